"""Sweeps: programs of calls to small CasADi Functions inside counted loops, as data.

Three interpreters run the same Sweep: unroll() on SX, which yields one straight-line Function; print_routine(), which
writes C loops that call static leaves; and count. A subtree is fused by unrolling it into a leaf of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from nmpc_codegen.ir.casadi_types import Expression, Function, elements
from nmpc_codegen.ir.kernel import Kernel, OpCount, Port, lift
from nmpc_codegen.ir.print_c import CStyle, comment, print_body, print_kernel, signature


@dataclass(frozen=True)
class Affine:
    """constant + sum of coefficient * loop index."""

    constant: int = 0
    terms: tuple[tuple[str, int], ...] = ()

    def at(self, indices: Mapping[str, int]) -> int:
        """Value for given loop indices."""
        return self.constant + sum(c * indices[i] for i, c in self.terms)

    def c(self) -> str:
        """C text, e.g. ``4 * c + 8``."""
        parts = [i if c == 1 else f"{c} * {i}" for i, c in self.terms]
        if self.constant or not parts:
            parts.append(str(self.constant))
        return " + ".join(parts).replace("+ -", "- ")


@dataclass(frozen=True)
class Slice:
    """``size`` elements of a buffer from an affine offset, ``stride`` apart."""

    buffer: str
    size: int
    offset: Affine = Affine()
    stride: int = 1

    def elements(self, indices: Mapping[str, int]) -> list[int]:
        """Positions in the buffer."""
        start = self.offset.at(indices)
        return [start + self.stride * i for i in range(self.size)]


@dataclass(frozen=True, eq=False)
class Call:
    """outs = leaf(ins). The leaf is an SX Function of dense vectors; equal names are one C function."""

    leaf: Function
    ins: tuple[Slice, ...]
    outs: tuple[Slice, ...]
    inline: bool = False  # print it in its place, whatever its slices are

    @property
    def written_out(self) -> bool:
        """True if the leaf is printed inside its loop instead of being called: its slices are columns of matrices."""
        return self.inline or any(s.stride != 1 and s.size > 1 for s in (*self.ins, *self.outs))


@dataclass(frozen=True, eq=False)
class For:
    """``for index = start .. start + count - 1`` (backwards if ``down``): body; count may depend on outer indices."""

    index: str
    start: int
    count: int | Affine
    body: tuple[Node, ...]
    down: bool = False

    def values(self, indices: Mapping[str, int]) -> range:
        """Index values in the order of the loop."""
        count = self.count if isinstance(self.count, int) else self.count.at(indices)
        values = range(self.start, self.start + count)
        return values[::-1] if self.down else values


Node = Call | For


@dataclass(frozen=True, eq=False)
class Sweep:
    """A named program from input ports to output ports through local buffers (name, size)."""

    name: str
    doc: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    locals: tuple[tuple[str, int], ...]
    body: tuple[Node, ...]


def unroll(sweep: Sweep) -> Function:
    """Run the sweep on SX: one CasADi Function with the sweep's ports; matrices lose their structural zeros."""
    symbols = [ca.SX.sym(p.name, p.size) for p in sweep.inputs]
    buffers: dict[str, list[Expression]] = {p.name: elements(s) for p, s in zip(sweep.inputs, symbols, strict=True)}
    buffers |= {p.name: [ca.SX(0)] * p.size for p in sweep.outputs}
    buffers |= {name: [ca.SX(0)] * size for name, size in sweep.locals}
    _run(sweep.body, buffers, {})
    outputs = [_shaped(buffers[p.name], p) for p in sweep.outputs]
    return ca.Function(sweep.name, symbols, outputs, [p.name for p in sweep.inputs], [p.name for p in sweep.outputs])


def _run(nodes: tuple[Node, ...], buffers: dict[str, list[Expression]], indices: dict[str, int]) -> None:
    for node in nodes:
        if isinstance(node, For):
            for value in node.values(indices):
                _run(node.body, buffers, {**indices, node.index: value})
            continue
        arguments = [ca.vertcat(*(buffers[s.buffer][e] for e in s.elements(indices))) for s in node.ins]
        results = node.leaf.call(arguments)
        for target, result in zip(node.outs, results, strict=True):
            for place, entry in zip(target.elements(indices), elements(ca.densify(result)), strict=True):
                buffers[target.buffer][place] = entry


def _shaped(values: list[Expression], port: Port) -> Expression:
    """A dense SX vector, or an SX matrix of the port's shape without structural zeros."""
    flat = ca.vertcat(*values) if values else ca.SX(0, 1)
    return ca.sparsify(ca.reshape(flat, port.cols, port.rows).T) if port.cols else ca.densify(flat)


