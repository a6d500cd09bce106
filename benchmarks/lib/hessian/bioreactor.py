"""Economic control of the bioreactor: orbits against IPOPT, closed loops after jumps, times, [Q14] Table III."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.lib.report import Report
from examples import bioreactor as example
from nmpc_codegen import (
    OCP,
    DenseActiveSet,
    ExactHessian,
    ForwardOverAdjoint,
    FullCondensing,
    Mirror,
    Options,
    Project,
    Status,
    build,
    generate,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference, ReferenceSolution
from nmpc_codegen.oracle.trajectory import CLASSICAL, node_data
from nmpc_codegen.runtime.build import PROFILES
from verification.closed_loop import closed_loop, compile_driver, pinned_core
from verification.scenarios import BIOREACTOR_LOOP

RK4 = replace(CLASSICAL, steps=example.STEPS)
EXPECTED = {"a": 3.074, "b": 3.054852}  # g/(L h)
MIRROR, PROJECT = ExactHessian(Mirror(level="stage")), ExactHessian(Project())
HESSIANS = {"mirrored stages": MIRROR, "projected reduced": PROJECT}
PHASES = ("shift", "integration + Hessian", "regularisation", "condensing", "QP", "RTI step")
PICTURE = Path(__file__).parents[3] / "out" / "bioreactor.png"

# Table III of [Q14], and the measurements of ACADO 1.2.2 and acados in benchmarks.md, us; None: not listed separately.
PEERS: dict[str, tuple[float | None, ...]] = {
    "[Q14], TSP": (None, 64, 16, 15, 60, 155),
    "[Q14], FOA": (None, 138, 16, 15, 60, 229),
    "ACADO here, TSP": (None, 27, 21, 4.7, 9.4, 61),
    "ACADO here, FOA": (None, 46, 21, 4.7, 9.4, 80),
    "acados, usual setting": (None, 74, 14, None, None, 102),
    "acados, best found": (None, 33, 14, None, None, 59.7),
}


def condensed(hessian: ExactHessian, shift: str | None = "repeat", unroll: str = "auto") -> Options:
    """The options of the example with full condensing."""
    options = example.options(hessian, shift)
    integrator = replace(options.integrator, unroll=unroll)
    return replace(options, integrator=integrator, condensing=FullCondensing(), qp=DenseActiveSet())


def by_ipopt(ocp: OCP, x0: np.ndarray, x: np.ndarray, u: np.ndarray) -> ReferenceSolution:
    """Solution of IPOPT from (x, u)."""
    problem = classify(ocp)
    return Reference(problem, RK4).solve(node_data(problem, x0=x0), x=x, u=u)


# Orbits --------------------------------------------------------------------------------------------------------------


def orbits(report: Report) -> None:
    """Optimal periodic orbits with a free initial state, both readings of the average feed; then the unique optimum."""
    for reading, value in EXPECTED.items():
        # In reading (a) the reduced Hessian is 0, so that the floor of its eigenvalues has no scale: no limit.
        for case, hessian in HESSIANS.items():
            watched = "_zero_reduced_hessian" if reading == "a" and hessian is PROJECT else ""
            ocp = example.build_ocp(reading)
            controller = build(ocp, condensed(hessian, shift=None), "fast")
            example.guess(controller)
            x, u = np.array(controller.x), np.array(controller.u)
            x0 = np.append(x[0, :3], [0.0, 0.0])
            ours, theirs = controller.solve(x0, tol=1e-9), by_ipopt(ocp, x0, x, u)
            error = abs(ours.cost - theirs.cost) if theirs.success and ours.status == Status.OK else np.nan
            label = f"{case}, {ours.iterations} iterations"
            print(f"orbit ({reading}), {label}: {-ours.cost:.9f} g/(L h), {ours.status.name}; IPOPT {-theirs.cost:.9f}")
            key, limit = f"bioreactor_{reading}_objective{watched}", None if watched else value - 1e-6
            report.add(key, -ours.cost, "g/(L h)", case=label, limit=limit, at_least=True)
            limit = None if watched else 1e-6
            report.add(
                f"bioreactor_objective_error{watched}", error, "g/(L h)", case=f"({reading}) {case}", limit=limit
            )
            kkt = max(dataclasses.astuple(ours.kkt))
            report.add(f"bioreactor_kkt{watched}", kkt, case=f"({reading}) {case}", limit=None if watched else 1e-8)
    for case, hessian in HESSIANS.items():
        unique(report, case, hessian)


def unique(report: Report, case: str, hessian: ExactHessian) -> None:
    """Without periodicity, from x0, with averages bounded above: one optimum, whose controls are compared."""
    ocp = example.build_ocp("a", periodic=False)
    controller = build(ocp, condensed(hessian, shift=None), "fast")
    x = np.tile(example.START, (example.N + 1, 1))
    u = np.full((example.N, 1), example.FEED)
    controller.x[...], controller.u[...] = x, u
    ours, theirs = controller.solve(example.START, tol=1e-10), by_ipopt(ocp, example.START, x, u)
    solved = theirs.success and ours.status == Status.OK

    def relative(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.max(np.abs(a - b) / np.maximum(1.0, np.max(np.abs(b), axis=0)))) if solved else np.nan

    label = f"{case}, {ours.iterations} iterations"
    report.add("bioreactor_u_error", relative(ours.u, theirs.u), case=label, limit=1e-6, n=example.N)
    report.add("bioreactor_x_error", relative(ours.x, theirs.x), case=label, limit=1e-6, n=example.N + 1)
    report.add("bioreactor_objective_error", abs(ours.cost - theirs.cost) if solved else np.nan, "g/(L h)",
               case=f"unique, {case}", limit=1e-6)  # fmt: skip


# Closed loops --------------------------------------------------------------------------------------------------------


def loops(report: Report) -> None:
    """288 h with soft periodicity; the state jumps at sample 60. The figure corresponds to [Q14] Fig. 1."""
    at = 60
    asked = {"S + 20 %": (1.0, 1.2, 1.0), "X + 10 %": (1.1, 1.0, 1.0)}
    watched = {"S - 20 %": (1.0, 0.8, 1.0), "X - 10 %": (0.9, 1.0, 1.0)}
    logs = {}
    for case, jump in {**asked, **watched}.items():
        log = logs[case] = example.closed_loop(jump, at=at)
        end = len(log.u)
        failed = np.flatnonzero(log.status != Status.OK)
        outside = int(np.count_nonzero((failed < at) | (failed > at + 1)))
        other = "" if case in asked else "_other_jumps"
        value = example.productivity(log, end - example.N, end)
        limit = 3.0540 if case in asked else None
        print(f"{case}: {value:.6f} g/(L h) in the last 48 h; failed QPs at samples {failed.tolist()}")
        report.add(f"productivity_after_jump{other}", value, "g/(L h)", case=case, limit=limit, at_least=True, n=end)
        before = example.productivity(log, at - example.N, at)
        report.add("productivity_before_jump", before, "g/(L h)", case=case, at_least=True, n=end)
        report.add(f"failed_qps{other}", outside, case=case, limit=0 if case in asked else None, n=end)
        report.add("failed_qps_after_jump", len(failed) - outside, case=f"{case}, samples 60, 61", n=2)
    _, best = example.orbit()
    example.draw(best, {case: logs[case] for case in asked}, str(PICTURE))


# Times ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """The timed configurations."""

    case: str
    reading: str
    options: Options
    limited: bool = False


def settings() -> Iterator[Setting]:
    """The setting of ACADO (mirrored stages, shifted plan), the default regularisation, other shifts, loops."""
    for reading in ("a", "b"):
        for case, hessian in HESSIANS.items():
            yield Setting(f"({reading}) {case}", reading, condensed(hessian), limited=True)
    foa = ExactHessian(Mirror(level="stage"), ForwardOverAdjoint())
    yield Setting("(a) mirrored stages, FOA", "a", condensed(foa))
    for unroll in ("all", "none"):
        yield Setting(f'(a) mirrored stages, unroll="{unroll}"', "a", condensed(MIRROR, unroll=unroll))
    yield Setting('(a) mirrored stages, shift="periodic"', "a", condensed(MIRROR, "periodic"))
    for case, hessian in HESSIANS.items():
        yield Setting(f"(a) {case}, no shift", "a", condensed(hessian, None))


def times(report: Report, runs: int = 15, steps: int = 1000) -> None:
    """Closed loops in C without periodicity, restarted at x0 (1 + 1e-2 U) every 50 steps."""
    for setting in settings():
        ocp = example.build_ocp(setting.reading, periodic=False)
        count = (runs, steps) if setting.limited else (5, steps // 2)
        t = closed_loop(generate(ocp, setting.options), "bioreactor", BIOREACTOR_LOOP, runs=count[0], steps=count[1])
        other = "" if setting.limited else "_other"
        key, n = f"bioreactor{other}", t.samples
        report.add(f"{key}_total_us", t.total, "us", case=setting.case, limit=25 if setting.limited else None, n=n)
        report.add(f"{key}_feedback_us", t.feedback, "us", case=setting.case, n=n)
        report.add(f"{key}_total_median_us", t.total_median, "us", case=setting.case, n=n)
        report.add(f"{key}_worst_us", t.worst, "us", case=setting.case, n=n)
        report.add(f"{key}_qp_iterations", t.qp_iterations, "per step", case=setting.case, n=n)
        report.add(f"{key}_failed_steps", t.failed, case=setting.case, n=n)


def phases(options: Options, reading: str = "a", runs: int = 9, steps: int = 500) -> list[float]:
    """Time per phase in us: minimum over the runs of the median over the steps."""
    sources = generate(example.build_ocp(reading, periodic=False), options)
    with tempfile.TemporaryDirectory() as folder:
        # At the reduced level condensing regularises, and there is no such function.
        at_stages = "\nstatic void hessian(solver_t" in sources["bioreactor.c"]
        flags = (*PROFILES["fast"].flags, f"-DAT_STAGES={int(at_stages)}")
        program = compile_driver(sources, "bioreactor", Path(folder), flags, Path(__file__).with_name("phases.c"))
        numbers = [
            runs,
            steps,
            BIOREACTOR_LOOP.dt,
            BIOREACTOR_LOOP.period,
            BIOREACTOR_LOOP.restart,
            *map(float, BIOREACTOR_LOOP.x0),
        ]
        core = pinned_core()
        text = subprocess.run(
            [str(program), *map(str, numbers)],
            check=True,
            capture_output=True,
            text=True,
            preexec_fn=lambda: os.sched_setaffinity(0, core),
        ).stdout
    return [float(v) for v in np.array([line.split() for line in text.splitlines()], dtype=float).min(axis=0)]


def table_3(report: Report) -> None:
    """Our times, straight-line and looped, next to those of the paper and of the peers."""
    rows = {}
    for scheme, hessian in (("TSP", MIRROR), ("FOA", ExactHessian(Mirror(level="stage"), ForwardOverAdjoint()))):
        for unroll, word in (("auto", "unrolled"), ("none", "looped")):
            rows[f"ours, {scheme}, {word}"] = found = phases(condensed(hessian, unroll=unroll))
            for phase, value in zip(PHASES, found, strict=True):
                key = f"table3_{phase.replace(' + ', '_and_').replace(' ', '_').lower()}_us"
                report.add(key, value, "us", case=f"{scheme}, {word}", n=9 * 500)
    rows["ours, TSP, reduced level"] = phases(condensed(PROJECT))
    table = Table(title="[Q14] Table III, us; bioreactor, x0 (1 + 1e-2 U) every 50 steps, plan shifted")
    table.add_column("")
    for phase in PHASES:
        table.add_column(phase, justify="right")
    for name, row in {**rows, **PEERS}.items():
        table.add_row(name, *("" if value is None else f"{value:.3g}" for value in row))
    Console(width=140).print(table)
