"""Sweeps as C functions with loops: calls of static leaves, or their text where it stands in a loop over columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby

import casadi as ca

from nmpc_codegen.ir.kernel import OPERATIONS, Instruction, Kernel
from nmpc_codegen.ir.passes import bound
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.expressions import Expressions, declare, wrap_statement
from nmpc_codegen.ir.printing.kernels import (
    comment,
    find_loads,
    print_count,
    print_kernel,
    result_note,
    signature,
    statement,
    wrapped_head,
)
from nmpc_codegen.ir.printing.local_names import Taken
from nmpc_codegen.ir.sweep import Affine, Call, For, LoopedRoutine, Node, Slice, Written, calls, passed_slices

#: So many elements that receive the same number are one statement, and so many zeros one call.
CHAIN, CLEARED = 3, 16


def print_loops(routine: LoopedRoutine, style: CStyle) -> str:
    """The C functions of the leaves that are called, and that of the sweep."""
    sweep = routine.sweep
    called = {c.leaf.name() for c in calls(sweep.body) if not c.written_out}
    texts = [print_kernel(kernel, style) for name, kernel in routine.leaves.items() if name in called]
    lines = [
        comment(sweep.doc, routine.reads, routine.writes, print_count(routine.count)),
        *wrapped_head(signature(sweep.name, routine.reads, routine.writes, style)),
        "{",
        *_Printer(routine, style).body(),
        "}",
    ]
    return "\n\n".join([*texts, "\n".join(lines)])


class _Printer:
    """Text of the nodes of one sweep."""

    def __init__(self, routine: LoopedRoutine, style: CStyle) -> None:
        sweep = routine.sweep
        self.routine, self.style = routine, style
        ports = (*routine.reads, *routine.writes)
        rows = {name: sweep.columns[name] for name, size in sweep.locals if sweep.columns.get(name, size) < size}
        self.columns: Mapping[str, int] = rows | {p.name: p.cols for p in ports if p.cols}
        self.locals = {name: size for name, size in sweep.locals if size and name in routine.touched}
        self.sizes = dict(sweep.locals) | {p.name: p.size for p in (*sweep.inputs, *sweep.outputs)}
        self.names = {*self.locals, *(p.name for p in ports), *_indices(sweep.body)}
        self.largest: dict[str, int] = {}

    def body(self) -> list[str]:
        """Declarations of the local buffers, and all nodes."""
        arrays = [f"{name}{self._sizes(name, size)}" for name, size in self.locals.items()]
        lines = wrap_statement("    ", f"{self.style.real} {', '.join(arrays)};") if arrays else []
        return lines + self.nodes(self.routine.sweep.body, "    ")

    def _sizes(self, name: str, size: int) -> str:
        columns = self.columns.get(name)
        return f"[{size // columns}][{columns}]" if columns else f"[{size}]" if size > 1 else ""

    def nodes(self, nodes: tuple[Node, ...], indent: str, note: str = "") -> list[str]:
        """The statements of a block, with a comment where a stage begins; ``note``: the last one above it."""
        lines: list[str] = []
        nodes = tuple(_once(nodes))
        for node in nodes:
            notes = {c.heading(c.step, self.routine.sweep.steps) for c in calls((node,)) if c.note}
            of = notes.pop() if len(notes) == 1 else note
            if of and of != note:
                lines.append(f"{indent}/* {of} */")
            note = of
            lines += self._node(node, indent, len(nodes) == 1, note)
        return lines

    def _node(self, node: Node, indent: str, alone: bool, note: str) -> list[str]:
        if isinstance(node, Written):
            return wrap_statement(indent, self._print_written(node))
        if isinstance(node, Call):
            return self._print_leaf(node, indent, alone) if node.written_out else [indent + self._print_call(node)]
        assert isinstance(node, For), "other blocks are printed in a frame"
        last = node.count if isinstance(node.count, int) else self._most(node.count)
        self.largest[node.index] = node.start + last - 1
        return [indent + head(node), *self.nodes(node.body, indent + "    ", note), indent + "}"]

    def _most(self, value: Affine) -> int:
        return value.constant + sum(c * (self.largest[i] if c > 0 else 0) for i, c in value.terms)

    def _print_call(self, call: Call) -> str:
        kernel = self.routine.leaves[call.leaf.name()]
        return f"{kernel.name}({', '.join(map(self._address, passed_slices(call, kernel)))});"

    def _print_written(self, node: Written) -> str:
        texts = (s if isinstance(s, str) else self._address(s) for s in (*node.ins, *node.outs))
        return f"{node.function}({', '.join(texts)});"

    def _address(self, s: Slice) -> str:
        columns = self.columns.get(s.buffer)
        text = self.element(s, 0)
        if columns and s.size <= columns and text.endswith("[0]"):
            return text.removesuffix("[0]")
        return s.buffer if text == f"{s.buffer}[0]" else f"&{text}"

    def _is_number(self, buffer: str) -> bool:
        """True for a local buffer of one element, which is no array."""
        return self.locals.get(buffer) == 1 and buffer not in self.columns

    def element(self, s: Slice, e: int) -> str:
        """C text of an element of a slice."""
        constant, columns = s.offset.constant + s.stride * e, self.columns.get(s.buffer)
        if self._is_number(s.buffer):
            return s.buffer
        if not columns:
            return f"{s.buffer}[{Affine(constant, s.offset.terms).c()}]"
        row, column = Affine(constant, s.offset.terms).split(columns)
        assert self._most(column) < columns, f"{self.routine.name}: {s} leaves a row of {columns}"
        return f"{s.buffer}[{row.c()}][{column.c()}]"

    def _print_leaf(self, call: Call, indent: str, alone: bool) -> list[str]:
        """The statements of a leaf; in braces if they declare constants beside other nodes."""
        kernel = self.routine.leaves[call.leaf.name()]
        taken = Taken(self.style.names, self.names)
        declarations, texts = self._loads(call, kernel, taken)
        expressions = Expressions(kernel, self.style, lambda port, e: texts[port, e], taken)
        constants = [*declarations, *expressions.statements]
        inner = indent if alone or not constants else indent + "    "
        lines = [part for line in constants for part in wrap_statement(inner, line)]
        lines += self._stores(call, kernel, expressions, inner)
        return lines if inner == indent else [indent + "{", *lines, indent + "}"]

    def _loads(self, call: Call, kernel: Kernel, taken: Taken) -> tuple[list[str], dict[tuple[int, int], str]]:
        """Declarations of the constants that hold loads, and the text of every load.

        A load is held if it has a name, or if a store of the call may change it.
        """
        texts = {(port, e): self.element(call.ins[port], e) for port, e in find_loads(kernel)}
        written = {s.buffer for s in call.outs}
        to_parameter = any(buffer not in self.locals for buffer in written)
        computes = any(ins.opcode in OPERATIONS for ins in kernel.instructions)
        declarations: list[str] = []
        for port, group in groupby(sorted(texts), key=lambda load: load[0]):
            s = call.ins[port]
            moves = s.buffer in written or (to_parameter and s.buffer not in self.locals)
            held: list[tuple[str, str]] = []
            for _, e in group:
                wish = self.style.names.signal(self.routine.name, s.buffer, e, s.size)
                if (moves and len(kernel.stores) > 1) or (wish and computes):
                    held.append((taken.of(wish, f"{s.buffer}_{e}"), texts[port, e]))
                    texts[port, e] = held[-1][0]
            declarations += declare(self.style.real, held)
        return declarations, texts

    def _stores(self, call: Call, kernel: Kernel, expressions: Expressions, indent: str) -> list[str]:
        """The stores of a leaf; a number that several elements in a row receive is one statement."""
        lines, rest = self._print_clearing(call, kernel, indent)
        numbers: dict[str, list[tuple[int, int, int]]] = {}
        for store in rest:
            if kernel.instructions[store[2]].opcode == ca.OP_CONST:
                numbers.setdefault(expressions.text(store[2]), []).append(store)
        equal = {text: stores for text, stores in numbers.items() if len(stores) >= CHAIN}
        for text, stores in equal.items():
            targets = [self.element(call.outs[o], e) for o, e, _ in stores]
            lines += wrap_statement(indent, f"{' = '.join(targets)} = {text};")
        for o, e, v in rest:
            if kernel.instructions[v].opcode != ca.OP_CONST or expressions.text(v) not in equal:
                target = self.element(call.outs[o], e)
                lines += statement(indent, expressions.assignment(target, v), self._note(call.outs[o], e))
        return lines

    def _print_clearing(self, call: Call, kernel: Kernel, indent: str) -> tuple[list[str], list[tuple[int, int, int]]]:
        """Calls that clear the buffers which are zero but for some elements, and the stores that remain."""
        zeros = [s for s in kernel.stores if kernel.instructions[s[2]] == Instruction(ca.OP_CONST, ())]
        lines: list[str] = []
        for o, s in enumerate(call.outs):
            those = [store for store in zeros if store[0] == o]
            if len(those) >= CLEARED and s.size == self.sizes[s.buffer]:
                size = f"sizeof {s.buffer}" if s.buffer in self.locals else f"{s.size} * sizeof {self.element(s, 0)}"
                lines.append(f"{indent}memset({s.buffer}, 0, {size});")
            else:
                zeros = [store for store in zeros if store[0] != o]
        return lines, [store for store in kernel.stores if store not in zeros]

    def _note(self, s: Slice, e: int) -> str:
        """What an element of a result is, where no loop runs over it."""
        if s.buffer in self.locals or s.offset.terms:
            return ""
        element = s.offset.constant + s.stride * e
        return result_note(s.buffer, self.columns.get(s.buffer, 0), element, self.style.names)


def _once(nodes: tuple[Node, ...]) -> Iterator[Node]:
    """The nodes, with what a loop runs once in its place."""
    for node in nodes:
        if isinstance(node, For) and node.count == 1:
            yield from _once(tuple(bound(inner, node.index, node.start) for inner in node.body))
        else:
            yield node


def _indices(nodes: tuple[Node, ...]) -> set[str]:
    loops = [node for node in nodes if isinstance(node, For)]
    return {node.index for node in loops}.union(*(_indices(node.body) for node in loops))


def head(loop: For) -> str:
    """``for (ptrdiff_t i = 0; i < 4; ++i) {``."""
    i, first = loop.index, loop.start
    count = Affine(loop.count) if isinstance(loop.count, int) else loop.count
    last = Affine(count.constant + first, count.terms)
    if loop.down:
        return f"for (ptrdiff_t {i} = {Affine(last.constant - 1, last.terms).c()}; {i} >= {first}; --{i}) {{"
    return f"for (ptrdiff_t {i} = {first}; {i} < {last.c()}; ++{i}) {{"
