"""The reduced level of the exact Hessian on stages: random indefinite QPs against NumPy, and convergence of solve()."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import cstr, quadrotor
from nmpc_codegen import (
    OCP,
    Controller,
    DenseActiveSet,
    ExactHessian,
    FullCondensing,
    Mirror,
    NoCondensing,
    Options,
    Project,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    Status,
    build,
    simulate,
)
from nmpc_codegen.compiler import generate, model_of
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import solve_reference
from nmpc_codegen.runtime.build import WARNINGS
from verification.c_harness import shared_library
from verification.models import couple, pendulum_of_everything
from verification.oracles.stage_qp import Point, Shape, StageQP, recover_lam, residuals, rows_of
from verification.qp.stage_solvers import (
    DYNAMICS,
    FEASIBILITY,
    ROWS,
    STATIONARITY,
    StageSolver,
    build_all,
    solver_options,
)
from verification.routes import PURE, ROUTES

Array = np.ndarray

ON_STAGES = ("riccati", "interior")
DENSE = (FullCondensing(), DenseActiveSet())
SHAPES = {
    Shape(1, 1, 1): Project(),
    Shape(3, 2, 5, states=1, coupled=1): Mirror(),
    Shape(2, 1, 5, free=1): Project(),
    Shape(4, 2, 3, path=1, end=1, free=2): Mirror(),
}


def options_of(route: tuple[Any, Any], regularization: Any) -> Options:
    return dataclasses.replace(solver_options(*route), hessian=ExactHessian(regularization))


def symmetric(L: Array) -> Array:
    """Symmetric matrices from their lower triangles."""
    return np.asarray(np.tril(L) + np.tril(L, -1).swapaxes(-1, -2))


def reduced_hessian(S: Array, Q: Array, Q_N: Array, free: int) -> Array:
    """d2 cost / d(u_0, .., u_{N-1}, the first ``free`` components of x_0)^2 on x_{k+1} = S_k (x_k, u_k)."""
    N, nx, nz = S.shape
    nu = nz - nx
    n = N * nu + free
    G, H = np.zeros((nx, n)), np.zeros((n, n))
    G[:free, N * nu :] = np.eye(free)
    for k in range(N):
        Z = np.zeros((nz, n))
        Z[:nx], Z[nx:, k * nu : (k + 1) * nu] = G, np.eye(nu)
        H += Z.T @ Q[k] @ Z
        G = S[k] @ Z
    return np.asarray(H + G.T @ Q_N @ G)


def random_nonconvex_qp(shape: Shape, seed: int, curvature: float) -> StageQP:
    """Convex blocks plus ``curvature`` times random symmetric ones; rows that a point inside the bounds satisfies. A
    control is fixed for every third seed."""
    rng = np.random.default_rng(seed)
    nx, nu, N = shape.nx, shape.nu, shape.N
    nz, rows = nx + nu, rows_of(shape)
    S = rng.normal(size=(N, nx, nz))
    S[:, :, :nx] *= 1.05 / np.maximum(1e-3, np.abs(np.linalg.eigvals(S[:, :, :nx])).max(axis=1))[:, None, None]

    def blocks(count: int, n: int) -> Array:
        J, M = rng.normal(size=(2, count, n, n))
        return J @ J.swapaxes(1, 2) / n + 0.1 * np.eye(n) + curvature * (M + M.swapaxes(1, 2)) / 2

    C, C0 = rng.normal(size=(len(rows), nz)), rng.normal(size=(len(rows), nx))
    C0[rows.kind != 2] = 0.0
    C[rows.node == N, nx:] = 0.0
    C[rows.kind == 0] = np.eye(nz)[rows.index[rows.kind == 0]]
    b, du = rng.normal(size=(N, nx)), rng.normal(size=(N, nu))
    lower_u, upper_u = du - rng.exponential(size=(N, nu)), du + rng.exponential(size=(N, nu))
    if seed % 3 == 0:
        lower_u[-1, 0] = upper_u[-1, 0] = du[-1, 0]
    dx = np.zeros((N + 1, nx))
    dx[0] = rng.normal(size=nx)
    for k in range(N):
        dx[k + 1] = S[k] @ np.concatenate([dx[k], du[k]]) + b[k]
    z = np.hstack([dx, np.vstack([du, np.zeros((1, nu))])])
    value = np.einsum("mi,mi->m", C, z[rows.node]) + C0 @ dx[0]
    ng = len(rows)
    return StageQP(
        shape=shape, rows=rows, S=S, b=b, Q=blocks(N, nz), Q_N=blocks(1, nx)[0], g=rng.normal(size=(N, nz)),
        g_N=rng.normal(size=nx), C=C, C0=C0, c=np.zeros(ng), lower=value - 2 * rng.exponential(size=ng),
        upper=value + 2 * rng.exponential(size=ng), lower_u=lower_u, upper_u=upper_u, x=np.zeros((N + 1, nx)),
        u=np.zeros((N, nu)), dx0=dx[0], optimum=None, proof=None, unit_x=np.ones(nx), unit_u=np.ones(nu), growth=1.05,
        seed=seed,
    )  # fmt: skip


def solved_hessian(solver: StageSolver) -> Array:
    """The reduced Hessian of the QP that was solved, without the padding of the last block."""
    memory, shape = solver.memory, solver.shape
    stages = memory["block"] if "block" in memory.dtype.names else None
    S = memory["node"]["S"] if stages is None else stages["S"]
    Q = symmetric(memory["hessian"]["Q"] if stages is None else stages["Q"])
    H = reduced_hessian(S, Q, symmetric(memory["hessian"]["Q_N"]), shape.free)
    n = shape.N * shape.nu
    keep = np.r_[0:n, len(H) - shape.free : len(H)]
    assert np.linalg.norm(np.delete(H[keep], keep, axis=1)) == 0.0
    return H[np.ix_(keep, keep)]


def shifted(qp: StageQP, shift: Array) -> StageQP:
    """The QP with an addition to the diagonal entries of the controls, then of the free components of x_0."""
    nx, nu, N, free = qp.shape.nx, qp.shape.nu, qp.shape.N, qp.shape.free
    Q = qp.Q.copy()
    for k in range(N):
        Q[k] += np.diag(np.concatenate([np.zeros(nx), shift[k * nu : (k + 1) * nu]]))
    Q[0, range(free), range(free)] += shift[N * nu :]
    return dataclasses.replace(qp, Q=Q)


def held(solver: StageSolver) -> Array:
    """Weights of a a' that the solver has added for rows of its predicted working set."""
    if not len(solver.point.mult):
        return np.zeros(0)
    return np.asarray(solver.memory["riccati"]["held"])


