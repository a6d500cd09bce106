"""The tariff and the demand of a heat store repeat every day, so that its best operation is an orbit."""

from __future__ import annotations

from functools import cache

import numpy as np

from nmpc_codegen import OCP, Controller, build
from nmpc_codegen.economic import PeriodicTuning, StageQp, Step, kkt_step, periodic_letempc, tune_periodic

HOURS = np.arange(24)
#: Price (EUR/kWh) and demand (kW) of every hour.
DATA = np.column_stack(
    [0.2 + 0.1 * np.sin(2 * np.pi * (HOURS - 9) / 24), 3 + 1.5 * np.cos(2 * np.pi * (HOURS - 18) / 24)]
)
#: Hour at which plans are compared, where and around which no row is active; nodes of the horizon.
START, N = 7, 48


def store(economic: bool = True) -> OCP:
    """Return the OCP of two days of a heat pump that loses efficiency with the temperature and with its load."""
    ocp = OCP("store", T=float(N), N=N, time_unit="h")
    T, q = ocp.state("T", unit="degC", initial=45.0), ocp.control("q", unit="kW")
    price, demand = ocp.parameter("price", value=0.2), ocp.parameter("demand", value=3.0)
    ocp.dynamics({T: (q - demand - 0.02 * (T - 15)) / 1.2})
    if economic:
        ocp.stage_cost(price * q * (1 + 0.05 * q) / (6 - 0.06 * T) + 1e-4 * (T - 40) ** 2)
    ocp.subject_to(0, q, 10)
    ocp.subject_to(35, T, 60)
    return ocp


@cache
def tuned() -> PeriodicTuning:
    """Return the orbit of a day."""
    return tune_periodic(store(), parameters=DATA)


def first_controls(offsets: list[float]) -> np.ndarray:
    """Return first controls (offsets, 2) of converged plans, economic and LETEMPC, offset from the orbit at START."""
    tracking = store(economic=False)
    at, nodes = periodic_letempc(tuned(), tracking), (START + np.arange(N + 1)) % 24
    controllers = [build(store()), build(tracking)]
    for name, values in at(START).items():
        controllers[1].set_parameter(name, values)
    return np.array([[_first(c, offset, DATA[nodes]) for c in controllers] for offset in offsets])


def _first(controller: Controller, offset: float, data: np.ndarray) -> float:
    for name, values in zip(("price", "demand"), data.T, strict=True):
        controller.set_parameter(name, values)
    return float(controller.solve(tuned().x[START] + offset, tol=1e-10).u[0, 0])


def first_steps(offset: float = 1.0) -> tuple[Step, Step]:
    """Return the first SQP steps of a day from the orbit at START, with the exact Hessians and with M."""
    t = tuned()
    order = (START + np.arange(24)) % 24
    n = t.x.shape[1]
    slopes = np.array([t.lam[k] - t.A[k].T @ t.lam[(k + 1) % 24] for k in order])
    controls = np.array([-t.B[k].T @ t.lam[(k + 1) % 24] for k in order])
    g = np.hstack([slopes, controls]) - np.array([t.C[k].T @ t.mu[k] for k in order])
    rows = [t.C[k] for k in order]

    def step(H: np.ndarray) -> Step:
        qp = StageQp(
            *(t.A[order], t.B[order], np.zeros((24, n)), H[order], g, rows, [np.zeros(len(C)) for C in rows]),
            *(np.zeros((n, n)), np.zeros(n), np.eye(n), np.zeros(n)),
        )
        return kkt_step(qp, np.full(n, offset))

    return step(t.H), step(t.M)
