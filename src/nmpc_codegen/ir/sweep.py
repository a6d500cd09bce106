"""Sweeps are programs of calls to small CasADi Functions inside counted loops, represented as data.

Three interpreters run the same Sweep: unroll() on SX, which yields one straight-line Function; printing/loops.py, which
writes C loops; and LoopedRoutine.count, which counts operations.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import casadi as ca

from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.ir.kernel import Kernel, Port, Watched, lift
from nmpc_codegen.package.opcount import OpCount


@dataclass(frozen=True)
class Affine:
    """An affine index is constant + sum of coefficient * loop index."""

    constant: int = 0
    terms: tuple[tuple[str, int], ...] = ()

    def at(self, indices: Mapping[str, int]) -> int:
        """Return the value for given loop indices."""
        return self.constant + sum(c * indices[i] for i, c in self.terms)

    def split(self, columns: int) -> tuple[Affine, Affine]:
        """Return row and column of an element of a matrix with ``columns`` columns."""
        row, column = divmod(self.constant, columns)
        column = column if row else self.constant  # a Size keeps its text
        along = tuple((i, c // columns) for i, c in self.terms if c % columns == 0)
        return Affine(row, along), Affine(column, tuple((i, c) for i, c in self.terms if c % columns))

    def at_one(self, index: str, value: int) -> int:
        """Return the constant plus the term of one index at one of its values."""
        return self.constant + sum(c * value for i, c in self.terms if i == index)

    def c(self) -> str:
        """Return the C text, e.g. ``4 * c + 8``."""
        parts = [i if c == 1 else f"{c} * {i}" for i, c in self.terms]
        if self.constant or not parts:
            parts.append(str(self.constant))
        return " + ".join(parts).replace("+ -", "- ")


@dataclass(frozen=True)
class Slice:
    """A slice has ``size`` elements of a buffer from an affine offset, ``stride`` apart."""

    buffer: str
    size: int
    offset: Affine = Affine()
    stride: int = 1

    def elements(self, indices: Mapping[str, int]) -> list[int]:
        """Return the positions in the buffer."""
        start = self.offset.at(indices)
        return [start + self.stride * i for i in range(self.size)]


@dataclass(frozen=True, eq=False)
class Call:
    """A call is outs = leaf(ins).

    The leaf is an SX Function of dense vectors, and leaves of equal names are one C function.

    inline: the leaf is printed inline, whatever its slices are. direct: a result may be stored before the next one is
    computed, as no later result reads it. keeps_zeros: structural zeros of the results are not stored, because the
    buffers already hold them. note: comment on the computation. stage: number of the stage of the scheme, counted from
    0.
    """

    leaf: Function
    ins: tuple[Slice, ...]
    outs: tuple[Slice, ...]
    inline: bool = False
    direct: bool = False
    keeps_zeros: bool = False
    note: str = ""
    stage: int = -1

    @property
    def written_out(self) -> bool:
        """Return True if the leaf is printed inline: ``inline`` is set, or its slices are columns."""
        return self.inline or any(s.stride != 1 and s.size > 1 for s in (*self.ins, *self.outs))

    def heading(self, step: int, steps: int) -> str:
        """Return the note, with the step if there are several."""
        return f"step {step + 1}, {self.note}" if self.note and steps > 1 and step >= 0 else self.note


@dataclass(frozen=True, eq=False)
class Written:
    """A written call is outs = function(ins) of a C function in a part, whose text is handwritten.

    ins: slices, or texts of arguments; count: operations of one run; kernels: kernels that it evaluates; nonzeros:
    elements of outs in these buffers that may be nonzero; in other buffers all.
    """

    function: str
    ins: tuple[Slice | str, ...]
    outs: tuple[Slice, ...]
    count: OpCount
    kernels: tuple[Kernel, ...] = ()
    nonzeros: Mapping[str, frozenset[int]] = field(default_factory=dict)

    @property
    def slices(self) -> tuple[Slice, ...]:
        """Return the slices among the arguments of the call."""
        return (*(s for s in self.ins if isinstance(s, Slice)), *self.outs)


@dataclass(frozen=True, eq=False)
class For:
    """A loop ``for index = start .. start + count - 1`` (backwards if ``down``); count may depend on outer indices."""

    index: str
    start: int
    count: int | Affine
    body: tuple[Node, ...]
    down: bool = False

    def values(self, indices: Mapping[str, int]) -> range:
        """Return the values of the index in the order of execution."""
        count = self.count if isinstance(self.count, int) else self.count.at(indices)
        values = range(self.start, self.start + count)
        return values[::-1] if self.down else values

    def passes(self, indices: Mapping[str, int]) -> Iterator[Mapping[str, int]]:
        """Yield the index that each iteration of the body sets, by name."""
        return ({self.index: value} for value in self.values(indices))


@dataclass(frozen=True, eq=False)
class Entries:
    """A loop runs over the entries n = first .. last - 1 of tables, whose values are bound to names.

    ``tables`` holds (name, C name of the table, its values), all of one length.
    """

    index: str
    tables: tuple[tuple[str, str, tuple[int, ...]], ...]
    first: int
    last: int
    body: tuple[Node, ...]

    def passes(self, indices: Mapping[str, int]) -> Iterator[Mapping[str, int]]:
        """Yield the indices that each iteration of the body sets, by name."""
        for n in range(self.first, self.last):
            yield {self.index: n, **{name: values[n] for name, _, values in self.tables}}


@dataclass(frozen=True, eq=False)
class If:
    """A condition ``left relation right`` guards its body: ``left`` is an index, ``right`` an index or a number."""

    left: str
    relation: Literal["<", "!="]
    right: str | int
    body: tuple[Node, ...]

    def passes(self, indices: Mapping[str, int]) -> Iterator[Mapping[str, int]]:
        """Yield one run of the body, which sets no index, if the condition holds."""
        left, right = indices[self.left], indices[self.right] if isinstance(self.right, str) else self.right
        if left < right if self.relation == "<" else left != right:
            yield {}


Block = For | Entries | If
Node = Call | Written | Block

#: Stage number of calls that compute the first stage point of the next step.
NEXT_STEP = -2


def add_notes(nodes: Iterable[Node], note: str, stage: int = -1) -> list[Node]:
    """Return the nodes, with a note and a stage added to those calls that have none."""
    marked: list[Node] = []
    for node in nodes:
        if isinstance(node, Call):
            marked.append(node if node.note else replace(node, note=note, stage=stage))
        elif isinstance(node, Block):
            marked.append(replace(node, body=tuple(add_notes(node.body, note, stage))))
        else:
            marked.append(node)
    return marked


@dataclass(frozen=True)
class Place:
    """The C text of a buffer that is a scalar (shape ()), a vector or a matrix (rows, columns)."""

    text: str
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Frame:
    """A frame is the C function of a sweep whose buffers are members of structs: parameters and places of buffers."""

    parameters: tuple[str, ...]
    places: Mapping[str, Place]
    inline: bool = False


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep is a named program from input ports to output ports through local buffers (name, size).

    columns: {local buffer that is a matrix: length of its rows}. steps: number of steps of a scheme, whose loop is
    "step". meanings: {local buffer: its content}, for comments.
    """

    name: str
    doc: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    locals: tuple[tuple[str, int], ...]
    body: tuple[Node, ...]
    frame: Frame | None = None
    columns: Mapping[str, int] = field(default_factory=dict)
    steps: int = 1
    meanings: Mapping[str, str] = field(default_factory=dict)