def held_hessian(qp: StageQP, solver: StageSolver) -> Array:
    """What they add to the reduced Hessian."""
    alone = with_held_rows(dataclasses.replace(qp, Q=np.zeros_like(qp.Q), Q_N=np.zeros_like(qp.Q_N)), solver)
    return reduced_hessian(qp.S, alone.Q, alone.Q_N, qp.shape.free)


def with_held_rows(qp: StageQP, solver: StageSolver) -> StageQP:
    """The QP with the terms of held rows."""
    Q, Q_N = qp.Q.copy(), qp.Q_N.copy()
    for m, weight in enumerate(held(solver)):
        k, a = qp.rows.node[m], qp.C[m]
        if k < qp.shape.N:
            Q[k] += weight * np.outer(a, a)
        else:
            Q_N += weight * np.outer(a[: qp.shape.nx], a[: qp.shape.nx])
    return dataclasses.replace(qp, Q=Q, Q_N=Q_N)


def assert_convex_and_optimal(qp: StageQP, solver: StageSolver) -> Array:
    """The solved QP is qp plus a nonnegative diagonal, which is returned; it is convex, the point its optimum."""
    before, after = reduced_hessian(qp.S, qp.Q, qp.Q_N, qp.shape.free), solved_hessian(solver)
    scale, change = np.abs(before).max(), after - before
    shift = np.diag(change)
    rounding = 1e-12 * max(scale, np.abs(after).max())
    assert np.abs(change - np.diag(shift)).max() <= rounding
    assert shift.min() >= -rounding
    assert np.linalg.eigvalsh(after + held_hessian(qp, solver))[0] > 0
    p = solver.point
    if len(p.mult):  # those of the QP with the held rows
        p = dataclasses.replace(p, mult=np.array(solver.memory["qp"]["mult"][-len(p.mult) :]))
    assert all(np.all(np.isfinite(a)) for a in (p.dx, p.du, p.mult_u, p.mult))
    r = residuals(with_held_rows(shifted(qp, shift), solver), p)
    in_blocks = "block" in solver.memory.dtype.names  # there, held rows lack the free response of their block
    assert r.stationarity <= STATIONARITY or (in_blocks and held(solver).any())
    assert r.dynamics <= DYNAMICS
    assert r.feasibility <= FEASIBILITY
    assert r.rows <= ROWS
    return np.where(np.abs(shift) <= rounding, 0.0, shift)


