"""Print kernels and numbers as C, in the working precision.

A sweep is one function, preceded by its leaves. A sweep whose buffers are members of structs (a frame) accesses the
members directly: every leaf is printed inline, as nested expressions. Its outputs may alias its inputs, so either all
loads or all results are first held in named constants: in a loop the loads, with loop-invariant ones in front of it;
elsewhere the results. A direct call needs neither.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import casadi as ca

from nmpc_codegen.ir.kernel import OPERATIONS, Kernel, Port

if TYPE_CHECKING:
    from nmpc_codegen.ir.kernel import Instruction
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from textwrap import wrap

from nmpc_codegen.ir.sweep import (
    Affine,
    Block,
    Call,
    Entries,
    For,
    Frame,
    If,
    LoopedRoutine,
    Node,
    Routine,
    Slice,
    calls,
    passed,
)


@dataclass(frozen=True)
class CStyle:
    """Spelling of types, literals and functions: ``real`` is the typedef, ``single`` selects 0.5F and sinf.

    lanes: values are GNU C vectors, with functions of their own for what has no operator. own: functions of the
    package's text take the place of those of math.h.
    """

    real: str
    single: bool
    lanes: bool = False
    own: bool = False

    #: Functions that are instructions, or made of bits, and round the same everywhere: those of math.h serve always.
    INSTRUCTIONS: ClassVar[tuple[str, ...]] = ("sqrt", "fabs")

    #: Opcodes of conditions -> the words of their functions on vectors.
    CONDITIONS: ClassVar[Mapping[int, str]] = {
        ca.OP_SIGN: "sign",
        ca.OP_LT: "lt",
        ca.OP_LE: "le",
        ca.OP_EQ: "eq",
        ca.OP_NE: "ne",
        ca.OP_NOT: "not",
        ca.OP_AND: "and",
        ca.OP_OR: "or",
        ca.OP_IF_ELSE_ZERO: "if_else_zero",
    }

    #: Words of the text of the elementary functions -> the same on vectors.
    ON_VECTORS: ClassVar[Mapping[str, str]] = {
        "real_t": "lanes_t",
        "bits_t": "words_t",
        "truth_t": "mask_t",
        "static": "LANES_INLINE",
        "inline ": "",
    }

    @property
    def on_vectors(self) -> CStyle:
        """The spelling of the same on vectors."""
        return replace(self, real="lanes_t", lanes=True, own=False)

    def literal(self, value: float) -> str:
        """A C literal that reads back to the same number, e.g. ``0.1`` or ``0.1F``."""
        text = repr(float(value))
        if "." not in text and "e" not in text:
            text += ".0"
        return text + ("F" if self.single else "")

    def function(self, name: str) -> str:
        """Name of a function of math.h, or of the package's own, in the working precision."""
        if self.lanes:
            return f"lanes_{name}"
        if self.own and name not in self.INSTRUCTIONS:
            return f"own_{name}"
        return name + ("f" if self.single else "")

    def word(self, word: str) -> str:
        """A word of the text of the elementary functions."""
        if not self.lanes:
            return word
        return self.function(word.removeprefix("own_")) if word.startswith("own_") else self.ON_VECTORS.get(word, word)

    def needs_values(self, opcode: int) -> bool:
        """True if the operands must be values: a vector cannot be compared with a number, nor a function take one."""
        return self.lanes and (opcode in self.CONDITIONS or bool(OPERATIONS[opcode].function))

    def whole(self, text: str) -> str:
        """A number as a value."""
        return f"lanes_all({text})" if self.lanes else text


_WORD = re.compile(r"\binline |[A-Za-z_]\w*")


def spell(text: str, style: CStyle) -> str:
    """The text of elementary functions, which is that on numbers, in a spelling."""
    return _WORD.sub(lambda found: style.word(found[0]), text)


def signature(name: str, inputs: tuple[Port, ...], outputs: tuple[Port, ...], style: CStyle) -> str:
    """``static void name(const real *x, ..., real *y)``."""
    arguments = [f"const {style.real} *{p.name}" for p in inputs] + [f"{style.real} *{p.name}" for p in outputs]
    return f"static void {name}({', '.join(arguments)})"