def straight(sweep: Sweep) -> Kernel:
    """The sweep as one straight-line Kernel."""
    return lift(unroll(sweep), sweep.name, sweep.doc, sweep.inputs, sweep.outputs)


@dataclass(frozen=True, eq=False)
class LoopedRoutine:
    """A Sweep ready for C: its leaves lifted into Kernels, named after the sweep."""

    sweep: Sweep
    leaves: Mapping[str, Kernel]

    @property
    def name(self) -> str:
        return self.sweep.name

    @property
    def doc(self) -> str:
        return self.sweep.doc

    @property
    def inputs(self) -> tuple[Port, ...]:
        return self.sweep.inputs

    @property
    def outputs(self) -> tuple[Port, ...]:
        return self.sweep.outputs

    @property
    def count(self) -> OpCount:
        """Operations of one run, loops multiplied out."""
        return _count(self.sweep.body, self.leaves, {})

    @property
    def reads(self) -> tuple[Port, ...]:
        """The inputs that a call loads from: the ones that its C function takes."""
        return tuple(p for p in self.inputs if p.name in self.touched)

    @property
    def writes(self) -> tuple[Port, ...]:
        """The outputs that a call loads from or stores to."""
        return tuple(p for p in self.outputs if p.name in self.touched)

    @cached_property
    def touched(self) -> frozenset[str]:
        """Buffers that its text names."""
        return frozenset(b for c in _calls(self.sweep.body) for b in _touched(c, self.leaves[c.leaf.name()]))

    @property
    def statements(self) -> int:
        """Instructions of all calls as they are written, loops once: the size of the code if every leaf is inlined."""
        return sum(len(self.leaves[c.leaf.name()].instructions) for c in _calls(self.sweep.body))

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """The leaves, in the order of their first call."""
        return tuple(self.leaves.values())


Routine = Kernel | LoopedRoutine


def nonzeros(routine: LoopedRoutine) -> dict[str, list[int]]:
    """Elements of every output that are not structurally zero, by running the loops on zero and nonzero alone."""
    sweep = routine.sweep
    buffers = {p.name: [True] * p.size for p in sweep.inputs}
    buffers |= {p.name: [False] * p.size for p in sweep.outputs}
    buffers |= {name: [False] * size for name, size in sweep.locals}
    _mark(sweep.body, routine.leaves, buffers, {})
    return {p.name: [e for e, marked in enumerate(buffers[p.name]) if marked] for p in sweep.outputs}


def _mark(
    nodes: tuple[Node, ...], leaves: Mapping[str, Kernel], buffers: dict[str, list[bool]], indices: dict[str, int]
) -> None:
    for node in nodes:
        if isinstance(node, For):
            alike = not _reads(node.body, node.index)
            for value in node.values(indices):
                before = {name: list(marks) for name, marks in buffers.items()} if alike else None
                _mark(node.body, leaves, buffers, {**indices, node.index: value})
                if buffers == before:
                    break  # every further run would be the same
            continue
        ins = [[buffers[s.buffer][e] for e in s.elements(indices)] for s in node.ins]
        outs = [s.elements(indices) for s in node.outs]
        kernel = leaves[node.leaf.name()]
        marks = kernel.nonzero_values(ins)
        for o, element, value in kernel.stores:
            buffers[node.outs[o].buffer][outs[o][element]] = marks[value]


def _reads(nodes: tuple[Node, ...], index: str) -> bool:
    """True if what the nodes do depends on a loop index."""
    for node in nodes:
        if isinstance(node, For):
            offsets = [] if isinstance(node.count, int) else [node.count]
            if _reads(node.body, index):
                return True
        else:
            offsets = [s.offset for s in (*node.ins, *node.outs)]
        if any(name == index for offset in offsets for name, _ in offset.terms):
            return True
    return False


def looped(sweep: Sweep) -> LoopedRoutine:
    """Lift the leaves of a sweep that is to be emitted as loops.

    Leaves store into buffers that are reused, so every output element is stored, structural zeros too.
    """
    leaves: dict[str, Kernel] = {}
    for call in _calls(sweep.body):
        name = call.leaf.name()
        if name not in leaves:
            inputs = [Port(call.leaf.name_in(i), s.size) for i, s in enumerate(call.ins)]
            outputs = [Port(call.leaf.name_out(i), s.size) for i, s in enumerate(call.outs)]
            kernel = lift(_dense(call.leaf), f"{sweep.name}_{name}", f"{sweep.name}: {name}", inputs, outputs)
            leaves[name] = kernel
    return LoopedRoutine(sweep, leaves)


