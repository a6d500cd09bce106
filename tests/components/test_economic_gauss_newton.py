"""EconomicGaussNewton: the generated step against a QP that NumPy assembles, routes, refusals, and stale data."""

from __future__ import annotations

import dataclasses
import functools
import re
from typing import Any

import casadi as ca
import numpy as np
import osqp
import pytest
import scipy.sparse as sp

from examples import driving, evaporation
from nmpc_codegen import (
    OCP,
    EconomicGaussNewton,
    ExplicitRungeKutta,
    NoCondensing,
    Online,
    OptionError,
    Options,
    RiccatiActiveSet,
    Status,
    build,
    generate,
)
from nmpc_codegen.cli.settings import apply_settings
from nmpc_codegen.economic import Tuning
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem, Row
from nmpc_codegen.oracle import trajectory as oracle
from nmpc_codegen.oracle.trajectory import CLASSICAL, Point, kkt_residuals, node_data
from nmpc_codegen.runtime.controller import Controller
from verification.routes import PURE, ROUTES, on

Array = np.ndarray

M = np.array([[0.9, 0.2, 0.05], [0.2, 0.6, 0.0], [0.05, 0.0, 0.4]])
M_F = np.array([[1.2, 0.3], [0.3, 0.8]])
X0 = np.array([0.9, -0.4])
TWO_STEPS = dataclasses.replace(CLASSICAL, steps=2)


def pendulum(soft: bool = True, fixed_end: bool = False, **grid: Any) -> OCP:
    """An economic cost with a saddle, integrated and at the nodes; a parameter, a general row, a soft bound."""
    ocp = OCP("pendulum", **(grid or {"T": 2.5, "N": 5}))
    q, w, u = ocp.state("q", initial=0.9), ocp.state("w", initial=-0.4), ocp.control("u")
    p, goal = ocp.parameter("p", value=1.5), ocp.parameter("goal", value=0.2)
    ocp.dynamics({q: w, w: -p * ca.sin(q) + u})
    ocp.stage_cost(1 - ca.cos(q - goal) + 0.1 * q * w + 0.2 * u**2, integrate=True)
    ocp.stage_cost(0.3 * (q - goal) ** 2 - 0.1 * w)
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-0.8, u + 0.3 * w * w, 0.9, name="effort")
    if soft:
        ocp.subject_to(-0.3, w, 0.6, soft=(0.5, 0.1), name="rate")
    if fixed_end:
        ocp.subject_to([-0.6, -0.1], ca.vertcat(q, w), [-0.6, -0.1], at="end", name="end")
    else:
        ocp.terminal_cost(w**2 + q**4)
    return ocp


@functools.cache
def built(route: str, precision: Any = "double", **more: Any) -> Controller:
    hessian = EconomicGaussNewton(M, None if more.get("fixed_end") else M_F)
    return build(pendulum(**more), options(hessian, route, precision), "test")


def options(hessian: Any, route: str, precision: Any = "double", **more: Any) -> Options:
    more = {"algorithm": PURE, **more}
    return on(route, integrator=ExplicitRungeKutta(steps=2), hessian=hessian, precision=precision, **more)


def drawn(c: Controller, seed: int) -> None:
    """A random plan near X0."""
    random = np.random.default_rng(seed)
    c.x[...] = X0 + random.uniform(-0.3, 0.3, c.x.shape)
    c.u[...] = random.uniform(-0.5, 0.5, c.u.shape)


# The QP by NumPy --------------------------------------------------------------------------------------------------


