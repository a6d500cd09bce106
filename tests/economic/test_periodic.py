"""tune_periodic(): the orbit, its Hessians, LETEMPC along it, and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nmpc_codegen import OCP, OptionError, ProblemError
from nmpc_codegen.economic import letempc_cost, periodic_letempc, tune, tune_periodic
from nmpc_codegen.errors import NmpcError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import CLASSICAL, Reference, node_data
from verification.economic import store

pytest.importorskip("clarabel")


def test_orbit_is_that_of_ipopt_on_the_stated_problem() -> None:
    """A day with a free initial state and x_N = x_0, stated as an OCP of its own."""
    day = store.store()
    ocp = OCP("day", T=24.0, N=24, time_unit="h")
    T, q = ocp.state("T", initial=45.0), ocp.control("q")
    price, demand = ocp.parameter("price"), ocp.parameter("demand")
    ocp.dynamics({T: (q - demand - 0.02 * (T - 15)) / 1.2})
    ocp.stage_cost(price * q * (1 + 0.05 * q) / (6 - 0.06 * T) + 1e-4 * (T - 40) ** 2)
    ocp.subject_to(0, q, 10)
    ocp.subject_to(35, T, 60)
    ocp.free_initial(T)
    ocp.boundary(0, ocp.at_end(T) - ocp.at_start(T), 0)
    problem, t = classify(ocp), store.tuned()
    p = np.vstack([store.DATA, store.DATA[:1]])
    data = node_data(problem, x0=np.array([45.0]))
    found = Reference(problem, CLASSICAL).solve(
        data.__class__(**{**vars(data), "p": p}), x=np.full((25, 1), 45.0), u=np.full((24, 1), 3.0)
    )
    assert found.success
    np.testing.assert_allclose(found.x[:-1], t.x, atol=1e-5)
    np.testing.assert_allclose(found.u, t.u, atol=1e-5)
    assert found.cost / 24 == pytest.approx(t.cost, rel=1e-8)
    assert classify(day).np == t.problem.np == 2


def test_hessians_are_convex_and_agree_on_the_null_space() -> None:
    """M_k > 0 although H_k is indefinite; the first step is that of H; M_k is H_k up to rotations and active rows."""
    t = store.tuned()
    assert np.linalg.eigvalsh(t.M).min() > 0 > np.linalg.eigvalsh(t.H)[:, 0].min()
    assert any(t.active)
    exact, constant = store.first_steps()
    np.testing.assert_allclose(constant.du, exact.du, atol=1e-10)
    np.testing.assert_allclose(constant.dx, exact.dx, atol=1e-10)


def test_letempc_agrees_to_first_order() -> None:
    """Halving the distance from the orbit divides the difference of the first control by four."""
    both = store.first_controls([1.0, 0.5, 0.25])
    difference = np.abs(both[:, 0] - both[:, 1])
    assert np.abs(both[:, 0] - store.tuned().u[store.START, 0]).min() > 0.05
    np.testing.assert_allclose(difference[:-1] / difference[1:], 4.0, rtol=0.05)


def plain(bend: float = 1.0) -> OCP:
    ocp = OCP("plain", T=3.0, N=3)
    x, u = ocp.state("x", initial=0.5), ocp.control("u")
    ocp.dynamics({x: u - 0.5 * x})
    ocp.stage_cost(bend * (x - 1) ** 2 + 0.1 * u**2 + 0.3 * u)
    ocp.subject_to(-5, u, 5)
    ocp.subject_to(-5, x, 5)
    return ocp


def test_a_period_without_changes_is_the_steady_state() -> None:
    """tune() and tune_periodic() find the same point, multipliers and H, and LETEMPC costs nothing there."""
    ocp = plain()
    ocp.lqr_terminal_cost(economic=True)
    steady, orbit = tune(ocp), tune_periodic(plain(), period=4)
    np.testing.assert_allclose(orbit.x, np.tile(steady.x_s, (4, 1)), atol=1e-8)
    np.testing.assert_allclose(orbit.lam, np.tile(steady.lam_s, (4, 1)), atol=1e-8)
    np.testing.assert_allclose(orbit.H[0], steady.H, atol=1e-8)
    assert letempc_cost(steady, steady.x_s, steady.u_s).is_zero()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({}, "either parameters=, one row per interval, or period="),
        ({"period": 0}, "period=0; expected an integer >= 1"),
        ({"period": 3, "parameters": [1.0]}, "either parameters="),
        ({"parameters": [[1.0], [2.0]]}, "'plain' has no parameters; give period="),
        ({"period": 3, "guess": ([0.0], [0.0])}, r"expected \(x, u\) of shapes \(3, 1\) and \(3, 1\)"),
        ({"period": 3, "guess": ([np.nan] * 3, [0.0] * 3)}, "guess= has NaN"),
        ({"period": 3, "eta": 2}, "eta=2"),
        ({"period": 3, "options": "fast"}, "options: 'fast'; expected Options"),
    ],
)
def test_wrong_arguments(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(NmpcError, match=said):
        tune_periodic(plain(), **arguments)


def test_what_has_no_orbit_is_refused() -> None:
    concave, impossible, cyclic = plain(bend=-1.0), plain(), plain()
    with pytest.raises(ProblemError, match="not strictly dissipative"):
        tune_periodic(concave, period=3, eta=0)
    impossible.subject_to(6, impossible.x[0] + impossible.u[0], 7, name="beyond")
    impossible.subject_to(-7, impossible.x[0] + 2 * impossible.u[0], -6, name="other")
    with pytest.raises(ProblemError, match="no periodic operation of 3 intervals"):
        tune_periodic(impossible, period=3)
    cyclic.cyclic(cyclic.x[0])
    with pytest.raises(ProblemError, match="cyclic"):
        tune_periodic(cyclic, period=3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (np.zeros((24, 3)), r"parameters of shape \(24, 3\); expected \(P, 2\)"),
        ([[1.0, 2.0], [3.0]], r"expected numbers of shape \(P, 2\)"),
        (np.where(np.arange(48).reshape(24, 2) == 7, np.nan, 1.0), r"parameters\[3, 1\] is nan"),
    ],
)
def test_wrong_parameters(given: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        tune_periodic(store.store(), parameters=given)


def money(scale: float, soft: tuple[float, float] | None = None) -> OCP:
    """The store with its cost in another currency."""
    ocp = OCP("money", T=24.0, N=24, time_unit="h")
    T, q = ocp.state("T", initial=45.0), ocp.control("q")
    price, demand = ocp.parameter("price", value=0.2), ocp.parameter("demand", value=3.0)
    ocp.dynamics({T: (q - demand - 0.02 * (T - 15)) / 1.2})
    ocp.stage_cost(scale * (price * q * (1 + 0.05 * q) / (6 - 0.06 * T) + 1e-4 * (T - 40) ** 2))
    ocp.subject_to(0, q, 10)
    ocp.subject_to(35, T, 60, soft=soft)
    return ocp


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_currency_decides_nothing(scale: float) -> None:
    found, known = tune_periodic(money(scale), parameters=store.DATA), store.tuned()
    np.testing.assert_allclose(found.x, known.x, atol=1e-6)
    assert found.active == known.active
    assert found.cost == pytest.approx(scale * known.cost, rel=1e-8)
    np.testing.assert_allclose(found.lam, scale * known.lam, atol=1e-8 * scale)


def test_a_soft_row_must_hold_on_the_orbit() -> None:
    """The largest multiplier of T >= 35 is about 0.014 EUR/K."""
    with pytest.raises(ProblemError, match="soft row 'T' is violated at the best orbit"):
        tune_periodic(money(1.0, (1e-3, 0.0)), parameters=store.DATA)
    assert tune_periodic(money(1.0, (1.0, 0.0)), parameters=store.DATA).active == store.tuned().active


def bent(bound: bool = True) -> OCP:
    """The best operation is at a bound of u, where the cost bends the wrong way; at 0 it is a maximum."""
    ocp = OCP("bent", T=6.0, N=6)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.stage_cost(-(x**2) + 0.5 * u**2, integrate=True)
    if bound:
        ocp.subject_to(-1, u, 1)
    return ocp


def test_a_maximum_is_left_and_m_keeps_the_size_of_h() -> None:
    found = tune_periodic(bent(), period=6)
    np.testing.assert_allclose(np.abs(found.u), 1.0, atol=1e-8)
    assert np.abs(found.M).max() < 100 * np.abs(found.H).max()
    with pytest.raises(ProblemError, match="no lower bound"):
        tune_periodic(bent(bound=False), period=3)


def test_what_letempc_is_stated_for() -> None:
    """The same signals and intervals, and no cost yet."""
    other = OCP("other", T=24.0, N=24)
    other.dynamics({other.state("T"): other.control("q")})
    slow = OCP("slow", T=48.0, N=24, time_unit="h")
    T, q = slow.state("T", initial=45.0), slow.control("q")
    slow.dynamics({T: q - T})
    two = OCP("two", T=24.0, N=24)
    two.dynamics({two.state("T"): two.control("q"), two.state("S"): 0 * two.u[0]})
    for ocp, said in ((store.store(), "has a cost already"), (slow, "intervals of 2; expected 1"), (two, "2 states")):
        with pytest.raises(ProblemError, match=said):
            periodic_letempc(store.tuned(), ocp)
    values = periodic_letempc(store.tuned(), other)
    assert {name: v.shape for name, v in values(3).items()}["letempc_factor"] == (25, 4)
    with pytest.raises(ProblemError, match="expected the result of tune_periodic"):
        periodic_letempc((), other)  # type: ignore[arg-type]


def test_the_result_in_words() -> None:
    text = str(store.tuned())
    assert "periodic tuning of store, 24 intervals" in text
    assert "T: in 9 intervals" in text
    assert len(text.splitlines()) < 15
