"""Schemes of economic NMPC as generated controllers, and their closed loops.

A scheme has a cost (economic, LETEMPC, tracking) and a Hessian; it takes one step per sample, or iterates to
convergence. All have the constraints, the plant and the first plan in common: the model, at the best steady state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.lib.built import build_all
from examples import driving, evaporation
from nmpc_codegen import (
    OCP,
    Controller,
    GaussNewton,
    IdentityHessian,
    Options,
    RealTimeIteration,
    Status,
)
from nmpc_codegen.economic import Tuning, letempc_cost, letempc_terminal_cost, tracking_cost
from nmpc_codegen.economic.stage import SteadyStage, steady_stage
from nmpc_codegen.frontend.classify import classify

Array = NDArray[np.float64]

#: l = 10 x'x + 0.1 u'u of [Z20] as 1/2 w'Ww.
TRACKING = (20.0, 20.0, 0.2, 0.2)
#: Optimality conditions of a converged sample, relative to the terms they sum.
TOLERANCE = 1e-8


@dataclass(frozen=True)
class Scheme:
    """cost: "economic", "letempc", "tracking"; hessian: "exact", "tuned" (M), "identity", "least squares"."""

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
    """An example with its tuning and the functions of a node of its economic problem."""

    example: ModuleType
    tuning: Tuning
    stage: SteadyStage

    def cost(self, x: Array, u: Array) -> float:
        """Economic cost of an interval."""
        w = np.concatenate([x[list(self.tuning.kept)], u])
        return float(np.asarray(self.stage.values(w)[1]).item())


@cache
def subject(name: str) -> Subject:
    """ "evaporation" or "driving"."""
    example = {"evaporation": evaporation, "driving": driving}[name]
    stage = steady_stage(classify(example.build_ocp()), example.options())
    return Subject(example, example.tuned(), stage)


@cache
def controllers(name: str, schemes: tuple[Scheme, ...]) -> dict[Scheme, Controller]:
    """The compiled controllers of the schemes."""
    found = build_all([(problem(name, scheme), options(name, scheme)) for scheme in schemes])
    return dict(zip(schemes, found, strict=True))


def problem(name: str, scheme: Scheme) -> OCP:
    """The problem of the example with the cost of the scheme."""
    s = subject(name)
    if scheme.cost == "economic":
        return s.example.build_ocp()  # type: ignore[no-any-return]
    ocp: OCP
    if name == "evaporation":
        ocp = evaporation.process(200, economic=False)
        ocp.subject_to(s.tuning.x_s, ocp.x, s.tuning.x_s, at="end")
    else:
        ocp = driving.build_ocp(economic=False)
        ocp.terminal_cost(letempc_terminal_cost(s.tuning, ocp.x))
    if scheme.hessian == "least squares":
        ocp.least_squares(ca.vertcat(ocp.x, ocp.u), weight=np.array(TRACKING), reference=[*s.tuning.x_s, *s.tuning.u_s])
    elif scheme.cost == "tracking":
        ocp.stage_cost(tracking_cost(s.tuning, ocp.x, ocp.u, TRACKING), scale_with_dt=False)
    else:
        ocp.stage_cost(letempc_cost(s.tuning, ocp.x, ocp.u), scale_with_dt=False)
    return ocp


def options(name: str, scheme: Scheme) -> Options:
    """Options of the example with the Hessian of the scheme; the plan moves by one interval per sample."""
    s = subject(name)
    hessian: Any = {
        "exact": None,
        "tuned": s.tuning.hessian(),
        "identity": IdentityHessian(),
        "least squares": GaussNewton(),
    }[scheme.hessian]
    found: Options = replace(s.example.options(hessian), algorithm=RealTimeIteration(shift="repeat"))
    return found


@dataclass(frozen=True, eq=False)
class Run:
    """cost: sum of the economic cost over the samples (inf after a state that is not finite); x (samples + 1, nx), u;
    time (samples,): prepare() and feedback(), us; failed: samples whose status is not OK."""

    cost: float
    x: Array
    u: Array
    time: Array
    failed: int


Event = Callable[[int, Controller, Array], Array]


@dataclass(frozen=True)
class Loop:
    """Samples of a closed loop from x0 with intervals dt; ``event`` sees the controller and may move the state."""

    name: str
    x0: tuple[float, ...]
    samples: int
    dt: float
    event: Event | None = None
    plan: Callable[[Controller, Tuning], None] = field(default=lambda c, t: _steady_plan(c, t))

    def run(self, controller: Controller, converged: bool) -> Run:
        """The closed loop of a controller; it ends early where the state leaves all bounds."""
        s, c, x, total, failed = subject(self.name), controller.copy(), np.array(self.x0), 0.0, 0
        self.plan(c, s.tuning)
        states, controls, times = [x], [], []
        for n in range(self.samples):
            x = x if self.event is None else self.event(n, c, x)
            u = _converged(c, x, first=n == 0) if converged else np.array(c.step(x))
            failed += int(c.status != Status.OK)
            total += s.cost(x, u)
            x = np.array(c.integrate(x, u, self.dt))
            states.append(x)
            controls.append(u)
            times.append((c.stats.prepare_ns + c.stats.feedback_ns) / 1e3)
            if not np.all(np.isfinite(x)) or np.abs(x).max() > 1e6:
                total = np.inf
                break
        return Run(total, np.array(states), np.array(controls), np.array(times), failed)

    def runs(self, schemes: Iterable[Scheme]) -> dict[str, Run]:
        """The closed loops of all schemes by name."""
        built = controllers(self.name, tuple(schemes))
        return {scheme.name: self.run(c, scheme.converged) for scheme, c in built.items()}


def _steady_plan(c: Controller, t: Tuning) -> None:
    c.x[...], c.u[...] = t.x_s, t.u_s


def _converged(c: Controller, x: Array, *, first: bool) -> Array:
    """The first control of the solution from the moved plan."""
    if not first:
        c.shift()
    return np.array(c.solve(x, tol=TOLERANCE, max_iterations=50).u[0])
