"""The products with the stage matrices are sweeps: straight-line code over structural nonzeros, or loops."""

from __future__ import annotations

from dataclasses import replace
from math import prod
from typing import Protocol

import casadi as ca

from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.product_interfaces import Interface, Interfaces
from nmpc_codegen.ir.sweep import Affine, Call, Entries, For, If, LoopedRoutine, Node, Place, Slice
from nmpc_codegen.ir.tuning import COLUMNS, TERMS
from nmpc_codegen.package.struct_layout import Size

Pattern = frozenset[tuple[int, int]]

#: (stored row, stored column, j) of a nonzero (i, j) of a symmetric matrix.
Entry = tuple[int, int, int]


class StageSweeps(Protocol):
    """Stage sweeps implement all products: first those with a vector, then those with a panel of columns."""

    def state_step(self) -> LoopedRoutine: ...
    def adjoint_step(self) -> LoopedRoutine: ...
    def cost_gradient(self) -> LoopedRoutine: ...
    def terminal_adjoint(self) -> LoopedRoutine: ...
    def forward_panel(self) -> LoopedRoutine: ...
    def terminal_panel(self) -> LoopedRoutine: ...
    def backward_panel(self) -> LoopedRoutine: ...


def entries(lower: Pattern, i: int) -> list[Entry]:
    """Return the nonzeros in row i of a symmetric matrix that is stored as its lower triangle, sorted by column."""
    found = [(r, c, c) for r, c in lower if r == i] + [(r, c, r) for r, c in lower if c == i and r != i]
    return sorted(found, key=lambda e: e[2])


class WrittenOut:
    """The products are written out over structural nonzeros, row by row.

    Nodes are processed one after the other. Terms with the result of the previous node come last in every sum, so that
    the other terms need not wait for it.
    """

    def __init__(self, nx: int, nu: int, S: Pattern, Q: Pattern, Q_N: Pattern, banded: int = 0) -> None:
        self.of = Interfaces(nx, nu)
        self.nx, self.kept = nx, nx - banded  # states whose columns panels multiply
        self.columns = [sorted(c for r, c in S if r == i) for i in range(nx)]
        self.rows = [sorted(r for r, c in S if c == i) for i in range(nx + nu)]
        self.Q = [entries(Q, i) for i in range(nx + nu)]
        self.Q_N = [entries(Q_N, i) for i in range(nx)]

    def state_step(self) -> LoopedRoutine:
        v = _Operands(self.of.state_step)
        z = ca.vertcat(v["dx"], v["du"])
        ordered = [sorted(row, key=lambda j: j < self.nx) for row in self.columns]
        return v.vectors([_total([v["b"][i], *(v["S"][i, j] * z[j] for j in row)]) for i, row in enumerate(ordered)])

    def adjoint_step(self) -> LoopedRoutine:
        v = _Operands(self.of.adjoint_step)
        z = ca.vertcat(v["dx"], v["du"])
        curved = [[v["Q"][r, c] * z[j] for r, c, j in row] for row in self.Q]
        later = [[v["S"][j, i] * v["w"][j] for j in rows] for i, rows in enumerate(self.rows)]
        return v.vectors([_total([v["g"][i], *curved[i], *later[i]]) for i in range(len(self.rows))])

    def cost_gradient(self) -> LoopedRoutine:
        v = _Operands(self.of.cost_gradient)
        z = ca.vertcat(v["dx"], v["du"])
        curved = [[v["Q"][r, c] * z[j] for r, c, j in row] for row in self.Q]
        return v.vectors([_total([v["g"][i], *row]) for i, row in enumerate(curved)], direct=True)

    def terminal_adjoint(self) -> LoopedRoutine:
        v = _Operands(self.of.terminal_adjoint)
        curved = [[v["Q"][r, c] * v["dx"][j] for r, c, j in row] for row in self.Q_N]
        return v.vectors([_total([v["g"][i], *row]) for i, row in enumerate(curved)], direct=True)

    def forward_panel(self) -> LoopedRoutine:
        v = _Operands(self.of.forward_panel, panel=True)
        kept = enumerate(self.columns[: self.kept])
        rows = [_total([v["S"][i, j] * v["G"][j] for j in row if j < self.kept]) for i, row in kept]
        return v.columns({"G_next": rows + [ca.SX(0)] * (self.nx - self.kept)})

    def terminal_panel(self) -> LoopedRoutine:
        v = _Operands(self.of.terminal_panel, panel=True)
        return v.columns(
            {"W": [_total([v["Q"][r, c] * v["G"][j] for r, c, j in row if j < self.kept]) for row in self.Q_N]},
            direct=True,
        )

    def backward_panel(self) -> LoopedRoutine:
        v = _Operands(self.of.backward_panel, panel=True)
        curved = [[v["Q"][r, c] * v["G"][j] for r, c, j in row if j < self.kept] for row in self.Q]
        later = [[v["S"][j, i] * v["W"][j] for j in rows if j < self.kept] for i, rows in enumerate(self.rows)]
        rows = [_total([*curved[i], *later[i]]) for i in range(len(self.rows))]
        return v.columns({"W": rows[: self.nx], "T": rows[self.nx :]})


