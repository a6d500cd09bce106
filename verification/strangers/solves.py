"""Cold starts of solve() from the boxes of the strangers, judged by residuals that are recomputed from the problem.

    python -m verification.strangers.solves [--only NAMES]

computes IPOPT's results from the same first guesses anew (solves.json).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from nmpc_codegen import Controller
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.trajectory import CLASSICAL, Point, kkt_residuals, node_data
from verification.strangers.problems import ONCE, known
from verification.strangers.statement import Stranger
from verification.strangers.twin import Twin

RESULTS = Path(__file__).with_name("solves.json")
STARTS = 10
ITERATIONS = 300
SOLVED = 1e-6  # KKT residual relative to the largest multiplier
WORSE = 1e-4  # of the cost, relative


@dataclass(frozen=True)
class Solve:
    """One start: whether it was solved, iterations, cost, status."""

    solved: bool
    iterations: int
    cost: float
    status: str

    def is_worse(self, other: Solve) -> bool:
        """True if the optimum is dearer than another one."""
        return self.cost > other.cost + WORSE * max(1.0, abs(other.cost))


@cache
def by_ipopt() -> dict[str, list[Solve]]:
    """IPOPT's solves, by problem and number of the start."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))
    return {name: [Solve(*row) for row in rows] for name, rows in found.items()}


def solves_of_ipopt(name: str) -> list[Solve]:
    """IPOPT from the plan that stays at the start."""
    twin, found = Twin(known(name)), []
    for number in range(STARTS):
        start = twin.stranger.initial(number)
        good, cost, _, _ = twin.solve(start, *twin.guess(start))
        stats = twin.solver.stats()
        found.append(Solve(good, int(stats["iter_count"]), float(f"{cost:.10g}"), stats["return_status"]))
    return found


def solves(stranger: Stranger, controller: Controller, numbers: Iterable[int]) -> list[Solve]:
    """solve() of this controller from the same plans."""
    twin, ocp, found = Twin(stranger), classify(stranger.ocp()), []
    tableau = replace(CLASSICAL, steps=stranger.steps)
    for number in numbers:
        start = stranger.initial(number)
        controller.reset()
        controller.x[:], controller.u[:] = twin.guess(start)
        mine = controller.solve(start, max_iterations=ITERATIONS)
        point = Point(**{name: getattr(mine, name) for name in Point.__dataclass_fields__})
        size = max(1.0, *(float(np.max(np.abs(m), initial=0.0)) for m in (mine.lam, mine.mu, mine.mu_N, mine.eta)))
        good = mine.status.name == "OK"
        good = good and kkt_residuals(ocp, point, node_data(ocp, x0=start), tableau).worst <= SOLVED * size
        found.append(Solve(good, mine.iterations, mine.cost, mine.status.name))
    return found


def main() -> None:
    """Compute IPOPT's results of these problems anew."""
    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    command.add_argument("--only", help="names, separated by commas")
    options = command.parse_args()
    names = options.only.split(",") if options.only else [s.name for s in ONCE]
    found = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    with ProcessPoolExecutor(2) as pool:
        for name, rows in zip(names, pool.map(solves_of_ipopt, names), strict=True):
            print(name, sum(row.solved for row in rows), [row.iterations for row in rows], flush=True)
            found[name] = [[row.solved, row.iterations, row.cost, row.status] for row in rows]
    lines = (f"{json.dumps(name)}: [\n" + ",\n".join(map(json.dumps, rows)) + "]" for name, rows in found.items())
    RESULTS.write_text("{\n" + ",\n".join(lines) + "}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
