"""Counted operations of samples against the worst case that the report states, and against a budget.

    python -m benchmarks.robustness --only worst [--scale S]

The loops are those of the part `work`. Each of them also gets measured states that are drawn at random, near and far,
one after the other without a plant, so that the solvers start from working sets and plans that do not fit.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.robustness.work import Counted, Loop, Recorded, closed_loops, count, record, soft_loops, steps_of
from nmpc_codegen import RealTimeIteration, Status
from nmpc_codegen.compiler import compiled
from nmpc_codegen.ir.cmodule import CModule

Array = np.ndarray

HOSTILE = 300  # samples per loop
FARTHEST = 3.0  # power of ten of the largest distance from the first state
UNBOUNDED = 2**31 - 1  # a budget that does not bind


def hostile(loop: Loop, samples: int) -> Recorded:
    """Measured states at distances from 0.1 to 1000, every fourth one where the loop starts."""
    random, x0 = np.random.default_rng(2), np.array(loop.scenario.x0, dtype=float)
    states = []
    for k in range(samples):
        distance = 0.0 if k % 4 == 3 else 10.0 ** random.uniform(-1.0, FARTHEST)
        states.append((None, x0 + distance * random.standard_normal(x0.size)))
    return Recorded([], states, np.zeros((samples, 0)), np.zeros(samples, dtype=bool))


def with_budget(loop: Loop, budget: int) -> Loop:
    """The loop with a limit on the operations of a sample."""
    algorithm = loop.options.algorithm or RealTimeIteration()
    assert isinstance(algorithm, RealTimeIteration)
    limited = dataclasses.replace(algorithm, budget=budget)
    return dataclasses.replace(loop, options=dataclasses.replace(loop.options, algorithm=limited))


def package_of(loop: Loop) -> CModule:
    """Its package."""
    return compiled(loop.make(), loop.options)


def least_budget(loop: Loop) -> int:
    """The smallest budget that its package accepts."""
    module = package_of(with_budget(loop, UNBOUNDED))
    iteration = sum(module.sizes[name] for name in module.iteration)
    return UNBOUNDED - module.sizes["ALLOWANCE"] + iteration


def outside(module: CModule, u: Array) -> int:
    """Number of samples whose control is not finite or outside its bounds."""
    wrong = ~np.all(np.isfinite(u), axis=1)
    for row in module.description.rows:
        if row.kind == "control":
            wrong |= ~((row.lower <= u[:, row.index]) & (u[:, row.index] <= row.upper))
    return int(np.sum(wrong))


def played(loop: Loop, scale: float) -> Counted:
    """The samples of the loop, then hostile ones, counted."""
    parts = count(loop, record(loop, steps_of(loop, scale), []), hostile(loop, max(40, round(scale * HOSTILE))))
    return Counted(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Counted)))


def worst_case(report: Report, loop: Loop, scale: float) -> None:
    """All samples against the stated worst case."""
    stated = package_of(loop).description.report.worst_operations["sample"]
    found = played(loop, scale).every
    case = f"{loop.name}: stated {stated:,}, worst seen {np.max(found):,.0f}"
    report.add("worst_case_exceeded", int(np.sum(found > stated)), case=case, n=len(found), limit=0)
    report.add("worst_case_over_seen", stated / float(np.max(found)), case=loop.name, n=len(found))


def budget(report: Report, loop: Loop, scale: float) -> None:
    """All samples against a budget of twice the least one, which binds in some."""
    limited = with_budget(loop, 2 * least_budget(loop))
    module = package_of(limited)
    limit = module.sizes["MAX_OPERATIONS"]
    found = played(limited, scale)
    ended = int(np.sum(found.status == Status.ITERATION_LIMIT))
    case = f"{loop.name}: budget {limit:,}, worst seen {np.max(found.every):,.0f}, {ended} ended by it"
    report.add("budget_exceeded", int(np.sum(found.every > limit)), case=case, n=len(found.every), limit=0)
    report.add("budget_bad_controls", outside(module, found.u), case=loop.name, n=len(found.every), limit=0)


def measure(report: Report, scale: float = 1.0) -> None:
    """Worst cases and budgets of all loops."""
    for loop in (*closed_loops(), *soft_loops()):
        worst_case(report, loop, scale)
        budget(report, loop, scale)
