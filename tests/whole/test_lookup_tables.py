"""Look-up tables. Oracles: CasADi's B-spline and numpy.interp for values, its derivatives and finite differences for
slopes, IPOPT for controllers."""

from __future__ import annotations

import time
from functools import cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest

import nmpc_codegen.derivatives as derivatives_package
from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    ExactHessian,
    ExplicitRungeKutta,
    ForwardOverAdjoint,
    NoCondensing,
    Options,
    ProblemError,
    ProblemWarning,
    RiccatiInteriorPoint,
    build,
    generate,
    lookup_table,
    simulate,
    worst_case,
)
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference, ReferenceSolution, node_data
from verification.quality import warnings_of

pytestmark = pytest.mark.filterwarnings("ignore:dynamics of .* contain lookup_table")

RANDOM = np.random.default_rng(0)
GRID = np.sort(np.append(RANDOM.uniform(-1, 1, 28), [-1.0, 1.0]))
VALUES = np.sin(3 * GRID) + RANDOM.normal(scale=0.05, size=30)
GRID_Y = np.linspace(0, 3, 17) ** 1.3
TABLE = np.sin(GRID)[:, None] * np.cos(GRID_Y) + RANDOM.normal(scale=0.01, size=(30, 17))
X0 = np.array([0.0, 10.0])


def derivatives(expression: Any, z: Any) -> Any:
    """Value, gradient and Hessian by three routes of CasADi, which must agree."""
    J, H = ca.jacobian(expression, z), ca.hessian(expression, z)[0]
    return ca.Function("F", [z], [ca.densify(v) for v in (expression, J, H, ca.jacobian(J, z))])


def of_casadi(grids: list[Any], values: Any, kind: str) -> Any:
    z = ca.MX.sym("z", len(grids))
    spline = ca.interpolant("s", kind, grids, values.ravel(order="F"))(z)
    return ca.Function("B", [z], [spline, ca.jacobian(spline, z), ca.hessian(spline, z)[0]])


@pytest.mark.parametrize("two", [False, True])
def test_cubic_is_the_spline_of_casadi(two: bool) -> None:
    z = ca.SX.sym("z", 2) if two else ca.SX.sym("z")
    grids = [GRID, GRID_Y] if two else [GRID]
    ours = lookup_table((z[0], z[1]), (GRID, GRID_Y), TABLE, "cubic") if two else lookup_table(z, GRID, VALUES, "cubic")
    found, theirs = derivatives(ours, z), of_casadi(grids, TABLE if two else VALUES, "bspline")
    for _ in range(300):
        point = [RANDOM.uniform(g[0], g[-1]) for g in grids]
        value, J, H, J_of_J = found(point)
        for ours_, theirs_ in zip((value, J, H), theirs(point), strict=True):
            np.testing.assert_allclose(ours_, theirs_, rtol=1e-9, atol=1e-7)
        np.testing.assert_allclose(J_of_J, H, atol=1e-7)


def test_linear_interpolates() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    one = derivatives(lookup_table(x, GRID, VALUES), x)
    for q in RANDOM.uniform(-1, 1, 200):
        np.testing.assert_allclose(one(q)[0], np.interp(q, GRID, VALUES), atol=1e-14)
    z = ca.vertcat(x, y)
    two = ca.Function("F", [z], [lookup_table((x, y), (GRID, GRID_Y), TABLE)])
    theirs = of_casadi([GRID, GRID_Y], TABLE, "linear")
    for _ in range(200):
        q = [RANDOM.uniform(-1, 1), RANDOM.uniform(0, GRID_Y[-1])]
        np.testing.assert_allclose(two(q), theirs(q)[0], atol=1e-13)


@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize("points", [4, 5, 8, 9, 64, 65])
def test_every_point_and_what_is_outside(kind: str, points: int) -> None:
    """At the points the values; outside the tangent, or the value at the end; NaN stays NaN."""
    grid, values = np.linspace(-1, 2, points), RANDOM.normal(size=points)
    x = ca.SX.sym("x")
    along, clamped = (
        derivatives(lookup_table(x, grid, values, kind, outside=how), x) for how in ("extrapolate", "clamp")
    )
    for q, value in zip(grid, values, strict=True):
        np.testing.assert_allclose(along(q)[0], value, atol=1e-12)
        np.testing.assert_allclose(clamped(q)[0], value, atol=1e-12)
    for end, beyond, value in ((-1.0, -4.0, values[0]), (2.0, 7.0, values[-1])):
        inside = end + 1e-9 * np.sign(end - beyond)
        slope = float(along(inside)[1])
        np.testing.assert_allclose(along(beyond)[0], value + slope * (beyond - end), atol=1e-6)
        assert float(along(beyond)[2]) == 0.0
        assert [float(v) for v in clamped(beyond)[:2]] == [pytest.approx(value, abs=1e-12), 0.0]
    assert np.isnan(float(along(np.nan)[0]))
    for a, b in pairwise(grid):  # the slope between points by finite differences
        q, h = 0.5 * (a + b), 1e-6
        slope = (float(along(q + h)[0]) - float(along(q - h)[0])) / (2 * h)
        np.testing.assert_allclose(along(q)[1], slope, rtol=1e-5, atol=1e-6)


