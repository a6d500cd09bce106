"""The stirred tank reactor in closed loop: three set points of 200 samples each, the second one out of reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.lib.adjoint.loops import converged, follows, run
from benchmarks.lib.report import Report
from examples import cstr
from nmpc_codegen import AdjointShooting, Online, Options, RealTimeIteration, Status, build

HOLD = 200
#: Other terms of rows than the default, with their weights.
TERMS = {"smooth_l1": 1e3, "lumped": 1e3, "barrier": None}
WEIGHT = np.array([0.2, 1.0, 0.5, 0.2, 0.5, 5e-7])
LOWEST = np.array([cstr.LOWEST["th"], cstr.LOWEST["thK"]])


def measure(report: Report) -> None:
    """Cost of the loop against that of IPOPT, largest violation of the bounds of the temperatures."""
    references = np.repeat(np.array(cstr.SET_POINTS), HOLD, axis=0)
    plant = build(cstr.build_ocp(), Options(algorithm=RealTimeIteration()))
    best = run(converged(cstr.build_ocp(), 2), plant, cstr.START, references, WEIGHT, cstr.SAMPLING)
    report.add("cstr_ipopt_violation", violation(best.x), "K", n=len(references))
    shift = AdjointShooting(shift="resample", sampling_time=cstr.SAMPLING)
    others = {rows: replace(shift, rows=rows, penalty=penalty) for rows, penalty in TERMS.items()}
    cases = {
        "shifted": shift,
        "not shifted": AdjointShooting(shift=None),
        "quasi-Newton": replace(shift, method="quasi_newton"),
    }
    for case, algorithm in {**cases, **others}.items():
        given = Options(algorithm=algorithm, online=Online(reference="shared"), solve=False)
        controller, counts = build(cstr.build_ocp(), given), list[tuple[int, int, int]]()
        loop = run(follows(controller, counts), plant, cstr.START, references, WEIGHT, cstr.SAMPLING)
        products, simulations, statuses = np.array(counts).T
        if case in TERMS:
            report.add("cstr_terms_cost_gap", abs(loop.cost / best.cost - 1), case=case, n=len(references), limit=0.05)
            report.add("cstr_terms_violation", violation(loop.x), "K", case=case, n=len(references), limit=0.2)
        else:
            report.add("cstr_cost_gap", abs(loop.cost / best.cost - 1), case=case, n=len(references), limit=1e-2)
            report.add("cstr_violation", violation(loop.x), "K", case=case, n=len(references), limit=0.1)
        report.add("cstr_not_ok", int((statuses != Status.OK).sum()), "samples", case=case, n=len(references))
        report.add("cstr_products", float(products.max()), "per sample", case=case, n=len(references))
        report.add("cstr_simulations", float(simulations.max()), "per sample", case=case, n=len(references))
        report.add("cstr_struct_bytes", controller.nbytes, "bytes", case=case)


def violation(x: np.ndarray) -> float:
    """Largest violation (K) of the lower bounds of both temperatures at the samples."""
    return float(np.maximum(LOWEST - x[:, 2:], 0.0).max())
