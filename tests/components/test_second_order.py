"""Second-order sensitivities in C, both schemes in every code style, against the complex step."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import bioreactor, cart_pole, chain, crane
from nmpc_codegen import OCP
from nmpc_codegen.components.integrators import TABLEAUS, Discrete, ExplicitRungeKutta
from nmpc_codegen.components.integrators.explicit import derivatives, symmetric
from nmpc_codegen.components.integrators.explicit.derivatives import IntervalDerivatives
from nmpc_codegen.components.stage_cost import stage_cost
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.ir.stage_products import pattern
from nmpc_codegen.ir.sweep import Call, LoopedRoutine, Routine, Slice
from nmpc_codegen.lowering.linearize import stage_model
from tests.components import jets
from tests.components.second_order_oracle import Expansion, Rate, expand
from verification.c_harness import Routines
from verification.models import GRID, LENGTH, discrete_map, problem_of
from verification.oracles.runge_kutta import MODELS, POINTS, SCHEMES, Array, complex_step

TOLERANCE = 1e-12
UNROLL = ("all", "none")
SWEEPS = ("symmetric", "forward_over_adjoint")

#: (steps, uniform grid); of three steps one is neither the first nor the last.
GRIDS = ((1, True), (3, False))

#: Every tableau on one model, two on the others; second derivatives are loops whatever ``unroll`` says.
PAIRS = [("crane", s) for s in SCHEMES] + [(m, s) for m in ("reactor", "tanks") for s in ("SSPRK3", "RK4")]
SPELLED = {"crane": UNROLL, "reactor": ("all", "none"), "tanks": ("none", "auto")}


def start(problem: Problem) -> Call:
    """g = 0, Q = 0."""
    nz = problem.nx + problem.nu
    zeros = ca.Function("zeros", [], [ca.SX.zeros(nz), ca.SX.zeros(nz * nz)])
    return Call(zeros, (), (Slice("g", nz), Slice("Q", nz * nz)))


def curved(problem: Problem, component: Any, scheme: str) -> Routine:
    return component.lift_hessian(problem, scheme, "curved", start(problem), ())


@functools.cache
def stated(model: str, uniform: bool) -> Problem:
    return classify(problem_of(model, uniform))


@functools.cache
def seed(n: int) -> Array:
    return np.random.default_rng(n).uniform(-1, 1, n)


def assert_equal(got: list[Array], expected: Expansion, case: object, tolerance: float = TOLERANCE) -> None:
    """x_next, S, g, lower triangle of Q, normwise."""
    wanted = (expected.x_next, expected.S, expected.g, np.tril(expected.H))
    for value, exact in zip((*got[:3], np.tril(got[3])), wanted, strict=True):
        assert np.abs(value - exact).max() <= tolerance * max(1e-300, np.abs(exact).max()), case


def variants(model: str, tableau: str) -> list[tuple[str, str, tuple[int, bool]]]:
    """Scheme, spelling and grid: grids in turn, so that every two of tableau, scheme, spelling and grid meet."""
    first = list(SCHEMES).index(tableau)
    pairs = list(itertools.product(enumerate(SWEEPS), enumerate(SPELLED[model])))
    return [(scheme, unroll, GRIDS[(first + i + j) % 2]) for (i, scheme), (j, unroll) in pairs]


def test_every_spelling_meets_every_grid() -> None:
    """Of every scheme on the crane; and every tableau meets both grids."""
    seen = {(variant, tableau) for model, tableau in PAIRS if model == "crane" for variant in variants(model, tableau)}
    assert {variant for variant, _ in seen} == set(itertools.product(SWEEPS, SPELLED["crane"], GRIDS))
    assert {(variant[2], tableau) for variant, tableau in seen} == set(itertools.product(GRIDS, SCHEMES))


@pytest.fixture(scope="module", params=PAIRS, ids="-".join)
def compiled(request: pytest.FixtureRequest) -> tuple[str, str, Routines]:
    """Model, tableau, and routines <scheme>_<unroll>."""
    model, tableau = request.param
    routines = {}
    for scheme, unroll, (steps, uniform) in variants(model, tableau):
        component = ExplicitRungeKutta(TABLEAUS[tableau], steps, unroll)  # type: ignore[arg-type]
        routines[f"{scheme}_{unroll}"] = curved(stated(model, uniform), component, scheme)
    return model, tableau, Routines(routines)


def test_against_the_complex_step(compiled: tuple[str, str, Routines]) -> None:
    model, tableau, routines = compiled
    x, u, p = POINTS[model]
    lam = seed(len(x))
    for scheme, unroll, (steps, uniform) in variants(model, tableau):
        dt = LENGTH if uniform else GRID[1]
        expected = expand(MODELS[model], tableau, steps, dt, x, u, p, lam)
        assert_equal(routines(f"{scheme}_{unroll}", x, u, p, [dt], lam), expected, (scheme, unroll, steps))


@pytest.mark.parametrize("scheme", SWEEPS)
def test_against_casadi(scheme: str) -> None:
    """The Hessian of the complete unrolled interval by CasADi."""
    problem = stated("reactor", False)
    x, u, p = POINTS["reactor"]
    lam = seed(2)
    a, b = SCHEMES["RK4"]
    X, U = ca.SX.sym("x", 2), ca.SX.sym("u", 2)
    state, h = X, GRID[0] / 2
    for _ in range(2):
        K: list[ca.SX] = []
        for row in a:
            K.append(problem.dynamics(state + sum((h * c * k for c, k in zip(row, K, strict=False)), 0 * X), U, p))
        state = state + sum((h * w * k for w, k in zip(b, K, strict=True)), 0 * X)
    hessian = ca.Function("H", [X, U], [ca.hessian(ca.dot(lam, state), ca.vertcat(X, U))[0]])
    exact = np.array(hessian(x, u))
    routines = Routines({f"as_{n}": curved(problem, ExplicitRungeKutta(unroll=n), scheme) for n in UNROLL})
    for unroll in UNROLL:
        Q = routines(f"as_{unroll}", x, u, p, [GRID[0]], lam)[3]
        assert np.abs(np.tril(Q - exact)).max() <= TOLERANCE * np.abs(exact).max()


@pytest.mark.parametrize("model", ["crane", "tanks"])
def test_single_precision(model: str) -> None:
    """256 eps: two sweeps over eight stages."""
    x, u, p = POINTS[model]
    lam = seed(len(x))
    expected = expand(MODELS[model], "RK4", 2, GRID[1], x, u, p, lam)
    routines = {
        f"{s}_{n}": curved(stated(model, False), ExplicitRungeKutta(unroll=n), s) for s in SWEEPS for n in UNROLL
    }
    single = Routines(routines, "single")
    for key in routines:
        assert_equal(single(key, x, u, p, [GRID[1]], lam), expected, key, 256 * 2.0**-23)


# Costs that are integrated -------------------------------------------------------------------------------------------

#: l = x_0^2 u_0 + exp(x_1) + u_1 of the reactor.
RATE = Rate(
    lambda x, u, p: x[0] ** 2 * u[0] + np.exp(x[1]) + u[1],
    lambda x, u, p: np.array([2 * x[0] * u[0], np.exp(x[1])]),
    lambda x, u, p: np.array([x[0] ** 2, 1.0]),
)


@functools.cache
def economic(uniform: bool) -> Problem:
    """The reactor with that rate, and a cost at the node that the start of a sweep would add."""
    ocp = problem_of("reactor", uniform)
    ocp.stage_cost(ocp.x[0] ** 2 * ocp.u[0] + ca.exp(ocp.x[1]) + ocp.u[1], integrate=True)
    return classify(ocp)


@pytest.mark.parametrize(("steps", "uniform"), GRIDS)
def test_integrated_cost(steps: int, uniform: bool) -> None:
    """Value, gradient by the adjoint, gradient and Hessian by the sweeps; least squares of the node are added."""
    x, u, p = POINTS["reactor"]
    lam, dt = seed(2), LENGTH if uniform else GRID[2]
    yref, W = np.array([0.1, 0.2, 0.3, 0.4]), np.array([1.0, 2.0, 3.0, 4.0])
    expected = expand(MODELS["reactor"], "SSPRK3", steps, dt, x, u, p, lam, RATE)
    r = np.concatenate([x, u]) - yref
    routines: dict[str, Routine] = {}
    for unroll in UNROLL:
        component = ExplicitRungeKutta(TABLEAUS["SSPRK3"], steps, unroll)
        for scheme in SWEEPS:
            routines[f"{scheme}_{unroll}"] = curved(economic(uniform), component, scheme)
        problem = economic(uniform)
        path = stage_model(problem, component, stage_cost(problem.path, "path"))
        for name, routine in (("cost", path.cost), ("gradient", path.gradient)):
            routines[f"{name}_{unroll}"] = routine
    call = Routines(routines)
    for unroll in UNROLL:
        for scheme in SWEEPS:
            assert_equal(call(f"{scheme}_{unroll}", x, u, p, [dt], lam), expected, (scheme, unroll))
        gradient = call(f"gradient_{unroll}", x, u, p, [dt], yref, W)[0]
        np.testing.assert_allclose(gradient, expected.g + W * r, rtol=TOLERANCE)
        value = call(f"cost_{unroll}", x, u, p, [dt], yref, W)[0]
        assert abs(value[0] - r @ (W * r) / 2 - integral(steps, dt, x, u, p)) <= TOLERANCE * abs(value[0])


def integral(steps: int, dt: float, x: Array, u: Array, p: Array) -> float:
    """The rate as a further state of the scheme."""
    a, b = SCHEMES["SSPRK3"]
    h, q, X = dt / steps, 0.0, x
    for _ in range(steps):
        points: list[Array] = []
        slopes: list[Array] = []
        for row in a:
            points.append(X + h * sum(c * k for c, k in zip(row, slopes, strict=False)))
            slopes.append(MODELS["reactor"].f(points[-1], u, p))
        q += h * sum(w * float(RATE.value(P, u, p)) for w, P in zip(b, points, strict=True))
        X = X + h * sum(w * k for w, k in zip(b, slopes, strict=True))
    return q


# Storage -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_what_is_not_kept_is_evaluated_again(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three ways of storage: curved rows of all stages; adjoints and tapes; only adjoints and points."""
    problem, (x, u, p) = stated(model, True), POINTS[model]
    lam = seed(len(x))
    expected = expand(MODELS[model], "RK4", 2, LENGTH, x, u, p, lam)
    routines: dict[str, Routine] = {}
    for way in ("kept", "tapes", "points"):
        if way == "tapes":
            monkeypatch.setattr(symmetric, "TAPE_PER_COMPONENT", 0)
        if way == "points":
            monkeypatch.setattr(derivatives, "TAPE_PER_COMPONENT", 0)
        for scheme in SWEEPS:
            routines[f"{way}_{scheme}"] = curved(problem, ExplicitRungeKutta(), scheme)
    call = Routines(routines)
    for key in routines:
        assert_equal(call(key, x, u, p, [LENGTH], lam), expected, key)

    def loops(key: str) -> int:
        routine = routines[key]
        assert isinstance(routine, LoopedRoutine)
        return sum(getattr(node, "index", "") == "step" for node in routine.sweep.body)

    assert [loops(f"{way}_symmetric") for way in ("kept", "tapes", "points")] == [2, 3, 3]


