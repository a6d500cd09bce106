"""Cart whose position alone is measured, on a slope that nobody knows: an estimator beside the controller.

What it shows: an estimator that shares the model of the controller, an unknown parameter that it finds and the
controller uses, measurements that are missing or grossly wrong, and the extended Kalman filter on the same data.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Estimator, Log, build, simulate

DT, N = 0.05, 20  # s; intervals of the controller and of the estimator
NOISE = 0.004  # m, standard deviation of a measurement
SAMPLES, JUMP, TILT = 240, 80, 160  # the reference jumps and the slope changes at these samples
MASS, DRAG = 0.5, 0.4  # kg, N s/m


def build_ocp() -> OCP:
    """Go to the reference, on a slope (m/s^2) that is a parameter; at most 1.5 N, and 0.6 m/s if that is possible."""
    ocp = OCP("cart", T=N * DT, N=N)
    p, v = ocp.state("p", unit="m"), ocp.state("v", unit="m/s")
    F = ocp.control("F", unit="N")
    slope = ocp.parameter("slope", unit="m/s^2")
    ocp.dynamics({p: v, v: (F - DRAG * v) / MASS + slope})
    ocp.least_squares(ca.vertcat(p, v, F + MASS * slope), weight=[20, 1, 0.2], names=["p", "v", "push"])
    ocp.terminal_least_squares(ca.vertcat(p, v), weight=[200, 20])
    ocp.subject_to(-1.5, F, 1.5)
    ocp.subject_to(-0.6, v, 0.6, soft=(50, 50))
    return ocp


def build_estimator(ocp: OCP, kind: str = "mhe") -> Estimator:
    """p, v and the slope from p: the speed changes by 2 mm/s and the slope by 0.02 m/s^2 from sample to sample."""
    found: Estimator = ocp.estimator(
        N=N,
        measure={"p": ocp.x[0]},
        noise_std={"p": NOISE},
        process_std={"v": 0.002, "slope": 0.02},
        initial_std={"p": 0.1, "v": 0.1, "slope": 0.5},
        loss="huber",
        kind=kind,
    )
    return found


def run(seed: int = 1) -> Log:
    """12 s of the loop: the reference jumps at 4 s, the slope at 8 s."""
    ocp, k = build_ocp(), np.arange(SAMPLES)
    return simulate(
        build(ocp),
        [0, 0],
        SAMPLES,
        estimator=build(build_estimator(ocp)),
        seed=seed,
        parameters={"slope": np.where(k < TILT, -0.3, 0.4)},
        references={"p": np.where(k < JUMP, 0.5, -0.2)},
    )


def compare(log: Log, seed: int = 2) -> dict[str, float]:
    """Errors (m/s) of the speed with the data of the loop, of which 30 % are missing and 5 % wrong by 0.2 m."""
    assert log.estimates is not None
    random, y = np.random.default_rng(seed), log.estimates.y.copy()
    y[random.uniform(size=y.shape) < 0.05] += 0.2
    y[random.uniform(size=y.shape) < 0.3] = np.nan
    errors = {}
    for kind in ("mhe", "ekf"):
        observer, before = build(build_estimator(build_ocp(), kind)), np.zeros((1, 1))
        found = np.array([observer.step(*data) for data in zip(y, np.vstack([before, log.u[:-1]]), strict=True)])
        errors[kind] = float(np.sqrt(np.mean((found[:, 1] - log.x[:-1, 1]) ** 2)))
    return errors


def main(picture: str = "out/estimation.png") -> tuple[Log, dict[str, float]]:
    """Run the loop, draw it, and compare the two estimators."""
    log = run()
    print(log.summary())
    errors = compare(log)
    for kind, error in errors.items():
        print(f"{kind} with data that are missing or wrong: error of the speed {1e3 * error:.1f} mm/s")
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    log.plot(picture)
    return log, errors


if __name__ == "__main__":
    main(*sys.argv[1:])
