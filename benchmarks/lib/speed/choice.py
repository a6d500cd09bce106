"""Regret of the automatic choice of condensing and QP solver: its time over that of the best route, in one run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from benchmarks.lib.speed.in_turn import in_turn
from benchmarks.lib.speed.loops import LOOPS, for_target, module_of, package_of
from nmpc_codegen import (
    DenseActiveSet,
    FullCondensing,
    NoCondensing,
    Options,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
)
from nmpc_codegen.components.base import Condensing, QpSolver
from nmpc_codegen.targets import NATIVE
from verification.closed_loop import compile_driver, run_driver
from verification.robustness.work import Loop

LIMIT, RUNS = 1.15, 5
ROUTES: dict[str, tuple[Condensing, QpSolver]] = {
    "dense": (FullCondensing(), DenseActiveSet()),
    "stages": (NoCondensing(), RiccatiActiveSet()),
    "interior point": (NoCondensing(), RiccatiInteriorPoint()),
}
#: A condensed QP with more controls takes minutes to compile and is no candidate.
MOST_CONTROLS = 200


def measure(report: Report, asked: Run) -> None:
    """choice_regret: median time of a sample with default options over that of the fastest route, native."""
    for loop in asked.cases(LOOPS):
        routes = dict(_routes(loop))
        with ExitStack() as stack:
            programs = []
            for options in routes.values():
                there = for_target(replace(loop, options=options), NATIVE)
                sources = package_of(there)
                program = compile_driver(
                    sources, module_of(there).name, Path(stack.enter_context(TemporaryDirectory()))
                )
                programs.append(partial(run_driver, program, loop.scenario, runs=1, steps=loop.steps // 2))
            times = in_turn(programs, RUNS)
        found = {name: min(t.total for t in each) for name, each in zip(routes, times, strict=True)}
        best = min(found, key=lambda name: found[name])
        case, n = f"{loop.name}, best: {best}", RUNS * loop.steps // 2
        report.add(
            "choice_regret",
            found["chosen"] / found[best],
            case=case,
            n=n,
            limit=LIMIT,
            target=sources.description.target,
        )
        for name, value in found.items():
            report.add(f"{loop.name}_{name.replace(' ', '_')}_us", value, "us", n=n, target=sources.description.target)


def _routes(loop: Loop) -> Iterator[tuple[str, Options]]:
    yield "chosen", loop.options
    module = module_of(loop)
    for name, (condensing, qp) in ROUTES.items():
        if name != "dense" or module.value("N") * module.value("NU") <= MOST_CONTROLS:
            yield name, replace(loop.options, condensing=condensing, qp=qp)
