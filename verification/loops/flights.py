"""A controller and solve() fly the same loops, and faults of the controller are found by comparison."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass

import numpy as np

from nmpc_codegen import Controller, Options, ProblemWarning, Status, build
from verification.loops.draw import GAIN, HELD, NOISE, POINTS, Array, Drawn
from verification.loops.plants import DRAWS

#: Excess of the simulated cost over that of solve(), relative to it.
DEARER = 0.05
#: Violation of a limit, relative to its width, that counts; distance from the set point, in sizes, that is an arrival.
LEFT, ARRIVED = 0.01, 0.1
#: Limits above which a loop of solve() is lost: distance from the last set point, in sizes, and samples not OK.
MISSED, FEW = 0.5, 3
#: Consecutive samples that may be OK although their relative KKT residual is above FAR, and that may fail.
MOST_FAR, MOST_FAILED, FAR = 5, 20, 0.1
#: Most iterations of solve() in a sample.
SOLVE_ITERATIONS = 200


@dataclass(frozen=True)
class Flight:
    """A flight is the result of a simulated loop.

    It has the cost, the largest violation of a limit, the distance from the last set point, statuses, QPs per sample,
    and the most consecutive samples that were OK far from a solution, or not OK.
    """

    cost: float
    violation: float
    distance: float
    statuses: Counter[str]
    iterations: float
    far: int
    failed: int

    @property
    def samples(self) -> int:
        return sum(self.statuses.values())

    @property
    def bad(self) -> int:
        """Return the number of samples that were not OK."""
        return self.samples - self.statuses["OK"]


@dataclass(frozen=True)
class Loop:
    """A loop is compared with the same loop by solve().

    ``counts``: solve() itself keeps its limits, arrives and hardly ever fails.
    """

    mine: Flight
    theirs: Flight
    faults: list[str]
    counts: bool


@dataclass(frozen=True)
class Judged:
    """A judged problem has its loops."""

    name: str
    loops: list[Loop]


class Course:
    """A course has the start, set points, noise and gain of a loop."""

    def __init__(self, drawn: Drawn, number: int) -> None:
        random = np.random.default_rng([drawn.seed, number])
        p = drawn.plant
        self.start = np.array([random.uniform(*range_) for range_ in p.start])
        self.points = np.array([[random.uniform(*range_) for range_ in p.points] for _ in range(POINTS)])
        self.noise = NOISE * (number % 2) * random.normal(size=(POINTS * HELD, len(p.states))) * np.array(p.sizes)
        self.gain = 1 + GAIN * (number % 3 - 1) * (number % 2)


def fly(drawn: Drawn, controller: Controller, course: Course, solve: bool) -> Flight:
    """Simulate one loop with a fresh plan."""
    p, plant, stage = drawn.plant, drawn.step(), drawn.stage()
    controller.reset()
    for j, (lower, upper) in enumerate(p.controls.values()):
        controller.u[:, j] = lower + drawn.first * (upper - lower)
    x, cost, violation, iterations = course.start.copy(), 0.0, 0.0, 0
    statuses: Counter[str] = Counter()
    far, failed, runs = 0, 0, [0, 0]
    for k in range(POINTS * HELD):
        point = course.points[k // HELD]
        if p.cost is None and k % HELD == 0:
            names = [p.states[i] for i in p.tracked]
            controller.set_reference(dict(zip(names, map(float, point), strict=True)))
            controller.set_terminal_reference(
                dict(zip([f"{name}_end" for name in names], map(float, point), strict=True))
            )
        measured = x + course.noise[k]
        u = controller.solve(measured, max_iterations=SOLVE_ITERATIONS).u[0] if solve else controller.step(measured)
        statuses[controller.status.name] += 1
        iterations += controller.stats.iterations
        ok = controller.status == Status.OK
        runs = [runs[0] + 1 if ok and controller.kkt().relative > FAR else 0, 0 if ok else runs[1] + 1]
        far, failed = max(far, runs[0]), max(failed, runs[1])
        cost += float(stage(x, u, point))
        x = np.asarray(plant(x, _with_gain(drawn, u, course.gain))).ravel()
        if not np.all(np.isfinite(x)):
            return Flight(np.inf, np.inf, np.inf, statuses, iterations / (k + 1), far, failed)
        for name, (lower, upper) in p.limits.items():
            value, width = x[p.states.index(name)], upper - lower
            violation = max(violation, (lower - value) / width, (value - upper) / width)
    distance = 0.0 if p.cost else max(abs(x[i] - point[n]) / p.sizes[i] for n, i in enumerate(p.tracked))
    return Flight(cost, violation, distance, statuses, iterations / (POINTS * HELD), far, failed)


def _with_gain(drawn: Drawn, u: Array, gain: float) -> Array:
    """Return the control as the plant receives it, with another gain about the first one."""
    bounds = np.array(list(drawn.plant.controls.values()))
    at = bounds[:, 0] + drawn.first * (bounds[:, 1] - bounds[:, 0])
    return np.asarray(np.clip(at + gain * (np.asarray(u) - at), bounds[:, 0], bounds[:, 1]))


def judge(draw: str, number: int, loops: int, options: Options | None = None) -> Judged:
    """Simulate loops of a drawn problem with these options, and with solve() of the default ones in every sample."""
    drawn = DRAWS[draw]()[number]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        controller, solver = build(drawn.ocp(), options), build(drawn.ocp())
    found = []
    for course in (Course(drawn, n) for n in range(loops)):
        mine, theirs = fly(drawn, controller, course, False), fly(drawn, solver, course, True)
        counts = theirs.violation <= LEFT and theirs.distance <= MISSED and theirs.bad <= FEW
        found.append(Loop(mine, theirs, faults(mine, theirs) if counts else [], counts))
    return Judged(drawn.name, found)


def faults(mine: Flight, theirs: Flight) -> list[str]:
    """Return the faults of a loop that the loop of solve() does not have."""
    found = []
    if mine.cost > theirs.cost + DEARER * abs(theirs.cost):
        found.append(f"cost {mine.cost:.4g} instead of {theirs.cost:.4g}")
    if mine.violation > LEFT >= theirs.violation:
        found.append(f"limit left by {mine.violation:.2g}")
    if mine.distance > max(ARRIVED, 2 * theirs.distance):
        found.append(f"{mine.distance:.2g} from the set point, solve() {theirs.distance:.2g}")
    if mine.far > MOST_FAR:
        found.append(f"OK while far {mine.far} in a row")
    if mine.failed > MOST_FAILED:
        found.append(f"not OK {mine.failed} in a row")
    return found
