"""Estimators are compared with the Kalman filter, with a filter, and with all measurements."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.stiff import code_bytes
from nmpc_codegen import OCP, Observer, build, generate
from verification.estimation import LOOPS, PLANTS, Linear, Plant, estimate, full_information
from verification.estimation import run as run_plant

#: Distance from the Kalman filter; errors relative to the estimate from all measurements, and to those of the filter.
KALMAN, FULL, FILTER = 1e-10, 1.05, 1.0

#: Runs of a plant, loops, samples at which all measurements are used, fractions of missing and wrong measurements.
RUNS, FLIGHTS, POINTS, MISSING, OUTLIERS = 20, 20, 8, 0.3, 0.05

#: Error with bad sensors, relative to that with the same ones without outliers.
SURVIVES = 2.0


def measure(report: Report, asked: Run) -> None:
    """Measure all figures, with a line per plant."""
    for N in asked.cases((1, 5, 20)):
        report.add("distance from the Kalman filter", _distance(N, asked.seed), case=f"linear, N = {N}", limit=KALMAN)
    for name in asked.cases(PLANTS):
        _compare(report, name, PLANTS[name], asked.share(RUNS, 2), asked.seed)
        _with_bad_sensors(report, name, PLANTS[name], asked.share(RUNS, 2), asked.seed)
    for name in asked.cases(LOOPS):
        _fly(report, name, asked.share(FLIGHTS, 2), asked.seed)


# -- linear -----------------------------------------------------------------------------------------------------------


def _distance(N: int, seed: int) -> float:
    """Return the largest distance of an estimate from the Kalman filter, in standard deviations.

    Three random plants have four states; 30 % of their measurements are missing.
    """
    rng, most = np.random.default_rng([N, seed]), 0.0
    for number in range(3):
        A, B, H = rng.normal(size=(4, 4)), rng.normal(size=(4, 1)), rng.normal(size=(2, 4))
        A *= 0.98 / np.max(np.abs(np.linalg.eigvals(A)))
        noise, process, initial = (10 ** rng.uniform(-2, 0, n) for n in (2, 4, 4))
        ocp = OCP(f"linear{number}", N=20)
        x, u = ocp.state("x", size=4), ocp.control("u")
        ocp.dynamics({x: ca.DM(A) @ x + ca.DM(B) @ u}, discrete=True)
        stated = {"measure": {"y": ca.DM(H) @ x}, "noise_std": {"y": noise}, "process_std": {x: process}}
        observer = build(ocp.estimator(N=N, **stated, initial_std={x: initial}), profile="test")
        controls, model = rng.normal(size=(100, 1)), Linear(A, B, H, np.diag(process**2), np.diag(noise**2))
        y = model.run(initial * rng.normal(size=4), controls, rng)
        y[rng.uniform(size=y.shape) < MISSING] = np.nan
        reference = model.filter(np.zeros(4), np.diag(initial**2), y, controls)
        for k, (expected, P) in enumerate(reference):
            found = observer.step(y[k], controls[k - 1] if k else None)
            most = max(most, float(np.max(np.abs(found - expected) / np.sqrt(np.diag(P)))))
    return most


# -- plants -----------------------------------------------------------------------------------------------------------


def _observers(plant: Plant, loss: str) -> dict[str, Observer]:
    return {kind: build(plant.estimator(kind=kind, loss=loss)) for kind in ("mhe", "ekf")}


def _rms(errors: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _compare(report: Report, name: str, plant: Plant, runs: int, seed: int) -> None:
    """Report errors in the scales of the states at some samples after the first window, time and bytes."""
    observers = _observers(plant, "squares")
    at = np.unique(np.linspace(plant.N, plant.samples - 1, POINTS).astype(int))
    errors: dict[str, list[np.ndarray]] = {"mhe": [], "ekf": [], "all": []}
    bad, times = 0, []
    for number in range(runs):
        found = run_plant(plant, np.random.default_rng([seed, number]))
        for kind, observer in observers.items():
            plant.begin(observer)
            estimates, statuses, of_samples = estimate(observer, found)
            errors[kind].append((estimates - found.x)[at] / plant.scale)
            bad += sum(s != 0 for s in statuses) if kind == "mhe" else 0
            times += of_samples if kind == "mhe" else []
        errors["all"].append(np.array([(full_information(plant, found, k) - found.x[k]) / plant.scale for k in at]))
    mhe, ekf, everything = (_rms(errors[kind]) for kind in ("mhe", "ekf", "all"))
    report.add("error, MHE", mhe, case=name, n=runs)
    report.add("error, MHE to EKF", mhe / ekf, case=name, n=runs, limit=FILTER)
    report.add("error, MHE to all measurements", mhe / everything, case=name, n=runs, limit=FULL)
    report.add("samples not OK", bad, case=name, n=runs * plant.samples)
    report.add("time per sample", float(np.median(times)) / 1e3, "us", case=name, n=len(times))
    for kind in ("mhe", "ekf"):
        sources = generate(plant.estimator(kind=kind))
        case = name if kind == "mhe" else f"{name}, filter"
        report.add("memory", sources.description.report.ram_bytes, "B", case=case)
        report.add("code", code_bytes(sources), "B", case=case)


def _with_bad_sensors(report: Report, name: str, plant: Plant, runs: int, seed: int) -> None:
    """Report errors with bad sensors relative to errors with the same missing measurements only.

    30 % of the measurements are missing, and 5 % are wrong by 20 to 60 standard deviations.
    """
    observer = _observers(plant, "huber")["mhe"]
    errors: dict[float, list[np.ndarray]] = {0.0: [], OUTLIERS: []}
    for number in range(runs):
        for outliers, of_runs in errors.items():
            found = run_plant(plant, np.random.default_rng([seed, number]), MISSING, outliers)
            plant.begin(observer)
            estimates, _, _ = estimate(observer, found)
            of_runs.append((estimates - found.x)[plant.N :] / plant.scale)
    report.add("error, outliers to none", _rms(errors[OUTLIERS]) / _rms(errors[0.0]), case=name, n=runs, limit=SURVIVES)


# -- loops ------------------------------------------------------------------------------------------------------------


def _fly(report: Report, name: str, count: int, seed: int) -> None:
    """Run closed loops of estimator and controller together."""
    loop = LOOPS[name]
    ocp, statement = loop.make()
    ctrl, observer = build(ocp), build(ocp.estimator(N=20, **statement))
    found = [loop.run(ctrl, observer, 1000 * seed + number) for number in range(count)]
    failed = sum(int(np.sum(log.estimates.status != 0)) for log, _ in found if log.estimates is not None)
    report.add("loops lost", sum(lost for _, lost in found), case=f"{name} loop", n=count, limit=0)
    report.add("estimates not OK", failed, case=f"{name} loop", n=count * loop.samples)
    report.add("controls not OK", sum(int(np.sum(log.status != 0)) for log, _ in found), case=f"{name} loop", n=count)
