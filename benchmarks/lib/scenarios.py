"""Scenarios of the tracking benchmark: six examples, variants of each for accuracy, and their closed loops for timing.

Variants wrap build_ocp() of the example and add a nonlinear row that is active at the solution, a nonuniform grid or an
online parameter in the dynamics; or they keep its package and change references per node and weights at run time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.lib.closed_loop import Scenario
from examples import cart_pole, chain, cstr, quadrotor
from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, GaussNewton, Options, build
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.oracle.trajectory import CLASSICAL, Tableau

Make = Callable[[], OCP]


@dataclass(frozen=True, eq=False)
class Example:
    """An example and its variants.

    ``row`` adds general rows, ``grid`` holds the non-uniform intervals (s), ``parametrised`` has an online parameter in
    its dynamics, and ``p`` (N+1, size) holds its values. ``move`` (ny,) and ``move_N`` (ny_N,) are the changes of
    the references over the horizon, ``heavier`` and ``heavier_N`` multiply the weights. ``tableau`` is the scheme of
    ``options``; ``curved_rows``: the rows need their curvature in the Hessian, and are only watched without it.
    """

    name: str
    make: Make
    options: Options
    x0: Callable[[], Array]
    row: Callable[[OCP], None]
    grid: Array
    parametrised: Make
    p: Array
    move: Array
    move_N: Array
    heavier: Array
    heavier_N: Array
    scenario: Callable[[], Scenario]
    steps: int = 1000
    others: Mapping[str, Make] = field(default_factory=dict)
    tableau: Tableau = CLASSICAL
    curved_rows: bool = False
    coarse_grid: Array | None = None  # the scheme may be unstable on it: watched only


@dataclass(frozen=True, eq=False)
class Case:
    """One problem with its data: arguments of node_data().

    ``rows``: general rows must be active. ``watched``: there are no limits, and its keys have this suffix.
    """

    example: str
    variant: str
    make: Make
    options: Options
    x0: Array
    data: Mapping[str, Any] = field(default_factory=dict)
    rows: bool = False
    watched: str = ""
    tableau: Tableau = CLASSICAL


def wrapped(make: Make, change: Callable[[OCP], None]) -> Make:
    """make(), then change() of its result."""

    def changed() -> OCP:
        ocp = make()
        change(ocp)
        return ocp

    return changed


def cases(example: Example) -> list[Case]:
    """The variants of an example, one by one."""

    def regridded(grid: Array) -> Make:
        def regrid(ocp: OCP) -> None:
            vars(ocp)["dt"] = tuple(float(v) for v in grid)

        return wrapped(example.make, regrid)

    def case(variant: str, make: Make = example.make, options: Options = example.options, **more: Any) -> Case:
        return Case(example.name, variant, make, options, example.x0(), tableau=example.tableau, **more)

    with_rows = wrapped(example.make, example.row)
    row_cases = [case("general rows active", with_rows, rows=True)]
    if example.curved_rows:
        curvature = replace(example.options, hessian=GaussNewton(convex_rows=True))
        row_cases = [
            case("general rows active, convex_rows", with_rows, curvature, rows=True),
            case("general rows active, no curvature", with_rows, rows=True, watched="without_curvature"),
        ]

    coarse = []
    if example.coarse_grid is not None:
        coarse = [case("coarse grid", regridded(example.coarse_grid), watched="coarse_grid")]
    return [
        case("plain"),
        *(case(variant, make) for variant, make in example.others.items()),
        *row_cases,
        case("non-uniform grid", regridded(example.grid)),
        *coarse,
        case("references, weights at run time", data=_run_time_data(example)),
        case("parameter per node", example.parametrised, data={"p": example.p}),
    ]


def _run_time_data(example: Example) -> dict[str, Any]:
    """References that move linearly along the horizon, and other weights."""
    problem = classify(example.make())
    path, end = problem.path, problem.terminal
    along = np.linspace(0.0, 1.0, problem.N)[:, None]
    return {
        "yref": path.reference + along * example.move,
        "yref_N": end.reference + example.move_N,
        "W": np.diag(path.weight) * example.heavier,
        "W_N": np.diag(end.weight) * example.heavier_N,
    }


def _add(ocp: OCP, index: int, rate: Any) -> None:
    """Add a term to the derivative of one element of x."""
    ocp.derivatives[index] = ocp.derivatives[index] + rate


#: The crane's closed loop: a disturbance every 50 samples.
CRANE_LOOP = Scenario((0.1, 0.0, 0.1, 0.0), 0.3, 50, amplitude=0.05)


# Continuous stirred tank reactor --------------------------------------------------------------------------------------


def _cstr_row(ocp: OCP) -> None:
    """Net feed of the educt, u1 (cA0 - cA) <= 41 mol/(l h); 77 without the row, 42 at the set point."""
    ocp.subject_to(-np.inf, ocp.u[0] * (cstr.CA0 - ocp.x[0]), 41.0, name="feed")


def _cstr_disturbance(ocp: OCP) -> None:
    """Temperature of the feed, degC above TH0."""
    d = ocp.parameter("d", unit="degC")
    _add(ocp, 2, ocp.u[0] * d / 3600)


def _set_point(index: int) -> tuple[Array, Array]:
    return cstr.SET_POINTS[index], cstr.SET_POINTS[index][:4]


CSTR = Example(
    name="cstr",
    make=cstr.build_ocp,
    options=Options(),
    x0=lambda: cstr.START,
    row=_cstr_row,
    grid=np.linspace(60.0, 150.0, 10),
    parametrised=wrapped(cstr.build_ocp, _cstr_disturbance),
    p=np.linspace(-10.0, 10.0, 11)[:, None],
    move=cstr.SET_POINTS[2] - cstr.SET_POINTS[0],
    move_N=(cstr.SET_POINTS[2] - cstr.SET_POINTS[0])[:4],
    heavier=np.array([2.0, 0.5, 1.5, 3.0, 0.4, 2.0]),
    heavier_N=np.array([0.5, 2.0, 1.0, 1.5]),
    scenario=lambda: Scenario(cstr.START, cstr.SAMPLING, 200, set_points=(_set_point(0), _set_point(2))),
    others={"state bounds active": lambda: cstr.build_ocp(1)},
)

#: The scenario of figure 6: three set points over 3000 s each.
FIGURE_6 = Scenario(cstr.START, cstr.SAMPLING, 600, set_points=tuple(_set_point(i) for i in range(3)))
FIGURE_6_STEPS = 1800


# Cart-pole ------------------------------------------------------------------------------------------------------------


def _cart_pole_row(ocp: OCP) -> None:
    """Power of the drive, |F v| <= 300 W; 666 without the row."""
    ocp.subject_to(-300.0, ocp.u[0] * ocp.x[2], 300.0, name="power")


CART_POLE = Example(
    name="cart_pole",
    make=cart_pole.build_ocp,
    options=Options(),
    x0=lambda: np.array([0.0, np.pi, 0.0, 0.0]),
    row=_cart_pole_row,
    grid=np.linspace(0.03, 0.07, 20),
    parametrised=lambda: cart_pole.build_ocp(any_length=True),
    p=np.linspace(0.7, 0.9, 21)[:, None],
    move=np.array([0.2, 0.0, 0.1, 0.0, 1.0]),
    move_N=np.array([0.2, 0.0, 0.1, 0.0]),
    heavier=np.array([0.5, 1.2, 2.0, 3.0, 1.5]),
    heavier_N=np.array([2.0, 1.0, 0.5, 4.0]),
    scenario=lambda: Scenario((0.1, 0.05, 0.0, 0.0), 0.05, 50, amplitude=0.05),
)


# Quadrotor ------------------------------------------------------------------------------------------------------------


def _quadrotor() -> OCP:
    return quadrotor.build_ocp((0.5, 0.5, 0.5))


def _quadrotor_row(ocp: OCP) -> None:
    """Tilt cos(phi) cos(theta) >= 0.95 (0.907 without the row) and |vel|^2 <= 0.8 m^2/s^2 (1.68)."""
    phi, theta, vel = ocp.x[6], ocp.x[7], ocp.x[3:6]
    ocp.subject_to(0.95, ca.cos(phi) * ca.cos(theta), np.inf, name="tilt")
    ocp.subject_to(-np.inf, ca.dot(vel, vel), 0.8, name="speed")


def _quadrotor_disturbance(ocp: OCP) -> None:
    """Wind, an acceleration (m/s^2)."""
    d = ocp.parameter("d", size=3, unit="m/s^2")
    for i in range(3):
        _add(ocp, 3 + i, d[i])


def _quadrotor_scenario() -> Scenario:
    hover, there = np.concatenate([np.zeros(12), np.full(4, quadrotor.HOVER)]), np.zeros(16)
    there[:3] = 1.0
    points = tuple((y, y[:12]) for y in (hover, hover + there))
    return Scenario((1.0, 1.0, 1.0, *np.zeros(9)), 0.05, 40, set_points=points)


QUADROTOR = Example(
    name="quadrotor",
    make=_quadrotor,
    options=Options(integrator=ExplicitRungeKutta(RK4, steps=1)),
    x0=lambda: np.array([0.5, 0.5, 0.5, *np.zeros(9)]),
    row=_quadrotor_row,
    grid=np.linspace(0.03, 0.07, 20),
    parametrised=wrapped(_quadrotor, _quadrotor_disturbance),
    p=np.linspace([0.5, 0.0, 0.0], [-0.5, 1.0, 0.3], 21),
    move=np.array([0.1, -0.1, 0.2, *np.zeros(9), 0.1, 0.1, 0.1, 0.1]),
    move_N=np.array([0.1, -0.1, 0.2, *np.zeros(9)]),
    heavier=np.array([1.5, 0.7, 1.0, *np.full(3, 1.3), *np.full(6, 0.8), *np.full(4, 2.0)]),
    heavier_N=np.array([*np.full(6, 0.9), *np.full(6, 1.1)]),
    scenario=_quadrotor_scenario,
    tableau=Tableau(CLASSICAL.A, CLASSICAL.b, steps=1),
)


# Chains ---------------------------------------------------------------------------------------------------------------

PUSH = (-1.0, 1.0, 1.0)


def _chain_row(ocp: OCP) -> None:
    """The norm of the velocity of the tip is bounded, |u|^2 <= 1 m^2/s^2; up to 3 without the row."""
    ocp.subject_to(-np.inf, ca.dot(ocp.u, ocp.u), 1.0, name="tip_speed")


def _chain_disturbance(ocp: OCP) -> None:
    """Wind along y, an acceleration of the first free ball (m/s^2)."""
    d = ocp.parameter("d", unit="m/s^2")
    free = (ocp.x.numel() - 3) // 2
    _add(ocp, free + 3 + 1, d)


@cache
def _at_rest(n: int) -> tuple[float, ...]:
    return tuple(classify(chain.build_ocp(n)).x_initial.tolist())


@cache
def _pushed(n: int) -> Array:
    """State after five pushes."""
    controller = build(chain.build_ocp(n), profile="fast")
    x = np.array(_at_rest(n))
    for _ in range(5):
        x = np.asarray(controller.integrate(x, np.array(PUSH), 0.2))
    return x


def _chain(n: int) -> Example:
    M = n - 2
    nx = 6 * M + 3
    return Example(
        name=f"chain{n}",
        make=lambda: chain.build_ocp(n),
        options=Options(),
        x0=lambda: _pushed(n),
        row=_chain_row,
        grid=np.linspace(0.1, 0.2, 40),  # two RK4 steps are unstable from 0.22 s on for n = 7
        parametrised=wrapped(lambda: chain.build_ocp(n), _chain_disturbance),
        p=np.linspace(0.0, 3.0, 41)[:, None],
        move=np.concatenate([np.zeros(3 * M), [0.0, 0.2, 0.1], np.zeros(3 * M), [0.1, 0.0, -0.1]]),
        move_N=np.concatenate([np.zeros(3 * M), [0.0, 0.2, 0.1], np.zeros(3 * M)]),
        heavier=np.concatenate([np.full(nx, 0.6), np.full(3, 5.0)]),
        heavier_N=np.full(nx, 1.5),
        scenario=lambda: Scenario(_at_rest(n), 0.2, 100, push=PUSH, pushes=5),
        steps=400,
        curved_rows=True,
        coarse_grid=np.linspace(0.1, 0.3, 40),
    )


EXAMPLES = (CSTR, CART_POLE, QUADROTOR, *(_chain(n) for n in (3, 5, 7)))
