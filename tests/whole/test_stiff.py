"""Stiff models with default options: what is chosen and said, optima against IPOPT, loops, residuals, every route."""

from __future__ import annotations

import re
from functools import cache, partial
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib
import numpy as np
import pytest
import scipy.linalg

from examples import crane, fast_charge
from nmpc_codegen import (
    OCP,
    RK4,
    SDIRK3,
    AdjointShooting,
    AugmentedLagrangian,
    Controller,
    ExplicitRungeKutta,
    ImplicitRungeKutta,
    Options,
    ProblemError,
    ProblemWarning,
    RealTimeIteration,
    build,
    derivatives,
    generate,
    worst_case,
)
from nmpc_codegen.cli import main
from nmpc_codegen.economic import tune, tune_periodic
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Point, Reference, Tableau, interval_map, kkt_residuals, node_data
from nmpc_codegen.package.sources import Sources
from verification import stiff

matplotlib.use("Agg")

NAMES = ("x", "u", "lam", "mu_x", "mu_u", "mu", "mu_N", "eta")
START = np.array([1.02, 0.1, 0.5, 349.0, 340.0])


def numbers(integrator: ImplicitRungeKutta) -> Tableau:
    rows = tuple(tuple(map(float, row)) for row in integrator.tableau.a)
    return Tableau(rows, tuple(map(float, integrator.tableau.b)), integrator.steps)


def decay(rate: float, time_unit: str = "s") -> OCP:
    ocp = OCP("decay", T=1.0, N=2, time_unit=time_unit)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -rate * x + u})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    return ocp


# What is chosen ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "scheme", "steps"),
    [(1.0, "RK4", 2), (5.0, "RK4", 4), (20.0, "RK4", 6), (33.0, "SDIRK3", None), (5e3, "SDIRK3", None)],
)
def test_a_default_is_stable(rate: float, scheme: str, steps: int | None) -> None:
    """Intervals of 0.5: RK4 with the steps that are accurate, up to six; no warning."""
    sources = generate(decay(rate, "h"))
    options, (choice, *_) = sources.description.options, sources.description.report.choices
    assert options["integrator.tableau.name"] == scheme
    assert steps is None or int(options["integrator.steps"]) == steps
    assert sources.description.report.warnings == ()
    if rate > 1e3:
        assert f"eigenvalue {-rate:.3g} 1/h" in choice
    assert "operations" in choice or rate < 30


def test_a_model_that_becomes_stiff_within_an_interval() -> None:
    """A radical starts at 0, where its rate has no derivative, and is at sqrt(i / k) within microseconds."""
    ocp = OCP("radical", T=10.0, N=20, time_unit="h")
    x, r = ocp.state("x", initial=5.0), ocp.state("r", initial=0.0)
    u, i = ocp.control("u"), ocp.control("i")
    ocp.dynamics({x: u * (8 - x) - 0.1 * r * x, r: 6e4 * (i - r**2)})
    ocp.least_squares(ca.vertcat(x, u, i), weight=[1, 1, 1], reference=[5, 0.5, 1])
    ocp.subject_to([0, 0.1], ca.vertcat(u, i), [2, 2])
    ctrl, state = build(ocp, profile="test"), np.array([5.0, 0.0])
    assert "the first plan leads to the eigenvalue -1.2e+05 1/h" in ctrl.description.report.choices[0]
    assert ctrl.integrate(state, [0.5, 1.0], 0.5)[1] == pytest.approx(1.0, abs=1e-4)
    for _ in range(10):
        state = ctrl.integrate(state, ctrl.step(state), 0.5)
        assert ctrl.status.name == "OK"
    with pytest.warns(ProblemWarning, match="unstable an interval behind the initial state"):
        generate(ocp, Options(integrator=ExplicitRungeKutta()))


def test_a_coarse_scheme_is_warned_of() -> None:
    ocp = OCP("swing", T=1.0, N=2)
    x, v, u = ocp.state("x", initial=1.0), ocp.state("v"), ocp.control("u")
    ocp.dynamics({x: v, v: 400 * (u - x) - v})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    with pytest.warns(ProblemWarning, match=r"SDIRK3 with steps=1: more steps end \S+ of the scale of a state"):
        generate(ocp, Options(integrator=ImplicitRungeKutta()))
    fine = generate(ocp, Options(integrator=ImplicitRungeKutta(steps=40)))
    assert fine.description.report.warnings == ()


