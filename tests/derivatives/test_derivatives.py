"""Gradient, impulse response matrix and sensitivities against CasADi on the whole simulation and complex steps."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options, derivatives
from nmpc_codegen.derivatives.toolbox import SWEEPS
from verification.adjoint.oracle import Model, complex_step, normwise
from verification.models import discrete_map, pendulum_of_everything, problem_of

EXACT = tuple(m for m in derivatives.GRADIENTS if m != "finite_differences")
TOLERANCE = 1e-12


def modelled(ocp: OCP, z: Any, cost: Any, terminal: Any, steps: int, rate: Any = 0.0) -> Model:
    """The model of an OCP whose costs are given again as expressions."""
    f = ca.vertcat(*(ocp.derivatives[i] for i in range(int(ocp.x.numel()))))
    dt = (1.0,) * ocp.N if ocp.dt is None else ocp.dt
    return Model(ocp.x, ocp.u, ocp.p, f, cost, terminal, z, tuple(dt), steps, rate)


def compare(tools: derivatives.Derivatives, model: Model, x0: np.ndarray, u: np.ndarray, p: np.ndarray) -> None:
    """All exact methods to rounding, finite differences to the root of it."""
    single = tools.precision == "single"
    exact, rough = (1e-4, 3e-2) if single else (TOLERANCE, 1e-4)
    expected = model.derivatives(x0, u, p)
    run = tools.simulate(x0, u)
    assert normwise(run.x, expected["x"]) <= exact
    assert normwise(run.z, expected["z"]) <= exact
    assert run.cost == pytest.approx(expected["J"], rel=exact, abs=exact)
    for method in derivatives.GRADIENTS:
        limit = rough if method == "finite_differences" else exact
        assert normwise(tools.gradient(x0, u, method), expected["gradient"]) <= limit, method
        assert normwise(tools.impulse_response(x0, u, method), expected["impulse_response"]) <= limit, method
    S = tools.responses(x0, u)
    assert normwise(S, expected["responses"]) <= exact
    lam = np.random.default_rng(7).normal(size=(tools.N, tools.nx))
    for sweep in SWEEPS:
        assert normwise(tools.hessians(x0, u, lam, sweep), model.hessians(x0, u, p, lam)) <= exact, sweep
    A, B = tools.sensitivities(x0, u)
    for k in range(tools.N):
        assert normwise(B[k], expected["responses"][k, k + 1]) <= exact
        if k + 1 < tools.N:
            assert normwise(A[k + 1] @ B[k], expected["responses"][k, k + 2]) <= exact


def data(tools: derivatives.Derivatives, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random initial state and controls."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=tools.nx), 0.7 * rng.normal(size=(tools.N, tools.nu))


# Models that are drawn -----------------------------------------------------------------------------------------------


@st.composite
def drawn(draw: st.DrawFn) -> tuple[OCP, Model, str]:
    """A random smooth model: a stable linear part and some nonlinear terms, costs of any kind, outputs with D."""
    nx, nu, N = draw(st.integers(1, 3)), draw(st.integers(1, 2)), draw(st.integers(1, 5))
    discrete, single = draw(st.booleans()), draw(st.integers(0, 3)) == 0
    steps = 0 if discrete else draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    grid = {"N": N} if discrete else {"intervals": list(rng.uniform(0.1, 0.4, N))}
    ocp = OCP("drawn", **grid)
    x, u, p = ocp.state("x", size=nx), ocp.control("u", size=nu), ocp.parameter("p", size=2, value=[0.4, -0.3])
    A, B = 0.5 * rng.normal(size=(nx, nx)), rng.normal(size=(nx, nu))
    i, j = rng.integers(nx), rng.integers(nu)
    f = A @ x + B @ u
    f[i] = f[i] + p[0] * ca.sin(x[rng.integers(nx)]) * u[j] + 0.2 * ca.tanh(x[i] ** 2)
    ocp.dynamics(f, discrete=discrete)
    y, weight = ca.vertcat(x * ca.cos(x[0]), u), rng.uniform(0.1, 2, nx + nu)
    ocp.least_squares(
        y, weight=weight, reference=rng.normal(size=nx + nu) if (referenced := rng.random() < 0.5) else None
    )
    cost = 0.5 * ca.dot(y, weight * y)
    if referenced:
        reference = ocp.residuals[-1].reference
        cost = 0.5 * ca.dot(y - reference, weight * (y - reference))
    terminal, rate = ca.SX(0), ca.SX(0)
    if draw(st.booleans()):
        terminal = ca.sumsqr(x) ** 2 + p[1] * x[0]
        ocp.terminal_cost(terminal)
    if not discrete and draw(st.booleans()):
        rate = ca.exp(-ca.sumsqr(x)) * u[0] + p[0] * x[0]
        ocp.stage_cost(rate, integrate=True)
    z = ca.vertcat(x[0] * u[0] + p[1], *([ca.atan(x[nx - 1])] if draw(st.booleans()) else []))
    return ocp, modelled(ocp, z, cost, terminal, steps, rate), "single" if single else "double"


@settings(max_examples=10, deadline=None)
@given(drawn(), st.integers(0, 10**6))
def test_random_models(case: tuple[OCP, Model, str], seed: int) -> None:
    """All methods, discrete and continuous models, N = 1, nu = 1, parameters of every node, both precisions."""
    ocp, model, precision = case
    integrator = ExplicitRungeKutta(RK4, steps=model.steps) if model.steps else None
    options = Options(integrator=integrator, precision=precision)
    tools = derivatives.build(ocp, model.z, options, profile="test", second_order=True)
    tools.p[...] = np.random.default_rng(seed).normal(size=tools.p.shape)
    compare(tools, model, *data(tools, seed), np.array(tools.p, float))


# Chosen models -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unroll", ["all", "none"])
@pytest.mark.parametrize("name", ["crane", "reactor", "tanks"])
def test_forms_of_the_code(name: str, unroll: str) -> None:
    """Straight-line programs, and loops over everything."""
    ocp = problem_of(name, uniform=False)
    z = ca.vertcat(ocp.x[0] ** 2, ocp.x[1] * ocp.u[0])
    options = Options(ExplicitRungeKutta(RK4, steps=3, unroll=unroll))
    tools = derivatives.build(ocp, z, options, profile="test", second_order=True)
    cost = 0.5 * ca.sumsqr(ca.vertcat(ocp.x, ocp.u))
    x0 = np.array([c.value[0] for c in (s.signal for s in ocp.states) for _ in range(len(c.elements))])
    _, u = data(tools, 3)
    x0, u = (x0 if name != "crane" else x0 + 0.3), (u if name != "tanks" else 1 + 0.1 * u)
    compare(tools, modelled(ocp, z, cost, ca.SX(0), 3), x0, u, np.array(getattr(tools, "p", np.zeros((4, 0)))))


def test_costs_of_every_kind() -> None:
    """Least squares with references, general, integrated and terminal costs; rows are not part of J."""
    ocp = pendulum_of_everything("everything", [0.2, 0.3, 0.45])
    (q, w), u, m = (ocp.x[0], ocp.x[1]), ocp.u, ocp.p
    z = ca.vertcat(q * u, w)
    tools = derivatives.build(ocp, z, Options(ExplicitRungeKutta(steps=2)), profile="test", second_order=True)
    dt = np.array([0.2, 0.3, 0.45])
    x0, controls = data(tools, 5)
    model = modelled(ocp, z, ca.SX(0), q**4 + m * w**2, 2, ca.exp(q) * w**2 + m * u * q)
    expected = model.derivatives(x0, controls, np.full((4, 1), 1.3))

    def node_costs(controls: np.ndarray) -> Any:
        """The costs at the nodes, of which the general one is scaled with dt."""
        U = ca.SX.sym("U", 3)
        x, total = ca.SX(ca.DM(x0)), 0
        for k in range(3):
            y = ca.vertcat(x[0] * x[1], U[k]) - ca.DM([0.4, 0.1])
            total = total + 0.5 * ca.dot(ca.DM([2.0, 0.3]) * y, y) + dt[k] * ca.cos(x[1]) * U[k]
            x, _ = model.interval(x, U[k], ca.DM(1.3), dt[k])
        return [np.array(v) for v in ca.Function("J", [U], [total, ca.jacobian(total, U)])(controls.reshape(-1))]

    value, gradient = node_costs(controls)
    assert tools.simulate(x0, controls).cost == pytest.approx(expected["J"] + value.item(), rel=1e-13)
    for method in EXACT:
        assert (
            normwise(tools.gradient(x0, controls, method), expected["gradient"] + gradient.reshape(3, 1)) <= TOLERANCE
        )


def test_complex_steps() -> None:
    """A route without CasADi: the pendulum in NumPy."""
    ocp = OCP("pendulum", T=2.0, N=8)
    q, w, u = ocp.state("q"), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) - 0.1 * w + u})
    ocp.least_squares(ca.vertcat(q, w, u), weight=[1.0, 0.2, 0.1])
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[3.0, 1.0])
    tools = derivatives.build(
        ocp, ca.vertcat(q * w, ca.sin(q) + u), Options(ExplicitRungeKutta(steps=2)), profile="verify"
    )
    x0 = np.array([1.0, -0.4])
    controls = np.random.default_rng(1).normal(size=(8, 1))

    def rhs(x: np.ndarray, a: complex) -> np.ndarray:
        return np.array([x[1], -np.sin(x[0]) - 0.1 * x[1] + a])

    def simulated(controls: np.ndarray) -> tuple[complex, np.ndarray]:
        x, J, z = x0.astype(complex), 0.0 + 0.0j, []
        for a in controls[:, 0]:
            J += 0.5 * (x[0] ** 2 + 0.2 * x[1] ** 2 + 0.1 * a**2)
            z += [x[0] * x[1], np.sin(x[0]) + a]
            for _ in range(2):
                h = 0.125
                k1 = rhs(x, a)
                k2 = rhs(x + h / 2 * k1, a)
                k3 = rhs(x + h / 2 * k2, a)
                k4 = rhs(x + h * k3, a)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return J + 0.5 * (3 * x[0] ** 2 + x[1] ** 2), np.array(z)

    gradient = complex_step(lambda v: np.array([simulated(v)[0]]), controls).reshape(8, 1)
    Xi = complex_step(lambda v: simulated(v)[1], controls)
    for method in EXACT:
        assert normwise(tools.gradient(x0, controls, method), gradient) <= TOLERANCE
        assert normwise(tools.impulse_response(x0, controls, method), Xi) <= TOLERANCE


def test_one_interval() -> None:
    """N = 1: the gradient is r_0 + B_0' q_1, the impulse response matrix is D_0."""
    ocp = OCP("one", T=0.5, N=1)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.least_squares(u, weight=2.0)
    ocp.terminal_least_squares(x, weight=3.0)
    tools = derivatives.build(ocp, x + 4 * u, profile="test")
    h = 0.5
    phi = 1 - h + h**2 / 2 - h**3 / 6 + h**4 / 24
    x1 = phi * 2.0 + (1 - phi) * 0.7
    for method in EXACT:
        np.testing.assert_allclose(tools.gradient([2.0], [[0.7]], method), [[1.4 + (1 - phi) * 3 * x1]], rtol=1e-14)
        np.testing.assert_array_equal(tools.impulse_response([2.0], [[0.7]], method), [[4.0]])