def car(kind: str, two: bool, points: int = 600) -> OCP:
    """A car whose resistance is a table of its speed, or of place and speed."""
    speeds = np.linspace(0, 60, points)
    drag = 0.3 * np.tanh(speeds / 10) + 0.002 * speeds**2 * (1 + 0.1 * np.sin(speeds / 4))
    ocp = OCP("car", T=4.0, N=20)
    s, v, f = ocp.state("s"), ocp.state("v", initial=10.0), ocp.control("f")
    if two:
        places, few = np.linspace(0, 200, 50), np.linspace(0, 60, 50)
        slope = 1 + 0.2 * np.sin(places / 30)
        table = slope[:, None] * np.interp(few, speeds, drag)
        resistance = lookup_table((s, v), (places, few), table, kind, name="drag")
    else:
        resistance = lookup_table(v, speeds, drag, kind, name="drag")
    ocp.dynamics({s: v, v: f - resistance})
    ocp.least_squares(ca.vertcat(v, f), weight=[1, 0.1], reference=[30, 0])
    ocp.terminal_least_squares(v, weight=3, reference=30)
    ocp.subject_to(-10, f, 8)
    return ocp


@cache
def best(kind: str, two: bool) -> ReferenceSolution:
    problem = classify(car(kind, two))
    return Reference(problem).solve(node_data(problem, x0=X0))


ROUTES = {
    "dense": Options(),
    "interior": Options(condensing=NoCondensing(), qp=RiccatiInteriorPoint()),
    "exact": Options(hessian=ExactHessian()),
    "directions": Options(hessian=ExactHessian(sweep=ForwardOverAdjoint())),
    "straight": Options(integrator=ExplicitRungeKutta(unroll="all")),
    "lanes": Options(target="native"),
    "own": Options(math="own"),
    "small": Options(goal="size"),
}


@pytest.mark.few(4)
@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("two", [False, True])
@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.parametrize("route", ROUTES)
def test_controllers_with_tables(route: str, kind: str, two: bool) -> None:
    found = build(car(kind, two), ROUTES[route], "test").solve(X0, tol=1e-10)
    assert found.status.name == "OK"
    np.testing.assert_allclose(found.u, best(kind, two).u, atol=1e-8)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("options", [AugmentedLagrangian(), AdjointShooting()])
def test_other_algorithms(options: Any) -> None:
    found = build(car("cubic", False), Options(algorithm=options), "test").solve(X0)
    np.testing.assert_allclose(found.u, best("cubic", False).u, atol=1e-4)


@pytest.mark.usefixtures("compiler")
def test_single_precision_and_a_loop() -> None:
    ctrl = build(car("cubic", True), Options(precision="single"), "test")
    found = ctrl.solve(X0)
    assert found.status.name == "OK"
    np.testing.assert_allclose(found.u, best("cubic", True).u, atol=2e-3)
    log = simulate(ctrl, X0, 40)
    assert set(log.status) == {0}


@pytest.mark.usefixtures("compiler")
def test_tables_in_costs_and_rows_from_mx_and_diagnosis() -> None:
    """A tariff by time of day in the cost, a limit by the speed as a row; MX expressions; rows are evaluated without
    CasADi."""
    ocp = OCP("rows", T=2.0, N=10)
    v, u = ocp.state("v", initial=1.0), ocp.control("u")
    ocp.dynamics({v: u})
    ocp.least_squares(ca.vertcat(v, u), weight=[1, 0.1], reference=[3, 0])
    mx = ca.MX.sym("v")
    ocp.stage_cost(lookup_table(mx, [0, 1, 2, 3, 4], [0, 0.1, 0.5, 1.0, 2.0], "cubic"))
    limit = lookup_table(v, [0, 2, 4], [2.0, 1.0, 0.2], name="limit")
    ocp.subject_to(-np.inf, u - limit, 0, name="torque")
    ctrl = build(ocp, profile="test")
    found, problem = ctrl.solve([1.0], tol=1e-10), classify(ocp)
    expected = Reference(problem).solve(node_data(problem, x0=np.array([1.0])))
    np.testing.assert_allclose(found.u, expected.u, atol=1e-8)
    log = simulate(ctrl, [1.0], 5)
    np.testing.assert_allclose(log.h[:, 0], log.u[:, 0] - np.interp(log.x[:-1, 0], [0, 2, 4], [2.0, 1.0, 0.2]))
    description = ctrl.description
    assert type(description).from_json(description.to_json()) == description