@pytest.mark.parametrize("first", [True, False])
def test_a_stage_without_a_solution_fails_the_interval(first: bool) -> None:
    """X = x + h (X^2 + 50) has no real root; the map of the other state hides it nowhere."""
    ocp = OCP("escape", T=1.0, N=2)
    states = {name: ocp.state(name) for name in ("mx" if first else "xm")}
    k, u = ocp.parameter("k", value=0.1), ocp.control("u")
    ocp.dynamics({states["x"]: states["x"] ** 2 + k + u}, discrete={states["m"]: 0.5 * states["m"] + u})
    ocp.least_squares(ca.vertcat(*states.values(), u), weight=1.0)
    ctrl = build(ocp, Options(integrator=ImplicitRungeKutta("ImplicitEuler")), "test")
    ctrl.set_parameter("k", 50.0)
    assert np.isnan(ctrl.integrate(np.zeros(2), [0.0], 0.5)[int(first)])
    for _ in range(3):
        ctrl.step(np.zeros(2))
        assert ctrl.status.name in ("NOT_CONVERGED", "NUMERICAL_FAILURE")
    assert ctrl.solve(np.zeros(2)).status.name == "NUMERICAL_FAILURE"


def test_the_cheaper_one_is_chosen() -> None:
    """With many states, few of which are coupled, ten steps of RK4 cost less than linear systems."""
    ocp = OCP("row", T=1.0, N=2)
    x, u = ocp.state("x", size=12, scale=1), ocp.control("u")
    ocp.dynamics(ca.vertcat(u - 44 * x[0], *(x[i] - x[i + 1] for i in range(11))))
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.subject_to(-9, u, 9)
    choices = generate(ocp).description.report.choices
    assert "RK4 with steps=10" in choices[0]
    assert "SDIRK3 with steps=" in choices[0]


def test_a_given_scheme_is_kept_with_a_warning_that_names_one_that_works() -> None:
    given = Options(integrator=ExplicitRungeKutta(RK4, 3))
    with pytest.warns(ProblemWarning, match=r"eigenvalue -1e\+05 1/s; ImplicitRungeKutta\(SDIRK3, steps=\d\) works"):
        sources = generate(decay(1e5), given)
    assert sources.description.options["integrator.steps"] == 3
    assert not generate(decay(1e5), Options(integrator=ImplicitRungeKutta())).description.report.warnings


def test_newton_steps_follow_from_the_first_plan() -> None:
    """Two where the model is linear; more where currents pass a double layer; those that are given."""
    chosen = {
        make().name: int(generate(make()).description.options["integrator.newton"])
        for make in (partial(decay, 5e3), fast_charge.build_ocp)
    }
    assert chosen["decay"] == 2
    assert chosen["fast_charge"] > 4
    given = generate(decay(5e3), Options(integrator=ImplicitRungeKutta(newton=5)))
    assert given.description.options["integrator.newton"] == 5


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = Path(fast_charge.__file__)
    command = [str(problem), "-o", str(tmp_path), "--set", "integrator=implicit_runge_kutta"]
    assert main([*command, "--set", "integrator.tableau=SDIRK2", "--set", "integrator.steps=3", "--check"]) == 0
    assert "check passed" in capsys.readouterr().out
    assert main([*command[:-2], "--check"]) == 0
    assert "check passed" in capsys.readouterr().out
    assert main([*command, "--set", "integrator.tableau=RK4"]) != 0
    assert "expected one of ImplicitEuler" in capsys.readouterr().err


# Optima --------------------------------------------------------------------------------------------------------------


def test_solve_finds_the_optimum_of_ipopt(need: Any) -> None:
    """The stages are rows of the nonlinear program; residuals with CasADi's rootfinder."""
    ocp = stiff.reactor()
    ctrl = build(ocp, profile="test")
    integrator = ImplicitRungeKutta(SDIRK3, int(ctrl.description.options["integrator.steps"]))
    problem = classify(ocp)
    data = node_data(problem, x0=START)
    ours, theirs = ctrl.solve(START, tol=1e-12), Reference(problem, numbers(integrator)).solve(data)
    assert ours.status.name == "OK"
    assert theirs.success
    assert ours.x == pytest.approx(theirs.x, rel=1e-9, abs=1e-9)
    assert ours.u == pytest.approx(theirs.u, rel=1e-8, abs=1e-8)
    point = Point(**{n: getattr(ours, n) for n in NAMES})
    assert kkt_residuals(problem, point, data, numbers(integrator)).worst < 1e-7


def small() -> OCP:
    """Two states, one fast and nonlinear, over few intervals of unequal length, with a parameter."""
    ocp = OCP("small", intervals=[0.2, 0.2, 0.3, 0.5])
    x, r, u = ocp.state("x", initial=1.0), ocp.state("r", initial=0.8), ocp.control("u")
    k = ocp.parameter("k", value=400.0)
    ocp.dynamics({x: -r + u, r: k * (ca.sin(x) - r - 0.2 * r**3)})
    ocp.least_squares(ca.vertcat(x, r, u), weight=[1, 0.5, 0.1])
    ocp.terminal_least_squares(x, weight=2)
    ocp.subject_to(-0.4, u, 0.4)
    return ocp