def test_step_of_finite_differences() -> None:
    """The error has a minimum between truncation, which grows with the step, and rounding, which falls."""
    ocp = discrete_map()
    tools = derivatives.build(ocp, profile="test")
    x0, u = data(tools, 2)
    exact = tools.gradient(x0, u)

    def error(step: float | None) -> float:
        return normwise(tools.gradient(x0, u, "finite_differences", step=step), exact)

    assert error(1e-3) == pytest.approx(10 * error(1e-4), rel=0.2)
    assert error(None) < 1e-6 < error(1e-3)
    assert error(1e-13) > error(None)


def test_rows_of_the_impulse_response() -> None:
    """Chosen rows in their order, also by name, once more and none at all."""
    ocp = problem_of("crane")
    z = ca.vertcat(ocp.x[0], ocp.x[2] * ocp.u)
    tools = derivatives.build(ocp, z, profile="test", output_names=["position", "load"])
    x0, u = data(tools, 4)
    full = tools.impulse_response(x0, u)
    for method in ("adjoint", "adjoint_matrices"):
        rows = [(2, "load"), (0, 1), (2, 0), (2, "load")]
        found = tools.impulse_response(x0, u, method, rows=rows)
        np.testing.assert_allclose(found, full[[5, 1, 4, 5]], rtol=0, atol=1e-14)
        assert tools.impulse_response(x0, u, method, rows=[]).shape == (0, 3)


