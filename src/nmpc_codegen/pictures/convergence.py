"""The iterations of solve() are drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from nmpc_codegen.pictures.style import (
    BOUND_COLOR,
    CONTROL_COLOR,
    FAILURE_COLOR,
    ROW_COLOR,
    STATE_COLOR,
    finish,
    new_figure,
    use_style,
)
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.records.iterations import Iteration
from nmpc_codegen.runtime.records.trace import File

PARTS = {"stationarity": STATE_COLOR, "equality": CONTROL_COLOR, "inequality": ROW_COLOR, "complementarity": "#7a4fa3"}


def _drawable(value: float) -> float:
    """Return a value for a logarithmic axis; 0 leaves a gap."""
    return value if value > 0 else math.nan


def draw(log: Sequence[Iteration], title: str, failed: bool, file: File) -> Any:
    """Draw residuals above, length of the step and shift of the Hessian below, over the iterations."""
    numbers = range(1, len(log) + 1)
    figure = new_figure((7.2, 4.6), file)
    with use_style():
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
        below.xaxis.set_major_locator(extra("matplotlib.ticker", "plot_convergence()").MaxNLocator(integer=True))
        figure.legend(fontsize=8, ncols=4, frameon=False, loc="outside lower center")
        return finish(figure, title, (), file, FAILURE_COLOR if failed else "0.2")
