"""Cost, gradient and Gauss-Newton Hessian in C against hand-written residuals and the complex step."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, OptionError, Options
from nmpc_codegen.compiler import model_of
from nmpc_codegen.components.hessians import ExactHessian, GaussNewton
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.lowering.linearize import Model
from verification.c_harness import Package, Routines, module_of
from verification.oracles.runge_kutta import complex_step

Array = np.ndarray
TOLERANCE = 1e-13


@dataclass(frozen=True)
class Case:
    """``weight`` of y = (x_0^2 u, sin x_1 + p x_0, exp(u) - x_1), and of y_N = (x_0 x_1 p, x_1)."""

    diagonal: bool
    scaled: tuple[int, ...] = ()


CASES = {
    "diagonal": Case(True),
    "dense": Case(False),
    "diagonal, scaled": Case(True, (0, 2)),
    "dense, scaled": Case(False, (0, 1, 2)),
}

GRID = [0.1, 0.3, 0.2]
X, U, P = np.array([0.8, -0.5]), np.array([0.4]), np.array([1.7])
REFERENCE, REFERENCE_N = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.5])


def residual(z: Array) -> Array:
    return np.array([z[0] ** 2 * z[2], np.sin(z[1]) + P[0] * z[0], np.exp(z[2]) - z[1]])


def residual_N(x: Array) -> Array:
    return np.array([x[0] * x[1] * P[0], x[1]])


def weights(case: Case, seed: int = 0) -> tuple[Array, Array]:
    """Random positive definite weights, diagonal or dense."""
    random = np.random.default_rng(seed)
    found = []
    for n in (3, 2):
        M = random.uniform(-1, 1, (n, n))
        W = M @ M.T + np.eye(n)
        found.append(np.diag(np.diag(W)) if case.diagonal else W)
    return found[0], found[1]


def stated(case: Case) -> OCP:
    ocp = OCP("hessians", intervals=GRID)
    x, u, p = ocp.state("x", size=2), ocp.control("u"), ocp.parameter("p", value=1.7)
    ocp.dynamics(ca.vertcat(x[1], u))
    y = ca.vertcat(x[0] ** 2 * u, ca.sin(x[1]) + p * x[0], ca.exp(u) - x[1])
    W, W_N = weights(case)
    if case.scaled and len(case.scaled) < 3:
        for i in range(3):
            ocp.least_squares(y[i], weight=[W[i, i]], scale_with_dt=i in case.scaled)
    else:
        ocp.least_squares(y, weight=W, scale_with_dt=bool(case.scaled))
    ocp.terminal_least_squares(ca.vertcat(x[0] * x[1] * p, x[1]), weight=W_N)
    return ocp


@functools.cache
def linearized(name: str) -> Model:
    case = CASES[name]
    return model_of(classify(stated(case)), Options(hessian=GaussNewton()))


@functools.cache
def compiled(name: str) -> Routines:
    wanted = [f"{stage}_{what}" for stage in ("path", "terminal") for what in ("cost", "gradient", "hessian")]
    return Routines({r.name: r for r in linearized(name).routines if r.name in wanted})


def stored(W: Array, case: Case) -> Array:
    return np.diag(W) if case.diagonal else W


@pytest.mark.parametrize("dt", GRID)
@pytest.mark.parametrize("name", CASES)
def test_path(name: str, dt: float) -> None:
    """Run-time weights that differ from the declared ones, symmetric positive definite."""
    case, call = CASES[name], compiled(name)
    W, _ = weights(case, seed=7)
    weight = W.copy()
    weight[list(case.scaled)] *= dt
    z = np.concatenate([X, U])
    y, J = residual(z) - REFERENCE, complex_step(residual, z)
    arguments = (X, U, P, [dt])
    np.testing.assert_allclose(
        call("path_cost", *arguments, REFERENCE, stored(W, case))[0], [y @ weight @ y / 2], rtol=TOLERANCE
    )
    gradient = call("path_gradient", *arguments, REFERENCE, stored(W, case))[0]
    np.testing.assert_allclose(gradient, J.T @ weight @ y, rtol=TOLERANCE, atol=TOLERANCE)
    Q = call("path_hessian", *arguments, REFERENCE, stored(W, case))[0]
    expected = np.tril(J.T @ weight @ J)
    np.testing.assert_allclose(Q, expected, rtol=TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("name", CASES)
def test_terminal(name: str) -> None:
    """Terminal terms are never scaled."""
    case, call = CASES[name], compiled(name)
    _, W = weights(case, seed=8)
    y, J = residual_N(X) - REFERENCE_N, complex_step(residual_N, X)
    cost, gradient, Q = (
        call("terminal_cost", X, P, REFERENCE_N, stored(W, case))[0],
        call("terminal_gradient", X, P, REFERENCE_N, stored(W, case))[0],
        call("terminal_hessian", X, P, REFERENCE_N, stored(W, case))[0],
    )
    np.testing.assert_allclose(cost, [y @ W @ y / 2], rtol=TOLERANCE)
    np.testing.assert_allclose(gradient, J.T @ W @ y, rtol=TOLERANCE)
    np.testing.assert_allclose(Q, np.tril(J.T @ W @ J), rtol=TOLERANCE)


@pytest.mark.parametrize("name", CASES)
def test_the_gradient_is_that_of_the_cost(name: str) -> None:
    """Central differences of the compiled cost, with an error of order h^2."""
    case, call = CASES[name], compiled(name)
    W, _ = weights(case)
    z, h = np.concatenate([X, U]), 1e-5

    def cost(z: Array) -> float:
        return float(call("path_cost", z[:2], z[2:], P, [0.2], REFERENCE, stored(W, case))[0][0])

    differences = [(cost(z + h * e) - cost(z - h * e)) / (2 * h) for e in np.eye(3)]
    gradient = call("path_gradient", X, U, P, [0.2], REFERENCE, stored(W, case))[0]
    np.testing.assert_allclose(gradient, differences, rtol=1e-8, atol=1e-8)


def test_zero_pattern_of_the_hessian() -> None:
    """y_2 and y_1 couple x_1 with both others: the lower triangle is full, the upper one is never written."""
    kernel = next(r for r in linearized("diagonal").routines if r.name == "path_hessian")
    assert isinstance(kernel, Kernel)
    assert {divmod(e, 3) for _, e, _ in kernel.stores} == {(i, j) for i in range(3) for j in range(i + 1)}


# Which Hessian is constant -----------------------------------------------------------------------------------------


def linear(**more: object) -> Model:
    grid = {"T": 2.0, "N": 4} if not more.get("grid") else {"intervals": more["grid"]}
    ocp = OCP("linear", **grid)  # type: ignore[arg-type]
    x, u = ocp.state("x", size=2), ocp.control("u")
    p = ocp.parameter("p", value=2.0) if more.get("parameter") else 1.0
    ocp.dynamics(ca.vertcat(x[1], u))
    last = u + 0.1 * x[0] ** 2 if more.get("nonlinear") else p * u
    ocp.least_squares(ca.vertcat(x, last), weight=[1.0, 2.0, 3.0], scale_with_dt=bool(more.get("scaled")))
    return model_of(classify(ocp), Options())


@pytest.mark.parametrize(
    ("more", "constant"),
    [
        ({}, True),
        ({"scaled": True}, True),
        ({"scaled": True, "grid": [0.1, 0.2]}, False),
        ({"grid": [0.1, 0.2]}, True),
        ({"nonlinear": True}, False),
        ({"parameter": True}, False),
    ],
)
def test_a_constant_hessian_is_recognised(more: dict, constant: bool) -> None:
    """There is a single block only if no dependence on the point, the parameters or a varying dt exists."""
    assert linear(**more).choices.constant_hessian is constant


def test_a_constant_hessian_is_stored_once_and_used_at_every_node() -> None:
    """hessian() of a package: NQ blocks, each equal to J'W J of its node."""
    for scaled in (False, True):
        ocp = OCP("linear", intervals=[0.1, 0.2, 0.4])
        x, u = ocp.state("x"), ocp.control("u")
        ocp.dynamics({x: u - x})
        ocp.least_squares(ca.vertcat(x - u, u), weight=[3.0, 5.0], scale_with_dt=scaled)
        package = Package(module_of(ocp), ["hessian"])
        package.call("hessian")
        Q = package["hessian"]["Q"]
        expected = np.array([[3.0, 0.0], [-3.0, 8.0]])
        assert Q.shape == ((3, 2, 2) if scaled else (1, 2, 2))
        for block, dt in zip(Q, [0.1, 0.2, 0.4] if scaled else [1.0], strict=True):
            np.testing.assert_allclose(block, dt * expected, rtol=1e-15)


def test_general_costs_are_refused() -> None:
    ocp = stated(CASES["diagonal"])
    ocp.stage_cost(ca.sin(ocp.u))
    with pytest.raises(OptionError, match=r"uses general cost, which hessian GaussNewton\(\)"):
        model_of(classify(ocp), Options(hessian=GaussNewton()))
    assert model_of(classify(ocp), Options()).parts.hessian == ExactHessian()