class _Operands:
    """The operands of a product are symbols; one column represents a panel."""

    def __init__(self, interface: Interface, panel: bool = False) -> None:
        self._interface, self._panel = interface, panel
        self._symbols = {name: ca.SX.sym(name, self._slice(name).size) for name in interface.inputs}

    def __getitem__(self, name: str) -> Expression:
        shape, symbol = self._interface.places[name].shape, self._symbols[name]
        if len(shape) == 1 or self._in_panel(name):
            return symbol
        return ca.reshape(symbol, int(shape[1]), int(shape[0])).T

    def vectors(self, rows: list[Expression], direct: bool = False) -> LoopedRoutine:
        """Return the product with these rows as its result, as an inline function."""
        (name,) = self._interface.outputs
        return replace(self._interface, inline=True).routine(self._call({name: rows}, direct))

    def columns(self, rows: dict[str, list[Expression]], direct: bool = False) -> LoopedRoutine:
        """Return the product with these rows as its result for every column of a panel."""
        return self._interface.routine(For("l", 0, Size("COLUMNS", COLUMNS), (self._call(rows, direct),)))

    def _call(self, rows: dict[str, list[Expression]], direct: bool) -> Call:
        leaf = ca.Function("rows", list(self._symbols.values()), [ca.vertcat(ca.SX(0, 1), *r) for r in rows.values()])
        ins, outs = (tuple(self._slice(name) for name in names) for names in (self._symbols, rows))
        return Call(leaf, ins, outs, inline=True, direct=direct)

    def _in_panel(self, name: str) -> bool:
        return self._panel and name not in ("S", "Q")

    def _slice(self, name: str) -> Slice:
        shape = self._interface.places[name].shape
        if self._in_panel(name):
            return Slice(name, int(shape[0]), Affine(0, (("l", 1),)), COLUMNS)
        return Slice(name, prod(shape))


def _total(terms: list[Expression]) -> Expression:
    total = terms[0] if terms else ca.SX(0)
    for term in terms[1:]:
        total = total + term
    return total


