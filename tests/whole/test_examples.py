"""The examples run as by their users, and the folder exported by the crane builds without the compiler."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

from examples import (
    adjoint_gradient,
    bioreactor,
    cart_pole,
    chain,
    crane,
    cstr,
    driving,
    estimation,
    evaporation,
    fermentation,
    heat_rod,
    input_delay,
    many_cranes,
    offset_free,
    output_rows,
    quadrotor,
    slew_rate,
    vandevusse,
)
from nmpc_codegen import OCP, ControllerError, ExplicitRungeKutta, Options, Status, build, cli
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference, node_data
from nmpc_codegen.oracle.trajectory import CLASSICAL, Tableau, interval_map
from verification import problems

matplotlib.use("Agg")

EXAMPLES = sorted(p.stem for p in (Path(__file__).parents[2] / "examples").glob("*.py") if p.stem != "__init__")


def assert_picture(file: Path) -> None:
    """The figure has some size, and it is not empty."""
    picture = matplotlib.image.imread(file)
    assert min(picture.shape[:2]) > 200
    assert picture[..., :3].std() > 0.01


def test_crane_main(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It exports the package, runs the loop and draws the picture."""
    crane.main(str(tmp_path / "c"), str(tmp_path / "loop.png"))
    files = {p.name for p in (tmp_path / "c").iterdir()}
    assert files == {"crane.c", "crane.h", "crane.json", "main.c", "CMakeLists.txt", "README.md"}
    assert_picture(tmp_path / "loop.png")
    printed = capsys.readouterr().out
    assert "bytes of memory" in printed
    assert "50" in printed


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The examples are built with the profile "test", which takes a third of the time; the crane keeps its own."""
    for module in (
        bioreactor,
        cart_pole,
        chain,
        cstr,
        driving,
        evaporation,
        fermentation,
        heat_rod,
        input_delay,
        estimation,
        offset_free,
        output_rows,
        quadrotor,
        slew_rate,
        vandevusse,
    ):
        monkeypatch.setattr(module, "build", partial(build, profile="test"))


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_cstr_main(tmp_path: Path) -> None:
    """Figure 6: reachable set points are reached, the other one up to the bounds; a node per sample satisfies them."""
    refined, coarse = cstr.main(str(tmp_path / "sub" / "cstr.png"))
    assert_picture(tmp_path / "sub" / "cstr.png")
    for log in (refined, coarse):
        assert log.ok
        for k, at in ((600, 0), (1800, 2)):
            np.testing.assert_allclose(log.x[k], cstr.SET_POINTS[at][:4], rtol=0, atol=2e-3)
        np.testing.assert_allclose(log.x[1200, 2:], [98, 92], rtol=0, atol=1e-2)
    assert sum(cstr.REFINED) == 1500
    assert (refined.x[:, 2:].min(axis=0) >= np.array([98, 92]) - 1e-5).all()
    assert coarse.x[:, 2].min() == pytest.approx(98 - 0.027, abs=1e-3)  # as described in the example


@pytest.mark.usefixtures("quick")
def test_cart_pole_main(tmp_path: Path) -> None:
    """The plan is followed, and the pole is upright at the end in spite of the push."""
    logs = cart_pole.main(str(tmp_path / "cart_pole.png"))
    assert_picture(tmp_path / "cart_pole.png")
    assert len(logs) == len(cart_pole.LENGTHS)
    for log in logs:
        assert np.all(np.delete(log.status, 40) == Status.OK)  # the plan before the blow is none after it
        assert not any(Status(s).is_failure for s in log.status)
        assert np.abs(log.x[39, :2]).max() < 0.08
        assert np.abs(log.x[41:50, 1]).max() > 0.5
        assert np.abs(log.x[-1, :2]).max() < 0.1


@pytest.mark.usefixtures("quick")
def test_slew_rate_main(tmp_path: Path) -> None:
    """The drive does what it is told, but for the time in which it is stuck, and the load hardly swings."""
    unknown, known = slew_rate.main(str(tmp_path / "slew.png")).values()
    assert_picture(tmp_path / "slew.png")
    free = np.setdiff1d(np.arange(slew_rate.SAMPLES), slew_rate.STUCK)
    np.testing.assert_allclose(known["told"][free], known["applied"][free], atol=1e-9)
    assert np.abs(unknown["told"] - unknown["applied"])[free].max() > 5
    assert np.abs(known["x"][:, 2]).max() < 0.2
    assert np.abs(unknown["x"][:, 2]).max() == pytest.approx(1.4, abs=0.05)  # as described in the tutorial
    np.testing.assert_allclose(known["x"][-1], [1, 0, 0, 0], atol=0.06)


@pytest.mark.usefixtures("quick")
def test_input_delay_main(tmp_path: Path) -> None:
    """Without the dead time in the model the loop overshoots and swings; with it, it comes to rest."""
    left_out, known = input_delay.main(str(tmp_path / "delay.png")).values()
    assert_picture(tmp_path / "delay.png")
    assert left_out.x[:, 0].max() - 60 == pytest.approx(24, abs=0.5)  # as described in the tutorial
    assert np.ptp(left_out.x[-20:, 0]) > 3
    assert known.x[:, 0].max() < 62.5
    np.testing.assert_allclose(known.x[-20:, 0], 60, atol=1e-2)
    np.testing.assert_allclose(known.x[2:-1, 2], known.u[:-2, 0], atol=1e-9)  # two samples late


@pytest.mark.usefixtures("quick")
def test_offset_free_main(tmp_path: Path) -> None:
    """Only rate and error of the model together leave no offset."""
    neither, rate, both = offset_free.main(str(tmp_path / "offset.png")).values()
    assert_picture(tmp_path / "offset.png")
    for k in (offset_free.LEAK_FROM, -1):
        assert abs(both.x[k, 0] - 0.5) < 1e-6
        assert min(abs(log.x[k, 0] - 0.5) for log in (neither, rate)) > 0.01
    alone = offset_free.run(integral=False, corrected=True)
    assert abs(alone.x[-1, 0] - 0.5) > 5e-4
    noisy = offset_free.run(integral=True, corrected=True, seed=1)
    assert noisy.estimates is not None
    np.testing.assert_allclose(noisy.x[-20:, 0], 0.5, atol=0.005)
    assert noisy.estimates.x[-1, 1] == pytest.approx(0.004 * -noisy.u[-1, 0] - offset_free.LEAK, abs=1e-3)


@pytest.mark.usefixtures("quick")
def test_quadrotor_main(tmp_path: Path) -> None:
    """After 2 s it is on the figure of eight, which is consistent: velocity is the derivative of position."""
    log = quadrotor.main(str(tmp_path / "quadrotor.png"))
    assert_picture(tmp_path / "quadrotor.png")
    assert log.ok
    wanted = quadrotor.path(log.t)
    distance = np.linalg.norm(log.x[:, :3] - wanted[:, :3], axis=1)
    assert distance[0] > 1
    assert distance[40:].max() < 0.03
    slope = (quadrotor.path(log.t + 1e-5) - quadrotor.path(log.t - 1e-5))[:, :3] / 2e-5
    np.testing.assert_allclose(wanted[:, 3:6], slope, atol=1e-8)


@pytest.mark.usefixtures("quick")
def test_chain_main(tmp_path: Path) -> None:
    (log,) = chain.main(str(tmp_path / "chain.png"), sizes=(3,))
    assert_picture(tmp_path / "chain.png")
    assert log.ok
    rest = [*chain.rest_shape(3), *chain.HAND]
    assert np.abs(log.x[0, :6] - rest).max() > 0.9
    np.testing.assert_allclose(log.x[-1, :6], rest, rtol=0, atol=1e-4)


@pytest.mark.usefixtures("quick")
def test_bioreactor_orbit() -> None:
    """The optimum with the exact Hessian; the topic exact_hessian has the other readings, closed loops."""
    controller, best = bioreactor.orbit()
    assert best.status.name == "OK"
    assert -best.cost == pytest.approx(3.054852, abs=1e-6)
    assert (controller.u >= bioreactor.LOWEST).all()
    assert (controller.u <= bioreactor.HIGHEST).all()


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_multipliers_of_the_orbit_are_not_unique() -> None:
    """As many rows are active as there are controls: lam jumps at every sample, and the plan stays all the same."""
    best = bioreactor.orbit()[1]
    controller = build(bioreactor.build_ocp(soft=True), bioreactor.options(), "test")
    rng, jumps = np.random.default_rng(0), []
    for _ in range(4):
        controller.reset()
        controller.x[...] = best.x * (1 + 1e-12 * rng.standard_normal(best.x.shape))
        controller.u[...], controller.lam[...] = best.u, best.lam
        x = best.x[0]
        for k in range(60):
            before = controller.lam.copy()
            u = controller.step(x)
            jumps.append(np.abs(controller.lam - before).max() > np.abs(before).max())
            assert controller.status is Status.OK
            assert controller.u[0] == pytest.approx(best.u[k % bioreactor.N], abs=1e-6)
            x = controller.integrate(x, u, bioreactor.SAMPLING)
    assert sum(jumps) > 10


@pytest.mark.slow
def test_bioreactor_main(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both orbits are optimal, and after a jump the classical one is reached again."""
    logs = bioreactor.main(str(tmp_path / "bioreactor.png"))
    assert_picture(tmp_path / "bioreactor.png")
    printed = capsys.readouterr().out
    assert f"(a): {(bioreactor.ALPHA * bioreactor.D + bioreactor.BETA) * bioreactor.X_MAX:.6f}" in printed
    assert "(b): 3.054852" in printed
    for log in logs.values():
        assert not log.status[:60].any()
        assert not log.status[62:].any()
        assert np.abs(log.x[60, :3] - log.x[40, :3]).max() > 0.5
        assert bioreactor.productivity(log, 100, 120) > 3.0540
        assert (log.u >= bioreactor.LOWEST).all()
        assert (log.u <= bioreactor.HIGHEST).all()


