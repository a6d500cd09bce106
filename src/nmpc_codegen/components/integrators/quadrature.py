"""Integral of a cost rate over an interval, by the scheme of the dynamics: its value and, by the adjoint, its gradient.

q = h sum over steps and stages of b_i rate(X_i, u, p)
dq / d(x, u): kappa_i = (h b_i lam + h sum_j a_ji Xbar_j; h b_i), (Xbar_i; ubar_i) = F_z' kappa_i, lam = 0 at the end
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import casadi as ca

from nmpc_codegen.components.integrators.tableau import ButcherTableau, combine
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, Sweep


class Quadrature:
    """Sweeps that add the integral to a buffer ``l``, or its gradient to ``g``, which ``start`` has filled."""

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int) -> None:
        stage = problem.path
        self.x, self.u, self.p = stage.x, stage.u, stage.p
        self.nx, self.nu, self.np = stage.nx, stage.nu, problem.np
        self.tableau, self.steps, self.stages = tableau, steps, tableau.stages
        self.f = problem.dynamics(self.x, self.u, self.p)
        self.rate = ca.SX(0) if stage.cost_rate is None else stage.cost_rate
        self.length = problem.dt[0] / steps if problem.uniform else None

    def value(self, name: str, doc: str, start: Call, more: tuple[Port, ...]) -> Sweep:
        """(x, u, p, dt, more) -> l."""
        body = [start, *self._start()]
        step = [node for i in range(self.stages) for node in self._stage(i, Slice("Xi", self.nx))]
        q = ca.SX.sym("q")
        body.append(For("step", 0, self.steps, (*step, self._update(), self._add_rates(q))))
        buffers = (("h", 1), ("X", self.nx), ("Xi", self.nx), ("K", self.stages * self.nx), ("L", self.stages))
        return Sweep(name, doc, (*self._ports, *more), (Port("l", 1),), buffers, tuple(body))

    def gradient(self, name: str, doc: str, start: Call, more: tuple[Port, ...]) -> Sweep:
        """(x, u, p, dt, more) -> g."""
        nx, nu, s = self.nx, self.nu, self.stages
        body = [start, *self._start()]
        first = [node for i in range(s) for node in self._stage(i, self._point(i), rate=False)]
        body.append(For("step", 0, self.steps, (*first, self._update())))
        body.append(Call(ca.Function("clear", [], [ca.SX.zeros(nx)]), (), (Slice("adj", nx),)))
        backward = [self._backward(i) for i in reversed(range(s))]
        body.append(For("step", 0, self.steps, (*backward, self._update_adjoint()), down=True))
        g, adj, here = ca.SX.sym("g", nx), ca.SX.sym("adj", nx), Slice("g", nx)
        body.append(Call(ca.Function("add", [g, adj], [g + adj]), (here, Slice("adj", nx)), (here,)))
        buffers = (
            *(("h", 1), ("X", nx), ("Xs", self.steps * s * nx), ("K", s * nx)),
            *(("adj", nx), ("Xbar", s * nx)),
        )
        return Sweep(name, doc, (*self._ports, *more), (Port("g", nx + nu),), buffers, tuple(body))

    @property
    def _ports(self) -> tuple[Port, ...]:
        return Port("x", self.nx), Port("u", self.nu), Port("p", self.np), Port("dt", 1)

    def _start(self) -> list[Node]:
        dt, x = ca.SX.sym("dt"), ca.SX.sym("x", self.nx)
        h = dt / self.steps if self.length is None else ca.SX(self.length)
        return [
            Call(ca.Function("step_length", [dt], [h]), (Slice("dt", 1),), (Slice("h", 1),)),
            Call(ca.Function("copy", [x], [x]), (Slice("x", self.nx),), (Slice("X", self.nx),)),
        ]

    def _point(self, stage: int) -> Slice:
        return Slice("Xs", self.nx, Affine(stage * self.nx, (("step", self.stages * self.nx),)))

    def _combination(self, name: str, coefficients: Sequence[Fraction], source: Slice, target: Slice) -> Call:
        x, h = ca.SX.sym("x", self.nx), ca.SX.sym("h")
        used = [j for j, c in enumerate(coefficients) if c]
        slopes = [ca.SX.sym(f"K{j}", self.nx) for j in used]
        leaf = ca.Function(name, [x, h, *slopes], [combine(x, h, slopes, coefficients)])
        ins = (source, Slice("h", 1), *(Slice("K", self.nx, Affine(j * self.nx)) for j in used))
        return Call(leaf, ins, (target,))

    def _stage(self, stage: int, point: Slice, rate: bool = True) -> list[Node]:
        """Stage point, K_i and the rate there."""
        leaf = ca.Function("f_and_rate", [self.x, self.u, self.p], [self.f, self.rate])
        outs: tuple[Slice, ...] = (Slice("K", self.nx, Affine(stage * self.nx)), Slice("L", 1, Affine(stage)))
        if not rate:
            leaf, outs = ca.Function("f", [self.x, self.u, self.p], [self.f]), outs[:1]
        call = Call(leaf, (point, Slice("u", self.nu), Slice("p", self.np)), outs)
        return [self._combination(f"point_{stage}", self.tableau.a[stage], Slice("X", self.nx), point), call]

    def _update(self) -> Call:
        return self._combination("update", self.tableau.b, Slice("X", self.nx), Slice("X", self.nx))

    def _add_rates(self, q: Expression) -> Call:
        h, rates = ca.SX.sym("h"), ca.SX.sym("L", self.stages)
        used = [rates[i] for i, b in enumerate(self.tableau.b) if b]
        leaf = ca.Function("add_rates", [q, h, rates], [combine(q, h, used, self.tableau.b)])
        return Call(leaf, (Slice("l", 1), Slice("h", 1), Slice("L", self.stages)), (Slice("l", 1),))

    def _backward(self, stage: int) -> Call:
        """Xbar_i, and g_u += ubar_i."""
        sym, nx, b = ca.SX.sym, self.nx, self.tableau.b
        adj, h, g = sym("adj", nx), sym("h"), sym("g", self.nu)
        later = [j for j in range(stage + 1, self.stages) if self.tableau.a[j][stage]]
        bars = [sym(f"Xbar{j}", nx) for j in later]
        coefficients = (b[stage], *(self.tableau.a[j][stage] for j in later))
        kappa = combine(ca.SX.zeros(nx), h, [adj, *bars][0 if b[stage] else 1 :], coefficients)
        k, weight = sym("k", nx), sym("weight")
        value = ca.dot(k, self.f) + weight * self.rate
        bar, ubar = (ca.densify(ca.gradient(value, v)) for v in (self.x, self.u))
        bar, ubar = ca.substitute([bar, ubar], [k, weight], [kappa, h * float(b[stage])])
        leaf = ca.Function(f"backward_{stage}", [self.x, self.u, self.p, adj, h, g, *bars], [bar, g + ubar])
        here = Slice("g", self.nu, Affine(nx))
        ins = [self._point(stage), Slice("u", self.nu), Slice("p", self.np), Slice("adj", nx), Slice("h", 1), here]
        ins += [Slice("Xbar", nx, Affine(j * nx)) for j in later]
        return Call(leaf, tuple(ins), (Slice("Xbar", nx, Affine(stage * nx)), here))

    def _update_adjoint(self) -> Call:
        nx = self.nx
        adj = ca.SX.sym("adj", nx)
        bars = [ca.SX.sym(f"Xbar{i}", nx) for i in range(self.stages)]
        leaf = ca.Function("update_adjoint", [adj, *bars], [sum(bars, adj)])
        slices = [Slice("Xbar", nx, Affine(i * nx)) for i in range(self.stages)]
        return Call(leaf, (Slice("adj", nx), *slices), (Slice("adj", nx),))