class NumpyStep:
    """min 1/2 d'H d + g'd  s.t.  E d = e, lower <= A d <= upper  for d = (dx_0, du_0, dx_1, ..., dx_N) at a plan."""

    def __init__(self, problem: Problem, x: Array, u: Array, blocks: tuple[Array, Array]) -> None:
        N, nx, nu = problem.N, problem.nx, problem.nu
        self.problem, self.n = problem, N * (nx + nu) + nx
        data = node_data(problem, x0=X0)
        (Phi, Phi_z), (_, cost_z), (h, h_z), (_, cost_N), *_ = oracle._jacobians(problem, TWO_STEPS)
        self.H, self.g = np.zeros((self.n, self.n)), np.zeros(self.n)
        equations, values = [np.eye(nx, self.n)], [X0 - x[0]]
        for k in range(N):
            z, after = self.part(k), slice((k + 1) * (nx + nu), (k + 1) * (nx + nu) + nx)
            S, q = (J.full() for J in Phi_z(x[k], u[k], data.p[k], problem.dt[k]))
            weight = (data.yref[k], data.W[k])
            self.H[z, z] = blocks[0]
            self.g[z] = (q + cost_z(x[k], u[k], data.p[k], problem.dt[k], *weight).full()).ravel()
            row = np.zeros((nx, self.n))
            row[:, z], row[:, after] = -S, np.eye(nx)
            equations.append(row)
            values.append(Phi(x[k], u[k], data.p[k], problem.dt[k])[0].full().ravel() - x[k + 1])
        end = slice(self.n - nx, self.n)
        self.H[end, end] = blocks[1]
        self.g[end] = cost_N(x[N], ca.DM(0, 1), data.p[N], 0.0, data.yref_N, data.W_N).full().ravel()
        self.E, self.e = np.vstack(equations), np.concatenate(values)
        self.rows = [(row, k) for row in problem.rows for k in row.nodes]
        self.A = np.array([self.gradient(row, k, h_z, x, u, data.p) for row, k in self.rows])
        self.value = np.array([self.at(row, k, h, x, u, data.p) for row, k in self.rows])

    def part(self, k: int) -> slice:
        n = self.problem.nx + self.problem.nu
        return slice(k * n, (k + 1) * n)

    def gradient(self, row: Row, k: int, h_z: Any, x: Array, u: Array, p: Array) -> Array:
        a, first = np.zeros(self.n), self.part(k).start
        if row.kind == "general":
            a[self.part(k)] = h_z(x[k], u[k], p[k]).full()[row.index]
        else:
            a[first + row.index + (self.problem.nx if row.kind == "control" else 0)] = 1.0
        return a

    def at(self, row: Row, k: int, h: Any, x: Array, u: Array, p: Array) -> float:
        if row.kind == "general":
            return float(h(x[k], u[k], p[k])[row.index])
        return float((x if row.kind == "state" else u)[k, row.index])

    def by_osqp(self) -> Array:
        """The step; a soft row has one slack s >= 0 that widens both bounds, which here exclude one another."""
        soft = [i for i, (row, _) in enumerate(self.rows) if row.soft is not None]
        m, ns = len(self.rows), len(soft)
        widen = np.zeros((m, ns))
        widen[soft, range(ns)] = 1.0
        l1, l2 = (np.array([self.rows[i][0].soft[j] for i in soft]) for j in (0, 1))  # type: ignore[index]
        lower, upper = (
            np.array([getattr(row, side) for row, _ in self.rows]) - self.value for side in ("lower", "upper")
        )
        A = np.block([
            [self.E, np.zeros((len(self.E), ns))],
            [self.A, widen],
            [self.A, -widen],
            [np.zeros((ns, self.n)), np.eye(ns)],
        ])  # fmt: skip
        low = np.concatenate([self.e, lower, np.full(m, -np.inf), np.zeros(ns)])
        high = np.concatenate([self.e, np.full(m, np.inf), upper, np.full(ns, np.inf)])
        solver = osqp.OSQP()
        P = sp.block_diag([self.H, np.diag(l2)]) if ns else sp.csc_matrix(self.H)
        exact = {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 200_000, "polishing": True, "verbose": False}
        solver.setup(sp.triu(P, format="csc"), np.concatenate([self.g, l1]), sp.csc_matrix(A), low, high, **exact)
        return np.asarray(solver.solve(raise_error=True).x)[: self.n]

    def on_active_set(self, c: Controller) -> Array:
        """The step by one linear system, with the rows whose multipliers in ``c`` are not 0 at their bounds."""
        point = Point(**{name: getattr(c, name) for name in ("x", "u", "lam", "mu_x", "mu_u", "mu", "mu_N", "eta")})
        H, g, equations, values = self.H.copy(), self.g.copy(), [self.E], [self.e]
        for a, v, (row, k) in zip(self.A, self.value, self.rows, strict=True):
            where, index = oracle.multiplier_of(self.problem, point, row, k)
            mu = float(where[index])
            if mu and row.soft is not None and abs(mu) >= row.soft[0]:
                bound = row.upper if mu > 0 else row.lower
                H, g = H + row.soft[1] * np.outer(a, a), g + a * (np.sign(mu) * row.soft[0] + row.soft[1] * (v - bound))
            elif mu:
                equations.append(a[None])
                values.append(np.array([(row.upper if mu > 0 else row.lower) - v]))
        E, e = np.vstack(equations), np.concatenate(values)
        K = np.block([[H, E.T], [E, np.zeros((len(E), len(E)))]])
        return np.linalg.lstsq(K, np.concatenate([-g, e]), rcond=None)[0][: self.n]