def comment(doc: str, inputs: tuple[Port, ...], outputs: tuple[Port, ...], extra: str) -> str:
    """Block comment with the formula, the ports and the operation count."""
    lines = [f"/* {doc}"]
    for port in (*inputs, *outputs):
        shape = f"{port.rows} x {port.cols}" if port.cols else f"{port.rows}"
        lines.append(f" *   {port.name} [{shape}]" + (f": {port.doc}" if port.doc else ""))
    lines.append(f" * {extra} */")
    return "\n".join(lines)


def print_kernel(kernel: Kernel, style: CStyle) -> str:
    """The whole C function; its parameters are the ports that it reads or writes."""
    count = ", ".join(f"{v} {k}" for k, v in kernel.count.as_dict().items() if v) or "no operations"
    lines = [comment(kernel.doc, kernel.reads, kernel.writes, count)]
    lines += [signature(kernel.name, kernel.reads, kernel.writes, style), "{"]
    lines += print_body(
        kernel,
        style,
        lambda port, element: f"{kernel.inputs[port].name}[{element}]",
        lambda port, element: f"{kernel.outputs[port].name}[{element}]",
    )
    return "\n".join([*lines, "}"])


def print_body(
    kernel: Kernel, style: CStyle, load: Callable[[int, int], str], store: Callable[[int, int], str]
) -> list[str]:
    """Loads, one statement per operation, stores; ``load`` and ``store`` spell element e of a port."""
    names: list[str] = []
    numbers: set[int] = set()
    loads, body = [], []
    for index, ins in enumerate(kernel.instructions):
        if ins.opcode == ca.OP_INPUT:
            port, element = ins.args
            names.append(f"{kernel.inputs[port].name}_{element}")
            loads.append(f"    const {style.real} {names[-1]} = {load(port, element)};")
        elif ins.opcode == ca.OP_CONST:
            text = style.literal(ins.constant)
            names.append(f"({text})" if text.startswith("-") else text)
            numbers.add(index)
        else:
            operands: Sequence[str] | Mapping[int, str] = names
            if style.needs_values(ins.opcode) or numbers.issuperset(ins.args):
                operands = {a: style.whole(names[a]) if a in numbers else names[a] for a in ins.args}
            names.append(f"t{index}")
            body.append(f"    const {style.real} {names[-1]} = {_expression(ins, operands, style)};")
    values = [style.whole(name) if i in numbers else name for i, name in enumerate(names)]
    return loads + body + [f"    {store(o, e)} = {values[v]};" for o, e, v in kernel.stores]


def _expression(ins: Instruction, names: Sequence[str] | Mapping[int, str], style: CStyle) -> str:
    operation = OPERATIONS[ins.opcode]
    if style.lanes and ins.opcode in CStyle.CONDITIONS:
        return f"lanes_{CStyle.CONDITIONS[ins.opcode]}({', '.join(names[a] for a in ins.args)})"
    return operation.c.format(
        *(names[a] for a in ins.args),
        fn=style.function(operation.function) if operation.function else "",
        one=style.literal(1.0),
        zero=style.literal(0.0),
    )


class Expressions:
    """A kernel as nested expressions: a value that is used once is printed where it is used.

    Attributes:
        statements: definitions of constants ``t<n>`` for the values that are used more than once.
    """

    def __init__(self, kernel: Kernel, style: CStyle, load: Callable[[int, int], str]) -> None:
        self._kernel, self._style = kernel, style
        self.statements: list[str] = []
        self._texts: list[str] = []
        uses = _uses(kernel)
        for index, ins in enumerate(kernel.instructions):
            if ins.opcode == ca.OP_INPUT:
                text = load(*ins.args)
            elif ins.opcode == ca.OP_CONST:
                text = style.literal(ins.constant)
                text = f"({text})" if text.startswith("-") else text
            else:
                text = self._nested(ins)
                if uses[index] > 1:
                    self.statements.append(f"const {style.real} t{index} = {text};")
                    text = f"t{index}"
            self._texts.append(text)

    def assignment(self, target: str, value: int) -> str:
        """``target = value``, or ``target += rest`` where the value is a sum that begins with the target."""
        ins = self._kernel.instructions[value]
        if ins.opcode == ca.OP_ADD and target in (terms := [self._texts[a] for a in ins.args]):
            return f"{target} += {terms[1 - terms.index(target)]}"
        return f"{target} = {self._texts[value]}"

    def _nested(self, ins: Instruction) -> str:
        operands = {a: self._texts[a] for a in ins.args}
        for position, a in enumerate(ins.args):
            if needs_parentheses(ins.opcode, position, self._kernel.instructions[a].opcode, self._texts[a]):
                operands[a] = f"({self._texts[a]})"
        return _expression(self._in_order(ins), operands, self._style)

    def _in_order(self, ins: Instruction) -> Instruction:
        """Sort the operands of a commutative operation on loads in the order of the inputs."""
        loads = [self._kernel.instructions[a] for a in ins.args]
        if not OPERATIONS[ins.opcode].commutative or any(load.opcode != ca.OP_INPUT for load in loads):
            return ins
        return ins._replace(args=tuple(a for _, a in sorted(zip((x.args for x in loads), ins.args, strict=True))))