class Loops:
    """The products are dense loops over S, and loops over tables of the nonzeros of Q and Q_N."""

    def __init__(self, nx: int, nu: int, Q: Pattern, Q_N: Pattern, banded: int = 0) -> None:
        self.of = of = Interfaces(nx, nu)
        self.kept = Size("NX - NBAND", nx - banded) if banded else of.nx  # states whose columns panels multiply
        self.nx, self.nu, self.nz, self.panel = of.nx, of.nu, of.nz, of.panel
        self.Q, self.Q_N = sorted(Q), sorted(Q_N)

    @property
    def tables(self) -> dict[str, list[int]]:
        """Return rows and columns of the structural nonzeros of Q and Q_N, if they have any: {C name: values}."""
        named = {"Q": self.Q, "Q_N": self.Q_N}
        of = {name: entries for name, entries in named.items() if entries}
        return {f"{n}_{part}": [e[i] for e in of[n]] for n in of for i, part in enumerate(("row", "column"))}

    def state_step(self) -> LoopedRoutine:
        total, y = _at("sum"), _at("y", i=1)
        in_x = _add(total, _at("S", i=self.nz, j=1), _at("dx", j=1))
        in_u = _add(total, _at("S", self.nx, i=self.nz, j=1), _at("du", j=1))
        row = (
            *(_copy(_at("b", i=1), total), For("j", 0, self.nx, (in_x,)), For("j", 0, self.nu, (in_u,))),
            _copy(total, y),
        )
        return replace(self.of.state_step, locals={"sum": Place("sum")}).routine(For("i", 0, self.nx, row))

    def adjoint_step(self) -> LoopedRoutine:
        r = _at("r", i=1)
        product = _add(r, _at("S", j=self.nz, i=1), _at("w", j=1))
        nodes = [
            *self._point(),
            For("i", 0, self.nz, (_copy(_at("g", i=1), r),)),
            For("j", 0, self.nx, (For("i", 0, self.nz, (product,)),)),
            *self._symmetric("Q", self.nz, 0, len(self.Q), "r", "z"),
            For("i", 0, self.nz, (_copy(r, _at("w", i=1)),)),
        ]
        vectors = {name: Place(name, (self.nz,)) for name in ("z", "r")}
        return replace(self.of.adjoint_step, locals=vectors).routine(*nodes)

    def cost_gradient(self) -> LoopedRoutine:
        start = For("i", 0, self.nz, (_copy(_at("g", i=1), _at("y", i=1)),))
        products = self._symmetric("Q", self.nz, 0, len(self.Q), "y", "z")
        return replace(self.of.cost_gradient, locals={"z": Place("z", (self.nz,))}).routine(
            *self._point(), start, *products
        )

    def _point(self) -> tuple[Node, ...]:
        """Return the loops of z = (dx, du)."""
        return (
            For("i", 0, self.nx, (_copy(_at("dx", i=1), _at("z", i=1)),)),
            For("i", 0, self.nu, (_copy(_at("du", i=1), _at("z", self.nx, i=1)),)),
        )

    def terminal_adjoint(self) -> LoopedRoutine:
        start = For("i", 0, self.nx, (_copy(_at("g", i=1), _at("w", i=1)),))
        products = self._symmetric("Q_N", self.nx, 0, len(self.Q_N), "w", "dx")
        return self.of.terminal_adjoint.routine(start, *products)

    def forward_panel(self) -> LoopedRoutine:
        totals = {"sum": Place("sum", (self.panel,))}
        rows = self._combine(_at("S", i=self.nz), 1, "G", _at("G_next", i=COLUMNS, l=1))
        clear = For("l", 0, self.panel, (_zero(_at("G_next", i=COLUMNS, l=1)),))
        others = (For("i", int(self.kept), self.nx - self.kept, (clear,)),) if self.kept < self.nx else ()
        return replace(self.of.forward_panel, locals=totals).routine(For("i", 0, self.kept, rows), *others)

    def terminal_panel(self) -> LoopedRoutine:
        clear = For("i", 0, self.nx, (For("l", 0, self.panel, (_zero(_at("W", i=COLUMNS, l=1)),)),))
        own = sum(r < self.kept for r, _ in self.Q_N)
        products = self._symmetric("Q_N", self.nx, 0, own, "W", "G", panel=True)
        return self.of.terminal_panel.routine(clear, *products)

    def backward_panel(self) -> LoopedRoutine:
        copy = _copy(_at("W", i=COLUMNS, l=1), _at("later", i=COLUMNS, l=1))
        W = self._combine(_at("S", i=1), self.nz, "later", _at("W", i=COLUMNS, l=1))
        T = self._combine(_at("S", self.nx, i=1), self.nz, "later", _at("T", i=COLUMNS, l=1))
        own, states = (sum(r < n for r, _ in self.Q) for n in (self.kept, self.nx))
        nodes = [
            For("i", 0, self.kept, (For("l", 0, self.panel, (copy,)),)),
            For("i", 0, self.kept, W),
            For("i", 0, self.nu, T),
            *self._symmetric("Q", self.nz, 0, own, "W", "G", panel=True),
            *self._add_mixed_block(states),
        ]
        buffers = {"later": Place("later", (self.nx, self.panel)), "sum": Place("sum", (self.panel,))}
        return replace(self.of.backward_panel, locals=buffers).routine(*nodes)

    def _combine(self, a: Slice, stride: int, rows: str, out: Slice) -> tuple[Node, ...]:
        """Return the loops of out[l] = sum_j a[j] rows[j][l] over the kept rows, TERMS at a time."""
        blocks, rest = divmod(int(self.kept), TERMS)
        many = _dot(
            _at("sum", l=1), _along(a, TERMS, stride), Slice(rows, TERMS, _affine(0, j=TERMS * COLUMNS, l=1), COLUMNS)
        )
        done = blocks * TERMS
        one = _dot(_at("sum", l=1), _along(a, 1, stride), Slice(rows, 1, _affine(0, j=COLUMNS, l=1), COLUMNS))

        def panel(call: Call) -> For:
            return For("l", 0, self.panel, (call,))

        return (
            panel(_zero(_at("sum", l=1))),
            *((For("j", 0, blocks, (panel(many),)),) if blocks else ()),
            *((For("j", done, rest, (panel(one),)),) if rest else ()),
            panel(_copy(_at("sum", l=1), out)),
        )

    def _symmetric(
        self, matrix: str, ld: int, first: int, last: int, out: str, factor: str, panel: bool = False
    ) -> list[Node]:
        """Return out += Q factor for a symmetric Q, over the nonzeros first .. last - 1 of its lower triangle."""
        value = _at("Q", a=ld, b=1)

        def product(row: str, column: str) -> Node:
            if not panel:
                return _add(_at(out, **{row: 1}), value, _at(factor, **{column: 1}))
            target, source = (_at(name, **{i: COLUMNS, "l": 1}) for name, i in ((out, row), (factor, column)))
            return For("l", 0, self.panel, (_add(target, value, source),))

        body = (product("a", "b"), If("a", "!=", "b", (product("b", "a"),)))
        return self._entries(matrix, first, last, body)

    def _add_mixed_block(self, first: int) -> list[Node]:
        """Return T += Q_ux G, with the block of Q that has the rows of the controls and the columns of the states."""
        target = _at("T", -self.nx * COLUMNS, a=COLUMNS, l=1)
        product = For("l", 0, self.panel, (_add(target, _at("Q", a=self.nz, b=1), _at("G", b=COLUMNS, l=1)),))
        some = any(c < self.kept for _, c in self.Q[first:])
        return self._entries("Q", first, len(self.Q) if some else first, (If("b", "<", self.kept, (product,)),))

    def _entries(self, matrix: str, first: int, last: int, body: tuple[Node, ...]) -> list[Node]:
        if first == last:
            return []
        tables = ((name, f"{matrix}_{part}") for name, part in (("a", "row"), ("b", "column")))
        return [
            Entries("n", tuple((name, table, tuple(self.tables[table])) for name, table in tables), first, last, body)
        ]