def far_from_singular(qp: StageQP) -> tuple[bool, bool]:
    """(clearly positive definite, clearly indefinite)."""
    values = np.linalg.eigvalsh(reduced_hessian(qp.S, qp.Q, qp.Q_N, qp.shape.free))
    return bool(values[0] > 1e-6 * values[-1]), bool(values[0] < -1e-6 * np.abs(values).max())


#: Two combinations of solvers in turn for every shape.
IN_TURN = {s: [ON_STAGES[(i + step) % len(ON_STAGES)] for step in (0, 1)] for i, s in enumerate(SHAPES)}


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_random_qps(shape: Shape) -> None:
    """Cold, and from the working set of the same QP; equal to the dense solver if no regularisation is needed."""
    regularization, names = SHAPES[shape], IN_TURN[shape]
    every = {name: options_of(ROUTES[name], regularization) for name in names}
    every["dense"] = options_of(DENSE, regularization)
    build_all((shape, options) for options in every.values())
    seen = {"convex": 0, "indefinite": 0}

    @settings(max_examples=40, deadline=None, database=None)
    @given(seed=st.integers(0, 2**20), curvature=st.sampled_from([0.0, 0.1, 0.3, 1.0, 3.0]))
    def check(seed: int, curvature: float) -> None:
        qp = random_nonconvex_qp(shape, seed, curvature)
        convex, indefinite = far_from_singular(qp)
        seen["convex"] += convex
        seen["indefinite"] += indefinite
        dense = StageSolver(shape, every["dense"])
        assert dense.solve(qp) == Status.OK
        for name in names:
            solver = StageSolver(shape, every[name])
            for _ in range(2):
                assert solver.solve(qp) == Status.OK
                shift = assert_convex_and_optimal(qp, solver)
                assert not (convex and shift.any())
                assert not (indefinite and not shift.any() and not held(solver).any())
                if convex:
                    size = max(1.0, np.abs(dense.point.dx).max())
                    np.testing.assert_allclose(solver.point.du, dense.point.du, rtol=0, atol=1e-8 * size)
                    np.testing.assert_allclose(solver.point.dx, dense.point.dx, rtol=0, atol=1e-8 * size)

    check()
    assert min(seen.values()) > 0


def test_the_check_sees_a_wrong_shift() -> None:
    """The same for a QP whose Hessian was changed after the preparation phase."""
    shape = Shape(3, 2, 5, states=1, coupled=1)
    solver = StageSolver(shape, options_of(ROUTES["riccati"], SHAPES[shape]))
    qp = random_nonconvex_qp(shape, 5, 1.0)
    assert solver.solve(qp) == Status.OK
    assert_convex_and_optimal(qp, solver)
    solver.memory["hessian"]["Q"][1, 4, 4] += 0.1
    with pytest.raises(AssertionError):
        assert_convex_and_optimal(qp, solver)