def step_taken(c: Controller, x: Array, u: Array) -> Array:
    dx, du = c.x - x, c.u - u
    return np.concatenate([*(np.concatenate(pair) for pair in zip(dx[:-1], du, strict=True)), dx[-1]])


@pytest.mark.few(5)
@pytest.mark.parametrize("fixed_end", [False, True])
@pytest.mark.parametrize("route", ROUTES)
def test_the_step_is_that_of_the_qp_with_m(route: str, fixed_end: bool) -> None:
    """Every route, from random plans, with active hard and soft rows: against OSQP, and one linear system."""
    soft = not fixed_end and route != "OSQP"
    controller, problem = built(route, soft=soft, fixed_end=fixed_end), classify(pendulum(soft, fixed_end))
    blocks, active = (M, 0 * M_F if fixed_end else M_F), 0
    for seed in range(4):
        c = controller.copy()
        drawn(c, seed)
        x, u = c.x.copy(), c.u.copy()
        reference = NumpyStep(problem, x, u, blocks)
        c.step(X0)
        assert c.status in (Status.OK, Status.INFEASIBLE), c.diagnose()
        if c.status != Status.OK:
            continue
        found = step_taken(c, x, u)
        rough = 1e-4 if route == "OSQP" else 1e-7
        np.testing.assert_allclose(found, reference.by_osqp(), rtol=0, atol=max(rough, 1e-6))
        if route != "OSQP":
            np.testing.assert_allclose(found, reference.on_active_set(c), rtol=0, atol=1e-8)
        active += int(np.count_nonzero(c.mu_u) + np.count_nonzero(c.mu) + np.count_nonzero(c.mu_x))
    assert active > 0


@pytest.mark.few(2)
@pytest.mark.parametrize("route", ["dense", "riccati", "interior"])
def test_single_precision(route: str) -> None:
    exact, rounded = built(route).copy(), built(route, "single").copy()
    for c in (exact, rounded):
        drawn(c, 3)
        c.step(X0)
        assert c.status == Status.OK
    np.testing.assert_allclose(rounded.x, exact.x, atol=2e-4)
    np.testing.assert_allclose(rounded.u, exact.u, atol=2e-4)


@pytest.mark.parametrize("route", ["dense", "riccati", "interior"])
def test_solve_converges_and_kkt_agrees_with_numpy(route: str) -> None:
    """The residuals of the generated code are those that NumPy recomputes, before and after solve()."""
    c = built(route).copy()
    drawn(c, 1)
    problem = classify(pendulum())
    c.step(X0)
    for _ in range(2):
        names = ("x", "u", "lam", "mu_x", "mu_u", "mu", "mu_N", "eta")
        point = Point(**{name: np.array(getattr(c, name)) for name in names})
        expected, found = kkt_residuals(problem, point, node_data(problem, x0=X0), TWO_STEPS), c.kkt()
        for part in ("stationarity", "equality", "inequality", "complementarity"):
            assert getattr(found, part) == pytest.approx(getattr(expected, part), rel=1e-6, abs=1e-12)
        solution = c.solve(X0, tol=1e-9, max_iterations=300)
    assert solution.status == Status.OK
    assert expected.worst < 1e-7


def test_steepest_descent() -> None:
    """The same QP with the identity in place of M."""
    c = build(pendulum(), options(EconomicGaussNewton(np.eye(3), np.eye(2)), "riccati"), "test").copy()
    drawn(c, 2)
    x, u = c.x.copy(), c.u.copy()
    reference = NumpyStep(classify(pendulum()), x, u, (np.eye(3), np.eye(2)))
    c.step(X0)
    assert c.status == Status.OK
    np.testing.assert_allclose(step_taken(c, x, u), reference.on_active_set(c), atol=1e-9)