@pytest.mark.usefixtures("quick")
def test_fermentation_main(tmp_path: Path) -> None:
    """The rich feed begins and ends; after the jump the loop is as productive as before, and no plan is far."""
    loop = fermentation.main(str(tmp_path / "fermentation.png"))
    assert_picture(tmp_path / "fermentation.png")
    assert loop.not_ok == 0
    assert loop.residual.max() < 1e-2
    for first in (80, 180):
        assert loop.productivity(first) == pytest.approx(3.0549, rel=3e-3)
        assert np.mean(loop.feed[first : first + 20]) == pytest.approx(32.9, abs=0.15)
    assert loop.feed.min() >= 28.7
    assert loop.feed.max() <= 40.0


@pytest.mark.parametrize("n", [3, 5, 7])
def test_rest_shape_is_at_rest(n: int) -> None:
    """The controls that hold the reference are 0: Phi(reference, 0) is the reference; the chain hangs down."""
    M = n - 2
    problem = classify(chain.build_ocp(n))
    x = np.asarray(problem.x_initial)
    np.testing.assert_array_equal(problem.path.reference, [*x, 0, 0, 0])
    np.testing.assert_array_equal(problem.terminal.reference, x)
    Phi = interval_map(problem, CLASSICAL)
    np.testing.assert_allclose(Phi(x, np.zeros(3), [], chain.SAMPLING)[0].full().ravel(), x, rtol=0, atol=1e-10)
    balls = x[: 3 * M].reshape(M, 3)
    assert (balls[:, 2] < -0.05).all()
    np.testing.assert_allclose(balls[:, 1], 0, atol=1e-12)


