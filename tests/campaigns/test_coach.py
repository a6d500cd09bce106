"""Options and weights that are chosen by closed loops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import nmpc_codegen
from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    ControllerError,
    EconomicGaussNewton,
    Euler,
    ExactHessian,
    ExplicitRungeKutta,
    Flights,
    GaussNewton,
    ImplicitRungeKutta,
    NoCondensing,
    Online,
    OptionError,
    Options,
    Project,
    RealTimeIteration,
)
from nmpc_codegen.campaigns import Box, campaign, tune_weights
from nmpc_codegen.campaigns.coach import candidates
from nmpc_codegen.campaigns.coach.candidates import build_candidates, build_plant, propose
from nmpc_codegen.campaigns.coach.spelling import spell_options
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.horizon import with_horizon
from nmpc_codegen.runtime.build import load
from tests.campaigns.problems import cart, point
from verification.routes import PURE
from verification.strangers.problems import known

SPELLED: tuple[tuple[Options, str], ...] = (
    (Options(), "Options()"),
    (Options(ExplicitRungeKutta(RK4, steps=4)), "Options(integrator=ExplicitRungeKutta(steps=4))"),
    (
        Options(hessian=ExactHessian(regularization=Project(level="stage"))),
        "Options(hessian=ExactHessian(regularization=Project(level='stage')))",
    ),
    (
        Options(
            algorithm=RealTimeIteration(iterations=1, shift=None), precision="single", online=Online(weight="fixed")
        ),
        "Options(algorithm=RealTimeIteration(shift=None, iterations=1), online=Online(weight='fixed'), "
        "precision='single')",
    ),
    (Options(ImplicitRungeKutta(nmpc_codegen.SDIRK3, steps=2)), ""),
    (Options(condensing=NoCondensing()), "Options(condensing=NoCondensing())"),
    (Options(algorithm=AugmentedLagrangian()), "Options(algorithm=AugmentedLagrangian())"),
)


@pytest.mark.parametrize(("options", "text"), SPELLED, ids=str)
def test_options_are_spelled_as_python(options: Options, text: str) -> None:
    """What is printed makes the same options."""
    found = spell_options(options)
    assert not text or found == text
    assert eval(found, vars(nmpc_codegen) | {n: getattr(nmpc_codegen, n) for n in nmpc_codegen.__all__}) == options


def test_matrices_are_spelled() -> None:
    M = np.diag([1.0, 2.0, 3.0])
    stated = EconomicGaussNewton(M=M, M_f=np.eye(2), steady_state=([1.0, 2.0], [0.5]))
    assert eval(spell_options(stated), vars(nmpc_codegen) | {"EconomicGaussNewton": EconomicGaussNewton}) == stated


def test_candidates_are_few_and_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    """None is proposed that the problem refuses, or that is the same code."""
    monkeypatch.setattr(candidates, "load", lambda files, name, profile: load(files, name, "test"))
    found = build_candidates(cart(), propose(cart(), Options()))
    changes = [c.change for c in found]
    assert changes[0] == "default"
    assert {"hessian=ExactHessian()", "shift=None", "iterations=30", "steps=4", "N = 16"} <= set(changes)
    assert 6 <= len(changes) <= 14
    assert len({c.controller._package.fingerprint for c in found}) == len(found)
    assert [c.intervals for c in found if c.change == "N = 16"] == [16]
    plant = build_plant(cart(), found)
    assert plant is not None
    assert plant.description.options["integrator.steps"] == 8
    linear = [c.change for c in build_candidates(cart(rate=True), propose(cart(rate=True), Options()))]
    assert not [change for change in linear if change.startswith("steps=")]  # no other plant knows the control before


def test_a_problem_over_another_horizon() -> None:
    long = with_horizon(point(), 8)
    assert (long.N, long.dt) == (8, (0.25,) * 8)
    assert point().N == 4
    held = OCP("held", T=1.0, N=4)
    x, u = held.state("x"), held.control("u", hold=[2, 2])
    held.dynamics({x: u})
    uneven = OCP("uneven", intervals=[0.1, 0.2])
    for ocp in (held, uneven):
        with pytest.raises(ProblemError):
            with_horizon(ocp, 3)


def test_the_better_options_are_chosen() -> None:
    """The pure scheme, which loses most flights of the trailer, beside the defaults; its worst flights replay."""
    s = known("trailer")
    gust = np.zeros((s.samples, len(s.states)))
    gust[s.kick[0]] = s.kick[1]
    words: dict[str, Any] = {"starts": Box(*map(np.asarray, s.start)), "added": gust, "steps": s.samples}
    pure = replace(s.options(), algorithm=replace(PURE, tolerance=0.1))
    found = campaign(s.ocp(), 60, [pure, s.options()], **words)
    assert [e.flights for e in found.entries] == [60, 60]
    assert found.default.share > 0.4
    assert not found.result.lost.any()
    assert found.options == s.options()
    assert found.reason == f"beside options[0]: it loses 0 instead of {found.default.lost.sum()} flights"
    assert f"chosen: {found.line}" in str(found)
    np.testing.assert_array_equal(found.default.flown.start, found.result.flown.start)
    assert found.result.job.statement.seed == 1  # fresh flights
    for number in found.default.worst(3):
        log = found.default.replay(number)
        np.testing.assert_array_equal(log.x[-1], found.default.flown.last[number])
        assert np.abs(log.x[1:, 3]).max() > 0.9


@pytest.mark.slow
def test_the_coach_chooses_among_candidates() -> None:
    """Half of them go on with twice as many flights, the default with all."""
    found = campaign(point(), 160, "candidates", progress=False)
    assert found.entries[0].change == "default"
    assert found.entries[0].flights == 160
    assert {e.flights for e in found.entries} <= {20, 40, 80, 160}
    assert sum(e.verdict for e in found.entries) in (2, 3)
    assert found.default.share == 0
    assert abs(found.entries[0].cost) == 0


def test_options_that_cannot_be_compared() -> None:
    """Those that the problem refuses are named; those that integrate differently need one plant."""
    ocp = OCP("general", T=1.0, N=4)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.stage_cost(ca.cos(x) + u**2)
    with pytest.raises(OptionError, match=r"options\[1\]: "):
        campaign(ocp, 10, [Options(), Options(hessian=GaussNewton())])
    with pytest.raises(OptionError, match="give plant="):
        campaign(point(), 10, [Options(), Options(ImplicitRungeKutta())])
    euler = Options(ExplicitRungeKutta(Euler, steps=4))
    found = build_candidates(point(), iter([("a", euler, 4), ("b", Options(), 4)]), given=True)
    plant = build_plant(point(), found)
    assert plant is not None
    assert plant.description.options["integrator.steps"] == 8
    assert plant.description.options["integrator.tableau.name"] == "RK4"
    starts = np.linspace(-1, 1, 30)[:, None]
    given = campaign(
        point(), options=[Options(), Options(algorithm=RealTimeIteration(iterations=1))], starts=starts, steps=5
    )
    assert [e.flights for e in given.entries] == [30, 30]


@pytest.mark.parametrize("options", ["best", [], [1], 3])
def test_options_that_are_none(options: Any) -> None:
    with pytest.raises(OptionError, match="expected Options, a list of them, or 'candidates'"):
        campaign(point(), 10, options)


def settle(flights: Flights) -> Any:
    """Time above 0.1, and effort: what the user wants, not what the controller minimises."""
    assert flights.x is not None
    assert flights.u is not None
    return np.sum(np.abs(flights.x[:, :, 0]) > 0.1, axis=1) + 0.5 * np.sum(flights.u[:, :, 0] ** 2, axis=1)


def test_weights_are_tuned() -> None:
    """The weight of the control, which is far too large, becomes less; the mean cost on fresh flights, summed here."""
    pytest.importorskip("optuna")
    ocp = OCP("slow", T=1.0, N=5)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), [1.0, 100.0], names=["x", "u"])
    ocp.subject_to(-1, u, 1)
    found = tune_weights(ocp, {"u": (1e-3, 100.0)}, settle, trials=12, flights=20, steps=40, seed=2)
    assert found.weights["u"] < 10
    assert found.value[0] < 0.7 * found.declared[0]
    assert found.study.trials[0].params == {"u": 100.0}
    other = OCP("slow", T=1.0, N=5)
    x, u = other.state("x", initial=1.0), other.control("u")
    other.dynamics({x: u})
    other.least_squares(ca.vertcat(x, u), [1.0, found.weights["u"]], names=["x", "u"])
    other.subject_to(-1, u, 1)
    result = campaign(other, 20, steps=40, seed=3)
    costs = [float(settle(result._with_samples(i))[0]) for i in range(20)]
    assert np.mean(costs) == pytest.approx(found.value[0], rel=1e-6)
    assert "weights {'u': " in str(found)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ({"weights": {"q": (1, 2)}}, "weight 'q'"),
        ({"weights": {"x": (2, 1)}}, "0 < lower < upper"),
        ({"weights": {"x": (1, 2)}, "flight": 1}, "flight"),
        ({"weights": {}}, "weights is empty"),
        ({"weights": ["x"]}, "weights is"),
        ({"weights": {"x": (1, 2)}, "trials": 2.5}, "trials is 2.5"),
        ({"weights": {"x": (1, 2)}, "cost": lambda flights: 1.0}, "shape"),
        ({"weights": {"x": (1, 2)}, "cost": lambda flights: np.zeros(3)}, "shape"),
    ],
)
def test_wrong_arguments_of_a_search(words: dict[str, Any], text: str) -> None:
    pytest.importorskip("optuna")
    with pytest.raises(ControllerError, match=text):
        tune_weights(point(), **{"cost": settle, "trials": 1, "flights": 2, **words})
