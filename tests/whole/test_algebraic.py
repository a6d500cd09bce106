"""Algebraic equations through the whole pipeline: optima against IPOPT, loops, starts, failures, all routes."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import distillation, rope_crane
from nmpc_codegen import (
    OCP,
    AdjointShooting,
    AugmentedLagrangian,
    ControllerError,
    ExactHessian,
    ExplicitRungeKutta,
    ForwardOverAdjoint,
    ImplicitRungeKutta,
    Log,
    OptionError,
    Options,
    ProblemError,
    ProblemWarning,
    RealTimeIteration,
    Status,
    build,
    export,
    generate,
    open_package,
    simulate,
)
from nmpc_codegen.cli.command import main as command
from nmpc_codegen.derivatives import generate as generate_derivatives
from nmpc_codegen.economic import steady_state
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference, Tableau, node_data
from verification import algebraic, stiff


def cubic(rows: bool = True, name: str = "cubic") -> OCP:
    """Two coupled equations, in dynamics, cost, a row and the end; one contains the control."""
    ocp = OCP(name, T=2.0, N=8)
    x, v, F = ocp.state("x", initial=1.0), ocp.state("v"), ocp.control("F")
    y, q = ocp.algebraic("y", initial=0.5, unit="N"), ocp.algebraic("q", initial=1.0)
    k = ocp.parameter("k", value=2.0)
    ocp.algebraic_equation(y**3 + k * y - x - F, name="spring")
    ocp.algebraic_equation(q * ca.exp(0.2 * q) - 1 - y**2 - 0.1 * v, name="friction")
    ocp.dynamics({x: v, v: -y - 0.3 * v * q})
    ocp.least_squares(ca.vertcat(x, v, F, y), weight=[10, 1, 0.1, 1])
    ocp.terminal_least_squares(ca.vertcat(x, v, y), weight=[10, 1, 5])
    ocp.stage_cost(0.1 * q**2 * (1 + F**2))
    ocp.stage_cost(q**2 * F**2 + y**4, integrate=True)
    ocp.subject_to(-2, F, 2)
    if rows:
        ocp.subject_to(-0.4, y, 0.45)
    return ocp


def scheme(ctrl: Any) -> Tableau:
    chosen = ctrl.description.options
    rows = tuple(map(tuple, chosen["integrator.tableau.a"]))
    return Tableau(rows, tuple(chosen["integrator.tableau.b"]), int(chosen["integrator.steps"]))


# Optima --------------------------------------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("route", algebraic.ROUTES)
@pytest.mark.parametrize("name", algebraic.PROBLEMS)
def test_solve_ends_at_the_optimum(name: str, route: str) -> None:
    error, _ = stiff.distance_from_optimum(algebraic.PROBLEMS[name], algebraic.ROUTES[route], "test")
    assert error < 1e-8


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "options",
    [
        Options(hessian=ExactHessian(sweep=ForwardOverAdjoint())),
        Options(algorithm=AugmentedLagrangian()),
        *(Options(integrator=ImplicitRungeKutta(name, 1)) for name in ("SDIRK2", "RadauIIA2", "RadauIIA3")),
        *(Options(integrator=ImplicitRungeKutta(name, 2)) for name in ("GaussLegendre2", "GaussLegendre3")),
    ],
    ids=str,
)
def test_nodes_and_stages_have_the_same_solution(options: Options) -> None:
    """Everything that contains z: two orders of derivatives, multipliers, the end with the last control."""
    ocp = cubic()
    problem = classify(ocp)
    ctrl = build(ocp, options, "test")
    ours = ctrl.solve([1.0, 0.0], tol=1e-12, max_iterations=300)
    theirs = Reference(problem, scheme(ctrl)).solve(node_data(problem), x=ctrl.whole_x, u=ours.u)
    assert ours.status == Status.OK
    for mine, other in (
        (ours.x, theirs.x[:, :2]),
        (ours.u, theirs.u),
        (ours.mu, theirs.mu),
        (ours.lam, theirs.lam[:, :2]),
    ):
        assert mine == pytest.approx(other, abs=1e-8)
    assert theirs.residuals.worst < 1e-10
    assert algebraic.residual(ocp, ours.x[:-1], ours.z[:-1], ours.u) < 1e-13
    assert algebraic.residual(ocp, ours.x[-1:], ours.z[-1:], ours.u[-1:]) < 1e-13


# Loops ---------------------------------------------------------------------------------------------------------------


@pytest.mark.few(3)
@pytest.mark.parametrize("name", algebraic.PROBLEMS)
def test_loops(name: str) -> None:
    """The plant is the model as it is stated, by IDAS."""
    case = algebraic.PROBLEMS[name]
    ctrl, plant = build(case.make(), profile="test"), algebraic.Plant(case.make())
    for seed in (1, 2):
        assert stiff.run(case, ctrl, plant, seed).lost == ""


def test_a_log_has_algebraic_variables(tmp_path: Path) -> None:
    ocp = algebraic.neutralisation()
    ctrl = build(ocp, profile="test")
    log = simulate(ctrl, [-0.4, 0.5, 13.0], 15)
    assert log.ok
    assert log.z.shape == (15, 1)
    assert log.algebraic[0].name == "pH"
    assert algebraic.residual(ocp, log.x[:-1], log.z, log.u) < 1e-13
    log.save(tmp_path / "log.npz")
    again = Log.load(tmp_path / "log.npz")
    assert np.array_equal(again.z, log.z)
    assert again.to_dataframe()["z", "pH"].iloc[3] == log.z[3, 0]
    log.plot(tmp_path / "log.png")


def test_rows_on_algebraic_variables_are_logged_and_named() -> None:
    ctrl = build(cubic(), profile="test")
    log = simulate(ctrl, [1.0, 0.0], 10)
    assert [row.name for row in log.rows] == ["y"]
    assert log.h[:, 0] == pytest.approx(log.z[:, 0], abs=1e-12)
    ctrl.set_bounds("y", -0.01, 0.01)
    ctrl.step([5.0, 3.0])
    assert "'y'" in ctrl.diagnose()


# Starts and failures -------------------------------------------------------------------------------------------------


def test_variables_are_consistent_after_init_and_after_jumps() -> None:
    ocp = algebraic.neutralisation()
    ctrl = build(ocp, profile="test")
    assert algebraic.residual(ocp, ctrl.x[:-1], ctrl.z[:-1], ctrl.u) < 1e-13
    for x in ([-3.0, 0.5, 14.0], [2.5, 0.5, 14.0], [-0.4, 5.0, 10.0]):  # pH about 11, 3 and 6
        ctrl.step(x)
        assert ctrl.status in (Status.OK, Status.NOT_CONVERGED, Status.RELAXED)
        assert algebraic.residual(ocp, ctrl.x[:-1], ctrl.z[:-1], ctrl.u) < 1e-12
    ctrl.set_parameter("buffer", 5.0)
    ctrl.step([-0.4, 0.5, 14.0])
    assert ctrl.status in (Status.OK, Status.NOT_CONVERGED, Status.RELAXED)
    ctrl.reset()
    assert np.all(np.isfinite(ctrl.z))


def test_integrate_ends_at_a_consistent_point() -> None:
    ocp = algebraic.neutralisation()
    ctrl, plant = build(ocp, Options(integrator=ImplicitRungeKutta("RadauIIA3", 4)), "test"), algebraic.Plant(ocp)
    x, u = np.array([-0.432, 0.528, 14.0]), np.array([18.0])
    end = ctrl.integrate(x, u, 15.0)
    assert end == pytest.approx(plant.step(x, u, np.array([0.55])), rel=1e-6)
    assert algebraic.residual(ocp, end[None], ctrl.algebraic(end, u)[None], u[None]) < 1e-13


def test_equations_without_a_solution_name_node_and_variable() -> None:
    """z^2 = x, measured at -1."""
    ocp = OCP("root", T=1.0, N=5)
    x, u, z = ocp.state("x", initial=1.0), ocp.control("u"), ocp.algebraic("z", initial=1.0)
    ocp.algebraic_equation(z**2 - x)
    ocp.dynamics({x: u - z})
    ocp.least_squares(ca.vertcat(x - 1, z - 1, u - 1), weight=[1, 1, 0.1])
    ocp.subject_to(0.8, u, 1.2)
    ctrl = build(ocp, profile="test")
    statuses = []
    for _ in range(3):
        assert np.all(np.isfinite(ctrl.step([-1.0])))
        statuses.append(ctrl.status)
    assert Status.OK not in statuses
    assert statuses[-1] == Status.NUMERICAL_FAILURE
    assert "algebraic equations are not solved at node 0" in ctrl.diagnose()
    assert ": z; check the model there" in ctrl.diagnose()
    assert np.isnan(ctrl.algebraic([-1.0], [1.0])).all()
    for _ in range(3):
        ctrl.step([1.2])
    assert ctrl.status == Status.OK  # nothing is lost


def drained(initial: float) -> OCP:
    """A tank whose outflow stands in its dynamics alone."""
    ocp = OCP("drained", T=2.0, N=5)
    h, q, out = ocp.state("h", initial=1.0), ocp.control("q"), ocp.algebraic("out", initial=initial)
    ocp.algebraic_equation(out**3 + out - h, name="valve")
    ocp.dynamics({h: q - out})
    ocp.least_squares(ca.vertcat(h - 1, q), weight=[1, 0.1])
    ocp.subject_to(0, q, 2)
    return ocp


def test_variables_in_dynamics_alone_follow_the_plan() -> None:
    """No function of a node reads them."""
    ctrls = [build(drained(start), profile="test") for start in (0.7, 5.0)]
    for ctrl in ctrls:
        for _ in range(3):
            ctrl.step([4.0])
        assert ctrl.status == Status.OK
        assert algebraic.residual(drained(0.7), ctrl.x[:-1], ctrl.z[:-1], ctrl.u) < 1e-13
        ends = [ctrl.integrate(x, u, 0.4) for x, u in zip(ctrl.x, ctrl.u, strict=False)]
        assert ctrl.x[1:] == pytest.approx(np.array(ends), abs=1e-2)
    assert ctrls[0].u == pytest.approx(ctrls[1].u, abs=1e-6)


def folded(terminal: bool = False) -> OCP:
    """z^2 = 1 - x in the cost of the path, or of node N alone."""
    ocp = OCP("folded", T=2.0, N=4)
    x, u, z = ocp.state("x"), ocp.control("u"), ocp.algebraic("z", initial=1.0)
    ocp.algebraic_equation(z**2 - 1 + x, name="fold")
    ocp.dynamics({x: 0.55 + 1e-3 * u if terminal else u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1, 0.1])
    (ocp.terminal_least_squares if terminal else ocp.least_squares)(z, weight=1e-3)
    ocp.subject_to(-1, u, 1)
    return ocp


def test_a_measured_state_without_a_solution_is_not_ok() -> None:
    ctrl = build(folded(), Options(algorithm=RealTimeIteration(iterations=1)), "test")
    statuses = []
    for x in (0.5, 1.2, 1.2, 0.5):
        ctrl.step([x])
        statuses.append(ctrl.status)
        if x > 1:
            assert "not solved at node 0: Newton's method does not converge: z" in ctrl.diagnose()
    assert statuses == [Status.OK, Status.NOT_CONVERGED, Status.NOT_CONVERGED, Status.OK]


def test_a_failure_at_the_end_is_named() -> None:
    """Stages of GaussLegendre2 are inside of the interval."""
    algorithm = RealTimeIteration(iterations=1, shift=None)
    ctrl = build(folded(terminal=True), Options(ImplicitRungeKutta("GaussLegendre2"), algorithm=algorithm), "test")
    ctrl.step([0.0])
    assert ctrl.status == Status.NOT_CONVERGED
    ctrl.step([0.0])
    assert ctrl.status == Status.NUMERICAL_FAILURE
    assert "not solved at node 4" in ctrl.diagnose()


def test_a_question_changes_nothing() -> None:
    ocp = OCP("branches", T=1.0, N=4)
    x, u, y = ocp.state("x", initial=1.0), ocp.control("u"), ocp.algebraic("y", initial=2.0)
    ocp.algebraic_equation(y**3 - 3 * y - x)
    ocp.dynamics({x: -x + u + 0.1 * y})
    ocp.least_squares(ca.vertcat(x, u, y - 1), weight=1.0)
    ocp.subject_to(-3, u, 3)
    ctrl = build(ocp, profile="test")
    ctrl.step([1.0])
    twin = ctrl.copy()
    assert ctrl.algebraic([-50.0], [0.0])[0] < -3  # on another branch
    assert np.array_equal(ctrl.step([1.0]), twin.step([1.0]))
    assert np.array_equal(ctrl.z, twin.z)


def test_a_start_from_which_newton_finds_nothing_is_warned_of() -> None:
    ocp = OCP("far", T=1.0, N=3)
    x, u, z = ocp.state("x", initial=0.5), ocp.control("u"), ocp.algebraic("z", initial=800.0)
    ocp.algebraic_equation(ca.exp(z) - x - 1)
    ocp.dynamics({x: u - z})
    ocp.least_squares(ca.vertcat(x, u, z), weight=1.0)
    with pytest.warns(ProblemWarning, match="not solved at the first plan: Newton's method does not find z from 800"):
        generate(ocp)


def test_numbers_that_are_not_finite() -> None:
    ctrl = build(algebraic.battery(), profile="test")
    for x in ([np.nan, 0.0, 30.0], [np.inf, 0.0, 30.0]):
        assert np.all(np.isfinite(ctrl.step(x)))
        assert ctrl.status == Status.NOT_FINITE
        assert np.isnan(ctrl.algebraic(x, [50.0])).all()
    with pytest.raises(ControllerError, match="node is 21; expected an integer between 0 and 20"):
        ctrl.algebraic([0.8, 0.0, 30.0], [50.0], node=21)


def test_the_root_near_the_last_one_is_kept() -> None:
    """The smaller one of two solutions."""
    ctrl = build(algebraic.battery(), profile="test")
    for power in np.linspace(1, 100, 12):
        current = float(ctrl.algebraic([0.8, 0.0, 30.0], [power])[0])
        U, R = 350 + 48 - 10 * np.exp(-16), 0.12
        assert current == pytest.approx((U - np.sqrt(U**2 - 4e3 * R * power)) / (2 * R), rel=1e-12)


def test_a_plan_follows_the_root_on_which_it_is() -> None:
    """Of z^2 = 1 - x the one that is not declared."""
    ctrl = build(folded(), profile="test")
    for sign in (-1.0, 1.0):
        ctrl.view("z")[...] = sign
        ctrl.step([0.1])
        np.testing.assert_allclose(ctrl.z[0], sign * np.sqrt(0.9), rtol=1e-9)


# What is refused -----------------------------------------------------------------------------------------------------


def test_what_needs_an_implicit_scheme_says_so() -> None:
    with pytest.raises(
        OptionError, match=r"uses nonlinear algebraic equations \(y, q\), which integrator .* choose Impl"
    ):
        generate(cubic(), Options(integrator=ExplicitRungeKutta()))
    with pytest.raises(OptionError, match=r"nonlinear algebraic equations .* algorithm AdjointShooting"):
        generate(cubic(), Options(algorithm=AdjointShooting()))
    with pytest.raises(ProblemError, match="derivatives: 'cubic' has nonlinear algebraic equations"):
        generate_derivatives(cubic())
    with pytest.raises(ProblemError, match=r"steady state: 'cubic' has .*nonlinear algebraic equations"):
        steady_state(cubic())
    discrete = OCP("discrete", N=3)
    x, u, z = discrete.state("x"), discrete.control("u"), discrete.algebraic("z")
    discrete.algebraic_equation(z + z**3 - x)
    discrete.dynamics({x: z + u}, discrete=True)
    discrete.least_squares(ca.vertcat(x, u), weight=1.0)
    with pytest.raises(OptionError, match="nonlinear algebraic equations"):
        generate(discrete)


def test_what_expressions_solve_goes_everywhere() -> None:
    """Linear equations: explicit schemes, discrete maps, steady states, derivatives."""
    ocp = OCP("linear", N=3)
    x, u, z = ocp.state("x", initial=0.5), ocp.control("u"), ocp.algebraic("z")
    ocp.algebraic_equation(z * (1 + x**2) - u)
    ocp.dynamics({x: 0.9 * x + z}, discrete=True)
    ocp.least_squares(ca.vertcat(x, z), weight=1.0)
    ctrl = build(ocp, profile="test")
    ours = ctrl.solve([0.5])
    assert ours.status == Status.OK
    assert ours.z[:-1, 0] == pytest.approx(ours.u[:, 0] / (1 + ours.x[:-1, 0] ** 2), rel=1e-13)
    tank = OCP("tank", T=1.0, N=3)
    h, q, out = tank.state("h", initial=1.0), tank.control("q"), tank.algebraic("out")
    tank.algebraic_equation(2 * out - h)
    tank.dynamics({h: q - out})
    tank.least_squares(ca.vertcat(out, q), weight=1.0, reference=[1.0, 1.0])
    assert steady_state(tank).x == pytest.approx([2.0], rel=1e-6)


# Routes of a user ----------------------------------------------------------------------------------------------------


def test_the_c_interface(tmp_path: Path) -> None:
    folder = tmp_path / "cubic"
    export(cubic(), Options(solve=False), folder)
    header = (folder / "cubic.h").read_text(encoding="utf-8")
    assert "#define CUBIC_Z_Y 0 /* N */" in header
    assert "#define CUBIC_ALGEBRAIC 2 /* algebraic variables */" in header
    assert "cubic_status_t cubic_algebraic(" in header
    page = (folder / "README.md").read_text(encoding="utf-8")
    assert "z[CUBIC_Z_Y]" in page
    ctrl = open_package(folder)
    assert ctrl.names.algebraic == ("y", "q")
    assert ctrl.step([1.0, 0.0]).shape == (1,)


@pytest.mark.few(1)
@pytest.mark.parametrize("example", [distillation, rope_crane], ids=lambda m: m.__name__)
def test_check_compares_with_the_oracle(example: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(Path(example.__file__)), "--out", str(tmp_path / "out"), "--check", "--set", "solve=True"]
    assert command(arguments) == 0
    assert "IPOPT" in capsys.readouterr().out


def test_an_estimator_with_algebraic_outputs() -> None:
    """x_0 of a horizon of measured pH, whose references are the measurements."""
    ocp = OCP("estimator", T=75.0, N=5)
    Wa, Wb = ocp.state("Wa", initial=-0.5), ocp.state("Wb", initial=0.528)
    pH, base = ocp.algebraic("pH", initial=7.0), ocp.parameter("base", value=15.6)
    power = partial(lambda ten, e: ca.exp(ten * e), np.log(10))
    carbonate = (1 + 2 * power(pH - 10.25)) / (1 + power(6.35 - pH) + power(pH - 10.25))
    ocp.algebraic_equation(Wa + 1e3 * (power(pH - 14) - power(-pH)) + Wb * carbonate)
    ocp.dynamics({Wa: ((3.0 - Wa) * 16.6 + (-3.05 - Wa) * base) / 2898.0, Wb: -Wb / 174.0})
    ocp.least_squares(pH, weight=100.0, reference=7.0)
    ocp.start_least_squares(Wb - 0.528, weight=1e3)
    ocp.free_initial(Wa, Wb)
    ctrl = build(ocp, profile="test")
    truth = np.array([-0.44, 0.528])
    x, measured = truth, []
    for _ in range(5):
        measured.append(float(ctrl.algebraic(x, [])[0]))
        x = ctrl.integrate(x, [], 15.0)
    for k, value in enumerate(measured):
        ctrl.set_reference([value], node=k)
    found = ctrl.solve([-0.5, 0.528])
    assert found.status == Status.OK
    assert found.x[0] == pytest.approx(truth, abs=1e-4)


# Examples ------------------------------------------------------------------------------------------------------------


def test_distillation_main(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distillation, "build", partial(build, profile="test"))
    log = distillation.main(str(tmp_path / "column.png"))
    assert log.ok
    assert log.x[-1, [0, -1]] == pytest.approx([distillation.BOTTOM, distillation.TOP], abs=5e-3)
    assert algebraic.residual(distillation.build_ocp(), log.x[1:5], log.z[1:5], log.u[1:5]) < 1e-12


def test_rope_crane_main(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rope_crane, "build", partial(build, profile="test"))
    log = rope_crane.main(str(tmp_path / "crane.png"))
    assert log.ok
    assert np.abs(log.x[-1, [0, 2]]).max() < 5e-3
    assert np.abs(rope_crane.stretch(log)).max() < 1e-5
    assert log.z.max() < rope_crane.STRONGEST + 1e-2
