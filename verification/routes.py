"""A route leads from the stages to a solution of the QP by a condensing and a solver; single shooting has no QP."""

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

#: The plain scheme: the plan is not shifted, a sample takes one full step, rows stay hard. The status is that of the
#: QP.
PURE = RealTimeIteration(iterations=1, shift=None, relaxation=None, tolerance=1e30)

ROUTES: dict[str, tuple[Condensing, QpSolver]] = {
    "dense": (FullCondensing(), DenseActiveSet()),
    "riccati": (NoCondensing(), RiccatiActiveSet()),
    "interior": (NoCondensing(), RiccatiInteriorPoint()),
    "OSQP": (FullCondensing(), Osqp()),
}
#: Routes that emit only code of ours.
OURS = tuple(route for route in ROUTES if route != "OSQP")


def on(route: str, **more: Any) -> Options:
    """Return the options of a route."""
    condensing, qp = ROUTES[route]
    return Options(condensing=condensing, qp=qp, **more)


def shooting(online: Online | None = None, precision: Any = "double", solve: bool = True, **algorithm: Any) -> Options:
    """Return options with single shooting, whose plan is not shifted unless a shift is given."""
    given = AdjointShooting(**({"shift": None} | algorithm))
    return Options(algorithm=given, online=online or Online(), precision=precision, solve=solve)
