"""Batches are measured: bits, threads, overhead, closed loops in compiled code, kernels for a GPU."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from examples import crane, quadrotor
from nmpc_codegen import OCP, Batch, Controller, Options, RealTimeIteration, build
from nmpc_codegen.runtime.batch.cuda import BEGIN
from nmpc_codegen.runtime.batch.device import kernel_text
from nmpc_codegen.runtime.batch.nvrtc import compile_kernel

Array = NDArray[np.float64]

#: Limits: time of one thread over that of two; overhead of a call (us) for every controller; NumPy calls over compiled
#: loops; time of NVRTC (s).
TWO_THREADS, OVERHEAD, LOOPS, NVRTC = 1.7, 0.2, 1.5, 60.0

#: Controllers of a batch, and flights in closed loop; samples whose rate is measured, and of a whole flight.
SIZES, FLIGHTS = (1, 10, 100, 1000, 10_000, 100_000), (1000, 10_000, 100_000, 1_000_000)
FIRST, SAMPLES = 10, 50
STD = np.array([0.01, 0.01, 0.001, 0.01])


def measure(report: Report, asked: Run) -> None:
    """Measure all figures."""
    controller = build(crane.build_ocp(), Options(algorithm=RealTimeIteration(sampling_time=0.3)))
    X = np.array([2.0, 0.0, 0.0, 0.0]) + 0.1 * np.random.default_rng(asked.seed).normal(size=(max(FLIGHTS), 4))
    threads = Batch(controller, 1).threads
    _compare_bits(report, controller, X[: asked.share(2000, 40)], threads)
    for size in SIZES if asked.scale == 1 else SIZES[:3]:
        for count in sorted({1, threads}):
            _time_calls(report, controller, X[:size], count)
    for size in FLIGHTS if asked.scale == 1 else FLIGHTS[:1]:
        for count in sorted({1, threads}):
            _time_loops(report, controller, X[:size], count)
    _compare_with_calls(report, controller, X[: asked.share(10_000, 200)])
    _measure_overhead(report, asked.share(100_000, 1000))
    if find_spec("nvidia") is not None and asked.scale:
        _compile_kernels(report)


def _seconds(function: Callable[[], object], least: float = 0.3) -> float:
    """Return the shortest of several runs, which together take at least this time."""
    best, total = np.inf, 0.0
    while total < least:
        start = time.perf_counter()
        function()
        took = time.perf_counter() - start
        best, total = min(best, took), total + took
    return float(best)


def _compare_bits(report: Report, controller: Controller, X: Array, threads: int) -> None:
    """Compare samples and flights by 1, 2 and all threads."""
    found = []
    for count in sorted({1, 2, threads}):
        many = Batch(controller, len(X), count)
        flights = many.simulate(X, SAMPLES, disturbance=STD)
        u, status = many.step(X)
        found.append((flights.last, flights.cost, flights.violation, u, status, many.memory))
    different = sum(not np.array_equal(a, b) for one in found[1:] for a, b in zip(found[0], one, strict=True))
    report.add("different arrays on 1, 2 and all threads", different, case="crane", n=len(X), limit=0)


def _time_calls(report: Report, controller: Controller, X: Array, threads: int) -> None:
    """Time the first samples of a loop by calls of step() and integrate()."""
    many = Batch(controller, len(X), threads)

    def loop() -> None:
        many.reset()
        x = X
        for _ in range(FIRST):
            u, _ = many.step(x)
            x = many.integrate(x, u, 0.3)

    _add_rate(report, f"crane, {len(X):,} in calls", threads, len(X) * FIRST, _seconds(loop))


def _time_loops(report: Report, controller: Controller, X: Array, threads: int) -> None:
    """Time the same samples by simulate()."""
    many = Batch(controller, 1, threads)
    took = _seconds(lambda: many.simulate(X, FIRST))
    _add_rate(report, f"crane, {len(X):,} in compiled loops", threads, len(X) * FIRST, took)


def _add_rate(report: Report, case: str, threads: int, samples: int, took: float) -> None:
    word = "thread" if threads == 1 else "threads"
    report.add(f"samples per second, {threads} {word}", samples / took, case=case, n=samples)


def _compare_with_calls(report: Report, controller: Controller, X: Array) -> None:
    """Compare with calls of step() and integrate() on arrays, and measure the gain of two threads."""
    random = np.random.default_rng(0)

    def calls(threads: int) -> float:
        many = Batch(controller, len(X), threads)

        def loop() -> None:
            x = X
            for _ in range(SAMPLES):
                u, _ = many.step(x)
                x = many.integrate(x, u, 0.3) + STD * random.normal(size=x.shape)

        return _seconds(loop)

    def loops(threads: int) -> float:
        many = Batch(controller, 1, threads)
        return _seconds(lambda: many.simulate(X, SAMPLES, disturbance=STD))

    n = len(X) * SAMPLES
    report.add("compiled loops over NumPy calls", calls(2) / loops(2), case="crane", n=n, limit=LOOPS, at_least=True)
    for what, of in (("calls", calls), ("compiled loops", loops)):
        speedup = of(1) / of(2)
        report.add(f"two threads over one, {what}", speedup, case="crane", n=n, limit=TWO_THREADS, at_least=True)


def _measure_overhead(report: Report, number: int) -> None:
    """Measure the overhead of a call by integrate() of a map with one state, which takes some nanoseconds."""
    ocp = OCP("still", N=1)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x + u}, discrete=True)
    ocp.least_squares(u, 1.0)
    many = Batch(build(ocp), number, 1)
    X, U = np.ones((number, 1)), np.ones((number, 1))
    took = _seconds(lambda: many.integrate(X, U, 1.0))
    report.add("time per controller of the shortest call", 1e6 * took / number, "us", case="one state", limit=OVERHEAD)


def _compile_kernels(report: Report) -> None:
    """Time NVRTC without a cache."""
    for module in (crane, quadrotor):
        package = build(module.build_ocp(), profile="test")._package
        text = kernel_text(package, BEGIN) + f"/* {time.time_ns()} */\n"
        start = time.perf_counter()
        path = compile_kernel(text, "sm_90", exact=False)
        took = time.perf_counter() - start
        report.add("NVRTC, sm_90", took, "s", case=package.name, limit=NVRTC)
        report.add("machine code", path.stat().st_size, "B", case=package.name)
        path.unlink()
        path.with_suffix(".sha256").unlink(missing_ok=True)
