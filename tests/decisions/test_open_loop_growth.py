"""The growth of the open loop that condensing eliminates: against products of exact matrices, and in closed loop."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool
from numpy.typing import NDArray
from scipy.linalg import expm

from nmpc_codegen import (
    OCP,
    Controller,
    DenseActiveSet,
    FullCondensing,
    NoCondensing,
    OptionError,
    Options,
    ProblemWarning,
    RiccatiActiveSet,
    Status,
    build,
    generate,
)
from nmpc_codegen.components.integrators import Discrete, ExplicitRungeKutta
from nmpc_codegen.decisions.growth import Growth, growth
from nmpc_codegen.decisions.trials import trials_of
from nmpc_codegen.frontend.classify import classify
from verification.routes import PURE

STEP, LENGTH, GRAVITY = 0.05, 0.8, 9.81
CART, POLE = 1.0, 0.1
DENSE = Options(condensing=FullCondensing(), qp=DenseActiveSet(), precision="single")


def cart_pole(N: int, **grid: object) -> OCP:
    """A pole that is kept upright, declared hanging: only the reference is an unstable point."""
    ocp = OCP("upright", **(grid or {"T": STEP * N, "N": N}))
    p, th, v, w = ocp.state("p"), ocp.state("th", initial=np.pi), ocp.state("v"), ocp.state("w")
    F = ocp.control("F")
    s, c = ca.sin(th), ca.cos(th)
    D = CART + POLE - POLE * c**2
    ocp.dynamics(
        {
            p: v,
            th: w,
            v: (-POLE * LENGTH * s * w**2 + POLE * GRAVITY * c * s + F) / D,
            w: (-POLE * LENGTH * c * s * w**2 + F * c + (CART + POLE) * GRAVITY * s) / (LENGTH * D),
        }
    )
    Q = [1e3, 1e3, 0.01, 0.01]
    ocp.least_squares(ca.vertcat(ocp.x, F), weight=[*Q, 0.01])
    ocp.terminal_least_squares(ocp.x, weight=Q)
    ocp.subject_to(-80, F, 80)
    return ocp


def upright(dt: float) -> NDArray[np.float64]:
    """exp(f_x dt) of the pole that stands."""
    f_x = np.zeros((4, 4))
    f_x[0, 2] = f_x[1, 3] = 1.0
    f_x[2, 1] = POLE * GRAVITY / CART
    f_x[3, 1] = (CART + POLE) * GRAVITY / (LENGTH * CART)
    return np.asarray(expm(f_x * dt))


def radius(largest: NDArray[np.float64]) -> float:
    return max(1.0, float(np.max(np.abs(np.linalg.eigvals(largest)))))


@pytest.mark.parametrize("N", [1, 7, 60])
def test_the_growth_is_that_of_the_products(N: int) -> None:
    """Products of exact matrix exponentials, one chain from every start."""
    found = growth(trials_of(classify(cart_pole(N))), ExplicitRungeKutta(), "single")
    assert len(found.factors) == N
    for length in {1, N // 2, N} - {0}:
        largest = np.max([np.abs(np.linalg.matrix_power(upright(STEP), k)) for k in range(length)], axis=0)
        assert found.factor(length) == pytest.approx(radius(largest), rel=1e-3)


def test_intervals_of_different_lengths() -> None:
    intervals = [0.2, 0.05, 0.1, 0.25, 0.15]
    found = growth(trials_of(classify(cart_pole(5, intervals=intervals))), ExplicitRungeKutta(), "double")
    for length in range(1, 6):
        starts = [(j, n) for n in range(length) for j in range(5 - n + 1)]
        products = [upright(sum(intervals[j : j + n])) for j, n in starts]
        assert found.factor(length) == pytest.approx(radius(np.max(np.abs(products), axis=0)), rel=1e-3)


def test_units_make_no_difference() -> None:
    def of(unit: float) -> Growth:
        ocp = OCP("units", N=30)
        x, y, u = ocp.state("x"), ocp.state("y"), ocp.control("u")
        ocp.dynamics({x: 1.2 * x + 0.1 / unit * y, y: 0.9 * y + 0.2 * unit * x + unit * u}, discrete=True)
        ocp.least_squares(ca.vertcat(x, y, u), weight=[1.0, 1.0, 1.0])
        return growth(trials_of(classify(ocp)), Discrete(), "double")

    assert of(1.0).factors == pytest.approx(of(1e8).factors, rel=1e-9)


def test_what_the_controls_do_not_reach_does_not_count() -> None:
    ocp = OCP("lost", N=40)
    x, y, u = ocp.state("x"), ocp.state("y"), ocp.control("u")
    ocp.dynamics({x: 0.5 * x + y + u, y: 3 * y}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    assert growth(trials_of(classify(ocp)), Discrete(), "single").factor(40) == 1.0


def test_integrators_in_a_row_do_not_grow() -> None:
    ocp = OCP("ramp", T=100.0, N=100)
    x = [ocp.state(f"x{i}") for i in range(4)]
    u = ocp.control("u")
    ocp.dynamics({x[0]: u, **{b: a for a, b in itertools.pairwise(x)}})
    ocp.least_squares(ca.vertcat(ocp.x, u), weight=np.ones(5))
    assert growth(trials_of(classify(ocp)), ExplicitRungeKutta(), "single").factor(100) == pytest.approx(1.0)


def test_points_without_derivatives_do_not_count() -> None:
    """The declared state has no derivative; the reference has one, or there is no other point."""

    def of(residual: bool) -> OCP:
        ocp = OCP("root", N=30, T=3.0)
        x, u = ocp.state("x", initial=0.0), ocp.control("u")
        ocp.dynamics({x: 2 * ca.sqrt(x) + u})
        ocp.least_squares(ca.vertcat(x if residual else x**2, u), weight=[1.0, 1.0], reference=[1.0, 0.0])
        return ocp

    finite = growth(trials_of(classify(of(True))), ExplicitRungeKutta(), "single")
    assert finite.factor(30) > 2.0
    assert growth(trials_of(classify(of(False))), ExplicitRungeKutta(), "single") == Growth((), "single")
    with pytest.warns(ProblemWarning, match="equation of x at nodes 0..29: sqrt"):
        assert generate(of(False), Options(precision="single"))


def test_products_that_overflow() -> None:
    ocp = OCP("blast", N=50)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: 1e60 * x + u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    assert growth(trials_of(classify(ocp)), Discrete(), "double").error(50) == 1.0
    assert "condensing: none" in "".join(choices(ocp, Options()))


def choices(ocp: OCP, options: Options) -> list[str]:
    report = json.loads(generate(ocp, options)[f"{ocp.name}.json"])["report"]
    return [str(choice) for choice in report["choices"]]


def test_condensing_that_cannot_work_is_refused() -> None:
    for options in (DENSE, Options(qp=DenseActiveSet(), precision="single")):
        with pytest.raises(OptionError, match=r"FullCondensing\(\).*grows by.*60 intervals.*0 of 7 digits.*double"):
            generate(cart_pole(60), options)
    with pytest.warns(ProblemWarning, match="condensing full: the open loop grows"):
        assert generate(cart_pole(60), Options(condensing=FullCondensing(), qp=DenseActiveSet()))


def test_rows_of_a_free_start_cannot_be_kept_on_stages() -> None:
    """A shorter horizon or a measured x_0 helps, as the error says."""

    def periodic(N: int, free: bool) -> OCP:
        ocp = cart_pole(N)
        ocp.boundary(0, ocp.at_start(ocp.x[1]) - ocp.at_end(ocp.x[1]), 0)
        if free:
            ocp.free_initial(ocp.x[1])
        return ocp

    options = Options(precision="single")
    with pytest.raises(OptionError, match=r"grows by.*; use a shorter horizon, or a measured x_0.*double"):
        generate(periodic(60, True), options)
    assert generate(periodic(60, False), options)
    with pytest.warns(ProblemWarning, match=r"condensing full: the open loop grows.*try a shorter horizon"):
        assert generate(periodic(20, True), options)


def test_the_compiler_leaves_out_what_loses_digits_and_says_so() -> None:
    found = choices(cart_pole(60), Options(precision="single"))
    table = next(choice for choice in found if "fewest operations" in choice)
    assert "full" not in table
    assert any("condensing: full not considered; the open loop grows" in choice for choice in found)
    assert not any("grows" in choice for choice in choices(cart_pole(30), Options()))
    with pytest.warns(ProblemWarning, match=r"condensing full: .*grows.*; try condensing NoCondensing\(\)"):
        assert not any("grows" in choice for choice in choices(cart_pole(20), DENSE))


@pytest.mark.filterwarnings("ignore:.*the open loop grows")
@pytest.mark.parametrize(
    ("N", "options"),
    [(60, Options(precision="single")), (45, Options(condensing=FullCondensing(), qp=DenseActiveSet()))],
    ids=["chosen", "full"],
)
def test_closed_loop_of_what_keeps_the_digits(N: int, options: Options) -> None:
    """What the compiler chooses in single precision, and full condensing in double, against stages in double."""
    require_tool("cc")
    found = build(cart_pole(N), options, "test")
    exact = build(cart_pole(N), Options(condensing=NoCondensing(), qp=RiccatiActiveSet()), "test")
    assert worst_difference(found, exact) < 80 * 1e-3


@pytest.mark.filterwarnings("ignore:.*the open loop grows")
def test_what_the_estimate_misses_is_not_called_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    """Full condensing in single precision, not refused: what is called OK is right, or a failure is reported."""
    require_tool("cc")
    monkeypatch.setattr("nmpc_codegen.decisions.growth.REFUSED", 1.0)
    exact = build(cart_pole(40), Options(condensing=NoCondensing(), qp=RiccatiActiveSet(), algorithm=PURE), "test")
    found = build(cart_pole(40), replace(DENSE, algorithm=PURE), "test")
    statuses, x = set(), np.array([0.2, 0.3, 0.0, 0.0])
    exact.x[:] = 0.0
    for _ in range(20):
        found.reset()
        found.x[:], found.u[:] = exact.x, exact.u
        u, other = exact.step(x).copy(), found.step(x).copy()
        assert found.status != Status.OK or np.max(np.abs(u - other)) < 80 * 1e-3
        statuses.add(found.status)
        x = np.array(exact.x[1])
    assert Status.NUMERICAL_FAILURE in statuses


@pytest.mark.filterwarnings("ignore:.*the open loop grows")
def test_rows_that_the_eliminated_states_violate(monkeypatch: pytest.MonkeyPatch) -> None:
    """x_N = 0 of an unstable plant, the states recomputed from the controls that are called OK."""
    require_tool("cc")
    monkeypatch.setattr("nmpc_codegen.decisions.growth.REFUSED", 1.0)
    ocp = OCP("landing", N=30)
    x, y, u = ocp.state("x"), ocp.state("y"), ocp.control("u")
    ocp.dynamics({x: 1.3 * x + 0.1 * y, y: 0.9 * y + u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, y, u), weight=[1.0, 1.0, 1.0])
    ocp.subject_to(-2, u, 2)
    ocp.subject_to(0, ocp.x, 0, at="end")
    controller = build(ocp, Options(condensing=FullCondensing(), precision="single"), "test")
    rng = np.random.default_rng(0)
    for _ in range(30):
        controller.reset()
        controller.step(rng.uniform(-1, 1, 2))
        if controller.status == Status.OK:
            assert np.max(np.abs(controller.x[-1])) < 1e-3


def worst_difference(found: Controller, exact: Controller) -> float:
    """Largest difference of the controls (N) while a pole that leans falls into its place; both start at one plan."""
    x, worst = np.array([0.2, 0.3, 0.0, 0.0]), 0.0
    exact.x[:] = 0.0
    for _ in range(60):
        found.x[:], found.u[:] = exact.x, exact.u
        u, other = exact.step(x).copy(), found.step(x).copy()
        assert exact.status == found.status == Status.OK
        worst = max(worst, float(np.max(np.abs(u - other))))
        x = np.array(exact.x[1])
    return worst
