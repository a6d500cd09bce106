"""Print kernels and numbers as C, in the working precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import casadi as ca

from nmpc_codegen.ir.kernel import OPERATIONS, Kernel, Port

if TYPE_CHECKING:
    from nmpc_codegen.ir.kernel import Instruction


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

    def needs_values(self, opcode: int) -> bool:
        """True if the operands must be values: a vector cannot be compared with a number, nor a function take one."""
        return self.lanes and (opcode in self.CONDITIONS or bool(OPERATIONS[opcode].function))

    def whole(self, text: str) -> str:
        """A number as a value."""
        return f"lanes_all({text})" if self.lanes else text


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