_SUMS = (ca.OP_ADD, ca.OP_SUB)
_PRODUCTS = (ca.OP_MUL, ca.OP_SQ, ca.OP_DIV)


def needs_parentheses(outer: int, position: int, inner: int, text: str) -> bool:
    """True if the text of an inner operation is no operand of an outer one, at a position, as it is."""
    if not (inner in OPERATIONS and " " in text) or OPERATIONS[inner].function:
        return False
    return not (outer in _SUMS and (inner in _PRODUCTS or (inner in _SUMS and position == 0)))


def _uses(kernel: Kernel) -> list[int]:
    """Number of occurrences of every value in the text of a kernel."""
    uses = [0] * len(kernel.instructions)
    for ins in kernel.instructions:
        if ins.opcode in OPERATIONS:
            for position, a in enumerate(ins.args):
                uses[a] += OPERATIONS[ins.opcode].c.count(f"{{{position}}}")
    for _, _, value in kernel.stores:
        uses[value] += 1
    return uses


def unit_style(precision: str, own: bool = False) -> CStyle:
    """Spelling of numbers and functions inside the translation unit."""
    return CStyle("real_t", precision == "single", own=own)


# -- sweeps with loops ------------------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def print_routine(routine: Routine, style: CStyle) -> str:
    """C text of a routine."""
    if isinstance(routine, Kernel):
        return print_kernel(routine, style)
    if routine.sweep.frame:
        return print_framed(routine, style)
    called = {c.leaf.name() for c in calls(routine.sweep.body) if not c.written_out}
    texts = [print_kernel(kernel, style) for name, kernel in routine.leaves.items() if name in called]
    sweep, count = routine.sweep, routine.count
    written = ", ".join(f"{v} {k}" for k, v in count.as_dict().items() if v)
    lines = [comment(sweep.doc, routine.reads, routine.writes, written)]
    lines += [signature(sweep.name, routine.reads, routine.writes, style), "{"]
    indices = dict.fromkeys(_indices(sweep.body))
    lines += [f"    {style.real} {name}[{size}];" for name, size in sweep.locals if size and name in routine.touched]
    if indices:
        lines.append(f"    ptrdiff_t {', '.join(indices)};")
    lines += _print_nodes(sweep.body, routine, style, "    ")
    return "\n\n".join([*texts, "\n".join([*lines, "}"])])


def _indices(nodes: tuple[Node, ...]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, For):
            yield node.index
            yield from _indices(node.body)


def _print_nodes(nodes: tuple[Node, ...], routine: LoopedRoutine, style: CStyle, indent: str) -> list[str]:
    lines: list[str] = []
    for node in nodes:
        if not isinstance(node, Call):
            assert isinstance(node, For), "other blocks are printed in a frame"
            lines.append(indent + _for(node))
            lines += _print_nodes(node.body, routine, style, indent + "    ")
            lines.append(indent + "}")
        elif node.written_out and len(nodes) > 1:
            lines += [indent + "{", *_print_call(node, routine, style, indent + "    "), indent + "}"]
        else:
            lines += _print_call(node, routine, style, indent)
    return lines


def _for(loop: For) -> str:
    i, first = loop.index, loop.start
    count = Affine(loop.count) if isinstance(loop.count, int) else loop.count
    last = Affine(count.constant + first, count.terms)
    if loop.down:
        return f"for ({i} = {Affine(last.constant - 1, last.terms).c()}; {i} >= {first}; {i}--) {{"
    return f"for ({i} = {first}; {i} < {last.c()}; {i}++) {{"