# The models -----------------------------------------------------------------------------------------------------------


def rate(ocp: OCP, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """x' = f(x, u) with the declared parameters."""
    problem = classify(ocp)
    return problem.dynamics(x, u, problem.p_value).full().ravel()


def test_cstr_stands_still_at_its_set_points() -> None:
    """Set point 1 is a steady state; set point 3 is rounded to three digits. Rates per hour."""
    for index, tolerance in ((0, 1e-5), (2, 0.5)):
        at = cstr.SET_POINTS[index]
        np.testing.assert_allclose(3600 * rate(cstr.build_ocp(), at[:4], at[4:]), 0, atol=tolerance)


@pytest.mark.parametrize("any_length", [False, True])
def test_cart_pole_power(any_length: bool) -> None:
    """dE/dt = F v; E from the velocities of cart and tip, with the mass of the pole at the tip, th = 0 upright."""
    p, th, v, w, F = np.random.default_rng(3).uniform(-2, 2, 5)
    length, M, m = 0.8, cart_pole.CART, cart_pole.POLE
    x = np.array([p, th, v, w])

    def energy(x: np.ndarray) -> float:
        _, th, v, w = x
        tip = np.array([v - length * np.cos(th) * w, -length * np.sin(th) * w])
        return float(M * v**2 / 2 + m * tip @ tip / 2 + m * cart_pole.GRAVITY * length * np.cos(th))

    f = rate(cart_pole.build_ocp(any_length), x, np.array([F]))
    power = (energy(x + 1e-6 * f) - energy(x - 1e-6 * f)) / 2e-6
    assert power == pytest.approx(F * v, abs=1e-6)


def test_quadrotor_by_rotation_matrices() -> None:
    """vel' = R (0, 0, sum u / m) - g with R = Rz Ry Rx, R' = R [omega x], torques of the arms."""
    rng = np.random.default_rng(4)
    x, u = rng.uniform(-0.6, 0.6, 12), rng.uniform(0, 2.5, 4)

    def R(x: np.ndarray) -> np.ndarray:
        c, s = np.cos(x[6:9]), np.sin(x[6:9])
        Rx = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
        Ry = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
        Rz = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
        return Rz @ Ry @ Rx

    f = rate(quadrotor.build_ocp(), x, u)
    np.testing.assert_allclose(f[:3], x[3:6], atol=1e-15)
    np.testing.assert_allclose(f[3:6], R(x)[:, 2] * u.sum() / 0.5 - [0, 0, 9.81], atol=1e-13)
    omega, J = x[9:], np.diag([0.0023, 0.0023, 0.004])
    turning = R(x).T @ (R(x + 1e-6 * f) - R(x - 1e-6 * f)) / 2e-6
    for axis in np.eye(3):
        np.testing.assert_allclose(turning @ axis, np.cross(omega, axis), atol=1e-8)
    torque = np.array([0.17 * (u[1] - u[3]), 0.17 * (u[2] - u[0]), 0.016 * (u[0] - u[1] + u[2] - u[3])])
    np.testing.assert_allclose(J @ f[9:], torque - np.cross(omega, J @ omega), atol=1e-13)


@pytest.mark.parametrize("n", [3, 5])
def test_chain_keeps_its_energy(n: int) -> None:
    """While the hand is at rest, springs and weight conserve energy: dE/dt = 0."""
    M = n - 2
    x = np.random.default_rng(5).uniform(-1, 1, 6 * M + 3)
    f = rate(chain.build_ocp(n), x, np.zeros(3))

    def energy(x: np.ndarray) -> float:
        balls = np.vstack([np.zeros(3), x[: 3 * M + 3].reshape(-1, 3)])
        stretch = np.linalg.norm(np.diff(balls, axis=0), axis=1) - 0.033 * 6 / (M + 1)
        speed = x[3 * M + 3 :]
        weight = 0.033 * 9.81 * balls[1:-1, 2].sum()
        return float(0.033 * speed @ speed / 2 + weight + (M + 1) * stretch @ stretch / 2)

    assert np.abs(f).max() > 1
    assert (energy(x + 1e-6 * f) - energy(x - 1e-6 * f)) / 2e-6 == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("name", EXAMPLES)
def test_run_time_dependencies_are_enough(name: str) -> None:
    """Only imports of the standard library, the package, and its own dependencies."""
    tree = ast.parse((Path(__file__).parents[2] / "examples" / f"{name}.py").read_text(encoding="utf-8"))
    modules = {
        module.split(".")[0]
        for node in ast.walk(tree)
        for module in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [str(node.module)]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    assert modules - set(sys.stdlib_module_names) <= {"casadi", "matplotlib", "nmpc_codegen", "numpy"}


# solve() against IPOPT ------------------------------------------------------------------------------------------------


def pushed(n: int) -> np.ndarray:
    """The chain after five pushes, by the classical scheme of the oracle."""
    problem = classify(chain.build_ocp(n))
    Phi, x = interval_map(problem, CLASSICAL), np.asarray(problem.x_initial)
    for _ in range(5):
        x = Phi(x, chain.PUSH, [], chain.SAMPLING)[0].full().ravel()
    return x


@dataclass(frozen=True)
class Solved:
    """An example with its initial state; ``optimum`` and the rows that touch a bound are known beforehand."""

    make: Callable[[], OCP]
    x0: Callable[[], np.ndarray]
    active: frozenset[str]
    options: Options = field(default_factory=Options)
    tableau: Tableau = CLASSICAL
    optimum: float | None = None
    data: Mapping[str, Any] = field(default_factory=dict)


TWO_STEPS = Options(ExplicitRungeKutta())

SOLVED = {
    "cstr_1": Solved(lambda: cstr.build_ocp(1), lambda: cstr.START, frozenset({"th", "thK"}), TWO_STEPS),
    "cstr_refined": Solved(
        lambda: cstr.build_ocp(1, intervals=cstr.REFINED), lambda: cstr.START, frozenset({"th", "thK", "u2"}), TWO_STEPS
    ),
    "cart_pole": Solved(
        cart_pole.build_ocp,
        lambda: cart_pole.HANGING,
        frozenset({"F"}),
        optimum=22417.4595,
        options=cart_pole.options(),
    ),
    "quadrotor": Solved(
        lambda: quadrotor.build_ocp((0.5, 0.5, 0.5)),
        lambda: np.array([0.5, 0.5, 0.5, *[0.0] * 9]),
        frozenset({"u[2]", "u[3]"}),
        options=quadrotor.options(),
        tableau=replace(CLASSICAL, steps=1),
    ),
    "chain_3": Solved(lambda: chain.build_ocp(3), lambda: pushed(3), frozenset({"u[0]", "u[1]", "u[2]"}), TWO_STEPS),
}


def relative(ours: Any, theirs: Any) -> float:
    """Largest difference per component, relative to max(1, largest value of the component)."""
    return float(np.max(np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs).max(axis=0))))


