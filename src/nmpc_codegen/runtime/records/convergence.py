"""The iterations of solve() as a table and as a picture."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmpc_codegen.package.status import Kkt
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.records.plot import (
    BOUND_COLOR,
    CONTROL_COLOR,
    FAILURE_COLOR,
    ROW_COLOR,
    STATE_COLOR,
    STYLE,
    new_figure,
)

PARTS = {"stationarity": STATE_COLOR, "equality": CONTROL_COLOR, "inequality": ROW_COLOR, "complementarity": "#7a4fa3"}


@dataclass(frozen=True)
class Iteration:
    """One SQP iteration.

    kkt: residuals at its end, absolute by parts and relative; cost: at its end; length: of its step, 1 for the full
    one; shift: what was added to the Hessian, in units of each variable, 0 if it was convex; qp_iterations: of its last
    QP; active: number of bounds and rows with a multiplier; restoring: its step only had to reduce the violation of
    constraints.
    """

    kkt: Kkt
    length: float
    qp_iterations: int
    active: int
    restoring: bool
    cost: float
    shift: float


def rows(log: Sequence[Iteration]) -> list[dict[str, float | int]]:
    """One row per iteration: its number, cost, residuals, length, shift, QP iterations, active bounds, restoring."""
    return [
        {
            "iteration": number,
            "cost": entry.cost,
            **entry.kkt.parts,
            "relative": entry.kkt.relative,
            "length": entry.length,
            "shift": entry.shift,
            "qp": entry.qp_iterations,
            "active": entry.active,
            "restoring": int(entry.restoring),
        }
        for number, entry in enumerate(log, 1)
    ]


def table(log: Sequence[Iteration]) -> str:
    """The rows in aligned columns."""
    found = rows(log)
    if not found:
        return "no iterations"
    texts = [list(found[0]), *([_short(key, value) for key, value in row.items()] for row in found)]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    return "\n".join("  ".join(t.rjust(w) for t, w in zip(line, widths, strict=True)) for line in texts)


def _short(key: str, value: float) -> str:
    if isinstance(value, int):
        return str(value)
    return f"{value:.8g}" if key == "cost" else f"{value:.1e}"


def write_csv(log: Sequence[Iteration]) -> str:
    """The rows with all digits as comma-separated values, with a line of names."""
    found, text = rows(log), io.StringIO()
    writer = csv.DictWriter(text, list(found[0]) if found else ["iteration"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(found)
    return text.getvalue()


def _drawable(value: float) -> float:
    """A value on a logarithmic axis; 0 leaves a gap."""
    return value if value > 0 else math.nan


def draw(log: Sequence[Iteration], title: str, failed: bool, file: str | os.PathLike[str] | None) -> Any:
    """Figure: residuals above, length of the step and shift of the Hessian below, over the iterations."""
    mpl = extra("matplotlib", "plot_convergence()")
    numbers = range(1, len(log) + 1)
    figure = new_figure((7.2, 4.6), file)
    with mpl.rc_context(STYLE):
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        for part, color in PARTS.items():
            values = [_drawable(getattr(entry.kkt, part)) for entry in log]
            above.semilogy(numbers, values, color=color, linewidth=1.2, marker=".", markersize=3, label=part)
        relative = [_drawable(entry.kkt.relative) for entry in log]
        above.semilogy(numbers, relative, color="0.2", linewidth=2.0, marker=".", label="relative")
        above.set_ylabel("KKT residuals")
        lengths, shifts = ([_drawable(getattr(entry, name)) for entry in log] for name in ("length", "shift"))
        below.semilogy(numbers, lengths, color="#8a6d1d", marker=".", label="length of step")
        below.semilogy(numbers, shifts, color=FAILURE_COLOR, marker="+", linestyle="none", label="shift of Hessian")
        for number, entry in zip(numbers, log, strict=True):
            if entry.restoring:
                below.axvspan(number - 0.5, number + 0.5, color=BOUND_COLOR, alpha=0.15, linewidth=0)
        below.set_xlabel("iteration (grey: feasibility is restored)")
        figure.legend(fontsize=8, ncols=4, frameon=False, loc="outside lower center")
        figure.suptitle(title, fontsize=10, color=FAILURE_COLOR if failed else "0.2")
        if file is not None:
            figure.savefig(Path(file), dpi=160)
    return figure
