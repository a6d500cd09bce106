"""The Van de Vusse reactor: Fig. 6.6, steady states; Fig. 6.7, a simulation; Figs. 6.8 and 6.9, its sensitivities."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.lib.adjoint import drawing
from benchmarks.lib.report import Report
from nmpc_codegen import derivatives
from verification.adjoint import problems

STATES = ("cA [mol/m$^3$]", "cB [mol/m$^3$]", "T [degC]", "Tc [degC]")
CONTROLS = ("u$_1$ [1/h]", "u$_2$ [MJ/h]")
SHADES = ("#08306b", "#2171b5", "#6baed6", "#c2571a")

#: Controls -> cB and T of the steady state, as given for the ramp of section 7.4 (rounded there to 740, 87, 960, 106).
KNOWN = {(8.256, -6.239): (739.7, 86.99), (18.037, -4.556): (959.9, 106.0)}


def steady_state(u: tuple[float, float], guess: np.ndarray) -> np.ndarray:
    """The root of (6.32) next to the guess; NaN if Newton's method finds none."""
    x, v = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    equations = {"x": x, "p": v, "g": ca.vertcat(*problems.reactor_rates(x, v))}
    options = {"abstol": 1e-8, "max_iter": 100, "error_on_fail": False}  # rates are of order 1e4
    solver = ca.rootfinder("steady", "newton", equations, options)
    found = np.array(solver(guess, u)).reshape(4)
    return found if solver.stats()["success"] else np.full(4, np.nan)


def steady_states(u1: np.ndarray, u2: float) -> np.ndarray:
    """States (len(u1), 4) along u1, each started from the one before."""
    guess, found = np.array([1000.0, 900.0, 105.0, 105.0 + u2]), []
    for flow in u1[::-1]:
        x = steady_state((float(flow), u2), guess)
        guess = x if np.isfinite(x).all() else guess
        found.append(x)
    return np.array(found[::-1])


def measure(report: Report, folder: Path) -> None:
    """Draw the four figures; record known steady states and the agreement of A_k, B_k with the responses."""
    _steady(report, folder)
    case = problems.reactor()
    tools: Any = derivatives.build(case.ocp, case.outputs, case.options)
    x = tools.simulate(case.x0, case.u).x
    A, B = tools.sensitivities(case.x0, case.u)
    _solution(folder, x, case.u)
    t = np.arange(tools.N) * problems.SAMPLE
    figure, axes = drawing.axes(2, 2)
    for i, axis in enumerate(axes.flat):
        for j, colour in enumerate(SHADES):
            axis.plot(t, A[:, i, j], color=colour, label=rf"$\partial$ / $\partial$ {STATES[j].split(' ')[0]}")
        axis.set(xlabel="t [h]", title=f"state sensitivities of {STATES[i].split(' ')[0]}")
        axis.grid(alpha=0.25)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    drawing.save(figure, folder, "figure_6_8")
    figure, axes = drawing.axes(4, 2, height=2.2)
    for i in range(4):
        for j in range(2):
            axes[i, j].plot(t, B[:, i, j], color=SHADES[1])
            axes[i, j].set(title=f"{STATES[i].split(' ')[0]} with respect to {CONTROLS[j].split(' ')[0]}")
            axes[i, j].grid(alpha=0.25)
    for axis in axes[-1]:
        axis.set(xlabel="t [h]")
    drawing.save(figure, folder, "figure_6_9")
    S = tools.responses(case.x0, case.u, 0)
    chained = [B[0]]
    for k in range(1, tools.N):
        chained.append(A[k] @ chained[-1])
    error = np.linalg.norm(np.array(chained) - S[1:]) / np.linalg.norm(S)
    report.add("sensitivities_against_responses", error, case="A_{n-1} ... A_1 B_0 against 6.8", limit=1e-12)


def _steady(report: Report, folder: Path) -> None:
    u1 = np.linspace(2.0, 40.0, 77)
    curves = {u2: steady_states(u1, u2) for u2 in (-8.0, -5.0, -2.0, 0.0)}
    figure, axes = drawing.axes(2, 2)
    for i, axis in enumerate(axes.flat):
        for (u2, x), colour in zip(curves.items(), SHADES, strict=True):
            axis.plot(u1, x[:, i], color=colour, label=f"{CONTROLS[1].split(' ')[0]} = {u2:g} MJ/h")
        axis.set(xlabel=CONTROLS[0], ylabel=STATES[i])
        axis.grid(alpha=0.25)
        axis.legend(frameon=False, fontsize=8)
    drawing.save(figure, folder, "figure_6_6")
    guess = np.array([2000.0, 800.0, 95.0, 90.0])
    errors = [np.abs(steady_state(u, guess)[1:3] - known) for u, known in KNOWN.items()]
    report.add(
        "steady_state_error",
        float(np.max(errors)),
        case="cB and T at the ends of the ramp of 7.4",
        limit=0.1,
        profile="",
    )


def _solution(folder: Path, x: np.ndarray, u: np.ndarray) -> None:
    figure, axes = drawing.axes(3, 2, height=2.4)
    t = np.arange(len(x)) * problems.SAMPLE
    for i, axis in enumerate(axes[:2].flat):
        axis.plot(t, x[:, i], color=SHADES[1])
        axis.set(ylabel=STATES[i])
    for j, axis in enumerate(axes[2]):
        axis.step(t[:-1], u[:, j], where="post", color=SHADES[3])
        axis.set(xlabel="t [h]", ylabel=CONTROLS[j])
    for axis in axes.flat:
        axis.grid(alpha=0.25)
    drawing.save(figure, folder, "figure_6_7")
