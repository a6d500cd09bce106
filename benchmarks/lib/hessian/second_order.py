"""Second-order sensitivities: operations, memory, time of both schemes; [Q14] Table I."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from benchmarks.lib.kernels import code_bytes, times
from benchmarks.lib.report import Report
from examples import bioreactor, cart_pole, chain, crane, cstr, quadrotor
from nmpc_codegen import OCP, RK4, ExplicitRungeKutta
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Kernel, lift
from nmpc_codegen.ir.sweep import Call, For, LoopedRoutine, Node, Routine, Slice, unroll
from nmpc_codegen.ir.tuning import PANEL

SWEEPS = {"tsp": "symmetric", "foa": "forward_over_adjoint"}


@dataclass(frozen=True)
class Model:
    """A problem, its RK4 steps per interval, and the distance from its initial state up to which points are drawn."""

    make: Callable[[], OCP]
    steps: int
    limit: float | None = None  # on the time of the exact Hessian over that of forward sensitivities


MODELS = {
    "crane": Model(crane.build_ocp, 2, 1.5),
    "cstr": Model(cstr.build_ocp, 2, 1.5),
    "bioreactor": Model(lambda: bioreactor.build_ocp(periodic=False), bioreactor.STEPS, 1.5),
    "quadrotor": Model(quadrotor.build_ocp, 1, 2.0),
    "cart_pole": Model(lambda: cart_pole.build_ocp(any_length=True), 2),
    "chain3": Model(lambda: chain.build_ocp(3), 2),
    "chain5": Model(lambda: chain.build_ocp(5), 2),
    "chain7": Model(lambda: chain.build_ocp(7), 2),
}


def curved(problem: Problem, component: Any, scheme: str) -> Routine:
    """x_next, S, gradient and Hessian of an interval; the node adds no terms."""
    nz = problem.nx + problem.nu
    zeros = ca.Function("zeros", [], [ca.SX.zeros(nz), ca.SX.zeros(nz * nz)])
    start = Call(zeros, (), (Slice("g", nz), Slice("Q", nz * nz)))
    routine: Routine = component.curved(problem, SWEEPS[scheme], "curved", start, ())
    return routine


def points(problem: Problem, n: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Random points around the initial state."""
    random = np.random.default_rng(seed)
    x = problem.x_initial * (1 + 0.02 * random.standard_normal((n, problem.nx)))
    lower = np.array(
        [next((r.lower for r in problem.rows if r.kind == "control" and r.index == j), -1.0) for j in range(problem.nu)]
    )
    upper = np.array(
        [next((r.upper for r in problem.rows if r.kind == "control" and r.index == j), 1.0) for j in range(problem.nu)]
    )
    return {
        "x": x + 0.01 * random.standard_normal(x.shape),
        "u": random.uniform(np.maximum(lower, -1e4), np.minimum(upper, 1e4), (n, problem.nu)),
        "p": np.tile(problem.p_value, (n, 1)),
        "dt": np.full((n, 1), problem.dt[0]),
        "lam": random.standard_normal((n, problem.nx)),
    }


# Errors --------------------------------------------------------------------------------------------------------------


# The promise ---------------------------------------------------------------------------------------------------------


def forward_problem(problem: Problem) -> Problem:
    """The same dynamics; an integrated cost becomes a state, so that its gradient is a forward sensitivity."""
    if problem.path.cost_rate is None:
        return problem
    if problem.np:
        raise ValueError(f"{problem.name}: an integrated cost with parameters")
    ocp = OCP("forward", T=sum(problem.dt), N=problem.N)
    x, u = ocp.state("x", size=problem.nx), ocp.control("u", size=problem.nu)
    ocp.state("q")
    stage = problem.path
    rates = ca.vertcat(problem.dynamics(stage.x, stage.u, stage.p), stage.cost_rate)
    ocp.dynamics(ca.substitute(rates, ca.vertcat(stage.x, stage.u), ca.vertcat(x, u)))
    ocp.least_squares(u, weight=np.ones(problem.nu))
    return classify(ocp)


def one_program(routine: Routine, sweep_of: LoopedRoutine) -> Kernel:
    """A sweep as one straight-line program without any loop, lower triangle of Q: fewest operations, most code."""
    function = unroll(sweep_of.sweep)
    symbols = [ca.SX.sym(port.name, port.size) for port in routine.inputs]
    outputs = function.call(symbols)
    outputs[-1] = ca.sparsify(ca.tril(outputs[-1]))
    return lift(ca.Function("curved", symbols, outputs), "curved", routine.doc, routine.inputs, routine.outputs)


#: unroll -> its name in the table and in keys
SPELLED = {"all": ('unroll="all"', "unrolled"), "none": ("looped", "looped"), "scalar": ("no loop at all", "scalar")}


