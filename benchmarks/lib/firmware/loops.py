"""Closed loops are recorded on the host as inputs for replays on targets."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from nmpc_codegen import Controller, ExplicitRungeKutta, Options, RiccatiActiveSet, build, generate
from nmpc_codegen.firmware.recording import Array, Disturbed, Event, Recording, record
from nmpc_codegen.options import Precision
from nmpc_codegen.package.sources import Sources
from verification.closed_loop import Scenario, disturbed
from verification.robustness.work import Loop, closed_loops

#: Loops that run on the boards; of the others only the single precision is judged.
ON_BOARDS = ("crane", "cstr", "bioreactor", "quadrotor", "cart_pole", "chain3")
SAMPLES = 200

#: Loops whose small package has smaller frames with a function per integration step.
STEPPED = ("chain3", "bioreactor")
#: Loops whose small package has no interior point fallback of the active-set method.
ALONE = ("quadrotor",)


def loops() -> list[Loop]:
    """Return the loops of ON_BOARDS, with default options except where their problem needs others."""
    known = {loop.name: loop for loop in closed_loops()}
    return [known[name] for name in ON_BOARDS]


def small(loop: Loop) -> Options:
    """Return options of a small real-time controller in single precision without solve().

    Loops in STEPPED have a function per integration step; loops in ALONE have no interior point fallback.
    """
    options = real_time(loop)
    if loop.name in STEPPED:
        integrator = options.integrator or ExplicitRungeKutta()
        assert isinstance(integrator, ExplicitRungeKutta)
        options = replace(options, integrator=replace(integrator, unroll="none"))
    return _alone(loop, options)


def smallest(loop: Loop) -> Options:
    """Return the small options with the goal "size": loops instead of straight-line code, whatever stack they need."""
    return _alone(loop, replace(real_time(loop), goal="size"))


def real_time(loop: Loop) -> Options:
    """Return options without solve(), in single precision, for a microcontroller, with libm."""
    return replace(loop.options, solve=False, precision="single", target="cortex-m4f", math="libm")


def _alone(loop: Loop, options: Options) -> Options:
    return replace(options, qp=RiccatiActiveSet(fallback=None)) if loop.name in ALONE else options


@cache
def package(loop: Loop, options: Options) -> tuple[str, Sources]:
    """Return name and files of the package of a loop."""
    ocp = loop.make()
    return ocp.name, generate(ocp, options)


def with_precision(loop: Loop, precision: Precision) -> Loop:
    """Return the loop with the default options of its example in a precision, for a microcontroller, with libm."""
    return replace(loop, options=replace(loop.options, precision=precision, target="cortex-m4f", math="libm"))


def events(scenario: Scenario, samples: int) -> list[Event]:
    """Return the changes of the set point."""
    found = []
    for k in range(0, samples if scenario.set_points else 0, scenario.period):
        y, y_N = scenario.set_points[k // scenario.period % len(scenario.set_points)]
        found += [Event(k, "set_reference", np.array(y)), Event(k, "set_terminal_reference", np.array(y_N))]
    return found


def disturbances(scenario: Scenario, controller: Controller) -> Disturbed:
    """Return the function that disturbs the plant at the first sample of every period."""
    random = np.random.default_rng(1)

    def at(k: int, x: Array) -> Array:
        return disturbed(scenario, x, random, controller.integrate) if k % scenario.period == 0 else x

    return at


def recorded(loop: Loop, samples: int) -> Recording:
    """Record the loop on the host, in the profile without contraction."""
    controller = build(loop.make(), loop.options, profile="verify")
    scenario = loop.scenario
    changes, plant = events(scenario, samples), disturbances(scenario, controller.copy())
    return record(controller, np.array(scenario.x0, dtype=float), samples, scenario.dt, changes, plant)
