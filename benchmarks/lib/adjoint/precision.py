"""Single precision: samples and solves that are OK in double precision alone, over many starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.lib.report import Report
from examples import crane, cstr
from nmpc_codegen import OCP, AdjointShooting, Options, Status, build

STARTS, SAMPLES = 100, 12
TOL, ITERATIONS = 1e-4, 100


@dataclass(frozen=True, eq=False)
class Plant:
    """A problem, how its plan moves, and starts ``centre`` +- ``spread`` of closed loops."""

    make: Callable[[], OCP]
    algorithm: AdjointShooting
    dt: float
    centre: np.ndarray
    spread: np.ndarray


PLANTS = {
    "crane": Plant(crane.build_ocp, AdjointShooting(shift="repeat"), 0.3, np.zeros(4), np.array([2.0, 0.3, 0.15, 0.3])),
    "CSTR": Plant(
        cstr.build_ocp,
        AdjointShooting(shift="resample", sampling_time=cstr.SAMPLING),
        cstr.SAMPLING,
        cstr.START,
        np.array([0.5, 0.3, 5.0, 5.0]),
    ),
}


def measure(report: Report) -> None:
    """False statuses of samples, from the first one of a loop on, and of solve()."""
    for case, plant in PLANTS.items():
        found = false_statuses(plant)
        for what, (false, good) in found.items():
            report.add("shooting_single_false_status", false, case=f"{case}, {what}", n=good, limit=0)


def false_statuses(plant: Plant) -> dict[str, tuple[int, int]]:
    """By kind of call: calls that are OK in double precision alone, and all that are. Both see the same states."""
    given = {p: Options(algorithm=plant.algorithm, precision=p) for p in ("double", "single")}
    double, single = (build(plant.make(), options) for options in given.values())
    starts = plant.centre + plant.spread * np.random.default_rng(7).uniform(-1, 1, (STARTS, plant.spread.size))
    calls: dict[str, list[tuple[Status, Status]]] = {"first sample": [], "later samples": [], "solve()": []}
    for start in starts:
        for controller in (double, single):
            controller.reset()
        x = start
        for n in range(SAMPLES):
            u = double.step(x)
            single.step(x)
            calls["later samples" if n else "first sample"].append((double.status, single.status))
            x = np.asarray(double.integrate(x, u, plant.dt))
        for controller in (double, single):
            controller.reset()
            controller.solve(start, tol=TOL, max_iterations=ITERATIONS)
        calls["solve()"].append((double.status, single.status))
    good = {what: [b for a, b in pairs if a is Status.OK] for what, pairs in calls.items()}
    return {what: (sum(b is not Status.OK for b in found), len(found)) for what, found in good.items()}
