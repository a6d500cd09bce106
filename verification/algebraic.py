"""Five models have algebraic equations, and closed loops.

They are a column with bubble points, a neutralisation, a crane in Cartesian coordinates, a braking car and a battery
that delivers power. IDAS simulates the model as it is stated, with other parameters and measurement noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from examples import distillation, rope_crane
from nmpc_codegen import (
    OCP,
    DenseActiveSet,
    ExactHessian,
    FullCondensing,
    GaussNewton,
    NoCondensing,
    Options,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
)
from nmpc_codegen.frontend.classify import classify
from verification.stiff import Stiff

Array = NDArray[Any]


def neutralisation() -> OCP:
    """Return the OCP of the pH of a stream of acid, buffer and base in reaction invariants.

    Invariants are in mmol/l, time is in s (Henson and Seborg, IEEE Trans. Control Syst. Technol. 2, 1994).
    """
    ocp = OCP("neutralisation", T=300.0, N=20)
    Wa, Wb = ocp.state("Wa", initial=-0.432, unit="mmol/l"), ocp.state("Wb", initial=0.528, unit="mmol/l")
    h = ocp.state("h", initial=14.0, unit="cm")
    pH = ocp.algebraic("pH", initial=7.0)
    base, buffer = ocp.control("base", unit="ml/s"), ocp.parameter("buffer", value=0.55, unit="ml/s")
    acid, area = 16.6, 207.0

    def power(e: Any) -> Any:
        return ca.exp(np.log(10) * e)

    carbonate = (1 + 2 * power(pH - 10.25)) / (1 + power(6.35 - pH) + power(pH - 10.25))
    ocp.algebraic_equation(Wa + 1e3 * (power(pH - 14) - power(-pH)) + Wb * carbonate, name="charge")
    ocp.dynamics(
        {
            Wa: ((3.0 - Wa) * acid + (-30.0 - Wa) * buffer + (-3.05 - Wa) * base) / (area * h),
            Wb: (-Wb * acid + (30.0 - Wb) * buffer + (0.05 - Wb) * base) / (area * h),
            h: (acid + buffer + base - 8.75 * ca.sqrt(h)) / area,
        }
    )
    ocp.least_squares(ca.vertcat(pH, base), weight=[1, 0.01], reference=[7.0, 15.6])
    ocp.terminal_least_squares(pH, weight=5, reference=7.0)
    ocp.subject_to(0, base, 30)
    ocp.subject_to(5.5, pH, 9.0, soft=(10, 10))
    return ocp


def car() -> OCP:
    """Return the OCP of a braking car with fast wheels.

    The loads of the axles follow from the tyre forces, which do not grow in proportion to the loads.
    """
    ocp = OCP("car", T=1.0, N=20)
    v = ocp.state("v", initial=30.0, unit="m/s")
    w = ocp.state("w", size=2, initial=[29.5, 29.5], unit="m/s")  # speeds of the wheels at their circumference
    N = ocp.algebraic("N", size=2, initial=[8.0, 6.0], unit="kN")
    brake = ocp.control("brake", size=2, unit="kN")
    grip = ocp.parameter("grip", value=1.0)
    slip = (v - w) / v
    mu = grip * (1.28 * (1 - ca.exp(-24.0 * slip)) - 0.52 * slip)
    force = mu * N * (1.1 - 0.0125 * N)
    share = ca.DM([0.55, 0.45]) * 1.4 * 9.81
    ocp.algebraic_equation(N - share - ca.vertcat(0.2, -0.2) * ca.sum1(force), name="load")
    ocp.dynamics({v: -ca.sum1(force) / 1.4, w: (force - brake) / 0.03})
    ocp.least_squares(ca.vertcat(v, slip, brake), weight=[1, 50, 50, 0.01, 0.01], reference=[12, 0.05, 0.05, 6, 4])
    ocp.subject_to(0, brake, [8.0, 3.2])
    ocp.subject_to(-0.02, slip, 0.15, soft=(10, 100), name="slip")
    ocp.subject_to(3.0, N[1], np.inf, soft=(10, 10))
    return ocp


def battery() -> OCP:
    """Return the OCP of a pack that delivers power and warms up. Time is in min.

    The current follows from P = (U - R I) I, of whose two solutions the smaller one is meant.
    """
    ocp = OCP("battery", T=20.0, N=20, time_unit="min")
    q, vp = ocp.state("q", initial=0.8), ocp.state("vp", unit="V")
    T = ocp.state("T", initial=30.0, unit="degC")
    I = ocp.algebraic("I", initial=100.0, unit="A")  # noqa: E741
    P, demand = ocp.control("P", unit="kW"), ocp.parameter("demand", value=60.0, unit="kW")
    U = 350 + 60 * q - 10 * ca.exp(-20 * q) - vp
    R = 0.12 * ca.exp(0.02 * (30 - T))
    ocp.algebraic_equation(P * 1e3 - (U - R * I) * I, name="power")
    ocp.dynamics(
        {
            q: -I / (60 * 250.0),
            vp: 60 * (I / 3000 - vp / 120),
            T: 60 * (R * I**2 / 1e5 - 12 * (T - 25) / 1e5),
        }
    )
    ocp.least_squares(ca.vertcat(P - demand), weight=1.0)
    ocp.subject_to(0, P, 100)
    ocp.subject_to(-np.inf, I, 180.0)
    ocp.subject_to(-np.inf, T, 45.0, soft=(1e3, 1e3))
    return ocp


def _far(*targets: tuple[int, float]) -> Callable[[Array, Array], float]:
    return lambda x, u: max(abs(float(x[i]) - value) for i, value in targets)


PROBLEMS = {
    "column": Stiff(distillation.build_ocp, 0.05, 0.03, 40, _far((0, 0.1), (distillation.TRAYS - 1, 0.9)), 0.03),
    "neutralisation": Stiff(neutralisation, 0.05, 0.1, 40, _far((2, 14.0)), 3.0),
    "crane": Stiff(rope_crane.build_ocp, 0.1, 0.1, 60, _far((0, 0.0), (2, 0.0)), 0.1),
    "car": Stiff(car, 0.02, 0.1, 60, _far((0, 12.0)), 1.0),
    "battery": Stiff(battery, 0.05, 0.1, 40, lambda x, u: max(0.0, float(x[2]) - 45), 0.5),
}


class Plant:
    """IDAS simulates the model as it is stated, with implicit derivatives and algebraic variables."""

    def __init__(self, ocp: OCP) -> None:
        self.problem = classify(ocp)
        implied = [i for i in ocp.slopes if i not in ocp.derivatives]
        slopes = {i: ocp.slopes[i] for i in implied} | ocp.derivatives
        z = ca.vertcat(ca.SX(0, 1), *(ocp.slopes[i] for i in implied), ocp.z)
        self._given = np.concatenate([np.zeros(len(implied)), *(d.signal.value for d in ocp.algebraics)])
        model = {
            "x": ocp.x,
            "z": z,
            "p": ca.vertcat(ocp.u, ocp.p),
            "ode": ca.vertcat(*(slopes[i] for i in range(ocp.x.numel()))),
            "alg": ca.vertcat(*(e.expression for e in ocp.equations)),
        }
        options = {"abstol": 1e-8, "reltol": 1e-7}
        self._run = ca.integrator("plant", "idas", model, 0.0, self.problem.dt[0], options)
        self._z = self._given

    def step(self, x: Array, u: Array, p: Array) -> Array:
        """Return the state one interval later."""
        found = self._run(x0=x, z0=self._z, p=np.concatenate([u, p]))
        self._z = np.asarray(found["zf"], dtype=float).ravel()
        return np.asarray(found["xf"], dtype=float).ravel()


#: The routes of solve().
ROUTES = {
    "default": Options(),
    "exact, full": Options(hessian=ExactHessian(), condensing=FullCondensing(), qp=DenseActiveSet()),
    "Gauss-Newton, none": Options(hessian=GaussNewton(), condensing=NoCondensing(), qp=RiccatiInteriorPoint()),
    "Gauss-Newton, riccati": Options(hessian=GaussNewton(), condensing=NoCondensing(), qp=RiccatiActiveSet()),
}


def residual(ocp: OCP, x: Array, z: Array, u: Array) -> float:
    """Return the largest residual of the algebraic equations as stated, relative to the sum of |dg/dz_i z_i|."""
    symbols = [ocp.x, ocp.z, ocp.u, ocp.p]
    g = ca.vertcat(*(e.expression for e in ocp.equations))
    p = np.array([v for d in ocp.parameters for v in d.signal.value])
    at = ca.Function("g", symbols, [g, ca.fabs(ca.jacobian(g, ocp.z)) @ ca.fabs(ocp.z)])
    found = [tuple(np.asarray(v, dtype=float) for v in at(*each, p)) for each in zip(x, z, u, strict=True)]
    return max(float(np.max(np.abs(value) / size)) for value, size in found)
