"""Closed-loop losses of the schemes of [Z20] are relative to converged plans, in percent of the steady cost.

    loss = (J - J_converged) / (|l_s| samples) 100 %,   J = sum of the economic cost of the samples

The evaporation process starts dP above its best pressure. The car has an obstacle at 80 m until 6 s; its lane moves
sideways at 8 s, in the references of the nodes from the first sample on ("foreseen") or at 8 s ("unforeseen").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from benchmarks.lib.run import Run
from benchmarks.papers.exhibit import BLUE, GREEN, ORANGE, RED, VIOLET, Table, save, sheet
from benchmarks.papers.schemes import (
    CONVERGED,
    EXACT,
    IDENTITY,
    LETEMPC,
    LETEMPC_CONVERGED,
    TRACK,
    TRACK_CONVERGED,
    TUNED,
    Array,
    Loop,
    subject,
)
from examples import driving
from nmpc_codegen import Controller
from nmpc_codegen.economic import kkt_step
from verification.economic.evaporation import N, shooting, tuning
from verification.economic.sqp import Plan, quadratic_program, steady_plan, stepped

PROCESS = (CONVERGED, EXACT, TUNED, IDENTITY, LETEMPC_CONVERGED, LETEMPC, TRACK_CONVERGED, TRACK)
CAR = (CONVERGED, EXACT, TUNED, IDENTITY, LETEMPC_CONVERGED, LETEMPC)
INDEFINITE = "indefinite H"
MOVE, CLEARED = round(driving.MOVE / driving.SAMPLING), round(driving.CLEARED / driving.SAMPLING)
Losses = dict[str, float]
COLOURS = {
    "exact": BLUE,
    "M": ORANGE,
    "M, dual correction": "#e0a070",
    INDEFINITE: GREEN,
    "identity": "0.2",
    "LETEMPC": VIOLET,
    "tracking": RED,
}
#: Smallest loss that is drawn, in percent: smaller ones equal those of the converged scheme up to rounding.
LEAST = 1e-10


@cache
def process(dP: float, samples: int) -> Losses:
    """Return the losses of every generated scheme but the converged one, and of the constant indefinite H.

    No convex solver accepts the QP of the latter; its steps are those of kkt_step() with X2 = 25 as an equation at the
    nodes 1..N-1.
    """
    t = tuning()
    costs = Loop("evaporation", tuple(t.x_s + np.array([0.0, dP])), samples, 1.0).costs(PROCESS)
    costs[INDEFINITE] = _indefinite(dP, samples)
    return _against_converged(costs, t.cost * samples)


def _against_converged(costs: Losses, steady: float) -> Losses:
    best = costs.pop(CONVERGED.name)
    return {name: (cost - best) / abs(steady) * 100 for name, cost in costs.items()}


def _indefinite(dP: float, samples: int) -> float:
    """Return the cost of the loop with the Hessian of the Lagrangian at the steady state."""
    t, problem = tuning(), shooting()
    node, plan = problem.functions(), steady_plan(t, N)
    x, total = t.x_s + np.array([0.0, dP]), 0.0
    for _ in range(samples):
        plan = stepped(plan, kkt_step(quadratic_program(problem, node, plan, t.H), x - plan.x[0]))
        Phi, cost, _ = (np.asarray(v, dtype=float).ravel() for v in problem.stage.values(np.append(x, plan.u[0])))
        x, total = Phi, total + float(cost[0])
        lam, mu = np.vstack([plan.lam[1:], plan.lam[-1:]]), np.vstack([plan.mu[1:], plan.mu[-1:]])
        plan = Plan(np.vstack([plan.x[1:], t.x_s]), np.vstack([plan.u[1:], t.u_s]), lam, mu)
    return total


@cache
def car(side: float, foreseen: bool, samples: int) -> Losses:
    """Return the losses of every scheme but the converged one, inf if it diverges; the first plan is converged."""
    return _against_converged(_drive(side, foreseen, samples).costs(CAR), subject("driving").tuning.cost * samples)


def _drive(side: float, foreseen: bool, samples: int) -> Loop:
    def event(n: int, c: Controller, x: Array) -> Array:
        if n <= CLEARED:
            driving.schedule(n, c)
        if foreseen and n == 0:
            for k in range(MOVE + 1, driving.N + 1):
                c.set_parameter("lane", side, node=k)
        if foreseen and n <= MOVE:
            c.set_parameter("lane", side, node=MOVE - n)
        if not foreseen and n == MOVE:
            c.set_parameter("lane", side)
        return x

    def origin(n: int) -> Array:
        return np.array([0.0, side * (n >= MOVE), 0.0, 0.0, 0.0])

    start, drift = (0.0, 0.0, driving.SPEED, 0.0, 0.0), (driving.SPEED * driving.SAMPLING, 0.0, 0.0, 0.0, 0.0)
    return Loop("driving", start, samples, driving.SAMPLING, event, origin, warm=True, drift=drift)


def loss_table(label: str, table: Mapping[float, Mapping[str, float]]) -> Table:
    """Return a table with a row per scheme and a column per argument."""
    names = list(next(iter(table.values())))
    rows = [(n, *(f"{each[n]:.2g}" if np.isfinite(each[n]) else "diverges" for each in table.values())) for n in names]
    return Table([f"{at:g}" for at in table], rows, corner=f"loss, %, at {label}")


def draw_losses(
    run: Run, name: str, says: str, tables: Mapping[str, Mapping[float, Mapping[str, float]]], label: str
) -> str:
    """Draw a panel per table: loss over the argument; dashed: converged."""
    figure, axes = sheet(1, len(tables), 4.6, 3.4)
    for axis, (word, table) in zip(axes[0], tables.items(), strict=True):
        at: Sequence[float] = list(table)
        for scheme in next(iter(table.values())):
            values = [table[a][scheme] for a in at]
            drawn = [max(v, LEAST) if np.isfinite(v) else np.nan for v in values]
            style = "--" if scheme.endswith("converged") else ":" if scheme == INDEFINITE else "-"
            text = scheme if np.any(np.isfinite(values)) else f"{scheme}: diverges"
            colour = COLOURS[scheme.removesuffix(" converged")]
            axis.semilogy(at, drawn, style, marker="o", markersize=3, color=colour, label=text)
        axis.set(xlabel=label, title=word)
    axes[0, 0].set_ylabel("loss against converged plans [%]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside right center")
    return save(figure, run, name, says)
