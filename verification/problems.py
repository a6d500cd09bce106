"""There is a small optimal control problem for each structure that the generated code must support, with its data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from examples import crane
from nmpc_codegen import (
    OCP,
    Controller,
    ExplicitRungeKutta,
    Online,
    Options,
    RealTimeIteration,
    RiccatiActiveSet,
    build,
    generate,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import Reference, ReferenceSolution
from nmpc_codegen.oracle.trajectory import (
    CLASSICAL,
    Data,
    Point,
    Tableau,
    node_data,
)
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.package.struct_layout import Precision
from verification.routes import PURE


@dataclass(frozen=True, eq=False)
class Case:
    """A case is a problem with options, the measured state, and run-time data that differ from the declared ones.

    ``data``: arguments of node_data(); yref (N, ny), yref_N, W, W_N, p (N+1, np), bounds {row: (lower, upper)}.
    """

    make: Callable[[], OCP]
    x0: tuple[float, ...]
    options: Options = field(default_factory=Options)
    data: Mapping[str, Any] = field(default_factory=dict)
    tableau: Tableau = CLASSICAL


def pendulum(name: str, **grid: Any) -> tuple[OCP, Any, Any, Any]:
    """Create a damped pendulum with a torque; return (ocp, angle, rate, torque)."""
    ocp = OCP(name, **(grid or {"T": 2.0, "N": 8}))
    q, w, u = ocp.state("q", initial=1.0), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) - 0.1 * w + u})
    return ocp, q, w, u


def state_bounds() -> OCP:
    ocp, q, w, u = pendulum("state_bounds")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[2.0, 0.1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[10.0, 1.0])
    ocp.subject_to(-2, u, 2)
    ocp.subject_to(-0.6, w, 0.6)
    return ocp


def one_sided() -> OCP:
    ocp, q, w, u = pendulum("one_sided")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[2.0, 0.1, 0.1])
    ocp.subject_to(-0.5, w, np.inf)
    ocp.subject_to(-np.inf, u, 0.7)
    return ocp


def path_rows() -> OCP:
    """Return an OCP with general rows with a control (nodes 0..N-1) and without (1..N)."""
    ocp, q, w, u = pendulum("path_rows")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[2.0, 0.1, 0.05])
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[10.0, 1.0])
    ocp.subject_to(-0.8, u + 0.5 * w * w, 0.9, name="effort")
    ocp.subject_to(-0.3, w + 0.2 * q * q, np.inf, name="slow")
    return ocp


def terminal_rows() -> OCP:
    ocp, q, w, u = pendulum("terminal_rows")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[1.0, 0.1, 1.0])
    ocp.subject_to(-3, u, 3)
    ocp.subject_to(-0.1, ca.vertcat(q + 0.2 * q * w, ca.sin(w) + q), [0.1, 0.5], at="end", name="gate")
    return ocp


def disc() -> OCP:
    """Return an OCP with a terminal disc of small weight: full Gauss-Newton steps ignore its curvature and cycle."""
    ocp, q, w, u = pendulum("disc")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[1.0, 0.1, 1.0])
    ocp.subject_to(-np.inf, q * q + w * w, 0.04, at="end", name="disc")
    return ocp


def single_nodes() -> OCP:
    """Return an OCP with bounds and general rows at some nodes only; node 0 with a control."""
    ocp, q, w, u = pendulum("single_nodes")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[2.0, 0.1, 0.1])
    ocp.subject_to(-0.2, w, 0.2, at=(3,), name="slow")
    ocp.subject_to(-0.3, u, 0.3, at=(0, 5), name="gentle")
    ocp.subject_to(-np.inf, q + 0.2 * q * q, 0.3, at=(4, 8), name="gate")
    return ocp


def parameters() -> OCP:
    ocp = OCP("parameters", T=2.0, N=8)
    r, v = ocp.state("r", size=2, initial=[1.0, -0.5]), ocp.state("v", size=2)
    a = ocp.control("a", size=2)
    k, g = ocp.parameter("k", value=1.0), ocp.parameter("g", size=2, value=[0.0, -0.3])
    ocp.dynamics({"r": v, "v": a + g - k * v * ca.sqrt(1 + ca.dot(v, v))})
    ocp.least_squares(ca.vertcat(r, v, a), weight=[5, 5, 0.5, 0.5, 0.1, 0.1])
    ocp.terminal_least_squares(r, weight=[20.0, 20.0])
    ocp.subject_to(-1.2, a, 1.2)
    ocp.subject_to(-np.inf, v[0] + k * v[1], 0.25, name="mix")
    return ocp


def dense_weight() -> OCP:
    ocp, q, w, u = pendulum("dense_weight")
    W = np.array([[2.0, 0.3, 0.1], [0.3, 0.5, -0.05], [0.1, -0.05, 0.2]])
    ocp.least_squares(ca.vertcat(ca.sin(q), w, u), weight=W)
    ocp.terminal_least_squares(ca.vertcat(q + q**3 / 5, w), weight=[[8.0, 1.0], [1.0, 2.0]])
    ocp.subject_to(-0.8, u, 0.8)
    return ocp


def scaled() -> OCP:
    """Return an OCP with weights scaled by dt on a nonuniform grid, one of the two dense."""
    ocp, q, w, u = pendulum("scaled", intervals=[0.1, 0.1, 0.2, 0.2, 0.4, 0.4])
    ocp.least_squares(ca.vertcat(q, w), weight=[[4.0, 1.0], [1.0, 2.0]], scale_with_dt=True)
    ocp.least_squares(u, weight=[0.3])
    ocp.subject_to(-0.7, u, 0.7)
    return ocp


def nonuniform() -> OCP:
    ocp, q, w, u = pendulum("nonuniform", intervals=[0.05, 0.1, 0.15, 0.3, 0.5])
    ocp.least_squares(ca.vertcat(q, w, u), weight=[3.0, 0.2, 0.1], scale_with_dt=True)
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[2.0, 1.0])
    ocp.subject_to(-1, u, 1)
    return ocp


def discrete() -> OCP:
    """Return the OCP of the map of [T09 6.6] at k = 1, in two controls."""
    ocp = OCP("discrete", N=6)
    x, u = ocp.state("x", size=2, initial=[0.6, 0.5]), ocp.control("u", size=2)
    nxt = ca.vertcat(x[0] + 0.5 * x[1] ** 2 + u[0], 0.84 * x[1] - x[0] + u[1])
    ocp.dynamics(nxt, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(4))
    ocp.terminal_least_squares(x, weight=np.ones(2))
    ocp.subject_to(-0.2, u, 0.2)
    return ocp


def tiny() -> OCP:
    """Return an OCP with nx = nu = N = 1 and no constraints."""
    ocp = OCP("tiny", T=0.5, N=1)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -(x**3) + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x, ca.sin(x)), weight=[1.0, 0.5])
    return ocp


def references() -> OCP:
    ocp, q, w, u = pendulum("references")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[3.0, 0.1, 0.1], reference=[0.2, 0.0, 0.1])
    ocp.terminal_least_squares(q, weight=[1.0])
    ocp.subject_to(-0.9, u, 0.9)
    return ocp


def _looped_crane() -> OCP:
    return crane.build_ocp(False)


CASES: dict[str, Case] = {
    "crane": Case(crane.build_ocp, (2.0, 0, 0, 0)),
    "crane_weight": Case(lambda: crane.build_ocp(False), (2.0, 0, 0, 0)),
    "crane_looped": Case(
        _looped_crane,
        (2.0, 0, 0, 0),
        Options(integrator=ExplicitRungeKutta(unroll="none")),
    ),
    "state_bounds": Case(state_bounds, (1.0, 0.0)),
    "one_sided": Case(one_sided, (1.0, 0.0)),
    "path_rows": Case(path_rows, (1.0, 0.0)),
    "terminal_rows": Case(terminal_rows, (1.0, 0.0)),
    "single_nodes": Case(single_nodes, (1.0, 0.0)),
    "parameters": Case(
        parameters,
        (1.0, -0.5, 0.0, 0.0),
        data={"p": np.column_stack([np.linspace(0.5, 1.5, 9), np.linspace(0, 0.4, 9), np.linspace(-0.3, 0.1, 9)])},
    ),
    "dense_weight": Case(dense_weight, (1.0, 0.0)),
    "dense_changed": Case(
        dense_weight,
        (1.0, 0.0),
        data={
            "W": np.array([[3.0, 0.1, 0.2], [0.1, 0.2, 0.05], [0.2, 0.05, 0.4]]),
            "W_N": np.array([[2.0, 0.5], [0.5, 1.0]]),
            "yref": np.linspace([0.3, 0.1, 0.0], [0.1, 0.0, 0.2], 8),
        },
    ),
    "scaled": Case(scaled, (1.0, 0.5)),
    "nonuniform": Case(nonuniform, (1.0, 0.0)),
    "discrete": Case(discrete, (0.6, 0.5)),
    "tiny": Case(tiny, (1.0,)),
    "references": Case(
        references,
        (1.0, 0.0),
        data={
            "yref": np.column_stack([np.linspace(0.8, -0.3, 8), np.zeros(8), np.linspace(0.1, -0.1, 8)]),
            "yref_N": np.array([-0.4]),
            "bounds": {"u": (-0.4, 0.6)},
            "W": np.array([2.0, 0.2, 0.15]),
        },
    ),
}


@cache
def problem(name: str) -> Problem:
    return classify(CASES[name].make())


@cache
def sources(name: str, precision: Precision = "double", prefix: str | None = None) -> Sources:
    """Return the package of a case; its prefix is the name of the OCP unless given."""
    case = CASES[name]
    return generate(case.make(), options_of(case, precision), prefix)


def options_of(case: Case, precision: Precision = "double") -> Options:
    """Return the options of the case with plain real-time iteration, unless it has another algorithm."""
    o = case.options
    algorithm = PURE if o.algorithm == RealTimeIteration() else o.algorithm
    return Options(o.integrator, o.hessian, o.condensing, o.qp, algorithm, o.online, precision)


@cache
def _built(name: str, profile: str, precision: Precision) -> Controller:
    case = CASES[name]
    return build(case.make(), options_of(case, precision), profile)


def controller(name: str, profile: str = "test", precision: Precision = "double") -> Controller:
    """Return a fresh controller with the data of the case."""
    fresh = _built(name, profile, precision).copy()
    apply(fresh, CASES[name].data)
    fresh.reset()
    return fresh


def apply(c: Controller, data: Mapping[str, Any]) -> None:
    """Set the data in a controller that node_data() passes to the reference."""
    if "yref" in data:
        c.set_reference(data["yref"])
    if "yref_N" in data:
        c.set_terminal_reference(data["yref_N"])
    if "W" in data:
        c.set_weight(data["W"])
    if "W_N" in data:
        c.set_terminal_weight(data["W_N"])
    if "p" in data:
        for s in c.description.parameters:
            c.set_parameter(s.name, data["p"][:, s.offset : s.offset + s.size])
    for row, (lower, upper) in data.get("bounds", {}).items():
        c.set_bounds(row, lower, upper)


def case_data(name: str) -> Data:
    return node_data(problem(name), x0=np.array(CASES[name].x0, dtype=float), **CASES[name].data)


@cache
def reference(name: str) -> ReferenceSolution:
    """Return IPOPT's solution from the initial iterate."""
    return Reference(problem(name), CASES[name].tableau).solve(case_data(name))


