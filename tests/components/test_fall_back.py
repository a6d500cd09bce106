"""RiccatiActiveSet.fallback: when the interior point method takes over, at what cost, and what happens without it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from examples import crane, quadrotor
from nmpc_codegen import OCP, NoCondensing, Options, RiccatiActiveSet, RiccatiInteriorPoint, Status, build
from nmpc_codegen.cli.settings import apply_settings
from nmpc_codegen.compiler import text_of
from verification.c_harness import module_of
from verification.models import problem_of
from verification.routes import PURE


def test_without_fall_back_the_interior_point_method_is_not_in_the_package() -> None:
    """No code, no struct, less memory; the command line knows the option."""
    ocp, closed = problem_of("reactor"), Options(condensing=NoCondensing(), qp=RiccatiActiveSet(fallback=None))
    with_it = module_of(ocp, replace(closed, qp=RiccatiActiveSet()))
    without = module_of(ocp, closed)
    assert "ipm" in {s.name for s in with_it.structs}
    assert "ipm" not in {s.name for s in without.structs}
    assert without.bytes < with_it.bytes
    assert "ipm" not in text_of(without)[f"{without.name}.c"]
    assert apply_settings(Options(), [("qp.fallback", "None")]).qp == RiccatiActiveSet(fallback=None)


@pytest.mark.parametrize("cap", [1, 4, None])
def test_attempts_after_the_interior_point_method_fit_the_record_of_working_sets(cap: int | None) -> None:
    """Also if fewer working sets may be tried: every one of them has its entry in history[]."""
    module = module_of(problem_of("reactor"), Options(condensing=NoCondensing(), qp=RiccatiActiveSet(cap)))
    (history,) = (f for s in module.structs if s.name == "qp" for f in s.fields if f.name == "history")
    assert history.padded == (1 + module.sizes["QP_MAX_ITERATIONS"],)
    assert module.sizes["QP_MAX_POLISH"] == min(5, module.sizes["QP_MAX_ITERATIONS"])


def test_without_fall_back_closed_loops_are_the_same_where_it_is_not_needed() -> None:
    loops = []
    for fallback in (RiccatiInteriorPoint(), None):
        controller = build(
            quadrotor.build_ocp(),
            Options(condensing=NoCondensing(), qp=RiccatiActiveSet(fallback=fallback)),
            profile="test",
        )
        x, states = np.array([0.5, -0.4, 0.3, 0.1, 0.05, -0.1, 0, 0, 0, 0, 0, 0]), []
        for _ in range(10):
            u = controller.step(x)
            assert controller.status == Status.OK
            x = np.asarray(controller.integrate(x, u, 0.05))
            states.append(x)
        loops.append(np.array(states))
    np.testing.assert_allclose(loops[0], loops[1], rtol=0, atol=1e-12)


def test_without_fall_back_an_infeasible_qp_ends_with_a_status_and_a_safe_control() -> None:
    """Two contradictory rows: the control stays inside its bounds, and the plan is unchanged."""
    ocp = OCP("torn", T=1.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(5, x, np.inf, at="end")
    statuses = {}
    for fallback in (RiccatiInteriorPoint(), None):
        options = Options(condensing=NoCondensing(), qp=RiccatiActiveSet(fallback=fallback), algorithm=PURE)
        controller = build(ocp, options, profile="test")
        before = controller.x.copy()
        u0 = controller.step(np.array([0.0]))
        statuses[fallback is None] = controller.status
        assert np.all(np.abs(u0) <= 1)
        np.testing.assert_array_equal(controller.x, before)
    assert statuses == {False: Status.INFEASIBLE, True: Status.ITERATION_LIMIT}


def gentle_crane() -> OCP:
    """Soft rows that most samples violate at some nodes, in other places than the sample before."""
    ocp = crane.build_ocp(False)
    ocp.subject_to(-0.3, ocp.x[1], 0.3, name="speed", soft=(10.0, 0.0))
    ocp.subject_to(-0.02, ocp.x[2], 0.02, name="angle", soft=(50.0, 10.0))
    return ocp


def test_soft_rows_in_use_need_few_iterations() -> None:
    """Of both methods together; the result is exact, so that the interior point method alone finds the same control."""
    c, other = (
        build(gentle_crane(), Options(condensing=NoCondensing(), qp=qp), profile="test")
        for qp in (RiccatiActiveSet(), RiccatiInteriorPoint())
    )
    x, iterations = np.random.default_rng(1).uniform(-0.8, 0.8, 4), []
    for _ in range(25):
        u = c.step(x)
        assert c.status == Status.OK
        np.testing.assert_allclose(other.step(x), u, rtol=0, atol=1e-6)
        iterations.append(c.stats.qp_iterations)
        x = np.asarray(c.integrate(x, u, 0.3))
    assert max(iterations) > 5
    assert max(iterations) <= 25


def test_an_infeasible_qp_costs_little_more_than_its_proof() -> None:
    """The load cannot come to rest in time; the proof takes a few iterations."""
    iterations = {}
    for qp in (RiccatiActiveSet(), RiccatiInteriorPoint()):
        c = build(crane.build_ocp(), Options(condensing=NoCondensing(), qp=qp, algorithm=PURE), profile="test")
        c.step(np.array([1.0, 0.0, 0.5, 0.0]))
        assert c.status == Status.INFEASIBLE
        iterations[qp.name] = c.stats.qp_iterations
    assert iterations["riccati_active_set"] <= iterations["riccati_interior_point"] + 10


def test_the_interior_point_method_stays_at_a_plan_that_is_a_solution() -> None:
    """The same state again and again: in the end steps and all that terminal rows sum up are rounding errors."""
    c = build(
        crane.build_ocp(), Options(condensing=NoCondensing(), qp=RiccatiInteriorPoint(), algorithm=PURE), profile="test"
    )
    for _ in range(20):
        c.step(np.array([2.0, 0.0, 0.0, 0.0]))
        assert c.status == Status.OK
