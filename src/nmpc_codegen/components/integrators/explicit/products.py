"""Products of the Jacobians A = d Phi / dx, B = d Phi / du of one interval with vectors do not form the Jacobians.

    value:   x_next = Phi(x, u, p)
    adjoint: lam_x = A' lam, lam_u = B' lam, the exact adjoint of the scheme:
             kappa_i = h b_i lam + h sum_j a_ji Xbar_j over later stages j,  Xbar_i = f_x' kappa_i,  lam += sum_i Xbar_i
    forced:  S_next = B, one column per control, started from zero:  K_i' = f_x S_i + f_u,  S_i = S + h sum_j a_ij K_j'
    free:    S_next = A S, the same without f_u

(Thesis of 2009 on adjoint derivatives in NMPC, sections 6.2 and 6.4: equations (6.27) and (6.30) differentiated after
discretisation, so that all products agree with one another to rounding.)
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from nmpc_codegen.components.integrators.explicit.first_order import SchemeDynamics
from nmpc_codegen.components.integrators.explicit.runge_kutta import LENGTH, MEANINGS, RungeKutta
from nmpc_codegen.components.integrators.tableau import ButcherTableau, combine
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Function, nonzeros
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, Sweep, add_notes


class IntervalSweeps:
    """The four products of one problem, scheme and number of steps are written as sweeps."""

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int) -> None:
        self.rk, self.f = RungeKutta(problem, tableau, steps), SchemeDynamics(problem)
        self.nx, self.nu = problem.nx, problem.nu
        self.steps, self.stages = steps, tableau.stages

    def value(self) -> Sweep:
        """Return the sweep (x, u, p, dt) -> x_next."""
        nx, rk = self.nx, self.rk
        step = self._stages(lambda i: Slice("Xi", nx))
        body: list[Node] = [
            *rk.start(),
            For("step", 0, self.steps, (*step, rk.update_state())),
            Call(copy("copy_x", nx), (rk.state,), (Slice("x_next", nx),)),
        ]
        buffers = (("h", 1), ("X", nx), ("Xi", nx), ("K", self.stages * nx))
        return Sweep(
            "integrator_value",
            f"x_next = Phi(x, u, p): {rk.steps_over_dt}",
            rk.ports,
            (Port("x_next", nx),),
            buffers,
            tuple(body),
            columns=rk.columns,
            meanings=MEANINGS,
            steps=self.steps,
        )

    def adjoint(self) -> Sweep:
        """Return the sweep (x, u, p, dt, lam) -> lam_x, lam_u."""
        nx, nu, rk, s = self.nx, self.nu, self.rk, self.stages
        forward = self._stages(self._stage_point)
        backward = [self._backward(i) for i in reversed(range(s))]
        adj = Slice("adj", nx)
        body: list[Node] = [
            *rk.start(),
            For("step", 0, self.steps, (*forward, rk.update_state())),
            Call(copy("copy_lam", nx), (Slice("lam", nx),), (adj,)),
            Call(ca.Function("clear", [], [ca.SX.zeros(nu)]), (), (Slice("lam_u", nu),)),
            For("step", 0, self.steps, (*backward, rk.update_adjoint("update_adjoint", adj, self._bar)), down=True),
            Call(copy("copy_adj", nx), (adj,), (Slice("lam_x", nx),)),
        ]
        buffers = (
            *(("h", 1), ("X", nx), ("Xs", self.steps * s * nx), ("K", s * nx)),
            *(("adj", nx), ("Xbar", s * nx)),
        )
        return Sweep(
            "integrator_adjoint",
            f"lam_x = A' lam, lam_u = B' lam: adjoint of {rk.steps_over_dt}",
            (*rk.ports, Port("lam", nx)),
            (Port("lam_x", nx), Port("lam_u", nu)),
            buffers,
            tuple(body),
            columns=rk.columns,
            meanings=MEANINGS,
            steps=self.steps,
        )

    def columns(self, forced: bool) -> Sweep:
        """Return the sweep (x, u, p, dt) -> x_next, S_next = B, or with S as an input S_next = A S unless ``forced``.

        S and S_next are [nx][nu].
        """
        nx, nu, rk, s = self.nx, self.nu, self.rk, self.stages
        first = (
            Call(ca.Function("clear", [], [ca.SX.zeros(nx * nu)]), (), (Slice("V", nx * nu),))
            if forced
            else Call(copy("copy_S", nx * nu), (Slice("S", nx * nu),), (Slice("V", nx * nu),))
        )
        V = self._column("V")
        step = [node for i in range(s) for node in self._column_stage(i, forced)]
        update = For("c", 0, nu, (rk.update("update", V, lambda i: self._column("Ks", i)),))
        body: list[Node] = [
            *rk.start(),
            first,
            For("step", 0, self.steps, (*step, rk.update_state(), update)),
            Call(copy("copy_x", nx), (rk.state,), (Slice("x_next", nx),)),
            Call(copy("copy_V", nx * nu), (Slice("V", nx * nu),), (Slice("S_next", nx * nu),)),
        ]
        buffers = (
            *(("h", 1), ("X", nx), ("V", nx * nu), ("Xi", nx), ("K", s * nx), ("Ks", s * nx * nu)),
            *(("fx", self.f.fx.nnz()), ("Fu", nx * nu if forced else 0)),
        )
        return Sweep(
            "integrator_forced" if forced else "integrator_free",
            f"x_next = Phi(x, u, p): {rk.steps_over_dt}; "
            + ("S_next = d x_next / du" if forced else "S_next = (d x_next / dx) S"),
            (*rk.ports, *(() if forced else (Port("S", nx * nu),))),
            (Port("x_next", nx), Port("S_next", nx * nu)),
            buffers,
            tuple(body),
            columns={**rk.columns, "V": nu, "Ks": nu, "Fu": nu},
            meanings=MEANINGS,
            steps=self.steps,
        )

    # Parts -----------------------------------------------------------------------------------------------------------

    def _slope(self, stage: int) -> Slice:
        return self.rk.slope(stage)

    def _stage_point(self, stage: int) -> Slice:
        """Return the stage point of a step, kept for the backward sweep."""
        return Slice("Xs", self.nx, Affine(stage * self.nx, (("step", self.stages * self.nx),)))

    def _bar(self, stage: int) -> Slice:
        return Slice("Xbar", self.nx, Affine(stage * self.nx))

    def _column(self, buffer: str, block: int = 0) -> Slice:
        """Return the slice of column c, the counter of the loop, of matrix number ``block`` [nx][nu] in ``buffer``."""
        return Slice(buffer, self.nx, Affine(block * self.nx * self.nu, (("c", 1),)), self.nu)

    def _stages(self, point: Callable[[int], Slice]) -> list[Node]:
        """Return the statements that compute points and slopes of all stages."""
        nodes: list[Node] = []
        for i in range(self.stages):
            slope = Call(self.f.leaf_f(), (point(i), *self.rk.up), (self._slope(i),))
            nodes += add_notes([self.rk.point(i, point(i)), slope], f"stage {i + 1}", i)
        return nodes

    def _backward(self, stage: int) -> Call:
        """Return the call that computes Xbar_i = f_x' kappa_i and adds f_u' kappa_i to lam_u."""
        sym, nx, f = ca.SX.sym, self.nx, self.f
        adj, h, total = sym("adj", nx), sym("h"), sym("lam_u", self.nu)
        bars = {j: sym(f"Xbar{j}", nx) for j in self.rk.later(stage)}
        kappa, k = self.rk.adjoint_of_slope(stage, adj, h, bars), sym("k", nx)
        weighted = ca.dot(k, f.f)
        bar, ubar = (ca.densify(ca.gradient(weighted, v)) for v in (f.x, f.u))
        bar, ubar = ca.substitute([bar, ubar], [k], [kappa])
        leaf = ca.Function(f"backward_{stage}", [f.x, f.u, f.p, adj, h, total, *bars.values()], [bar, total + ubar])
        here = Slice("lam_u", self.nu)
        ins = [self._stage_point(stage), *self.rk.up, Slice("adj", nx), LENGTH, here, *map(self._bar, bars)]
        return Call(leaf, tuple(ins), (self._bar(stage), here), note=f"adjoint of stage {stage + 1}")

    def _column_stage(self, stage: int, forced: bool) -> list[Node]:
        """Return K_i, then K_i' column by column."""
        rk, f, coefficients = self.rk, self.f, self.rk.tableau.a[stage]
        point = Slice("Xi", self.nx) if any(coefficients) else rk.state
        nodes: list[Node] = [rk.point(stage, point)] if any(coefficients) else []
        outs = (self._slope(stage), Slice("fx", f.fx.nnz()), *((Slice("Fu", self.nx * self.nu),) if forced else ()))
        nodes.append(Call(self._leaf_linearize(forced), (point, *rk.up), outs))
        slopes = [self._column("Ks", j) for j, c in enumerate(coefficients) if c]
        forcing = (self._column("Fu"),) if forced else ()
        ins = (Slice("fx", f.fx.nnz()), self._column("V"), LENGTH, *forcing, *slopes)
        nodes.append(For("c", 0, self.nu, (Call(self._leaf_slope(stage, forced), ins, (self._column("Ks", stage),)),)))
        return add_notes(nodes, f"stage {stage + 1}", stage)

    def _leaf_linearize(self, forced: bool) -> Function:
        """Return the leaf of K = f, the nonzeros of f_x, and f_u row by row if it is needed."""
        f = self.f
        values = ca.vertcat(ca.SX(0, 1), *nonzeros(f.fx))
        results = [f.f, values, *([ca.densify(ca.vec(f.fu.T))] if forced else [])]
        return ca.Function("linearize_f", [f.x, f.u, f.p], results)

    def _leaf_slope(self, stage: int, forced: bool) -> Function:
        """Return the leaf of one column of K_i' = f_x (S + h sum_j a_ij K_j') (+ f_u)."""
        coefficients, f, nx = self.rk.tableau.a[stage], self.f, self.nx
        values, column, h = ca.SX.sym("fx", f.fx.nnz()), ca.SX.sym("s", nx), ca.SX.sym("h")
        forcing = [ca.SX.sym("Fu", nx)] if forced else []
        slopes = [ca.SX.sym(f"K{j}", nx) for j, c in enumerate(coefficients) if c]
        jacobian = ca.SX(f.fx.sparsity(), values) if f.fx.nnz() else ca.SX(nx, nx)
        value = sum(forcing, jacobian @ combine(column, h, slopes, coefficients))
        return ca.Function(f"slope_{stage}", [values, column, h, *forcing, *slopes], [ca.densify(value)])
