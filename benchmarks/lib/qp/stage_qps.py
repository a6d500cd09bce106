"""Random stage QPs of random dimensions for every registered QP solver, judged by the optimum they are built around.

    python -m benchmarks.lib.qp.stage_qps [--tuples N] [--first I]

A package is compiled for every tuple of dimensions and every solver. Full condensing is included if the spectral radius
is at most 1.05, because the condition number grows with its power 2 N, and if N nu is at most CONDENSED.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.lib.peers import silent
from benchmarks.lib.qp.plugins import Plugin, point_of, stage_form
from nmpc_codegen import Options, Status
from nmpc_codegen.components import condensing, qp
from tests.oracles.stage_qp import Shape, StageQP, condition, distance
from tests.oracles.stage_qp_random import INFEASIBLE, SEMIDEFINITE, kinds_of, random_qp
from tests.stage_qp import GIVEN_UP, StageSolver, built, generated, solver_options, solvers

SETS = 7  # data sets of a tuple
CONDENSED = 160  # largest N nu of full condensing, whose solver is cubic in N nu
LARGE = 400  # number of bounds and rows above which a smaller share is active
MILD, UNSTABLE = 1.05, 1.3  # spectral radius
OSQP_LIMIT, OSQP_CONDITION = 1e-5, 1e5


@dataclass(frozen=True)
class Drawn:
    """Dimensions, spectral radius, and the block length of partial condensing."""

    shape: Shape
    radius: float
    block: int


def draw(seed: int) -> Drawn:
    """nx 1..30, nu 1..8, N 1..100 (logarithmically), 0..20 rows of all kinds, some soft."""
    rng = np.random.default_rng([20, seed])
    nx, nu = int(rng.integers(1, 31)), int(rng.integers(1, 9))
    N = int(np.exp(rng.uniform(0, np.log(101))))
    left = int(rng.integers(0, 21)) if rng.random() < 0.8 else 0
    parts: dict[str, Any] = {}
    limits = {"states": nx, "end": max(nx, 4), "path": 8, "pure": 6, "coupled": 4}
    for name in rng.permutation(list(limits)):
        parts[str(name)] = int(rng.integers(0, min(left, limits[str(name)]) + 1))
        left -= parts[str(name)]
    total = sum(parts.values())
    if rng.random() < 0.5:
        parts["soft"] = tuple(int(i) for i in np.flatnonzero(rng.random(total) < 0.4))
    if rng.random() < 0.3:
        parts["controls"] = int(rng.integers(0, nu + 1))
    if rng.random() < 0.15 and not parts["coupled"]:
        parts["free"] = int(rng.integers(1, nx + 1))
    radius = MILD if seed % 2 == 0 else UNSTABLE
    return Drawn(Shape(nx, nu, N, **parts), radius, int(rng.integers(1, 7)))


def options_of(drawn: Drawn) -> dict[str, Options]:
    """The solvers for these dimensions, by name; partial condensing uses one of them in turn, with the drawn block."""
    found, partial = {}, []
    for name, options in solvers().items():
        if isinstance(options.condensing, condensing.PartialCondensing):
            partial.append((name, solver_options(condensing.PartialCondensing(drawn.block), options.qp)))
        elif isinstance(options.condensing, condensing.FullCondensing):
            if drawn.radius <= MILD and drawn.shape.N * drawn.shape.nu <= CONDENSED:
                found[name] = options
        else:
            found[name] = options
    if partial:
        name, options = partial[drawn.block % len(partial)]
        found[name] = options
    return found


def data_sets(drawn: Drawn, seed: int) -> Iterator[StageQP]:
    """SETS problems, of all kinds in turn; the number of active bounds and rows remains moderate if there are many."""
    rng = np.random.default_rng([21, seed])
    shape, kinds = drawn.shape, kinds_of(drawn.shape)
    size = shape.N * shape.bounded + shape.N * shape.user_rows
    chosen = rng.permutation([k for k in kinds if size <= LARGE or k != "all_active"])
    for i in range(SETS):
        active = rng.uniform(0, 0.7) * min(1.0, LARGE / max(1, size))
        yield random_qp(shape, str(chosen[i % len(chosen)]), 1000 * seed + i, drawn.radius, float(active))


@dataclass
class Tally:
    """Counts over problems and solvers."""

    tuples: int = 0
    problems: int = 0
    solved: Counter[str] = field(default_factory=Counter)  # by solver: number of its problems
    wrong: Counter[str] = field(default_factory=Counter)
    given_up: Counter[str] = field(default_factory=Counter)  # semidefinite problems without an answer
    iterations: Counter[str] = field(default_factory=Counter)
    most: Counter[str] = field(default_factory=Counter)
    seconds: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    osqp_compared: int = 0
    osqp_error: float = 0.0
    distance: float = 0.0  # of well-conditioned problems


def try_solver(tally: Tally, name: str, solver: StageSolver, problem: StageQP) -> None:
    """Solve one problem with one solver and judge its answer."""
    start = time.perf_counter()
    status = solver.solve(problem)
    tally.seconds[name] += time.perf_counter() - start
    tally.solved[name] += 1
    tally.iterations[name] += solver.iterations
    tally.most[name] = max(tally.most[name], solver.iterations)
    if problem.kind == SEMIDEFINITE and status in GIVEN_UP:
        tally.given_up[name] += 1
        return
    found = solver.verdict(problem, status)
    if found:
        tally.wrong[name] += 1
        tally.examples.append(f"{name} {problem} radius {problem.growth}: {found}")
    elif status == Status.OK and problem.unique:
        error = distance(problem, solver.point)
        if error > tally.distance and condition(problem) <= OSQP_CONDITION:
            tally.distance = error


def compare_with_osqp(tally: Tally, problem: StageQP) -> None:
    """OSQP with polishing on a well-scaled problem with a unique minimiser, if it converges."""
    size = problem.shape.N * (problem.shape.nx + problem.shape.nu)
    if problem.kind in ("scaled", "reduced", SEMIDEFINITE, INFEASIBLE) or size > 1500:
        return
    if condition(problem) > OSQP_CONDITION:
        return
    form = stage_form(problem)
    with silent():
        found, w = Plugin("osqp", [form]).solve(form)
    if found:
        tally.osqp_compared += 1
        tally.osqp_error = max(tally.osqp_error, distance(problem, point_of(problem, w)))


def run(tuples: int = 300, first: int = 0, osqp: bool = True) -> Tally:
    """Solve all drawn problems; the compilers work ahead."""
    tally = Tally()
    drawn = [draw(seed) for seed in range(first, first + tuples)]
    with ThreadPoolExecutor(2) as pool:
        waiting: dict[int, list[Future[Any]]] = {}
        for i, one in enumerate(drawn):
            for j in range(i, min(i + 4, tuples)):
                if j not in waiting:
                    ahead = drawn[j]
                    chosen = options_of(ahead).values()
                    for o in chosen:
                        generated(ahead.shape, o)
                    waiting[j] = [pool.submit(built, ahead.shape, o) for o in chosen]
            for future in waiting[i]:
                future.result()
            run_tuple(tally, one, first + i, osqp)
    return tally


def run_tuple(tally: Tally, drawn: Drawn, seed: int, osqp: bool) -> None:
    """The data sets of one tuple: every solver cold on the first, then from the working set of the preceding one."""
    used = {name: StageSolver(drawn.shape, options) for name, options in options_of(drawn).items()}
    tally.tuples += 1
    for i, problem in enumerate(data_sets(drawn, seed)):
        tally.problems += 1
        for name, solver in used.items():
            if i % 3 == 0:
                solver.reset()
            try_solver(tally, name, solver, problem)
        if osqp and i == 0:
            compare_with_osqp(tally, problem)


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tuples", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    start = time.perf_counter()
    tally = run(options.tuples, options.first)
    print(
        f"{tally.problems} problems of {tally.tuples} tuples, {time.perf_counter() - start:.0f} s;",
        ", ".join(sorted(qp.REGISTRY)),
    )
    for name in tally.solved:
        mean = tally.iterations[name] / tally.solved[name]
        print(
            f"{name}: {tally.solved[name]} problems, {tally.wrong[name]} wrong, {tally.given_up[name]} given up, "
            f"iterations {mean:.1f}, at most {tally.most[name]}, {tally.seconds[name]:.1f} s"
        )
    print(f"largest distance {tally.distance:.1e}; OSQP {tally.osqp_error:.1e} over {tally.osqp_compared}")
    for line in tally.examples:
        print(" ", line)


if __name__ == "__main__":
    main()
