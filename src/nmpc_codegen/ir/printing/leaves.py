"""The statements of a leaf are printed where a sweep calls it: loads, constants, loops over elements, stores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import groupby

import casadi as ca

from nmpc_codegen.ir.kernel import OPERATIONS, Kernel, live
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.constant_names import Taken
from nmpc_codegen.ir.printing.kernels import CLEARED, find_loads, result_note, statement
from nmpc_codegen.ir.printing.nested_expressions import NestedExpressions, declare, loads_inside, wrap_statement
from nmpc_codegen.ir.printing.rolls import Roll, Store, find_rolls
from nmpc_codegen.ir.sweep import Affine, Call, LoopedRoutine, Slice


@dataclass(frozen=True)
class Buffers:
    """The buffers of a sweep have sizes, rows, and a way of access in C.

    ``local`` buffers belong to the sweep and alias nothing; ``reached`` maps a buffer that is a member to the text
    before its name.
    """

    sizes: Mapping[str, int]
    columns: Mapping[str, int]
    local: Mapping[str, int]
    reached: Mapping[str, str]

    def is_number(self, buffer: str) -> bool:
        """Return True for a local buffer of one element, which is no array."""
        return self.local.get(buffer) == 1 and buffer not in self.columns

    def name(self, buffer: str) -> str:
        """Return the buffer as an operand."""
        return self.reached.get(buffer, "") + buffer

    def element(self, s: Slice, e: int, index: str = "", stride: int = 0) -> str:
        """Return the C text of an element of a slice, or of elements ``stride`` apart for an index."""
        constant, columns = s.offset.constant + s.stride * e, self.columns.get(s.buffer)
        name, moved = self.name(s.buffer), s.stride * stride
        if self.is_number(s.buffer):
            return name
        if not columns:
            terms = (*s.offset.terms, *(((index, moved),) if moved else ()))
            return f"{name}[{Affine(constant, terms).c()}]"
        row, column = Affine(constant, s.offset.terms).split(columns)
        down, along = divmod(moved, columns)
        row = replace(row, terms=(*row.terms, (index, down))) if down else row
        column = replace(column, terms=(*column.terms, (index, along))) if along else column
        return f"{name}[{row.c()}][{column.c()}]"

    def address(self, s: Slice) -> str:
        """Return the slice as an argument: a pointer to its first number."""
        columns = self.columns.get(s.buffer)
        text = self.element(s, 0)
        if columns and s.size <= columns and text.endswith("[0]"):
            return text.removesuffix("[0]")
        name = self.name(s.buffer)
        return name if text == f"{name}[0]" else f"&{text}"

    def fits(self, s: Slice, e: int, stride: int, count: int) -> bool:
        """Return True if ``count`` elements of a slice are in one row, or on a diagonal."""
        columns = self.columns.get(s.buffer)
        if not columns:
            return True
        if s.stride != 1 or any(c % columns for _, c in s.offset.terms):
            return False
        column = (s.offset.constant + e) % columns
        return column + (stride % columns) * (count - 1) < columns


class Leaf:
    """A leaf is called in a function whose names are ``taken``.

    If every result is a number, or one expression of the elements of vectors, the leaf is printed as loops over
    elements. Otherwise only its numbers are printed as loops, and all else as nested expressions.
    """

    def __init__(self, routine: LoopedRoutine, call: Call, buffers: Buffers, style: CStyle) -> None:
        self.routine, self.call, self.buffers, self.style = routine, call, buffers, style
        self.kernel: Kernel = routine.leaves[call.leaf.name()]
        self.cleared = self._find_cleared()
        stores = tuple(s for s in self.kernel.stores if not (s[0] in self.cleared and self.kernel.is_zero(s[2])))
        self.rolls, self.stores = self._roll(stores)
        #: True if it consists of loops over elements and stores of numbers.
        self.is_loop = all(self._is_number(v) for _, _, v in self.stores) and all(map(self._may_loop, self.rolls))
        if not self.is_loop:
            self.rolls = [roll for roll in self.rolls if self._is_number(roll.value)]
            rolled = {(r.output, r.first + n * r.stride) for r in self.rolls for n in range(r.count)}
            self.stores = [s for s in stores if s[:2] not in rolled]

    def lines(self, indent: str, index: str, taken: Taken) -> list[str]:
        """Return the statements of the leaf; ``index`` is the counter of loops over elements."""
        kernel = replace(self.kernel, stores=tuple(self.stores))
        held, texts = ([], {}) if self.is_loop else self._loads(taken)
        if self.is_loop:
            instructions, new = live(kernel.instructions, [v for _, _, v in self.stores])
            stores = tuple((o, e, new[v]) for o, e, v in self.stores)
            kernel = replace(kernel, instructions=instructions, stores=stores, parts=())
        expressions = NestedExpressions(kernel, self.style, lambda port, e: texts[port, e], taken)
        lines = [part for line in (*held, *expressions.statements) for part in wrap_statement(indent, line)]
        lines += [f"{indent}{self._clear(o)}" for o in self.cleared]
        for roll in self.rolls:
            lines += self._loop(roll, indent, index, taken)
        for o, e, v in kernel.stores:
            target = self.buffers.element(self.call.outs[o], e)
            lines += statement(indent, expressions.assignment(target, v), self._note(self.call.outs[o], e))
        return lines

    def _is_number(self, value: int) -> bool:
        return self.kernel.instructions[value].opcode == ca.OP_CONST

    # Loops over elements ---------------------------------------------------------------------------------------------

    def _roll(self, stores: tuple[Store, ...]) -> tuple[list[Roll], list[Store]]:
        columns = [self.buffers.columns.get(s.buffer, 0) for s in self.call.outs]
        strides = [(1, n + 1) if n and s.stride == 1 else (1,) for n, s in zip(columns, self.call.outs, strict=True)]

        def fits(output: int, first: int, stride: int, count: int) -> bool:
            return self.buffers.fits(self.call.outs[output], first, stride, count)

        return find_rolls(replace(self.kernel, stores=stores), strides, fits)

    def _may_loop(self, roll: Roll) -> bool:
        """Return True if a loop reads nothing that this loop, or another loop of the leaf, has changed."""
        if self._is_number(roll.value):
            return True
        target = self.call.outs[roll.output]
        ends = (roll.stride, roll.count)
        if target.stride != 1 or not all(self.buffers.fits(self.call.ins[p], e, *ends) for p, e in roll.moving):
            return False
        written = {s.buffer for s in self.call.outs}
        alone = len(self.call.outs) == 1 and len(self.rolls) == 1
        first = roll.of_first(self.kernel)
        inside = loads_inside(first, roll.moving)
        for port, e in find_loads(first) & inside:
            s = self.call.ins[port]
            here = s.offset == target.offset and e == roll.first and (port, e) in roll.moving
            foreign = s.buffer not in self.buffers.local and target.buffer not in self.buffers.local
            if (s.buffer in written or foreign) and not (alone and here):
                return False
        return True

    def _loop(self, roll: Roll, indent: str, index: str, taken: Taken) -> list[str]:
        """Return a loop over the elements of a roll, or the call that copies them."""
        ins, outs = self.call.ins, self.call.outs
        if copied := self._find_copy(roll):
            to = self.buffers.address(self._from(outs[roll.output], roll.first))
            source = self.buffers.address(self._from(ins[copied[0]], copied[1]))
            return [f"{indent}(void)memcpy({to}, {source}, sizeof({self.style.real}[{roll.count}]));"]

        def load(port: int, e: int) -> str:
            moved = (index, roll.stride) if (port, e) in roll.moving else ()
            return self.buffers.element(ins[port], e, *moved)

        expressions = NestedExpressions(roll.of_first(self.kernel), self.style, load, taken, roll.moving)
        ((o, e, v),) = expressions.kernel.stores
        target = self.buffers.element(outs[o], e, index, roll.stride)
        before = [c for c in expressions.constants if c.is_fixed]
        inside = [c for c in expressions.constants if not c.is_fixed]
        lines = [part for c in before for part in wrap_statement(indent, c.definition(self.style.real))]
        lines.append(f"{indent}for (ptrdiff_t {index} = 0; {index} < {roll.count}; ++{index}) {{")
        inner = [*(c.definition(self.style.real) for c in inside), f"{expressions.assignment(target, v)};"]
        lines += [part for line in inner for part in wrap_statement(indent + "    ", line)]
        return [*lines, indent + "}"]

    def _find_copy(self, roll: Roll) -> tuple[int, int] | None:
        """Return the load of the first element if a roll copies adjacent elements between buffers without overlap."""
        ins = self.kernel.instructions[roll.value]
        if ins.opcode != ca.OP_INPUT or (ins.args[0], ins.args[1]) not in roll.moving:
            return None
        source, target = self.call.ins[ins.args[0]], self.call.outs[roll.output]
        apart = source.buffer != target.buffer and {source.buffer, target.buffer} & set(self.buffers.local)
        adjacent = (source.stride, target.stride, roll.stride) == (1, 1, 1)
        return (ins.args[0], ins.args[1]) if apart and adjacent else None

    def _from(self, s: Slice, e: int) -> Slice:
        """Return the slice from an element on."""
        offset = Affine(s.offset.constant + e, s.offset.terms)
        return replace(s, offset=offset, size=s.size - e)

    # Zeros -----------------------------------------------------------------------------------------------------------

    def _find_cleared(self) -> list[int]:
        """Return the outputs that are whole buffers and have many zeros."""
        zeros = [o for o, _, v in self.kernel.stores if self.kernel.is_zero(v)]
        outs = enumerate(self.call.outs)
        return [o for o, s in outs if zeros.count(o) >= CLEARED and s.size == self.buffers.sizes[s.buffer]]

    def _clear(self, output: int) -> str:
        s = self.call.outs[output]
        name = self.buffers.name(s.buffer)
        local = s.buffer in self.buffers.local
        size = f"sizeof {name}" if local else f"sizeof({self.style.real}[{s.size}])"
        return f"(void)memset({name}, 0, {size});"

    # Loads and notes -------------------------------------------------------------------------------------------------

    def _loads(self, taken: Taken) -> tuple[list[str], dict[tuple[int, int], str]]:
        """Return declarations of the constants that hold loads, and the text of every load.

        A load is held in a constant if it has a name, or if a store of the call may change it.
        """
        kernel, call, local = self.kernel, self.call, self.buffers.local
        texts = {(port, e): self.buffers.element(call.ins[port], e) for port, e in find_loads(kernel)}
        written = {s.buffer for s in call.outs}
        to_parameter = any(buffer not in local for buffer in written)
        computes = any(ins.opcode in OPERATIONS for ins in kernel.instructions)
        declarations: list[str] = []
        for port, group in groupby(sorted(texts), key=lambda load: load[0]):
            s = call.ins[port]
            moves = s.buffer in written or (to_parameter and s.buffer not in local)
            held: list[tuple[str, str]] = []
            for _, e in group:
                wish = self.style.names.signal(self.routine.name, s.buffer, e, s.size)
                if (moves and len(kernel.stores) > 1) or (wish and computes):
                    held.append((taken.of(wish, f"{s.buffer}_{e}"), texts[port, e]))
                    texts[port, e] = held[-1][0]
            declarations += declare(self.style.real, held)
        return declarations, texts

    def _note(self, s: Slice, e: int) -> str:
        """Return the note on an element of a result that is outside loops."""
        if s.buffer in self.buffers.local or s.offset.terms:
            return ""
        element = s.offset.constant + s.stride * e
        return result_note(s.buffer, self.buffers.columns.get(s.buffer, 0), element, self.style.names)
