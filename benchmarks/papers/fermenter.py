"""The closed loop of the bioreactor in [HSJ] runs with any controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from examples import bioreactor
from nmpc_codegen import OCP, RK4, AugmentedLagrangian, Controller, ExplicitRungeKutta, Options, Status, build
from verification.closed_loop import Scenario
from verification.robustness.work import Loop, Recorded, count

#: Productivity of the optimal orbit with an average feed of 32.9, and of the best steady state, g/(L h).
OPTIMUM, STEADY = 3.0549, 3.0165
JUMPS = {"undisturbed": (1.0, 1.0, 1.0), "S +20 %": (1.0, 1.2, 1.0), "X +10 %": (1.1, 1.0, 1.0)}
#: The paper's M = 3; its rho = 100 for unscaled gaps is 3,400 to 42,000 in the scales of the states.
OPTIONS = Options(
    integrator=ExplicitRungeKutta(RK4, steps=3),
    algorithm=AugmentedLagrangian(iterations=3, penalty=2e4, proximal=0.1, shift="periodic"),
)


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples have states (n, nx), controls (n, nu), conjugate gradients (n,), times in us (n,), and failures."""

    x: np.ndarray
    u: np.ndarray
    gradients: np.ndarray
    us: np.ndarray
    failed: int

    def operations(self) -> np.ndarray:
        """Count the operations of every sample."""
        samples = len(self.u)
        recorded = Recorded([], [(None, x) for x in self.x], self.u, np.zeros(samples, dtype=bool))
        counted = Loop("bioreactor", reactor, OPTIONS, Scenario(self.x[0], bioreactor.SAMPLING, samples))
        return count(counted, recorded, optimise=samples > bioreactor.N)[0].operations


def reactor() -> OCP:
    """Return the OCP of the bioreactor with soft periodicity."""
    return bioreactor.build_ocp(soft=True)


def drive(controller: Controller, jump: Sequence[float], samples: int) -> Samples:
    """Run the loop from the orbit of a 40/28.7 feed.

    X, S, P jump at half time. The plant takes 20 RK4 steps per interval.
    """
    process = build(reactor(), replace(bioreactor.options(), integrator=ExplicitRungeKutta(RK4, steps=20)))
    bioreactor.guess(controller)
    x, states, controls, stats, failed = controller.x[0].copy(), [], [], [], 0
    for n in range(samples):
        x[:3] *= jump if n == samples // 2 else 1.0
        x[3:] = 0.0
        controls.append(controller.step(x).copy())
        failed += controller.status != 0
        states.append(x.copy())
        stats.append(controller.stats)
        x = np.asarray(process.integrate(x, controls[-1], bioreactor.SAMPLING))
    gradients, us = ([s.cg_iterations for s in stats], [(s.prepare_ns + s.feedback_ns) / 1e3 for s in stats])
    return Samples(np.array(states), np.array(controls), np.array(gradients), np.array(us), failed)


@cache
def loop(jump: Sequence[float], samples: int) -> Samples:
    """Run the loop of the paper's controller."""
    return drive(build(reactor(), OPTIONS), jump, samples)


def productivity(found: Samples) -> float:
    """Return the productivity of the last 48 h."""
    n = len(found.u)
    return bioreactor.productivity(found, n - min(n, bioreactor.N), n)  # type: ignore[arg-type]


def iterations(controller: Any, spread: float, seed: int) -> float:
    """Count full steps from a perturbed state and random feeds to the solution; inf if there are more than 60."""
    random = np.random.default_rng(seed)
    controller.reset()
    x0 = bioreactor.START.copy()
    x0[:3] *= 1 + spread * random.uniform(-1, 1, 3)
    controller.x[...] = x0
    controller.u[...] = random.uniform(bioreactor.LOWEST, bioreactor.HIGHEST, controller.u.shape)
    found = controller.solve(x0, tol=1e-8, max_iterations=60, globalization="full_step")
    return float(found.iterations) if found.status == Status.OK else np.inf
