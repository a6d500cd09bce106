"""The cost of a recording is measured: microseconds of a sample, at once and at 500 Hz, bytes in the file, opening."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from examples import chain, crane, quadrotor
from nmpc_codegen import OCP, Controller, Recorder, build, open_recording

SAMPLES, PERIOD = 1500, 0.002  # s
#: Largest overhead that is aimed at.
MOST_US = 2.0
CASES: dict[str, Callable[[], OCP]] = {
    "crane": crane.build_ocp,
    "quadrotor": lambda: quadrotor.build_ocp((0.0, 0.0, 1.0)),
    "chain, 33 states": lambda: chain.build_ocp(7),
}


def measure(report: Report, asked: Run) -> None:
    """Measure medians over the samples, in turn with and without the recorder, near the declared state."""
    for case in asked.cases(CASES):
        ctrl, samples = build(CASES[case]()), asked.share(SAMPLES, 200)
        rng, start = np.random.default_rng(asked.seed), ctrl.description.x_initial
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "run.rec"
            with Recorder(ctrl, file=file) as recorder:
                plain, recorded = [], []
                for k in range(samples):
                    x = start + 1e-3 * rng.standard_normal(start.size)
                    step, times = (recorder.step, recorded) if k % 2 else (ctrl.step, plain)
                    begin = time.perf_counter()
                    step(x)
                    end = time.perf_counter()
                    times.append(1e6 * (end - begin) - 1e-3 * ctrl.time_ns)
                    time.sleep(max(0.0, begin + PERIOD - end))
            size = file.stat().st_size / recorder.samples
            begin = time.perf_counter()
            log = open_recording(file, ctrl)
            opened = 1e6 * (time.perf_counter() - begin) / len(log.u)
        report.add("overhead", _at_once(ctrl, samples), "us", case=case, n=samples, limit=MOST_US)
        report.add("at 500 Hz", median(recorded) - median(plain), "us", case=case, n=samples)
        report.add("worst", max(recorded) - max(plain), "us", case=case, n=samples)
        report.add("sample in the file", size, "B", case=case)
        report.add("left out", recorder.dropped, "", case=case, limit=0)
        report.add("opening a sample", opened, "us", case=case)


def _at_once(ctrl: Controller, samples: int) -> float:
    """Return the overhead (us) of samples that follow each other at once, in memory."""
    x, times = ctrl.description.x_initial, []
    with Recorder(ctrl) as recorder:
        for step in (recorder.step, ctrl.step):
            found = []
            for _ in range(samples):
                begin = time.perf_counter()
                step(x)
                found.append(1e6 * (time.perf_counter() - begin) - 1e-3 * ctrl.time_ns)
            times.append(median(found))
    return times[0] - times[1]
