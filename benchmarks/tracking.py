"""Tracking problems: accuracy against IPOPT, random QPs, closed loops against sqpmethod, CSTR scenario, a new clone.

    python -m benchmarks.tracking [--json FILE] [--without-clone] [--only accuracy,qps,...]

The definition of "equal to IPOPT" (per component, relative to max(1, its largest value): controls and states 1e-6, cost
1e-8) allows several optima: if the controls differ, IPOPT started at our solution must return it; the case is marked.
Multipliers are compared if LICQ and strict complementarity hold at the solution, which is tested numerically.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.lib import command
from benchmarks.lib.closed_loop import closed_loop
from benchmarks.lib.peers import QUIET, available, time_sqpmethod
from benchmarks.lib.report import Report
from benchmarks.lib.scenarios import CSTR, EXAMPLES, FIGURE_6, FIGURE_6_STEPS, Case, Example, cases
from examples import cstr
from nmpc_codegen import Controller, Status, build, generate
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import Sources, render
from nmpc_codegen.oracle.reference import Data, Point, Reference, ReferenceSolution
from nmpc_codegen.oracle.trajectory import (
    Tableau,
    interval_map,
    kkt_residuals,
    multiplier_of,
    node_data,
    node_rows,
    row_nodes,
)
from nmpc_codegen.runtime.build import PROFILES, find_compiler

TOTAL_US = {"cstr": 8.0, "quadrotor": 50.0, "chain5": 600.0}
PAPER_WORST_US = 404.0  # [H11] 4.2, a CPU of 2011
SLOWEST_PEER = 1e6  # us
ACTIVE = 1e-6  # distance from a bound, and multiplier, below which a row counts as active or its multiplier as zero

# Accuracy -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Comparison:
    """Our solution and that of IPOPT. ``other``: from the initial iterate IPOPT finds another optimum."""

    problem: Problem
    data: Data
    solution: Any
    reference: ReferenceSolution
    other: ReferenceSolution | None


def relative(a: Array, b: Array) -> float:
    """Largest difference per component, relative to max(1, largest |b| of the component)."""
    return float(np.max(np.abs(a - b) / np.maximum(1.0, np.max(np.abs(b), axis=0, initial=0.0)), initial=0.0))


def apply(controller: Controller, data: Any) -> None:
    """Set the data of a controller at run time that node_data() passes to the reference."""
    setters: dict[str, Callable[[Any], None]] = {
        "yref": controller.set_reference,
        "yref_N": controller.set_terminal_reference,
        "W": controller.set_weight,
        "W_N": controller.set_terminal_weight,
        "p": lambda values: controller.set_parameter(controller.names.parameters[0].partition("[")[0], values),
    }
    for name, value in data.items():
        setters[name](value)


def compare(case: Case, tol: float = 1e-10) -> Comparison:
    """Solve a case by the generated code and by IPOPT, both from the initial iterate."""
    ocp = case.make()
    problem = classify(ocp)
    controller = build(ocp, case.options, profile="fast")
    apply(controller, case.data)
    controller.reset()
    ours = controller.solve(case.x0, tol=tol, max_iterations=1000)
    data = node_data(problem, x0=case.x0, **case.data)
    ipopt = Reference(problem, case.tableau)
    ref = ipopt.solve(data)
    if ref.success and relative(ours.u, ref.u) <= 1e-6:
        return Comparison(problem, data, ours, ref, None)
    return Comparison(problem, data, ours, ipopt.solve(data, x=ours.x, u=ours.u), ref)


def point(solution: Any) -> Point:
    """Primal and dual variables of a Solution."""
    return Point(**{name: np.array(getattr(solution, name), dtype=float) for name in Point.__dataclass_fields__})


def active_rows(c: Comparison, tableau: Tableau) -> tuple[Array, Array, list[str]]:
    """Gradients in the controls (rows, N nu) of the active rows, |multipliers| (0 for equalities: infinity), kinds.

    dx_{k+1} = A_k dx_k + B_k du_k with dx_0 = 0: LICQ holds if and only if these gradients are independent.
    """
    problem, data, s = c.problem, c.data, point(c.solution)
    N, nx, nu = problem.N, problem.nx, problem.nu
    x, u, p, dt = (ca.SX.sym(n, size) for n, size in (("x", nx), ("u", nu), ("p", problem.np), ("dt", 1)))
    w, none = ca.vertcat(x, u), ca.SX(0, 1)
    Phi = ca.Function("Phi", [x, u, p, dt], [ca.jacobian(interval_map(problem, tableau)(x, u, p, dt)[0], w)])
    path, end = node_rows(problem.path)(x, u, p), node_rows(problem.terminal)(x, none, p)
    h = ca.Function("h", [x, u, p], [path, ca.jacobian(path, w)])
    h_N = ca.Function("h_N", [x, p], [end, ca.jacobian(end, x)])
    Z = np.zeros((N + 1, nx, N * nu))
    controls = np.eye(N * nu).reshape(N, nu, N * nu)
    for k in range(N):
        S = Phi(s.x[k], s.u[k], data.p[k], problem.dt[k]).full()
        Z[k + 1] = S @ np.vstack([Z[k], controls[k]])
    gradients, multipliers, kinds = [np.zeros((0, N * nu))], [], []
    for i, row in enumerate(problem.rows):
        for k in row_nodes(row):
            if row.kind == "control":
                value, gradient = s.u[k, row.index], controls[k, row.index]
            elif row.kind == "state":
                value, gradient = s.x[k, row.index], Z[k, row.index]
            elif k == N:
                values, J = (v.full() for v in h_N(s.x[N], data.p[N]))
                value, gradient = values[row.index_terminal, 0], J[row.index_terminal] @ Z[N]
            else:
                values, J = (v.full() for v in h(s.x[k], s.u[k], data.p[k]))
                value, gradient = values[row.index, 0], J[row.index] @ np.vstack([Z[k], controls[k]])
            low, high = data.lower[k, i], data.upper[k, i]
            if min(value - low, high - value) < ACTIVE:
                array, index = multiplier_of(problem, s, row, k)
                gradients.append(gradient[None, :])
                multipliers.append(abs(float(array[index])) if low < high else np.inf)
                kinds.append(row.kind)
    return np.vstack(gradients), np.array(multipliers), kinds


def is_regular(gradients: Array, multipliers: Array) -> bool:
    """LICQ and strict complementarity, numerically; only then are multipliers unique and comparable."""
    if not len(gradients):
        return True
    sizes = np.linalg.norm(gradients, axis=1, keepdims=True)
    if np.any(sizes == 0) or len(gradients) > gradients.shape[1]:
        return False
    smallest = float(np.linalg.svd(gradients / sizes, compute_uv=False)[-1])
    return smallest > 1e-6 and float(multipliers.min()) > ACTIVE


def accuracy(report: Report, examples: Sequence[Example] = EXAMPLES) -> None:
    """Every example and variant against IPOPT; KKT residuals recomputed in NumPy."""
    for example in examples:
        for case in cases(example):
            report_case(report, case, compare(case))


def report_case(report: Report, case: Case, c: Comparison) -> None:
    """Records of one comparison."""
    ours, ref = c.solution, c.reference
    name = case.example + (f"_{case.watched}" if case.watched else "")
    label = case.variant + ("" if c.other is None else " (IPOPT from ours)")

    def add(key: str, value: float, limit: float | None = None, **more: Any) -> None:
        report.add(f"{name}_{key}", value, case=label, limit=None if case.watched else limit, **more)

    add("u_error", relative(ours.u, ref.u), 1e-6, n=c.problem.N)
    add("x_error", relative(ours.x, ref.x), 1e-6, n=c.problem.N + 1)
    add("cost_error", abs(ours.cost - ref.cost) / abs(ref.cost) if ref.success else np.nan, 1e-8)
    if c.other is not None and c.other.success:
        add("cost_over_other_optimum", ours.cost / c.other.cost - 1)
    add("kkt", kkt_residuals(c.problem, point(ours), c.data, case.tableau).worst)
    add("not_ok", int(ours.status != Status.OK) + int(not ref.success), 0)
    gradients, multipliers, kinds = active_rows(c, case.tableau)
    if is_regular(gradients, multipliers):
        errors = [relative(getattr(ours, m), getattr(ref, m)) for m in ("lam", "mu_x", "mu_u", "mu", "mu_N")]
        add("lam_error", max(errors), 1e-5, n=c.problem.N + 1)
    for kind in ("control", "state", "general"):
        required = (kind == "general" and case.rows) or (kind == "state" and case.variant.startswith("state bounds"))
        if required:
            add(f"active_{kind}_rows", kinds.count(kind), 1, at_least=True)
    add("active_rows", len(kinds))
    add("sqp_iterations", ours.iterations)
    add("ipopt_iterations", ref.iterations if c.other is None else c.other.iterations)


# Random QPs -----------------------------------------------------------------------------------------------------------


def qps(report: Report) -> None:
    """The dense active-set solver on random QPs built from known KKT points, and on infeasible ones."""
    from benchmarks.lib.qp.qp_random import random_qp_statistics

    found = random_qp_statistics()
    limits = {"qp_wrong_answers": 0, "qp_false_infeasible": 0, "qp_missed_infeasible": 0}
    count = int(found["qp_problems"])
    for key, value in found.items():
        if isinstance(value, int | float):
            report.add(key, value, limit=limits.get(key), n=count, profile="test")
    for kind, row in found["qp_classes"].items():
        n = int(row["problems"])
        report.add("qp_class_iterations_mean", row["iterations_mean"], case=kind, n=n, profile="test")
        report.add("qp_class_iterations_max", row["iterations_max"], case=kind, n=n, profile="test")


# Times ----------------------------------------------------------------------------------------------------------------


def times(report: Report, examples: Sequence[Example] = EXAMPLES, runs: int = 15, steps: int | None = None) -> None:
    """Closed loops in C."""
    for example in examples:
        name = example.name
        ocp = example.make()
        t = closed_loop(
            generate(ocp, example.options), name, example.scenario(), runs=runs, steps=steps or example.steps
        )
        n = t.samples
        report.add(f"{name}_total_us", t.total, "us", limit=TOTAL_US.get(name), n=n)
        report.add(f"{name}_feedback_us", t.feedback, "us", n=n)
        report.add(f"{name}_total_median_us", t.total_median, "us", n=n)
        report.add(f"{name}_worst_us", t.worst, "us", n=n)
        report.add(f"{name}_failed_steps", t.failed, n=n)
        report.add(f"{name}_qp_iterations", t.qp_iterations, "per step", n=n)
        report.add(f"{name}_qp_iterations_max", t.qp_iterations_max, "per step", n=n)


def peers(report: Report, examples: Sequence[Example] = EXAMPLES, seconds: float = 2.0) -> None:
    """CasADi's sqpmethod on the same closed loops, with every QP plugin that this CasADi ships; called after times().

    A plugin that needs more than SLOWEST_PEER per step is not run on the larger examples that follow.
    """
    ours = {key: record.value for key, record in report.worst().items()}
    for plugin in QUIET:
        if not available(plugin):
            report.add(f"sqpmethod_{plugin}_missing", 1, profile="casadi")
            continue
        slow = False
        for example in examples:
            name = example.name
            key = f"sqpmethod_{plugin}_{name}"
            if slow:
                report.add(
                    f"{key}_left_out", 1, case=f"over {SLOWEST_PEER / 1e6:g} s per step before", profile="casadi"
                )
                continue
            ocp = example.make()
            plant = build(ocp, example.options, profile="fast").integrate
            peer = time_sqpmethod(
                classify(ocp), plant, example.scenario(), example.tableau, qpsol=plugin, seconds=seconds
            )
            slow = peer.total > SLOWEST_PEER
            report.add(f"{key}_us", peer.total, "us", profile="casadi", n=peer.steps)
            if f"{name}_total_us" in ours:
                report.add(f"{name}_ratio_to_{plugin}", ours[f"{name}_total_us"] / peer.total, n=peer.steps)


# Scenario of figure 6 -------------------------------------------------------------------------------------------------


def figure_6(report: Report, steps: int = FIGURE_6_STEPS, runs: int = 15) -> None:
    """Three set points of the CSTR: bounds of the predicted states and of the plant, worst-case time of a step."""
    predicted, plant, failed = violations(build(CSTR.make(), CSTR.options, profile="fast"), steps)
    report.add("cstr_bound_violation", predicted, "degC", limit=1e-10, n=steps)
    report.add("cstr_plant_violation", plant, "degC", n=steps)
    report.add("cstr_figure6_failed_steps", failed, limit=0, n=steps)
    refined = build(cstr.build_ocp(intervals=cstr.REFINED), cstr.options(), profile="fast")
    predicted, plant, failed = violations(refined, steps)
    report.add("cstr_bound_violation", predicted, "degC", case="refined grid", limit=1e-10, n=steps)
    report.add("cstr_refined_plant_violation", plant, "degC", n=steps)
    report.add("cstr_figure6_failed_steps", failed, case="refined grid", limit=0, n=steps)
    t = closed_loop(generate(CSTR.make(), CSTR.options), "cstr", FIGURE_6, runs=runs, steps=steps)
    report.add("cstr_figure6_worst_us", t.worst, "us", case="paper: 404", limit=PAPER_WORST_US, n=t.samples)
    report.add("cstr_figure6_total_us", t.total, "us", n=t.samples)
    report.add("cstr_figure6_qp_iterations_max", t.qp_iterations_max, "per step", case="paper: 21", n=t.samples)


def violations(controller: Controller, steps: int) -> tuple[float, float, int]:
    """Largest violation at the predicted nodes 1..N of every step, and of the plant at the samples (degC); failures."""
    x = np.array(FIGURE_6.x0, dtype=float)
    predicted, plant, failed = -np.inf, -np.inf, 0
    for n in range(steps):
        if n % FIGURE_6.period == 0:
            y, y_N = FIGURE_6.set_points[n // FIGURE_6.period]
            controller.set_reference(y)
            controller.set_terminal_reference(y_N)
        u = controller.step(x)
        failed += controller.status != Status.OK
        predicted = max(predicted, below_bounds(controller.x[1:]))
        x = np.asarray(controller.integrate(x, u, FIGURE_6.dt))
        plant = max(plant, below_bounds(x))
    return predicted, plant, failed


def below_bounds(x: Array) -> float:
    """Largest violation of th >= 98, thK >= 92, degC; negative inside."""
    return float(np.max(np.array([98.0, 92.0]) - x[..., 2:4]))


# Sizes ----------------------------------------------------------------------------------------------------------------


#: Functions whose operations are reported, those of condensing or of stages, depending on the package.
COUNTED = {
    "linearize", "condense_hessian", "condense_gradient", "condense_expand",
    "riccati_factorize", "riccati_backward", "riccati_forward",
}  # fmt: skip


def sizes(report: Report, examples: Sequence[Example] = EXAMPLES) -> None:
    """Exact figures: memory, size of the generated C, operations; and the size of the compiled code."""
    for example in examples:
        name = example.name
        module = lower(linearize(classify(example.make()), example.options))
        sources = render(module)
        facts = module.description.report
        report.add(f"{name}_ram_bytes", facts.ram_bytes, "bytes", profile="exact")
        text = sum(len(sources[f"{name}.{ending}"].encode()) for ending in ("h", "c"))
        report.add(f"{name}_source_bytes", text, "bytes", profile="exact")
        for part in sorted(COUNTED & facts.operations.keys()):
            operations = facts.operations[part].total
            report.add(f"{name}_{part}_operations", operations, "operations", profile="exact")
        report.add(f"{name}_code_bytes", code_bytes(sources, name), "bytes")


def code_bytes(sources: Sources, name: str) -> int:
    """Code and constants of the object file in profile "fast"."""
    with tempfile.TemporaryDirectory() as folder:
        for ending in ("h", "c"):
            Path(folder, f"{name}.{ending}").write_text(sources[f"{name}.{ending}"], encoding="utf-8")
        command = [*find_compiler(), *PROFILES["fast"].flags, "-std=c99", "-c", f"{name}.c", "-o", "package.o"]
        subprocess.run(command, cwd=folder, check=True)
        line = subprocess.run(["size", "package.o"], cwd=folder, check=True, capture_output=True, text=True).stdout
    return int(line.splitlines()[1].split()[0])


# A new clone ----------------------------------------------------------------------------------------------------------


#: key, target of make, limit (s)
CLONE = (("newcomer_seconds", "demo", 300.0), ("test_suite_seconds", "test", 600.0))


def clone(report: Report, targets: Sequence[tuple[str, str, float]] = CLONE) -> None:
    """make demo and make test as a newcomer runs them: committed files, own virtual environment, empty cache.

    The record of a target that fails is NaN, and the end of its output is shown.
    """
    root = Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder, "clone")
        subprocess.run(["git", "clone", "--quiet", str(root), str(where)], check=True)
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
        environment["NMPC_CODEGEN_CACHE"] = str(Path(folder, "cache"))
        for key, target, limit in targets:
            command = ["make", target]
            start = time.perf_counter()
            done = subprocess.run(command, cwd=where, env=environment, capture_output=True, text=True, check=False)
            seconds = time.perf_counter() - start
            if done.returncode:
                print("\n".join((done.stdout + done.stderr).splitlines()[-30:]))
            report.add(key, np.nan if done.returncode else seconds, "s", limit=limit, profile=f"make {target}")


PARTS: dict[str, Callable[[Report], None]] = {
    "times": times,
    "peers": peers,
    "figure_6": figure_6,
    "accuracy": accuracy,
    "sizes": sizes,
    "qps": qps,
    "clone": clone,
}


def main() -> None:
    """All figures."""
    parser = command.parser(__doc__, PARTS)
    parser.add_argument("--without-clone", action="store_true", help="leave out make demo and make test")
    options = parser.parse_args()
    names, report = command.chosen(parser, options, PARTS), Report("tracking")
    names = [name for name in names if not (name == "clone" and options.without_clone)]
    note = f"; CasADi {ca.__version__}, NumPy {np.__version__}"
    command.measure(report, names, lambda name: PARTS[name](report), options.json, note)


if __name__ == "__main__":
    main()
