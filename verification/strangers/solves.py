"""solve() starts cold from the boxes of the strangers, judged by residuals recomputed from the problem.

    python -m verification.strangers.solves [--only NAMES]

computes IPOPT's results from the same first guesses anew (solves.json).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

from nmpc_codegen import Controller
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.trajectory import CLASSICAL
from verification.convergence.starts import WORSE, Attempt, is_solved, recorded
from verification.strangers.problems import ONCE, known
from verification.strangers.statement import Stranger
from verification.strangers.twin import Twin

RESULTS = Path(__file__).with_name("solves.json")
STARTS = 10
ITERATIONS = 300


def is_worse(one: Attempt, other: Attempt) -> bool:
    """Return True if the optimum of one costs more than that of another."""
    return one.cost > other.cost + WORSE * max(1.0, abs(other.cost))


@cache
def by_ipopt() -> dict[str, list[Attempt]]:
    """Return IPOPT's solves, by problem and number of the start."""
    return recorded(RESULTS)


def solves_of_ipopt(name: str) -> list[Attempt]:
    """Run IPOPT from the plan that stays at the start."""
    twin, found = Twin(known(name)), []
    for number in range(STARTS):
        start = twin.stranger.initial(number)
        good, cost, _, _ = twin.solve(start, *twin.guess(start))
        stats = twin.solver.stats()
        found.append(Attempt(good, int(stats["iter_count"]), float(f"{cost:.10g}"), stats["return_status"]))
    return found


def solves(stranger: Stranger, controller: Controller, numbers: Iterable[int]) -> list[Attempt]:
    """Run solve() of this controller from the same plans."""
    twin, ocp, found = Twin(stranger), classify(stranger.ocp()), []
    tableau = replace(CLASSICAL, steps=stranger.steps)
    for number in numbers:
        start = stranger.initial(number)
        controller.reset()
        controller.x[:], controller.u[:] = twin.guess(start)
        mine = controller.solve(start, max_iterations=ITERATIONS)
        good = is_solved(ocp, tableau, mine, start)
        found.append(Attempt(good, mine.iterations, mine.cost, mine.status.name))
    return found


def main() -> None:
    """Compute IPOPT's results of these problems again."""
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