@pytest.mark.few(3)
@pytest.mark.parametrize("name", sorted(SOLVED))
def test_equal_to_ipopt(name: str) -> None:
    """Both from the initial iterate; if they find different optima, IPOPT started at ours must return it."""
    case = SOLVED[name]
    ocp, x0 = case.make(), case.x0()
    problem = classify(ocp)
    controller = build(ocp, case.options, "test")
    problems.apply(controller, case.data)
    controller.x[:] = x0
    solution = controller.solve(x0, tol=1e-9, max_iterations=200)
    assert solution.status.name == "OK"
    reference, data = Reference(problem, case.tableau), node_data(problem, x0=x0, **case.data)
    optimum = reference.solve(data)
    if relative(solution.u, optimum.u) > 1e-3:
        assert solution.cost < optimum.cost
        optimum = reference.solve(data, x=solution.x, u=solution.u)
    assert optimum.success
    assert relative(solution.u, optimum.u) <= 1e-6
    assert relative(solution.x, optimum.x) <= 1e-6
    assert solution.cost == pytest.approx(optimum.cost, rel=1e-8)
    if case.optimum is not None:
        assert solution.cost == pytest.approx(case.optimum, abs=1e-4)
    values = dict(zip(controller.names.states, solution.x[1:].T, strict=True))
    values.update(zip(controller.names.controls, solution.u.T, strict=True))
    near = {row.name for row in problem.rows if is_at_bound(values[row.name], row.lower, row.upper)}
    assert near == case.active


