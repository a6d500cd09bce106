"""Sensitivities of every tableau in the compiled C: against CasADi, against the NumPy twin, and convergence orders."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from examples.crane import build_ocp
from nmpc_codegen import Controller, ExplicitRungeKutta, Options, build
from nmpc_codegen.components.integrators import TABLEAUS
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Tableau, interval_map
from tests.oracles.runge_kutta import MODELS, ORDERS, SCHEMES, integrate

UNROLL = ("all", "step", "none")
CRANE = MODELS["crane"]


def _controller(tableau: str, steps: int, unroll: str) -> Controller:
    integrator = ExplicitRungeKutta(TABLEAUS[tableau], steps=steps, unroll=unroll)
    return build(build_ocp(), Options(integrator=integrator), profile="test")


def _linearised(controller: Controller, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, ...]]:
    """(x_k, u_k, x_next, S) of every node of a random plan."""
    controller.x[:] = rng.uniform(-1.5, 1.5, controller.x.shape)
    controller.u[:] = rng.uniform(-1, 1, controller.u.shape)
    controller.prepare()
    S, b = np.asarray(controller.view("node.S")), np.asarray(controller.view("node.b"))
    for k in range(len(controller.u)):
        yield controller.x[k], controller.u[k], b[k] + controller.x[k + 1], S[k]


def _normwise(value: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(value - expected) / np.linalg.norm(expected))


def sensitivity_errors() -> Iterator[tuple[str, float, int]]:
    """(case, largest normwise error of S and x_next over random nodes, number of nodes)."""
    problem = classify(build_ocp())
    dt = problem.dt[0]
    for scheme, (a, b) in SCHEMES.items():
        for unroll in UNROLL:
            steps = 2
            Phi = interval_map(problem, Tableau(np.array(a, dtype=float), np.array(b, dtype=float), steps))
            x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 1)
            x_next = Phi(x, u, ca.SX(0, 1), dt)[0]
            casadi = ca.Function("casadi", [x, u], [x_next, ca.jacobian(x_next, ca.vertcat(x, u))])
            errors = []
            for xk, uk, value, S in _linearised(_controller(scheme, steps, unroll), np.random.default_rng(7)):
                exact, S_exact = (np.array(v) for v in casadi(xk, uk))
                twin, S_twin = integrate(CRANE, scheme, steps, dt, xk, uk, np.zeros(0))
                errors += [_normwise(S, S_exact), _normwise(S, S_twin)]
                errors += [_normwise(value, exact.ravel()), _normwise(value, twin)]
            yield f"{scheme}, {unroll}", max(errors), len(errors) // 4


def order_slopes() -> Iterator[tuple[str, float, int]]:
    """(tableau, |fitted slope - order|, number of step sizes) of crane_integrate over 0.5 s."""
    x0, u, T = np.array([0.5, 0.3, 0.7, -0.4]), np.array([0.6]), 0.5
    exact = solve_ivp(lambda t, x: CRANE.f(x, u, np.zeros(0)), (0, T), x0, method="DOP853", rtol=1e-13, atol=1e-14)
    for scheme in SCHEMES:
        counts = np.array([16, 32, 64, 128]) if ORDERS[scheme] > 2 else np.array([128, 256, 512, 1024])
        controller = _controller(scheme, 1, "all")
        errors = []
        for n in counts:
            x = x0
            for _ in range(n):
                x = controller.integrate(x, u, T / n)
            errors.append(np.linalg.norm(x - exact.y[:, -1]))
        slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
        yield scheme, abs(float(slope) - ORDERS[scheme]), len(counts)