def _print_call(call: Call, routine: LoopedRoutine, style: CStyle, indent: str) -> list[str]:
    """A call of a static leaf; a leaf on strided slices is printed inline, so that the loop around it vectorises."""
    kernel = routine.leaves[call.leaf.name()]
    if not call.written_out:
        arguments = (f"&{s.buffer}[{s.offset.c()}]" for s in passed(call, kernel))
        return [f"{indent}{kernel.name}({', '.join(arguments)});"]

    def element(slices: tuple[Slice, ...], port: int, e: int) -> str:
        s = slices[port]
        return f"{s.buffer}[{Affine(s.offset.constant + s.stride * e, s.offset.terms).c()}]"

    body = print_body(
        kernel, style, lambda port, e: element(call.ins, port, e), lambda port, e: element(call.outs, port, e)
    )
    return [indent + line.removeprefix("    ") for line in body]


# -- sweeps with a frame -----------------------------------------------------------------------------------------------

#: Maximum length of a line.
WIDTH = 120

#: Text of a load -> name of the constant that holds it.
Names = dict[str, str]


def print_framed(routine: LoopedRoutine, style: CStyle) -> str:
    """The C function of a sweep with a frame, with its formula and operation count above it."""
    sweep, frame = routine.sweep, routine.sweep.frame
    assert frame is not None
    count = ", ".join(f"{v} {k}" for k, v in routine.count.as_dict().items() if v) or "no operations"
    lines = _body(routine, style)
    parameters = [text for name, text in named(frame).items() if name in _names(lines)]
    head = f"static {'inline ' if frame.inline else ''}void {sweep.name}({', '.join(parameters)})"
    return "\n".join([f"/* {sweep.doc}: {count} */", head, "{", *lines, "}"])


def call(routine: LoopedRoutine, style: CStyle) -> tuple[tuple[str, ...], str]:
    """Names of all parameters of a product, and the text of its call, which passes those that it reads or writes."""
    frame = routine.sweep.frame
    assert frame is not None
    names = tuple(named(frame))
    used = _names(_body(routine, style))
    return names, f"{routine.name}({', '.join(name for name in names if name in used)})"


def named(frame: Frame) -> dict[str, str]:
    """Name -> declaration of every parameter."""
    stripped = (re.sub(r"\W*(?:\[\w+\])*$", "", p) for p in frame.parameters)
    return {s.split("*")[-1].split(" ")[-1]: p for s, p in zip(stripped, frame.parameters, strict=True)}


@lru_cache(maxsize=256)
def _body(routine: LoopedRoutine, style: CStyle) -> tuple[str, ...]:
    """The statements of the function; its definition and its calls name those parameters that they use."""
    frame = routine.sweep.frame
    assert frame is not None
    printer = _Printer(routine, frame, style)
    return (*_declarations(routine, frame, style), *printer.block(routine.sweep.body, "    ", {}, set()))


def _names(lines: Iterable[str]) -> set[str]:
    return set(re.findall(r"\w+", "\n".join(lines)))


def _declarations(routine: LoopedRoutine, frame: Frame, style: CStyle) -> list[str]:
    """Declarations of the local arrays; scalars are declared at their first assignment."""
    arrays = [frame.places[name] for name, _ in routine.sweep.locals if name in routine.touched]
    return [f"    {style.real} {a.text}{''.join(f'[{n}]' for n in a.shape)};" for a in arrays if a.shape]