def promise(report: Report) -> None:
    """Exact Hessian over forward sensitivities: time, operations and code; FOA over TSP."""
    for name, model in MODELS.items():
        problem = classify(model.make())
        forward = forward_problem(problem)
        long = name in ("chain5", "chain7")  # their straight-line programs take the compiler minutes
        spelled = ("none",) if long else ("all", "none", "scalar")
        routines: dict[str, Routine] = {}
        for word in spelled:
            way: Any = "all" if word == "scalar" else word
            component = ExplicitRungeKutta(RK4, model.steps, way)
            routines[f"forward_{word}"] = component.interval(forward).linearize
            for scheme in SWEEPS:
                routine = curved(problem, component, scheme)
                assert isinstance(routine, LoopedRoutine)
                routines[f"{scheme}_{word}"] = one_program(routine, routine) if word == "scalar" else routine
        data = points(problem, 20)
        if forward is not problem:
            data["x"] = np.hstack([data["x"], np.zeros((20, 1))])
        t = times(routines, data, 40 if name.startswith("chain") else 400)
        for word in spelled:
            _report_spelling(report, name, model, word, routines, t)
        ratio = t["foa_none"] / t["tsp_none"]
        if name == "bioreactor":
            report.add("foa_over_tsp", ratio, case="time, looped", limit=1.3, at_least=True, n=20)
        report.add(f"{name}_foa_over_tsp", ratio, case="time, looped", at_least=True, n=20)
    explain()


def _report_spelling(
    report: Report, name: str, model: Model, word: str, routines: Mapping[str, Routine], t: Mapping[str, float]
) -> None:
    watched = "_scalar" if word == "scalar" else ""
    case, key = SPELLED[word]
    ratio = t[f"tsp_{word}"] / t[f"forward_{word}"]
    limit = None if watched else model.limit
    report.add(f"{name}_exact_over_forward{watched}", ratio, case=f"time, {case}", limit=limit, n=20)
    for what in ("forward", *SWEEPS):
        routine = routines[f"{what}_{word}"]
        report.add(f"{name}_{what}_{key}_ns", t[f"{what}_{word}"], "ns", case=case, n=20)
        report.add(f"{name}_{what}_{key}_operations", routine.count.total, "operations", case=case, profile="exact")
        report.add(f"{name}_{what}_{key}_code_bytes", code_bytes(routine), "bytes", case=case)


#: Parts of both schemes and the leaves that they consist of.
GROUPS = {
    "points": ("f", "taped_f", "point", "update"),
    "derivatives of f": ("tape", "curvature"),
    "S": ("slope", "update_columns"),
    "adjoint": ("backward",),
    "H": ("bend", "accumulate", "sum", "bar", "update_bars"),
    "rest": (),
}


def explain() -> None:
    """Distribution of the operations of the bioreactor's loops: all of them, and as instructions on vectors of four.

    With four packed columns a symmetric product saves no instructions. Three sweeps are faster because the terms of the
    sum are independent of one another: their factors are evaluated for all stages of a step at once. The reference
    follows [Q14] algorithm 1, one stage after the other; its tapes could be treated in the same way.
    """
    model = MODELS["bioreactor"]
    problem = classify(model.make())
    component = ExplicitRungeKutta(RK4, model.steps, "none")
    table = Table(title="bioreactor, looped: operations (scalar and vector instructions)")
    for column in ("", *GROUPS, "all"):
        table.add_column(column, justify="right")
    for scheme in SWEEPS:
        routine = curved(problem, component, scheme)
        assert isinstance(routine, LoopedRoutine)
        found = {group: np.zeros(2) for group in GROUPS}
        _collect(routine.sweep.body, routine, found)
        cells = [*found.values(), sum(found.values(), np.zeros(2))]
        table.add_row(scheme.upper(), *(f"{all_:.0f} ({issued:.0f})" for all_, issued in cells))
    Console(width=140).print(table)


def _collect(
    nodes: tuple[Node, ...], routine: LoopedRoutine, found: dict[str, np.ndarray], times: int = 1, vector: int = 1
) -> None:
    for node in nodes:
        if isinstance(node, For):
            n = len(node.values({}))
            vectors = node.index in ("c", "s") and n % PANEL == 0
            _collect(node.body, routine, found, times * n, PANEL if vectors else vector)
            continue
        name = node.leaf.name()
        words = (name, name.rstrip("0123456789").rstrip("_"))
        group = next((g for g, leaves in GROUPS.items() if any(w in leaves for w in words)), "rest")
        total = times * routine.leaves[name].count.total
        found[group] += np.array([total, total / vector])


# Table I -------------------------------------------------------------------------------------------------------------


def dense(nz: int) -> Problem:
    """nz - 1 states and one control, every derivative nonzero; one Euler step is one recursion z+ = phi(z)."""
    ocp = OCP("dense", T=1.0, N=1)
    x, u = ocp.state("x", size=nz - 1), ocp.control("u")
    M = np.random.default_rng(nz).uniform(0.1, 1, (nz - 1, nz))
    ocp.dynamics(ca.sin(M @ ca.vertcat(x, u)) ** 2)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(nz))
    return classify(ocp)