def point(solution: Any) -> Point:
    """Return the primal and dual variables of a Solution."""
    return Point(**{name: np.array(getattr(solution, name), dtype=float) for name in Point.__dataclass_fields__})


def toy(T: float = 0.4) -> OCP:
    """Return the OCP of a cart with mass m, disturbance d, and bounds: x+ = A x + B a / m + d for 0.1 s."""
    ocp = OCP("toy", T=T, N=4)
    p, v, a = ocp.state("p", unit="m", initial=1.0), ocp.state("v", unit="m/s"), ocp.control("a", unit="m/s^2")
    m, d = ocp.parameter("m", value=1.0), ocp.parameter("d", size=2, value=[0.0, 0.0])
    ocp.dynamics({p: v + 10 * d[0] - d[1] / 2, v: a / m + 10 * d[1]})
    ocp.least_squares(ca.vertcat(p, v, a), weight=[10.0, 1.0, 0.1], names=["p", "v", "a"])
    ocp.terminal_least_squares(ca.vertcat(p, v), weight=[100.0, 10.0], names=["p", "v"])
    ocp.subject_to(-5, a, 5)
    ocp.subject_to(-np.inf, ca.vertcat(p, v), np.inf, name="box")
    return ocp


@cache
def toy_sources(precision: Precision = "double", T: float = 0.4) -> Sources:
    """Return the package of the toy: a Riccati recursion, and all data can be changed at run time."""
    online = Online("node", "shared", "shared", "node")
    return generate(toy(T), Options(qp=RiccatiActiveSet(fallback=None), online=online, precision=precision))


def explosive() -> OCP:
    """Return the OCP x' = x^2 + u, which diverges in finite time from x = 1 with u = 5, but not with u = -2."""
    ocp = OCP("explosive", T=4.0, N=8)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: x**2 + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1], reference=[0.0, -2.0])
    ocp.subject_to(-8, u, 5)
    return ocp


def saddle() -> OCP:
    """Return an OCP with a cost that is concave in x where the plan begins; all first derivatives are small there."""
    ocp = OCP("saddle", T=1.0, N=6)
    x, u = ocp.state("x", initial=0.1), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.stage_cost(x**4 / 4 - 2 * x**2 + 0.05 * u**2)
    ocp.subject_to(-3, u, 3)
    return ocp
