"""Ten thousand cranes: ropes, damping and starts differ, gusts push the load, sensors are noisy.

What it shows: a batch, closed loops in compiled code on all cores, plants that differ from the model, random
disturbances, a summary of all flights, and the picture of their paths.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Flights, Options, RealTimeIteration, Uniform, batch

FLIGHTS, SAMPLES = 10_000, 60


def build_ocp() -> OCP:
    """The overhead crane with a rope of length L and damping d: bring the load to the origin with |a| <= 1 m/s^2, while
    the speed stays below 0.8 m/s and the load does not swing far."""
    ocp = OCP("many_cranes", T=3.0, N=15)
    p = ocp.state("p", unit="m", initial=2.0)
    v = ocp.state("v", unit="m/s")
    phi = ocp.state("phi", unit="rad")
    omega = ocp.state("omega", unit="rad/s")
    a = ocp.control("a", unit="m/s^2")
    L, d = ocp.parameter("L", value=1.0, unit="m"), ocp.parameter("d", value=0.2, unit="1/s")
    swing = -(9.81 * ca.sin(phi) + a * ca.cos(phi)) / L - d * omega
    ocp.dynamics({p: v, v: a, phi: omega, omega: swing})
    ocp.least_squares(ca.vertcat(ocp.x, a), weight=np.diag([1.0, 0.5, 2.0, 0.2, 0.1]))
    ocp.terminal_least_squares(ocp.x, weight=np.diag([10.0, 5.0, 10.0, 2.0]))
    ocp.subject_to(-1, a, 1)
    ocp.subject_to(-0.8, v, 0.8, soft=(50, 10))
    ocp.subject_to(-0.3, phi, 0.3, soft=(50, 10))
    return ocp


def run(flights: int = FLIGHTS, threads: int | None = None, record: bool = True) -> Flights:
    """The flights: the controllers know a rope of 1 m, the plants have one of 0.6 to 1.6 m."""
    random = np.random.default_rng(0)
    starts = random.uniform([1.0, -0.3, -0.1, -0.2], [2.5, 0.3, 0.1, 0.2], (flights, 4))
    options = Options(algorithm=RealTimeIteration(sampling_time=0.2))
    many = batch(build_ocp(), 1, options, threads=threads)
    return many.simulate(
        starts,
        SAMPLES,
        plant_parameters={
            "L": random.uniform(0.6, 1.6, (flights, 1)),
            "d": random.uniform(0.05, 0.4, (flights, 1)),
        },
        disturbance={"omega": 0.03},
        noise=Uniform({"p": 0.01, "v": 0.02, "phi": 0.01, "omega": 0.02}),
        seed=1,
        record=record,
    )


def main(picture: str = "out/many_cranes.png") -> Flights:
    """Fly, say how many went wrong, and draw all paths."""
    flights = run()
    print(flights.summary())
    arrived = np.abs(flights.last[:, 0]) < 0.1
    print(f"at the origin after {SAMPLES * flights.dt:g} s, within 0.1 m: {arrived.sum()} of {len(flights)}")
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    flights.plot(picture)
    return flights


if __name__ == "__main__":
    main(*sys.argv[1:])
