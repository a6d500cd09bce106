"""Six examples have closed loops for timing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from examples import bioreactor, cart_pole, chain, cstr, quadrotor
from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.oracle.trajectory import CLASSICAL, Tableau
from verification.closed_loop import Scenario
from verification.timed import Sample

Make = Callable[[], OCP]


@dataclass(frozen=True, eq=False)
class Example:
    """An example has its closed loop for timing, and the scheme of its integrator as the oracle states it."""

    name: str
    make: Make
    options: Options
    x0: Callable[[], Array]
    scenario: Callable[[], Scenario]
    steps: int = 1000
    tableau: Tableau = CLASSICAL


#: The integrator of peers.
TWO_STEPS = Options(ExplicitRungeKutta())

#: The crane's closed loop: a disturbance every 50 samples.
CRANE_LOOP = Scenario((0.1, 0.0, 0.1, 0.0), 0.3, 50, amplitude=0.05)
BIOREACTOR_LOOP = Scenario(bioreactor.START, bioreactor.SAMPLING, 50, restart=1e-2)


# Continuous stirred tank reactor --------------------------------------------------------------------------------------


def _set_point(index: int) -> tuple[Array, Array]:
    return cstr.SET_POINTS[index], cstr.SET_POINTS[index][:4]


CSTR = Example(
    name="cstr",
    make=cstr.build_ocp,
    options=TWO_STEPS,
    x0=lambda: cstr.START,
    scenario=lambda: Scenario(cstr.START, cstr.SAMPLING, 200, set_points=(_set_point(0), _set_point(2))),
)

#: The scenario of figure 6: three set points over 3000 s each.
FIGURE_6 = Scenario(cstr.START, cstr.SAMPLING, 600, set_points=tuple(_set_point(i) for i in range(3)))
FIGURE_6_STEPS = 1800


# Cart-pole ------------------------------------------------------------------------------------------------------------


CART_POLE = Example(
    name="cart_pole",
    make=cart_pole.build_ocp,
    options=Options(),
    x0=lambda: np.array([0.0, np.pi, 0.0, 0.0]),
    scenario=lambda: Scenario((0.1, 0.05, 0.0, 0.0), 0.05, 50, amplitude=0.05),
)


# Quadrotor ------------------------------------------------------------------------------------------------------------


def _quadrotor_scenario() -> Scenario:
    hover, there = np.concatenate([np.zeros(12), np.full(4, quadrotor.HOVER)]), np.zeros(16)
    there[:3] = 1.0
    points = tuple((y, y[:12]) for y in (hover, hover + there))
    return Scenario((1.0, 1.0, 1.0, *np.zeros(9)), 0.05, 40, set_points=points)


QUADROTOR = Example(
    name="quadrotor",
    make=lambda: quadrotor.build_ocp((0.5, 0.5, 0.5)),
    options=Options(integrator=ExplicitRungeKutta(RK4, steps=1)),
    x0=lambda: np.array([0.5, 0.5, 0.5, *np.zeros(9)]),
    scenario=_quadrotor_scenario,
    tableau=Tableau(CLASSICAL.A, CLASSICAL.b, steps=1),
)


# Chains ---------------------------------------------------------------------------------------------------------------

PUSH = (-1.0, 1.0, 1.0)


@cache
def _at_rest(n: int) -> tuple[float, ...]:
    return tuple(classify(chain.build_ocp(n)).x_initial.tolist())


@cache
def _pushed(n: int) -> Array:
    """Return the state after five pushes."""
    controller = build(chain.build_ocp(n), TWO_STEPS, "fast")
    x = np.array(_at_rest(n))
    for _ in range(5):
        x = np.asarray(controller.integrate(x, np.array(PUSH), 0.2))
    return x


def _chain(n: int) -> Example:
    return Example(
        name=f"chain{n}",
        make=lambda: chain.build_ocp(n),
        options=TWO_STEPS,
        x0=lambda: _pushed(n),
        scenario=lambda: Scenario(_at_rest(n), 0.2, 100, push=PUSH, pushes=5),
        steps=400,
    )


EXAMPLES = (CSTR, CART_POLE, QUADROTOR, *(_chain(n) for n in (3, 5, 7)))


def of_sample(sample: Sample) -> Scenario:
    """Return the closed loop of a timed problem."""
    own = {"timed crane": CRANE_LOOP, "timed bioreactor": BIOREACTOR_LOOP}
    name = sample.name.removeprefix("timed ")
    return own[sample.name] if sample.name in own else next(e.scenario() for e in EXAMPLES if e.name == name)
