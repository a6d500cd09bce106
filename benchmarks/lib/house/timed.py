"""Problems that are timed, old against new: stated with what earlier commits have, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from examples import bioreactor, chain, crane, cstr, quadrotor
from nmpc_codegen import (
    OCP,
    RK4,
    DenseActiveSet,
    ExactHessian,
    ExplicitRungeKutta,
    FullCondensing,
    Mirror,
    Options,
    RealTimeIteration,
)


@dataclass(frozen=True, eq=False)
class Sample:
    """One package: how its problem is made, and its options."""

    name: str
    make: Callable[[], OCP]
    options: Options = field(default_factory=Options)


#: Problems that are timed, in the settings of the benchmarks that time them against peers.
TIMED = (
    Sample("timed crane", crane.build_ocp),
    Sample("timed cstr", cstr.build_ocp),
    Sample(
        "timed quadrotor",
        lambda: quadrotor.build_ocp((0.5, 0.5, 0.5)),
        Options(integrator=ExplicitRungeKutta(RK4, steps=1)),
    ),
    Sample("timed chain5", lambda: chain.build_ocp(5)),
    Sample(
        "timed bioreactor",
        lambda: bioreactor.build_ocp("a", periodic=False),
        Options(
            qp=DenseActiveSet(),
            condensing=FullCondensing(),
            integrator=ExplicitRungeKutta(RK4, steps=bioreactor.STEPS),
            hessian=ExactHessian(Mirror(level="stage")),
            algorithm=RealTimeIteration(shift="repeat"),
        ),
    ),
)
