"""[T09]: the operations of gradients and impulse responses of single shooting are counted.

rod.py has its heat equation, rows.py has chapter 7.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from benchmarks.lib.run import Run
from benchmarks.papers.exhibit import BLUE, GREEN, ORANGE, RED, Check, Exhibit, Table, curves, save, sheet
from examples import adjoint_gradient, vandevusse
from nmpc_codegen import derivatives
from verification.adjoint import choice, measured, problems
from verification.adjoint.oracle import normwise

PAPER = '"Adjoint-based derivative evaluation methods for nonlinear model predictive control", thesis, NTNU 2009'
HORIZONS = (10, 25, 50, 100, 150, 200, 300, 400)
STATES = ("cA", "cB", "T", "Tc")


def figure_6_3(run: Run) -> Exhibit:
    """Draw the stabilised map (6.31)."""
    x, u = adjoint_gradient.stabilised(10)
    figure, axes = sheet(1, 2)
    curves(axes[0, 0], range(11), {"x1": x[:, 0], "x2": x[:, 1]}, xlabel="k", title="states")
    curves(axes[0, 1], range(10), {"u1": u[:, 0], "u2": u[:, 1]}, xlabel="k", title="controls")
    case = problems.discrete_map(10)
    tools: Any = derivatives.build(case.ocp, case.outputs, case.options)
    tools.p[...] = case.p
    exact = case.model.derivatives(case.x0, case.u, case.p)["gradient"]
    errors = {m: normwise(tools.gradient(case.x0, case.u, m), exact) for m in derivatives.GRADIENTS}
    worst = max(value for m, value in errors.items() if m != "finite_differences")
    return Exhibit(
        "Fig. 6.3",
        "solution of the discrete model (6.31), and its gradient",
        "agrees with",
        f"Forward and adjoint gradients differ by {worst:.0e} from CasADi's of the whole simulation (thesis: 1e-16 "
        f"between them), those of finite differences by {errors['finite_differences']:.0e}.",
        pictures=[save(figure, run, "t09_figure_6_3", "Fig. 6.3")],
        checks=[Check("map (6.31): gradients against CasADi, relative", worst, 1e-14)],
    )


def figure_6_4(run: Run) -> Exhibit:
    """Count the operations of a gradient over the horizon."""
    horizons = HORIZONS[: run.share(len(HORIZONS), 4)]
    methods = {"finite differences": "finite_differences", "forward": "forward", "adjoint": "adjoint"}
    found: dict[str, list[float]] = {word: [] for word in methods}
    for N in horizons:
        counts = measured.counts(problems.discrete_map, N)
        for word, method in methods.items():
            matrices = counts.sensitivities.total * (method == "forward")
            found[word].append(counts.all[f"gradient_{method}"].total + matrices)
    figure, axes = sheet(1, 2)
    curves(axes[0, 0], horizons, found, xlabel="N", ylabel="operations", title="(a)")
    curves(axes[0, 1], horizons, {"adjoint": found["adjoint"]}, xlabel="N", title="(b) adjoint alone")
    slopes = {word: measured.exponent(horizons, values, horizons[-2]) for word, values in found.items()}
    return Exhibit(
        "Fig. 6.4",
        "operations of the gradient over the horizon",
        "agrees with",
        f"Operations grow with N to the power {slopes['adjoint']:.2f} by the adjoint method, {slopes['forward']:.2f} "
        f"forward and {slopes['finite differences']:.2f} by finite differences (thesis: N, N^2, N^2).",
        pictures=[
            save(
                figure,
                run,
                "t09_figure_6_4",
                "Fig. 6.4: N for the adjoint method, N^2 for the others, as in the thesis",
            )
        ],
    )


# Reactor -------------------------------------------------------------------------------------------------------------


def figure_6_6(run: Run) -> Exhibit:
    """Draw the steady states over both controls."""
    flows = np.linspace(2.0, 40.0, run.share(77, 5))
    figure, axes = sheet(1, 4, 3.2, 2.8)
    for cooling, colour in zip((-8.0, -5.0, -2.0, 0.0), (BLUE, GREEN, ORANGE, RED), strict=True):
        x = problems.steady_states(flows, cooling)
        for i, axis in enumerate(axes[0]):
            axis.plot(flows, x[:, i], color=colour, label=f"u2 = {cooling:g} MJ/h")
            axis.set(xlabel="u1 [1/h]", title=STATES[i])
    axes[0, 1].legend(frameon=False, fontsize=8)
    ends = [vandevusse.steady_state(u)[1:3] for u in vandevusse.ENDS]
    off = float(np.abs(np.array(ends) - [[740.0, 87.0], [960.0, 106.0]]).max())
    return Exhibit(
        "Fig. 6.6",
        "steady states of the Van de Vusse reactor",
        "agrees with",
        f"cB has a maximum over u1; at both set points of section 7.4 cB and T are within {off:.2g} mol/m^3 and K of "
        "the rounded values.",
        pictures=[save(figure, run, "t09_figure_6_6", "Fig. 6.6: cB has a maximum over u1, as in the thesis")],
    )


def figures_6_7_to_6_9(run: Run) -> Exhibit:
    """Draw the simulation of an hour, and the sensitivities of every sample."""
    case = problems.reactor(run.share(50, 10))
    tools: Any = derivatives.build(case.ocp, case.outputs, case.options)
    x, (A, B) = tools.simulate(case.x0, case.u).x, tools.sensitivities(case.x0, case.u)
    t = np.arange(len(x)) * problems.SAMPLE
    figure, axes = sheet(3, 4, 3.0, 2.2)
    for i in range(4):
        axes[0, i].plot(t, x[:, i], color=BLUE)
        axes[0, i].set(title=f"{STATES[i]} (Fig. 6.7)")
        curves(axes[1, i], t[:-1], {f"/ d {name}": A[:, i, j] for j, name in enumerate(STATES)})
        axes[1, i].set(title=f"d {STATES[i]}+ (Fig. 6.8)")
        curves(axes[2, i], t[:-1], {"/ d u1": B[:, i, 0], "/ d u2": B[:, i, 1]}, xlabel="t [h]")
        axes[2, i].set(title=f"d {STATES[i]}+ (Fig. 6.9)")
    exact = case.model.derivatives(case.x0, case.u, case.p)["responses"]
    error = normwise(problems.chained(A, B), exact[0][1:])
    return Exhibit(
        "Figs. 6.7, 6.8, 6.9",
        "simulation of the reactor, sensitivities with respect to states and controls",
        "agrees with",
        "Inputs and initial state are those of the thesis, which prints no numbers; A_n-1 ... A_1 B_0 differs by "
        f"{error:.0e} from CasADi's derivative of the whole simulation.",
        pictures=[save(figure, run, "t09_figure_6_7", "Figs. 6.7, 6.8, 6.9")],
        checks=[Check("reactor: chained A_k, B_k against CasADi, relative", error, 1e-12)],
    )


def figure_6_10(run: Run) -> Exhibit:
    """Count the operations of the impulse response matrix from known matrices."""
    horizons = HORIZONS[: run.share(6, 4)]
    found: dict[str, list[float]] = {"forward": [], "adjoint": [], "alternative": [], "structure ignored": []}
    for N in horizons:
        counts = measured.counts(partial(problems.reactor, unroll="none"), N)
        for word, method in (("forward", "forward"), ("adjoint", "adjoint_matrices")):
            found[word].append(counts.all[f"impulse_response_{method}"].total)
        found["alternative"].append(counts.insertion.total)
        found["structure ignored"].append(measured.structure_ignored(counts))
    figure, axes = sheet(1, 1, 5.0, 3.0)
    curves(axes[0, 0], horizons, found, log="xy", xlabel="N", ylabel="operations")
    slopes = {word: measured.exponent(horizons, values, horizons[-2]) for word, values in found.items()}
    return Exhibit(
        "Fig. 6.10",
        "operations of the impulse response matrix over the horizon",
        "agrees with",
        f"The work grows as N^p: {', '.join(f'{way} {p:.2f}' for way, p in slopes.items())} (thesis: 2, 2, 2, 3).",
        pictures=[save(figure, run, "t09_figure_6_10", "Fig. 6.10: N^2, N^3 without structure, as in the thesis")],
    )


def table_6_7(run: Run) -> Exhibit:
    """Count the operations of Algorithms 6.7 and 6.8 in the three scenarios."""
    figure, axes = sheet(1, 3, 3.6)
    powers_of = []
    for axis, (title, (every, step, expected)), fig in zip(
        axes[0], measured.SCENARIOS.items(), (11, 12, 13), strict=True
    ):
        grids = every[:: -max(1, round(len(every) / run.share(20, 3)))][::-1]
        steps = [max(1, math.ceil(length / N / step - 1e-9)) for N, length in grids]
        cases = [problems.reactor(N, T / N, s, unroll="none") for (N, T), s in zip(grids, steps, strict=True)]
        counts = np.array([measured.integration(case) for case in cases])
        varies = [float(T if title == "N = 100" else N) for N, T in grids]
        label = "t_f [h]" if title == "N = 100" else "N"
        curves(axis, varies, {"6.7": counts[:, 0], "6.8": counts[:, 1]}, log="xy", xlabel=label)
        axis.set(title=f"Fig. 6.{fig}: {title}")
        powers = [measured.exponent(varies, c, varies[len(varies) // 2 - 1]) for c in counts.T]
        powers_of.append((title, *powers, *(f"{e}" for e in expected)))
    axes[0, 0].set_ylabel("operations")
    return Exhibit(
        "Table 6.7, Figs. 6.11, 6.12, 6.13",
        "integration of sensitivities over N, t_f and T_s",
        "differs from",
        "With fixed steps of one length the work grows as the thesis expects; its own times do so in Fig. 6.13 "
        "alone, as in Figs. 6.11 and 6.12 CVODES starts over with small steps at every sample.",
        tables=[
            Table(
                ("6.7, power", "6.8, power", "6.7, expected", "6.8, expected"),
                powers_of,
                "power of N (of t_f for N = 100)",
            )
        ],
        pictures=[
            save(figure, run, "t09_table_6_7", "Table 6.7, Figs. 6.11 to 6.13: the powers that the thesis expects")
        ],
    )


def tables_6_3_and_6_4(_: Run) -> Exhibit:
    """Count the operations of the algorithms on four problems."""
    tables = []
    for title, each in choice.tables().items():
        lines = [(name, *map(float, values)) for name, values in each.items()]
        tables.append(Table(list(choice.CASES), lines, f"{title}, operations"))
    return Exhibit(
        "Tables 6.3, 6.4",
        "operations of the algorithms for the gradient and for the impulse response matrix",
        "agrees with",
        "For a gradient, and for one row of the matrix, adjoint products, which the thesis does not consider, take "
        "the fewest operations on all four problems. Of the thesis' own methods the adjoint one takes the fewest on "
        "the first three; on the rod finite differences and 6.8 take fewer, as 6.7 integrates nx (nx + nu) "
        "sensitivities. For the whole matrix forward and adjoint methods take about as many; on the rod the "
        "alternative one takes a tenth of these, finite differences even fewer.",
        tables=tables,
    )


EXHIBITS = {
    "Fig. 6.3": figure_6_3,
    "Fig. 6.4": figure_6_4,
    "Tables 6.3, 6.4": tables_6_3_and_6_4,
    "Fig. 6.6": figure_6_6,
    "Figs. 6.7, 6.8, 6.9": figures_6_7_to_6_9,
    "Fig. 6.10": figure_6_10,
    "Table 6.7, Figs. 6.11, 6.12, 6.13": table_6_7,
}
