"""[T09]: the heat equation has many states and few controls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.lib.run import Run
from benchmarks.papers.exhibit import Check, Exhibit, Table, curves, save, sheet
from examples import heat_rod
from nmpc_codegen import (
    RK4,
    ExplicitRungeKutta,
    NoCondensing,
    Options,
    RiccatiActiveSet,
    build,
    derivatives,
    simulate,
)
from verification.adjoint import measured, problems


def figure_6_14(run: Run) -> Exhibit:
    """Draw the zero-input and zero-state response of the rod of 50 states."""
    N, nx = run.share(240, 20), 50
    case = problems.rod(nx, N, sample=1.0, heated=False)
    tools: Any = derivatives.build(case.ocp, None, case.options)
    free = tools.simulate(case.x0, np.zeros((N, 1))).x
    forced = tools.simulate(np.zeros(nx), np.sin(2 * np.pi * np.arange(N) / 120)[:, None]).x
    figure, axes = sheet(1, 2, 4.2, 2.8)
    place, t = np.arange(1, nx + 1) / (nx + 1), np.arange(N + 1)
    for axis, values, title in ((axes[0, 0], free, "(a) zero input"), (axes[0, 1], forced, "(b) zero state")):
        figure.colorbar(axis.pcolormesh(place, t, values, cmap="coolwarm", shading="nearest", vmin=-1, vmax=1), ax=axis)
        axis.set(xlabel="place", ylabel="t [s]", title=title)
    error = np.abs(free[-1] - np.linalg.matrix_power(problems.rod_step(nx), N) @ case.x0).max() / np.abs(case.x0).max()
    return Exhibit(
        "Fig. 6.14",
        "heat equation, 50 states",
        "agrees with",
        "Two warm places flow together, and a controlled end sends damped waves; the last state differs by "
        f"{error:.0e} from powers of the matrix of a step.",
        pictures=[save(figure, run, "t09_figure_6_14", "Fig. 6.14")],
        checks=[Check("rod: zero-input response against powers of a matrix", float(error), 1e-12)],
    )


def figure_6_15(run: Run) -> Exhibit:
    """Count the operations of both algorithms over the number of states."""
    sizes = (5, 10, 20, 40, 60, 80, 100, 140, 200)[: run.share(9, 3)]
    make: Callable[[int], problems.Case] = lambda nx: problems.rod(nx, 10, unroll="none")  # noqa: E731
    counts = np.array([measured.integration(make(nx)) for nx in sizes])
    figure, axes = sheet(1, 1, 5.0, 2.8)
    curves(axes[0, 0], sizes, {"6.7": counts[:, 0], "6.8": counts[:, 1]}, log="xy", xlabel="nx", ylabel="operations")
    powers = [measured.exponent(sizes, c, sizes[len(sizes) // 2]) for c in counts.T]
    better = measured.crossover(make, 10)
    return Exhibit(
        "Fig. 6.15",
        "integration of sensitivities over the states of the rod",
        "agrees with",
        f"Algorithm 6.7 grows with nx to the power {powers[0]:.2f}, 6.8 with {powers[1]:.2f}; with N = 10 and two "
        f"(thesis: one) controls 6.8 takes fewer operations from {better} states on.",
        pictures=[save(figure, run, "t09_figure_6_15", "Fig. 6.15: 6.8 wins with many states, as in the thesis")],
    )


def memory(run: Run) -> Exhibit:
    """Compare bytes and time of a sample with multiple shooting, for the heat rod with 100 states and two controls."""
    states, options = run.share(heat_rod.STATES, 10), heat_rod.options()
    integrator = ExplicitRungeKutta(RK4, steps=heat_rod.STEPS)
    stages = Options(
        integrator, None, NoCondensing(), RiccatiActiveSet(fallback=None), online=options.online, solve=False
    )
    rows = []
    for name, given in (("adjoint shooting", options), ("multiple shooting, stages", stages)):
        controller = build(heat_rod.build_ocp(states), given)
        log = simulate(controller, np.full(states, heat_rod.START), steps=run.share(40, 2), dt=heat_rod.INTERVAL)
        us = float(np.median(log.time_ns)) / 1e3
        rows.append((name, controller.nbytes / 1e3, us))
    return Exhibit(
        "Section 6.7",
        f"memory of single and multiple shooting with {states} states and two controls",
        "extends",
        f"Adjoints need no matrix of the model: {rows[0][1]:.0f} kB instead of {rows[1][1]:,.0f} kB.",
        tables=[Table(("struct, kB", "sample, us"), rows)],
    )


EXHIBITS = {"Fig. 6.14": figure_6_14, "Fig. 6.15": figure_6_15, "Section 6.7": memory}
