"""Examples times QP solvers with their condensing, precisions and shifts: every package of an example."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from examples import bioreactor, cart_pole, chain, crane, cstr, quadrotor
from nmpc_codegen import (
    DenseActiveSet,
    ExactHessian,
    FullCondensing,
    GaussNewton,
    NoCondensing,
    Options,
    PartialCondensing,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    generate,
)
from nmpc_codegen.components.algorithms.real_time_iteration import SHIFTS
from nmpc_codegen.components.qp import Osqp
from nmpc_codegen.lowering.render import Sources
from nmpc_codegen.options import PRECISIONS

#: Label -> condensing and QP solver.
ROUTES: dict[str, tuple[Any, Any]] = {
    "full + dense_active_set": (FullCondensing(), DenseActiveSet()),
    "full + osqp": (FullCondensing(), Osqp()),
    "none + riccati_active_set": (NoCondensing(), RiccatiActiveSet()),
    "partial + riccati_active_set": (PartialCondensing(2), RiccatiActiveSet()),
    "none + riccati_interior_point": (NoCondensing(), RiccatiInteriorPoint()),
    "partial + riccati_interior_point": (PartialCondensing(2), RiccatiInteriorPoint()),
}

#: Problem, Hessian, and a sampling time (s) that is not a multiple of the intervals.
EXAMPLES: dict[str, tuple[Any, Any, float]] = {
    "crane": (crane.build_ocp, GaussNewton(), 0.2),
    "cstr": (cstr.build_ocp, GaussNewton(), 10.0),
    "cart_pole": (cart_pole.build_ocp, GaussNewton(), 0.03),
    "quadrotor": (quadrotor.build_ocp, GaussNewton(), 0.03),
    "chain": (lambda: chain.build_ocp(3), GaussNewton(), 0.15),
    "bioreactor": (bioreactor.build_ocp, ExactHessian(), 0.5),
}


def shift(moves: str | None, sampling_time: float) -> RealTimeIteration:
    """The algorithm with this shift; the sampling time is used by "resample" only."""
    return RealTimeIteration(shift=moves, sampling_time=sampling_time if moves == "resample" else None)


@dataclass(frozen=True)
class Combination:
    """Description of one combination."""

    example: str
    route: str
    precision: str
    shift: str | None

    def __str__(self) -> str:
        return f"{self.example}, {self.route}, {self.precision}, shift {self.shift}"

    def generate(self) -> Sources:
        """The package.

        Raises:
            OptionError: a component refuses the combination.
        """
        make, hessian, sampling_time = EXAMPLES[self.example]
        condensing, qp = ROUTES[self.route]
        algorithm = shift(self.shift, sampling_time)
        return generate(make(), Options(None, hessian, condensing, qp, algorithm, precision=self.precision))


def combinations() -> Iterator[Combination]:
    """All combinations, including those that are refused."""
    for example in EXAMPLES:
        for route in ROUTES:
            for precision in PRECISIONS:
                for moves in SHIFTS:
                    yield Combination(example, route, precision, moves)