def test_no_second_derivatives_and_no_operations() -> None:
    files = generate(pendulum(), options(EconomicGaussNewton(M, M_F), "riccati"))
    text = re.sub(r"(sha256|package) \w+", "", files["pendulum.c"])
    assert "d2" not in text.replace("d2 h_i", "")
    assert "path_exact" not in text
    c = built("riccati")
    operations = c.description.report.operations
    assert operations["hessian"].total == operations["path_hessian"].total == 0
    np.testing.assert_array_equal(np.tril(c.copy().view("hessian.Q")[0]), 0 * M)
    d = c.copy()
    d.prepare()
    np.testing.assert_array_equal(np.tril(d.view("hessian.Q")[0]), np.tril(M))
    np.testing.assert_array_equal(np.tril(d.view("hessian.Q_N")), np.tril(M_F))
    assert d.view("hessian.Q").shape[0] == 1


# Free x_0, accumulators, coupled rows ---------------------------------------------------------------------------------


def orbit(hessian: Any) -> Controller:
    """A periodic problem with a counted state, a free start with its own cost, and a soft coupled row."""
    ocp = OCP("orbit", T=1.0, N=5)
    q, w, work, u = ocp.state("q"), ocp.state("w"), ocp.state("work"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) + u, work: u})
    ocp.stage_cost(1 - ca.cos(q) + 0.1 * w**2 + 0.2 * u**2, integrate=True)
    ocp.accumulator(work)
    ocp.free_initial(q, w)
    ocp.start_least_squares(ca.vertcat(q, q * w), weight=[3.0, 1.0], reference=[0.5, 0.1])
    ocp.boundary(0, ocp.at_start(w) - ocp.at_end(w), 0)
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-np.inf, work, 0.1, at="end", soft=(1.0, 0.0))
    ocp.terminal_cost(q**2)
    return build(ocp, options(hessian, "dense"), "test")


def test_with_free_components_accumulators_and_coupled_rows() -> None:
    """The optimum does not depend on the Hessian."""
    c = orbit(EconomicGaussNewton(np.diag([1.0, 0.5, 0.0, 0.5]), np.diag([2.0, 0.0, 0.0])))
    solution = c.copy().solve([0.4, 0, 0], tol=1e-8, max_iterations=300)
    expected = orbit(EconomicGaussNewton(np.eye(4), np.eye(3))).copy().solve([0.4, 0, 0], tol=1e-8, max_iterations=1000)
    assert (solution.status, expected.status) == (Status.OK, Status.OK)
    np.testing.assert_allclose(solution.x, expected.x, atol=1e-6)
    np.testing.assert_allclose(solution.u, expected.u, atol=1e-6)


# Cyclic states --------------------------------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("route", ["dense", "riccati", "interior"])
def test_a_cyclic_state_has_zero_rows(route: str) -> None:
    """Driving, whose first state grows for ever: the side step is reached, and no factorisation fails."""
    t = tuning(driving)
    assert not np.any(t.M[0])
    more = dataclasses.replace(options(t.hessian(), route), integrator=ExplicitRungeKutta(steps=driving.STEPS))
    c = build(driving.build_ocp(intervals=30), more, "test").copy()
    c.x[...], c.u[...] = t.x_s, t.u_s
    x = t.x_s - np.array([0.0, 1.0, 0.0, 0.0, 0.0])
    for _ in range(60):
        u = c.step(x)
        assert c.status == Status.OK
        x = c.integrate(x, u, driving.SAMPLING)
    np.testing.assert_allclose(x[1], 0.0, atol=0.02)
    np.testing.assert_allclose(x[2], driving.SPEED, atol=0.05)
    assert not c.stats.stale_hessian


# Equations at the end ------------------------------------------------------------------------------------------------


@functools.cache
def tuning(example: Any) -> Tuning:
    """M of an example; it does not depend on the number of intervals."""
    found: Tuning = example.tuned()
    return found


def refinements(c: Controller, t: Tuning, x: Array, dt: float) -> list[int]:
    """Refinements of the QP in 40 samples from x, with the steady state as first plan; no QP iterations in the last."""
    c.x[...], c.u[...] = t.x_s, t.u_s
    found = []
    for _ in range(40):
        u = c.step(x)
        assert c.status == Status.OK
        x = c.integrate(x, u, dt)
        found.append(int(c.view("qp.refinements")))
    assert c.stats.qp_iterations == 0
    return found