class _Printer:
    """Text of the nodes of one sweep."""

    def __init__(self, routine: LoopedRoutine, frame: Frame, style: CStyle) -> None:
        self._leaves, self._places, self._style = routine.leaves, frame.places, style
        self._stored = {s.buffer for call in calls(routine.sweep.body) for s in call.outs}

    def block(self, nodes: tuple[Node, ...], indent: str, names: Names, scalars: set[str]) -> list[str]:
        """The statements of a block; its declarations are in scope until its end."""
        names, scalars = dict(names), set(scalars)
        lines: list[str] = []
        for node in nodes:
            if isinstance(node, Block):
                lines += self._nested(node, indent, names, scalars)
            else:
                lines += self._call(node, indent, names, scalars)
        return lines

    def _nested(self, node: Block, indent: str, names: Names, scalars: set[str]) -> list[str]:
        """A loop or condition; an innermost loop is preceded by its loop-invariant loads."""
        inner, lines = indent + "    ", []
        if isinstance(node, For) and len(node.body) == 1 and isinstance(node.body[0], Call):
            call = node.body[0]
            lines += self._loads(call, indent, names, node.index)
            loads = [] if call.direct else self._loads(call, inner, inner_names := dict(names), None)
            body = loads + self._stores(call, inner, names if call.direct else inner_names, scalars, False)
        else:
            body = self.block(node.body, inner, names, scalars)
        entries = [f"{inner}const int {_bindings(node)};"] if isinstance(node, Entries) else []
        return [*lines, f"{indent}{_head(node)} {{", *entries, *body, indent + "}"]

    def _call(self, call: Call, indent: str, names: Names, scalars: set[str]) -> list[str]:
        return self._stores(call, indent, names, scalars, not call.direct)

    def _loads(self, call: Call, indent: str, names: Names, index: str | None) -> list[str]:
        """Constants that hold loads: all of them, or, given a loop ``index``, those that the loop does not change."""
        lines: list[str] = []
        for port, element in sorted(_loaded(self._leaves[call.leaf.name()])):
            s = call.ins[port]
            text, name = self._element(s, element), self._name(s, element)
            fixed = s.buffer not in self._stored and all(i != index for i, _ in s.offset.terms)
            if text not in names and name not in names.values() and (fixed or index is None):
                names[text] = name
                lines.append(f"{indent}const {self._style.real} {name} = {text};")
        return lines

    def _stores(self, call: Call, indent: str, names: Names, scalars: set[str], named: bool) -> list[str]:
        """Statements that compute and store the results; ``named``: all are computed as constants before any store."""
        kernel = self._leaves[call.leaf.name()]

        def load(port: int, element: int) -> str:
            text = self._element(call.ins[port], element)
            return names.get(text, text)

        expressions = Expressions(kernel, self._style, load)
        lines, last = list(expressions.statements), []
        for port, element, value in kernel.stores:
            target = self._element(call.outs[port], element)
            if named:
                name = self._name(call.outs[port], element)
                lines.append(f"const {self._style.real} {expressions.assignment(name, value)};")
                last.append(f"{target} = {name};")
            else:
                new = not self._places[call.outs[port].buffer].shape and target not in scalars
                scalars |= {target} if new else set()
                lines.append(f"{self._style.real + ' ' if new else ''}{expressions.assignment(target, value)};")
        return [part for line in lines + last for part in _wrapped(indent, line)]

    def _element(self, s: Slice, element: int) -> str:
        """C text of an element of a slice."""
        place = self._places[s.buffer]
        constant = s.offset.constant + s.stride * element if element else s.offset.constant
        if not place.shape:
            return place.text
        if len(place.shape) == 1:
            return f"{place.text}[{Affine(constant, s.offset.terms).c()}]"
        columns = int(place.shape[1])
        along = tuple((i, c // columns) for i, c in s.offset.terms if c % columns == 0)
        across = tuple((i, c) for i, c in s.offset.terms if c % columns)
        row, column = divmod(constant, columns)
        column = constant if row == 0 else column  # a Size keeps its macro name
        return f"{place.text}[{Affine(row, along).c()}][{Affine(column, across).c()}]"

    def _name(self, s: Slice, element: int) -> str:
        """Name of the constant that holds the element."""
        place = self._places[s.buffer]
        if len(place.shape) == 2 and not s.offset.terms:
            return "_".join(map(str, (s.buffer, *divmod(s.offset.constant + s.stride * element, int(place.shape[1])))))
        return f"{s.buffer}_{element}"


def _loaded(kernel: Kernel) -> set[tuple[int, int]]:
    """(port, element) of all loads."""
    return {(ins.args[0], ins.args[1]) for ins in kernel.instructions if ins.opcode == ca.OP_INPUT}


def _head(node: Block) -> str:
    if isinstance(node, If):
        return f"if ({node.left} {node.relation} {node.right})"
    if isinstance(node, Entries):
        return f"for (int {node.index} = {node.first}; {node.index} < {node.last}; ++{node.index})"
    assert isinstance(node.count, int)
    assert not node.down
    last = node.start + node.count if node.start else node.count
    return f"for (int {node.index} = {node.start}; {node.index} < {last}; ++{node.index})"


def _bindings(node: Entries) -> str:
    return ", ".join(f"{name} = {table}[{node.index}]" for name, table, _ in node.tables)


def _wrapped(indent: str, line: str) -> list[str]:
    """The statement in lines of at most WIDTH columns, broken in front of plus signs."""
    glued = re.sub(r" (?!\+ )", "\0", line)
    lines = wrap(
        glued,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [part.replace("\0", " ") for part in lines]
