"""Controllers spend most of their life at rest: in these loops every sample must be OK, with one QP.

A plant at rest has states, controls and rows whose values are 0 up to rounding. The draws vary how it rests: at a set
point, at a bound, at a bound of 0, on a row whose bound is 0, in a soft band, with a penalty of rates; with exact,
noisy and quantised measurements, on all routes and in both precisions. Then single components of the state are
displaced by little, and solve() starts from the plan that is left, and from one whose zeros are other rounding errors.

In other units of states, controls, rows and cost, a problem is the same: statuses, iterations and controls are.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    Controller,
    ExactHessian,
    Options,
    RealTimeIteration,
    Status,
    build,
)
from verification.convergence.units import Units, in_units
from verification.routes import on

Array = np.ndarray
ARRIVES, RESTS = 80, 100  # samples before, and after a plant counts as being at rest
#: Standard deviations of measurements, in the scales of the states, and steps of a quantised one.
NOISES = (0.0, 1e-16, 1e-12, 1e-3)
QUANTA = (0.0, 0.0, 1e-3)
#: Differences of controls from those of another route in double precision, in their scales, by precision.
SAME = {"double": 1e-4, "single": 2e-2}
#: Most iterations of solve() from a plan at rest.
MOST_ITERATIONS = 12
#: Iterations of the interior point method where its warm start fails: those of both starts.
COLD = 50
#: Displacements of a component of a state at rest, in its scale, and what no sample after one may be.
SHARES = (1e-9, 1e-5, 1e-2)
GIVEN_UP = (Status.ITERATION_LIMIT, Status.NUMERICAL_FAILURE, Status.STALLED)
#: Draws of units, and samples of a loop in them.
UNITS, IN_LOOP = 5, 40


@dataclass(frozen=True)
class Plant:
    """A plant is a problem, the range of its starts (nx,) and the spread of its states, which scales noise.

    ``moves``: values of the reference of the first residual that are set at run time.
    """

    name: str
    make: Callable[[], OCP]
    starts: tuple[tuple[float, float], ...]
    spread: tuple[float, ...]
    moves: tuple[float, float] | None = None


def mass() -> OCP:
    """Return the OCP of a mass at a set point, which may be 0."""
    ocp = OCP("mass", T=2.0, N=10)
    p, v, a = ocp.state("p"), ocp.state("v"), ocp.control("a")
    ocp.dynamics({p: v, v: a})
    ocp.least_squares(ca.vertcat(p, v, a), weight=[1, 0.1, 0.1])
    ocp.subject_to(-1, a, 1)
    ocp.subject_to(-2, v, 2)
    return ocp


def standstill() -> OCP:
    """Return the OCP of a car beyond its stop line that must not reverse: a state is at its bound 0."""
    ocp = OCP("standstill", T=2.0, N=10)
    s, v, a = ocp.state("s"), ocp.state("v"), ocp.control("a")
    ocp.dynamics({s: v, v: a})
    ocp.least_squares(ca.vertcat(s, v, a), weight=[1, 0.1, 0.1])
    ocp.subject_to(-5, a, 2)
    ocp.subject_to(0, v, 20)
    return ocp


def pushed() -> OCP:
    """Return the OCP of a control at its bound, with a penalty of its rate."""
    ocp = OCP("pushed", N=10)
    T, last, u = ocp.state("T"), ocp.state("last"), ocp.control("u")
    ocp.dynamics({T: 0.8 * T + 0.2 * u, last: u}, discrete=True)
    ocp.least_squares(ca.vertcat(T - 1, u - last), weight=[1, 0.5])
    ocp.subject_to(0, u, 0.6)
    return ocp


def fan() -> OCP:
    """Return the OCP of a fan that had better stay off below its soft band."""
    ocp = OCP("fan", T=10.0, N=10)
    x, y, d = ocp.state("x", initial=18.0), ocp.state("y"), ocp.control("dy")
    ocp.dynamics({x: 0.205 + 0.029 * y - 0.003 * x * y - 0.001 * x**2, y: d})
    ocp.least_squares(d, weight=0.1)
    ocp.subject_to(-20, d, 20)
    ocp.subject_to(0, y, 100, name="fan")
    ocp.subject_to(17.5, x, 19, name="band", soft=(10, 0))
    return ocp


def on_row() -> OCP:
    """Return the OCP of a mass on a row p (p - 1) >= 0, whose bound is 0; its target violates the row."""
    ocp = OCP("on_row", T=2.0, N=10)
    p, u = ocp.state("p"), ocp.control("u")
    ocp.dynamics({p: u})
    ocp.least_squares(ca.vertcat(p - 0.2, u), weight=[1, 0.1])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(0, p * (p - 1), np.inf, name="gap")
    return ocp


def circle() -> OCP:
    """Return the OCP of a mass at a set point, under a circle of controls with a bound of 0."""
    ocp = OCP("circle", T=2.0, N=10)
    p, v, a = ocp.state("p", size=2), ocp.state("v", size=2), ocp.control("a", size=2)
    ocp.dynamics({p: v, v: a})
    ocp.least_squares(ca.vertcat(p, v, a), weight=[1, 1, 0.1, 0.1, 0.02, 0.02])
    ocp.subject_to(-4, a, 4)
    ocp.subject_to(-np.inf, ca.sumsqr(a) - 16, 0, name="friction")
    return ocp


def closed_valve() -> OCP:
    """Return the OCP of a tank that is too full: its valve stays closed, with a state and its rate at 0."""
    ocp = OCP("closed_valve", T=10.0, N=10)
    L, q, d = ocp.state("L"), ocp.state("q"), ocp.control("dq")
    ocp.dynamics({L: 0.1 * q, q: d})
    ocp.least_squares(ca.vertcat(L - 1, d), weight=[1, 0.1])
    ocp.subject_to(-0.2, d, 0.2)
    ocp.subject_to(0, q, 1)
    ocp.subject_to(0, L, 3)
    return ocp


def empty_store() -> OCP:
    """Return the OCP of a store with more demand than content, which rests empty."""
    ocp = OCP("empty_store", T=5.0, N=10)
    e, u = ocp.state("e"), ocp.control("u")
    ocp.dynamics({e: u})
    ocp.least_squares(u + 0.4, weight=1)
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(0, e, 5)
    return ocp


def two_at_once() -> OCP:
    """Return the OCP of two stores, one empty and one full, with a soft limit on their exchange."""
    ocp = OCP("two_at_once", T=5.0, N=10)
    e, f, u, w = ocp.state("e"), ocp.state("f"), ocp.control("u"), ocp.control("w")
    ocp.dynamics({e: u, f: w - 0.1 * u})
    ocp.least_squares(ca.vertcat(u + 0.4, w - 0.5), weight=[1, 1])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-1, w, 1)
    ocp.subject_to(0, e, 5)
    ocp.subject_to(0, f, 2)
    ocp.subject_to(-np.inf, u - w, 0.1, name="exchange", soft=(0.5, 1.0))
    return ocp


def _upright(name: str, T: float, N: int, pull: float, most: float) -> OCP:
    ocp = OCP(name, T=T, N=N)
    th, w, u = ocp.state("th"), ocp.state("w"), ocp.control("u")
    ocp.dynamics({th: w, w: pull * ca.sin(th) + u})
    ocp.least_squares(ca.vertcat(th, w, u), weight=[10, 1, 0.1])
    ocp.subject_to(-most, u, most)
    return ocp


def pendulum() -> OCP:
    """Return the OCP of an upright nonlinear pendulum."""
    return _upright("pendulum", 1.0, 20, 9.81, 8)


def stick() -> OCP:
    """Return the OCP of an upright stick with an open loop that grows by e^21 over the horizon."""
    return _upright("stick", 3.0, 40, 49, 20)


def drone() -> OCP:
    """Return the OCP of a planar drone at a set point; thrusts have a reference, the lateral motion is exactly 0."""
    ocp = OCP("drone", T=1.5, N=15)
    x, z, th = ocp.state("x"), ocp.state("z"), ocp.state("th")
    vx, vz, om = ocp.state("vx"), ocp.state("vz"), ocp.state("om")
    f, t = ocp.control("f"), ocp.control("t")
    ocp.dynamics({x: vx, z: vz, th: om, vx: -f * ca.sin(th), vz: f * ca.cos(th) - 9.81, om: t})
    y = ca.vertcat(x, z, th, vx, vz, om, f, t)
    ocp.least_squares(y, weight=[5, 5, 1, 1, 1, 0.5, 0.05, 0.05], reference=[0, 0, 0, 0, 0, 0, 9.81, 0])
    ocp.subject_to(2, f, 18)
    ocp.subject_to(-10, t, 10)
    return ocp


def reactor() -> OCP:
    """Return the OCP of a cooled reactor at its temperature, in kelvin, with an Arrhenius term."""
    ocp = OCP("reactor", T=2.0, N=20)
    c, T, u = ocp.state("c", initial=0.5), ocp.state("T", initial=350.0), ocp.control("u")
    k = 7.2e10 * ca.exp(-8750 / T)
    ocp.dynamics({c: 1 - c - k * c, T: 350 - T + 209 * k * c + 2.1 * (u - T)})
    ocp.least_squares(ca.vertcat(T, u), weight=[1, 0.01], reference=[350, 300])
    ocp.subject_to(280, u, 370)
    return ocp


def economic() -> OCP:
    """Return the OCP of a general cost with an inner optimum."""
    ocp = OCP("economic", T=4.0, N=10)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -x + u})
    ocp.stage_cost(u**2 - 2 * x + 0.1 * x**4)
    ocp.subject_to(-3, u, 3)
    ocp.subject_to(0, x, 4)
    return ocp


PLANTS = {
    p.name: p
    for p in (
        Plant("mass", mass, ((-2, 2), (-0.5, 0.5)), (1, 1), moves=(-2, 2)),
        Plant("standstill", standstill, ((0.05, 0.5), (0, 0)), (1, 1)),
        Plant("pushed", pushed, ((0, 1), (0, 0.6)), (1, 1)),
        Plant("fan", fan, ((17, 19), (0, 0)), (10, 10)),
        Plant("on_row", on_row, ((-2, -0.1),), (1,)),
        Plant("circle", circle, ((-1, 1), (-1, 1), (-0.5, 0.5), (-0.5, 0.5)), (1, 1, 1, 1)),
        Plant("closed_valve", closed_valve, ((1.1, 2), (0, 0.1)), (1, 1)),
        Plant("empty_store", empty_store, ((0, 2),), (1,)),
        Plant("two_at_once", two_at_once, ((0, 2), (0, 2)), (1, 1)),
        Plant("pendulum", pendulum, ((-0.3, 0.3), (-0.3, 0.3)), (0.3, 0.3)),
        Plant("stick", stick, ((-0.1, 0.1), (0, 0)), (0.1, 0.1)),
        Plant("drone", drone, ((-1, 1), (-1, 1), *[(0, 0)] * 4), (1,) * 6, moves=(-1, 1)),
        Plant("reactor", reactor, ((0.4, 0.6), (345, 355)), (0.1, 1)),
        Plant("economic", economic, ((0.5, 2),), (1,)),
    )
}


@dataclass(frozen=True)
class Package:
    """A package is a plant on a route."""

    plant: Plant
    label: str
    options: Options

    def __str__(self) -> str:
        return f"{self.plant.name} {self.label}"


#: Options of packages for microcontrollers, and the algorithms without a QP.
FIRMWARE: dict[str, Any] = {"goal": "size", "solve": False, "algorithm": RealTimeIteration(iterations=1)}
OTHERS = {
    "augmented Lagrangian": Options(algorithm=AugmentedLagrangian()),
    "single shooting": Options(algorithm=AdjointShooting()),
}
#: Plants whose rows those do not hold to the last bit, and an open loop that single shooting cannot follow.
WITH_ROWS = ("stick", "on_row", "standstill", "two_at_once", "closed_valve", "fan", "empty_store", "circle", "economic")


@functools.cache
def packages() -> tuple[Package, ...]:
    """Return the default of every plant in both precisions, and one other route each, in turn."""
    turns = ("dense", "interior")
    found = []
    for number, plant in enumerate(PLANTS.values()):
        more: dict[str, Any] = {"hessian": ExactHessian()} if plant.name == "economic" else {}
        route = turns[number % len(turns)]
        found += [
            Package(plant, "default", Options(**more)),
            Package(plant, "single", Options(precision="single", **more)),
            Package(plant, route, on(route, **more)),
            Package(plant, "reference", on("riccati", **more)),
        ]
        if number % 3 == 0:
            found.append(Package(plant, "firmware", Options(precision="single", **FIRMWARE, **more)))
        if plant.name not in WITH_ROWS:
            found += [Package(plant, label, options) for label, options in OTHERS.items()]
    return tuple(found)


@dataclass
class Outcome:
    """An outcome has the samples of a plant at rest, and their faults by kind, with the first example."""

    samples: int = 0
    wrong: Counter[str] = field(default_factory=Counter)
    example: str = ""

    def note(self, what: str, where: str) -> None:
        """Count a fault."""
        self.wrong[what] += 1
        self.example = self.example or f"{what}: {where}"

    def __str__(self) -> str:
        return f"{dict(self.wrong)}, first {self.example}" if self.wrong else "OK"


@functools.lru_cache(maxsize=16)
def _built(number: int) -> Controller:
    package = packages()[number]
    return build(package.plant.make(), package.options, profile="test")


def run(seed: int) -> tuple[Package, Outcome]:
    """Run the draw with this seed: a package, a start, a set point, noise, a quantum."""
    random, number = np.random.default_rng([7, seed]), 7 * seed % len(packages())
    package, c = packages()[number], _built(number)
    plant, out = package.plant, Outcome()
    x = np.array([random.uniform(*span) for span in plant.starts])
    spread, noise, quantum = np.array(plant.spread), random.choice(NOISES), random.choice(QUANTA)
    c.reset()
    if plant.moves is not None:
        c.set_reference(_moved(c, random.choice([0.0, random.uniform(*plant.moves)])))
    other, fast = _reference(package.plant, c, number), list[int]()
    for sample in range(ARRIVES + RESTS):
        measured = x + noise * spread * random.standard_normal(x.size)
        measured = np.round(measured / (quantum * spread)) * quantum * spread if quantum else measured
        u = c.step(measured)
        if other is not None:
            other.step(measured)
        if sample >= ARRIVES:
            out.samples += 1
            where = f"seed {seed}, sample {sample}, noise {noise:g}, quantum {quantum:g}, x {measured}"
            _judge(c, out, where)
            if other is not None:
                _compare(c, other, out, where)
            fast.append(int(getattr(c.stats, "qp_iterations", 0)))
        x = np.asarray(c.integrate(x, u, float(c.description.dt[0])), dtype=float)
    most = COLD if package.label == "interior" else 2 * max(1, fast[0]) + 2
    if max(fast) > most and noise < 1e-3:
        out.note("iterations grow", f"seed {seed}: {fast[0]} to {max(fast)}")
    _displace(c, x, spread, out, f"seed {seed}")
    if c.description.offers("solve"):
        _solve(c, x, random, out, f"seed {seed}")
    return package, out


def _reference(plant: Plant, c: Controller, number: int) -> Controller | None:
    """Return a controller of the same plant on stages in double precision, with the same references.

    Returns None for algorithms that converge over the samples.
    """
    if packages()[number].label in OTHERS:
        return None
    (where,) = (i for i, p in enumerate(packages()) if p.plant is plant and p.label == "reference")
    found = _built(where)
    found = found.copy() if where == number else found
    found.reset()
    if plant.moves is not None:
        found.set_reference(np.array(c.view("yref")[0], dtype=float))
    return found


def _compare(c: Controller, other: Controller, out: Outcome, where: str) -> None:
    scale = np.array(c.description.scales[c.dims.nx :])
    if not np.all(np.abs(c.u[0] - other.u[0]) <= SAME[c.description.precision] * scale):
        out.note("another control", f"{where}: {c.u[0]} instead of {other.u[0]}")


def _displace(c: Controller, x: Array, spread: Array, out: Outcome, where: str) -> None:
    """Run two samples of a fresh controller after a displacement along one axis."""
    for i in range(x.size):
        for share in SHARES:
            twin, away = c.copy(), x.copy()
            twin.reset()
            away[i] += share * spread[i]
            for sample in range(2):
                twin.step(away)
                if twin.status in GIVEN_UP:
                    out.note(
                        f"displaced {twin.status.name}", f"{where}, {c.names.states[i]} {share:g}, sample {sample}"
                    )


def _moved(c: Controller, value: float) -> Array:
    reference = np.array([r.reference for r in c.description.residuals])
    reference[0] = value
    return reference


def _judge(c: Controller, out: Outcome, where: str) -> None:
    if c.status != Status.OK:
        out.note(c.status.name, f"{where}: {c.diagnose().splitlines()[0]}")
    if c.stats.iterations > 1:
        out.note("iterated", where)
    tiny = np.finfo(c.x.dtype).tiny
    for values in (c.x, c.u):
        if np.any((values != 0) & (np.abs(values) < tiny)):
            out.note("denormal", where)


def _solve(c: Controller, x: Array, random: np.random.Generator, out: Outcome, where: str) -> None:
    """Solve from the plan, and from one whose zeros are rounding errors of another magnitude."""
    magnitude = 10.0 ** -random.uniform(16, 80 if c.x.dtype == np.float64 else 30)
    for what in ("as it is", f"zeros of {magnitude:.0e}"):
        for plan in (c.x, c.u) if what != "as it is" else ():
            plan[np.abs(plan) < 1e-9] = magnitude
        solution = c.copy().solve(x)
        if solution.status != Status.OK:
            out.note(f"solve {solution.status.name}", f"{where}, {what}: {solution.kkt}")
        elif solution.iterations > MOST_ITERATIONS:
            out.note("solve takes long", f"{where}, {what}: {solution.iterations}")


# -- other units ------------------------------------------------------------------------------------------------------

#: Plants whose sizes are declared: by bounds, initial values or references.
IN_UNITS = (
    "standstill",
    "pushed",
    "fan",
    "on_row",
    "circle",
    "closed_valve",
    "empty_store",
    "drone",
    "reactor",
    "mass",
)


def differences(name: str, seed: int) -> list[str]:
    """Return the differences in a loop, and in solve(), between a problem and the same one in random units."""
    plant, found = PLANTS[name], []
    ocp = plant.make()
    units = Units.of(ocp, seed)
    c, d = build(ocp, profile="test"), build(in_units(ocp, units), profile="test")
    x = np.array([np.random.default_rng([8, seed]).uniform(*span) for span in plant.starts])
    start = x
    size = np.maximum(1e-6, np.array(c.description.scales[x.size :]))
    for sample in range(IN_LOOP):
        u, v = c.step(x), d.step(x / units.x) * units.u
        if c.status != d.status:
            found.append(f"sample {sample} {c.status.name} {d.status.name}")
        elif c.stats.iterations != d.stats.iterations:
            found.append(f"sample {sample} iterations {c.stats.iterations} {d.stats.iterations}")
        elif not np.all(np.abs(u - v) <= 1e-5 * size):
            found.append(f"sample {sample} controls {u} {v}")
        x = np.asarray(c.integrate(x, u, float(c.description.dt[0])), dtype=float)
    a, b = build(ocp, profile="test").solve(start), build(in_units(ocp, units), profile="test").solve(start / units.x)
    if a.status != b.status or abs(a.iterations - b.iterations) > 1:
        found.append(f"solve() {a.status.name} {a.iterations}, {b.status.name} {b.iterations}")
    return found
