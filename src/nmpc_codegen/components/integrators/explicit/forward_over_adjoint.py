"""Forward over adjoint propagates the derivative of the adjoint recursion backward, without using its symmetry.

    Kbar_i' = h b_i lam' + h sum_j a_ji Xbar_j',   Xbar_i' = F_x' Kbar_i' + H_x Z_i,   lam' += sum_i Xbar_i',
    ubar' += F_u' Kbar_i' + H_u Z_i,   Z_i = [S_i; 0 I];   the result is [lam'; ubar'].

The sensitivities of all stages are stored (Quirynen et al., CDC 2014, algorithm 1).
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from nmpc_codegen.components.integrators.explicit.second_derivatives import Builder, Local, constant
from nmpc_codegen.ir.casadi_types import Function
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, add_notes


class AdjointSweep(Builder):
    """The sweep applies forward mode to the adjoint of an interval.

    ThreeSweeps gives the same result with less memory.
    """

    def body(self) -> list[Node]:
        """Return all nodes, which compute x_next and S from x, u, p, dt, lam and add to g and Q."""
        nodes = self.start()
        first = [node for i in range(self.stages) for node in (*self.evaluate(i), *self._slope(i))]
        nodes.append(For("step", 0, self.steps, (*first, self.rk.update_state(), self.update_columns())))
        nodes += self.results()
        if not self.rows:
            return nodes
        n, m = len(self.d.needed) * self.ld, len(self.controls) * self.ld
        nodes.append(Call(copy("copy_x", self.nx), (Slice("lam", self.nx),), (Slice("adj", self.nx),)))
        nodes.append(Call(constant("clear_states", ca.SX.zeros(n)), (), (Slice("adjS", n),)))
        if m:
            nodes.append(Call(constant("clear_controls", ca.SX.zeros(m)), (), (Slice("ubarS", m),)))
        second = [node for i in reversed(range(self.stages)) for node in self._second(i)]
        nodes.append(For("step", 0, self.steps, (*self.backward(), *second, self._update()), down=True))
        return [*nodes, *add_notes(self._results(), "results")]

    def _curved_column(self, stage: int) -> Slice:
        """Return column c of the curved rows of Z, stored for every stage of every step."""
        size = len(self.d.curved_states) * self.ld
        terms = (("step", self.stages * size), ("c", 1))
        return Slice("Zs", len(self.d.curved_states), Affine(stage * size, terms), self.ld)

    def _slope(self, stage: int) -> list[Node]:
        """Return the statements that compute the columns of K_i', the derivative of K_i, in the first sweep."""
        return [*self.again(stage, self.d.slopes), self.slope(stage, self.d.curved_states, self._curved_column(stage))]

    def _second(self, stage: int) -> list[Node]:
        """Return kappa_i, H_i, and the columns of Xbar_i' and ubar'."""
        needed, later = len(self.d.needed), self.rk.later(stage)
        nodes = [*self.again(stage, self.d.tape), self.curvature(stage)]
        ins = [self.tape(stage, self.d.slopes), Slice("h", 1), Slice("Hs", self.d.values), self._curved_column(stage)]
        ins += [self.column("E", len(self.controls)), self.column("adjS", needed)]
        ins += [self.column("ubarS", len(self.controls)), *(self.column("XbarS", needed, j) for j in later)]
        outs = [self.column("XbarS", needed, stage), self.column("ubarS", len(self.controls))]
        bar = Call(self._leaf_bar(stage), tuple(ins), tuple(outs), note=f"second derivatives of stage {stage + 1}")
        return [*nodes, self.columnwise(bar)]

    def _leaf_bar(self, stage: int) -> Function:
        d, sym = self.d, ca.SX.sym
        needed = d.needed
        tape, h, H = sym("t", d.slopes), sym("h"), sym("H", d.values)
        Z, units = sym("Z", len(d.curved_states)), sym("E", len(self.controls))
        adj, ubar = sym("adj", len(needed)), sym("ubar", len(self.controls))
        bars = {j: sym(f"bar{j}", len(needed)) for j in self.rk.later(stage)}
        K = ca.SX(self.nF, 1)
        K[needed] = self.rk.adjoint_of_slope(stage, adj, h, bars)
        curved = ca.SX(self.nz, 1)
        curved[self.rows] = self.full_hessian(H)[self.rows, d.curved_states] @ Z + self.curvature_forcing(H, units)
        bar = ca.densify(d.Fz(tape).T @ K + curved)
        names = ["t", "h", "H", "Z", "E", "adj", "ubar", *(f"bar{j}" for j in bars)]
        arguments = [tape, h, H, Z, units, adj, ubar, *bars.values()]
        outputs = [bar[needed], ubar + bar[self.controls]]
        return ca.Function(f"bar_{stage}", arguments, outputs, names, ["Xbar", "next"])

    def _update(self) -> For:
        """Return the loop lam' += sum_i Xbar_i'."""
        n = len(self.d.needed)
        update = self.rk.update_adjoint("update_bars", self.column("adjS", n), lambda i: self.column("XbarS", n, i))
        return self.columnwise(replace(update, note="second derivatives of the step"))

    def _results(self) -> list[Node]:
        """Return the statements Q += [lam'; ubar'], rows up to their diagonal."""
        nodes: list[Node] = []
        for a, j, n in self.runs:
            buffer = "adjS" if j < self.nx else "ubarS"
            for i in range(n):
                row = self.d.needed.index(j + i) if j < self.nx else a + i - self.state_columns
                nodes += [self.add_block(buffer, row, (j + i, 1), run) for run in self.runs if run[1] <= j + i]
        return nodes

    def buffers(self) -> tuple[Local, ...]:
        """Return all local buffers."""
        needed = len(self.d.needed) * self.ld
        return (
            *self.locals(),
            *(
                ("kappa", self.stages * len(self.d.curved)),
                ("Zs", self.steps * self.stages * len(self.d.curved_states) * self.ld),
            ),
            *(("adjS", needed), ("XbarS", self.stages * needed), ("ubarS", len(self.controls) * self.ld)),
        )
