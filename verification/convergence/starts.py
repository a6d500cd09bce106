"""Random cold starts: ours and IPOPT's from the same first guess.

A start is solved if the KKT residuals, recomputed from the problem, vanish. Where both solve, costs are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from nmpc_codegen import OptionError, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import CLASSICAL, Point, kkt_residuals, node_data
from nmpc_codegen.runtime.package_description import Names
from verification.convergence.problems import problems
from verification.routes import ROUTES

STARTS = 100
SOLVED = 1e-6  # KKT residual relative to the largest multiplier
WORSE = 1e-4  # of the cost, relative
#: The QP solvers among which qp=None chooses.
NAMES = ("dense", "riccati")


@dataclass
class Attempt:
    """One start: whether it was solved, iterations, cost, status, and whether a failure was explained."""

    solved: bool
    iterations: int
    cost: float
    status: str
    explained: bool = True


@dataclass
class Outcome:
    """Attempts by number of the start."""

    problem: str
    ipopt: list[Attempt] = field(default_factory=list)
    ours: dict[str, list[Attempt]] = field(default_factory=dict)


def run(job: tuple[str, int]) -> Outcome:
    """All routes of a problem: (its name, starts)."""
    name, count = job
    problem = next(p for p in problems() if p.name == name)
    ocp = classify(problem.make())
    tableau = replace(CLASSICAL, steps=max(1, problem.steps))
    oracle = Reference(ocp, tableau, tol=1e-8)
    out = Outcome(name)
    for route, (condensing, qp) in ((name, ROUTES[name]) for name in NAMES):
        try:
            ctrl = build(problem.make(), replace(problem.options(), condensing=condensing, qp=qp), profile="fast")
        except OptionError:  # refused, so it is not chosen, either
            continue
        attempts = out.ours.setdefault(route, [])
        for number in range(count):
            x0 = problem.start(number)
            data = node_data(ocp, x0=x0)
            ctrl.reset()
            if number == len(out.ipopt):
                found = oracle.solve(data, x=ctrl.x.copy(), u=ctrl.u.copy())
                out.ipopt.append(Attempt(found.success, found.iterations, found.cost, found.status))
            mine = ctrl.solve(x0)
            point = Point(**{name: getattr(mine, name) for name in Point.__dataclass_fields__})
            size = max(1.0, *(float(np.max(np.abs(m), initial=0.0)) for m in (mine.lam, mine.mu, mine.mu_N, mine.eta)))
            good = mine.status.name == "OK" and kkt_residuals(ocp, point, data, tableau).worst <= SOLVED * size
            explained = mine.status.name == "OK" or is_explained(ctrl.diagnose(), ctrl.names)
            attempts.append(Attempt(good, mine.iterations, mine.cost, mine.status.name, explained))
    return out


def is_explained(text: str, names: Names) -> bool:
    """True if the diagnosis names a row, a state with its node, or an option to change."""
    rows = any(f"row {row!r}" in text for row in names.rows)
    states = any(f"{state} at node" in text or f"measured {state}" in text for state in names.states)
    return rows or states or "Options(" in text or "steps" in text
