"""Random test cases are drawn: a problem, and the closed loops that are simulated with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from nmpc_codegen import OCP

Array = np.ndarray
#: Steps of RK4 per sample of the plant.
FINE = 20
#: Samples between changes of the set point, and set points of a loop.
HELD, POINTS = 25, 3
#: Standard deviation of the noise, and error of the gain of the plant, of loops that have them.
NOISE, GAIN = 2e-3, 0.15


@dataclass(frozen=True)
class Plant:
    """A plant is x' = f(x, u), its names, and the data of its loops.

    ``start`` and ``points``: lower and upper ends from which starts, and set points of the tracked states, are drawn;
    ``tracked``: their indices; ``controls``: bounds; ``limits``: state -> bounds that count; ``sizes``: of the states;
    ``cost``: an economic cost (x, u) instead of tracking.
    """

    name: str
    states: tuple[str, ...]
    controls: dict[str, tuple[float, float]]
    model: Callable[..., list[ca.SX]]
    horizon: float
    start: tuple[tuple[float, float], ...]
    points: tuple[tuple[float, float], ...]
    tracked: tuple[int, ...]
    sizes: tuple[float, ...]
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    cost: Callable[[ca.SX, ca.SX], ca.SX] | None = None
    intervals: int = 20


@dataclass(frozen=True, eq=False)
class Drawn:
    """A drawn problem is a plant with weights, and the seed of its loops."""

    plant: Plant
    weight: float
    first: float
    seed: int

    @property
    def name(self) -> str:
        return f"{self.plant.name}_{self.seed}"

    @property
    def dt(self) -> float:
        return self.plant.horizon / self.plant.intervals

    def ocp(self) -> OCP:
        """Return the OCP as a user writes it; controls have their first values as references."""
        p = self.plant
        ocp = OCP(p.name, T=p.horizon, N=p.intervals)
        x = [ocp.state(name, initial=float(np.mean(range_))) for name, range_ in zip(p.states, p.start, strict=True)]
        u = [ocp.control(name) for name in p.controls]
        X, U = ca.vertcat(*x), ca.vertcat(*u)
        ocp.dynamics(ca.vertcat(*p.model(X, U)))
        for symbol, (lower, upper), name in zip(u, p.controls.values(), p.controls, strict=True):
            ocp.subject_to(lower, symbol, upper, name=name)
            at = lower + self.first * (upper - lower)
            if p.cost is None:
                ocp.least_squares(symbol, weight=self.weight / (upper - lower) ** 2, reference=at, names=[f"to_{name}"])
        if p.cost is None:
            for i in p.tracked:
                ocp.least_squares(x[i], weight=1 / p.sizes[i] ** 2, names=[p.states[i]])
                ocp.terminal_least_squares(x[i], weight=10 / p.sizes[i] ** 2, names=[f"{p.states[i]}_end"])
        else:
            ocp.stage_cost(p.cost(X, U), integrate=True)
        for name, (lower, upper) in p.limits.items():
            ocp.subject_to(lower, x[p.states.index(name)], upper, name=f"limit_{name}")
        return ocp

    def stage(self) -> ca.Function:
        """Return the simulated cost of a sample (x, u, point)."""
        p = self.plant
        x, u, point = ca.SX.sym("x", len(p.states)), ca.SX.sym("u", len(p.controls)), ca.SX.sym("r", len(p.tracked))
        if p.cost is not None:
            return ca.Function("stage", [x, u, point], [p.cost(x, u)])
        value = sum((x[i] - point[n]) ** 2 / p.sizes[i] ** 2 for n, i in enumerate(p.tracked))
        for j, (lower, upper) in enumerate(p.controls.values()):
            value += self.weight * ((u[j] - lower) / (upper - lower) - self.first) ** 2
        return ca.Function("stage", [x, u, point], [value])

    def step(self) -> ca.Function:
        """Return the plant over a sample, (x, u) -> x_next, by fine steps."""
        p = self.plant
        x, u = ca.SX.sym("x", len(p.states)), ca.SX.sym("u", len(p.controls))
        f, h = ca.Function("f", [x, u], [ca.vertcat(*p.model(x, u))]), self.dt / FINE
        k1 = f(x, u)
        k2 = f(x + h / 2 * k1, u)
        k3 = f(x + h / 2 * k2, u)
        k4 = f(x + h * k3, u)
        one = ca.Function("one", [x, u], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
        ends = one.mapaccum(FINE)(x, ca.repmat(u, 1, FINE))
        return ca.Function("plant", [x, u], [ends[:, -1]])
