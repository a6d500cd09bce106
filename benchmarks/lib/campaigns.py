"""Campaigns are measured: flights per second, losses with their intervals, replays, memory, chosen options."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from examples import crane, quadrotor
from nmpc_codegen import OCP, Options, ProblemWarning
from nmpc_codegen.campaigns import Box, Campaign, Flown, campaign
from verification.routes import PURE
from verification.strangers.problems import STRANGERS, known
from verification.strangers.statement import Stranger

#: Flights of the five systems, and of the coach for a stranger; share lost of the five, of one that is known to
#: lose; bytes of a process with a million flights.
FLIGHTS, COACHED = 10_000, 400
LOST, LOSER, MEMORY = 0.001, 0.4, 1e9
MILLION = 1_000_000

#: A million flights of the crane in a process of its own, and the peak of its memory.
_MILLION = """
import json, sys
from benchmarks.lib.campaigns import fly_million
print(json.dumps(fly_million(int(sys.argv[1]))))
"""


def of_stranger(s: Stranger) -> dict[str, Any]:
    """Return starts in the stranger's box, its kick, and its goal, as arguments of campaign()."""
    words: dict[str, Any] = s.flights([0])
    words["starts"] = Box(*(np.asarray(side) for side in s.start))
    if s.distance is not None:
        words["success"] = _arrival(s.distance, s.reach)
    return words


def _arrival(distance: Callable[[NDArray[np.float64]], float], reach: float) -> Callable[[Flown], NDArray[np.bool_]]:
    return lambda flown: np.array([distance(x) <= reach for x in flown.last])


def _systems() -> list[tuple[str, OCP, Options, dict[str, Any]]]:
    """Return crane, drone with pillar, car, tank, quadrotor."""
    found = [("crane", crane.build_ocp(), Options(), {"success": {"p": Box(-0.1, 0.1)}})]
    found += [(n, known(n).ocp(), known(n).options(), of_stranger(known(n))) for n in ("drone", "car", "tanks")]
    return [*found, ("quadrotor", quadrotor.build_ocp(), quadrotor.options(), {})]


def measure(report: Report, asked: Run) -> None:
    """Measure all figures."""
    for name, ocp, options, words in asked.cases(_systems()):
        begin = time.perf_counter()
        found = campaign(ocp, asked.share(FLIGHTS, 50), options, progress=False, **words)
        _report(report, name, found, time.perf_counter() - begin)
        report.add("lost", found.share, "share", case=name, n=len(found), limit=LOST)
    trailer = known("trailer")
    pure = replace(trailer.options(), algorithm=replace(PURE, tolerance=0.1))
    loser = campaign(trailer.ocp(), asked.share(FLIGHTS, 50), pure, progress=False, **of_stranger(trailer))
    report.add("found to lose", loser.share, "share", case="trailer, pure", n=len(loser), limit=LOSER, at_least=True)
    other = [n for n in loser.worst(5) if not np.array_equal(loser.replay(n).x[-1], loser.flown.last[loser._place(n)])]
    report.add("worst replayed otherwise", len(other), "flights", case="trailer, pure", n=5, limit=0)
    flights = asked.share(MILLION, 1000)
    command = [sys.executable, "-c", _MILLION, str(flights)]
    peak, seconds = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    report.add("peak of memory", peak, "B", case="crane, all flights", n=flights, limit=MEMORY)
    report.add("time", seconds, "s", case="crane, all flights", n=flights)


def _report(report: Report, name: str, found: Campaign, seconds: float) -> None:
    report.add("time", seconds, "s", case=name, n=len(found))
    report.add("at most lost", found.interval[1], "share", case=name, n=len(found))
    report.add("sample", 1e6 * float(np.mean(found.flown.seconds[:, 0])), "us", case=name, n=len(found))


def fly_million(flights: int) -> tuple[float, float]:
    """Return the peak of memory (bytes) and the time (s) of this number of flights of the crane."""
    begin = time.perf_counter()
    campaign(crane.build_ocp(), flights, progress=False, steps=20)
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter() - begin


def table(names: Sequence[str] = ()) -> str:
    """Return a Markdown table that compares the options chosen by campaign() with the defaults, on new flights."""
    lines = ["| stranger | default lost | choice | lost | cost | time | why |", "|---|---:|---|---:|---:|---:|---|"]
    for s in STRANGERS:
        if names and s.name not in names:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ProblemWarning)
            found = campaign(s.ocp(), COACHED, "candidates", progress=False, **of_stranger(s))
        chosen, first, why = found.chosen, found.first, found.reason.partition(": ")[2] or found.reason
        lines.append(
            f"| {s.name} | {first.lost} of {first.flights} | `{chosen.change}` | {chosen.lost} | "
            f"{100 * chosen.cost:+.2g} % | {chosen.seconds / first.seconds:.2f} | {why} |"
        )
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"