def test_time_and_text_of_an_export_depend_little_on_the_size() -> None:
    texts = []
    for points in (60, 6000):
        start = time.perf_counter()
        sources = generate(car("cubic", False, points))
        assert time.perf_counter() - start < 10
        code = "\n".join(line for line in sources["car.c"].splitlines() if "static const real_t lookup" not in line)
        texts.append(len(code))
        assert warnings_of(sources) == ""
    assert abs(texts[1] - texts[0]) < 200
    few, many = (worst_case(generate(car("linear", False, n)))["sample"] for n in (60, 6000))
    assert few < many < 1.1 * few


@pytest.mark.usefixtures("compiler")
def test_a_package_of_derivatives_with_a_table() -> None:
    """Its adjoint gradient against differences of its own cost."""
    tools, u, h = derivatives_package.build(car("cubic", False)), np.full((20, 1), 2.0), 1e-5
    gradient = tools.gradient(X0, u)
    for k in (0, 7, 19):
        step = np.zeros_like(u)
        step[k] = h
        slope = (tools.simulate(X0, u + step).cost - tools.simulate(X0, u - step).cost) / (2 * h)
        np.testing.assert_allclose(np.ravel(gradient)[k], slope, rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, [0, 1], [0, 1], "quadratic"), "kind is 'quadratic'; allowed: 'linear', 'cubic'"),
        ((1.0, [0, 1, 1], [0, 1, 2]), "grid must be finite and increase"),
        ((1.0, [0, 1, np.inf], [0, 1, 2]), "grid must be finite and increase"),
        ((1.0, [0], [0]), "at least 2 points"),
        ((1.0, [0, 1, 2], [0, 1, 2], "cubic"), "at least 4 points"),
        ((1.0, [0, 1], [0, 1, 2]), r"values has shape \(3,\), expected \(2,\)"),
        ((1.0, [0, 1], [0, np.inf]), "values must be finite"),
        ((ca.SX.sym("x", 2), [0, 1], [0, 1]), "expected a scalar expression"),
        (((1.0, 2.0), np.arange(3.0), [0, 1]), "grid must be a pair"),
        (((1.0, 2.0), ([0, 1], [0, 1, 2]), np.zeros((3, 2))), r"values has shape \(3, 2\), expected \(2, 3\)"),
    ],
)
def test_what_is_no_table(arguments: Any, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        lookup_table(*arguments)
    with pytest.raises(ProblemError, match="mixes SX and MX"):
        lookup_table((ca.SX.sym("x"), ca.MX.sym("y")), ([0, 1], [0, 1]), np.zeros((2, 2)))
    with pytest.raises(ProblemError, match="outside is 'nan'"):
        lookup_table(1.0, [0, 1], [0, 1], outside="nan")
    with pytest.raises(ProblemError, match="name"):
        lookup_table(1.0, [0, 1], [0, 1], name="a b")


def test_a_table_whose_entries_single_precision_cannot_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmpc_codegen.frontend.functions.lookup_table.MOST_ENTRIES", 8)
    with pytest.raises(ProblemError, match="10 entries; expected at most 8"):
        lookup_table(ca.SX.sym("x"), np.arange(6.0), np.zeros(6))


def test_names_and_foreign_calls() -> None:
    ocp = OCP("names", T=1.0, N=2)
    x, u = ocp.state("x"), ocp.control("u")
    a, b = (lookup_table(x, [0, 1], [0, s], name="same") for s in (1, 2))
    with pytest.warns(ProblemWarning, match=r'lookup_table\(kind="linear"\): derivatives jump'):
        ocp.dynamics({x: u + a + b})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    with pytest.raises(ProblemError, match="two look-up tables have the name 'same'"):
        generate(ocp)
    other = OCP("other", T=1.0, N=2)
    x, u = other.state("x"), other.control("u")
    spline = ca.interpolant("s", "linear", [[0, 1]], [0, 1])
    with pytest.raises(ProblemError, match=r"lookup_table\(x, grid, values\)"):
        other.dynamics({x: u + spline(x)})
