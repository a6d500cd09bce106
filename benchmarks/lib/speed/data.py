"""What changing data costs: microseconds of a call in Python, and time and bytes of packages with look-up tables."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import casadi as ca
import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import OCP, Online, Options, Soft, build, generate, lookup_table
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.controller import Controller

N, CALLS, ROUNDS = 25, 2000, 5
#: The aims: an array by node, in one call; an export.
MOST_US, MOST_S = 5.0, 1.0


def setters(report: Report, asked: Run) -> None:
    """The least mean time of a call over some rounds: a residual of 7, a parameter of 2, N = 25, all data by node."""
    ctrl, calls = _controller(), asked.share(CALLS)
    by_node = np.linspace(-1.0, 1.0, (N + 1) * 7).reshape(N + 1, 7)
    limits = np.linspace(4.0, 5.0, N + 1)
    cases: dict[str, Callable[[], object]] = {
        "reference (25, 7)": partial(ctrl.set_reference, by_node[:N].copy()),
        "reference (26, 7)": partial(ctrl.set_reference, by_node),
        "reference (7,)": partial(ctrl.set_reference, by_node[0].copy()),
        "reference by name": partial(ctrl.set_reference, {"x": by_node[:, :5]}),
        "weight (25, 7)": partial(ctrl.set_weight, 1.0 + by_node[:N] ** 2),
        "weight by name": partial(ctrl.set_weight, {"u": 2.0}),
        "parameter (26, 2)": partial(ctrl.set_parameter, "price", by_node[:, :2].copy()),
        "parameter, a number": partial(ctrl.set_parameter, "m", 1.1),
        "bounds (26,)": partial(ctrl.set_bounds, "x[1]", -limits, limits),
        "bounds, two numbers": partial(ctrl.set_bounds, "x[1]", -4.0, 4.0),
        "soft (26,)": partial(ctrl.set_soft, "swing", (limits, limits)),
        "step": partial(ctrl.step, np.zeros(5)),
    }
    for case, call in cases.items():
        best = min(_mean(call, calls) for _ in range(ROUNDS))
        report.add("call", best, "us", case=case, n=calls, limit=MOST_US if case == "reference (25, 7)" else None)


def tables(report: Report, asked: Run) -> None:
    """export: seconds of generate(); text, data: bytes of the .c without and of the tables; operations of a step."""
    cases: dict[str, tuple[str, int, int]] = {
        f"{size}, {kind}": (kind, *points)
        for kind in ("linear", "cubic")
        for size, points in (("600", (600, 0)), ("6,000", (6000, 0)), ("50 x 50", (50, 50)))
    }
    for case, (kind, n, m) in cases.items():
        seconds, sources = min((_export(kind, n, m) for _ in range(asked.share(ROUNDS))), key=lambda found: found[0])
        report.add("export", seconds, "s", case=case, n=ROUNDS, limit=MOST_S)
        lines = sources["car.c"].splitlines()
        data = sum(8 * line.count(",") + 8 for line in lines if line.startswith("static const real_t lookup_"))
        report.add("text", sum(len(line) + 1 for line in lines if "real_t lookup_" not in line[:32]), "B", case=case)
        report.add("data", data, "B", case=case)
        interval = sources.description.report.operations["integrator_interval"]
        report.add("interval", interval.total, "operations", case=case)


def _mean(call: Callable[[], object], calls: int) -> float:
    start = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - start) / calls * 1e6


def _controller() -> Controller:
    ocp = OCP("data", T=2.5, N=N)
    x, u = ocp.state("x", size=5), ocp.control("u", size=2)
    m, price = ocp.parameter("m", value=1.0), ocp.parameter("price", size=2)
    ocp.dynamics({x: ca.vertcat(x[1:], u[0] * m + u[1] + price[0])})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.terminal_least_squares(x, weight=1.0)
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-9, x, 9)
    ocp.subject_to(-5, x[0] + x[1], 5, soft=Soft((10.0, 1.0), (10.0, 1.0)), name="swing")
    return build(ocp, Options(online=Online("node", "node", "node", "node", soft="node")))


def _export(kind: str, n: int, m: int) -> tuple[float, Sources]:
    speeds = np.linspace(0, 60, n)
    drag = 0.3 * np.tanh(speeds / 10) + 0.002 * speeds**2 * (1 + 0.1 * np.sin(speeds / 4))
    start = time.perf_counter()
    ocp = OCP("car", T=4.0, N=20)
    s, v, f = ocp.state("s"), ocp.state("v", initial=10.0), ocp.control("f")
    if m:
        places = np.linspace(0, 200, m)
        table = (1 + 0.2 * np.sin(places / 30))[:, None] * drag
        resistance = lookup_table((s, v), (places, speeds), table, kind)
    else:
        resistance = lookup_table(v, speeds, drag, kind)
    ocp.dynamics({s: v, v: f - resistance})
    ocp.least_squares(ca.vertcat(v, f), weight=[1, 0.1], reference=[30, 0])
    ocp.subject_to(-10, f, 8)
    sources = generate(ocp)
    return time.perf_counter() - start, sources
