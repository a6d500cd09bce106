"""Kernels are printed as nested expressions: a value that is used once stands where it is used, others have names."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple

import casadi as ca

from nmpc_codegen.ir.kernel import OPERATIONS, Kernel, Part, function_of
from nmpc_codegen.ir.printing.constant_names import Taken

if TYPE_CHECKING:
    from nmpc_codegen.ir.kernel import Instruction
    from nmpc_codegen.ir.printing.c_style import CStyle

#: Maximum length of a line.
WIDTH = 100
#: Expressions longer than LONGEST get a name unless they are at most FLAT deep; so do those deeper than DEEPEST.
LONGEST, FLAT, DEEPEST = 240, 2, 6

_IDENTIFIER = re.compile(r"[A-Za-z_]\w*")
_SUMS = (ca.OP_ADD, ca.OP_SUB)
_PRODUCTS = (ca.OP_MUL, ca.OP_SQ, ca.OP_DIV)


class Constant(NamedTuple):
    """A constant is a value with a name; ``note`` is the heading before it; ``is_fixed``: a loop does not change it."""

    name: str
    text: str
    note: str = ""
    is_fixed: bool = True

    def definition(self, real: str) -> str:
        """Return the statement that defines the constant."""
        return f"const {real} {self.name} = {self.text};"


class NestedExpressions:
    """The expressions of a kernel are nested, part by part.

    Attributes:
        kernel: the kernel.
        constants: values that are used more than once, in their order; in a loop over elements, in which the loads
            ``moving`` (port, element) change, also values that do not change.
    """

    def __init__(
        self,
        kernel: Kernel,
        style: CStyle,
        load: Callable[[int, int], str],
        taken: Taken | None = None,
        moving: Collection[tuple[int, int]] = (),
    ) -> None:
        self.kernel, self._style, self._load = kernel, style, load
        self._taken = taken or Taken(style.names)
        self._uses = _uses(kernel)
        self._texts: dict[int, str] = {}
        self._moves = _find_moving(kernel, moving)
        self.constants: list[Constant] = []
        printed = frozenset[int]().union(*(part.values for part in kernel.parts))
        rest = Part("", frozenset(range(len(kernel.instructions))) - printed, {})
        for part in (*kernel.parts, rest):
            self._print(part, not kernel.parts or part is kernel.parts[-1])

    def _print(self, part: Part, last: bool) -> None:
        """Print the values of a part.

        Values that later parts need, or stores before the last part, become constants.
        """
        inside = {a for v in part.values for a in self.kernel.operands(v)}
        if last:
            inside.update(v for _, _, v in self.kernel.stores)
        note = part.note
        for v in sorted(part.values):
            ins = self.kernel.instructions[v]
            if ins.opcode not in OPERATIONS:
                loads = ins.opcode == ca.OP_INPUT
                self._texts[v] = self._load(*ins.args) if loads else self._style.number(ins.constant)
                continue
            text = self._nest(ins)
            alone = self._uses[v] == 1 and (v in inside or not part.note) and not self._leaves_loop(v)
            deep = depth(text)
            if not alone or deep > DEEPEST or (len(text) > LONGEST and deep > FLAT):
                named = part.named.get(v)
                wish = self._style.names.value(named.buffer, named.element, named.mark) if named else ""
                name = self._taken.next(wish or self._wish(ins))
                self.constants.append(Constant(name, text, note, v not in self._moves))
                text, note = name, ""
            self._texts[v] = text

    @property
    def statements(self) -> list[str]:
        """Return definitions of the constants, with comments above parts."""
        lines: list[str] = []
        for constant in self.constants:
            lines += [f"/* {constant.note} */"] if constant.note else []
            lines.append(constant.definition(self._style.real))
        return lines

    def _leaves_loop(self, value: int) -> bool:
        """Return True if a value does not change in the loop that uses it."""
        return value not in self._moves and any(value in self.kernel.operands(v) for v in self._moves)

    def _wish(self, ins: Instruction) -> str:
        """Return cos_phi for cos(phi)."""
        operation = OPERATIONS[ins.opcode]
        operand = self._texts[ins.args[0]] if len(ins.args) == 1 else ""
        plain = _IDENTIFIER.fullmatch(operand) and not re.fullmatch(r"t\d+_*", operand)
        return f"{operation.function}_{operand}" if operation.function and plain else ""

    def text(self, value: int) -> str:
        """Return the text of a value that is stored."""
        number = self.kernel.instructions[value].opcode == ca.OP_CONST
        return self._style.whole(self._texts[value]) if number else self._texts[value]

    def assignment(self, target: str, value: int) -> str:
        """Return ``target = value``, or ``target += rest`` if the value is a sum that begins with the target."""
        ins = self.kernel.instructions[value]
        if ins.opcode == ca.OP_ADD and target in (terms := [self._texts[a] for a in ins.args]):
            return f"{target} += {terms[1 - terms.index(target)]}"
        return f"{target} = {self.text(value)}"

    def _nest(self, ins: Instruction) -> str:
        numbers = [a for a in ins.args if self.kernel.instructions[a].opcode == ca.OP_CONST]
        operands = {a: self._texts[a] for a in ins.args}
        if self._style.needs_values(ins.opcode) or len(numbers) == len(ins.args):
            operands |= {a: self._style.whole(operands[a]) for a in numbers}
        for position, a in enumerate(ins.args):
            if needs_parentheses(ins.opcode, position, self.kernel.instructions[a].opcode, operands[a]):
                operands[a] = f"({operands[a]})"
        return expression(self._in_order(ins), operands, self._style)

    def _in_order(self, ins: Instruction) -> Instruction:
        """Sort the operands of a commutative operation on loads in the order of the inputs."""
        loads = [self.kernel.instructions[a] for a in ins.args]
        if not OPERATIONS[ins.opcode].commutative or any(load.opcode != ca.OP_INPUT for load in loads):
            return ins
        return ins._replace(args=tuple(a for _, a in sorted(zip((x.args for x in loads), ins.args, strict=True))))


def expression(ins: Instruction, operands: Mapping[int, str], style: CStyle) -> str:
    """Return an operation on the texts of its operands."""
    operation = OPERATIONS[ins.opcode]
    if style.lanes and ins.opcode in style.CONDITIONS:
        return f"lanes_{style.CONDITIONS[ins.opcode]}({', '.join(operands[a] for a in ins.args)})"
    return operation.c.format(
        *(operands[a] for a in ins.args),
        fn=style.function(function_of(ins)) if operation.function else "",
        one=style.literal(1.0),
        zero=style.literal(0.0),
    )


def needs_parentheses(outer: int, position: int, inner: int, text: str) -> bool:
    """Return True if the text of an inner operation needs parentheses as an operand of an outer one at a position."""
    if OPERATIONS[outer].function:
        return False
    if text.startswith("-") and (position > 0 or outer not in (*_SUMS, ca.OP_MUL, ca.OP_DIV)):
        return True
    if " " not in text or inner == ca.OP_INPUT or (inner in OPERATIONS and OPERATIONS[inner].function):
        return False
    return not (outer in _SUMS and (inner in _PRODUCTS or (inner in _SUMS and position == 0)))


def depth(text: str) -> int:
    """Return the largest number of parentheses that are open at once."""
    most = now = 0
    for character in text:
        now += (character == "(") - (character == ")")
        most = max(most, now)
    return most


def _find_moving(kernel: Kernel, loads: Collection[tuple[int, int]]) -> frozenset[int]:
    """Return the values that depend on these loads (port, element)."""
    found = set[int]()
    for v, ins in enumerate(kernel.instructions if loads else ()):
        if ins.args in loads if ins.opcode == ca.OP_INPUT else not found.isdisjoint(kernel.operands(v)):
            found.add(v)
    return frozenset(found)


def loads_inside(kernel: Kernel, loads: Collection[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return the loads (port, element) that are evaluated inside a loop in which ``loads`` change.

    Values that depend on none of these are computed before the loop.
    """
    moving = _find_moving(kernel, loads)
    operands = {a for v in moving for a in kernel.operands(v)} | moving
    found = (kernel.instructions[a] for a in operands)
    return {(ins.args[0], ins.args[1]) for ins in found if ins.opcode == ca.OP_INPUT}