def unroll(sweep: Sweep) -> Function:
    """Run the sweep on SX and return one CasADi Function with the sweep's ports; matrices lose structural zeros.

    A port that is changed in place becomes the input <name> and the output <name>_out.
    """
    return _unroll(sweep, None)


def _unroll(sweep: Sweep, watched: list[Watched] | None) -> Function:
    """Unroll a sweep; with ``watched``, the results of all calls are a last output, which the list describes."""
    symbols = [ca.SX.sym(p.name, p.size) for p in sweep.inputs]
    buffers: dict[str, Expression] = {p.name: ca.SX.zeros(p.size) for p in sweep.outputs}
    buffers |= {p.name: ca.SX(s) for p, s in zip(sweep.inputs, symbols, strict=True)}
    buffers |= {name: ca.SX.zeros(size) for name, size in sweep.locals}
    seen: list[Expression] = []

    def watch(call: Call, step: int, results: Sequence[Expression]) -> None:
        if watched is not None:
            watched.extend(_watch(call, step, sweep.steps))
            seen.extend(results)

    _run(sweep.body, buffers, {}, watch)
    outputs = [_shape(buffers[p.name], p) for p in sweep.outputs]
    names = [p.name for p in sweep.inputs]
    results = [f"{p.name}_out" if p.name in names else p.name for p in sweep.outputs]
    if watched is not None:
        outputs, results = [*outputs, ca.densify(ca.veccat(ca.SX(0, 1), *map(ca.densify, seen)))], [*results, "watched"]
    return ca.Function(sweep.name, symbols, outputs, names, results)