@pytest.mark.parametrize("regularization", [Project(), Mirror()], ids=repr)
def test_size_of_the_shift(regularization: Any) -> None:
    """No bounds: H + shift D. The shift is 1 to 4 times 9/8 (Mirror: 2) of the one at which the Hessian is singular."""
    shape = Shape(3, 2, 5, controls=0)
    solver = StageSolver(shape, options_of(ROUTES["riccati"], regularization))
    factor = 2.0 if regularization.mirrors else 1.125
    for seed in range(30):
        qp = random_nonconvex_qp(shape, seed, 1.0)
        qp = dataclasses.replace(qp, lower_u=np.full((5, 2), -np.inf), upper_u=np.full((5, 2), np.inf))
        H = reduced_hessian(qp.S, qp.Q, qp.Q_N, 0)
        next_diagonal = np.abs(np.array([np.diag(Q)[:3] for Q in (*qp.Q[1:], qp.Q_N)]))
        own = np.abs(np.array([np.diag(Q)[3:] for Q in qp.Q]))
        unit = np.tile((own + np.einsum("kij,ki->kj", qp.S[:, :, 3:] ** 2, next_diagonal)).max(axis=0), 5)
        lowest = np.linalg.eigvalsh(H / np.sqrt(np.outer(unit, unit)))[0]
        solver.reset()
        assert solver.solve(qp) == Status.OK
        shift = np.diag(solved_hessian(solver) - H) / unit
        if lowest < -1e-6:
            np.testing.assert_allclose(shift, shift[0], rtol=1e-9)
            assert -lowest * factor * (1 - 1e-9) <= shift[0] <= -4 * lowest * factor * (1 + 1e-6)
        else:
            assert np.abs(shift).max() <= 1e-9


# Whole problems -------------------------------------------------------------------------------------------------------

#: Every combination of solvers and both regularisations, but not all pairs.
PAIRS = (
    ("riccati", Project()),
    ("interior", Mirror()),
)


def quadratic(n: int, bounds: tuple[float, float] | None = None) -> OCP:
    """min c'u + 1/2 u'H u over one interval; H and c are parameters."""
    ocp = OCP(f"quadratic{n}", N=1)
    x, u = ocp.state("x"), ocp.control("u", size=n)
    H, c = ocp.parameter("H", size=n * n, value=np.eye(n).ravel()), ocp.parameter("c", size=n)
    ocp.dynamics({x: x + ca.sum1(u)}, discrete=True)
    ocp.stage_cost(ca.dot(c, u) + ca.dot(u, ca.reshape(H, n, n) @ u) / 2)
    if bounds is not None:
        ocp.subject_to(bounds[0], u, bounds[1])
    return ocp


@functools.cache
def _built(ocp: Any, route: str, regularization: Any, *args: Any) -> Controller:
    condensing, qp = ROUTES[route]
    options = Options(hessian=ExactHessian(regularization), condensing=condensing, qp=qp, algorithm=PURE)
    if ocp is quadrotor.build_ocp:
        options = dataclasses.replace(options, integrator=quadrotor.options().integrator)
    return build(ocp(*args), options, "test")


@pytest.mark.parametrize(("route", "regularization"), PAIRS, ids=str)
def test_controls_at_their_bounds_keep_the_step(route: str, regularization: Any) -> None:
    """H is indefinite, but positive definite along the controls that are free at the local minimiser: one step leads
    there, and nothing is added for these controls."""
    c = _built(quadratic, route, regularization, 3, (-1.0, 1.0)).copy()
    H = np.array([[1.0, 2.0, 0.3], [2.0, 1.0, 0.1], [0.3, 0.1, 2.0]])
    c.set_parameter("H", H.ravel())
    c.set_parameter("c", [-4.0, 0.2, 0.1])
    solution = c.solve([0.0], tol=1e-12)
    assert solution.status == Status.OK
    u = c.u[0].copy()
    free = np.abs(u) < 1
    assert 0 < free.sum() < 3
    exact = -np.linalg.solve(H[np.ix_(free, free)], (np.array([-4.0, 0.2, 0.1]) + H[:, ~free] @ u[~free])[free])
    np.testing.assert_allclose(u[free], exact, atol=1e-12)
    gradient = np.array([-4.0, 0.2, 0.1]) + H @ u
    np.testing.assert_allclose(c.mu_u[0], -gradient, atol=1e-12)
    assert np.all(c.mu_u[0][~free] * u[~free] > 0)
    c.u[0, free] += 0.3 * (u[free] < 0.5)  # one step brings it back
    c.step([0.0])
    np.testing.assert_allclose(c.u[0], u, atol=1e-12)
    change = np.diag(symmetric(np.array(c.view("hessian.Q"))[0])[1:, 1:] - H)
    assert np.all(change[free] == 0.0)
    assert np.any(change[~free] > 0.0)


