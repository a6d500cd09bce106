"""RealTimeIteration(simulate=True): the single-shooting form of the real-time iteration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import crane, cstr
from nmpc_codegen import (
    OCP,
    AdjointShooting,
    NoCondensing,
    OptionError,
    Options,
    ProblemWarning,
    RealTimeIteration,
    Status,
    build,
    generate,
    simulate,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, interval_map
from verification import problems, samples
from verification.routes import PURE

SIMULATED = replace(PURE, simulate=True)
X0 = np.array([0.5, 0.0, 0.1, 0.0])


def wild(algorithm: Any = SIMULATED, **options: Any) -> Any:
    """The crane without a terminal row and with a plan that has gaps everywhere."""
    controller = build(crane.build_ocp(terminal_constraint=False), Options(algorithm=algorithm, **options), "test")
    random = np.random.default_rng(4)
    controller.x = np.vstack([X0, random.uniform(-0.3, 0.3, (10, 4))])
    controller.u = random.uniform(-0.2, 0.2, (10, 1))
    return controller


def rollout(u: Any) -> list[Any]:
    """The states by CasADi, with the classical scheme in two steps."""
    problem = classify(crane.build_ocp(terminal_constraint=False))
    step, x = interval_map(problem, replace(CLASSICAL, steps=2)), [ca.MX(X0)]
    for k in range(problem.N):
        x.append(step(x[-1], u[k], ca.MX(0, 1), problem.dt[k])[0])
    return x


@pytest.mark.parametrize("options", [{}, {"condensing": NoCondensing()}], ids=["chosen", "stages"])
def test_a_sample_is_a_gauss_newton_step_of_the_residual_in_the_controls(options: dict[str, Any]) -> None:
    """min_du |F(u) + dF/du du|^2 with F of all nodes, from CasADi's Jacobian of the whole simulation."""
    controller = wild(**options)
    start = controller.u.copy()
    u = ca.MX.sym("u", 10)
    x = rollout(u)
    F = ca.vertcat(*(ca.vertcat(x[k], u[k]) for k in range(10)), x[10])
    value, J = (np.asarray(v) for v in ca.Function("F", [u], [F, ca.jacobian(F, u)])(start))
    step = np.linalg.lstsq(J, -value.ravel(), rcond=None)[0]
    assert np.abs(start.ravel() + step).max() < 1
    controller.step(X0)
    np.testing.assert_allclose(controller.u.ravel(), start.ravel() + step, atol=1e-9)


def test_the_linearisation_has_no_gaps_and_the_residual_tells_what_they_were() -> None:
    controller = wild(replace(SIMULATED, tolerance=0.1))
    u, before = controller.u.copy(), controller.x.copy()
    controller.prepare()
    exact = np.hstack([np.asarray(ca.evalf(v)) for v in rollout(ca.DM(u))]).T
    np.testing.assert_allclose(controller.x, exact, atol=1e-13)
    assert np.abs(controller.view("node.b")).max() < 1e-14
    size = np.maximum(np.abs(exact).max(axis=0), 0.1 * np.array(controller.description.scales[: exact.shape[1]]))
    assert controller.stats.residual == pytest.approx((np.abs(before - exact).max(axis=0) / size).max(), rel=1e-9)
    controller.feedback(X0)
    assert (controller.status is Status.NOT_CONVERGED) == (controller.stats.residual > 0.1)


def test_it_agrees_with_single_shooting_by_adjoints() -> None:
    """The same step by conjugate gradients without any matrix."""
    ours, other = wild(), wild(AdjointShooting(products=200, shift=None))
    other.x = ours.x
    ours.step(X0)
    other.step(X0)
    np.testing.assert_allclose(other.u, ours.u, atol=5e-3 * np.abs(ours.u).max())


@pytest.mark.parametrize("precision", ["double", "single"])
def test_closed_loops(precision: Any) -> None:
    for make, x0, dt, steps in ((crane.build_ocp, [2.0, 0, 0, 0], 0.3, 40), (cstr.build_ocp, cstr.START, 150.0, 40)):
        loops = []
        for simulated in (False, True):
            algorithm = RealTimeIteration(shift="repeat", simulate=simulated)
            controller = build(make(), Options(algorithm=algorithm, precision=precision), "test")
            loops.append(simulate(controller, x0, steps=steps, dt=dt))
        assert not np.any(loops[1].status[3:])
        scale = np.abs(loops[0].x).max(axis=0) + 1e-3
        assert (np.abs(loops[1].x[-1] - loops[0].x[-1]) / scale).max() < 2e-3


def test_a_simulation_that_overflows_leaves_the_plan() -> None:
    controller = build(problems.explosive(), Options(algorithm=SIMULATED), "test")
    controller.u, controller.x = np.full((8, 1), 5.0), np.ones((9, 1))
    for _ in range(8):
        control = controller.step([1.0])
        assert np.isfinite(control).all()
    assert np.isfinite(controller.x).all()
    assert controller.status is Status.OK


def test_unstable_plants_are_warned_of() -> None:
    """An upright pendulum over 2 s: e^(3.1 T)."""
    ocp = OCP("upright", T=2.0, N=20)
    angle, rate, torque = ocp.state("angle"), ocp.state("rate"), ocp.control("torque")
    ocp.dynamics({angle: rate, rate: 9.81 * ca.sin(angle) + torque})
    ocp.least_squares(ca.vertcat(angle, rate, torque), weight=np.ones(3))
    for algorithm in (AdjointShooting(), RealTimeIteration(simulate=True)):
        name = type(algorithm).__name__
        with pytest.warns(ProblemWarning, match=rf"{name} simulates its plans, .* factor of .* over 20 intervals"):
            generate(ocp, Options(algorithm=algorithm))
    generate(ocp)


def test_levels_are_refused() -> None:
    with pytest.raises(OptionError, match="simulate: True clashes with levels"):
        RealTimeIteration(shift="repeat", simulate=True, levels=True)


@pytest.mark.parametrize("make", [samples.arrival, samples.counted, samples.mixed], ids=lambda make: make.__name__)
def test_free_components_and_accumulators_are_simulated(make: Any) -> None:
    controller = build(make(), Options(algorithm=SIMULATED), "test")
    x0 = np.array(classify(make()).x_initial)
    for _ in range(6):
        controller.step(x0)
    assert controller.status is Status.OK
    assert controller.kkt().equality < 1e-3
