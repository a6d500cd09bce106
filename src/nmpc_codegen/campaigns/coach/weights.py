"""Weights are chosen by closed loops: Optuna searches for the least value of the user's own cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from nmpc_codegen.campaigns.flying.fly import Flyer, Job
from nmpc_codegen.campaigns.stated.defaults import facts_of
from nmpc_codegen.campaigns.stated.flight_statement import (
    SILENT,
    FlightStatement,
    Stated,
    Wish,
    plant_of,
    state_flights,
)
from nmpc_codegen.compiler import build
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.options import Options
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.given import is_integer
from nmpc_codegen.runtime.loops.flights import Flights

Cost = Callable[[Flights], ArrayLike]
Ranges = Mapping[str, tuple[float, float]]

#: Cost of a set of weights whose flights have no finite cost.
WORST = 1e300


@dataclass(frozen=True, eq=False)
class Tuned:
    """The weights that a search has found.

    Attributes:
        weights: {residual: weight}, for set_weight() and the statement.
        terminal_weights: the same for the terminal residual.
        value: mean cost with these weights on fresh flights, and its standard error.
        declared: mean cost with the declared weights on the same flights, and its standard error.
        study: Optuna's study with all trials.
    """

    weights: Mapping[str, float]
    terminal_weights: Mapping[str, float]
    value: tuple[float, float]
    declared: tuple[float, float]
    study: Any

    def __str__(self) -> str:
        found = ", ".join(f"{name!r}: {value:.4g}" for name, value in self.weights.items())
        end = ", ".join(f"{name!r}: {value:.4g}" for name, value in self.terminal_weights.items())
        lines = [f"weights {{{found}}}"] * bool(found) + [f"terminal weights {{{end}}}"] * bool(end)
        costs = (f"{mean:.5g} +- {error:.2g}" for mean, error in (self.value, self.declared))
        lines.append("mean cost of fresh flights: {}; with the declared weights {}".format(*costs))
        lines += ["they are no better than the declared ones"] * (self.value[0] >= self.declared[0])
        return "\n".join(lines)


def tune_weights(
    ocp: OCP,
    weights: Ranges,
    cost: Cost,
    *,
    terminal_weights: Ranges | None = None,
    options: Options | None = None,
    flights: int = 50,
    trials: int = 100,
    progress: bool = False,
    **stated: Unpack[Stated],
) -> Tuned:
    """Search for the weights with which closed loops have the least cost, where the cost is the user's own.

    All trials fly from the same starts, with the same parameters and disturbances; the result is judged on fresh
    flights.

    Args:
        ocp: the problem; its weights have to be changeable at run time, which they are by default.
        weights: {residual of the path: (lower, upper)}, 0 < lower < upper, searched on a logarithmic scale.
        cost: function that returns a cost for each recorded flight, (F,), from Flights: x (F, steps + 1, nx), u (F,
            steps, nu), violation (F, rows), ... The mean cost is minimised; a cost that is not finite is the worst.
            Flights.cost depends on the weights of the trial and must not be used.
        terminal_weights: the same for terminal residuals.
        options: options of the controller.
        flights: number of flights of a trial.
        trials: number of sets of weights, the declared ones first.
        progress: show Optuna's bar.
        stated: statement of the flights, as in campaign(); see help(Stated).

    Raises:
        ControllerError: a name, a range or a cost is wrong.
        ExtraError: Optuna is not installed.
    """
    optuna = extra("optuna", "tune_weights()")
    allowed = set(Stated.__annotations__)
    _check(weights, terminal_weights or {}, trials)
    if not set(stated) <= allowed:
        raise ControllerError(f"tune_weights: {sorted(set(stated) - allowed)}; expected {', '.join(sorted(allowed))}")
    ranges = {("", name): pair for name, pair in weights.items()}
    ranges |= {("terminal ", name): pair for name, pair in (terminal_weights or {}).items()}
    declared = _declared_weights(ocp, ranges)
    course = _Course(build(ocp, options), ocp, {**SILENT, **stated, "flights": flights}, cost)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=int(stated.get("seed", 0)) % 2**32)
    study = optuna.create_study(sampler=sampler)
    course.mean({}, fresh=False)  # a wrong cost function fails here, before the search
    study.enqueue_trial({f"{end}{name}": value for (end, name), value in declared.items()})

    def objective(trial: Any) -> float:
        chosen = {key: trial.suggest_float("".join(key), *pair, log=True) for key, pair in ranges.items()}
        return course.mean(chosen, fresh=False)[0]

    study.optimize(objective, n_trials=trials, show_progress_bar=progress)
    best = {key: float(study.best_params["".join(key)]) for key in ranges}
    of_path, of_end = ({name: best[end, name] for end, name in best if bool(end) == is_end} for is_end in (False, True))
    return Tuned(of_path, of_end, course.mean(best, fresh=True), course.mean({}, fresh=True), study)


def _check(weights: object, terminal_weights: object, trials: Any) -> None:
    """Raise ControllerError if there is nothing to search for."""
    for what, value in (("weights", weights), ("terminal_weights", terminal_weights)):
        if not isinstance(value, Mapping):
            raise ControllerError(f"{what} is {value!r:.60}; expected {{residual: (lower, upper)}}")
    if not weights and not terminal_weights:
        raise ControllerError("weights is empty; expected {residual: (lower, upper)}")
    if not is_integer(trials) or trials < 1:
        raise ControllerError(f"trials is {trials!r}; expected an integer >= 1")


def _declared_weights(ocp: OCP, ranges: Mapping[tuple[str, str], tuple[float, float]]) -> dict[tuple[str, str], float]:
    """Return the declared weights, clipped to their ranges."""
    known = {
        ("terminal " if residual.stage == "terminal" else "", name): float(residual.weight[i, i])
        for residual in ocp.residuals
        if residual.stage != "start"
        for i, name in enumerate(residual.names)
    }
    found = {}
    for (end, name), pair in ranges.items():
        good = isinstance(pair, tuple) and len(pair) == 2 and 0 < pair[0] < pair[1] < math.inf
        if (end, name) not in known or not good:
            there = ", ".join(other for at, other in known if at == end) or "none"
            raise ControllerError(
                f"{end or 'path '}weight {name!r}: {pair!r}; expected (lower, upper) with 0 < lower < upper, for a "
                f"residual; there is {there}"
            )
        found[end, name] = float(np.clip(known[end, name], *pair))
    return found


class _Course:
    """A course flies sets of weights."""

    def __init__(self, controller: Controller, ocp: OCP, wish: Wish, cost: Cost) -> None:
        self._controller, self._cost, self._plant = controller, cost, plant_of(wish)
        facts = facts_of(ocp)
        self._statements: dict[bool, FlightStatement] = {
            fresh: state_flights(controller, facts, {**wish, "seed": (wish["seed"] + fresh) % 2**64})
            for fresh in (False, True)
        }

    def mean(self, chosen: Mapping[tuple[str, str], float], fresh: bool) -> tuple[float, float]:
        """Return the mean cost of a set of weights and its standard error."""
        controller, s = self._controller.copy(), self._statements[fresh]
        for is_end, tell in ((False, controller.set_weight), (True, controller.set_terminal_weight)):
            of_kind: dict[str, ArrayLike] = {
                name: value for (end, name), value in chosen.items() if bool(end) == is_end
            }
            if of_kind:
                tell(of_kind)
        flyer = Flyer(Job(controller, self._plant, s), None)
        found = np.asarray(self._cost(flyer.simulate(s.whole_data(0, s.flights), 0, record=True)), dtype=float)
        if found.shape != (s.flights,):
            raise ControllerError(f"cost returns an array of shape {found.shape}; expected ({s.flights},)")
        if not np.isfinite(found).all():
            return WORST, math.nan
        return float(np.mean(found)), float(np.std(found) / math.sqrt(len(found)))
