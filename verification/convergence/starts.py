"""solve() starts cold from the same random first guesses as IPOPT, whose results are kept in ipopt.json.

A start is solved if the KKT residuals, recomputed from the problem, vanish. Where both solve, costs are compared.

    python -m verification.convergence.starts

computes ipopt.json anew.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen import Controller, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import CLASSICAL, Point, Tableau, kkt_residuals, node_data
from nmpc_codegen.package.signals import Names
from nmpc_codegen.runtime.solving import Solution
from verification.convergence.problems import StartProblem, problems

RESULTS = Path(__file__).with_name("ipopt.json")
STARTS = 100
SOLVED = 1e-6  # KKT residual relative to the largest multiplier
WORSE = 1e-4  # of the cost, relative


@dataclass(frozen=True)
class Attempt:
    """An attempt is one start: whether it was solved, iterations, cost, status, and whether a failure was explained."""

    solved: bool
    iterations: int
    cost: float
    status: str
    explained: bool = True


def recorded(file: Path) -> dict[str, list[Attempt]]:
    """Read the attempts in a file, by problem."""
    found = json.loads(file.read_text(encoding="utf-8"))
    return {name: [Attempt(*row) for row in rows] for name, rows in found.items()}


def is_solved(ocp: Problem, tableau: Tableau, solution: Solution, x0: NDArray[np.float64]) -> bool:
    """Return True if the status is OK and the KKT residuals, recomputed from the problem, vanish."""
    point = Point(**{name: getattr(solution, name) for name in Point.__dataclass_fields__})
    multipliers = (solution.lam, solution.mu, solution.mu_N, solution.eta)
    size = max(1.0, *(float(np.max(np.abs(m), initial=0.0)) for m in multipliers))
    residual = kkt_residuals(ocp, point, node_data(ocp, x0=x0), tableau).worst
    return bool(solution.status.name == "OK" and residual <= SOLVED * size)


@cache
def by_ipopt() -> dict[str, list[Attempt]]:
    """Return IPOPT's attempts, by problem and number of the start."""
    return recorded(RESULTS)


def known(name: str) -> StartProblem:
    """Return the problem of that name."""
    return next(problem for problem in problems() if problem.name == name)


def _tableau(problem: StartProblem) -> Tableau:
    return replace(CLASSICAL, steps=max(1, problem.steps))


def attempts_of_ipopt(name: str, numbers: Sequence[int]) -> list[Attempt]:
    """Run IPOPT from the first guess of a new controller."""
    problem = known(name)
    ocp, ctrl = classify(problem.make()), build(problem.make(), problem.options(), profile="test")
    oracle, found = Reference(ocp, _tableau(problem), tol=1e-8), []
    for number in numbers:
        ctrl.reset()
        data = node_data(ocp, x0=problem.start(number))
        result = oracle.solve(data, x=ctrl.x.copy(), u=ctrl.u.copy())
        found.append(Attempt(result.success, result.iterations, result.cost, result.status))
    return found


def attempts(name: str, controller: Controller, numbers: Sequence[int]) -> list[Attempt]:
    """Run solve() of this controller from starts of the problem."""
    problem = known(name)
    ocp, tableau, found = classify(problem.make()), _tableau(problem), []
    for number in numbers:
        x0 = problem.start(number)
        controller.reset()
        mine = controller.solve(x0)
        good = is_solved(ocp, tableau, mine, x0)
        explained = mine.status.name == "OK" or is_explained(controller.diagnose(), controller.names)
        found.append(Attempt(good, mine.iterations, mine.cost, mine.status.name, explained))
    return found


def is_explained(text: str, names: Names) -> bool:
    """Return True if the diagnosis names a row, a state with its node, or an option to change."""
    rows = any(f"row {row!r}" in text for row in names.rows)
    states = any(f"{state} at node" in text or f"measured {state}" in text for state in names.states)
    return rows or states or "Options(" in text or "steps" in text


def main() -> None:
    """Run all problems, and write one line per start."""
    lines = []
    for problem in problems():
        rows = attempts_of_ipopt(problem.name, range(STARTS))
        texts = [json.dumps([r.solved, r.iterations, float(f"{r.cost:.10g}"), r.status]) for r in rows]
        lines.append(f"{json.dumps(problem.name)}: [\n" + ",\n".join(texts) + "]")
    RESULTS.write_text("{\n" + ",\n".join(lines) + "}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
