"""What cannot work at the first plan is a warning of build(), export() and generate(); its remedies work."""

from __future__ import annotations

import operator
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    RK4,
    ExplicitRungeKutta,
    Options,
    ProblemWarning,
    Status,
    build,
    export,
    generate,
    open_package,
    simulate,
)
from verification.problems import CASES
from verification.strangers.problems import STRANGERS


def texts(ocp: OCP, options: Options | None = None) -> list[str]:
    """What generate() warns of."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        generate(ocp, options)
    return [str(w.message) for w in seen if issubclass(w.category, ProblemWarning)]


def point(where: str, distance: Callable[[ca.SX], ca.SX] = ca.norm_2, initial: float = 0.0) -> OCP:
    """A point that is pulled to (1, 1), with its distance from the origin in a part of the problem."""
    ocp = OCP("point", T=2.0, N=10)
    p, a = ocp.state("p", size=2, initial=initial), ocp.control("a", size=2)
    d = distance(p)
    ocp.dynamics({p: a - (0.1 * d if where == "equation" else 0)})
    ocp.least_squares(ca.vertcat(p - 1, a), weight=1)
    if where == "residual":
        ocp.least_squares(d, weight=1, names=["dist"])
    if where == "cost":
        ocp.stage_cost(d)
    if where in ("row", "soft row"):
        ocp.subject_to(-ca.inf, d, 0.5, name="leash", soft=(10, 1) if where == "soft row" else None)
    return ocp


PARTS = {
    "row": "row 'leash' at nodes 1..9",
    "soft row": "row 'leash' at nodes 1..9",
    "residual": "the residual 'dist' at nodes 0..9",
    "cost": "the general cost at nodes 0..9",
    "equation": "the equation of p[0] at nodes 0..9",
}


@pytest.mark.parametrize("where", PARTS)
def test_a_norm_at_zero_is_named_before_and_after_it_fails(where: str, compiler: tuple[str, ...]) -> None:
    """By part, nodes, operation and remedy; step() and solve() fail, and say the same."""
    assert compiler
    ocp = point(where)
    named = f"{PARTS[where]}: sqrt(p[0]**2 + p[1]**2) has no finite derivative where its argument is 0"
    with pytest.warns(ProblemWarning, match="the first plan has no finite derivatives") as seen:
        ctrl = build(ocp, profile="test")
    assert named in str(seen[0].message)
    assert seen[0].filename == __file__
    ctrl.step([0.0, 0.0])
    assert ctrl.status == Status.NUMERICAL_FAILURE
    assert named in ctrl.diagnose()
    ctrl.reset()
    ctrl.solve([0.0, 0.0])
    assert named in ctrl.diagnose()
    assert f"write sqrt(p[0]**2 + p[1]**2 + {'1e-3' if where == 'equation' else '1e-6'})" in ctrl.diagnose()
    assert ("bound the square instead" in ctrl.diagnose()) == (where == "row")
    assert "GaussNewton" not in ctrl.diagnose()


@pytest.mark.few(3)
@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("where", PARTS)
def test_the_remedies_for_a_norm_work(where: str) -> None:
    eps = 1e-3 if where == "equation" else 1e-6
    remedies = [lambda p: ca.sqrt(ca.sumsqr(p) + eps), *((ca.sumsqr,) if where == "row" else ())]
    for remedy in remedies:
        ocp = point(where, remedy)
        assert not texts(ocp)
        ctrl = build(ocp, profile="test")
        for _ in range(10):
            ctrl.step([0.0, 0.0])
        assert ctrl.status == Status.OK
        ctrl.reset()
        assert ctrl.solve([0.0, 0.0]).status == Status.OK


EDGES: dict[str, Callable[[Any, Any], Any]] = {
    "hypot(x, v)": ca.hypot,
    "atan2(x, v)": ca.atan2,
    "pow(x, 0.7)": lambda x, v: x**0.7,
    "log(x)": lambda x, v: ca.log(x),
    "v / x": lambda x, v: v / x,
    "asin(x + 1)": lambda x, v: ca.asin(x + 1),
}


@pytest.mark.parametrize("text", EDGES)
def test_other_operations_at_the_edge_of_their_domain(text: str) -> None:
    ocp = OCP("edge", T=1.0, N=4)
    x, v, u = ocp.state("x"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({x: v, v: u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=1)
    ocp.subject_to(-1, EDGES[text](x, v) + u, 1, name="edge")
    (found,) = texts(ocp)
    assert f"row 'edge' at nodes 0..3: {text} " in found
    for written in re.findall(r"(?:write|angle, or) ((?!the)[^;]*?)(?: if [^;]*)?(?:;|$)", found):
        assert_is_finite(written)


def assert_is_finite(written: str) -> None:
    """The expression of a remedy, in x and v, has finite derivatives at and beside the edge."""
    functions = {"sqrt": ca.sqrt, "pow": operator.pow, "log": ca.log, "fmax": ca.fmax, "atan2": ca.atan2}
    z = ca.SX.sym("z", 2)
    better = eval(written, {"x": z[0], "v": z[1]} | functions)
    f = ca.Function("f", [z], [better, *ca.hessian(better, z)])
    for x in (0.0, 1e-6, -1e-6 if "atan2" in written else 1.0):
        assert all(np.all(np.isfinite(np.array(value))) for value in f([x, 0.0])), written


def test_a_second_derivative_counts_where_it_is_evaluated() -> None:
    """x^(3/2) at 0: the exact Hessian of solve() has no finite value there, Gauss-Newton alone needs none."""
    ocp = OCP("kink", T=1.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x**1.5, u), weight=1)
    (found,) = texts(ocp)
    assert "residual 'y_0' at nodes 0..3: pow(x, 1.5) has no finite second derivative" in found
    assert not texts(ocp, Options(solve=False))


# What moves nothing --------------------------------------------------------------------------------------------------


def cube(**control: float) -> OCP:
    """A force u^3."""
    ocp = OCP("cube", T=4.0, N=40)
    p, v, u = ocp.state("p"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({p: v, v: u**3})
    ocp.least_squares(ca.vertcat(p - 1, v, u), weight=[10, 0.1, 0.01], reference=[0, 0, control.get("reference", 0)])
    ocp.terminal_least_squares(ca.vertcat(p - 1, v), weight=[100, 10])
    ocp.subject_to(-1, u, 1)
    return ocp


@pytest.mark.usefixtures("compiler")
def test_a_control_whose_slope_vanishes_is_no_fault() -> None:
    """Samples probe it, from the first plan on; one that waits for another, too."""
    assert not texts(cube())
    assert simulate(build(cube(), profile="test"), [0.0, 0.0], steps=40).x[-1, 0] > 0.5
    ocp = OCP("product", T=1.0, N=4)
    x, u, w = ocp.state("x"), ocp.control("u"), ocp.control("w")
    ocp.dynamics({x: u * w})
    ocp.least_squares(ca.vertcat(10 * (x - 1), u, w), weight=1)
    assert not texts(ocp)
    assert simulate(build(ocp, profile="test"), [0.0], steps=10).x[-1, 0] > 0.5


@pytest.mark.usefixtures("compiler")
def test_a_control_without_influence() -> None:
    """A state at 0 scales it, which nothing moves: it stays where it is, and with another state it does not."""
    ocp = OCP("scaled", T=1.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x * (1 + u)})
    ocp.least_squares(ca.vertcat(x - 1, u), weight=1)
    (found,) = texts(ocp)
    assert "control 'u' is 0 at the first plan, where its first derivatives" in found
    assert "no iteration moves it" in found
    with pytest.warns(ProblemWarning):
        ctrl = build(ocp, profile="test")
    assert np.all(simulate(ctrl, [0.0], steps=10).x == 0)
    assert simulate(ctrl, [0.5], steps=10).x[-1, 0] > 0.8


def test_an_end_time_that_is_a_control() -> None:
    """It waits for the speed, the speed for it: a product of three, which no probe of two moves."""
    ocp = OCP("both", T=1.0, N=20)
    p, v, end, a = ocp.state("p", initial=2.0), ocp.state("v"), ocp.control("end"), ocp.control("a")
    ocp.dynamics({p: end * v, v: end * a})
    ocp.least_squares(ca.vertcat(p, v, a, end), weight=[1, 1, 0.1, 0.1])
    assert len(texts(ocp)) == 2


def test_influence_that_comes_with_the_first_steps_is_no_fault() -> None:
    """A car that stands: its wheels turn it once it moves. Data that are parameters: they change."""
    car = OCP("car", T=2.0, N=10)
    x, y, h, v = (car.state(name) for name in ("x", "y", "h", "v"))
    a, steering = car.control("a"), car.control("steering")
    car.dynamics({x: v * ca.cos(h), y: v * ca.sin(h), h: v * ca.tan(steering), v: a})
    car.least_squares(ca.vertcat(x - 1, y - 1, h, v, a, steering), weight=1)
    assert not texts(car)
    given = OCP("given", T=2.0, N=10)
    z, u, b, d = given.state("z"), given.control("u"), given.parameter("b"), given.parameter("d")
    given.dynamics({z: b * u - z})
    given.least_squares(ca.vertcat(z, u), weight=1)
    given.subject_to(1, (z - d) ** 2, ca.inf, name="away")
    assert not texts(given)


def robot(row: str) -> OCP:
    """A robot with a turning radius, |w| <= g v, that starts at rest."""
    g, lag = 1.5, 0.15
    ocp = OCP("robot", T=3.0, N=30)
    x, y, th, v, w = (ocp.state(n) for n in ("x", "y", "theta", "v", "w"))
    vc, wc = ocp.control("v_cmd"), ocp.control("w_cmd")
    ocp.dynamics({x: v * ca.cos(th), y: v * ca.sin(th), th: w, v: (vc - v) / lag, w: (wc - w) / lag})
    e = ca.vertcat(x - 2, y - 1, th)
    ocp.least_squares(ca.vertcat(e, vc, wc), weight=[1, 1, 0.1, 0.05, 0.05])
    ocp.terminal_least_squares(e, weight=[20, 20, 2])
    ocp.subject_to([-0.3, -1.5], ca.vertcat(vc, wc), [1, 1.5])
    if row == "squares":
        ocp.subject_to(-ca.inf, wc**2 - g**2 * vc**2, 0, name="turn")
    else:
        ocp.subject_to(0, ca.vertcat(g * vc - wc, g * vc + wc), ca.inf, name="turn")
    return ocp


@pytest.mark.usefixtures("compiler")
def test_a_row_whose_gradient_vanishes_at_rest() -> None:
    (found,) = texts(robot("squares"))
    assert "row 'turn': its gradient vanishes at the first plan, where it is 0 and its bounds are -inf and 0" in found
    assert not texts(robot("lines"))
    log = simulate(build(robot("lines"), profile="test"), np.zeros(5), steps=60)
    assert log.failures == 0
    assert np.all(np.abs(log.u[:, 1]) <= 1.5 * log.u[:, 0] + 1e-9)


def test_a_gradient_that_vanishes_inside_the_bounds_is_no_fault() -> None:
    ocp = OCP("disc", T=1.0, N=4)
    x, u = ocp.state("x", size=2), ocp.control("u", size=2)
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    ocp.subject_to(-ca.inf, ca.sumsqr(x), 4, name="inside")
    assert not texts(ocp)
    ocp.subject_to(1, ca.sumsqr(u), 1, name="unit")
    assert ["row 'unit': its gradient vanishes" in text for text in texts(ocp)] == [True]


def test_a_bound_that_always_holds_is_no_fault() -> None:
    """The lower bound 0 of a sum of squares; a row with a path and an end is named once."""
    ocp = OCP("squares", T=1.0, N=4)
    x, u = ocp.state("x", size=2), ocp.control("u", size=2)
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    ocp.subject_to(0, ca.sumsqr(x), 4, name="ring")
    assert not texts(ocp)
    ocp.subject_to(1, ca.sumsqr(x), 5, name="away")
    (found,) = texts(ocp)
    assert "row 'away'" in found


def test_a_control_without_weight_that_waits_for_another() -> None:
    """Steering of a car that stands: the first QP does not determine it."""
    ocp = OCP("parked", T=2.0, N=20)
    x, y, h, v = (ocp.state(name) for name in ("x", "y", "psi", "v"))
    a, d = ocp.control("a"), ocp.control("delta")
    ocp.dynamics({x: v * ca.cos(h), y: v * ca.sin(h), h: v * ca.tan(d) / 2, v: a})
    ocp.least_squares(ca.vertcat(x - 5, y - 1, h, v, a), weight=[1, 1, 0.1, 0.1, 0.1])
    (found,) = texts(ocp)
    assert "control 'delta' has neither a weight nor an influence" in found
    assert "least_squares(delta, weight=1e-2)" in found
    ocp.least_squares(d, weight=1e-2)
    assert not texts(ocp)


@pytest.mark.parametrize("discrete", [False, True])
def test_an_end_time_beside_a_clock_and_in_a_map(discrete: bool) -> None:
    ocp = OCP("clock", **({"N": 10} if discrete else {"T": 1.0, "N": 10}))
    p, v, s = ocp.state("p", initial=2.0), ocp.state("v"), ocp.state("s")
    end, a = ocp.state("end"), ocp.control("a")
    flow = {p: end * v, v: end * a, s: 1, end: 0}
    ocp.dynamics({p: p + end * v, v: v + end * a, s: s + 1, end: end} if discrete else flow, discrete=discrete)
    ocp.free_initial(end)
    ocp.stage_cost(end + a**2)
    ocp.terminal_cost(p**2 + v**2)
    (found,) = texts(ocp)
    assert "state 'end' is 0 at the first plan and scales the derivatives" in found


def test_a_parameter_that_is_set_later_is_no_fault() -> None:
    """A mass of 0 in a denominator; a step before it is set says so."""
    ocp = OCP("mass", T=2.0, N=20)
    p, v, F, m = ocp.state("p", initial=1.0), ocp.state("v"), ocp.control("F"), ocp.parameter("m")
    ocp.dynamics({p: v, v: F / m})
    ocp.least_squares(ca.vertcat(p, v, F), weight=[1, 1, 0.1])
    assert not texts(ocp)
    ctrl = build(ocp, profile="test")
    ctrl.step([1.0, 0.0])
    assert "F / m is not finite where the denominator is 0; set the parameters in it" in ctrl.diagnose()


@pytest.mark.parametrize("given", ["state", "parameter"])
def test_an_end_time_of_zero(given: str) -> None:
    def landing(value: float) -> OCP:
        ocp = OCP("landing", T=1.0, N=10)
        x, v, u = ocp.state("x"), ocp.state("v", initial=1.0), ocp.control("u")
        end = ocp.state("end", initial=value) if given == "state" else ocp.parameter("end", value=value)
        ocp.dynamics({x: v * end, v: u * end} | ({end: 0} if given == "state" else {}))
        if given == "state":
            ocp.free_initial(end)
        ocp.stage_cost(end + u**2)
        ocp.subject_to(1, x, 1, at="end")
        return ocp

    word = "initial" if given == "state" else "value"
    (found,) = texts(landing(0.0))
    assert f"{given} 'end' is 0 at the first plan and scales the derivatives" in found
    assert f"ocp.{given}('end', {word}=1.0)" in found
    assert not texts(landing(1.0))


# Where they are said -------------------------------------------------------------------------------------------------


def fast() -> OCP:
    """A pole at -20 1/s, samples of 1 s."""
    ocp = OCP("fast", T=30.0, N=30)
    P, m, r = ocp.state("P", initial=0.6), ocp.state("m", initial=0.3), ocp.control("r")
    ocp.dynamics({P: 20.0 * (0.6 + 2.0 * (m - 0.3) * P - P), m: r})
    ocp.least_squares(ca.vertcat(P, r), weight=[1, 1], reference=[0.7, 0])
    ocp.subject_to([-0.05, 0.02, 0.1], ca.vertcat(r, m, P), [0.05, 0.9, 2])
    return ocp


@pytest.mark.usefixtures("compiler")
def test_unstable_steps_are_said_by_all_and_repeated_after_a_failure(tmp_path: Path) -> None:
    needed = (
        r"RK4 with steps=2 is unstable.*eigenvalue -20 1/s; ImplicitRungeKutta\(SDIRK3, steps=\d\).*; 8 steps.*"
        r"ExplicitRungeKutta\(RK4, steps=8\)"
    )
    explicit = Options(integrator=ExplicitRungeKutta())
    with pytest.warns(ProblemWarning, match=needed):
        package = export(fast(), explicit, directory=tmp_path)
    assert [text.startswith("integrator RK4") for text in package.report["warnings"]] == [True]
    assert not any("unstable" in choice for choice in package.report["choices"])
    with pytest.warns(ProblemWarning, match=needed) as seen:
        build(fast(), explicit, profile="test")
    assert [w.filename for w in seen] == [__file__]
    ctrl = open_package(tmp_path, profile="test")
    assert ctrl.solve([0.65, 0.3]).status.is_failure
    assert "warning at build: integrator RK4 with steps=2 is unstable" in ctrl.diagnose()
    better = build(fast(), Options(integrator=ExplicitRungeKutta(RK4, steps=12)), profile="test")
    assert better.solve([0.65, 0.3]).status == Status.OK


@pytest.mark.slow
def test_known_problems_have_no_warnings() -> None:
    """All cases of the tests and all strangers but one, whose unit vector starts as 0."""
    for case in CASES.values():
        assert not texts(case.make(), case.options), case
    warned = {s.name: texts(s.ocp(), s.options()) for s in STRANGERS}
    assert [name for name, found in warned.items() if found] == ["quaternion"]
    assert "row 'unit': its gradient vanishes" in warned["quaternion"][0]