def _watch(call: Call, step: int, steps: int) -> Iterator[Watched]:
    """Yield descriptions of the results of a call in a step, element by element."""
    note = call.heading(step, steps)
    step, stage = (step + 1, 0) if call.stage == NEXT_STEP else (step, call.stage)
    mark = "" if stage < 0 or step >= steps else f"{step + 1}{stage + 1}" if steps > 1 else f"{stage + 1}"
    for s in call.outs:
        yield from (Watched(note, s.buffer, i, mark) for i in range(s.size))


def _run(
    nodes: tuple[Node, ...],
    buffers: dict[str, Expression],
    indices: dict[str, int],
    watch: Callable[[Call, int, Sequence[Expression]], None],
) -> None:
    for node in nodes:
        if isinstance(node, Block):
            for more in node.passes(indices):
                _run(node.body, buffers, {**indices, **more}, watch)
            continue
        assert isinstance(node, Call), "a function that is written in C has no expression"
        arguments = [buffers[s.buffer][s.elements(indices)] for s in node.ins]
        results = node.leaf.call(arguments)
        watch(node, indices.get("step", -1), results)
        for target, result in zip(node.outs, results, strict=True):
            buffers[target.buffer][target.elements(indices)] = ca.vec(ca.densify(result))


def _shape(flat: Expression, port: Port) -> Expression:
    """Return a dense SX vector, or an SX matrix of the port's shape without structural zeros."""
    return ca.sparsify(ca.reshape(flat, port.cols, port.rows).T) if port.cols else ca.densify(flat)


def lift_straight(sweep: Sweep) -> Kernel:
    """Return the sweep as one straight-line Kernel, in the order of its calls."""
    watched: list[Watched] = []
    function = _unroll(sweep, watched)
    return lift(function, sweep.name, sweep.doc, sweep.inputs, sweep.outputs, watched)


@dataclass(frozen=True, eq=False)
class LoopedRoutine:
    """A looped routine is a Sweep that is printed as loops; its leaves are Kernels that are named after the sweep."""

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

    @cached_property
    def count(self) -> OpCount:
        """Return the operations of one run, over all iterations of the loops."""
        return _count(self.sweep.body, self.leaves, {})

    @property
    def reads(self) -> tuple[Port, ...]:
        """Return the inputs that a call loads; only these are parameters of its C function."""
        return tuple(p for p in self.inputs if p.name in self.touched)

    @property
    def writes(self) -> tuple[Port, ...]:
        """Return the outputs that a call loads or stores."""
        return tuple(p for p in self.outputs if p.name in self.touched)

    @cached_property
    def touched(self) -> frozenset[str]:
        """Return the buffers that occur in the C text of the routine."""
        called = (b for c in calls(self.sweep.body) for b in _touched_buffers(c, self.leaves[c.leaf.name()]))
        return frozenset(called) | {s.buffer for node in part_calls(self.sweep.body) for s in node.slices}

    @property
    def calls_parts(self) -> bool:
        """Return True if the routine calls functions that are written in C."""
        return any(True for _ in part_calls(self.sweep.body))

    @property
    def kernels_of_parts(self) -> tuple[Kernel, ...]:
        """Return the kernels that these functions evaluate."""
        return tuple(kernel for node in part_calls(self.sweep.body) for kernel in node.kernels)

    @property
    def statements(self) -> int:
        """Return the number of instructions of all calls, with each loop counted once.

        This number is the code size if all leaves are inlined.
        """
        return sum(len(self.leaves[c.leaf.name()].instructions) for c in calls(self.sweep.body))

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """Return the leaves, in the order of their first call."""
        return tuple(dict.fromkeys(self.leaves.values()))


Routine = Kernel | LoopedRoutine


def nonzeros(routine: LoopedRoutine) -> dict[str, list[int]]:
    """Return the elements of every output that are not structurally zero, found by running the loops on flags."""
    sweep = routine.sweep
    buffers = {p.name: [False] * p.size for p in sweep.outputs}
    buffers |= {p.name: [True] * p.size for p in sweep.inputs}
    buffers |= {name: [False] * size for name, size in sweep.locals}
    _mark(sweep.body, routine.leaves, buffers, {})
    return {p.name: [e for e, marked in enumerate(buffers[p.name]) if marked] for p in sweep.outputs}