def _uses(kernel: Kernel) -> list[int]:
    """Return the number of occurrences of every value in the text of a kernel."""
    uses = [0] * len(kernel.instructions)
    for ins in kernel.instructions:
        if ins.opcode in OPERATIONS:
            for position, a in enumerate(ins.args):
                uses[a] += OPERATIONS[ins.opcode].c.count(f"{{{position}}}")
    for _, _, value in kernel.stores:
        uses[value] += 1
    return uses


def declare(real: str, constants: Iterable[tuple[str, str]]) -> list[str]:
    """Return one declaration of all constants (name, text)."""
    texts = [f"{name}{FIRM}={FIRM}{text}" for name, text in constants]
    return [f"const {real} {', '.join(texts)};"] if texts else []


#: A blank at which no line may break while lines are filled.
FIRM = "\0"
#: Blanks at which no line breaks: lines break before operators, and after commas between declarations.
_FIRM = re.compile(r" (?![-+*/?:=] )(?<!, )")
_INDEX = re.compile(r"\[[^\[\]]*\]")


def wrap_statement(indent: str, line: str) -> list[str]:
    """Return the statement in lines of at most WIDTH columns, broken before operators."""
    if len(indent) + len(line) <= WIDTH:
        return [indent + line.replace(FIRM, " ")]
    whole = _INDEX.sub(lambda found: found[0].replace(" ", FIRM), line)
    lines = wrap(
        _FIRM.sub(FIRM, whole),
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [part.replace(FIRM, " ") for part in lines]
