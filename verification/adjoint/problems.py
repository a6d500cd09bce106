"""The derivative benchmarks have three models: the discrete map (6.31), the Van de Vusse reactor (6.32), a heat rod.

Each is an OCP with outputs, a trajectory along which derivatives are taken, and the options of its integrator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from examples import adjoint_gradient
from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options
from verification.adjoint.oracle import Model

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Case:
    """A case is a problem with the point at which its derivatives are evaluated.

    ``model`` states the problem independently.
    """

    name: str
    ocp: OCP
    outputs: Any
    options: Options
    x0: Array
    u: Array
    p: Array
    model: Model


def _modelled(ocp: OCP, z: Any, cost: Any, terminal: Any, steps: int) -> Model:
    f = ca.vertcat(*(ocp.derivatives[i] for i in range(int(ocp.x.numel()))))
    dt = (1.0,) * ocp.N if ocp.dt is None else tuple(ocp.dt)
    return Model(ocp.x, ocp.u, ocp.p, f, cost, terminal, z, dt, steps)


def discrete_map(N: int) -> Case:
    """Return (6.31), stabilised, with Q = R = P = I."""
    ocp = adjoint_gradient.build_ocp(N)
    z = adjoint_gradient.output(ocp)
    x, u = adjoint_gradient.stabilised(N)
    cost, terminal = 0.5 * (z**2 + ca.sumsqr(ocp.u)), 0.5 * ca.sumsqr(ocp.x)
    k = np.arange(1.0, N + 2)[:, None]
    return Case("map (6.31)", ocp, z, Options(), x[0], u, k, _modelled(ocp, z, cost, terminal, 0))


# Van de Vusse reactor, time in hours ---------------------------------------------------------------------------------

SAMPLE = 72 / 3600  # h
STEPS = 4  # Runge-Kutta steps of a sample
REACTOR_START = np.array([0.0, 750.0, 85.0, 100.0])
REACTOR_WEIGHTS = ([0.1, 10.0], [10.0, 10.0])


def reactor_rates(x: Any, u: Any, exp: Any = ca.exp) -> list[Any]:
    """Return the derivatives per hour of (cA, cB, T, Tc) under u = (flow per volume [1/h], cooling [MJ/h])."""
    cA, cB, T, Tc = (x[i] for i in range(4))
    k1 = 1.287e12 * exp(-9758.3 / (T + 273.15))
    k2 = 9.042e6 * exp(-8560 / (T + 273.15))
    heat = -3.556e-4 * (k1 * (4.2 * cA - 11 * cB) - 41.85 * k2 * cA**2)
    return [
        -k1 * cA - k2 * cA**2 + (5100 - cA) * u[0],
        k1 * (cA - cB) - cB * u[0],
        heat + 30.8285 * (Tc - T) + (104.9 - T) * u[0],
        86.668 * (T - Tc) + 100 * u[1],
    ]


def steady_states(flows: Array, cooling: float) -> Array:
    """Return the states (flows, 4) of the reactor at rest; NaN where Newton's method fails.

    Newton's method starts at the result for the previous flow.
    """
    x, v = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    equations = {"x": x, "p": v, "g": ca.vertcat(*reactor_rates(x, v))}
    solver = ca.rootfinder("steady", "newton", equations, {"abstol": 1e-8, "max_iter": 100, "error_on_fail": False})
    guess, found = np.array([1000.0, 900.0, 105.0, 105.0 + cooling]), []
    for flow in flows[::-1]:
        state = np.array(solver(guess, [flow, cooling])).ravel()
        good = solver.stats()["success"]
        guess = state if good else guess
        found.append(state if good else np.full(4, np.nan))
    return np.array(found[::-1])


def chained(A: Array, B: Array) -> Array:
    """Return dx_n / du_0 for n = 1, ..., N: A_{n-1} ... A_1 B_0."""
    found = [B[0]]
    for k in range(1, len(A)):
        found.append(A[k] @ found[-1])
    return np.array(found)


def reactor_inputs(N: int, sample: float = SAMPLE) -> Array:
    """Return the steps of the thesis: flow 12, then 1 from 2/3 h on; cooling -3, then -1 MJ/h from 1/3 h on."""
    t = np.arange(N) * sample
    return np.column_stack([np.where(t < 2 / 3, 12.0, 1.0), np.where(t < 1 / 3, -3.0, -1.0)])


def reactor(N: int = 50, sample: float = SAMPLE, steps: int = STEPS, unroll: Any = "auto") -> Case:
    """Return the reactor over N samples.

    Z = (cB, T), least squares about (750, 90) with Q = diag(0.1, 10), R = 10 I.
    """
    ocp = OCP("reactor", T=N * sample, N=N)
    cA, cB = ocp.state("cA", unit="mol/m^3"), ocp.state("cB", unit="mol/m^3", initial=750.0)
    T, Tc = ocp.state("T", unit="degC", initial=85.0), ocp.state("Tc", unit="degC", initial=100.0)
    u1, u2 = ocp.control("u1", unit="1/h"), ocp.control("u2", unit="MJ/h")
    ocp.dynamics(ca.vertcat(*reactor_rates([cA, cB, T, Tc], [u1, u2])))
    z, y = ca.vertcat(cB, T), ca.vertcat(cB, T, u1, u2)
    weight, reference = np.concatenate(REACTOR_WEIGHTS), np.array([750.0, 90.0, 8.0, -3.0])
    ocp.least_squares(y, weight=weight, reference=reference)
    cost = 0.5 * ca.dot(y - reference, weight * (y - reference))
    options = Options(ExplicitRungeKutta(RK4, steps=steps, unroll=unroll))
    model = _modelled(ocp, z, cost, ca.SX(0), steps)
    p = np.zeros((N + 1, 0))
    return Case("Van de Vusse", ocp, z, options, REACTOR_START, reactor_inputs(N, sample), p, model)


# Heat rod ------------------------------------------------------------------------------------------------------------


def rod_step(nx: int) -> Array:
    """Return the matrix of one RK4 step of the rod without heat at rate 0.5 and sample 1, nx states."""
    hA = 0.5 * (np.diag(-2 * np.ones(nx)) + np.diag(np.ones(nx - 1), 1) + np.diag(np.ones(nx - 1), -1))
    return np.asarray(sum(np.linalg.matrix_power(hA, i) / math.factorial(i) for i in range(5)))


def rod_profile(nx: int) -> Array:
    """Return the temperatures of a cold rod with two warm spots."""
    place = np.arange(1, nx + 1) / (nx + 1)
    return np.exp(-(((place - 0.25) / 0.05) ** 2)) + 0.7 * np.exp(-(((place - 0.7) / 0.08) ** 2))


def rod(
    nx: int, N: int = 10, sample: float = 1.0, rate: float = 0.5, unroll: Any = "auto", heated: bool = True
) -> Case:
    """Return psi_i' = rate (psi_{i-1} - 2 psi_i + psi_{i+1}), both ends heated by u, with one RK4 step per sample.

    ``heated`` False: the first end only, as in the thesis. 4 rate sample < 2.78 is the limit of stability.
    """
    ocp = OCP("rod", T=N * sample, N=N)
    psi = ocp.state("psi", size=nx, initial=rod_profile(nx).tolist())
    u = ocp.control("u", size=2 if heated else 1)
    left, right = u[0], u[1] if heated else ca.SX(0)
    padded = ca.vertcat(left, psi, right)
    ocp.dynamics(rate * (padded[:-2] - 2 * padded[1:-1] + padded[2:]))
    z, y = psi[nx // 2], ca.vertcat(psi, u)
    ocp.least_squares(y, weight=np.ones(int(y.numel())))
    model = _modelled(ocp, z, 0.5 * ca.sumsqr(y), ca.SX(0), 1)
    t = np.arange(N)[:, None] * sample
    controls = np.sin(0.7 * t + np.arange(2 if heated else 1))
    options = Options(ExplicitRungeKutta(RK4, steps=1, unroll=unroll))
    return Case(f"rod, nx = {nx}", ocp, z, options, rod_profile(nx), controls, np.zeros((N + 1, 0)), model)
