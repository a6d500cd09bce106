"""The ways from stages to a solution of the QP: a condensing with a solver; and the one without a QP."""

from __future__ import annotations

from typing import Any

from nmpc_codegen import (
    AdjointShooting,
    DenseActiveSet,
    FullCondensing,
    NoCondensing,
    Online,
    Options,
    Osqp,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
)
from nmpc_codegen.components.base import Condensing, QpSolver

#: The plain scheme: the plan stays where it is, one full step per sample, rows stay hard. The status is that of the QP.
PURE = RealTimeIteration(iterations=1, shift=None, relaxation=None, tolerance=1e30)

ROUTES: dict[str, tuple[Condensing, QpSolver]] = {
    "dense": (FullCondensing(), DenseActiveSet()),
    "riccati": (NoCondensing(), RiccatiActiveSet()),
    "interior": (NoCondensing(), RiccatiInteriorPoint()),
    "OSQP": (FullCondensing(), Osqp()),
}
#: Those that write code of ours alone.
OURS = tuple(route for route in ROUTES if route != "OSQP")


def on(route: str, **more: Any) -> Options:
    """Options of a route."""
    condensing, qp = ROUTES[route]
    return Options(condensing=condensing, qp=qp, **more)


def shooting(online: Online | None = None, precision: Any = "double", solve: bool = True, **algorithm: Any) -> Options:
    """Single shooting whose plan does not move unless a shift is given."""
    given = AdjointShooting(**({"shift": None} | algorithm))
    return Options(algorithm=given, online=online or Online(), precision=precision, solve=solve)
