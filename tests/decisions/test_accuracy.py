"""Steps and schemes that are chosen by the error of an interval: linear circuits, whose solution is known."""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from nmpc_codegen import OCP, RK4, Controller, ExplicitRungeKutta, Options, ProblemWarning, build, generate
from nmpc_codegen.decisions.accuracy import ACCURATE
from nmpc_codegen.decisions.trials import trials_of
from nmpc_codegen.frontend.classify import classify

DT = 5e-4


def circuit(L: float, C: float, R: float) -> tuple[OCP, Any]:
    """A filter, and the matrices of d(i, v, u)/dt."""
    ocp = OCP("filter", T=20 * DT, N=20)
    i, v, u = ocp.state("i", unit="A"), ocp.state("v", unit="V"), ocp.control("u", unit="V")
    ocp.dynamics({i: (u - v - 0.05 * i) / L, v: (i - v / R) / C})
    ocp.least_squares(ca.vertcat(v, u), weight=[1.0, 1e-3], reference=[5.0, 5.0])
    ocp.subject_to(0, u, 12)
    return ocp, np.array([[-0.05 / L, -1 / L, 1 / L], [1 / C, -1 / (R * C), 0], [0, 0, 0]])


def largest_error(ctrl: Controller, M: Any) -> float:
    """Of an interval from the first plan and the set point, relative to 5 V."""
    exact, most = expm(M * DT), 0.0
    for start in ([0, 0, 0], [0, 0, 12], [0, 5, 5], [0, 5, 0]):
        found = ctrl.integrate(np.array(start[:2], float), [start[2]], DT)
        most = max(most, float(np.abs(found - (exact @ start)[:2]).max()) / 5)
    return most


@pytest.mark.parametrize("seed", range(4))
def test_a_default_is_accurate_or_says_that_it_is_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ocp, M = circuit(10 ** rng.uniform(-4.5, -3), 10 ** rng.uniform(-5, -4), rng.uniform(1, 8))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        ctrl = build(ocp, profile="test")
    error = largest_error(ctrl, M)
    assert error <= 5 * ACCURATE or any("is not accurate" in str(w.message) for w in said)


def test_the_advice_of_the_warning_has_been_tried() -> None:
    ocp, M = circuit(5e-5, 2e-5, 5.0)
    with pytest.warns(
        ProblemWarning, match=r"from i = .*, v = .* is 0.\d+ of .* off; steps=(\d+) are accurate"
    ) as said:
        build(ocp, profile="test")
    steps = int(str(said[0].message).rsplit("=", 1)[1].rstrip(")"))
    better = build(ocp, Options(ExplicitRungeKutta(RK4, steps=steps)), "test")
    assert largest_error(better, M) <= 5 * ACCURATE


def test_the_choice_says_why() -> None:
    ocp, _ = circuit(1.27e-4, 1.93e-5, 1.6)
    (choice, *_) = generate(ocp).description.report.choices
    assert "steps end" in choice
    assert "RK4 needs" in choice
    flow = trials_of(classify(ocp)).flow
    steps = int(generate(ocp).description.options["integrator.steps"])
    assert flow.error(RK4, steps) <= ACCURATE < flow.error(RK4, steps - 1)


def test_states_inside_the_bounds_count() -> None:
    """At the first plan a pendulum hangs; at the speeds that its bounds allow two steps are not enough."""
    found = {}
    for fastest in (1.0, 60.0):
        ocp = OCP("pendulum", T=4.0, N=10)
        angle, rate, u = ocp.state("angle"), ocp.state("rate"), ocp.control("u")
        ocp.dynamics({angle: rate, rate: -9.81 * ca.sin(angle) + u})
        ocp.least_squares(ca.vertcat(angle, rate, u), weight=[1, 1, 0.1])
        ocp.subject_to(-1, u, 1)
        ocp.subject_to(-fastest, rate, fastest)
        ocp.subject_to(-3, angle, 3)
        found[fastest] = trials_of(classify(ocp)).flow.error(RK4, 2)
    assert found[60.0] > 3 * found[1.0]


def test_states_that_escape_do_not_count() -> None:
    """x' = x^2 + u is infinite after 1 / x; where the bounds lead there no number of steps matters."""
    ocp = OCP("escape", T=2.0, N=2)
    x, u = ocp.state("x", initial=0.1), ocp.control("u")
    ocp.dynamics({x: x**2 + u})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.subject_to(-0.1, u, 0.1)
    ocp.subject_to(0, x, 100)
    assert np.isfinite(trials_of(classify(ocp)).flow.error(RK4, 4))
    assert trials_of(classify(ocp)).flow.error(RK4, 4) < 0.1
