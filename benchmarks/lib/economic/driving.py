"""Energy-optimal driving: the terminal cost of its regulator and its tuning."""

from __future__ import annotations

import numpy as np

from benchmarks.lib.report import Report
from examples import driving
from nmpc_codegen import ProblemError
from nmpc_codegen.economic import lqr_terminal_cost, tune


def measure(report: Report) -> None:
    """P is indefinite and solves its equation; the program is solved with eta = 1 although one scaling fails."""
    terminal = lqr_terminal_cost(driving.build_ocp(), driving.options(), economic=True)
    least = float(np.linalg.eigvalsh(terminal.P)[0]) * driving.POWER / driving.SAMPLING
    report.add("driving_least_eigenvalue_of_P", least, "W s^2/m^2", case="-17025", profile="")
    report.add("driving_riccati_residual", terminal.residual, limit=1e-9, profile="")
    report.add("driving_speed_error", abs(terminal.x_s[2] - driving.SPEED) * 3.6, "km/h", limit=1e-3, profile="")
    found = driving.tuned()
    kept = [i for i in range(len(found.names)) if found.names[i] != "px"]
    report.add("driving_least_eigenvalue_of_M", np.linalg.eigvalsh(found.M[np.ix_(kept, kept)])[0], profile="")
    report.add("driving_frequency_function", found.with_rows.least, limit=0, at_least=True, profile="")
    report.add("driving_false_infeasible", unscaled_fails(), case="N, w not scaled: named as failed", profile="")


def unscaled_fails() -> float:
    """1 if the solver fails without scaling and the error says that M exists all the same."""
    try:
        tune(driving.build_ocp(newton=1.0), driving.options(), scaling="none")
    except ProblemError as error:
        return float("says that M exists" in str(error))
    return 0.0