@pytest.mark.few(1)
@pytest.mark.parametrize("start", [0.0, 1.0])
def test_equations_at_the_end_cost_no_refinement_loops(start: float) -> None:
    """They are members of the working set at every sample, also when steps vanish at the steady state.

    For driving they are the only rows, and equations of a Schur complement; the evaporation process has a state at its
    bound at all nodes besides, so that rows have weights, and one correction removes their error.
    """
    t = tuning(evaporation)
    c = build(
        evaporation.build_ocp(60), evaporation_options(condensing=NoCondensing(), qp=RiccatiActiveSet()), "test"
    ).copy()
    assert max(refinements(c, t, t.x_s + np.array([0.0, start]), 1.0)[20:]) <= 2
    t, ocp = tuning(driving), driving.build_ocp(intervals=30)
    ocp.subject_to(t.x_s[1:], ocp.x[1:], t.x_s[1:], at="end", name="steady")
    hessian = EconomicGaussNewton(t.M)
    chosen = dataclasses.replace(options(hessian, "riccati"), integrator=ExplicitRungeKutta(steps=driving.STEPS))
    c = build(ocp, chosen, "test").copy()
    far = np.array([0, 0.05 * start, 0.1 * start, 0, 0])
    assert max(refinements(c, t, t.x_s + far, driving.SAMPLING)[20:]) == 0


# Corollary 9 ----------------------------------------------------------------------------------------------------------


def test_first_step_equals_that_of_the_exact_hessian() -> None:
    """[Z20] Corollary 9: from the steady state, the QP with M and the one with H on the steady active set."""
    at = tuning(evaporation)
    c = build(evaporation.build_ocp(30), evaporation_options(algorithm=PURE), "test").copy()
    c.x[...], c.u[...] = at.x_s, at.u_s
    x, u = c.x.copy(), c.u.copy()
    c.step(at.x_s + np.array([0.0, 0.5]))
    assert c.status == Status.OK
    assert np.count_nonzero(c.mu_x[1:30, 0]) == 29
    N, n = 30, 4
    H, E, e = np.zeros((N * n + 2, N * n + 2)), [np.eye(2, N * n + 2)], [np.array([0.0, 0.5])]
    for k in range(N):
        H[k * n : (k + 1) * n, k * n : (k + 1) * n] = at.H
        row = np.zeros((2, N * n + 2))
        row[:, k * n : (k + 1) * n], row[:, (k + 1) * n : (k + 1) * n + 2] = -np.hstack([at.A, at.B]), np.eye(2)
        E.append(row)
        e.append(np.zeros(2))
    held = np.zeros((N + 1, N * n + 2))
    held[range(N), [n * k for k in range(1, N + 1)]] = 1.0
    held[N, -1] = 1.0
    E, e = np.vstack([*E, held]), np.concatenate([*e, np.zeros(N + 1)])
    K = np.block([[H, E.T], [E, np.zeros((len(E), len(E)))]])
    gradient = np.concatenate(
        [*([np.concatenate([(np.eye(2) - at.A).T @ at.lam_s, -at.B.T @ at.lam_s])] * N), np.zeros(2)]
    )
    exact = np.linalg.lstsq(K, np.concatenate([-gradient, e]), rcond=None)[0][: N * n + 2]
    found = step_taken(c, x, u)
    assert np.abs(found - exact).max() <= 1e-6 * np.abs(exact).max()
    assert not np.allclose(at.M, at.H)


def evaporation_options(with_steady_state: bool = True, **more: Any) -> Options:
    t = tuning(evaporation)
    given = (t.x_s, t.u_s) if with_steady_state else None
    return Options(ExplicitRungeKutta(steps=1), EconomicGaussNewton(t.M, None, given), **more)


# Data to which M does not belong --------------------------------------------------------------------------------------


