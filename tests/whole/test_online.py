"""Online: data that can be changed at run time, and their storage. Oracle: IPOPT with the data of every node."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    ControllerError,
    ExplicitRungeKutta,
    Online,
    Options,
    RealTimeIteration,
    build,
    export,
    generate,
    open_package,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference, ReferenceSolution, node_data
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.controller import Controller
from verification.routes import PURE

LAYOUTS = ("fixed", "shared", "node")
KINDS = ("reference", "weight", "bounds", "parameter")
N, NY, NY_N, NP, NR = 5, 3, 2, 3, 5
X0 = np.array([1.0, 0.2])

#: Orthogonal array L9: every pair of layouts of every two kinds occurs once.
PAIRS = [(a, b, (a + b) % 3, (a + 2 * b) % 3) for a in range(3) for b in range(3)]


def stated(weight: Any = (2.0, 0.3, 0.2), weight_N: Any = (4.0, 1.0), **grid: Any) -> OCP:
    """A pendulum with a nonlinear residual; parameters in dynamics, residual and rows; every kind of row."""
    ocp = OCP("online", **(grid or {"intervals": [0.15, 0.15, 0.2, 0.25, 0.25]}))
    q, w, u = ocp.state("q", initial=1.0), ocp.state("w"), ocp.control("u")
    k, g = ocp.parameter("k", value=0.1), ocp.parameter("g", size=2, value=[1.0, 0.5])
    ocp.dynamics({q: w, w: -g[0] * ca.sin(q) - k * w + u})
    ocp.least_squares(ca.vertcat(q + g[1] * q**3 / 10, w, u), weight=weight, reference=[0.1, 0.0, 0.0])
    ocp.terminal_least_squares(ca.vertcat(q, w + k * q), weight=weight_N)
    ocp.subject_to(-1.5, u, 1.5)
    ocp.subject_to(-1.2, w, 1.2)
    ocp.subject_to(-2.0, u + g[1] * w, 2.0, name="effort")
    ocp.subject_to(-3.0, q + 0.2 * w * w, 3.0, name="slow")
    ocp.subject_to(-1.0, q - g[1] * w, 1.0, at="end", name="gate")
    return ocp


ROWS = ("u", "w", "effort", "slow", "gate_end")
NODES = {"u": range(N), "w": range(1, N + 1), "effort": range(N), "slow": range(1, N + 1), "gate_end": (N,)}


@cache
def oracle() -> Reference:
    return Reference(classify(stated()))


@cache
def built(online: Online) -> Controller:
    return build(stated(), Options(online=online, algorithm=PURE), "test")


def fresh(online: Online) -> Controller:
    c = built(online).copy()
    c.reset()
    return c


def change_reference(c: Controller, layout: str, data: dict[str, Any]) -> None:
    yref = np.linspace([0.5, 0.1, 0.2], [-0.3, 0.0, -0.4], N)
    if layout == "node":
        for k in range(N):
            c.set_reference(yref[k], node=k)
    else:
        c.set_reference(yref[0])
        yref = np.tile(yref[0], (N, 1))
    c.set_terminal_reference([-0.2, 0.1])
    data |= {"yref": yref, "yref_N": [-0.2, 0.1]}


def change_weight(c: Controller, layout: str, data: dict[str, Any]) -> None:
    W = np.array([np.diag([1.0 + k, 0.2, 0.6 - 0.1 * k]) for k in range(N)])
    if layout == "node":
        c.set_weight(W)
        c.set_weight([1.5, 0.2, 0.3], node=2)
        W[2] = np.diag([1.5, 0.2, 0.3])
    else:
        c.set_weight(np.diag(W[0]))
        W = np.tile(W[0], (N, 1, 1))
    c.set_terminal_weight([2.0, 3.0])
    data |= {"W": W, "W_N": np.array([2.0, 3.0])}


def change_bounds(c: Controller, layout: str, data: dict[str, Any]) -> None:
    """Node 2 of the state bound becomes an equality, some bounds vanish; shared: path and end differ."""
    low = np.tile([-0.8, -0.7, -0.9, -np.inf, -0.6], (N + 1, 1))
    high = np.tile([0.9, 0.7, 1.0, 1.05, 1.0], (N + 1, 1))
    for i, name in enumerate(ROWS):
        c.set_bounds(name, low[0, i], high[0, i])
    if layout == "node":
        high[:N, 0] = np.linspace(0.9, 0.7, N)
        low[2, 1] = high[2, 1] = -0.1
        low[3, 2] = -np.inf
        low[N, 4] = -np.inf
        for i, name in enumerate(ROWS):
            for k in NODES[name]:
                c.set_bounds(name, low[k, i], high[k, i], node=k)
    low[N, 1], high[N, 1] = -0.65, 0.3
    c.set_bounds("w", -0.65, 0.3, node=N)
    data["bounds"] = {name: (low[:, i], high[:, i]) for i, name in enumerate(ROWS)}


def change_parameter(c: Controller, layout: str, data: dict[str, Any]) -> None:
    p = np.linspace([0.05, 0.8, 0.3], [0.3, 1.3, 0.6], N + 1)
    if layout == "node":
        c.set_parameter("g", p[:, 1:])
        for k in range(N + 1):
            c.set_parameter("k", p[k, 0], node=k)
    else:
        c.set_parameter("k", p[0, 0])
        c.set_parameter("g", p[0, 1:])
        c.set_parameter("g", p[N, 1:], node=N)
        p[:N] = p[0]
        p[N, 0] = p[0, 0]
    data["p"] = p


CHANGE = {
    "reference": change_reference,
    "weight": change_weight,
    "bounds": change_bounds,
    "parameter": change_parameter,
}


def change_all(c: Controller, online: Online) -> dict[str, Any]:
    """Change all data that the layout allows to change; returns the data of every node, for node_data()."""
    data: dict[str, Any] = {}
    for kind, layout in online.layouts.items():
        if layout != "fixed" and kind in CHANGE:
            CHANGE[kind](c, layout, data)
    return data


def assert_equal(c: Controller, ipopt: ReferenceSolution) -> None:
    found = c.solve(X0, tol=1e-10, max_iterations=300)
    assert ipopt.success
    assert found.status == Status.OK
    np.testing.assert_allclose(found.u, ipopt.u, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.x, ipopt.x, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.lam, ipopt.lam, rtol=0, atol=1e-6)
    assert found.cost == pytest.approx(ipopt.cost, rel=1e-9)


def solved(**data: Any) -> ReferenceSolution:
    return oracle().solve(node_data(oracle().problem, x0=X0, **data))


# Layouts --------------------------------------------------------------------------------------------------------------


@pytest.mark.few(6)
@pytest.mark.parametrize("pick", PAIRS)
def test_equal_to_ipopt_after_changes(pick: tuple[int, ...]) -> None:
    """As declared, and after changing all data that can be changed; every change has an effect."""
    online = Online(**dict(zip(KINDS, (LAYOUTS[i] for i in pick), strict=True)))
    c = fresh(online)
    declared = solved()
    assert_equal(c, declared)
    data = change_all(c, online)
    changed = solved(**data)
    assert_equal(c, changed)
    if data:
        assert np.abs(changed.u - declared.u).max() > 1e-2


def ram(online: Online) -> int:
    return int(
        json.loads(generate(stated(), Options(online=online, algorithm=PURE))["online.json"])["report"]["ram_bytes"]
    )


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("kind", "shared", "node"),
    [
        ("reference", NY + NY_N, N * NY + NY_N),
        ("weight", NY + NY_N, N * NY + NY_N),
        ("bounds", 2 * 2 * NR, 2 * (N + 1) * NR),
        ("parameter", 2 * NP, (N + 1) * NP),
    ],
)
def test_memory_is_that_of_the_data(kind: str, shared: int, node: int) -> None:
    """Fixed data take no RAM, shared data little. The residual is nonlinear: no Hessian block is saved. References have
    a flag, with its padding."""
    fixed = ram(Online(**{kind: "fixed"})) + (8 if kind == "reference" else 0)
    assert ram(Online(**{kind: "shared"})) == fixed + 8 * shared
    assert ram(Online(**{kind: "node"})) == fixed + 8 * node


def test_dense_weight_takes_the_matrix() -> None:
    assert ram(Online(dense_weight=True)) == ram(Online()) + 8 * (NY**2 - NY + NY_N**2 - NY_N)


# Hessians that the layout keeps constant ------------------------------------------------------------------------------


def linear() -> OCP:
    """Residuals linear in x and u, one of them times a parameter."""
    ocp = OCP("linear", T=1.0, N=4)
    x, u, k = ocp.state("x"), ocp.control("u"), ocp.parameter("k", value=1.0)
    ocp.dynamics({x: u - ca.sin(x)})
    ocp.least_squares(ca.vertcat(k * x, u), weight=[1.0, 0.5])
    ocp.terminal_least_squares(k * x, weight=[2.0])
    return ocp


@pytest.mark.parametrize(
    ("online", "blocks"),
    [
        (Online(parameter="fixed"), 1),
        (Online(parameter="shared"), 1),
        (Online(parameter="node"), 4),
        (Online(parameter="shared", weight="fixed"), 1),
        (Online(parameter="shared", weight="node"), 4),
    ],
)
def test_hessian_is_constant_only_where_its_data_are_shared(online: Online, blocks: int) -> None:
    c = build(linear(), Options(online=online), "test")
    assert c.view("hessian.Q").shape[0] == blocks
    data: dict[str, Any] = {}
    if online.parameter != "fixed":
        c.set_parameter("k", 0.7)
        c.set_parameter("k", 1.4, node=4)
        data["p"] = np.array([[0.7]] * 4 + [[1.4]])
    if online.parameter == "node":
        c.set_parameter("k", 2.0, node=1)
        data["p"][1] = 2.0
    if online.weight == "node":
        c.set_weight([3.0, 0.1], node=2)
        data["W"] = np.array([np.diag([3.0, 0.1] if k == 2 else [1.0, 0.5]) for k in range(4)])
    problem = classify(linear())
    expected = Reference(problem).solve(node_data(problem, x0=[1.0], **data))
    found = c.solve([1.0], tol=1e-11)
    assert found.status == Status.OK
    np.testing.assert_allclose(found.u, expected.u, rtol=0, atol=1e-8)


# Dense weights --------------------------------------------------------------------------------------------------------

DENSE = np.array([[2.0, 0.3, 0.2], [0.3, 0.5, -0.1], [0.2, -0.1, 0.4]])
DENSE_N = np.array([[3.0, 0.5], [0.5, 1.0]])


@pytest.mark.parametrize("layout", ["shared", "node"])
def test_dense_weights_at_run_time(layout: str) -> None:
    c = fresh(Online(weight=layout, dense_weight=True))
    assert_equal(c, solved())
    c.set_weight(DENSE)
    c.set_terminal_weight(DENSE_N)
    W = np.tile(DENSE, (N, 1, 1))
    if layout == "node":
        W = np.array([DENSE * (1 + 0.3 * k) for k in range(N)])
        c.set_weight(W)
    assert_equal(c, solved(W=W, W_N=DENSE_N))
    c.set_weight([2.0, 0.3, 0.2])
    c.set_terminal_weight([4.0, 1.0])
    assert_equal(c, solved())


@pytest.mark.parametrize("call", ["set_weight", "set_terminal_weight"])
def test_dense_weight_without_the_option(call: str) -> None:
    W = DENSE if call == "set_weight" else DENSE_N
    with pytest.raises(ControllerError, match=r"entries off its diagonal.*dense_weight=True"):
        getattr(fresh(Online()), call)(W)


def test_declared_dense_weight_per_node() -> None:
    ocp = stated(DENSE, DENSE_N)
    c = build(ocp, Options(online=Online(weight="node")), "test")
    W = np.array([DENSE + np.diag([0.2 * k, 0, 0]) for k in range(N)])
    c.set_weight(W)
    reference = Reference(classify(ocp))
    assert_equal(c, reference.solve(node_data(reference.problem, x0=X0, W=W)))
    with pytest.raises(ControllerError, match=r"weight of node 3 must be positive semidefinite"):
        c.set_weight(np.array([W[0], W[0], W[0], -W[0], W[0]]))
    assert_equal(c, reference.solve(node_data(reference.problem, x0=X0, W=W)))


# What is refused ------------------------------------------------------------------------------------------------------

ALL_FIXED, ALL_SHARED, ALL_NODE = (Online(**dict.fromkeys(KINDS, layout)) for layout in LAYOUTS)

SETTERS = {
    "reference": ("set_reference", "set_terminal_reference"),
    "weight": ("set_weight", "set_terminal_weight"),
    "bounds": ("set_bounds",),
    "parameter": ("set_parameter",),
}
ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "set_reference": (np.zeros(NY),),
    "set_terminal_reference": (np.zeros(NY_N),),
    "set_weight": (np.ones(NY),),
    "set_terminal_weight": (np.ones(NY_N),),
    "set_bounds": ("w", -1.0, 1.0),
    "set_parameter": ("g", [1.0, 1.0]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_fixed_data_have_no_setter(kind: str) -> None:
    c = fresh(ALL_FIXED)
    others = generate(stated(), Options(online=replace(ALL_NODE, **{kind: "fixed"})))
    for call in ARGUMENTS:
        assert (f"online_{call}(" in others["online.h"] + others["online.c"]) == (call not in SETTERS[kind])
    for call in SETTERS[kind]:
        with pytest.raises(ControllerError, match=rf'cannot be set.*Online\({kind}="fixed"\)'):
            getattr(c, call)(*ARGUMENTS[call])


@pytest.mark.parametrize("call", ["set_reference", "set_weight", "set_bounds", "set_parameter"])
@pytest.mark.parametrize("node", range(N))
def test_a_node_without_data_of_its_own(call: str, node: int) -> None:
    kind = next(k for k, calls in SETTERS.items() if call in calls)
    c = fresh(ALL_SHARED)
    before = c._memory.copy()
    with pytest.raises(ControllerError, match=rf'at node {node}; expected node None.*Online\({kind}="shared"\)'):
        getattr(c, call)(*ARGUMENTS[call], node=node)
    np.testing.assert_array_equal(c._memory, before)


@pytest.mark.parametrize("call", ["set_bounds", "set_parameter", "set_reference"])
def test_the_terminal_node_of_shared_data(call: str) -> None:
    c, declared = fresh(ALL_SHARED), fresh(ALL_SHARED)
    value = ([0.3, 0.4],) if call == "set_reference" else ARGUMENTS[call]
    getattr(c, call)(*value, node=N)
    path, end = {"set_bounds": ("lower", "lower"), "set_parameter": ("p", "p")}.get(call, ("yref", "yref_N"))
    np.testing.assert_array_equal(c.view(path)[0], declared.view(path)[0])
    assert not np.array_equal(c.view(end), declared.view(end))


@pytest.mark.parametrize(
    ("call", "value"),
    [
        ("set_reference", (np.zeros((N, NY)),)),
        ("set_weight", (np.ones((N, NY, NY)),)),
        ("set_parameter", ("g", np.ones((N + 1, 2)))),
    ],
)
def test_data_of_every_node_where_they_are_shared(call: str, value: tuple[Any, ...]) -> None:
    with pytest.raises(ControllerError, match=r"shape"):
        getattr(fresh(ALL_SHARED), call)(*value)


def test_names_of_residuals_where_references_are_shared() -> None:
    c = fresh(ALL_SHARED)
    c.set_reference({c.names.y[1]: 0.3})
    np.testing.assert_array_equal(c.view("yref"), [[0.1, 0.3, 0.0]])


#: layout -> call -> nodes that C accepts, without ALL (-1).
ACCEPTED = {
    ALL_SHARED: {"reference": (), "weight": (), "parameter": (N,), "w": (N,), "u": (), "gate_end": (N,)},
    ALL_NODE: {
        "reference": range(N),
        "weight": range(N),
        "parameter": range(N + 1),
        **{name: NODES[name] for name in ("u", "w", "gate_end")},
    },
}


@pytest.mark.parametrize("online", [ALL_SHARED, ALL_NODE], ids=["shared", "node"])
def test_indices_in_c(online: Online) -> None:
    """ALL and the nodes of the layout are accepted; any other node is BAD_INDEX and writes nothing."""
    c = fresh(online)
    values = c._pointer(np.full(NY, 0.25))

    def set_row(row: int, k: int) -> int:
        return int(c._call("set_bounds", c._s, row, k, -0.25, 0.25))

    calls = {
        "reference": lambda k: c._call("set_reference", c._s, k, values),
        "weight": lambda k: c._call("set_weight", c._s, k, values),
        "parameter": lambda k: c._call("set_parameter", c._s, 1, k, values),
        **{name: partial(set_row, c.names.rows.index(name)) for name in ("u", "w", "gate_end")},
    }
    for name, call in calls.items():
        for k in (-(2**31), -2, *range(-1, N + 3), 2**31 - 1):
            before = c._memory.copy()
            status = call(k)
            if k == -1 or k in ACCEPTED[online][name]:
                assert status == Status.OK, (name, k)
            else:
                assert status == Status.BAD_INDEX, (name, k)
                np.testing.assert_array_equal(c._memory, before)


@pytest.mark.parametrize("online", [ALL_SHARED, ALL_NODE], ids=["shared", "node"])
def test_crossed_bounds_keep_the_old_ones(online: Online) -> None:
    c = fresh(online)
    row = c.names.rows.index("w")
    before = c._memory.copy()
    for lower, upper in ((1.0, -1.0), (np.nan, 1.0), (-1.0, np.nan), (np.inf, np.inf), (-np.inf, -np.inf)):
        for k in (-1, N):
            assert c._call("set_bounds", c._s, row, k, lower, upper) == Status.BAD_BOUNDS
    np.testing.assert_array_equal(c._memory, before)
    with pytest.raises(ControllerError, match=r"bounds of 'w': lower \[1.0\] above upper \[-1.0\]"):
        c.set_bounds("w", 1.0, -1.0, node=N)


# Bounds per node in a running loop ------------------------------------------------------------------------------------


def test_every_control_stays_inside_the_bounds_of_its_node() -> None:
    """Bounds that narrow along the horizon, shifted plans, failures; one node is an equality, one has no bound."""
    options = Options(ExplicitRungeKutta(), online=Online(bounds="node"), algorithm=RealTimeIteration(shift="repeat"))
    c = build(stated(T=1.0, N=N), options, "test")
    low, high = np.array([-0.2, -1.0, -0.4, -np.inf, 0.05]), np.array([0.3, -0.1, 0.4, np.inf, 0.05])
    for k in range(N):
        c.set_bounds("u", low[k], high[k], node=k)
    x = X0
    failures = 0
    for n in range(12):
        u0 = c.step([np.nan, 0.0] if n % 4 == 3 else x)
        failures += c.status != Status.OK
        assert low[0] <= u0[0] <= high[0]
        assert np.all((low <= c.u[:, 0]) & (c.u[:, 0] <= high))
        x = c.integrate(x, u0, 0.2)
    assert failures == 3
    c.u[:] = 9.0
    assert c.feedback(X0)[0] == high[0]
    c.reset()
    np.testing.assert_array_equal(c.u[:, 0], np.clip(0.0, low, high))


@pytest.mark.parametrize(
    "algorithm",
    [
        RealTimeIteration(shift="repeat"),
        RealTimeIteration(shift="periodic"),
        RealTimeIteration(shift="resample", sampling_time=0.11),
    ],
    ids=["repeat", "periodic", "resample"],
)
def test_moved_plans_stay_inside(algorithm: RealTimeIteration) -> None:
    c = build(stated(T=1.0, N=N), Options(online=Online(bounds="node"), algorithm=algorithm), "test")
    c.u[:, 0] = [0.5, -0.5, 0.5, -0.5, 0.5]
    bounds = np.array([(-0.1, 0.1), (0.2, 0.3), (-0.3, -0.2), (0.0, 0.0), (-0.05, 0.4)])
    for k, (low, high) in enumerate(bounds):
        c.set_bounds("u", low, high, node=k)
    c.shift()
    assert np.all((bounds[:, 0] <= c.u[:, 0]) & (c.u[:, 0] <= bounds[:, 1]))


def test_bounds_between_the_phases() -> None:
    late, early = fresh(ALL_NODE), fresh(ALL_NODE)
    late.prepare()
    for c in (late, early):
        c.set_bounds("u", -0.1, 0.2, node=0)
        c.set_bounds("slow", -3.0, 0.97, node=3)
    early.prepare()
    np.testing.assert_allclose(late.feedback(X0, "raise"), early.feedback(X0, "raise"), atol=1e-12)
    np.testing.assert_allclose(late.u, early.u, atol=1e-12)
    assert np.abs(late.u - fresh(ALL_NODE).u).max() > 1e-2


# Copies and packages --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("online", [ALL_FIXED, ALL_SHARED, ALL_NODE], ids=LAYOUTS)
def test_copies_keep_the_data(online: Online, tmp_path: Path) -> None:
    c = fresh(online)
    change_all(c, online)
    u = c.copy().step(X0)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(c)).step(X0), u)
    c.save(tmp_path / "state.npz")
    other = fresh(online)
    other.load(tmp_path / "state.npz")
    np.testing.assert_array_equal(other.step(X0), u)


RUN = """
import sys
sys.modules["casadi"] = sys.modules["jinja2"] = None
import numpy as np
from nmpc_codegen import open_package
from nmpc_codegen.runtime.loops.simulate import simulate
c = open_package(sys.argv[1], profile="test")
if c.description.online["bounds"] == "node":
    c.set_bounds("u", -0.1, 0.1, node=0)
log = simulate(c, [1.0, 0.2], 3)
print(repr(log.u.tolist()), *(float(side[-1]) for side in log.bounds("u")))
"""


@pytest.mark.parametrize("online", [ALL_FIXED, ALL_NODE], ids=["fixed", "node"])
def test_an_exported_package_without_casadi(online: Online, tmp_path: Path) -> None:
    """open_package(), setters, a closed loop and the bounds in its plots, in a process that cannot import CasADi."""
    export(stated(), Options(online=online), tmp_path, name="online")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2] / "src")}
    command = [sys.executable, "-c", RUN, str(tmp_path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    c = open_package(tmp_path, profile="test")
    if online is ALL_NODE:
        c.set_bounds("u", -0.1, 0.1, node=0)
    x, controls = X0, []
    for _ in range(3):
        controls.append(c.step(x).tolist())
        x = c.integrate(x, controls[-1], 0.15)
    printed, lower, upper = done.stdout.rsplit(maxsplit=2)
    np.testing.assert_allclose(json.loads(printed), controls, rtol=0, atol=1e-14)
    assert (float(lower), float(upper)) == ((-0.1, 0.1) if online is ALL_NODE else (-1.5, 1.5))