#: Example, steps, whether its three sweeps have tapes in vectors.
IN_VECTORS = (
    (lambda: bioreactor.build_ocp(periodic=False), 3, True),
    (cart_pole.build_ocp, 2, True),  # calls of sin and cos
    (lambda: chain.build_ocp(3), 2, True),  # a long tape
    (crane.build_ocp, 2, False),  # a short one
)


@pytest.mark.parametrize(("make", "steps", "wide"), IN_VECTORS)
def test_stages_in_vectors(make: Callable[[], OCP], steps: int, wide: bool) -> None:
    """Against arithmetic with Taylor polynomials, at a point where nothing vanishes."""
    problem = classify(make())
    builder = symmetric.ThreeSweeps(problem, TABLEAUS["RK4"], steps)
    assert builder.wide == wide
    x = problem.x_initial + np.random.default_rng(1).uniform(-0.1, 0.1, problem.nx)
    u, lam = np.random.default_rng(2).uniform(0.2, 0.9, problem.nu), seed(problem.nx)
    rate = problem.path.cost_rate
    if rate is not None:
        rate = ca.Function("rate", [problem.path.x, problem.path.u, problem.path.p], [rate])
    end, q = jets.interval(problem.dynamics, rate, SCHEMES["RK4"], steps, problem.dt[0], x, u, problem.p_value)
    H = sum((weight * jet.H for weight, jet in zip(lam, end, strict=True)), q.H)
    expected = Expansion(np.array([jet.v for jet in end]), np.array([jet.g for jet in end]), q.g, H)
    spelled = ("none", "auto") if len(x) > 5 else UNROLL
    call = Routines(
        {f"as_{n}": curved(problem, ExplicitRungeKutta(steps=steps, unroll=n), "symmetric") for n in spelled}
    )
    for unroll in spelled:
        assert_equal(call(f"as_{unroll}", x, u, problem.p_value, [problem.dt[0]], lam), expected, unroll)


