"""Multiple shooting is written by hand and solved by IPOPT, without any part of the package.

A node has its state x, its control u, the control v of the previous node, the time t, and d, the time between u and v.
Controls of one block of ``hold`` are one variable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: (x, u, v, t, d) -> an expression of a node; of the end: (x, v, t).
OfNode = Callable[[Any, Any, Any, Any, float], Any]
OfEnd = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True, eq=False)
class Transcription:
    """A problem is stated in plain functions. ``rows``: (lower, expression, upper, nodes)."""

    nx: int
    nu: int
    dt: Sequence[float]
    derivative: Callable[[Any, Any, Any, Any], Any] | None  # (x, u, v, t), for RK4 in two steps
    maps: Callable[[Any, Any, Any, Any, float], dict[int, Any]]  # (x, u, v, t, dt) -> values at the next node
    cost: OfNode
    end_cost: OfEnd
    rows: Sequence[tuple[float, OfNode, float, Sequence[int]]] = ()
    end_rows: Sequence[tuple[float, OfEnd, float]] = ()
    lower: Sequence[float] = ()
    upper: Sequence[float] = ()
    hold: Sequence[Sequence[int]] = field(default_factory=tuple)  # for every control, lengths of its blocks

    def solve(
        self, x0: Any, previous: Any, time: float = 0.0, period: float | None = None, guess: Any = None
    ) -> tuple[Array, Array, float]:
        """Return (x, u, cost) from x_0, after the control ``previous``; ``period``: d at node 0, by default dt_0."""
        N = len(self.dt)
        lengths = self.hold or [(1,) * N] * self.nu
        free = [ca.MX.sym(f"u{j}", len(blocks)) for j, blocks in enumerate(lengths)]
        where = [np.repeat(np.arange(len(blocks)), blocks) for blocks in lengths]
        u = [ca.vertcat(*(free[j][int(where[j][k])] for j in range(self.nu))) for k in range(N)]
        x = [ca.MX(ca.DM(x0)), *(ca.MX.sym(f"x{k + 1}", self.nx) for k in range(N))]
        v = [ca.MX(ca.DM(previous)), *u]
        t = time + np.concatenate([[0.0], np.cumsum(self.dt)])
        d = [period or self.dt[0], *self.dt]
        g: list[Any] = []
        bounds: list[tuple[Any, Any]] = []
        cost = self.end_cost(x[N], v[N], t[N])
        for k in range(N):
            g.append(x[k + 1] - self._next(x[k], u[k], v[k], t[k], self.dt[k]))
            bounds.append((np.zeros(self.nx), np.zeros(self.nx)))
            cost = cost + self.cost(x[k], u[k], v[k], t[k], d[k])
        for low, row, high, nodes in self.rows:
            for k in nodes:
                g.append(row(x[k], u[k], v[k], t[k], d[k]))
                bounds.append(([low], [high]))
        for low, end_row, high in self.end_rows:
            g.append(end_row(x[N], v[N], t[N]))
            bounds.append(([low], [high]))
        z = ca.vertcat(*x[1:], *free)
        limits = [np.full(N * self.nx, s * np.inf) for s in (-1.0, 1.0)]
        for limit, given, s in zip(limits, (self.lower, self.upper), (-1.0, 1.0), strict=True):
            of_u = [np.full(len(b), given[j] if len(given) else s * np.inf) for j, b in enumerate(lengths)]
            limit.resize(z.numel(), refcheck=False)
            limit[N * self.nx :] = np.concatenate(of_u)
        options: Any = {
            "print_time": False,
            "ipopt": {"tol": 1e-12, "bound_relax_factor": 0.0, "print_level": 0, "max_iter": 500, "sb": "yes"},
        }
        problem: Any = {"x": z, "f": cost, "g": ca.vertcat(*g)}
        solver = ca.nlpsol("by_hand", "ipopt", problem, options)
        start = np.concatenate([np.tile(np.asarray(x0, float), N), np.zeros(z.numel() - N * self.nx)])
        if guess is not None:
            start[: N * self.nx] = np.asarray(guess)[1:].ravel()
        found = solver(
            x0=start,
            lbx=limits[0],
            ubx=limits[1],
            lbg=np.concatenate([b[0] for b in bounds]),
            ubg=np.concatenate([b[1] for b in bounds]),
        )
        if not solver.stats()["success"] and solver.stats()["return_status"] not in (
            "Search_Direction_Becomes_Too_Small",
        ):
            raise AssertionError(f"IPOPT: {solver.stats()['return_status']}")
        values = ca.Function("values", [z], [ca.horzcat(*x), ca.horzcat(*u)])(found["x"])
        return values[0].full().T, values[1].full().T, float(found["f"])

    def _next(self, x: Any, u: Any, v: Any, t: Any, dt: float) -> Any:
        h, end = dt / 2, x
        if self.derivative is not None:
            for n in range(2):
                s = t + n * h
                k1 = self.derivative(end, u, v, s)
                k2 = self.derivative(end + h / 2 * k1, u, v, s + h / 2)
                k3 = self.derivative(end + h / 2 * k2, u, v, s + h / 2)
                k4 = self.derivative(end + h * k3, u, v, s + h)
                end = end + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        parts = self.maps(x, u, v, t, dt)
        return ca.vertcat(*(parts.get(i, end[i]) for i in range(self.nx)))