#: Leaves of the propagation, and the buffers that it needs besides derivatives of phi.
LEAVES = {"tsp": ("bend", "accumulate", "sum"), "foa": ("bar", "update_bars")}
BUFFERS = {"tsp": ("Xs", "kappa", "Z", "Sx", "H"), "foa": ("Xs", "Zs", "Sx", "adj", "adjS", "ubarS")}
TABLE_1 = Path(__file__).parents[3] / "out" / "table_1.png"


def table_1(steps: int = 10) -> list[dict[str, float]]:
    """Operations per step and numbers stored for n steps, counted from the emitted loops, and the paper's formulas.

    As in the paper, a product counts as one operation. Columns are padded to multiples of PANEL. ``memory`` is the
    storage of the recursions of S and H, without the slopes of a step, which are local to it.
    """
    rows = []
    for nz in range(2, 21):
        problem = dense(nz)
        row: dict[str, float] = {"nz": nz}
        for scheme in SWEEPS:
            routine = curved(problem, ExplicitRungeKutta("Euler", steps, "none"), scheme)  # type: ignore[arg-type]
            assert isinstance(routine, LoopedRoutine)
            row[f"{scheme}_products"] = _products(routine.sweep.body, routine, LEAVES[scheme]) / steps
            row[f"{scheme}_all"] = routine.count.total / steps
            sizes = dict(routine.sweep.locals)
            row[f"{scheme}_memory"] = sum(sizes.get(buffer, 0) for buffer in BUFFERS[scheme])
        n = steps
        row["tsp_formula"], row["foa_formula"] = nz**3 + nz**2 * (nz + 1) / 2, 2 * nz**3
        row["tsp_memory_formula"] = n * (nz + nz) + nz**2 + nz * (nz + 1) / 2
        row["foa_memory_formula"] = n * (nz + nz**2) + nz + nz**2
        rows.append(row)
    return rows


def report_table_1(report: Report) -> None:
    """Table, picture, and the ratios at nz = 20."""
    rows = table_1()
    table = Table(title="[Q14] Table I: products per step, numbers stored for 10 steps; counted (formula)")
    for title in ("nz", "TSP", "FOA", "FOA/TSP", "TSP stores", "FOA stores", "all operations: TSP", "FOA"):
        table.add_column(title, justify="right")
    for row in rows:
        both = [f"{row[f'{s}_products']:.0f} ({row[f'{s}_formula']:.0f})" for s in SWEEPS]
        ratio = f"{row['foa_products'] / row['tsp_products']:.2f} ({row['foa_formula'] / row['tsp_formula']:.2f})"
        memory = [f"{row[f'{s}_memory']:.0f} ({row[f'{s}_memory_formula']:.0f})" for s in SWEEPS]
        every = [f"{row[f'{s}_all']:.0f}" for s in SWEEPS]
        table.add_row(f"{row['nz']:.0f}", *both, ratio, *memory, *every)
    Console(width=140).print(table)
    draw_table_1(rows, TABLE_1)
    for row in (rows[4], rows[10], rows[18]):
        case = f"nz = {row['nz']:.0f}"
        for what in ("products", "memory"):
            ratio = row[f"foa_{what}"] / row[f"tsp_{what}"]
            report.add(f"table1_foa_over_tsp_{what}", ratio, case=case, at_least=True, profile="exact")
            for scheme in SWEEPS:
                formula = row[f"{scheme}_formula" if what == "products" else f"{scheme}_memory_formula"]
                excess = row[f"{scheme}_{what}"] / formula
                report.add(f"table1_{scheme}_{what}_over_formula", excess, case=case, profile="exact")


def _products(nodes: tuple[Node, ...], routine: LoopedRoutine, leaves: tuple[str, ...], indices: Any = None) -> int:
    """Multiplications in the given leaves, with loops multiplied out."""
    total = 0
    for node in nodes:
        if isinstance(node, For):
            for value in node.values(indices or {}):
                total += _products(node.body, routine, leaves, {**(indices or {}), node.index: value})
        elif node.leaf.name().startswith(leaves):
            total += routine.leaves[node.leaf.name()].count.mul
    return total


def draw_table_1(rows: list[dict[str, float]], picture: Path) -> None:
    """Both schemes, counted and by the formulas of the paper."""
    nz = [row["nz"] for row in rows]
    figure = Figure(figsize=(9, 4), layout="constrained")
    for axis, what, formula, title in zip(
        figure.subplots(1, 2),
        ("products", "memory"),
        ("formula", "memory_formula"),
        ("products per step", "numbers stored, 10 steps"),
        strict=True,
    ):
        for scheme, color in (("tsp", "#1f5fa8"), ("foa", "#c2571a")):
            axis.plot(
                nz, [row[f"{scheme}_{what}"] for row in rows], "o", color=color, label=f"{scheme.upper()}, counted"
            )
            axis.plot(nz, [row[f"{scheme}_{formula}"] for row in rows], color=color, linewidth=1, label="formula")
        axis.set(xlabel="nz", title=title, xticks=range(2, 21, 3))
        axis.grid(alpha=0.25)
        axis.legend(frameon=False)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