def _affine(constant: int, **terms: int) -> Affine:
    return Affine(constant, tuple(terms.items()))


def _at(buffer: str, constant: int = 0, **terms: int) -> Slice:
    """Return one element of a buffer."""
    return Slice(buffer, 1, _affine(constant, **terms))


def _along(start: Slice, size: int, stride: int) -> Slice:
    """Return the j-th block of ``size`` elements of a row or column."""
    return Slice(start.buffer, size, Affine(start.offset.constant, (*start.offset.terms, ("j", size * stride))), stride)


def _copy(source: Slice, target: Slice) -> Call:
    """Return the call target = source."""
    x = ca.SX.sym("x")
    return Call(ca.Function("copy", [x], [x]), (source,), (target,), inline=True, direct=True)


def _zero(target: Slice) -> Call:
    """Return the call target = 0."""
    return Call(ca.Function("zero", [], [ca.SX.zeros(1)]), (), (target,), inline=True, direct=True)


def _add(target: Slice, a: Slice, b: Slice) -> Call:
    """Return the call target += a b."""
    s, x, y = ca.SX.sym("s"), ca.SX.sym("x"), ca.SX.sym("y")
    return Call(ca.Function("add", [s, x, y], [s + x * y]), (target, a, b), (target,), inline=True, direct=True)


def _dot(target: Slice, a: Slice, b: Slice) -> Call:
    """Return the call target += a' b, summed pairwise."""
    s, x, y = ca.SX.sym("s"), ca.SX.sym("x", a.size), ca.SX.sym("y", a.size)
    sums = [x[i] * y[i] for i in range(a.size)]
    while len(sums) > 1:
        sums = [sums[i] + sums[i + 1] for i in range(0, len(sums) - 1, 2)] + sums[len(sums) & ~1 :]
    return Call(
        ca.Function(f"dot_{a.size}", [s, x, y], [s + sums[0]]), (target, a, b), (target,), inline=True, direct=True
    )
