"""The integral of a cost rate over an interval uses the scheme of the dynamics: value, adjoint gradient, products.

q = h sum over steps and stages of b_i rate(X_i, u, p)
dq / d(x, u): kappa_i = (h b_i lam + h sum_j a_ji Xbar_j; h b_i), (Xbar_i; ubar_i) = F_z' kappa_i, lam = 0 at the end
H d, Gauss-Newton: (dX_i; du) by the linearised steps, then the same with f_z' kappa_i + h b_i rate_zz (dX_i; du)
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from nmpc_codegen.components.integrators.explicit.runge_kutta import LENGTH, MEANINGS, RungeKutta
from nmpc_codegen.components.integrators.tableau import ButcherTableau, combine
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, Sweep, add_notes


class Quadrature:
    """Sweeps that add the integral to a buffer ``l``, or its gradient to ``g``, which ``start`` initialises."""

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int) -> None:
        stage = problem.path
        self.rk = RungeKutta(problem, tableau, steps)
        self.x, self.u, self.p = stage.x, stage.u, stage.p
        self.nx, self.nu = stage.nx, stage.nu
        self.steps, self.stages = steps, tableau.stages
        self.f = problem.dynamics(self.x, self.u, self.p)
        self.rate = ca.SX(0) if stage.cost_rate is None else stage.cost_rate

    def value(self, name: str, doc: str, start: Call, more: tuple[Port, ...]) -> Sweep:
        """Return the sweep (x, u, p, dt, more) -> l."""
        body: list[Node] = [start, *self.rk.start()]
        step = [node for i in range(self.stages) for node in self._stage(i, Slice("Xi", self.nx))]
        q = ca.SX.sym("q")
        body.append(For("step", 0, self.steps, (*step, self.rk.update_state(), self._add_rates(q))))
        buffers = (("h", 1), ("X", self.nx), ("Xi", self.nx), ("K", self.stages * self.nx), ("L", self.stages))
        return Sweep(
            name,
            doc,
            (*self.rk.ports, *more),
            (Port("l", 1),),
            buffers,
            tuple(body),
            columns=self.rk.columns,
            meanings=MEANINGS,
            steps=self.steps,
        )

    def gradient(self, name: str, doc: str, start: Call, more: tuple[Port, ...]) -> Sweep:
        """Return the sweep (x, u, p, dt, more) -> g."""
        nx, nu, s = self.nx, self.nu, self.stages
        body: list[Node] = [start, *self.rk.start()]
        first = [node for i in range(s) for node in self._stage(i, self._point(i), rate=False)]
        body.append(For("step", 0, self.steps, (*first, self.rk.update_state())))
        body.append(Call(ca.Function("clear", [], [ca.SX.zeros(nx)]), (), (Slice("adj", nx),)))
        backward = [self._backward(i, "g") for i in reversed(range(s))]
        update = self.rk.update_adjoint("update_adjoint", Slice("adj", nx), self._bar)
        body.append(For("step", 0, self.steps, (*backward, update), down=True))
        g, adj, here = ca.SX.sym("g", nx), ca.SX.sym("adj", nx), Slice("g", nx)
        body.append(Call(ca.Function("add", [g, adj], [g + adj]), (here, Slice("adj", nx)), (here,)))
        buffers = (
            *(("h", 1), ("X", nx), ("Xs", self.steps * s * nx), ("K", s * nx)),
            *(("adj", nx), ("Xbar", s * nx)),
        )
        return Sweep(
            name,
            doc,
            (*self.rk.ports, *more),
            (Port("g", nx + nu),),
            buffers,
            tuple(body),
            columns=self.rk.columns,
            meanings=MEANINGS,
            steps=self.steps,
        )

    def product(self, name: str, doc: str, start: Call, more: tuple[Port, ...]) -> Sweep:
        """Return the sweep (x, u, p, dt, more) -> w; ``more`` ends with the direction d = (dx, du)."""
        nx, nu, s, rk = self.nx, self.nu, self.stages, self.rk
        adj, w, dx, du = Slice("adj", nx), Slice("w", nx), Slice("d", nx), Slice("d", nu, Affine(nx))
        leaf = rk.slope_and_tangent(self.f, self.x, self.u, self.p)
        body: list[Node] = [start, *rk.start(), Call(copy("copy_dx", nx), (dx,), (rk.moved,))]
        first: list[Node] = []
        for i in range(s):
            slopes = rk.slopes(i, leaf, self._point(i), self._direction(i), du)
            first += add_notes(
                [rk.point(i, self._point(i)), rk.move(i, self._direction(i)), slopes], f"stage {i + 1}", i
            )
        first += [rk.update_state(), rk.update("move", rk.moved, rk.tangent)]
        body.append(For("step", 0, self.steps, tuple(first)))
        body.append(Call(ca.Function("clear", [], [ca.SX.zeros(nx)]), (), (adj,)))
        along = {i: {"dx": self._direction(i), "du": du} for i in range(s)}
        backward = [self._backward(i, "w", along[i]) for i in reversed(range(s))]
        update = rk.update_adjoint("update_adjoint", adj, self._bar)
        body.append(For("step", 0, self.steps, (*backward, update), down=True))
        total, value = ca.SX.sym("w", nx), ca.SX.sym("adj", nx)
        body.append(Call(ca.Function("add", [total, value], [total + value]), (w, adj), (w,)))
        kept = self.steps * s * nx
        buffers = (
            *(("h", 1), ("X", nx), ("Xs", kept), ("K", s * nx), ("dX", nx), ("dXs", kept), ("dK", s * nx)),
            *(("adj", nx), ("Xbar", s * nx)),
        )
        return Sweep(
            name,
            doc,
            (*rk.ports, *more),
            (Port("w", nx + nu),),
            buffers,
            tuple(body),
            columns=self.rk.columns,
            meanings=MEANINGS,
            steps=self.steps,
        )

    def _direction(self, stage: int) -> Slice:
        return Slice("dXs", self.nx, Affine(stage * self.nx, (("step", self.stages * self.nx),)))

    def _point(self, stage: int) -> Slice:
        return Slice("Xs", self.nx, Affine(stage * self.nx, (("step", self.stages * self.nx),)))

    def _bar(self, stage: int) -> Slice:
        return Slice("Xbar", self.nx, Affine(stage * self.nx))

    def _stage(self, stage: int, point: Slice, rate: bool = True) -> list[Node]:
        """Return the statements that compute the stage point, K_i and the rate there."""
        leaf = ca.Function("f_and_rate", [self.x, self.u, self.p], [self.f, self.rate])
        outs: tuple[Slice, ...] = (self.rk.slope(stage), Slice("L", 1, Affine(stage)))
        if not rate:
            leaf, outs = ca.Function("f", [self.x, self.u, self.p], [self.f]), outs[:1]
        nodes = [self.rk.point(stage, point), Call(leaf, (point, *self.rk.up), outs)]
        return add_notes(nodes, f"stage {stage + 1}", stage)

    def _add_rates(self, q: Expression) -> Call:
        h, rates = ca.SX.sym("h"), ca.SX.sym("L", self.stages)
        b = self.rk.tableau.b
        used = [rates[i] for i, weight in enumerate(b) if weight]
        leaf = ca.Function("add_rates", [q, h, rates], [combine(q, h, used, b)])
        return Call(leaf, (Slice("l", 1), LENGTH, Slice("L", self.stages)), (Slice("l", 1),))

    def _backward(self, stage: int, target: str, direction: Mapping[str, Slice] | None = None) -> Call:
        """Return the call that computes Xbar_i and adds ubar_i to ``target``_u.

        They belong to the rate or, for a product, to its derivative along (dX_i, du).
        """
        sym, nx = ca.SX.sym, self.nx
        adj, h, g = sym("adj", nx), sym("h"), sym("g", self.nu)
        bars = {j: sym(f"Xbar{j}", nx) for j in self.rk.later(stage)}
        kappa = self.rk.adjoint_of_slope(stage, adj, h, bars)
        k, weight, rate, along = sym("k", nx), sym("weight"), self.rate, direction or {}
        moved = [sym(name, slot.size) for name, slot in along.items()]
        if moved:
            rate = ca.jtimes(rate, ca.vertcat(self.x, self.u), ca.vertcat(*moved))
        value = ca.dot(k, self.f) + weight * rate
        bar, ubar = (ca.densify(ca.gradient(value, v)) for v in (self.x, self.u))
        bar, ubar = ca.substitute([bar, ubar], [k, weight], [kappa, h * float(self.rk.tableau.b[stage])])
        inputs = [self.x, self.u, self.p, adj, h, g, *moved, *bars.values()]
        leaf = ca.Function(f"backward_{stage}", inputs, [bar, g + ubar])
        here = Slice(target, self.nu, Affine(nx))
        ins = [self._point(stage), *self.rk.up, Slice("adj", nx), LENGTH, here, *along.values(), *map(self._bar, bars)]
        return Call(leaf, tuple(ins), (self._bar(stage), here), note=f"adjoint of stage {stage + 1}")
