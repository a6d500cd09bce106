"""Closed loops in single against double precision: cost and statuses. Both drive the same plant in double."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.lib.firmware.loops import SAMPLES, disturbances, events
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from examples import driving, evaporation
from nmpc_codegen import OCP, Controller, ExplicitRungeKutta, Options, Status, build
from nmpc_codegen.economic import steady_state
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.options import PRECISIONS, Precision
from nmpc_codegen.oracle.trajectory import CLASSICAL, Tableau, interval_map, node_cost, node_data, scaled_weight
from verification.robustness.work import Loop, closed_loops

GAP = 1e-3

#: Before sample k of a loop: the controller's data, and the state of the plant.
Before = Callable[[int, Controller, Array], Array]


@dataclass(frozen=True, eq=False)
class Course:
    """A closed loop: its problem, options, first state, sampling time, first plan, and what happens before samples."""

    name: str
    make: Callable[[], OCP]
    options: Options
    x0: Array
    dt: float
    samples: int
    start: Callable[[Controller], None]
    before: Callable[[Controller], Before]


@dataclass(frozen=True, eq=False)
class Driven:
    """A loop: cost of every sample, status of every sample."""

    cost: Array
    status: Array


def cost_of(problem: Problem, steps: int) -> Callable[[Array, Array, Array], float]:
    """Stage cost (x, u, yref) with the declared weight and parameters, and the cost integrated over the interval."""
    cost = node_cost(problem.path)
    Phi = interval_map(problem, Tableau(CLASSICAL.A, CLASSICAL.b, steps))
    p, dt = problem.p_value, problem.dt[0]
    W = scaled_weight(problem, node_data(problem).W[0], 0)

    def value(x: Array, u: Array, yref: Array) -> float:
        return float(cost(x, u, p, dt, yref, W)) + float(Phi(x, u, p, dt)[1])

    return value


def drive(course: Course, precision: Precision, plant: Controller) -> Driven:
    """Run the loop with the controller in this precision."""
    controller = build(course.make(), replace(course.options, precision=precision), profile="verify")
    problem = classify(course.make())
    steps = getattr(controller_integrator(course.options), "steps", 1)
    value, before = cost_of(problem, steps), course.before(plant)
    course.start(controller)
    x, costs, statuses = course.x0, [], []
    for k in range(course.samples):
        x = before(k, controller, x)
        u = controller.step(x).astype(np.float64)
        yref = controller.view("yref")[0].astype(np.float64) if problem.path.ny else np.zeros(0)
        costs.append(value(x, u, yref))
        statuses.append(int(controller.status))
        x = np.asarray(plant.integrate(x, u, course.dt))
    return Driven(np.array(costs), np.array(statuses))


def controller_integrator(options: Options) -> object:
    """The integrator that is given, else the default."""
    return options.integrator or ExplicitRungeKutta()


def of_loop(loop: Loop, samples: int) -> Course:
    """A closed loop of the other benchmarks."""
    changes = events(loop.scenario, samples)

    def before(plant: Controller) -> Before:
        moved = disturbances(loop.scenario, plant)

        def at(k: int, controller: Controller, x: Array) -> Array:
            for event in (e for e in changes if e.sample == k):
                event.apply(controller)
            return moved(k, x)

        return at

    x0 = np.array(loop.scenario.x0, dtype=float)
    return Course(loop.name, loop.make, loop.options, x0, loop.scenario.dt, samples, lambda c: None, before)


def of_evaporation(samples: int) -> Course:
    """From 10 kPa above the best pressure back to it."""
    best = steady_state(evaporation.build_ocp(), evaporation.options())

    def start(controller: Controller) -> None:
        controller.x[...], controller.u[...] = best.x, best.u

    x0 = np.asarray(best.x) + np.array([0.0, 10.0])
    return Course(
        "evaporation", evaporation.build_ocp, evaporation.options(), x0, 1.0, samples, start, lambda plant: unchanged
    )


def of_driving(samples: int) -> Course:
    """Towards the obstacle, then into the other lane."""
    best = steady_state(driving.build_ocp(), driving.options())

    def start(controller: Controller) -> None:
        controller.x[...] = controller.x[0]
        controller.x[:, 2] = driving.SPEED
        controller.x[:, 0] = np.arange(driving.N + 1) * driving.SAMPLING * driving.SPEED
        controller.u[...] = best.u

    def at(k: int, controller: Controller, x: Array) -> Array:
        driving.schedule(k, controller)
        moved = round(driving.MOVE / driving.SAMPLING)
        return x - np.array([0.0, 2.0, 0, 0, 0]) if k == moved else x

    x0 = np.array([0.0, 0.0, driving.SPEED, 0.0, 0.0])
    return Course(
        "driving", driving.build_ocp, driving.options(), x0, driving.SAMPLING, samples, start, lambda plant: at
    )


def unchanged(k: int, controller: Controller, x: Array) -> Array:
    """Nothing happens."""
    return x


def courses(asked: Run) -> list[Course]:
    """Loops of all examples."""
    samples = asked.share(SAMPLES, 20)
    return [*(of_loop(loop, samples) for loop in closed_loops()), of_evaporation(samples), of_driving(samples)]


def single(report: Report, asked: Run) -> None:
    """Every loop in both precisions."""
    for course in asked.cases(courses(asked)):
        plant = build(course.make(), course.options, profile="verify")
        double, rounded = (drive(course, precision, plant) for precision in PRECISIONS)
        gap = abs(rounded.cost.sum() - double.cost.sum()) / abs(double.cost.sum())
        differs = int(np.sum((rounded.status != Status.OK) & (double.status == Status.OK)))
        words = sorted({Status(s).name for s in rounded.status[rounded.status != Status.OK]})
        note = f"{course.name}: {', '.join(words)}" if words else course.name
        report.add("float_cost_gap", gap, case=course.name, n=course.samples, limit=GAP, profile="verify")
        report.add("float_status_differs", differs, case=note, n=course.samples, limit=0, profile="verify")
        failed = int(np.sum(double.status != Status.OK))
        report.add("double_not_ok", failed, case=course.name, n=course.samples, profile="verify")
