"""Derivatives of a right-hand side are leaves of sweeps, with structural zeros and constants.

    F = (f, l)(x, u, p): the dynamics, followed by the rate of an integrated cost, if there is one
    F_z = dF / d(x, u),   H(kappa) = d2 (kappa' F) / d(x, u)^2, lower triangle

Intermediate values of F_z and H are evaluated once per stage point and stored (the "tape"); H is completed when kappa
is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca

from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression, Function, nonzeros
from nmpc_codegen.ir.kernel import OPERATIONS, Kernel, Port, lift
from nmpc_codegen.ir.lookup_calls import known_lookup, look_up
from nmpc_codegen.ir.tuning import CLOSED_STATES, TAPE_PER_COMPONENT

Entry = tuple[int, int]

#: Number of an instruction -> its value.
Values = Callable[[int], Expression]


class IntervalDerivatives:
    """The derivatives of an interval are F, F_z and H of one problem with their sparsity patterns.

    Attributes:
        nF: number of rows of F, nx or nx + 1.
        jacobian: nonzeros (i, j) of F_z, in the order of its values.
        hessian: nonzeros (r, c), r >= c, of H -> position of the value among ``values`` distinct ones.
        curved: rows of F that are nonlinear in (x, u).
        tape: number of values stored per stage point; F_z needs the first ``slopes`` of them.
    """

    def __init__(self, problem: Problem) -> None:
        stage = problem.path
        self.x, self.u, self.p = stage.x, stage.u, stage.p
        self.nx, self.nu, self.np = stage.nx, stage.nu, problem.np
        self.nz = self.nx + self.nu
        f = problem.dynamics(self.x, self.u, self.p)
        self.F = f if stage.cost_rate is None else ca.vertcat(f, stage.cost_rate)
        self.nF = int(self.F.numel())
        z = ca.vertcat(self.x, self.u)
        self._kappa = ca.SX.sym("kappa", self.nF)
        Fz = ca.sparsify(ca.jacobian(self.F, z))
        self.jacobian: list[Entry] = list(zip(*Fz.sparsity().get_triplet(), strict=True))
        self.Fz_values = nonzeros(Fz)
        self.constants = [v.is_constant() for v in self.Fz_values]
        H, self._kernel = self._cheapest(z)
        stored = [v for o, _, v in self._kernel.stores if o == 2]
        self._values_of_H = list(dict.fromkeys(stored))
        where = {v: n for n, v in enumerate(self._values_of_H)}
        entries = zip(*H.sparsity().get_triplet(), strict=True)
        self.hessian: dict[Entry, int] = {e: where[v] for e, v in zip(entries, stored, strict=True)}
        self.values = len(where)
        read = {i.args for i in self._kernel.instructions if i.opcode == ca.OP_INPUT}
        self.curved = [i for i in range(self.nF) if (3, i) in read]
        self._split()

    def _cheapest(self, z: Expression) -> tuple[Expression, Kernel]:
        """Return the one of three expressions of H whose program, together with f and F_z, has fewest operations."""
        L = ca.dot(self._kappa, self.F)
        terms = [self._kappa[i] * ca.tril(ca.hessian(self.F[i], z)[0]) for i in range(self.nF)]
        forward = ca.jacobian(ca.jacobian(self.F, z).T @ self._kappa, z)
        candidates = [ca.tril(ca.hessian(L, z)[0]), sum(terms[1:], terms[0]), ca.tril(forward)]
        values = [v for v, constant in zip(self.Fz_values, self.constants, strict=True) if not constant]
        found = []
        for H in map(ca.sparsify, candidates):
            outputs = [self.F[: self.nx], _column(values), _column(nonzeros(H))]
            found.append((H, _lift([self.x, self.u, self.p, self._kappa], outputs)))
        return min(found, key=lambda c: c[1].count.total)

    def _split(self) -> None:
        """Select the values of the program to store: those of F_z, and inputs of H that do not depend on kappa."""
        k = self._kernel
        late: list[bool] = []
        kept: dict[int, None] = dict.fromkeys(v for o, _, v in k.stores if o == 1)
        self.slopes = len(kept)
        for ins in k.instructions:
            known = ins.opcode not in OPERATIONS
            late.append(ins.args[0] == 3 if ins.opcode == ca.OP_INPUT else not known and any(late[a] for a in ins.args))
            if not known and late[-1]:
                for a in ins.args:
                    if not late[a] and k.instructions[a].opcode in OPERATIONS:
                        kept[a] = None
        self._late, self._kept = late, list(kept)
        self.tape = len(kept)

    @property
    def keeps_tape(self) -> bool:
        """Return True if the tape of every stage is stored, False if it is evaluated again from the stage point."""
        return self.tape <= TAPE_PER_COMPONENT * self.nz

    def _values(self, inputs: Sequence[Expression], preset: dict[int, Expression]) -> Values:
        """Return a lookup of the values of the program for the given inputs, evaluated on demand."""
        k, known = self._kernel, dict(preset)

        def value(index: int) -> Expression:
            if index not in known:
                ins = k.instructions[index]
                if ins.opcode == ca.OP_INPUT:
                    known[index] = inputs[ins.args[0]][ins.args[1]]
                elif ins.opcode == ca.OP_CONST:
                    known[index] = ca.SX(ins.constant)
                elif ins.opcode == ca.OP_CALL:
                    known[index] = look_up(known_lookup(ins.constant), value(ins.args[0]))
                elif len(ins.args) == 1:
                    known[index] = ca.SX.unary(ins.opcode, value(ins.args[0]))
                else:
                    known[index] = ca.SX.binary(ins.opcode, value(ins.args[0]), value(ins.args[1]))
            return known[index]

        return value

    # Leaves ----------------------------------------------------------------------------------------------------------

    def leaf_value(self) -> Function:
        """Return the leaf K = f(X, u, p)."""
        return ca.Function("f", [self.x, self.u, self.p], [self.F[: self.nx]], ["x", "u", "p"], ["K"])

    def leaf_tape(self, length: int, value: bool = True) -> Function:
        """Return the leaf of (K,) tape[:length] at a stage point."""
        entry = self._values([self.x, self.u, self.p], {})
        tape = _column([entry(v) for v in self._kept[:length]])
        if value:
            return ca.Function("taped_f", [self.x, self.u, self.p], [self._K(entry), tape], ["x", "u", "p"], ["K", "t"])
        name = "tape" if length == self.tape else "slopes"
        return ca.Function(name, [self.x, self.u, self.p], [tape], ["x", "u", "p"], ["t"])

    @cached_property
    def functions(self) -> list[int]:
        """Return the calls of math.h functions in the tape, which compilers do not vectorise."""
        found, todo = set(), list(self._kept)
        while todo:
            index = todo.pop()
            ins = self._kernel.instructions[index]
            if index not in found and ins.opcode in OPERATIONS:
                found.add(index)
                todo += ins.args
        return sorted(v for v in found if _is_call(self._kernel.instructions[v].opcode))

    def leaf_value_and_functions(self) -> Function:
        """Return the leaf of K and of the values of ``functions``."""
        entry = self._values([self.x, self.u, self.p], {})
        values = _column([entry(v) for v in self.functions])
        return ca.Function("f", [self.x, self.u, self.p], [self._K(entry), values], ["x", "u", "p"], ["K", "m"])

    def leaf_tape_of_functions(self) -> Function:
        """Return the leaf of the tape, computed from the values of ``functions`` by arithmetic only."""
        values = ca.SX.sym("m", len(self.functions))
        preset = {v: values[n] for n, v in enumerate(self.functions)}
        entry = self._values([self.x, self.u, self.p], preset)
        tape = _column([entry(v) for v in self._kept])
        return ca.Function("tape", [self.x, self.u, self.p, values], [tape], ["x", "u", "p", "m"], ["t"])

    def _K(self, entry: Values) -> Expression:
        K = ca.SX.zeros(self.nx)
        for o, e, v in self._kernel.stores:
            if o == 0:
                K[e] = entry(v)
        return K

    def Fz(self, tape: Expression) -> Expression:
        """Return F_z as an SX matrix in the symbols of a tape; constant entries are numbers."""
        stored = iter([v for o, _, v in self._kernel.stores if o == 1])
        where = {v: tape[n] for n, v in enumerate(self._kept[: self.slopes])}
        matrix = ca.SX(self.nF, self.nz)
        for (i, j), constant, value in zip(self.jacobian, self.constants, self.Fz_values, strict=True):
            matrix[i, j] = value if constant else where[next(stored)]
        return matrix

    def leaf_hessian(self) -> Function:
        """Return the leaf of the values of H from the stage point, its tape, and kappa of the curved rows."""
        tape, kappa = ca.SX.sym("t", self.tape), ca.SX.sym("kappa", len(self.curved))
        full = ca.SX.zeros(self.nF)
        for n, i in enumerate(self.curved):
            full[i] = kappa[n]
        entry = self._values([self.x, self.u, self.p, full], {v: tape[n] for n, v in enumerate(self._kept)})
        H = _column([entry(v) for v in self._values_of_H])
        return ca.Function(
            "curvature", [self.x, self.u, self.p, tape, kappa], [H], ["x", "u", "p", "t", "kappa"], ["H"]
        )

    # Structure -------------------------------------------------------------------------------------------------------

    @cached_property
    def needed(self) -> list[int]:
        """Return the states on which F depends."""
        return sorted({j for _, j in self.jacobian if j < self.nx})

    @cached_property
    def curved_states(self) -> list[int]:
        """Return the states in which F is nonlinear, which are rows of H."""
        return sorted({j for e in self.hessian for j in e if j < self.nx})

    @cached_property
    def curved_controls(self) -> list[int]:
        """Return the controls (0 .. nu - 1) in which F is nonlinear."""
        return sorted({j - self.nx for e in self.hessian for j in e if j >= self.nx})

    def depends_on_time_alone(self, column: int) -> bool:
        """Return True if this column of d x(t) / d(x, u) depends only on time.

        This is the case if all states that the column reaches enter F linearly with constant coefficients. Columns that
        reach more than CLOSED_STATES states are not treated in this way.
        """
        constant: dict[int, bool] = {}
        rows: dict[int, list[int]] = {}
        for (i, j), is_constant in zip(self.jacobian, self.constants, strict=True):
            constant[j] = constant.get(j, True) and is_constant
            rows.setdefault(j, []).append(i)
        reached, todo = set(), [column]
        while todo:
            j = todo.pop()
            if j in reached:
                continue
            if not constant.get(j, True):
                return False
            reached.add(j)
            if len(reached) > CLOSED_STATES:
                return False
            todo += [i for i in rows.get(j, []) if i < self.nx]
        return True


def _column(values: list[Expression]) -> Expression:
    return ca.vertcat(ca.SX(0, 1), *values)


def _lift(inputs: list[Expression], outputs: list[Expression]) -> Kernel:
    dense = [ca.densify(o) for o in outputs]
    ports = [Port(f"i{n}", int(s.numel())) for n, s in enumerate(inputs)]
    return lift(
        ca.Function("joint", inputs, dense),
        "joint",
        "",
        ports,
        [Port(f"o{n}", int(o.numel())) for n, o in enumerate(dense)],
    )


def _is_call(opcode: int) -> bool:
    return opcode == ca.OP_CALL or OPERATIONS[opcode].count == "call"