@pytest.mark.parametrize(("route", "regularization"), PAIRS[1:], ids=str)
def test_cstr_converges_quadratically(route: str, regularization: Any) -> None:
    """From the initial iterate to 1e-10 in at most 8 iterations (Gauss-Newton: 13), with quadratic convergence."""
    controller = _built(cstr.build_ocp, route, regularization)
    found = []
    for n in range(1, 9):
        c = controller.copy()
        c.x[...] = cstr.START
        solution = c.solve(cstr.START, tol=1e-10, max_iterations=n)
        found.append(max(solution.kkt.stationarity, solution.kkt.equality))
        if solution.status == Status.OK:
            break
    assert solution.status == Status.OK
    steps = np.diff(np.log(found[-4:]))
    assert np.max(steps[1:] / steps[:-1]) > 1.6  # the last residual may be a rounding error


@pytest.mark.parametrize(("route", "regularization"), PAIRS[::2], ids=str)
def test_quadrotor_converges(route: str, regularization: Any) -> None:
    """From (1, 1, 1) in at most 30 iterations (Gauss-Newton: about 600) to IPOPT's cost; the same again after reset."""
    c = _built(quadrotor.build_ocp, route, regularization).copy()
    x0 = np.array([1.0, 1.0, 1.0, *np.zeros(9)])
    solution = c.solve(x0, tol=1e-10, max_iterations=30)
    assert solution.status == Status.OK
    assert solution.cost == pytest.approx(181.337254, abs=1e-6)  # test_examples.py computes it by IPOPT
    u = c.u.copy()
    c.reset()
    again = c.solve(x0, tol=1e-10, max_iterations=30)
    assert again.iterations == solution.iterations
    np.testing.assert_array_equal(c.u, u)


def test_closed_loop() -> None:
    """Real-time iterations through the nonconvex region: every QP is solved, and the quadrotor comes to rest."""
    c = _built(quadrotor.build_ocp, "riccati", Project()).copy()
    log = simulate(c, [1.0, 1.0, 1.0, *np.zeros(9)], steps=80, dt=quadrotor.SAMPLING)
    assert all(status == Status.OK for status in log.status)
    assert np.abs(log.x[-1]).max() <= 1e-2


def curved(free: bool, coupled: bool) -> OCP:
    """All kinds of costs and rows that solvers on stages support, and strongly nonlinear dynamics."""
    ocp = pendulum_of_everything("curved", [0.1, 0.3, 0.2, 0.2, 0.4])
    ocp.subject_to(-1.5, ocp.u, 1.5)
    if free:
        ocp.free_initial("w")
    if coupled:
        couple(ocp)
    return ocp


@pytest.mark.parametrize(
    ("route", "regularization", "free", "coupled"),
    [
        ("riccati", Project(), True, False),
        ("riccati", Project(), False, True),
        ("interior", Project(), True, False),
        ("interior", Mirror(level="stage"), False, True),
    ],
    ids=str,
)
def test_solutions_equal_those_of_ipopt(route: str, regularization: Any, free: bool, coupled: bool) -> None:
    """Both levels, with x_0 given and partly free."""
    problem = classify(curved(free, coupled))
    c = _built(curved, route, regularization, free, coupled).copy()
    ours = c.solve([0.7, -0.2], tol=1e-9)
    assert ours.status == Status.OK
    ref = solve_reference(problem, x0=[0.7, -0.2], x_guess=ours.x, u_guess=ours.u)
    assert ref.success
    np.testing.assert_allclose(ours.u, ref.u, atol=1e-6)
    assert ours.cost == pytest.approx(ref.cost, rel=1e-8)


