"""The iterations of solve() are shown as a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from nmpc_codegen.package.status import Kkt


@dataclass(frozen=True)
class Iteration:
    """The record has the results of one SQP iteration.

    Attributes:
        kkt: residuals at its end, absolute by parts and relative.
        length: length of its step, 1 for a full step.
        qp_iterations: iterations of its last QP.
        active: number of bounds and rows with a multiplier.
        restoring: True if the step only had to reduce the violation of constraints.
        cost: cost at its end.
        shift: number added to the diagonal of the scaled Hessian, 0 if it was convex.
    """

    kkt: Kkt
    length: float
    qp_iterations: int
    active: int
    restoring: bool
    cost: float
    shift: float


def rows(log: Sequence[Iteration]) -> list[dict[str, float | int]]:
    """Return one row per iteration: number, cost, residuals, length, shift, QP iterations, active bounds, restoring."""
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
    """Return the rows as text in aligned columns."""
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
    """Return the rows as comma-separated values with all digits, below a line of names."""
    found, text = rows(log), io.StringIO()
    writer = csv.DictWriter(text, list(found[0]) if found else ["iteration"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(found)
    return text.getvalue()
