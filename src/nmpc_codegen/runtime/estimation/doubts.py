"""An estimate is in doubt if measurements differ from their expected values; this module explains that in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from nmpc_codegen.package.estimation import Estimation
from nmpc_codegen.package.status import Stats

#: Unit of an angle -> a full turn; a measurement without a unit may be an angle.
TURNS = {"rad": 2 * np.pi, "": 2 * np.pi, "deg": 360.0}


def describe_doubts(found: Estimation, stats: Stats, watch: Any) -> str:
    """Return one line that says what was expected, how the estimator reacted, and what would help."""
    said = []
    name = stats.measurement
    if name is not None and int(watch["doubted"]):
        place = found.measurements.index(name)
        unit = next(s.unit for s in found.measured if name in s.elements)
        size = f"{stats.error:.3g} {unit}".strip()
        said.append(f"{name} is {size} from what was expected, {stats.innovation:.2g} standard deviations")
        turns = _turns(stats, unit)
        if turns:
            said.append(f"that is {turns} full turn{'s' if turns > 1 else ''} of an angle: unwrap it before step()")
        if int(watch["left_out"]):
            said.append("an outlier was left out")
        if not turns:
            said.append(_advice(found.thresholds[place] > 0, not int(watch["left_out"])))
    if int(watch["trial"]):
        anew = "the estimate began anew, and " if int(watch["restarts"]) else "the estimate "
        said.append(f"{anew}is OK after {int(watch['trial'])} more samples as expected")
    return "; ".join(said)


def _turns(stats: Stats, unit: str) -> int:
    """Return by how many full turns a measurement is off, 0 for none."""
    turn = TURNS.get(unit)
    if turn is None or not stats.innovation:
        return 0
    rest = abs(abs(stats.error) - turn * round(abs(stats.error) / turn))
    near = min(5 * abs(stats.error) / stats.innovation, turn / 12)
    return round(abs(stats.error) / turn) if rest <= near else 0


def _advice(has_loss: bool, lasting: bool) -> str:
    if not has_loss:
        return 'if that happens often, state loss="huber"' + (
            ", or a larger noise_std or process_std" if lasting else ""
        )
    return "state a larger noise_std or process_std, or find what the model lacks"