def _mark(
    nodes: tuple[Node, ...], leaves: Mapping[str, Kernel], buffers: dict[str, list[bool]], indices: dict[str, int]
) -> None:
    for node in nodes:
        if isinstance(node, Block):
            alike = isinstance(node, For) and not _reads(node.body, node.index)
            for more in node.passes(indices):
                before = {name: list(marks) for name, marks in buffers.items()} if alike else None
                _mark(node.body, leaves, buffers, {**indices, **more})
                if buffers == before:
                    break  # further iterations would change nothing
            continue
        if isinstance(node, Written):
            for s in node.outs:
                for e in node.nonzeros.get(s.buffer, s.elements(indices)):
                    buffers[s.buffer][e] = True
            continue
        ins = [[buffers[s.buffer][e] for e in s.elements(indices)] for s in node.ins]
        outs = [s.elements(indices) for s in node.outs]
        kernel = leaves[node.leaf.name()]
        marks = kernel.nonzero_values(ins)
        for o, element, value in kernel.stores:
            buffers[node.outs[o].buffer][outs[o][element]] = marks[value]


def _reads(nodes: tuple[Node, ...], index: str) -> bool:
    """Return True if the effect of the nodes depends on a loop index."""
    for node in nodes:
        if isinstance(node, Block):
            offsets = [node.count] if isinstance(node, For) and isinstance(node.count, Affine) else []
            if _reads(node.body, index) or (isinstance(node, If) and index in (node.left, node.right)):
                return True
        else:
            offsets = [s.offset for s in (*node.ins, *node.outs) if isinstance(s, Slice)]
        if any(name == index for offset in offsets for name, _ in offset.terms):
            return True
    return False


def lift_loops(sweep: Sweep) -> LoopedRoutine:
    """Lift the leaves of a sweep that will be printed as loops.

    Leaves store into buffers that are reused, so every output element is stored, including structural zeros. Results
    that no later node reads are not computed.
    """
    sweep = sweep if sweep.frame else _without_unread(sweep)
    leaves: dict[str, Kernel] = {}
    for call in calls(sweep.body):
        name = call.leaf.name()
        if name in leaves and [s.size for s in call.ins] != [p.size for p in leaves[name].inputs]:
            raise ValueError(f"{sweep.name}: two leaves are called {name}")
        if name not in leaves:
            names, whole = _port_names(call), {p.name: p for p in sweep.outputs if p.cols}
            inputs = [Port(n, s.size, flat=True) for n, s in zip(names, call.ins, strict=False)]
            outputs = [Port(n, s.size, flat=True) for n, s in zip(names[len(inputs) :], call.outs, strict=True)]
            leaf = call.leaf if call.keeps_zeros else _dense(call.leaf)
            kernel = lift(leaf, f"{sweep.name}_{name}", f"{sweep.name}: {name}", inputs, outputs)
            matrices = (
                replace(port, rows=whole[s.buffer].rows, cols=whole[s.buffer].cols, flat=False)
                if s.buffer in whole and s.size == whole[s.buffer].size
                else port
                for port, s in zip(outputs, call.outs, strict=True)
            )
            leaves[name] = _first_alike(replace(kernel, outputs=tuple(matrices)), leaves.values())
    return LoopedRoutine(sweep, leaves)


def _first_alike(kernel: Kernel, known: Iterable[Kernel]) -> Kernel:
    """Return the first kernel that computes the same, or this one."""

    def of(k: Kernel) -> tuple[object, ...]:
        return k.instructions, k.stores, *((port.size, port.cols, port.flat) for port in (*k.inputs, *k.outputs))

    return next((k for k in known if of(k) == of(kernel)), kernel)


def _port_names(call: Call) -> list[str]:
    """Return the names of the inputs and outputs of a leaf; those of the buffers if it has none."""
    given = [*call.leaf.name_in(), *call.leaf.name_out()]
    buffers = [s.buffer for s in (*call.ins, *call.outs)]
    names: list[str] = []
    for n, (own, buffer) in enumerate(zip(given, buffers, strict=True)):
        new = f"{buffer}_next" if n >= len(call.ins) and buffer in buffers[: len(call.ins)] else buffer
        single = buffers.count(buffer) - (new != buffer) == 1
        unnamed = own[0] in "io" and own[1:].isdigit()
        names.append((new if single else f"{new}_{buffers[:n].count(buffer)}") if unnamed else own)
    return names


