"""Products of the derivatives of one interval with vectors are computed without storing a transition matrix.

forward:  dx_next = A dx + B du:   dX_i = dx + h sum_j a_ij dK_j,  dK_i = f_x dX_i + f_u du,  dx += h sum_i b_i dK_i
adjoint:  g = [A B]' adj, the exact discrete adjoint of the scheme:
          kappa_i = h b_i adj + h sum_j a_ji Xbar_j,  (Xbar_i, ubar_i) = [f_x f_u]' kappa_i,  adj += sum_i Xbar_i

A and B are evaluated at (x, u); the stage points are computed again.
"""

from __future__ import annotations

import casadi as ca

from nmpc_codegen.components.integrators.explicit.runge_kutta import LENGTH, MEANINGS, RungeKutta
from nmpc_codegen.components.integrators.tableau import ButcherTableau
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, Sweep, add_notes

FORWARD, ADJOINT = "integrator_forward", "integrator_adjoint"
FORWARD_DOC = "dx_next = A dx + B du, where [A B] = d Phi / d(x, u)"
ADJOINT_DOC = "g = [A B]' adj, where [A B] = d Phi / d(x, u)"


class Directional:
    """A directional product consists of two sweeps of one problem, scheme and number of steps."""

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int) -> None:
        self.rk = RungeKutta(problem, tableau, steps)
        self.x, self.u, self.p = problem.path.x, problem.path.u, problem.path.p
        self.nx, self.nu = problem.nx, problem.nu
        self.steps, self.stages = steps, tableau.stages
        self.f = problem.dynamics(self.x, self.u, self.p)

    def forward(self) -> Sweep:
        """Return the sweep (x, u, p, dt, dx, du) -> dx_next."""
        rk, nx, s = self.rk, self.nx, self.stages
        point, moved, du = Slice("Xi", nx), Slice("dXi", nx), Slice("du", self.nu)
        leaf = rk.slope_and_tangent(self.f, self.x, self.u, self.p)
        body: list[Node] = [*rk.start(), Call(copy("copy_dx", nx), (Slice("dx", nx),), (rk.moved,))]
        step: list[Node] = []
        for i in range(s):
            nodes = [rk.point(i, point), rk.move(i, moved), rk.slopes(i, leaf, point, moved, du)]
            step += add_notes(nodes, f"stage {i + 1}", i)
        step += [rk.update_state(), rk.update("move", rk.moved, rk.tangent)]
        body.append(For("step", 0, self.steps, tuple(step)))
        body.append(Call(copy("copy_dx_next", nx), (rk.moved,), (Slice("dx_next", nx),)))
        buffers = (("h", 1), ("X", nx), ("Xi", nx), ("K", s * nx), ("dX", nx), ("dXi", nx), ("dK", s * nx))
        ports = (*rk.ports, Port("dx", nx), Port("du", self.nu))
        return Sweep(
            FORWARD,
            FORWARD_DOC,
            ports,
            (Port("dx_next", nx),),
            buffers,
            tuple(body),
            columns=self.rk.columns,
            meanings=MEANINGS,
            steps=self.steps,
        )

    def adjoint(self) -> Sweep:
        """Return the sweep (x, u, p, dt, adj) -> g."""
        nx, nu, s = self.nx, self.nu, self.stages
        leaf = ca.Function("f", [self.x, self.u, self.p], [self.f])
        first: list[Node] = []
        for i in range(s):
            slope = Call(leaf, (self._point(i), *self.rk.up), (self.rk.slope(i),))
            first += add_notes([self.rk.point(i, self._point(i)), slope], f"stage {i + 1}", i)
        lam, controls = Slice("lam", nx), Slice("g", nu, Affine(nx))
        body: list[Node] = [
            *self.rk.start(),
            For("step", 0, self.steps, (*first, self.rk.update_state())),
            Call(copy("copy_adj", nx), (Slice("adj", nx),), (lam,)),
            Call(ca.Function("clear", [], [ca.SX.zeros(nu)]), (), (controls,)),
        ]
        backward = [self._backward(i, lam, controls) for i in reversed(range(s))]
        update = self.rk.update_adjoint("update_adjoint", lam, self._bar)
        body.append(For("step", 0, self.steps, (*backward, update), down=True))
        body.append(Call(copy("copy_lam", nx), (lam,), (Slice("g", nx),)))
        buffers = (
            *(("h", 1), ("X", nx), ("Xs", self.steps * s * nx), ("K", s * nx)),
            *(("lam", nx), ("Xbar", s * nx)),
        )
        ports = (*self.rk.ports, Port("adj", nx))
        return Sweep(
            ADJOINT,
            ADJOINT_DOC,
            ports,
            (Port("g", nx + nu),),
            buffers,
            tuple(body),
            columns=self.rk.columns,
            meanings=MEANINGS,
            steps=self.steps,
        )

    def _point(self, stage: int) -> Slice:
        return Slice("Xs", self.nx, Affine(stage * self.nx, (("step", self.stages * self.nx),)))

    def _bar(self, stage: int) -> Slice:
        return Slice("Xbar", self.nx, Affine(stage * self.nx))

    def _backward(self, stage: int, lam: Slice, controls: Slice) -> Call:
        """Return the call that computes Xbar_i and adds ubar_i to the adjoint of the controls."""
        sym, nx = ca.SX.sym, self.nx
        adj, h, g = sym("lam", nx), sym("h"), sym("g", self.nu)
        bars = {j: sym(f"Xbar{j}", nx) for j in self.rk.later(stage)}
        kappa, k = self.rk.adjoint_of_slope(stage, adj, h, bars), sym("k", nx)
        value = ca.dot(k, self.f)
        results = [ca.densify(ca.gradient(value, v)) for v in (self.x, self.u)]
        bar, ubar = ca.substitute(results, [k], [kappa])
        inputs = [self.x, self.u, self.p, adj, h, g, *bars.values()]
        leaf = ca.Function(f"backward_{stage}", inputs, [bar, g + ubar])
        ins = [self._point(stage), *self.rk.up, lam, LENGTH, controls, *map(self._bar, bars)]
        return Call(leaf, tuple(ins), (self._bar(stage), controls), note=f"adjoint of stage {stage + 1}")
