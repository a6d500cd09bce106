"""The crane with x_N = 0: memory of the struct and its stack, closed loop of 30 samples from (2, 0, 0, 0)."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.lib.adjoint.loops import converged, follows, run
from benchmarks.lib.report import Report
from examples import crane
from nmpc_codegen import AdjointShooting, Online, Options, RealTimeIteration, Status, build, generate
from nmpc_codegen.firmware.certificate import certify
from nmpc_codegen.targets import TARGETS

SAMPLES, DT = 30, 0.3
X0 = np.array([2.0, 0.0, 0.0, 0.0])
TARGET = "cortex-m4f"
BYTES = {"double": 2048, "single": 1024}


def options(precision: Any = "double", **algorithm: Any) -> Options:
    """A controller for real-time use alone, with one reference for all nodes."""
    return Options(
        algorithm=AdjointShooting(shift="repeat", **algorithm),
        online=Online(reference="shared"),
        precision=precision,
        solve=False,
    )


def measure(report: Report) -> None:
    """Bytes, the cost of the loop against that of IPOPT, and the state at its end."""
    plant = build(crane.build_ocp(), Options(algorithm=RealTimeIteration(shift="repeat")))
    references, weight = np.zeros((SAMPLES, 5)), np.ones(5)
    best = run(converged(crane.build_ocp(), 2), plant, X0, references, weight, DT)
    report.add("crane_ipopt_final_state", float(np.abs(best.x[-1]).max()))
    cases = {
        "double": options(),
        "single": options("single"),
        "quasi-Newton": options(method="quasi_newton"),
        "smooth_l1": options(rows="smooth_l1", penalty=100.0),
        "lumped": options(rows="lumped", penalty=100.0),
    }
    for case, given in cases.items():
        controller = build(crane.build_ocp(), given)
        counts: list[tuple[int, int, int]] = []
        loop = run(follows(controller, counts), plant, X0, references, weight, DT)
        if case in BYTES:
            report.add(f"crane_struct_bytes_{case}", controller.nbytes, "bytes", limit=BYTES[case])
            stack = certify(generate(crane.build_ocp(), given), "crane", TARGETS[TARGET], "Os").stack_bytes["step"]
            report.add(f"crane_stack_bytes_{case}", stack, "bytes", case=f"step() on a {TARGET}, -Os", profile="")
        gap = "crane_cost_gap" if case in BYTES else "crane_terms_cost_gap"
        report.add(gap, abs(loop.cost / best.cost - 1), case=case, n=SAMPLES, limit=1e-2)
        final = "crane_final_state" if case in BYTES else "crane_terms_final_state"
        report.add(final, float(np.abs(loop.x[-1]).max()), case=case, n=SAMPLES, limit=5e-3)
        products, simulations, statuses = np.array(counts).T
        report.add("crane_not_ok", int((statuses != Status.OK).sum()), "samples", case=case, n=SAMPLES)
        report.add("crane_products", float(products.max()), "per sample", case=case, n=SAMPLES)
        report.add("crane_simulations", float(simulations.max()), "per sample", case=case, n=SAMPLES)