# Samples -------------------------------------------------------------------------------------------------------------


@cache
def reactor() -> Controller:
    return build(stiff.reactor(), profile="test")


@pytest.mark.filterwarnings("ignore:.* Newton steps leave")
def test_what_newton_leaves_counts_in_the_residual() -> None:
    """At an optimum, which has no gaps with all Newton steps, a sample with one does not solve the stages."""
    start = np.array([*[0.3] * fast_charge.SHELLS, 0.0, 25.0, 25.0])
    residuals = {}
    for newton in (1, 11):
        integrator = ImplicitRungeKutta(SDIRK3, 2, newton)
        options = Options(integrator=integrator, algorithm=RealTimeIteration(shift=None, iterations=1))
        ctrl = build(fast_charge.build_ocp(), options, "test")
        assert ctrl.solve(start, tol=1e-9).status.name == "OK"
        ctrl.step(start)
        left = np.max(np.asarray(ctrl.view("node.left")) / np.asarray(ctrl.description.scales)[:9])
        residuals[newton] = ctrl.stats.residual, left, ctrl.status.name
    assert residuals[11][0] < 1e-3
    assert residuals[11][1] < 1e-3
    assert residuals[11][2] == "OK"
    assert not residuals[1][0] < 0.1
    assert residuals[1][1] > 1
    assert residuals[1][2] != "OK"


def test_a_plan_of_samples_is_the_optimum() -> None:
    ctrl = build(stiff.reactor(), Options(algorithm=RealTimeIteration(shift=None)), profile="test")
    for _ in range(40):
        ctrl.step(START)
    assert ctrl.status.name == "OK"
    assert ctrl.kkt().relative < 1e-3
    assert ctrl.stats.residual < 1e-3


def test_integrate_is_independent_of_the_call() -> None:
    """A step to rounding errors: the same after samples, in parts of an interval, and near the solution of Radau."""
    ctrl, plant = reactor(), stiff.Plant(stiff.reactor())
    u = np.array([0.05, 345.0])
    first = np.asarray(ctrl.integrate(START, u, 2.0))
    ctrl.step(START)
    assert np.array_equal(first, np.asarray(ctrl.integrate(START, u, 2.0)))
    exact = plant.step(START, u, plant.problem.p_value)
    assert first == pytest.approx(exact, rel=1e-3)
    assert np.asarray(ctrl.integrate(START, u, 0.0)) == pytest.approx(START, rel=1e-15)
    middle = np.asarray(ctrl.integrate(START, u, 1.0))
    assert np.asarray(ctrl.integrate(middle, u, 1.0)) == pytest.approx(exact, rel=1e-3)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["kinetics", "converter", "reactor", "battery"])
def test_loops(name: str) -> None:
    ctrl, plant = build(stiff.PROBLEMS[name].make(), profile="test"), stiff.Plant(stiff.PROBLEMS[name].make())
    for seed in (3, 4):
        assert stiff.run(stiff.PROBLEMS[name], ctrl, plant, seed).lost == ""


