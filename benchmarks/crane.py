"""The crane [H11 4.1]: from the import to a controller, and time against peers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import casadi as ca
import numpy as np

from benchmarks.lib import command
from benchmarks.lib.report import Report
from examples.crane import build_ocp
from nmpc_codegen import build, generate
from nmpc_codegen.frontend.classify import classify
from verification.closed_loop import closed_loop
from verification.peers import time_sqpmethod
from verification.scenarios import CRANE_LOOP

CASES = {"terminal constraint": True, "terminal weight": False}


def times(report: Report) -> None:
    """Closed loop in C, and CasADi's sqpmethod with qpOASES in the same run."""
    for case, constraint in CASES.items():
        ocp = build_ocp(constraint)
        t = closed_loop(generate(ocp), "crane", CRANE_LOOP)
        report.add("crane_total_us", t.total, "us", case=case, limit=2.6, n=t.samples)
        report.add("crane_feedback_us", t.feedback, "us", case=case, limit=1.0, n=t.samples)
        report.add("crane_total_median_us", t.total_median, "us", case=case, n=t.samples)
        report.add("crane_failed_steps", t.failed, case=case, n=t.samples)
        report.add("crane_qp_iterations", t.qp_iterations, "per step", case=case, n=t.samples)
        plant = build(ocp).integrate
        peer = time_sqpmethod(classify(ocp), plant, CRANE_LOOP)
        report.add("sqpmethod_total_us", peer.total, "us", case=case, profile="casadi", n=peer.steps)
        report.add("crane_ratio_to_sqpmethod", t.total / peer.total, case=case, n=t.samples)


IMPORT_TO_CONTROLLER = """
import sys, time
start = time.perf_counter()
from nmpc_codegen import build, export
from examples.crane import build_ocp
ocp = build_ocp()
export(ocp, None, sys.argv[1])
build(ocp)
print(time.perf_counter() - start)
"""


def export_time(report: Report) -> None:
    """Time from the import in Python to the loaded controller, with empty caches."""
    import os
    import tempfile

    seconds = []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "NMPC_CODEGEN_CACHE": folder}
            command = [sys.executable, "-c", IMPORT_TO_CONTROLLER, folder]
            out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
            seconds.append(float(out))
    report.add("export_build_s", float(np.median(seconds)), "s", limit=3.0, n=len(seconds))


PARTS: dict[str, Callable[[Report], None]] = {"export": export_time, "times": times}


def main() -> None:
    """All figures, or some."""
    parser = command.parser(__doc__, PARTS)
    options = parser.parse_args()
    names, report = command.chosen(parser, options, PARTS), Report("crane")
    note = f"; CasADi {ca.__version__}, NumPy {np.__version__}"
    command.measure(report, names, lambda name: PARTS[name](report), options.json, note)


if __name__ == "__main__":
    main()
