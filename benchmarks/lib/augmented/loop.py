"""The bioreactor in closed loop with the augmented Lagrangian, undisturbed and after jumps of the state.

Hours, Shukla and Jones, section V: 48 h in 20 intervals, M = 3, rho = 100. The plan starts on a simulated orbit; the
controller integrates with 3 RK4 steps per interval, the plant with 20.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.lib import callgrind
from benchmarks.lib.augmented import instructions
from benchmarks.lib.report import Report
from examples import bioreactor
from nmpc_codegen import (
    RK4,
    AugmentedLagrangian,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    Mirror,
    Options,
    build,
)
from nmpc_codegen.package.status import Stats
from verification.routes import PURE

SAMPLES, JUMP = 160, 80
JUMPS = {"undisturbed": (1.0, 1.0, 1.0), "S +20 %": (1.0, 1.2, 1.0), "X +10 %": (1.1, 1.0, 1.0)}
#: Productivity of the optimal orbit, g/(L h).
OPTIMUM = 3.0548


@dataclass(frozen=True, eq=False)
class Loop:
    """States (samples, nx), controls (samples, nu), statistics and times (us) of the samples."""

    x: np.ndarray
    u: np.ndarray
    stats: tuple[Stats, ...]
    us: np.ndarray
    failed: int


#: The controller of the paper, and the real-time iteration with the exact Hessian, mirrored where it is indefinite.
AUGMENTED = Options(
    integrator=ExplicitRungeKutta(RK4, steps=3),
    algorithm=AugmentedLagrangian(iterations=3, penalty=100.0, proximal=0.1, scaling="units", shift="periodic"),
)
EXACT = Options(
    integrator=ExplicitRungeKutta(RK4, steps=3),
    hessian=ExactHessian(Mirror(level="reduced")),
    algorithm=replace(PURE, shift="periodic"),
)


def built(options: Options) -> Controller:
    """The bioreactor with soft periodicity."""
    return build(bioreactor.build_ocp(soft=True), options)


@cache
def plant() -> Controller:
    """The bioreactor with 20 RK4 steps per interval."""
    return build(
        bioreactor.build_ocp(soft=True), replace(bioreactor.options(), integrator=ExplicitRungeKutta(RK4, steps=20))
    )


def run(loop: Controller, jump: Sequence[float], samples: int = SAMPLES) -> Loop:
    """Simulate from the orbit of a 40/28.7 feed; X, S, P are multiplied by ``jump`` before sample 80."""
    process = plant()
    bioreactor.guess(loop)
    x = loop.x[0].copy()
    states, controls, stats, failed = [], [], [], 0
    for n in range(samples):
        if n == JUMP:
            x[:3] *= jump
        x[3:] = 0.0
        u = loop.step(x)
        failed += loop.status != 0
        states.append(x.copy())
        controls.append(u.copy())
        stats.append(loop.stats)
        x = np.asarray(process.integrate(x, u, bioreactor.SAMPLING))
    us = np.array([(s.prepare_ns + s.feedback_ns) / 1e3 for s in stats])
    return Loop(np.array(states), np.array(controls), tuple(stats), us, failed)


def fastest(make: Controller, jump: Sequence[float], repeats: int) -> tuple[Loop, np.ndarray]:
    """A loop, and the least time of every sample over some repeats, which run the same computations."""
    loops = []
    for _ in range(repeats):
        make.reset()
        loops.append(run(make, jump))
    return loops[0], np.min([loop.us for loop in loops], axis=0)


def measure(report: Report, scale: float) -> None:
    """Productivity and feed of the last 48 h, times, conjugate-gradient iterations."""
    found: dict[str, tuple[Loop, np.ndarray]] = {}
    repeats = max(1, round(5 * scale))
    for name, jump in JUMPS.items():
        loop, us = found[name] = fastest(built(AUGMENTED), jump, repeats)
        produced = bioreactor.productivity(loop, SAMPLES - bioreactor.N, SAMPLES)  # type: ignore[arg-type]
        report.add("closed_loop_productivity", produced, "g/(L h)", case=name, limit=0.99 * OPTIMUM, at_least=True)
        report.add("productivity_error", abs(produced / OPTIMUM - 1), case=name, limit=0.01)
        feed = float(np.mean(loop.u[-bioreactor.N :]))
        report.add("average_feed", feed, "g/L", case=name)
        report.add("average_feed_error", abs(feed - 32.9), "g/L", case=name, limit=0.1)
        report.add("average_us", float(np.mean(us)), "us", case=name, n=repeats, limit=70.0)
        report.add("worst_over_median", float(us.max() / np.median(us)), case=name, n=repeats, limit=3.0)
        report.add("cg_iterations", float(np.mean([s.cg_iterations for s in loop.stats])), "per sample", case=name)
        report.add("failed", loop.failed, case=name, limit=0)
        _, exact = fastest(built(EXACT), jump, repeats)
        report.add("exact_real_time_us", float(np.mean(exact)), "us", case=name, n=repeats)
        report.add("exact_worst_over_median", float(exact.max() / np.median(exact)), case=name, n=repeats)
        if callgrind.available():
            for key, options in (("average_instructions", AUGMENTED), ("exact_instructions", EXACT)):
                count = instructions.per_sample(bioreactor.build_ocp(soft=True), options, jump)
                if count is not None:
                    report.add(key, count, "instructions", case=name, profile="fast, AVX2")
    draw(found, Path("out/augmented_lagrangian.png"))


def draw(found: dict[str, tuple[Loop, np.ndarray]], picture: Path) -> None:
    """Figures 1 and 2 of the paper: feed, times and cumulative conjugate-gradient iterations per sample."""
    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    for name, (loop, us) in found.items():
        axes[0].step(range(len(loop.u)), loop.u[:, 0], where="post", label=name)
        axes[1].plot(us)
        axes[2].plot(np.cumsum([s.cg_iterations for s in loop.stats]))
    for axis, label in zip(axes, ("feed [g/L]", "time [us]", "conjugate gradients, cumulative"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.25)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", frameon=False, ncols=3)
    axes[2].set_xlabel("sample")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=85)