def test_fast_charge_main(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """An implicit scheme is chosen; the cell is full, the voltage touches its ceiling and stays below it."""
    monkeypatch.setattr(fast_charge, "build", partial(build, profile="test"))
    log = fast_charge.main(str(tmp_path / "charge.png"))
    assert matplotlib.image.imread(tmp_path / "charge.png")[..., :3].std() > 0.01
    assert "implicit_runge_kutta, SDIRK3" in capsys.readouterr().out
    assert log.ok
    assert log.x[-1, : fast_charge.SHELLS] == pytest.approx(fast_charge.TARGET, abs=1e-3)
    found = fast_charge.voltage(log)
    assert fast_charge.CEILING - 1e-3 < found.max() < fast_charge.CEILING + 1e-3


@pytest.mark.parametrize("algorithm", [AugmentedLagrangian(repair=0), AdjointShooting(shift=None, repair=0)])
def test_samples_that_do_not_solve_their_stages_are_not_ok(algorithm: Any) -> None:
    """One Newton step leaves the currents through the double layer unsolved, also where no gap tells."""
    start = np.array([*[0.3] * fast_charge.SHELLS, 0.0, 25.0, 25.0])
    given = ImplicitRungeKutta(SDIRK3, 2, newton=1)
    with pytest.warns(ProblemWarning, match=r"SDIRK3 with steps=2: 1 Newton steps leave .* or more Newton steps"):
        ctrl = build(fast_charge.build_ocp(N=5), Options(integrator=given, algorithm=algorithm), "test")
    statuses = [ctrl.step(start) is not None and ctrl.status.name for _ in range(4)]
    assert "OK" not in statuses


# Off line ------------------------------------------------------------------------------------------------------------


def test_terminal_cost_of_the_regulator() -> None:
    """P of the discrete algebraic Riccati equation with A, B of the implicit scheme, by CasADi's rootfinder."""
    ocp = OCP("regulated", T=6.0, N=6)
    x, r, u = ocp.state("x", initial=1.0), ocp.state("r", initial=0.8), ocp.control("u")
    ocp.dynamics({x: -r + u, r: 400 * (ca.sin(x) - r)})
    ocp.least_squares(ca.vertcat(x, r, u), weight=[1, 0.5, 0.1])
    ocp.lqr_terminal_cost()
    ctrl, problem = build(ocp, profile="test"), classify(ocp)
    options = ctrl.description.options
    scheme = Tableau(tuple(map(tuple, options["integrator.tableau.a"])), tuple(options["integrator.tableau.b"]), 2)
    assert (options["integrator"], options["integrator.steps"]) == ("ImplicitRungeKutta", 2)
    z = ca.MX.sym("z", 3)
    end = interval_map(problem, scheme)(z[:2], z[2], ca.DM(0, 1), 1.0)[0]
    S = np.array(ca.Function("S", [z], [ca.jacobian(end, z)])(np.zeros(3)))
    P = scipy.linalg.solve_discrete_are(S[:, :2], S[:, 2:], np.diag([1, 0.5]), np.diag([0.1]))
    small = 1e-3 * np.array([1.0, 0.5])
    assert ctrl.solve(small, tol=1e-12).cost == pytest.approx(small @ P @ small / 2, rel=1e-4)


def test_a_point_that_newton_does_not_leave_is_no_steady_state() -> None:
    """At x = 0 the Newton steps of an interval return to x, where x' = -2."""
    ocp = OCP("cubic", T=3.0, N=3)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: -(x**3) + 3 * x - 2 + u})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.subject_to(-0.5, u, 0.5)
    given = Options(integrator=ImplicitRungeKutta("ImplicitEuler"))
    with pytest.raises(ProblemError, match="the state 'x' is not at rest at the steady state that was found"):
        tune(ocp, given)
    with pytest.raises(ProblemError, match="tune_periodic: the map of 'cubic' is that of an implicit scheme"):
        tune_periodic(ocp, given, period=3)


@pytest.mark.parametrize("sweep", ["symmetric", "forward_over_adjoint"])
def test_derivatives_without_a_controller(sweep: Any) -> None:
    """States, [A B] and second derivatives of all intervals; the gradients of three methods agree."""
    problem, integrator = classify(stiff.reactor()), ImplicitRungeKutta(SDIRK3, 2)
    found = derivatives.build(stiff.reactor(), options=Options(integrator=integrator), second_order=True)
    u, lam = np.tile([0.05, 345.0], (30, 1)), np.random.default_rng(0).normal(size=(30, 5))
    A, B = found.sensitivities(problem.x_initial, u)
    H, x = found.hessians(problem.x_initial, u, lam, sweep), problem.x_initial
    z, weights = ca.MX.sym("z", 7), ca.MX.sym("lam", 5)
    end = interval_map(problem, numbers(integrator))(z[:5], z[5:], problem.p_value, 2.0)[0]
    outputs = [end, ca.jacobian(end, z), ca.hessian(ca.dot(weights, end), z)[0]]
    exact = ca.Function("exact", [z, weights], outputs)
    for k in range(30):
        end_k, S, second = (np.array(value) for value in exact(np.concatenate([x, u[k]]), lam[k]))
        assert np.hstack([A[k], B[k]]) == pytest.approx(S, rel=1e-9, abs=1e-9)
        assert H[k] == pytest.approx(second, rel=1e-9, abs=1e-9 * float(np.abs(second).max()))
        x = end_k.ravel()
    first = found.gradient(problem.x_initial, u)
    for method in ("adjoint", "forward", "alternative"):
        other = found.gradient(problem.x_initial, u, method=method)  # type: ignore[arg-type]
        assert other == pytest.approx(first, rel=1e-8, abs=1e-8)


# Firmware ------------------------------------------------------------------------------------------------------------


def test_the_worst_case_grows_with_the_newton_steps() -> None:
    def prepare(newton: int) -> int:
        sources: Sources = generate(small(), Options(integrator=ImplicitRungeKutta(newton=newton), solve=False))
        return worst_case(sources)["prepare"]

    assert prepare(2) < prepare(3) < prepare(6)
    assert prepare(3) - prepare(2) == prepare(4) - prepare(3)


def test_an_explicit_package_has_no_trace_of_stages() -> None:
    sources = generate(crane.build_ocp())
    for word in (r"\bnewton\b", r"\bfailed_", r"\bstage_t\b", r"\bleft\["):
        assert not re.search(word, sources["crane.c"] + sources["crane.h"])
