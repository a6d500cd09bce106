"""Three sweeps with a symmetric third one form only the lower triangle of the Hessian.

    H = sum over stages of Z_i' d2(kappa_i' F) Z_i,   Z_i = [S_i; 0 I]

No matrix of size nz x nz is stored per stage (Quirynen et al., CDC 2014, algorithm 2).
"""

from __future__ import annotations

import casadi as ca

from nmpc_codegen.components.integrators.explicit.second_derivatives import Builder, Local, constant
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, add_notes
from nmpc_codegen.ir.tuning import FACTORS, LONGEST_TAPE, PANEL, TAPE_PER_COMPONENT, WRITTEN_PANELS


class ThreeSweeps(Builder):
    """The three sweeps compute stage points forward, adjoints backward, then sensitivities and Hessian forward.

    If S has few curved rows, the first sweep also propagates S and stores these rows for all stages. The rest of the
    third sweep is then merged into the second, because the terms of H can be summed in any order. Tape and H of a stage
    do not depend on other stages. For tapes of medium length, those of a step are therefore evaluated in one loop over
    its stages, which compilers vectorise like the loops over columns.
    """

    @property
    def wide(self) -> bool:
        """Return True if the terms of one step, which are independent, are evaluated together."""
        return self.d.keeps_tape and self.nz < self.d.tape <= LONGEST_TAPE

    @property
    def merged(self) -> bool:
        """Return True if there are two sweeps, which store the curved rows of Z."""
        return self.d.keeps_tape and len(self.d.curved_states) * self.ld <= TAPE_PER_COMPONENT * self.nz

    @property
    def keeps_kappa(self) -> bool:
        """Return True if the adjoints of all stages are stored for the third sweep."""
        return not self.merged

    def body(self) -> list[Node]:
        """Return all nodes, which compute x_next and S from x, u, p, dt, lam and add to g and Q."""
        loops = self._two() if self.merged else self._three()
        nodes = [*self.start(), *loops, *self.results()]
        if self.rows:
            pairs = [(row, column) for row in self.runs for column in self.runs if column[1] <= row[1]]
            nodes += add_notes((self.add_block("H", a, (j, n), column) for (a, j, n), column in pairs), "results")
        return nodes

    def _two(self) -> list[Node]:
        stages = range(self.stages)
        tapes = [self.tapes()] if self.wide else []
        slopes = [self._slope(i) for i in stages]
        nodes: list[Node] = [self.loop([*self._points(), *tapes, *slopes, self.update_columns()])]
        if self.rows:
            curvatures = [self.curvatures()] if self.wide else []
            bends = [node for i in stages for node in self._bend(i)]
            nodes += [*self._clear(), self.loop([*self.backward(), *curvatures, *bends], down=True)]
        return nodes

    def _three(self) -> list[Node]:
        nodes: list[Node] = [self.loop([*self._points(), *([self.tapes()] if self.wide else [])])]
        if self.rows:
            nodes += [*self._clear(), self.loop(self.backward(), down=True)]
        third: list[Node] = [self.curvatures()] if self.rows and self.wide else []
        for i in range(self.stages):
            third += [*self.again(i, self.d.tape), self._slope(i), *(self._bend(i) if self.rows else ())]
        return [*nodes, self.loop([*third, self.update_columns()])]

    def _points(self) -> list[Node]:
        """Return the statements for stage points and slopes, and for the update of the state."""
        return [*(node for i in range(self.stages) for node in self.evaluate(i)), self.rk.update_state()]

    def _clear(self) -> list[Node]:
        """Return the calls adj = lam, H = 0."""
        size = self.ld**2
        return [
            Call(copy("copy_x", self.nx), (Slice("lam", self.nx),), (Slice("adj", self.nx),), note="adjoints"),
            Call(constant("clear", ca.SX.zeros(size)), (), (Slice("H", size),), note="adjoints"),
        ]

    def _curved_column(self, stage: int, column: tuple[tuple[str, int], ...] = (("c", 1),)) -> Slice:
        """Return a column of the curved rows of Z."""
        size = len(self.d.curved_states) * self.ld
        if not self.merged:
            return Slice("Z", len(self.d.curved_states), Affine(stage % self.group * size, column), self.ld)
        terms = (*column, ("step", self.stages * size))
        return Slice("Z", len(self.d.curved_states), Affine(stage * size, terms), self.ld)

    def _slope(self, stage: int) -> For:
        return self.slope(stage, self.d.curved_states, self._curved_column(stage))

    def _bend(self, stage: int) -> list[Node]:
        """Return the statements HZ = H [Z; 0 I], curved rows.

        A complete group of stages then adds its terms to the result.
        """
        d = self.d
        H, Z, units = ca.SX.sym("H", d.values), ca.SX.sym("Z", len(d.curved_states)), ca.SX.sym("E", len(self.controls))
        value = self.full_hessian(H)[self.rows, d.curved_states] @ Z + self.curvature_forcing(H, units)
        leaf = ca.Function("bend", [H, Z, units], [value], ["H", "Z", "E"], ["HZ"])
        ins = (self.hessian_values(stage), self._curved_column(stage), self.column("E", len(self.controls)))
        bend = self.columnwise(Call(leaf, ins, (self.column("HZ", len(self.rows), stage % self.group),)))
        first = stage - stage % self.group
        complete = stage + 1 == min(first + self.group, self.stages)
        own = () if self.wide else (self.curvature(stage),)
        nodes = [*own, *add_notes([bend], f"curvature of stage {stage + 1}")]
        return [*nodes, *(add_notes(self._accumulate(range(first, stage + 1)), "Hessian") if complete else ())]

    @property
    def group(self) -> int:
        """Return the number of stages whose terms are summed together: their factors must fit into registers."""
        return max(1, min(self.stages, FACTORS // max(1, len(self.d.curved_states))))

    def _accumulate(self, stages: range) -> list[Node]:
        """Return H += sum_i Z_i' (HZ)_i, rows in panels of PANEL columns up to the diagonal, then control rows."""
        states, n = len(self.d.curved_states), len(stages)
        nodes: list[Node] = []
        if states:
            q, w = ca.SX.sym("q"), ca.SX.sym("w", n * len(self.rows))
            z = [ca.SX.sym(f"z{i}", states) for i in range(n)]
            total = sum((ca.dot(z[i], w[i * len(self.rows) : i * len(self.rows) + states]) for i in range(n)), q)
            leaf = ca.Function(f"accumulate_{n}", [q, w, *z], [total])
            panels = self.ld // PANEL
            for first in range(panels) if panels <= WRITTEN_PANELS else ():
                here = Slice("H", 1, Affine(0, (("i", self.ld), ("c", 1))))
                Z = [self._curved_column(i, (("i", 1),)) for i in stages]
                row = Call(leaf, (here, self.column("HZ", n * len(self.rows)), *Z), (here,), inline=True)
                rows = min(PANEL, len(self.columns) - PANEL * first)
                nodes.append(For("i", PANEL * first, rows, (For("c", 0, PANEL * (first + 1), (row,)),)))
            if panels > WRITTEN_PANELS:
                here = Slice("H", 1, Affine(0, (("i", PANEL * self.ld), ("j", self.ld), ("b", PANEL), ("c", 1))))
                HZ = Slice("HZ", n * len(self.rows), Affine(0, (("b", PANEL), ("c", 1))), self.ld)
                Z = [self._curved_column(i, (("i", PANEL), ("j", 1))) for i in stages]
                row = Call(leaf, (here, HZ, *Z), (here,), inline=True)
                blocks = For("b", 0, Affine(1, (("i", 1),)), (For("c", 0, PANEL, (row,)),))
                nodes.append(For("i", 0, panels, (For("j", 0, PANEL, (blocks,)),)))
        for m, j in enumerate(self.d.curved_controls):
            here = Slice("H", 1, Affine(self.columns.index(self.nx + j) * self.ld, (("c", 1),)))
            terms = [Slice("HZ", 1, Affine((i * len(self.rows) + states + m) * self.ld, (("c", 1),))) for i in range(n)]
            symbols = [ca.SX.sym(f"a{i}") for i in range(n + 1)]
            leaf = ca.Function(f"sum_{n}", symbols, [sum(symbols[1:], symbols[0])])
            nodes.append(self.columnwise(Call(leaf, (here, *terms), (here,))))
        return nodes

    def buffers(self) -> tuple[Local, ...]:
        """Return all local buffers."""
        n = self.steps * self.stages
        return (
            *self.locals(),
            *(("kappa", (n if self.keeps_kappa else self.stages) * len(self.d.curved)), ("H", self.ld**2)),
            *(
                ("Z", (n if self.merged else self.group) * len(self.d.curved_states) * self.ld),
                ("HZ", self.group * len(self.rows) * self.ld),
            ),
        )