@pytest.mark.parametrize("route", ON_STAGES)
def test_without_regularisation_an_indefinite_qp_is_refused(route: str) -> None:
    c = _built(quadratic, route, None, 2).copy()
    c.set_parameter("H", [1.0, 2.0, 2.0, 1.0])
    c.set_parameter("c", [1.0, -0.5])
    c.step([0.0])
    refused = Status.ITERATION_LIMIT if route == "interior" else Status.NUMERICAL_FAILURE
    assert c.status == refused
    c.set_parameter("H", [2.0, 1.0, 1.0, 1.0])
    c.set_parameter("c", [1.0, 1.0])
    c.step([0.0])
    assert c.status == Status.OK
    np.testing.assert_allclose(c.u[0], [0.0, -1.0], atol=1e-14)


def linear_in_the_control() -> OCP:
    """Q_uu is structurally zero; the curvature of the state is a parameter."""
    ocp = OCP("linear", N=3)
    x, u = ocp.state("x"), ocp.control("u")
    a = ocp.parameter("a", value=-1.0)
    ocp.dynamics({x: x + u}, discrete=True)
    ocp.stage_cost(a * x**2 / 2 + 0.1 * u)
    ocp.terminal_cost(a * x**2 / 2)
    ocp.subject_to(-1, u, 1)
    return ocp


def test_shifts_of_the_sample_before_are_forgotten() -> None:
    """Also in entries that no kernel writes; the multipliers of a convex sample reveal it."""
    c = _built(linear_in_the_control, "riccati", Project()).copy()
    c.step([0.3])
    assert c.status == Status.OK
    assert np.all(np.array(c.view("hessian.Q"))[:, 1, 1] > 0)
    c.set_parameter("a", 1.0)
    c.step([0.3])
    assert c.status == Status.OK
    np.testing.assert_array_equal(np.array(c.view("hessian.Q")), np.tile(np.diag([1.0, 0.0]), (3, 1, 1)))


def test_single_precision() -> None:
    """No warning; the step solves the system with the shifted Hessian."""
    options = Options(
        hessian=ExactHessian(Mirror()),
        condensing=NoCondensing(),
        qp=RiccatiActiveSet(),
        precision="single",
        algorithm=PURE,
    )
    shared_library(generate(quadratic(3), options), "quadratic3.c", WARNINGS)
    c = build(quadratic(3), options, "test").copy()
    H, g = np.array([[1.0, 2.0, 0.3], [2.0, 1.0, 0.1], [0.3, 0.1, 2.0]]), np.array([1.0, -0.5, 0.25])
    c.set_parameter("H", H.ravel())
    c.set_parameter("c", g)
    c.step([0.0])
    assert c.status == Status.OK
    M = symmetric(np.array(c.view("hessian.Q"), dtype=float)[0])[1:, 1:]
    assert np.linalg.eigvalsh(M)[0] >= 0.99
    np.testing.assert_allclose(c.u[0], -np.linalg.solve(M, g), rtol=1e-4)


def test_warnings_of_the_interior_point_route() -> None:
    options = Options(hessian=ExactHessian(), condensing=NoCondensing(), qp=RiccatiInteriorPoint())
    shared_library(generate(curved(True, False), options), "curved.c", WARNINGS)


def test_qp_none_looks_at_stages() -> None:
    """The combinations that keep stages are candidates for an exact Hessian, too."""
    chosen = model_of(classify(cstr.build_ocp()), Options(hessian=ExactHessian()))
    assert chosen.options.condensing == NoCondensing()
    assert chosen.options.qp == RiccatiActiveSet()
    assert any("full + dense_active_set" in why for why in chosen.choices.reasons)
    few = model_of(classify(quadratic(3)), Options(hessian=ExactHessian()))
    assert isinstance(few.options.condensing, FullCondensing | NoCondensing)


def test_multipliers_do_not_see_the_shift() -> None:
    """lam of the original QP equals that of the shifted one."""
    shape = Shape(3, 2, 5, states=1, coupled=1)
    solver = StageSolver(shape, options_of(ROUTES["riccati"], SHAPES[shape]))
    qp = random_nonconvex_qp(shape, 11, 1.0)
    assert solver.solve(qp) == Status.OK
    shift = assert_convex_and_optimal(qp, solver)
    assert shift.any()
    p: Point = solver.point
    np.testing.assert_array_equal(recover_lam(qp, p), recover_lam(shifted(qp, shift), p))
