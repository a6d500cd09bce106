"""The contracts of plans in operation concern their phases, and the use of a solution in the next sample."""

from __future__ import annotations

import numpy as np

from nmpc_codegen import Status
from verification.contracts.subject import TOLERANCE, Subject, relative

#: Largest difference, by precision, between the solution's control and the control of a sample that starts there.
KEPT = {"double": 1e-5, "single": 2e-2}


def a_preparation_serves_one_feedback(subject: Subject) -> None:
    """Assert that a second feedback, or one after shift() or reset(), is NOT_PREPARED with a finite control."""
    controller, x = subject.controller(), subject.measured()
    for between in (lambda: controller.feedback(x), controller.shift, controller.reset):
        controller.prepare()
        between()
        assert np.all(np.isfinite(controller.feedback(x)))
        assert controller.status is Status.NOT_PREPARED
    controller.prepare()
    controller.feedback(x)
    assert controller.status is not Status.NOT_PREPARED


def a_sample_keeps_the_solution(subject: Subject) -> None:
    """Assert that a sample right after solve() keeps the plan, and returns the control of the solution."""
    controller, x0, precision = subject.controller(), subject.measured(), subject.options.precision
    solution = controller.solve(x0, TOLERANCE[precision], 300)
    if solution.status is not Status.OK:
        return
    u = controller.step(x0)
    assert not controller.status.is_failure, controller.diagnose()
    assert relative(u, solution.u[0]) <= KEPT[precision]
