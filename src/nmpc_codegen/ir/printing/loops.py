"""Sweeps are printed as C functions with loops.

A sweep that is too long for one function is cut where comments begin: one function per stage and direction, on scratch
memory in a struct with a comment on each member.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.constant_names import Taken
from nmpc_codegen.ir.printing.kernels import (
    LONGEST_FUNCTION,
    comment,
    first_short,
    parameters,
    pointer,
    print_count,
    print_kernel,
    wrapped_head,
)
from nmpc_codegen.ir.printing.leaves import Buffers, Leaf
from nmpc_codegen.ir.printing.nested_expressions import wrap_statement
from nmpc_codegen.ir.printing.stages import STAGE, Piece, StageLoop, cut, flat, note_of, once
from nmpc_codegen.ir.sweep import Affine, Call, For, LoopedRoutine, Node, Slice, Written, calls, passed_slices
from nmpc_codegen.ir.tuning import PANEL

#: SHORT_PIECES: largest lengths of pieces of a sweep without their own functions; the first one is used with which the
#: sweep is short enough. SHORT_LEAF: largest length of a leaf that is called once and has no function.
SHORT_PIECES, SHORT_LEAF = (6, 3, 0), 8


def print_loops(routine: LoopedRoutine, style: CStyle) -> str:
    """Return the C functions of the leaves that are called, and then the functions of the sweep."""
    printer = _Printer(routine, style)
    called = {routine.leaves[c.leaf.name()] for c in calls(routine.sweep.body) if not printer.is_inline(c)}
    texts = [print_kernel(kernel, style) for kernel in routine.kernels if kernel in called]
    whole, length = printer.whole()
    if length <= LONGEST_FUNCTION:
        return "\n\n".join([*texts, whole])
    cuts = (Pieces(printer, longest) for longest in SHORT_PIECES)
    return "\n\n".join([*texts, *first_short(cuts, lambda cut: cut.main()[1]).texts()])


class _Printer:
    """A printer prints the nodes of one sweep."""

    def __init__(self, routine: LoopedRoutine, style: CStyle) -> None:
        sweep = routine.sweep
        self.routine, self.style = routine, style
        self.ports = (*routine.reads, *routine.writes)
        self.pointer = pointer(self.ports)
        rows = {name: sweep.columns[name] for name, size in sweep.locals if sweep.columns.get(name, size) < size}
        columns = rows | {p.name: p.cols for p in self.ports if p.cols}
        local = {name: size for name, size in sweep.locals if size and name in routine.touched}
        sizes = dict(sweep.locals) | {p.name: p.size for p in (*sweep.inputs, *sweep.outputs)}
        self.buffers = Buffers(sizes, columns, local, {})
        self.names = {*local, *(p.name for p in self.ports), *_indices(sweep.body), self.pointer, STAGE}
        self._inline: dict[tuple[str, tuple[Slice, ...], tuple[Slice, ...]], bool] = {}
        self.uses: dict[str, int] = {}
        for c in calls(sweep.body):
            self.uses[c.leaf.name()] = self.uses.get(c.leaf.name(), 0) + 1

    def whole(self) -> tuple[str, int]:
        """Return the sweep as one function."""
        body = Body(self, self.buffers).nodes(self.routine.sweep.body, "    ")
        return self.sweep(self.declarations(self.buffers.local), body)

    def sweep(self, *parts: Sequence[str]) -> tuple[str, int]:
        """Return the function of the sweep with its comment, and its number of lines without the comment."""
        r = self.routine
        text, length = self.function(r.name, self.arguments(), *parts)
        return f"{comment(r.doc, r.reads, r.writes, print_count(r.count))}\n{text}", length

    def function(self, name: str, arguments: Sequence[str], *parts: Sequence[str]) -> tuple[str, int]:
        """Return the text of a function, and its number of lines."""
        head = wrapped_head(f"static void {name}({', '.join(arguments)})")
        lines = [*head, "{", *(line for part in parts for line in part), "}"]
        return "\n".join(lines), len(lines)

    def arguments(self, used: Iterable[str] | None = None) -> list[str]:
        """Return the parameters for the ports, or for the used ones."""
        names = None if used is None else set(used)
        ports = [p for p in self.ports if names is None or p.name in names]
        return parameters(ports, self.routine.writes, self.style)

    def declarations(self, local: Iterable[str]) -> list[str]:
        """Return declarations of local buffers."""
        names = [name for name in self.buffers.local if name in set(local)]
        return [f"    {self.member(name)}" for name in names]

    def member(self, name: str) -> str:
        """Return the declaration of a local buffer, or of a member of scratch memory, with a comment on its content."""
        meaning = self.routine.sweep.meanings.get(name, "")
        return f"{self.style.real} {name}{self.sizes(name)};" + (f" /* {meaning} */" if meaning else "")

    def sizes(self, name: str) -> str:
        """Return the sizes of a local buffer in its declaration."""
        columns, size = self.buffers.columns.get(name), self.buffers.local[name]
        return f"[{size // columns}][{columns}]" if columns else f"[{size}]" if size > 1 else ""

    def is_inline(self, call: Call) -> bool:
        """Return True if a leaf is printed where it is called: it has to be, is a loop over elements, or is short."""
        if call.written_out:
            return True
        key = (call.leaf.name(), call.ins, call.outs)
        if key not in self._inline:
            self._inline[key] = self._is_short(call)
        return self._inline[key]

    def _is_short(self, call: Call) -> bool:
        leaf = Leaf(self.routine, call, self.buffers, self.style)
        if leaf.is_loop or self.uses[call.leaf.name()] > 1:
            return leaf.is_loop
        return len(leaf.lines("", "i", Taken(self.style.names, self.names))) <= SHORT_LEAF


class Body:
    """A body has the statements of nodes in one function, with its own access to buffers."""

    def __init__(self, printer: _Printer, buffers: Buffers) -> None:
        self.printer, self.routine, self.buffers = printer, printer.routine, buffers
        self.taken = Taken(printer.style.names, printer.names)
        self.indices: tuple[str, ...] = ()
        self.largest: dict[str, int] = {}

    def nodes(self, nodes: tuple[Node, ...], indent: str, note: str = "") -> list[str]:
        """Return the statements of a block, with a comment where a stage begins.

        ``note`` is the last comment above it.
        """
        lines: list[str] = []
        for node in once(nodes):
            of = note_of(node) or note
            if of != note:
                lines.append(f"{indent}/* {of} */")
            note = of
            lines += self.node(node, indent, note)
        return lines

    def node(self, node: Node, indent: str, note: str) -> list[str]:
        """Return the statements of a node."""
        if isinstance(node, Written):
            return wrap_statement(indent, self._print_written(node))
        if isinstance(node, Call):
            return self._print_call(node, indent)
        assert isinstance(node, For), "other blocks are printed in a frame"
        return [*self.enter(node, indent), *self.nodes(node.body, indent + "    ", note), *self.leave(indent)]

    def enter(self, loop: For, indent: str) -> list[str]:
        """Return the head of a loop and open its scope."""
        last = loop.count if isinstance(loop.count, int) else self._most(loop.count)
        self.largest[loop.index] = loop.start + last - 1
        self.indices = (*self.indices, loop.index)
        return [indent + head(loop)]

    def leave(self, indent: str) -> list[str]:
        """Return the end of the innermost loop and close its scope."""
        self.indices = self.indices[:-1]
        return [indent + "}"]

    def _most(self, value: Affine) -> int:
        return value.constant + sum(c * (self.largest[i] if c > 0 else 0) for i, c in value.terms)

    def _print_call(self, call: Call, indent: str) -> list[str]:
        if self.printer.is_inline(call):
            index = next(i for i in ("i", "j", "n", "m") if i not in self.indices)
            return Leaf(self.routine, call, self.buffers, self.printer.style).lines(indent, index, self.taken)
        kernel = self.routine.leaves[call.leaf.name()]
        ports = (*kernel.reads, *kernel.writes)
        passed = zip(passed_slices(call, kernel), ports, strict=True)
        arguments = ", ".join(self.buffers.name(s.buffer) if p.cols else self.buffers.address(s) for s, p in passed)
        return wrap_statement(indent, f"{kernel.name}({arguments});")

    def _print_written(self, node: Written) -> str:
        texts = (s if isinstance(s, str) else self.buffers.address(s) for s in (*node.ins, *node.outs))
        return f"{node.function}({', '.join(texts)});"


class Pieces:
    """A sweep that is cut into functions on scratch memory."""

    def __init__(self, printer: _Printer, longest: int) -> None:
        self.printer, self.routine, self.style = printer, printer.routine, printer.style
        self.pieces = cut(self.routine.sweep.body, self.routine.leaves)
        self.functions: list[Piece] = []
        self.largest = dict(_largest(self.pieces))
        names = {kernel.name for kernel in self.routine.leaves.values()}
        for piece in flat(self.pieces):
            lines = Body(printer, printer.buffers).nodes(tuple(piece.nodes), "", piece.note)
            if len(lines) > longest or any(line.startswith("const ") for line in lines):
                piece.name = self._name(piece.note, names)
                names.add(piece.name)
                self.functions.append(piece)
        self.shared = self._find_shared()

    def _name(self, note: str, names: set[str]) -> str:
        name = f"{self.routine.name}_{re.sub(r'[^a-z0-9]+', '_', note.lower()) or 'part'}"
        numbered = (name if n == 1 else f"{name}_{n}" for n in range(1, len(names) + 2))
        return next(n for n in numbered if n not in names)

    def _find_shared(self) -> list[str]:
        """Return the local buffers that are members of the scratch memory: those that several functions need.

        Buffers whose size is a multiple of a panel come first, so that their rows stay aligned as in separate arrays.
        """
        places: dict[str, set[int]] = {}
        loaded: set[str] = set()
        for piece in flat(self.pieces):
            first: dict[str, bool] = {}
            for s, is_written in self._slices(piece.nodes):
                first.setdefault(s.buffer, is_written)
                places.setdefault(s.buffer, set()).add(id(piece) if piece.name else 0)
            loaded |= {buffer for buffer, is_written in first.items() if piece.name and not is_written}
        local = self.printer.buffers.local
        found = [name for name in local if len(places.get(name, ())) > 1 or name in loaded]
        return sorted(found, key=lambda name: local[name] % PANEL > 0)

    def _slices(self, nodes: Sequence[Node]) -> Iterator[tuple[Slice, bool]]:
        """Yield (slice, True if it is written) for all loads and stores of nodes, in the order of execution."""
        for node in nodes:
            if isinstance(node, Call):
                kernel = self.routine.leaves[node.leaf.name()]
                yield from ((s, False) for s, p in zip(node.ins, kernel.inputs, strict=True) if p in kernel.reads)
                yield from ((s, True) for s, p in zip(node.outs, kernel.outputs, strict=True) if p in kernel.writes)
            elif isinstance(node, Written):
                yield from ((s, False) for s in node.ins if isinstance(s, Slice))
                yield from ((s, True) for s in node.outs)
            else:
                yield from self._slices(node.body)

    @property
    def scratch(self) -> str:
        """Return the type of the scratch memory."""
        return f"{self.routine.name}_scratch_t"

    def texts(self) -> list[str]:
        """Return the struct, the functions of the pieces, and the function of the sweep."""
        functions = [self._function(piece) for piece in self.functions]
        return [*([self._struct()] if self.shared else []), *functions, self.main()[0]]

    def _struct(self) -> str:
        lines = [f"typedef struct {{ /* scratch memory of {self.routine.name} */"]
        lines += [f"    {self.printer.member(name)}" for name in self.shared]
        return "\n".join([*lines, f"}} {self.scratch};"])

    def _buffers(self, mark: str) -> Buffers:
        of = self.printer.buffers
        return Buffers(of.sizes, of.columns, of.local, dict.fromkeys(self.shared, f"{self.printer.pointer}{mark}"))

    def _find_uses(self, piece: Piece) -> tuple[set[str], list[str], bool, bool]:
        """Return what a piece uses: ports and local buffers, indices of loops around it, and two flags.

        The flags are True if the piece uses, or changes, scratch memory.
        """
        found, nodes, shared = list(self._slices(piece.nodes)), tuple(piece.nodes), set(self.shared)
        names = {s.buffer for s, _ in found} | set(_texts(nodes))
        changed = {s.buffer for s, is_written in found if is_written}
        around = {i for s, _ in found for i, _ in s.offset.terms} - _indices(nodes)
        return names, sorted(around), bool(names & shared), bool(changed & shared)

    def _function(self, piece: Piece) -> str:
        names, indices, uses, changes = self._find_uses(piece)
        arguments = [*self.printer.arguments(names), *(f"ptrdiff_t {i}" for i in indices)]
        arguments += [f"{'' if changes else 'const '}{self.scratch} *{self.printer.pointer}"] if uses else []
        body = Body(self.printer, self._buffers("->"))
        body.largest = self.largest
        lines = body.nodes(tuple(piece.nodes), "    ", piece.note)
        declared = self.printer.declarations(names - set(self.shared))
        text, _ = self.printer.function(piece.name, arguments, declared, lines)
        return f"/* {self.routine.name}: {piece.note} */\n{text}"

    def main(self) -> tuple[str, int]:
        """Return the function of the sweep, which calls the functions of the pieces, and its number of lines."""
        body = Body(self.printer, self._buffers("."))
        lines = self._print(body, self.pieces, "    ")
        own = {s.buffer for p in flat(self.pieces) if not p.name for s, _ in self._slices(p.nodes)}
        declared = self.printer.declarations(own - set(self.shared))
        scratch = [f"    {self.scratch} {self.printer.pointer};"] if self.shared else []
        return self.printer.sweep(scratch, declared, lines)

    def _print(self, body: Body, pieces: Iterable[Piece | StageLoop], indent: str) -> list[str]:
        lines: list[str] = []
        for piece in pieces:
            if isinstance(piece, StageLoop):
                inner = body.enter(piece.loop, indent)
                lines += [*inner, *self._print(body, piece.pieces, indent + "    "), *body.leave(indent)]
            elif piece.name:
                lines += self._call(piece, indent)
            else:
                lines += body.nodes(tuple(piece.nodes), indent)
        return lines

    def _call(self, piece: Piece, indent: str) -> list[str]:
        names, indices, uses, _ = self._find_uses(piece)
        passed = [p.name for p in self.printer.ports if p.name in names]
        arguments = [*passed, *indices, *([f"&{self.printer.pointer}"] if uses else [])]
        return wrap_statement(indent, f"{piece.name}({', '.join(arguments)});")


def _largest(pieces: Iterable[Piece | StageLoop]) -> Iterator[tuple[str, int]]:
    """Yield (index, its largest value) of the loops around pieces."""
    for piece in pieces:
        if isinstance(piece, StageLoop):
            assert isinstance(piece.loop.count, int)
            yield piece.loop.index, piece.loop.start + piece.loop.count - 1
            yield from _largest(piece.pieces)


def _texts(nodes: tuple[Node, ...]) -> Iterator[str]:
    """Yield the words of arguments that are texts."""
    for node in nodes:
        if isinstance(node, Written):
            yield from (word for s in node.ins if isinstance(s, str) for word in re.findall(r"\w+", s))
        elif not isinstance(node, Call):
            yield from _texts(node.body)


def _indices(nodes: tuple[Node, ...]) -> set[str]:
    loops = [node for node in nodes if isinstance(node, For)]
    return {node.index for node in loops}.union(*(_indices(node.body) for node in loops))


def head(loop: For) -> str:
    """Return ``for (ptrdiff_t i = 0; i < 4; ++i) {``."""
    i, first = loop.index, loop.start
    count = Affine(loop.count) if isinstance(loop.count, int) else loop.count
    last = Affine(count.constant + first, count.terms)
    if loop.down:
        return f"for (ptrdiff_t {i} = {Affine(last.constant - 1, last.terms).c()}; {i} >= {first}; --{i}) {{"
    return f"for (ptrdiff_t {i} = {first}; {i} < {last.c()}; ++{i}) {{"
