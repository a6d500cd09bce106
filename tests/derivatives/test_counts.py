"""Stated operation counts against the generated C run with a counting scalar, class by class."""

from __future__ import annotations

import casadi as ca
import pytest

from nmpc_codegen import OCP, ExplicitRungeKutta, Options, derivatives
from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.derivative_model import derivative_model
from tests.derivatives.counted import counted
from verification.counting import CLASSES
from verification.models import discrete_map, pendulum_of_everything, problem_of

CASES = {
    "map": (discrete_map, Options()),
    "reactor, straight-line": (lambda: problem_of("reactor"), Options(ExplicitRungeKutta(steps=2))),
    "tanks, loops": (lambda: problem_of("tanks", uniform=False), Options(ExplicitRungeKutta(steps=3, unroll="none"))),
    "costs of every kind": (lambda: pendulum_of_everything("pend", [0.2, 0.3]), Options(ExplicitRungeKutta(steps=2))),
    "single": (lambda: problem_of("crane"), Options(precision="single")),
}


def outputs(ocp: OCP) -> ca.SX:
    return ca.vertcat(ocp.x[0] * ocp.u[0], ca.sqrt(1 + ocp.x[1] ** 2))


@pytest.mark.few(4)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("with_outputs", [True, False])
def test_counts_are_exact(name: str, with_outputs: bool) -> None:
    make, options = CASES[name]
    ocp = make()
    z = outputs(ocp) if with_outputs else None
    model = derivative_model(ocp, z, None, options, second_order=True)
    stated = Counts(model).all
    found = counted(
        derivatives.generate(ocp, z, options, "counted_package", second_order=True), "counted_package", list(stated)
    )
    for function, count in stated.items():
        expected = {c: getattr(count, c) for c in CLASSES}
        assert {c: getattr(found[function], c) for c in CLASSES} == expected, function


def test_counts_of_rows_and_of_one_response() -> None:
    """One row goes back over as many intervals as its node has before it; all rows are the sum of all."""
    ocp = problem_of("crane")
    counts = Counts(derivative_model(ocp, outputs(ocp), None, None))
    for method in (counts.impulse_response_adjoint, counts.impulse_response_adjoint_matrices):
        base = method([0])
        one, last, every = method([2]), method([5]), method(range(6))
        step = one.total - base.total
        assert last.total - base.total == 2 * step > 0
        assert every.total - base.total == 2 * (0 + 1 + 2) * step
    later = counts.sensitivities_alternative(2).total
    assert later == counts.sensitivities_alternative(1).total + counts.value.total - counts.free.total