def _without_unread(sweep: Sweep) -> Sweep:
    """Return the sweep without empty loops, and without results in local buffers that no later node reads."""
    read = {p.name for p in sweep.outputs}
    body: list[Node] = []
    for node in reversed(_without_empty(sweep.body)):
        kept = _read_results(node, read) if isinstance(node, Call) else node
        if kept is not None:
            body.append(kept)
            read |= {s.buffer for call in calls((kept,)) for s in _operands(call)}
            read |= {s.buffer for node in part_calls((kept,)) for s in node.slices}
    return replace(sweep, body=_without_empty(_only_read(tuple(reversed(body)), read)))


def _only_read(nodes: tuple[Node, ...], read: Collection[str]) -> tuple[Node, ...]:
    """Return the nodes whose calls in blocks store only results that some node reads."""
    found = (
        replace(n, body=_only_read(n.body, read))
        if isinstance(n, Block)
        else _read_results(n, read)
        if isinstance(n, Call)
        else n
        for n in nodes
    )
    return tuple(node for node in found if node is not None)


def _without_empty(nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    """Return the nodes without blocks that run no call."""
    kept: list[Node] = []
    for node in nodes:
        if not isinstance(node, Block):
            kept.append(node)
        elif not (isinstance(node, For) and node.count == 0) and (body := _without_empty(node.body)):
            kept.append(replace(node, body=body))
    return tuple(kept)


def _operands(call: Call) -> Iterator[Slice]:
    """Yield the slices on whose elements the results of a call depend."""
    symbols = call.leaf.sx_in()
    used = {e.element_hash() for e in ca.symvar(ca.veccat(ca.SX(0, 1), *call.leaf.call(symbols)))}
    for s, symbol in zip(call.ins, symbols, strict=True):
        if any(symbol[i].element_hash() in used for i in range(symbol.numel())):
            yield s


def _read_results(call: Call, read: Collection[str]) -> Call | None:
    """Return the call with only its results in the buffers ``read``; None if there are none."""
    kept = [o for o, s in enumerate(call.outs) if s.size and s.buffer in read]
    if len(kept) == len(call.outs):
        return call
    if not kept:
        return None
    leaf, symbols = call.leaf, call.leaf.sx_in()
    results = leaf.call(symbols)
    fewer = ca.Function(
        f"{leaf.name()}_{''.join(map(str, kept))}",
        symbols,
        [results[o] for o in kept],
        leaf.name_in(),
        [leaf.name_out(o) for o in kept],
    )
    return replace(call, leaf=fewer, outs=tuple(call.outs[o] for o in kept))


def _dense(leaf: Function) -> Function:
    symbols = leaf.sx_in()
    return ca.Function(
        leaf.name(), symbols, [ca.densify(o) for o in leaf.call(symbols)], leaf.name_in(), leaf.name_out()
    )


def calls(nodes: tuple[Node, ...]) -> Iterator[Call]:
    """Yield all calls of leaves, in the order of the C text."""
    for node in nodes:
        if isinstance(node, Block):
            yield from calls(node.body)
        elif isinstance(node, Call):
            yield node


def part_calls(nodes: tuple[Node, ...]) -> Iterator[Written]:
    """Yield all calls of functions that are written in C."""
    for node in nodes:
        if isinstance(node, Block):
            yield from part_calls(node.body)
        elif isinstance(node, Written):
            yield node


def _count(nodes: tuple[Node, ...], leaves: Mapping[str, Kernel], indices: Mapping[str, int]) -> OpCount:
    total = OpCount()
    for node in nodes:
        if isinstance(node, Call):
            total += leaves[node.leaf.name()].count
            continue
        if isinstance(node, Written):
            total += node.count
            continue
        runs = list(node.passes(indices))
        if isinstance(node, For) and not any(isinstance(n, For) and isinstance(n.count, Affine) for n in node.body):
            total += _count(node.body, leaves, {**indices, **runs[0]}) * len(runs) if runs else OpCount()
        else:
            for more in runs:
                total += _count(node.body, leaves, {**indices, **more})
    return total


def _touched_buffers(call: Call, leaf: Kernel) -> Iterator[str]:
    """Yield the buffers in the text of a call: those that its leaf loads or stores."""
    yield from (s.buffer for s in passed_slices(call, leaf))


def passed_slices(call: Call, leaf: Kernel) -> Iterator[Slice]:
    """Yield the slices of a call that its leaf loads or stores: the arguments of its C function."""
    yield from (s for s, port in zip(call.ins, leaf.inputs, strict=True) if port in leaf.reads)
    yield from (s for s, port in zip(call.outs, leaf.outputs, strict=True) if port in leaf.writes)
