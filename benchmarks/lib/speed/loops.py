"""Closed loops of all benchmark problems: units for this machine, and exported C, in the same run."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.lib.report import Report
from benchmarks.lib.speed.in_turn import in_turn
from benchmarks.lib.speed.reference import REFERENCE, reference_kernel_us
from examples import chain
from nmpc_codegen import OCP, Options, RealTimeIteration
from nmpc_codegen.compiler import compiled
from nmpc_codegen.host.unit import host_unit
from nmpc_codegen.lowering.render import Sources, render
from nmpc_codegen.runtime.build import PROFILES, host
from verification import scenarios
from verification.closed_loop import Scenario, Timing, compile_driver, run_driver
from verification.timed import TIMED

RUNS = 15


@dataclass(frozen=True)
class Loop:
    """A problem in closed loop with the limits (us) of a sample and of the feedback phase."""

    name: str
    make: Callable[[], OCP]
    options: Options
    scenario: Scenario
    total: float
    feedback: float | None
    steps: int = 1000
    worst: float | None = None


def _loops() -> tuple[Loop, ...]:
    timed = {s.name.removeprefix("timed "): s for s in TIMED}
    examples = {e.name: e for e in scenarios.EXAMPLES}
    chain5 = examples["chain5"].scenario()

    def known(name: str, total: float, feedback: float, worst: float | None = None) -> Loop:
        sample = timed[name]
        own = {"crane": scenarios.CRANE_LOOP, "bioreactor": scenarios.BIOREACTOR_LOOP}
        scenario = own[name] if name in own else examples[name].scenario()
        steps = 400 if name.startswith("chain") else 1000
        return Loop(name, sample.make, sample.options, scenario, total, feedback, steps, worst)

    def of_chain(n: int, total: float, feedback: float) -> Loop:
        return Loop(
            f"chain{n}",
            lambda: chain.build_ocp(n),
            Options(),
            examples[f"chain{n}"].scenario(),
            total,
            feedback,
            400,
        )

    return (
        known("crane", 1.25, 0.45),
        known("cstr", 2.5, 0.7),
        known("bioreactor", 8.0, 2.0, 25.0),
        known("quadrotor", 10.5, 2.0, 25.0),
        of_chain(3, 18.0, 3.0),
        of_chain(5, 70.0, 6.0),
        of_chain(7, 175.0, 10.0),
        Loop("chain5_N160", lambda: chain.build_ocp(5, N=160), Options(), chain5, 280.0, None, 400),
    )


LOOPS = _loops()


def units(loop: Loop, avx512: bool = True) -> tuple[str, Sources, Sources, int]:
    """Prefix, the exported package, the same with the unit for this machine as its .c, and the lanes of the latter."""
    module, found = compiled(loop.make(), loop.options), host(None, "fast")
    if found.avx512 and not avx512:
        found = replace(found, lanes=4, avx512=False)
    exported = render(module)
    unit = host_unit(module, found.lanes, found.avx512)
    return module.name, exported, {**exported, f"{module.name}.c": unit}, found.lanes


def measure(report: Report, runs: int = RUNS) -> None:
    """<name>_total_us, _feedback_us, _worst_us; the same of exported C with _single_lane; worst_over_median_time."""
    reference = reference_kernel_us()
    report.add("reference_kernel_us", reference, "us", n=200)
    for loop in LOOPS:
        prefix, exported, hosted, lanes = units(loop)
        with ExitStack() as stack:
            folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(2)]
            programs = [compile_driver(s, prefix, f) for s, f in zip((hosted, exported), folders, strict=True)]
            times = in_turn(programs, loop.scenario, runs, loop.steps)
        for found, suffix, count in zip(times, ("", "_single_lane"), (lanes, 1), strict=True):
            _add(report, loop, found, suffix, count, reference)


def first_control(report: Report, runs: int = 5) -> None:
    """feedback_first_us: the first part of the feedback phase, which returns the control of the predicted set."""
    for loop in LOOPS:
        prefix, _, hosted, lanes = units(_with(loop, replace(_algorithm(loop), first_control=True)))
        with tempfile.TemporaryDirectory() as folder:
            program = compile_driver(hosted, prefix, Path(folder), (*PROFILES["fast"].flags, "-DFIRST"))
            times = run_driver(program, loop.scenario, runs=runs, steps=loop.steps)
        n = times.samples
        report.add("feedback_first_us", times.feedback, "us", case=loop.name, n=n, limit=0.3, lanes=lanes)


def levels(report: Report, runs: int = 5) -> None:
    """<name>_level_b_us, _level_c_us, _level_d_us: a sample whose preparation keeps derivatives and factors."""
    for loop in LOOPS:
        prefix, _, hosted, lanes = units(_with(loop, replace(_algorithm(loop), levels=True)))
        for number, level in ((1, "b"), (2, "c"), (3, "d")):
            with tempfile.TemporaryDirectory() as folder:
                program = compile_driver(hosted, prefix, Path(folder), (*PROFILES["fast"].flags, f"-DLEVEL={number}"))
                times = run_driver(program, loop.scenario, runs=runs, steps=loop.steps)
            report.add(f"{loop.name}_level_{level}_us", times.total, "us", n=times.samples, lanes=lanes)


def _algorithm(loop: Loop) -> RealTimeIteration:
    assert isinstance(loop.options.algorithm, RealTimeIteration)
    return loop.options.algorithm


def _with(loop: Loop, algorithm: RealTimeIteration) -> Loop:
    """The loop with other options of the real-time iteration."""
    return replace(loop, options=replace(loop.options, algorithm=algorithm))


def _add(report: Report, loop: Loop, times: list[Timing], suffix: str, lanes: int, reference: float) -> None:
    n = sum(t.samples for t in times)
    values = {
        "total": (min(t.total for t in times), loop.total),
        "feedback": (min(t.feedback for t in times), loop.feedback),
        "worst": (min(t.worst for t in times), loop.worst),
    }
    for name, (value, limit) in values.items():
        here = None if suffix or limit is None else limit
        report.add(f"{loop.name}_{name}_us{suffix}", value, "us", n=n, limit=here, lanes=lanes)
        if here is not None:
            scaled = value * REFERENCE / reference
            report.add(f"{loop.name}_{name}_us_scaled", scaled, "us", n=n, limit=here, lanes=lanes)
    ratio = values["worst"][0] / values["total"][0]
    report.add(f"worst_over_median_time{suffix}", ratio, case=loop.name, n=n, lanes=lanes)
    report.add(f"failed_steps{suffix}", max(t.failed for t in times), case=loop.name, n=n, lanes=lanes)
