"""Times of a sample with exact Hessians and with a constant one: energy-optimal driving, and the evaporation process.

Every case is a closed loop with the model of the controller as plant, from the optimal steady state as first plan:
driving through a side step of 3 m, N = 100; the evaporation process with a disturbance every 50 samples, N = 200. Times
are those of the calls of prepare() and feedback() alone, about 0.3 us more than in C, on one core, in a single lane.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from benchmarks.lib.closed_loop import pinned_core
from benchmarks.lib.economic_problems import (
    DRIVING,
    DRIVING_STEPS,
    EVAPORATION,
    Array,
    Stage,
    driving,
    evaporation,
    steady,
    tuned,
)
from benchmarks.lib.report import Report
from nmpc_codegen import (
    OCP,
    RK4,
    Controller,
    EconomicGaussNewton,
    ExactHessian,
    ExplicitRungeKutta,
    Options,
    Status,
    build,
)

RUNS = 5


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop of ``samples`` samples of ``dt``; ``event`` changes the state or the controller before a sample."""

    key: str
    stage: Stage
    make: Callable[[], OCP]
    steps: int
    dt: float
    samples: int
    event: Callable[[int, Array, Controller], Array]
    limits: tuple[float | None, float | None] = (None, None)  # us, exact and constant


@dataclass(frozen=True)
class Figures:
    """Medians over the samples, minima over the runs, in us; the largest sample; failures; QP iterations on average."""

    total: float
    feedback: float
    worst: float
    failed: int
    iterations: float
    x: Array


def _side_step(n: int, x: Array, c: Controller) -> Array:
    c.set_parameter("py_ref", 3.0 if n >= 80 else 0.0) if n in (0, 80) else None
    return x


def _disturbance(n: int, x: Array, _: Controller) -> Array:
    random = np.random.default_rng(n)
    return x + np.array([abs(random.normal()), 3 * random.normal()]) if n % 50 == 0 else x


LOOPS = (
    Loop("driving", DRIVING, driving, DRIVING_STEPS, 0.1, 300, _side_step, (300.0, 150.0)),
    Loop("evaporation", EVAPORATION, evaporation, 1, 1.0, 400, _disturbance),
    Loop("evaporation_free_end", EVAPORATION, lambda: evaporation(fixed_end=False), 1, 1.0, 400, _disturbance),
)


def constant(loop: Loop, fixed_end: bool) -> EconomicGaussNewton:
    """M of the problem with its steady state."""
    at, (M, M_f), nx = steady(loop.stage), tuned(loop.stage), loop.stage.nx
    return EconomicGaussNewton(M, None if fixed_end else M_f, (at.w[:nx], at.w[nx:]))


def controller(loop: Loop, exact: bool) -> Controller:
    """The compiled controller, in a single lane."""
    hessian = ExactHessian() if exact else constant(loop, loop.key == "evaporation")
    options = Options(integrator=ExplicitRungeKutta(RK4, steps=loop.steps), hessian=hessian)
    return build(loop.make(), options, "fast", lanes=1)


@contextmanager
def _one_core() -> Iterator[None]:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, pinned_core())
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def started(loop: Loop, c: Controller) -> Array:
    """The steady state as plan, cyclic states at the rate of the model; returns the state."""
    at, nx = steady(loop.stage), loop.stage.nx
    c.reset()
    c.x[0], c.u[...] = at.w[:nx], at.w[nx:]
    for k in range(len(c.u)):
        c.x[k + 1] = at.w[:nx]
        for i in loop.stage.cyclic:
            c.x[k + 1, i] = c.integrate(c.x[k], c.u[k], loop.dt)[i]
    return np.array(at.w[:nx])


def run(loop: Loop, c: Controller) -> tuple[Array, Array, Array]:
    """(prepare ns, feedback ns, not OK, QP iterations) of every sample, (samples, 4), all controls, the last state."""
    x, rows, controls = started(loop, c), [], []
    for n in range(loop.samples):
        x = loop.event(n, x, c)
        u = c.step(x)
        stats = c.stats
        rows.append((stats.prepare_ns, stats.feedback_ns, c.status != Status.OK, stats.qp_iterations))
        controls.append(u)
        x = np.asarray(c.integrate(x, u, loop.dt))
    return np.array(rows, dtype=float), np.array(controls), x


def figures(loop: Loop, c: Controller, runs: int = RUNS) -> Figures:
    """Times of the loop; the runs are all alike."""
    with _one_core():
        found = [run(loop, c) for _ in range(runs)]
    tables = np.array([table for table, _, _ in found])
    total = (tables[:, :, 0] + tables[:, :, 1]) / 1e3
    return Figures(
        total=float(np.median(total, axis=1).min()),
        feedback=float(np.median(tables[:, :, 1] / 1e3, axis=1).min()),
        worst=float(total.min(axis=0).max()),
        failed=int(tables[:, :, 2].sum()),
        iterations=float(tables[:, :, 3].mean()),
        x=found[-1][2],
    )


def measure(report: Report) -> None:
    """<loop>_exact_us, <loop>_m_us: median of a sample; also the feedback phase, the worst sample, failures."""
    for loop in LOOPS:
        for word, exact, limit in zip(("exact", "m"), (True, False), loop.limits, strict=True):
            c = controller(loop, exact)
            f, n, key = figures(loop, c), loop.samples, f"{loop.key}_{word}"
            report.add(f"{key}_us", f.total, "us", n=n, limit=limit)
            report.add(f"{key}_feedback_us", f.feedback, "us", n=n)
            report.add(f"{key}_worst_us", f.worst, "us", n=n)
            report.add(f"{key}_failed", f.failed, n=n, limit=0)
            report.add(f"{key}_qp_iterations", f.iterations, n=n)
            report.add(f"{key}_bytes", c.nbytes, "bytes")