def test_stale_data_are_flagged_until_they_return() -> None:
    c = built("riccati").copy()

    def stale() -> bool:
        c.step(X0)
        return c.stats.stale_hessian

    assert not stale()
    assert "constant Hessian" not in c.diagnose() + str(c.stats)
    c.set_parameter("p", 1.6, node=3)
    assert stale()
    assert "M belongs to other" in str(c.stats)
    assert "not at their declared values: p" in c.diagnose()
    c.set_parameter("p", 1.5)
    assert not stale()
    c.set_parameter("goal", -1.0)  # the second derivative of cos(q - goal) depends on it
    assert stale()
    c.set_parameter("goal", 0.2)
    c.set_bounds("effort", -0.8, 0.95)
    assert stale()
    assert "not at their declared values: effort" in c.diagnose()
    c.set_bounds("effort", -0.8, 0.9)
    assert not stale()
    c.set_bounds("rate", -0.3, 0.6 + 1e-12, node=5)
    assert stale()
    c.copy().reset()
    assert stale(), "reset keeps settings, and so their effect"
    c.set_bounds("rate", -0.3, 0.6)
    c.set_soft("rate", (0.6, 0.1))
    assert stale()
    assert "not at their declared values: the penalty of rate" in c.diagnose()
    c.set_soft("rate", (0.5, 0.1))
    assert not stale()


@pytest.mark.parametrize("online", [Online(), Online(bounds="node"), Online(bounds="node", parameter="shared")])
def test_with_a_steady_state_only_active_bounds_are_tied(online: Online) -> None:
    c = build(evaporation.build_ocp(10), evaporation_options(online=online), "test").copy()
    x_s = tuning(evaporation).x_s

    def stale(name: str, low: float, high: float, declared: tuple[float, float]) -> bool:
        c.set_bounds(name, low, high)
        c.prepare()
        found = c.stats.stale_hessian
        c.set_bounds(name, *declared)
        c.prepare()
        assert not c.stats.stale_hessian
        return found

    assert not stale("P2", 45, 70, (40, 80)), "inactive, and the steady state is inside"
    assert stale("P2", 50, 80, (40, 80)), "the steady state is cut off"
    assert stale("P100", 0, 190, (0, 400))
    assert stale("X2", 24, np.inf, (25, np.inf)), "active"
    assert not stale("X2", 25, 90, (25, np.inf))
    assert stale("P2_end", 50, 50, (x_s[1], x_s[1]))


def test_weights_and_fixed_data() -> None:
    """Weights of added least squares; without setters there is no flag."""
    ocp = pendulum()
    ocp.least_squares(ocp.u, weight=0.5, names=["u_y"])
    c = build(ocp, options(EconomicGaussNewton(M, M_F), "dense"), "test").copy()
    c.set_reference([1.0])
    c.prepare()
    assert not c.stats.stale_hessian, "references may change"
    c.set_weight([0.25])
    c.prepare()
    assert c.stats.stale_hessian
    fixed = options(
        EconomicGaussNewton(M, M_F), "dense", online=Online("fixed", "fixed", "fixed", "fixed", soft="fixed")
    )
    text = generate(ocp, fixed)
    assert "stale" not in text["pendulum.c"] + text["pendulum.h"]
    assert not build(ocp, fixed, "test").stats.stale_hessian


def test_the_report_says_to_what_m_belongs() -> None:
    (note,) = (c for c in built("riccati").description.report.choices if c.startswith("hessian"))
    assert note.startswith(
        "hessian: economic_gauss_newton; M belongs to the declared parameters p, goal, bounds of all"
    )
    choices = build(evaporation.build_ocp(10), evaporation_options(), "test").description.report.choices
    assert any("declared bounds of P2_end, X2, X2_end" in c for c in choices)


# Refusals -------------------------------------------------------------------------------------------------------------

