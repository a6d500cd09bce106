"""Exact Hessian: blocks against CasADi, regularisation against eigenvalues of NumPy, solutions against IPOPT."""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import cstr
from nmpc_codegen import (
    OCP,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    ForwardOverAdjoint,
    FullCondensing,
    Mirror,
    OptionError,
    Options,
    Project,
    Status,
    Symmetric,
    build,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import solve_reference
from nmpc_codegen.oracle.trajectory import Point, node_data
from tests.components.exact_hessian_oracle import blocks, regularized, regularized_reduced
from verification.models import couple, pendulum_of_everything
from verification.routes import PURE

Array = np.ndarray
#: Least eigenvalue of a regularised Hessian, relative to the largest one.
FLOOR = 1e-8
MIRROR, PROJECT = Mirror("stage"), Project("stage")


def everything(free: bool = True) -> OCP:
    """Least-squares, general, integrated and terminal costs, path, terminal and coupled rows, a parameter."""
    ocp = pendulum_of_everything("everything", [0.1, 0.3, 0.2])
    ocp.terminal_least_squares(ocp.x[0] * ocp.x[1], weight=[3.0])
    if free:
        ocp.free_initial("w")
    couple(ocp)
    return ocp


@functools.cache
def _built(scheme: Any, regularization: Any, unroll: str, free: bool = True) -> Controller:
    hessian = ExactHessian(regularization, scheme)
    return build(
        everything(free),
        Options(ExplicitRungeKutta(unroll=unroll), hessian, condensing=FullCondensing(), algorithm=PURE),
        "test",
    )


def drawn(controller: Controller, seed: int = 3) -> None:
    """A random plan with random multipliers."""
    random = np.random.default_rng(seed)
    for name in ("x", "u", "lam", "mult"):
        view = controller.view(name)
        view[...] = random.uniform(-1, 1, view.shape)


def point(c: Controller) -> Point:
    return Point(**{name: np.array(getattr(c, name)) for name in Point.__dataclass_fields__})


def mirrored(L: Array) -> Array:
    """A symmetric matrix from its lower triangle."""
    return np.tril(L) + np.tril(L, -1).T


@pytest.mark.parametrize(
    ("scheme", "unroll"),
    [*((Symmetric(), n) for n in ("all", "none")), (ForwardOverAdjoint(), "all")],
    ids=str,
)
def test_blocks(scheme: Any, unroll: str) -> None:
    """Every term of the Lagrangian, nonuniform grid, parameters per node."""
    problem = classify(everything())
    c = _built(scheme, None, unroll).copy()
    p = np.linspace(0.8, 1.6, 4)
    for k in range(4):
        c.set_parameter("m", p[k], node=k)
    drawn(c)
    data = node_data(problem, p=p[:, None])
    path, last = blocks(problem, point(c), data)
    c.prepare()
    for got, exact in zip((*c.view("hessian.Q"), c.view("hessian.Q_N")), (*path, last), strict=True):
        np.testing.assert_allclose(mirrored(np.array(got)), exact, rtol=1e-12, atol=1e-13)


def test_adjoint_pass_after_reset() -> None:
    """lam_N = q_N, lam_k = q_k + A_k' lam_{k+1} if all multipliers are zero, and 0 for the free component of x_0."""
    c = _built(Symmetric(), None, "auto").copy()
    c.reset()
    c.x[...] = np.random.default_rng(1).uniform(-1, 1, c.x.shape)
    c.prepare()
    lam = np.array(c.view("terminal.g"))
    np.testing.assert_allclose(c.lam[3], lam, rtol=1e-15)
    for k in (2, 1, 0):
        lam = np.array(c.view("node.g"))[k, :2] + np.array(c.view("node.S"))[k, :, :2].T @ lam
        np.testing.assert_allclose(c.lam[k], lam * [1, 0] if k == 0 else lam, rtol=1e-13)
    given = c.copy()
    given.lam[2] = 1.0
    kept = given.lam.copy()
    given.prepare()
    np.testing.assert_array_equal(given.lam, kept)


@pytest.mark.parametrize("regularization", [PROJECT, MIRROR], ids=repr)
def test_stage_level(regularization: Any) -> None:
    """Blocks of random plans; positive definite blocks keep their values."""
    problem = classify(everything())
    c = _built(Symmetric(), regularization, "auto").copy()
    changed = 0
    for seed in range(20):
        drawn(c, seed)
        path, last = blocks(problem, point(c), node_data(problem))
        c.prepare()
        for got, H in zip((*c.view("hessian.Q"), c.view("hessian.Q_N")), (*path, last), strict=True):
            expected = regularized(H, regularization.mirrors, FLOOR)
            scale = np.abs(H).max()
            np.testing.assert_allclose(mirrored(np.array(got)), expected, atol=1e-13 * scale, rtol=0)
            changed += np.abs(expected - H).max() > 1e-9 * scale
    assert 20 < changed < 80


# Regularisation of given matrices ------------------------------------------------------------------------------------


def quadratic(n: int, N: int = 1) -> OCP:
    """N unconstrained minimisations of c'u + 1/2 u'H u in n controls; H and c are parameters of every node."""
    ocp = OCP(f"quadratic{n}", N=N)
    x, u = ocp.state("x"), ocp.control("u", size=n)
    H, c = ocp.parameter("H", size=n * n, value=np.eye(n).ravel()), ocp.parameter("c", size=n)
    ocp.dynamics({x: x}, discrete=True)
    M = ca.reshape(H, n, n)
    ocp.stage_cost(ca.dot(c, u) + ca.dot(u, M @ u) / 2)
    return ocp


@functools.cache
def _quadratic(n: int, N: int, regularization: Any) -> Controller:
    hessian = ExactHessian(regularization)
    return build(quadratic(n, N), Options(hessian=hessian, condensing=FullCondensing(), algorithm=PURE), "test")


def spectrum(random: np.random.Generator, n: int, kind: int) -> Array:
    """A symmetric matrix: random, of low rank, with equal and with tiny eigenvalues, diagonal, positive, zero."""
    V = np.linalg.qr(random.standard_normal((n, n)))[0]
    scale = 10.0 ** random.integers(-6, 7)
    if kind == 6:
        return np.zeros((n, n))
    values = {
        0: random.standard_normal(n),
        1: random.standard_normal(n) * (np.arange(n) < (n + 1) // 2),
        2: random.choice([-1.0, 1.0], n),
        3: random.standard_normal(n) * 10.0 ** random.integers(-12, 1, n),
        4: np.sort(random.standard_normal(n)),
        5: random.uniform(0.1, 1, n),
    }[kind]
    H = np.diag(values) if kind == 4 else V * values @ V.T
    return np.asarray(scale * (H + H.T) / 2)


@pytest.mark.parametrize(("n", "mirror"), [(n, i % 2 == 0) for i, n in enumerate((1, 2, 3, 4, 5, 8, 13))])
def test_given_blocks(n: int, mirror: bool) -> None:
    """Eleven nodes, more than the number of lanes; the blocks of x and of node N are zero."""
    floor, N = FLOOR, 11
    c = _quadratic(n, N, (Mirror if mirror else Project)("stage")).copy()
    random = np.random.default_rng(n)
    for _ in range(5):
        H = [spectrum(random, n, kind) for kind in random.permutation([0, 1, 2, 3, 4, 5, 6, 0, 3, 5, 1])]
        for k in range(N):
            c.set_parameter("H", H[k].ravel(), node=k)
        c.prepare()
        Q, largest = np.array(c.view("hessian.Q")), max(np.abs(h).max() for h in H)
        for k in range(N):
            expected = regularized(H[k], mirror, floor, largest)
            got = mirrored(Q[k])[1:, 1:]
            np.testing.assert_allclose(
                got, expected, rtol=0, atol=4e-14 * max(np.abs(H[k]).max(), np.abs(expected).max())
            )
            assert np.linalg.eigvalsh(got).min() > 0
            assert Q[k, 0, 0] > 0


@pytest.mark.parametrize(("n", "mirror"), [(n, i % 2 == 1) for i, n in enumerate((1, 2, 3, 7, 16, 25))])
def test_reduced_level(n: int, mirror: bool) -> None:
    """The condensed Hessian is H: the step is -f(H)^{-1} c, where f is the identity if H is positive definite."""
    floor = FLOOR
    c = _quadratic(n, 1, (Mirror if mirror else Project)()).copy()
    random = np.random.default_rng(n)
    for kind in (0, 2, 3, 4, 5, 0, 5):
        H, g = spectrum(random, n, kind), random.standard_normal(n)
        c.set_parameter("H", H.ravel())
        c.set_parameter("c", g)
        c.reset()
        values = np.linalg.eigvalsh(H)
        if abs(values).min() < 1e-10 * abs(values).max():
            continue  # zero up to rounding: left to the solver
        c.step([0.0])
        assert c.status == Status.OK
        M = regularized_reduced(H, mirror, floor) if values[0] < 0 else H
        expected, rough = -np.linalg.solve(M, g), 1e-9 if mirror else 1e-6
        np.testing.assert_allclose(c.u[0], expected, rtol=rough, atol=rough * np.abs(expected).max())


def test_without_regularisation_an_indefinite_qp_is_refused() -> None:
    c = _quadratic(2, 1, None).copy()
    c.set_parameter("H", [1.0, 2.0, 2.0, 1.0])
    c.step([0.0])
    assert c.status == Status.NUMERICAL_FAILURE
    c.set_parameter("H", [2.0, 1.0, 1.0, 1.0])
    c.set_parameter("c", [1.0, 1.0])
    c.step([0.0])
    assert c.status == Status.OK
    np.testing.assert_allclose(c.u[0], [0.0, -1.0], atol=1e-14)


# Solutions -----------------------------------------------------------------------------------------------------------


def assert_optimal(problem: Problem, controller: Controller, x0: Any, **solver: Any) -> int:
    """solve() and IPOPT agree; returns the iterations."""
    ours = controller.solve(x0, tol=1e-9, **solver)
    assert ours.status == Status.OK
    ref = solve_reference(problem, x0=x0)
    if abs(ours.cost - ref.cost) > 1e-8 * max(1, abs(ref.cost)):
        ref = solve_reference(problem, x0=x0, x_guess=ours.x, u_guess=ours.u)
    assert ref.success
    scale = np.maximum(1, np.abs(ref.u).max(axis=0))
    assert np.max(np.abs(ours.u - ref.u) / scale) <= 1e-6
    assert abs(ours.cost - ref.cost) <= 1e-8 * max(1, abs(ref.cost))
    return int(ours.iterations)


@pytest.mark.parametrize(
    ("free", "regularization"),
    [(True, Project()), (True, Mirror(level="stage")), (False, Mirror()), (False, Project(level="stage"))],
    ids=repr,
)
def test_solutions_equal_those_of_ipopt(free: bool, regularization: Any) -> None:
    """All kinds of costs and rows at once."""
    controller = _built(Symmetric(), regularization, "auto", free).copy()
    assert_optimal(classify(everything(free)), controller, [0.7, -0.2])


def test_quadratic_convergence() -> None:
    """CSTR from the initial iterate: 8 iterations to 1e-12 with quadratic convergence."""
    controller = build(
        cstr.build_ocp(), Options(hessian=ExactHessian(), condensing=FullCondensing(), algorithm=PURE), "test"
    )
    controller.x[...] = cstr.START
    residuals = [entry.kkt.relative for entry in controller.solve(cstr.START, tol=1e-12).log]
    assert len(residuals) <= 8
    order = np.log(residuals[-2] / residuals[-3]) / np.log(residuals[-3] / residuals[-4])
    assert order > 1.6


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ExactHessian("flip"), "regularization: 'flip'; expected one of project, mirror, none"),
        (lambda: ExactHessian(sweep="two"), "sweep: 'two'; expected one of symmetric, forward_over_adjoint"),
        (lambda: Mirror(level="node"), "Mirror.level: 'node'; expected one of reduced, stage"),
    ],
)
def test_bad_options(make: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        make()


def test_words_of_the_command_line() -> None:
    assert ExactHessian("mirror", "forward_over_adjoint") == ExactHessian(Mirror(), ForwardOverAdjoint())  # type: ignore[arg-type]
    assert ExactHessian("none").regularization is None  # type: ignore[arg-type]