def _dense(leaf: Function) -> Function:
    symbols = leaf.sx_in()
    return ca.Function(
        leaf.name(), symbols, [ca.densify(o) for o in leaf.call(symbols)], leaf.name_in(), leaf.name_out()
    )


def _calls(nodes: tuple[Node, ...]) -> Iterator[Call]:
    for node in nodes:
        if isinstance(node, For):
            yield from _calls(node.body)
        else:
            yield node


def _count(nodes: tuple[Node, ...], leaves: Mapping[str, Kernel], indices: Mapping[str, int]) -> OpCount:
    total = OpCount()
    for node in nodes:
        if isinstance(node, For):
            values = node.values(indices)
            if any(isinstance(inner, For) and isinstance(inner.count, Affine) for inner in node.body):
                for value in values:
                    total += _count(node.body, leaves, {**indices, node.index: value})
            elif values:
                total += _count(node.body, leaves, {**indices, node.index: values[0]}) * len(values)
        else:
            total += leaves[node.leaf.name()].count
    return total


def print_routine(routine: Routine, style: CStyle) -> str:
    """C text of a routine: one function, preceded by its leaves where it is looped."""
    if isinstance(routine, Kernel):
        return print_kernel(routine, style)
    called = {c.leaf.name() for c in _calls(routine.sweep.body) if not c.written_out}
    texts = [print_kernel(kernel, style) for name, kernel in routine.leaves.items() if name in called]
    sweep, count = routine.sweep, routine.count
    written = ", ".join(f"{v} {k}" for k, v in count.as_dict().items() if v)
    lines = [comment(sweep.doc, routine.reads, routine.writes, written)]
    lines += [signature(sweep.name, routine.reads, routine.writes, style), "{"]
    indices = dict.fromkeys(_indices(sweep.body))
    lines += [f"    {style.real} {name}[{size}];" for name, size in sweep.locals if name in routine.touched]
    if indices:
        lines.append(f"    int {', '.join(indices)};")
    lines += _print_nodes(sweep.body, routine, style, "    ")
    return "\n\n".join([*texts, "\n".join([*lines, "}"])])


def _touched(call: Call, leaf: Kernel) -> Iterator[str]:
    """Buffers that the text of a call names: those that its leaf loads or stores."""
    yield from (s.buffer for s in _passed(call, leaf))


def _passed(call: Call, leaf: Kernel) -> Iterator[Slice]:
    """The slices of a call that its leaf loads or stores: the arguments of its C function."""
    yield from (s for s, port in zip(call.ins, leaf.inputs, strict=True) if port in leaf.reads)
    yield from (s for s, port in zip(call.outs, leaf.outputs, strict=True) if port in leaf.writes)


def _indices(nodes: tuple[Node, ...]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, For):
            yield node.index
            yield from _indices(node.body)


def _print_nodes(nodes: tuple[Node, ...], routine: LoopedRoutine, style: CStyle, indent: str) -> list[str]:
    lines: list[str] = []
    for node in nodes:
        if isinstance(node, For):
            lines.append(indent + _head(node))
            lines += _print_nodes(node.body, routine, style, indent + "    ")
            lines.append(indent + "}")
        elif node.written_out and len(nodes) > 1:
            lines += [indent + "{", *_print_call(node, routine, style, indent + "    "), indent + "}"]
        else:
            lines += _print_call(node, routine, style, indent)
    return lines


def _head(loop: For) -> str:
    i, first = loop.index, loop.start
    count = Affine(loop.count) if isinstance(loop.count, int) else loop.count
    last = Affine(count.constant + first, count.terms)
    if loop.down:
        return f"for ({i} = {Affine(last.constant - 1, last.terms).c()}; {i} >= {first}; {i}--) {{"
    return f"for ({i} = {first}; {i} < {last.c()}; {i}++) {{"


def _print_call(call: Call, routine: LoopedRoutine, style: CStyle, indent: str) -> list[str]:
    """A call of a static leaf; a leaf on strided slices is written out, so that the loop around it vectorises."""
    kernel = routine.leaves[call.leaf.name()]
    if not call.written_out:
        arguments = (f"&{s.buffer}[{s.offset.c()}]" for s in _passed(call, kernel))
        return [f"{indent}{kernel.name}({', '.join(arguments)});"]

    def element(slices: tuple[Slice, ...], port: int, e: int) -> str:
        s = slices[port]
        return f"{s.buffer}[{Affine(s.offset.constant + s.stride * e, s.offset.terms).c()}]"

    body = print_body(
        kernel, style, lambda port, e: element(call.ins, port, e), lambda port, e: element(call.outs, port, e)
    )
    return [indent + line.removeprefix("    ") for line in body]
