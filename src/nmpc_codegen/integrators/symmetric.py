"""Three sweeps with a symmetric third one (TSP, [Q14] algorithm 2): only the lower triangle is formed, nothing of size
nz x nz is stored per stage.

    H = sum over stages of Z_i' d2(kappa_i' F) Z_i,   Z_i = [S_i; 0 I]
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from nmpc_codegen.integrators.second_order import Builder, Local, constant, copy
from nmpc_codegen.integrators.tableau import combine
from nmpc_codegen.products import PANEL
from nmpc_codegen.sweep import Affine, Call, For, Node, Slice


class ThreeSweeps(Builder):
    """Three sweeps with a symmetric third one."""

    def body(self) -> list[Node]:
        """All nodes, from the inputs x, u, p, dt, lam to x_next, S, and what is added to g and Q."""
        nodes = self.start()
        first = [node for i in range(self.stages) for node in self.evaluate(i)]
        nodes.append(For("step", 0, self.steps, (*first, self.update())))
        if self.rows:
            nodes.append(Call(copy("copy_x", self.nx), (Slice("lam", self.nx),), (Slice("adj", self.nx),)))
            second = [
                n for i in reversed(range(self.stages)) for n in (*self.again(i, self.d.slopes), self.backward(i))
            ]
            nodes.append(For("step", 0, self.steps, (*second, self.update_adjoint()), down=True))
            nodes.append(Call(constant("clear", ca.SX.zeros(self.ld**2)), (), (Slice("H", self.ld**2),)))
        third = [node for i in range(self.stages) for node in self._third(i)]
        nodes.append(For("step", 0, self.steps, (*third, self.update_columns(), *self._accumulate())))
        nodes += self.results()
        if self.rows:
            nodes += [
                self.add_block("H", a, (j, n), (c, k, m)) for a, j, n in self.runs for c, k, m in self.runs if k <= j
            ]
        return nodes

    def _third(self, stage: int) -> list[Node]:
        nodes = self.again(stage, self.d.tape)
        if self.rows:
            nodes.append(self.curvature(stage))
        coefficients = self.tableau.a[stage]
        ins = [self.tape(stage, self.d.slopes), self.column("Sx", self.nF), Slice("h", 1)]
        ins += [self.column("Fu", len(self.forced)), self.column("E", len(self.controls)), Slice("Hs", self.d.values)]
        ins += [self.column("Ks", self.nF, j) for j, a in enumerate(coefficients) if a]
        outs = [self.column("Ks", self.nF, stage)]
        if self.rows:
            outs += [self.column("Z", len(self.d.curved_states), stage), self.column("HZ", len(self.rows), stage)]
        return [*nodes, self.columnwise(self._leaf_slope(stage), ins, outs)]

    def _leaf_slope(self, stage: int) -> Any:
        """One column of K_i' = F_x Z + [0 F_u] and of HZ = H [Z; 0 I], with the curved rows of Z."""
        d, coefficients = self.d, self.tableau.a[stage]
        tape, s, h = ca.SX.sym("t", d.slopes), ca.SX.sym("s", self.nF), ca.SX.sym("h")
        Fu, units = ca.SX.sym("Fu", len(self.forced)), ca.SX.sym("E", len(self.controls))
        H = ca.SX.sym("H", d.values)
        slopes = [ca.SX.sym(f"K{j}", self.nF) for j, c in enumerate(coefficients) if c]
        Z = combine(s, h, slopes, coefficients)[: self.nx]
        outputs = [d.Fz(tape)[:, : self.nx] @ Z + self.forcing(Fu, tape, units)]
        if self.rows:
            curved = self.full_hessian(H)[self.rows, : self.nx]
            outputs += [Z[d.curved_states], curved @ Z + self.curvature_forcing(H, units)]
        names = ["t", "s", "h", "Fu", "E", "H", *(f"K{j}" for j in range(len(slopes)))]
        arguments = [tape, s, h, Fu, units, H, *slopes]
        return ca.Function(f"slope_{stage}", arguments, outputs, names, ["Ks", "Z", "HZ"][: len(outputs)])

    def _accumulate(self) -> list[Node]:
        """H += sum_i Z_i' (HZ)_i, panels of rows up to their diagonal, and the rows of the controls."""
        states, s = len(self.d.curved_states), self.stages
        nodes: list[Node] = []
        if states:
            q, z, w = ca.SX.sym("q"), ca.SX.sym("z", s * states), ca.SX.sym("w", s * len(self.rows))
            total = q
            for stage in range(s):
                for r in range(states):
                    total += z[stage * states + r] * w[stage * len(self.rows) + r]
            leaf = ca.Function("accumulate", [q, z, w], [total], ["q", "z", "w"], ["Q"])
            ins = (self.column("Z", s * states, index="i"), self.column("HZ", s * len(self.rows)))
            for first in range(0, self.ld, PANEL):
                rows = min(PANEL, len(self.columns) - first)
                here = Slice("H", 1, Affine(0, (("i", self.ld), ("c", 1))))
                inner = For("c", 0, first + PANEL, (Call(leaf, (here, *ins), (here,), inline=True),))
                nodes.append(For("i", first, rows, (inner,)))
        for m, j in enumerate(self.d.curved_controls):
            q, w = ca.SX.sym("q"), ca.SX.sym("w", s * len(self.rows))
            total = sum((w[i * len(self.rows) + states + m] for i in range(s)), q)
            here = Slice("H", 1, Affine(self.columns.index(self.nx + j) * self.ld, (("c", 1),)))
            leaf = ca.Function(f"accumulate_{m}", [q, w], [total], ["q", "w"], ["Q"])
            nodes.append(self.columnwise(leaf, (here, self.column("HZ", s * len(self.rows))), (here,)))
        return nodes if self.rows else []

    def buffers(self) -> tuple[Local, ...]:
        """All local buffers."""
        n = self.steps * self.stages
        return (
            *self.locals(),
            *(("kappa", n * len(self.d.curved)), ("H", self.ld**2)),
            *(("Z", self.stages * len(self.d.curved_states) * self.ld), ("HZ", self.stages * len(self.rows) * self.ld)),
        )
