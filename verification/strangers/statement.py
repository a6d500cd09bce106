"""A stranger is an optimal control problem with a closed loop, stated independently of the product.

min sum_{k<N} 1/2 |residual(x_k, u_k)|_W^2 + dt rate(x_k, u_k) + 1/2 |end_residual(x_N)|_P^2 + end_cost(x_N)
x_{k+1} = RK4 of model(x, u) over dt = T / N in ``steps`` steps
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options

Array = np.ndarray
Function = Callable[[Any, Any], Any]  # of the vectors x and u


@dataclass(frozen=True, eq=False)
class Limit:
    """A limit is a row lower <= value(x, u) <= upper at nodes of the path, or of x at the end.

    ``scale``: a violation of this size counts as large.
    """

    name: str
    value: Function
    lower: float = -np.inf
    upper: float = np.inf
    scale: float = 1.0
    soft: tuple[float, float] | None = None
    at: str = "path"


@dataclass(frozen=True, eq=False)
class Stranger:
    """A stranger is stated by functions, bounds and the data of its loop.

    ``start``: the box of initial states; ``free``: components of the start that are only guesses; ``samples``: samples
    of the closed loop, 0 if the problem is only solved; ``kick``: (sample, addition to the state after it);
    ``distance``: distance of a state from the goal, which is reached within ``reach``.
    """

    name: str
    family: str
    T: float
    N: int
    states: Sequence[str]
    controls: Mapping[str, tuple[float, float]]
    model: Function
    start: tuple[Sequence[float], Sequence[float]]
    samples: int = 0
    kick: tuple[int, Sequence[float]] = (0, ())
    free: Sequence[int] = ()
    residual: Function | None = None
    weight: Sequence[float] = ()
    end_residual: Callable[[Any], Any] | None = None
    end_weight: Sequence[float] = ()
    rate: Function | None = None
    end_cost: Callable[[Any], Any] | None = None
    limits: Sequence[Limit] = ()
    distance: Callable[[Array], float] | None = field(default=None, repr=False)
    reach: float = 0.0
    steps: int = 2

    @property
    def dt(self) -> float:
        """Return the length of an interval, which is the time between samples."""
        return self.T / self.N

    def initial(self, number: int) -> Array:
        """Return the initial state (nx,) of the loop with this number."""
        random = np.random.default_rng([40, number])
        return random.uniform(*map(np.asarray, self.start))

    def flights(self, numbers: Sequence[int], nominal: bool = False) -> dict[str, Any]:
        """Return arguments of campaign() for the loops with these numbers, without their kicks if ``nominal``."""
        added = np.zeros((self.samples, len(self.states)))
        if not nominal:
            added[self.kick[0]] = self.kick[1]
        starts = np.array([self.initial(number) for number in numbers])
        return {"starts": starts, "added": added, "steps": self.samples, "parameters": {}, "known": {}}

    def options(self) -> Options:
        """Return the options that a user has to state: the number of integration steps."""
        return Options(ExplicitRungeKutta(RK4, steps=self.steps))

    def ocp(self) -> OCP:
        """Return the OCP as a user of the product writes it."""
        ocp = OCP(self.name, T=self.T, N=self.N)
        middle = np.mean(self.start, axis=0)
        x = [ocp.state(name, initial=float(value)) for name, value in zip(self.states, middle, strict=True)]
        u = [ocp.control(name) for name in self.controls]
        X, U = ca.vertcat(*x), ca.vertcat(*u)
        ocp.dynamics(self.model(X, U))
        for i in self.free:
            ocp.free_initial(x[i])
        if self.residual is not None:
            ocp.least_squares(self.residual(X, U), weight=list(self.weight))
        if self.end_residual is not None:
            ocp.terminal_least_squares(self.end_residual(X), weight=list(self.end_weight))
        if self.rate is not None:
            ocp.stage_cost(self.rate(X, U))
        if self.end_cost is not None:
            ocp.terminal_cost(self.end_cost(X))
        for control, (lower, upper) in zip(u, self.controls.values(), strict=True):
            ocp.subject_to(lower, control, upper)
        for limit in self.limits:
            ocp.subject_to(limit.lower, limit.value(X, U), limit.upper, soft=limit.soft, at=limit.at, name=limit.name)
        return ocp