def test_data_can_be_changed() -> None:
    """References, weights and parameters are read at every call."""
    ocp = discrete_map()
    ocp.terminal_least_squares(ocp.x, weight=np.array([[2.0, 0.5], [0.5, 1.0]]))
    tools = derivatives.build(ocp, profile="test")
    np.testing.assert_array_equal(tools.W_N, [2.0, 0.5, 0.5, 1.0])
    x0, u = data(tools, 6)
    tools.W[...], tools.W_N[...] = [1.0, 2.0, 3.0, 4.0], [1.0, 0.2, 0.2, 5.0]
    tools.yref[...] = np.arange(16.0).reshape(4, 4) / 10
    tools.yref_N[...] = [0.3, -0.3]
    tools.p[...] = np.linspace(0.5, 0.9, 5)[:, None]
    model = modelled(ocp, ca.SX(0, 1), ca.SX(0), ca.SX(0), 0)
    U, x, J = ca.SX.sym("U", 8), ca.SX(ca.DM(x0)), 0
    for k in range(4):
        uk = U[2 * k : 2 * k + 2]
        y = ca.vertcat(x, uk) - ca.DM(tools.yref[k])
        J = J + 0.5 * ca.dot(ca.DM(tools.W) * y, y)
        x, _ = model.interval(x, uk, ca.DM(tools.p[k]), 1.0)
    y = x - ca.DM(tools.yref_N)
    J = J + 0.5 * ca.bilin(ca.DM(tools.W_N.reshape(2, 2)), y, y)
    value, gradient = ca.Function("J", [U], [J, ca.jacobian(J, U)])(u.reshape(-1))
    assert tools.simulate(x0, u).cost == pytest.approx(float(value), rel=1e-14)
    for method in EXACT:
        assert normwise(tools.gradient(x0, u, method), np.array(gradient).reshape(4, 2)) <= TOLERANCE
