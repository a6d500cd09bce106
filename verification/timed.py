"""The times of these problems are compared with earlier commits, whose features are sufficient to state them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from examples import bioreactor, chain, crane, cstr, quadrotor
from nmpc_codegen import (
    OCP,
    RK4,
    DenseActiveSet,
    Estimator,
    ExactHessian,
    ExplicitRungeKutta,
    FullCondensing,
    Mirror,
    Options,
    RealTimeIteration,
)


@dataclass(frozen=True, eq=False)
class Sample:
    """A sample is one package: the function that states its problem, and its options.

    ``x0``: a measured state; ``data``: arguments of node_data() that differ from the declared ones.
    """

    name: str
    make: Callable[[], OCP | Estimator]
    options: Options = field(default_factory=Options)
    x0: tuple[float, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)


#: The timed problems, in the settings of the benchmarks that compare their times with those of peers.
TIMED = (
    Sample("timed crane", crane.build_ocp),
    Sample(
        "timed cstr",
        cstr.build_ocp,
        Options(ExplicitRungeKutta(), algorithm=RealTimeIteration(sampling_time=cstr.SAMPLING)),
    ),
    Sample(
        "timed quadrotor",
        lambda: quadrotor.build_ocp((0.5, 0.5, 0.5)),
        Options(integrator=ExplicitRungeKutta(RK4, steps=1)),
    ),
    Sample("timed chain5", lambda: chain.build_ocp(5), Options(ExplicitRungeKutta())),
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
