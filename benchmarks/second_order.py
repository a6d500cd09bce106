"""Second-order sensitivities: errors against two oracles; operations, memory, time of both schemes; [Q14] Table I."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from benchmarks.kernels import code_bytes, times
from benchmarks.report import Report
from examples import bioreactor, cart_pole, chain, crane, cstr, quadrotor
from nmpc_codegen import OCP, RK4, ExplicitRungeKutta
from nmpc_codegen.analyse import analyse
from nmpc_codegen.evaluation import Tableau, interval_map
from nmpc_codegen.integrators import TABLEAUS, Discrete
from nmpc_codegen.problem import Problem
from nmpc_codegen.sweep import Call, For, LoopedRoutine, Node, Routine, Slice
from tests.c_harness import Routines
from tests.models import discrete_map
from tests.oracles.jets import interval, run
from tests.oracles.runge_kutta import SCHEMES

SWEEPS = {"tsp": "symmetric", "foa": "forward_over_adjoint"}
UNROLL = ("all", "step", "none", "auto")


@dataclass(frozen=True)
class Model:
    """A problem, its RK4 steps per interval, and how far from its initial state points are drawn."""

    make: Callable[[], OCP]
    steps: int
    limit: float | None = None  # on the time of exact over that of forward sensitivities


MODELS = {
    "crane": Model(crane.build_ocp, 2, 1.5),
    "cstr": Model(cstr.build_ocp, 2, 1.5),
    "bioreactor": Model(lambda: bioreactor.build_ocp(periodic=False), bioreactor.STEPS, 1.5),
    "quadrotor": Model(quadrotor.build_ocp, 1, 2.0),
    "cart_pole": Model(lambda: cart_pole.build_ocp(any_length=True), 2),
    "chain3": Model(lambda: chain.build_ocp(3), 2),
    "chain5": Model(lambda: chain.build_ocp(5), 2),
}


def curved(problem: Problem, component: Any, scheme: str) -> Routine:
    """x_next, S, gradient and Hessian of an interval; the node itself adds nothing."""
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


def errors() -> Iterator[tuple[str, str, float, int]]:
    """(scheme, case, largest normwise error of Q, S and g against CasADi and against Taylor arithmetic, points)."""
    for name, model in MODELS.items():
        if name == "chain5":
            continue  # the oracles would take minutes; chain3 has its structure
        problem = analyse(model.make())
        for tableau in TABLEAUS if name in ("crane", "bioreactor") else ("RK4",):
            for steps in (1, 2, 3) if name == "crane" else (model.steps,):
                components = {n: ExplicitRungeKutta(TABLEAUS[tableau], steps, n) for n in UNROLL}  # type: ignore[arg-type]
                yield from _errors(f"{name}, {tableau}, {steps} steps", problem, components, tableau, steps)
    yield from _errors("discrete map", analyse(discrete_map()), {"map": Discrete()}, "", 0)


def _errors(
    case: str, problem: Problem, components: dict[str, Any], tableau: str, steps: int
) -> Iterator[tuple[str, str, float, int]]:
    data = points(problem, 3)
    if problem.discrete:
        data["x"], data["u"] = np.random.default_rng(0).uniform(-1, 1, (2, 3, problem.nx))
    call = Routines({f"{s}_{n}": curved(problem, c, s) for s in SWEEPS for n, c in components.items()})
    worst = dict.fromkeys(SWEEPS, 0.0)
    for k in range(3):
        arguments = [data[name][k] for name in ("x", "u", "p", "dt", "lam")]
        for exact in (_by_casadi(problem, tableau, steps, *arguments), _by_jets(problem, tableau, steps, *arguments)):
            for scheme in SWEEPS:
                for n in components:
                    _, S, g, Q = call(f"{scheme}_{n}", *arguments)
                    for got, wanted in zip((S, g, np.tril(Q)), exact, strict=True):
                        scale = np.linalg.norm(wanted)
                        worst[scheme] = max(
                            worst[scheme], float(np.linalg.norm(got - wanted) / scale) if scale else 0.0
                        )
    for scheme, error in worst.items():
        yield scheme, case, error, 3 * len(components)


def _by_casadi(
    problem: Problem, tableau: str, steps: int, x: Any, u: Any, p: Any, dt: Any, lam: Any
) -> tuple[Any, ...]:
    X, U = ca.SX.sym("x", problem.nx), ca.SX.sym("u", problem.nu)
    scheme = Tableau(*(np.array(v, dtype=float) for v in SCHEMES[tableau]), steps) if tableau else Tableau((), ())
    end, q = interval_map(problem, scheme)(X, U, p, float(dt[0]))
    z = ca.vertcat(X, U)
    values = [ca.jacobian(end, z), ca.gradient(q, z), ca.tril(ca.hessian(ca.dot(lam, end) + q, z)[0])]
    found = ca.Function("exact", [X, U], values)(x, u)
    return np.array(found[0]), np.array(found[1]).ravel(), np.array(found[2])


def _by_jets(problem: Problem, tableau: str, steps: int, x: Any, u: Any, p: Any, dt: Any, lam: Any) -> tuple[Any, ...]:
    stage = problem.path
    rate = None
    if stage.cost_rate is not None:
        rate = ca.Function("rate", [stage.x, stage.u, stage.p], [stage.cost_rate])
    if problem.discrete:
        end, q = interval(problem.dynamics, None, ([[0.0]], [0.0]), 1, 0.0, x, u, p)
        end = run(problem.dynamics, _jets(x, u, p), len(x) + len(u))
    else:
        end, q = interval(problem.dynamics, rate, SCHEMES[tableau], steps, float(dt[0]), x, u, p)
    S = np.array([jet.g for jet in end])
    return S, q.g, np.tril(sum((weight * jet.H for weight, jet in zip(lam, end, strict=True)), q.H))


def _jets(x: Any, u: Any, p: Any) -> tuple[list[Any], ...]:
    from tests.oracles.jets import Jet

    size = len(x) + len(u)
    unit, flat = np.eye(size), np.zeros((size, size))
    z = [Jet(float(v), unit[i], flat) for i, v in enumerate((*x, *u))]
    return z[: len(x)], z[len(x) :], [Jet(float(v), np.zeros(size), flat) for v in p]


# The promise ---------------------------------------------------------------------------------------------------------


def forward_problem(problem: Problem, make: Callable[[], OCP]) -> Problem:
    """The same dynamics; an integrated cost becomes a state: its gradient is part of the forward sensitivities."""
    if problem.path.cost_rate is None:
        return problem
    old = make()
    ocp = OCP("forward", T=sum(problem.dt), N=problem.N)
    x, u = ocp.state("x", size=problem.nx), ocp.control("u", size=problem.nu)
    ocp.state("q")
    stage = problem.path
    rates = ca.vertcat(problem.dynamics(stage.x, stage.u, stage.p), stage.cost_rate)
    ocp.dynamics(ca.substitute(rates, ca.vertcat(stage.x, stage.u), ca.vertcat(x, u)))
    ocp.least_squares(u, weight=np.ones(problem.nu))
    assert old.p.numel() == 0
    return analyse(ocp)


def promise(report: Report) -> dict[str, dict[str, float]]:
    """Exact Hessian over forward sensitivities: time and operations, straight-line and looped; code size."""
    found = {}
    for name, model in MODELS.items():
        problem = analyse(model.make())
        forward = forward_problem(problem, model.make)
        routines: dict[str, Routine] = {}
        spelled = (
            ("none", "auto") if name == "chain5" else ("all", "none", "auto")
        )  # 65,000 instructions in one function
        for unroll in spelled:
            component = ExplicitRungeKutta(RK4, model.steps, unroll)  # type: ignore[arg-type]
            routines[f"forward_{unroll}"] = component.routines(forward)[0]
            for scheme in SWEEPS:
                routines[f"{scheme}_{unroll}"] = curved(problem, component, scheme)
        data = points(problem, 20)
        if forward is not problem:
            data["x"] = np.hstack([data["x"], np.zeros((20, 1))])
        t = found[name] = times(routines, data, 40 if name.startswith("chain") else 400)
        ops = {key: r.count.total for key, r in routines.items()}
        for unroll in spelled:
            word = {"all": "straight-line", "none": "looped", "auto": "auto"}[unroll]
            limit = model.limit if unroll != "auto" else None
            key = f"{name}_exact_over_forward" if unroll != "auto" else f"{name}_exact_over_forward_auto"
            report.add(key, t[f"tsp_{unroll}"] / t[f"forward_{unroll}"], case=f"time, {word}", limit=limit, n=20)
            report.add(
                f"{name}_operations_over_forward", ops[f"tsp_{unroll}"] / ops[f"forward_{unroll}"], case=word, n=1
            )
            report.add(f"{name}_tsp_ns", t[f"tsp_{unroll}"], "ns", case=word, n=20)
            report.add(f"{name}_foa_ns", t[f"foa_{unroll}"], "ns", case=word, n=20)
            report.add(f"{name}_forward_ns", t[f"forward_{unroll}"], "ns", case=word, n=20)
            report.add(f"{name}_tsp_code_bytes", code_bytes(routines[f"tsp_{unroll}"]), "bytes", case=word)
    return found


# Table I -------------------------------------------------------------------------------------------------------------


def dense(nz: int) -> Problem:
    """nz - 1 states and one control, every derivative nonzero; one Euler step is one recursion z+ = phi(z)."""
    ocp = OCP("dense", T=1.0, N=1)
    x, u = ocp.state("x", size=nz - 1), ocp.control("u")
    M = np.random.default_rng(nz).uniform(0.1, 1, (nz - 1, nz))
    ocp.dynamics(ca.sin(M @ ca.vertcat(x, u)) ** 2)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(nz))
    return analyse(ocp)


#: Leaves of the propagation, and the buffers that it needs besides derivatives of phi.
LEAVES = {"tsp": ("bend", "accumulate", "sum"), "foa": ("bar", "update_bars")}
BUFFERS = {"tsp": ("Xs", "kappa", "Sx", "H"), "foa": ("Xs", "Zs", "Sx", "adj", "adjS", "ubarS")}


def table_1(steps: int = 10) -> list[dict[str, float]]:
    """Products per step and numbers stored for n steps, counted from the emitted loops, and the paper's formulas."""
    rows = []
    for nz in range(2, 21):
        problem = dense(nz)
        row: dict[str, float] = {"nz": nz}
        for scheme in SWEEPS:
            routine = curved(problem, ExplicitRungeKutta("Euler", steps, "none"), scheme)  # type: ignore[arg-type]
            assert isinstance(routine, LoopedRoutine)
            row[f"{scheme}_products"] = _products(routine.sweep.body, routine, LEAVES[scheme]) / steps
            sizes = dict(routine.sweep.locals)
            sweeps = sum(isinstance(node, For) and node.index == "step" for node in routine.sweep.body)
            kept = ("Z",) if scheme == "tsp" and sweeps == 2 else ()  # the third sweep joined the second
            row[f"{scheme}_memory"] = sum(sizes.get(b, 0) for b in (*BUFFERS[scheme], *kept))
        n = steps
        row["tsp_formula"], row["foa_formula"] = nz**3 + nz**2 * (nz + 1) / 2, 2 * nz**3
        row["tsp_memory_formula"] = n * (nz + nz) + nz**2 + nz * (nz + 1) / 2
        row["foa_memory_formula"] = n * (nz + nz**2) + nz + nz**2
        rows.append(row)
    return rows


def _products(nodes: tuple[Node, ...], routine: LoopedRoutine, leaves: tuple[str, ...], indices: Any = None) -> int:
    """Multiplications in the given leaves, loops multiplied out."""
    total = 0
    for node in nodes:
        if isinstance(node, For):
            for value in node.values(indices or {}):
                total += _products(node.body, routine, leaves, {**(indices or {}), node.index: value})
        elif node.leaf.name().startswith(leaves):
            total += routine.leaves[node.leaf.name()].count.mul
    return total


def draw_table_1(rows: list[dict[str, float]], picture: Path) -> None:
    """Both schemes, counted and by formula."""
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