EYE2, EYE3 = np.eye(2), np.eye(3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: EconomicGaussNewton([[1, 2], [0, 1]]), "M: .*expected a symmetric matrix of finite numbers"),
        (lambda: EconomicGaussNewton([[1, np.nan], [np.nan, 1]]), "M: .*finite"),
        (lambda: EconomicGaussNewton("many"), "M: 'many'"),
        (lambda: EconomicGaussNewton([1.0, 2.0]), "M: .*matrix"),
        (lambda: EconomicGaussNewton([[1, 2, 3], [2, 1, 1]]), "M: .*matrix"),
        (lambda: EconomicGaussNewton([[True]]), "M: .*matrix"),
        (lambda: EconomicGaussNewton([[1, 2], [2, 1]]), "M: smallest eigenvalue -1 .*positive semidefinite"),
        (lambda: EconomicGaussNewton([[1, 0], [0, -1]]), "M: entry 1 of the diagonal is -1"),
        (lambda: EconomicGaussNewton(EYE3, [[1, 2], [2, 1]]), "M_f: smallest eigenvalue -1"),
        (lambda: EconomicGaussNewton(EYE3, EYE2, 3.0), "steady_state: 3.0; expected a pair"),  # type: ignore[arg-type]
        (lambda: EconomicGaussNewton(EYE3, EYE2, ([0, np.inf], [0])), "steady_state: .*finite"),
    ],
)
def test_what_is_no_hessian(make: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        make()


@pytest.mark.parametrize(
    ("hessian", "message"),
    [
        (EconomicGaussNewton(), r"M: None; expected the Hessian of pendulum, shape \(3, 3\)"),
        (EconomicGaussNewton(EYE2, EYE2), r"M: shape \(2, 2\); expected \(3, 3\), order \(x, u\)"),
        (EconomicGaussNewton(EYE3, EYE3), r"M_f: shape \(3, 3\); expected \(2, 2\)"),
        (EconomicGaussNewton(EYE3), "M_f: None, but no equations fix the terminal state"),
        (EconomicGaussNewton(np.diag([1, 1, 0]), EYE2), "block of the controls: entry 0 of the diagonal is 0"),
        (EconomicGaussNewton(EYE3, EYE2, ([0], [0])), r"x_s: shape \(1,\); expected \(2,\)"),
        (EconomicGaussNewton(EYE3, EYE2, ([0, 0], [2])), "row 'u' has the value 2 there; expected -1 .. 1"),
    ],
)
def test_what_does_not_fit_the_problem(hessian: EconomicGaussNewton, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        generate(pendulum(), Options(hessian=hessian))


def test_intervals_must_be_equal() -> None:
    with pytest.raises(OptionError, match="M belongs to one interval length and clashes with the non-uniform grid"):
        generate(pendulum(intervals=[0.1, 0.2]), Options(hessian=EconomicGaussNewton(EYE3, EYE2)))


def test_options_are_values() -> None:
    """Arrays and lists give equal, hashable options; asymmetry of rounding is removed; --set reads the repr."""
    skew = M.copy()
    skew[0, 1] += 1e-14
    a, b = EconomicGaussNewton(M, M_F, (X0, [0.0])), EconomicGaussNewton(M.tolist(), M_F.tolist(), (X0.tolist(), [0.0]))
    assert a == b
    assert hash(a) == hash(b)
    given = np.asarray(EconomicGaussNewton(skew).M)
    assert np.array_equal(given, given.T)
    assert re.match(r"EconomicGaussNewton\(M=\(\(0.9, 0.2", repr(a))


def test_from_the_command_line() -> None:
    """--set takes the matrices as Python literals."""
    settings = [
        ("hessian", "economic_gauss_newton"),
        ("hessian.M", "[[1, 0], [0, 2.5]]"),
        ("hessian.M_f", "[[3]]"),
        ("hessian.steady_state", "([0.5], [1])"),
    ]
    made = apply_settings(Options(), settings).hessian
    assert made == EconomicGaussNewton([[1, 0], [0, 2.5]], [[3]], ([0.5], [1]))
    with pytest.raises(OptionError, match=r"M: .*matrix.*--set hessian.M="):
        apply_settings(Options(), [("hessian", "economic_gauss_newton"), ("hessian.M", "eye")])


@pytest.mark.parametrize("route", ["dense", "riccati", "interior"])
def test_recovers_from_bad_numbers(route: str) -> None:
    """A measured NaN, a plan with NaN, and a jump: safe controls, then the optimum again."""
    c, reference = built(route).copy(), built(route).copy()
    for _ in range(30):
        expected = reference.step(X0)
    u = c.step([np.nan, 0.0])
    assert (c.status, bool(np.all(np.abs(u) <= 1))) == (Status.NOT_FINITE, True)
    c.x[2] = np.nan
    assert np.all(np.isfinite(c.step(X0)))
    for _ in range(30):
        u = c.step(X0)
    assert c.status == Status.OK
    np.testing.assert_allclose(u, expected, atol=1e-6)
