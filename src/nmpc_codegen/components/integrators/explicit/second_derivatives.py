"""The schemes for second-order sensitivities of explicit Runge-Kutta methods share slices, leaves and results.

    H = d2 (lam' Phi + integral of the cost rate) / d(x, u)^2

They add H and the gradient to buffers Q (nz x nz, lower triangle) and g (nz), which the cost of the node has
initialised, and also compute x_next and S = d x_next / d(x, u). Stage i of a step has the adjoint kappa_i = h b_i lam +
h sum_j a_ji Xbar_j, Xbar_i = F_x' kappa_i, and each step performs lam += sum_i Xbar_i. Columns of S that depend only on
time are written in closed form; the others are stored packed, in rows whose length is a multiple of PANEL.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import casadi as ca

from nmpc_codegen.components.integrators.explicit.derivatives import IntervalDerivatives
from nmpc_codegen.components.integrators.explicit.runge_kutta import LENGTH, RungeKutta
from nmpc_codegen.components.integrators.tableau import ButcherTableau, combine
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.ir.kernel import Port, lift
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, add_notes
from nmpc_codegen.ir.tuning import PANEL

Local = tuple[str, int]


class Builder:
    """The builder has the slices and leaves that both schemes share."""

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int) -> None:
        self.d = d = IntervalDerivatives(problem)
        self.rk = RungeKutta(problem, tableau, steps)
        self._h = ca.SX.sym("h")
        self.tableau, self.steps, self.stages = tableau, steps, tableau.stages
        self.nx, self.nu, self.nz, self.nF = d.nx, d.nu, d.nz, d.nF
        self.columns = [j for j in range(d.nz) if not d.depends_on_time_alone(j)]
        self.state_columns = sum(j < d.nx for j in self.columns)
        self.controls = self.columns[self.state_columns :]
        self.ld = -(-len(self.columns) // PANEL) * PANEL
        self.rows = [*d.curved_states, *(d.nx + j for j in d.curved_controls)]  # of H
        self.forced = sorted({i for i, j in d.jacobian if j >= d.nx})  # rows of F with controls
        kernel = lift(d.leaf_hessian(), "h", "", self._hessian_ports(), [Port("H", d.values)])
        reads = {i.args[0] for i in kernel.instructions if i.opcode == ca.OP_INPUT}
        self.keeps_points = not d.keeps_tape or 0 in reads

    def _hessian_ports(self) -> list[Port]:
        d = self.d
        sizes = (("x", d.nx), ("u", d.nu), ("p", d.np), ("t", d.tape), ("kappa", len(d.curved)))
        return [Port(name, size) for name, size in sizes]

    # Slices ----------------------------------------------------------------------------------------------------------

    @property
    def wide(self) -> bool:
        """Return True if the stages of a step are interleaved in memory, so that tapes and curvatures vectorise."""
        return False

    def stage_slice(self, buffer: str, stage: int, size: int, kept: bool = True, length: int | None = None) -> Slice:
        """Return the data of one stage, in a buffer over all steps if ``kept``, else in a buffer that is reused."""
        if self.wide:
            offset = Affine(stage, (("step", self.stages * size),) if kept else ())
            return Slice(buffer, size if length is None else length, offset, self.stages)
        if not kept:
            return Slice(buffer, length or size)
        return Slice(buffer, length or size, Affine(stage * size, (("step", self.stages * size),)))

    def point(self, stage: int) -> Slice:
        """Return the stage point."""
        return self.stage_slice("Xs", stage, self.nx, self.keeps_points)

    def tape(self, stage: int, length: int | None = None) -> Slice:
        """Return the tape of a stage."""
        return self.stage_slice("tape", stage, self.d.tape, self.d.keeps_tape, length)

    @property
    def keeps_kappa(self) -> bool:
        """Return True if the adjoints of all stages are stored, because a later sweep uses them."""
        return False

    def kappa(self, stage: int) -> Slice:
        """Return the adjoints of the curved rows of a stage."""
        size = len(self.d.curved)
        if self.wide:
            return self.stage_slice("kappa", stage, size, self.keeps_kappa)
        terms = (("step", self.stages * size),) if self.keeps_kappa else ()
        return Slice("kappa", size, Affine(stage * size, terms))

    def column(self, buffer: str, rows: int, block: int = 0, index: str = "c") -> Slice:
        """Return column ``index`` of a matrix of packed columns; ``block`` selects a matrix in the buffer."""
        return Slice(buffer, rows, Affine(block * rows * self.ld, ((index, 1),)), self.ld)

    def columnwise(self, call: Call) -> For:
        """Return a loop over the packed columns."""
        return For("c", 0, self.ld, (replace(call, inline=True),))

    def locals(self) -> tuple[Local, ...]:
        """Return the buffers that both schemes use."""
        n, d, s = self.steps * self.stages, self.d, self.stages
        once, points = s if self.wide else 1, self.nx if self.wide else 0
        return (
            *(("h", 1), ("X", self.nx), ("Xi", points), ("K", s * self.nx)),
            *(("Xs", (n if self.keeps_points else once) * self.nx), ("tape", (n if d.keeps_tape else 1) * d.tape)),
            *(("adj", self.nx), ("Xbar", s * self.nx), ("Hs", once * d.values)),
            *(("m", len(d.functions) if self.wide else 0), ("M", s * len(d.functions))),
            *(("Sx", self.nF * self.ld), ("Ks", s * self.nF * self.ld)),
            *(("Fu", len(self.forced) * self.ld), ("E", len(self.controls) * self.ld)),
        )

    # Leaves ----------------------------------------------------------------------------------------------------------

    def leaf_backward(self, stage: int) -> Function:
        """Return the leaf of kappa_i of the curved rows and Xbar_i = F_x' kappa_i.

        Kappa of an integrated cost is h b_i.
        """
        d, h, adj = self.d, ca.SX.sym("h"), ca.SX.sym("adj", self.nx)
        tape = ca.SX.sym("t", d.slopes)
        bars = {j: ca.SX.sym(f"Xbar{j}", self.nx) for j in self.rk.later(stage)}
        kappa = self.rk.adjoint_of_slope(stage, adj, h, bars)
        if self.nF > self.nx:
            kappa = ca.vertcat(kappa, h * float(self.tableau.b[stage]))
        bar = d.Fz(tape)[:, : self.nx].T @ kappa
        wanted = ca.vertcat(ca.SX(0, 1), *(kappa[i] for i in d.curved))
        names = ["adj", "h", "t", *(f"Xbar{j}" for j in bars)]
        return ca.Function(f"backward_{stage}", [adj, h, tape, *bars.values()], [wanted, bar], names, ["kappa", "Xbar"])

    @property
    def forcing_varies(self) -> bool:
        """Return True if F_u depends on the stage point."""
        return any(j >= self.nx and not c for (_, j), c in zip(self.d.jacobian, self.d.constants, strict=True))

    def linear_forcing(self) -> Expression:
        """Return the constant entries of [0 F_u], in the rows ``forced`` and the packed columns."""
        rows = ca.SX.zeros(len(self.forced), self.ld)
        for (i, j), constant, value in zip(self.d.jacobian, self.d.constants, self.d.Fz_values, strict=True):
            if j in self.controls and constant:
                rows[self.forced.index(i), self.columns.index(j)] = value
        return ca.vec(rows.T)

    def forcing(self, Fu: Expression, tape: Expression, units: Expression) -> Expression:
        """Return the statements for one column of [0 F_u], with constants from a table and unit rows of controls."""
        column = ca.SX(self.nF, 1)
        for n, i in enumerate(self.forced):
            column[i] = Fu[n]
        matrix = self.d.Fz(tape)
        varying: dict[int, dict[str, tuple[Expression, Expression]]] = {}
        for (i, j), constant in zip(self.d.jacobian, self.d.constants, strict=True):
            if j >= self.nx and not constant:
                key = str(matrix[i, j])
                value, unit = varying.setdefault(i, {}).get(key, (matrix[i, j], ca.SX(0)))
                varying[i][key] = (value, unit + units[self.controls.index(j)])
        for i, terms in varying.items():
            column[i] += sum((value * unit for value, unit in terms.values()), ca.SX(0))
        return column

    def curvature_forcing(self, H: Expression, units: Expression) -> Expression:
        """Return the statements for one column of [0 H_u], in the rows of H."""
        terms: dict[tuple[int, int], Expression] = {}
        for (r, c), n in self.d.hessian.items():
            for row, j in {(r, c), (c, r)}:
                if j >= self.nx:
                    at = (self.rows.index(row), n)
                    terms[at] = terms.get(at, 0) + units[self.controls.index(j)]
        column = ca.SX(len(self.rows), 1)
        for (row, n), unit in terms.items():
            column[row] += H[n] * unit
        return column

    def full_hessian(self, values: Expression) -> Expression:
        """Return the statements that fill H as a symmetric matrix, from its distinct values."""
        full = ca.SX(self.nz, self.nz)
        for (r, c), n in self.d.hessian.items():
            full[r, c] = full[c, r] = values[n]
        return full

    # Parts of the sweeps ---------------------------------------------------------------------------------------------

    def start(self) -> list[Node]:
        """Initialise h, X = x, S = [I 0] and the constant forcing."""
        identity = ca.SX.zeros(self.nF * self.ld)
        for c, j in enumerate(self.columns[: self.state_columns]):
            identity[j * self.ld + c] = 1
        nodes: list[Node] = [
            *self.rk.start(),
            Call(constant("identity", identity), (), (Slice("Sx", self.nF * self.ld),)),
        ]
        if self.d.curved_controls or self.forcing_varies:
            units = ca.SX.zeros(len(self.controls) * self.ld)
            for n in range(len(self.controls)):
                units[n * self.ld + self.state_columns + n] = 1
            nodes.append(Call(constant("units", units), (), (Slice("E", units.numel()),)))
        value = self.linear_forcing()
        nodes.append(Call(constant("forcing", value), (), (Slice("Fu", value.numel()),)))
        return add_notes(nodes, "start")

    def evaluate(self, stage: int) -> list[Node]:
        """Return the statements for the stage point and K_i, and for the tape if it is stored."""
        point, K = Slice("Xi", self.nx) if self.wide else self.point(stage), self.rk.slope(stage)
        start = Call(copy("copy_x", self.nx), (self.rk.state,), (point,))
        nodes: list[Node] = [self.rk.point(stage, point) if any(self.tableau.a[stage]) else start]
        n = len(self.d.functions)
        found, kept = Slice("m", n), self.stage_slice("M", stage, n, kept=False)
        if self.wide:
            nodes.append(Call(self.d.leaf_value_and_functions(), (point, *self.rk.up), (K, found)))
            nodes.append(Call(copy(f"keep_{self.nx}", self.nx), (point,), (self.point(stage),), inline=True))
            nodes.append(Call(copy(f"keep_{n}", n), (found,), (kept,), inline=True))
        elif self.d.keeps_tape:
            nodes.append(Call(self.d.leaf_tape(self.d.tape), (point, *self.rk.up), (K, self.tape(stage))))
        else:
            nodes.append(Call(self.d.leaf_value(), (point, *self.rk.up), (K,)))
        return add_notes(nodes, f"stage {stage + 1}", stage)

    def row_lengths(self) -> dict[str, int]:
        """Return the row lengths of the buffers that are matrices."""
        stages = dict.fromkeys(("Xs", "tape", "kappa", "M", "Hs"), self.stages)
        if not self.wide:
            stages = {"tape": self.d.tape, "kappa": len(self.d.curved)}
        packed = ("Sx", "Ks", "Fu", "E", "H", "Z", "HZ", "Zs", "adjS", "XbarS", "ubarS")
        return self.rk.columns | stages | dict.fromkeys(packed, self.ld)

    def slope(self, stage: int, rows: list[int], target: Slice) -> For:
        """Return the columns of K_i' = F_x Z + [0 F_u]; the given rows of Z are stored in ``target``."""
        d, coefficients = self.d, self.tableau.a[stage]
        tape, s, h = ca.SX.sym("t", d.slopes), ca.SX.sym("s", self.nF), ca.SX.sym("h")
        Fu, units = ca.SX.sym("Fu", len(self.forced)), ca.SX.sym("E", len(self.controls))
        slopes = [ca.SX.sym(f"K{j}", self.nF) for j, c in enumerate(coefficients) if c]
        Z = combine(s, h, slopes, coefficients)[: self.nx]
        K = d.Fz(tape)[:, : self.nx] @ Z + self.forcing(Fu, tape, units)
        names = ["t", "s", "h", "Fu", "E", *(f"K{j}" for j in range(len(slopes)))]
        leaf = ca.Function(f"slope_{stage}", [tape, s, h, Fu, units, *slopes], [K, Z[rows]], names, ["Ks", "Z"])
        ins = [self.tape(stage, d.slopes), self.column("Sx", self.nF), Slice("h", 1)]
        ins += [self.column("Fu", len(self.forced)), self.column("E", len(self.controls))]
        ins += [self.column("Ks", self.nF, j) for j, a in enumerate(coefficients) if a]
        outs = (self.column("Ks", self.nF, stage), target)
        return self.columnwise(Call(leaf, tuple(ins), outs, note=f"sensitivities of stage {stage + 1}"))

    def update_columns(self) -> For:
        """Return S += h sum_i b_i K_i'."""
        update = self.rk.update("update_columns", self.column("Sx", self.nF), lambda j: self.column("Ks", self.nF, j))
        return self.columnwise(replace(update, note="sensitivities of the step"))

    def again(self, stage: int, length: int) -> list[Node]:
        """Return the statements that evaluate the first ``length`` values of the tape again if it is not stored."""
        if self.d.keeps_tape or not length:
            return []
        return [
            Call(self.d.leaf_tape(length, value=False), (self.point(stage), *self.rk.up), (self.tape(stage, length),))
        ]

    def backward(self) -> list[Node]:
        """Return the statements of one step of the adjoint: kappa_i of all stages, adj += sum_i Xbar_i."""
        nodes: list[Node] = []
        for i in reversed(range(self.stages)):
            stage = [*self.again(i, self.d.slopes), self._backward_stage(i)]
            nodes += add_notes(stage, f"adjoint of stage {i + 1}")
        return [*nodes, self.rk.update_adjoint("update_adjoint", Slice("adj", self.nx), self._bar, down=True)]

    def _backward_stage(self, stage: int) -> Call:
        """Return the call of kappa_i and Xbar_i."""
        ins = (Slice("adj", self.nx), LENGTH, self.tape(stage, self.d.slopes), *map(self._bar, self.rk.later(stage)))
        return Call(self.leaf_backward(stage), ins, (self.kappa(stage), self._bar(stage)))

    def _bar(self, stage: int) -> Slice:
        return Slice("Xbar", self.nx, Affine(stage * self.nx))

    def stagewise(self, call: Call) -> For:
        """Return a loop over the stages of a step."""
        return For("s", 0, self.stages, (replace(call, inline=True),))

    def lane(self, buffer: str, size: int, kept: bool = True) -> Slice:
        """Return the data of stage s, the loop index."""
        terms = (("s", 1), ("step", self.stages * size)) if kept else (("s", 1),)
        return Slice(buffer, size, Affine(0, terms), self.stages)

    def tapes(self) -> For:
        """Evaluate the tapes of all stages of a step."""
        d = self.d
        ins = (self.lane("Xs", d.nx, self.keeps_points), *self.rk.up, self.lane("M", len(d.functions), False))
        call = Call(d.leaf_tape_of_functions(), ins, (self.lane("tape", d.tape),), note="derivatives at all stages")
        return self.stagewise(call)

    def curvatures(self) -> For:
        """Evaluate the values of H for all stages of a step."""
        d = self.d
        ins = (self.lane("Xs", d.nx, self.keeps_points), *self.rk.up, self.lane("tape", d.tape))
        kappa = self.lane("kappa", len(d.curved), self.keeps_kappa)
        call = Call(
            d.leaf_hessian(), (*ins, kappa), (self.lane("Hs", d.values, False),), note="curvatures at all stages"
        )
        return self.stagewise(call)

    def hessian_values(self, stage: int) -> Slice:
        """Return the values of H_i."""
        return self.stage_slice("Hs", stage, self.d.values, kept=False)

    def curvature(self, stage: int) -> Call:
        """Evaluate the values of H_i."""
        d, H = self.d, Slice("Hs", self.d.values)
        point = self.point(stage) if self.keeps_points else Slice("X", self.nx)
        ins = (point, *self.rk.up, self.tape(stage), self.kappa(stage))
        return Call(d.leaf_hessian(), ins, (H,), note=f"curvature of stage {stage + 1}")

    def loop(self, nodes: Iterable[Node], down: bool = False) -> For:
        """Return a loop over steps."""
        return For("step", 0, self.steps, tuple(nodes), down)

    # Results ---------------------------------------------------------------------------------------------------------

    @property
    def runs(self) -> list[tuple[int, int, int]]:
        """Return (packed column, column, length) of runs of adjacent columns.

        States and controls are in separate runs.
        """
        found: list[list[int]] = []
        for c, j in enumerate(self.columns):
            if found and found[-1][1] + found[-1][2] == j and j != self.nx:
                found[-1][2] += 1
            else:
                found.append([c, j, 1])
        return [(c, j, n) for c, j, n in found]

    def results(self) -> list[Node]:
        """Store x_next and S, and add the gradient of the integrated cost to g."""
        nz, runs = self.nz, self.runs
        nodes: list[Node] = [Call(copy("copy_x", self.nx), (Slice("X", self.nx),), (Slice("x_next", self.nx),))]
        closed = {j: self._closed_column(j) for j in range(nz) if j not in self.columns}
        if closed:
            S = ca.SX.zeros(self.nx, nz)
            for j, s in closed.items():
                S[:, j] = s[: self.nx]
            leaf = ca.Function("closed_columns", [self._h], [ca.vec(S.T)], ["h"], ["S"])
            note = "columns that depend on time alone"
            nodes.append(Call(leaf, (LENGTH,), (Slice("S", self.nx * nz),), inline=True, note=note))
        rows = tuple(
            Call(copy(f"copy_{n}", n), (_row("Sx", n, c, self.ld),), (_row("S", n, j, nz),)) for c, j, n in runs
        )
        nodes.append(For("i", 0, self.nx, rows))
        if self.nF > self.nx:
            nodes += [self._add_gradient(j, s[self.nx]) for j, s in closed.items() if not s[self.nx].is_zero()]
            for c, j, n in runs:
                here = Slice("g", n, Affine(j))
                nodes.append(Call(addition(n), (here, Slice("Sx", n, Affine(self.nx * self.ld + c))), (here,)))
        return add_notes(nodes, "results")

    def _add_gradient(self, j: int, value: Expression) -> Call:
        """Return component j of the gradient of an integrated cost, a function of h only."""
        g, here = ca.SX.sym("g"), Slice("g", 1, Affine(j))
        return Call(ca.Function(f"gradient_{j}", [g, self._h], [g + value]), (here, LENGTH), (here,))

    def _closed_column(self, j: int) -> Expression:
        """Return column j of S and of the gradient, a function of h only."""
        Fx = self.d.Fz(ca.SX.sym("t", self.d.slopes))[:, : self.nx]
        forcing = ca.SX(self.nF, 1) if j < self.nx else self.d.Fz(ca.SX.sym("t", self.d.slopes))[:, j]
        s = ca.SX.zeros(self.nF)
        if j < self.nx:
            s[j] = 1
        for _ in range(self.steps):
            slopes: list[Expression] = []
            for i in range(self.stages):
                used = [k for k, a in zip(slopes, self.tableau.a[i], strict=False) if a]
                point = combine(s, self._h, used, self.tableau.a[i])
                slopes.append(_constants_only(Fx, point[: self.nx]) + forcing)
            s = combine(s, self._h, [k for k, b in zip(slopes, self.tableau.b, strict=True) if b], self.tableau.b)
        return s

    def add_block(self, buffer: str, row: int, run_rows: tuple[int, int], columns: tuple[int, int, int]) -> Node:
        """Return Q[j + i][columns] += buffer[row + i][columns], i < n, for a run of n rows from row j of Q."""
        j, n = run_rows
        c, k, m = columns
        target = Slice("Q", 1, Affine(j * self.nz + k, (("i", self.nz), ("c", 1))))
        source = Slice(buffer, 1, Affine(row * self.ld + c, (("i", self.ld), ("c", 1))))
        inner = For("c", 0, m, (Call(addition(1), (target, source), (target,), inline=True),))
        return For("i", 0, n, (inner,))


def _row(buffer: str, n: int, offset: int, ld: int) -> Slice:
    return Slice(buffer, n, Affine(offset, (("i", ld),)))


def _constants_only(Fx: Expression, s: Expression) -> Expression:
    """Return Fx s, where the columns of Fx that multiply nonzeros of s are constant."""
    total = ca.SX.zeros(Fx.shape[0])
    for j in range(int(s.numel())):
        if not s[j].is_zero():
            total += ca.densify(Fx[:, j]) * s[j]
    return total


def constant(name: str, value: Expression) -> Function:
    """Return the leaf y = value."""
    return ca.Function(name, [], [value], [], ["y"])


def addition(n: int) -> Function:
    """Return the leaf y = x + a."""
    x, a = ca.SX.sym("x", n), ca.SX.sym("a", n)
    return ca.Function(f"add_{n}", [x, a], [x + a], ["x", "a"], ["y"])