def test_memory_of_three_sweeps() -> None:
    """No storage per stage of three sweeps exceeds n (nx + nx); forward over adjoint stores n nx nz."""
    problem = classify(dense(6))
    sizes = {}
    for scheme in SWEEPS:
        routine = curved(problem, ExplicitRungeKutta(steps=2, unroll="none"), scheme)
        assert isinstance(routine, LoopedRoutine)
        sizes[scheme] = dict(routine.sweep.locals)
    stages, nx, ld = 8, 6, 8
    kept = {"Xs": stages * nx, "kappa": stages * nx}
    assert {name: sizes["symmetric"][name] for name in kept} == kept
    assert sizes["forward_over_adjoint"]["Zs"] == stages * nx * ld
    assert sum(sizes["symmetric"].values()) < sum(sizes["forward_over_adjoint"].values())


def dense(n: int) -> OCP:
    """A model with all derivatives nonzero: n states, one control."""
    ocp = OCP("dense", T=1.0, N=2)
    x, u = ocp.state("x", size=n), ocp.control("u")
    M = np.random.default_rng(n).uniform(0.1, 1, (n, n + 1))
    ocp.dynamics(ca.sin(M @ ca.vertcat(x, u)) ** 2)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(n + 1))
    return ocp


# Structure -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", SWEEPS)
def test_lower_triangle_and_structural_zeros(scheme: str) -> None:
    """The crane is curved only in (phi, omega, a); straight-line code stores nothing else, and loops use it as well."""
    block = {(i, j) for i in (2, 3, 4) for j in (2, 3, 4) if j <= i}
    for unroll in UNROLL:
        routine = curved(stated("crane", True), ExplicitRungeKutta(steps=2, unroll=unroll), scheme)
        assert {(i, j) for i, j in pattern(routine, "Q") if j <= i} == block
        if isinstance(routine, Kernel):
            assert pattern(routine, "Q") == block


