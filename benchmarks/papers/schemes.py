"""Schemes of economic NMPC are generated controllers with closed loops.

A scheme has a cost (economic, LETEMPC, tracking) and a Hessian; it takes one step per sample, or iterates to
convergence. All have the constraints, the plant (the model) and the first plan (the optimal steady state) in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from examples import driving, evaporation
from nmpc_codegen import (
    OCP,
    Controller,
    EconomicGaussNewton,
    GaussNewton,
    Options,
    Status,
)
from nmpc_codegen.economic import Tuning, letempc_cost, letempc_terminal_cost, lqr_terminal_cost, tracking_cost
from nmpc_codegen.economic.stage import SteadyStage, steady_stage
from nmpc_codegen.frontend.classify import classify
from verification.built import build_all
from verification.routes import PURE

Array = NDArray[np.float64]

#: l = 10 x'x + 0.1 u'u of [Z20] as 1/2 w'Ww.
TRACKING = (20.0, 20.0, 0.2, 0.2)
#: Tolerance of the optimality conditions of a converged sample, relative to their terms; most iterations.
TOLERANCE, MOST = 1e-8, 30


@dataclass(frozen=True)
class Scheme:
    """A scheme is a cost and a Hessian.

    cost: "economic", "letempc", "tracking"; hessian: "exact", "tuned" (M), "identity", "least squares".
    """

    name: str
    cost: str
    hessian: str
    converged: bool = False


CONVERGED = Scheme("economic converged", "economic", "exact", converged=True)
EXACT, TUNED = Scheme("exact", "economic", "exact"), Scheme("M", "economic", "tuned")
IDENTITY = Scheme("identity", "economic", "identity")
LETEMPC, LETEMPC_CONVERGED = (
    Scheme("LETEMPC", "letempc", "tuned"),
    Scheme("LETEMPC converged", "letempc", "tuned", converged=True),
)
TRACK, TRACK_CONVERGED = (
    Scheme("tracking", "tracking", "least squares"),
    Scheme("tracking converged", "tracking", "exact", converged=True),
)


@dataclass(frozen=True, eq=False)
class Subject:
    """A subject is an example with its tuning, node functions of its economic problem, and its problem for a scheme."""

    example: ModuleType
    tuning: Tuning
    stage: SteadyStage
    make: Callable[[Scheme], OCP]

    def cost(self, x: Array, u: Array) -> float:
        """Return the economic cost of an interval."""
        w = np.concatenate([x[list(self.tuning.kept)], u])
        return float(np.asarray(self.stage.values(w)[1]).item())

    @property
    def _identity(self) -> Array | None:
        """Return the identity at node N, or None if the state there is fixed."""
        return None if self.tuning.M_f is None else np.eye(len(self.tuning.M_f))

    def options(self, scheme: Scheme) -> Options:
        """Return options of the example with the Hessian of the scheme; a sample shifts the plan by one interval."""
        hessian: Any = {
            "exact": None,
            "tuned": self.tuning.hessian(),
            "identity": EconomicGaussNewton(np.eye(len(self.tuning.M)), self._identity),
            "least squares": GaussNewton(),
        }[scheme.hessian]
        found: Options = replace(self.example.options(hessian), algorithm=replace(PURE, shift="repeat"))
        return found


@cache
def subject(name: str) -> Subject:
    """Return "evaporation", or "driving" with the lane as a parameter of every node."""
    example = {"evaporation": evaporation, "driving": driving}[name]
    tuning, stage = example.tuned(), steady_stage(classify(example.build_ocp()), example.options())
    return Subject(example, tuning, stage, partial({"evaporation": process, "driving": car}[name], tuning))


def process(t: Tuning, scheme: Scheme) -> OCP:
    """Return the OCP of the evaporation process with the cost of the scheme."""
    if scheme.cost == "economic":
        return evaporation.build_ocp()
    ocp = evaporation.process(t.problem.N, economic=False)
    ocp.subject_to(t.x_s, ocp.x, t.x_s, at="end")
    if scheme.hessian == "least squares":
        y = ca.vertcat(ocp.x, ocp.u)
        ocp.least_squares(y, weight=np.array(TRACKING), reference=[*t.x_s, *t.u_s])
    elif scheme.cost == "tracking":
        ocp.stage_cost(tracking_cost(t, ocp.x, ocp.u, TRACKING), scale_with_dt=False)
    else:
        ocp.stage_cost(letempc_cost(t, ocp.x, ocp.u), scale_with_dt=False)
    return ocp


def car(t: Tuning, scheme: Scheme) -> OCP:
    """Return the OCP of the car with the cost of the scheme.

    The middle of the lane is a parameter, so that moves can be foreseen.
    """
    ocp = driving.build_ocp(economic=False)
    lane = ocp.parameter("lane", value=0.0)
    x = ocp.x - ca.vertcat(0, lane, 0, 0, 0)
    if scheme.cost == "economic":
        end = lqr_terminal_cost(driving.build_ocp(), driving.options(), economic=True)
        dx = (x - t.x_s)[1:]
        ocp.stage_cost(driving.cost_rate(ocp.x, ocp.u, lane=lane), integrate=True)
        ocp.terminal_cost(ca.dot(ca.DM(end.slope[1:]), dx) + ca.bilin(ca.DM(end.P[1:, 1:]), dx, dx) / 2)
    else:
        ocp.stage_cost(letempc_cost(t, x, ocp.u), scale_with_dt=False)
        ocp.terminal_cost(letempc_terminal_cost(t, x))
    return ocp


@cache
def controllers(name: str, schemes: tuple[Scheme, ...]) -> dict[Scheme, Controller]:
    """Return the compiled controllers of the schemes."""
    s = subject(name)
    return dict(zip(schemes, build_all([(s.make(scheme), s.options(scheme)) for scheme in schemes]), strict=True))


#: (sample, controller, state) -> state: changes the state before a sample.
Event = Callable[[int, Controller, Array], Array]
DIVERGED = 1e6


@dataclass(frozen=True)
class Loop:
    """A loop has samples of a closed loop from x0 with intervals dt.

    ``warm``: the plan of the first sample is converged.

    ``origin``: (sample) -> offset subtracted from the state in the cost.
    """

    name: str
    x0: tuple[float, ...]
    samples: int
    dt: float
    event: Event | None = None
    origin: Callable[[int], Array | float] = field(default=lambda n: 0.0)
    warm: bool = False
    drift: tuple[float, ...] | float = 0.0

    def start(self, c: Controller) -> None:
        """Set the first plan to the optimal steady state, with the drift of cyclic states."""
        t, steps = subject(self.name).tuning, np.arange(len(c.x))[:, None]
        c.x[...], c.u[...] = t.x_s + steps * np.asarray(self.drift), t.u_s

    def cost(self, scheme: Scheme, controller: Controller) -> float:
        """Return the sum of the economic cost over the closed loop; inf if the state leaves all bounds."""
        s, c, x, total = subject(self.name), controller.copy(), np.array(self.x0), 0.0
        self.start(c)
        for n in range(self.samples):
            x = x if self.event is None else self.event(n, c, x)
            if n and scheme.converged:
                c.shift()
            converged = scheme.converged or (n == 0 and self.warm and scheme.hessian != "identity")
            u = _solution(c, x) if converged else np.array(c.step(x))
            total += s.cost(x - self.origin(n), u)
            x = np.array(c.integrate(x, u, self.dt))
            if not np.abs(x).max() <= DIVERGED:
                return np.inf
        return total

    def costs(self, schemes: Iterable[Scheme]) -> dict[str, float]:
        """Return the costs of the closed loops of all schemes by name."""
        return {scheme.name: self.cost(scheme, c) for scheme, c in controllers(self.name, tuple(schemes)).items()}


def _solution(c: Controller, x: Array) -> Array:
    """Return the first control of the solution: by full steps from the shifted plan, else by the filter."""
    before = c.x.copy(), c.u.copy(), c.lam.copy()
    found = c.solve(x, tol=TOLERANCE, max_iterations=MOST, globalization="full_step")
    if found.status != Status.OK:
        c.x[...], c.u[...], c.lam[...] = before
        found = c.solve(x, tol=TOLERANCE, max_iterations=MOST)
    return np.array(found.u[0])