def is_at_bound(values: np.ndarray, lower: float, upper: float) -> bool:
    return bool(np.minimum(values - lower, upper - values).min() <= 1e-7)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_evaporation_main(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The plant is on its way to the cheapest steady state, on the bound; eta = 0 is explained."""
    tuning, log = evaporation.main(str(tmp_path / "evaporation.png"))
    assert_picture(tmp_path / "evaporation.png")
    assert log.ok
    assert log.x[1:, 0] == pytest.approx(25, abs=1e-4)
    assert abs(log.x[-1, 1] - tuning.x_s[1]) < 1.0 < log.x[0, 1] - tuning.x_s[1]
    assert "eta=1 uses the strictly active rows (X2)" in capsys.readouterr().out


@pytest.mark.usefixtures("quick")
def test_many_cranes_main(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """All arrive, no sample fails; the picture is that of a density, and of few flights that of lines."""
    monkeypatch.setattr(many_cranes, "run", partial(many_cranes.run, 300))
    flights = many_cranes.main(str(tmp_path / "many.png"))
    assert flights.ok.all()
    assert "within 0.1 m: 300 of 300" in capsys.readouterr().out
    few = many_cranes.run(20)
    few.plot(tmp_path / "few.png")
    few.failed[3] = 5
    assert few.wrong.sum() == 1
    few.plot(tmp_path / "wrong.png")
    for name in ("many", "few", "wrong"):
        assert_picture(tmp_path / f"{name}.png")
    with pytest.raises(ControllerError, match="record=True"):
        many_cranes.run(2, record=False).plot()


def test_estimation_main(tmp_path: Path) -> None:
    """The estimates converge to what is true, and the cart follows although it tilts by 35 standard deviations
    of what is declared, which is told."""
    log, errors = estimation.main(str(tmp_path / "estimation.png"))
    assert_picture(tmp_path / "estimation.png")
    found = log.estimates
    assert log.ok
    assert found is not None
    assert set(np.flatnonzero(found.status)) <= set(range(estimation.TILT, estimation.TILT + 30))
    assert found.status[estimation.TILT : estimation.TILT + 30].any()
    settled = np.r_[60:80, 140:160, 220:240]
    error = np.abs(found.x - np.column_stack([log.x[:-1], found.p]))[settled]
    assert (error.mean(axis=0) < [estimation.NOISE, 0.02, 0.06]).all()
    wanted = np.where(settled < estimation.JUMP, 0.5, -0.2)[~np.isin(settled, range(60, 80))]
    assert np.abs(log.x[settled, 0][20:] - wanted).max() < 0.01
    assert errors["mhe"] < errors["ekf"] < 0.1


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_driving_main(tmp_path: Path) -> None:
    """The car stops short of the obstacle without using the brake, follows the lane and returns to 50 km/h."""
    _, log = driving.main(str(tmp_path / "driving.png"))
    assert_picture(tmp_path / "driving.png")
    assert log.ok
    assert log.x[60, 0] == pytest.approx(driving.OBSTACLE, abs=1e-3)
    assert log.u[80:, 1].max() < 1e-6
    np.testing.assert_allclose(log.x[-1, 1:], [0, driving.SPEED, 0, 0], rtol=0, atol=1e-4)


def test_adjoint_gradient_main(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All methods find the same gradient; along the stabilised trajectory the simulation follows the formula."""
    found = adjoint_gradient.main(str(tmp_path / "gradient.png"))
    assert_picture(tmp_path / "gradient.png")
    assert "J = 10.575964" in capsys.readouterr().out
    for method, gradient in found.items():
        rough = method == "finite_differences"
        np.testing.assert_allclose(gradient, found["adjoint"], rtol=0, atol=1e-4 if rough else 1e-12)
    counts = [adjoint_gradient.operations(N) for N in (160, 320)]
    growth = {method: counts[1][method] / counts[0][method] for method in adjoint_gradient.LABELS}
    assert growth["adjoint"] < 2.01
    assert 3.8 < growth["forward"] < 4 > growth["finite_differences"] > 3.8


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_vandevusse_main(tmp_path: Path) -> None:
    """A weight above the multipliers satisfies the rows; less does not."""
    plans = vandevusse.main(str(tmp_path / "vandevusse.png"))
    assert_picture(tmp_path / "vandevusse.png")
    over = {name: (plan.x[1:, 1:3] - [800, 100]).max(axis=0) for name, plan in plans.items()}
    assert all(plan.status.name == "OK" for plan in plans.values())
    assert over["penalty 0"][0] > over["penalty 10"][0] > 50
    np.testing.assert_allclose(over["penalty 20"], 0, atol=1e-3)
    assert over["integral, penalty 20"][0] > over["integral, penalty 80"][0]
    assert max(over["integral, penalty 80"]) < 0.5


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_output_rows_main(tmp_path: Path) -> None:
    """All treatments and both methods end at the optimum of IPOPT with the rows themselves."""
    plans = output_rows.main(str(tmp_path / "rows.png"))
    assert_picture(tmp_path / "rows.png")
    problem = classify(output_rows.build_ocp())
    data = replace(node_data(problem, x0=output_rows.START), p=np.arange(1.0, output_rows.N + 2)[:, None])
    exact = Reference(problem).solve(data, u=output_rows.first_guess())
    assert exact.success
    for (method, rows), found in plans.items():
        assert found.status is Status.OK, (method, rows)
        assert found.cost == pytest.approx(exact.cost, rel=1e-3), (method, rows)
        assert np.abs(output_rows.output_of(found)[1:]).max() < output_rows.HIGHEST + 1e-4
    assert all(
        plans["gauss_newton", r].iterations < plans["quasi_newton", r].iterations for r in output_rows.TREATMENTS
    )


@pytest.mark.parametrize(("u", "cB", "T"), [(vandevusse.ENDS[0], 739.7, 86.99), (vandevusse.ENDS[1], 959.9, 106.0)])
def test_vandevusse_stands_still_at_its_steady_states(u: np.ndarray, cB: float, T: float) -> None:
    x = vandevusse.steady_state(u)
    assert x[1] == pytest.approx(cB, abs=0.05)
    assert x[2] == pytest.approx(T, abs=0.05)
    assert np.abs(np.asarray(classify(vandevusse.build_ocp()).dynamics(x, u, []))).max() < 1e-6


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_heat_rod_main(tmp_path: Path) -> None:
    """The profile is approached, with the left control at its bound at first."""
    log = heat_rod.main(str(tmp_path / "heat_rod.png"))
    assert_picture(tmp_path / "heat_rod.png")
    assert log.ok
    assert log.u[:100, 0] == pytest.approx(heat_rod.HOTTEST)
    off = np.abs(log.x - heat_rod.profile())
    assert off[-1].max() < 5 < off[360].max() < off[0].max()


# The packages ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_example_states_a_problem(name: str) -> None:
    module: Any = importlib.import_module(f"examples.{name}")
    assert (module.__doc__ or "").strip()
    assert callable(module.main)
    problem = classify(module.build_ocp())
    assert problem.N >= 1
    assert problem.path.ny >= 1 or problem.path.cost is not None or problem.path.cost_rate is not None


@pytest.mark.few(1)
@pytest.mark.parametrize("name", EXAMPLES)
def test_command_line_takes_every_example(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([str(Path(__file__).parents[2] / "examples" / f"{name}.py"), "-o", str(tmp_path / "c")]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.count("fewest operations") <= 1
    assert len(list((tmp_path / "c").glob("*.c"))) == 2