def test_columns_that_depend_on_time_alone() -> None:
    """States of the crane: position and velocity of the cart; they are not propagated."""
    d = IntervalDerivatives(stated("crane", True))
    assert [d.depends_on_time_alone(j) for j in range(5)] == [True, True, False, False, False]
    assert d.curved == [3]
    assert (d.curved_states, d.curved_controls) == ([2], [0])


@pytest.mark.parametrize("scheme", SWEEPS)
def test_linear_dynamics_have_no_curvature(scheme: str) -> None:
    ocp = OCP("linear", T=1.0, N=2)
    x, u = ocp.state("x", size=4), ocp.control("u")
    M = np.random.default_rng(0).uniform(-1, 1, (4, 5))
    ocp.dynamics(M @ ca.vertcat(x, u))
    ocp.least_squares(u, weight=[1.0])
    problem = classify(ocp)
    routines = {f"as_{n}": curved(problem, ExplicitRungeKutta(unroll=n), scheme) for n in UNROLL}
    call = Routines(routines)
    expected = np.array(ca.DM.zeros(5, 5))
    for unroll, routine in routines.items():
        assert not pattern(routine, "Q")
        x_next, S, _, Q = call(unroll, np.ones(4), [0.5], np.zeros(0), [0.5], np.ones(4))
        np.testing.assert_array_equal(Q, expected)
        np.testing.assert_allclose(S @ np.append(np.ones(4), 0.5), x_next, rtol=1e-14)


@pytest.mark.parametrize("scheme", SWEEPS)
def test_products_of_controls(scheme: str) -> None:
    """x' = u_0 u_1 + u_0^2: H has rows of the controls only, no state is curved."""
    ocp = OCP("controls", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u", size=2)
    ocp.dynamics({x: u[0] * u[1] + u[0] ** 2 - x})
    ocp.least_squares(u, weight=[1.0, 1.0])
    problem = classify(ocp)
    call = Routines({f"as_{n}": curved(problem, ExplicitRungeKutta(unroll=n), scheme) for n in UNROLL})
    h, growth = 0.25, 0.0
    for _ in range(2):  # RK4 on s' = 1 - s
        s = growth
        k1 = 1 - s
        k2 = 1 - (s + h / 2 * k1)
        k3 = 1 - (s + h / 2 * k2)
        k4 = 1 - (s + h * k3)
        growth = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    expected = 3.0 * growth * np.array([[0, 0, 0], [0, 2, 0], [0, 1, 0]])
    for n in UNROLL:
        Q = call(f"as_{n}", [0.3], [0.2, -0.4], np.zeros(0), [0.5], [3.0])[3]
        np.testing.assert_allclose(np.tril(Q), expected, rtol=1e-14, atol=1e-16)


@pytest.mark.parametrize("scheme", SWEEPS)
def test_discrete_map(scheme: str) -> None:
    """d2 (lam' Phi) itself, from the hand-written Jacobian."""
    problem = classify(discrete_map())
    z, p, lam = np.array([0.4, -0.7, 0.2, 0.3]), np.array([0.8]), np.array([0.7, -1.3])

    def phi(z: Array) -> Array:
        return np.array([z[0] + 0.5 * z[1] ** 2 + p[0] * z[2], 0.84 * z[1] - z[0] * np.exp(z[3])])

    def slope(z: Array) -> Array:
        e = np.exp(z[3])
        S = np.array([[1, z[1], p[0], 0], [-e, 0.84, 0, -z[0] * e]])
        return S.T @ lam

    call = Routines({"map": curved(problem, Discrete(), scheme)})
    got = call("map", z[:2], z[2:], p, [1.0], lam)
    S = complex_step(phi, z)
    assert_equal(got, Expansion(phi(z), S, np.zeros(4), complex_step(slope, z)), scheme)
