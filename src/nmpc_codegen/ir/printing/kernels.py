"""Straight-line kernels are printed as C functions: loads, then named constants, then stores.

Outputs may alias inputs, so all loads are named constants in front of the first store.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from textwrap import wrap
from typing import TypeVar

import casadi as ca

from nmpc_codegen.ir.kernel import Kernel, Port
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.constant_names import LocalNames, Taken
from nmpc_codegen.ir.printing.nested_expressions import FIRM, WIDTH, NestedExpressions, declare, wrap_statement
from nmpc_codegen.package.opcount import OpCount

#: Largest number of lines of a function that is not cut.
LONGEST_FUNCTION = 60

#: Number of zeros of an output from which one call writes them.
CLEARED = 4

Cut = TypeVar("Cut")


def signature(name: str, inputs: tuple[Port, ...], outputs: tuple[Port, ...], style: CStyle) -> str:
    """Return ``static void name(const real x[4], ..., real y[4])``."""
    return f"static void {name}({', '.join(parameters((*inputs, *outputs), outputs, style))})"


def parameters(ports: Iterable[Port], outputs: Collection[Port], style: CStyle) -> list[str]:
    """Return ports as parameters in C: ``const real x[4]``, ``real y[4]`` for ``outputs``, ``int k``."""
    return [
        f"int {p.name}" if p.whole else f"{'' if p in outputs else 'const '}{style.real} {parameter(p)}" for p in ports
    ]


def parameter(port: Port) -> str:
    """Return a port as a parameter in C: ``x[4]``, ``S[4][5]``, ``*W``."""
    if port.flat:
        return f"*{port.name}"
    return f"{port.name}[{port.rows}][{port.cols}]" if port.cols else f"{port.name}[{port.rows}]"


def comment(doc: str, inputs: tuple[Port, ...], outputs: tuple[Port, ...], extra: str) -> str:
    """Return the block comment with the formula, the notes on ports, and the operation count."""
    ports = "".join(f"; {p.name}: {p.doc}" for p in (*inputs, *outputs) if p.doc)
    return block(f"{doc}{ports}", extra)


def block(doc: str, count: str) -> str:
    """Return a block comment in filled lines; the operation count is on the line of the text if it fits."""
    width = WIDTH - len(" * ") - len(" */")
    together = f"{doc}: {count}"
    lines = [together] if len(together) <= width else [*wrap(doc, width, break_on_hyphens=False), count]
    return "/* " + "\n * ".join(lines) + " */"


def print_count(count: OpCount) -> str:
    """Return ``3 add, 4 mul``."""
    return ", ".join(f"{v} {k}" for k, v in count.as_dict().items() if v) or "no operations"


def print_kernel(kernel: Kernel, style: CStyle) -> str:
    """Return the whole C function; its parameters are the ports that the kernel loads or stores."""
    printed = PrintedFunction(kernel, style)
    lines = [*wrapped_head(signature(kernel.name, kernel.reads, kernel.writes, style)), "{", *printed.lines(), "}"]
    return "\n".join([describe(kernel), *lines])


def describe(kernel: Kernel) -> str:
    """Return the comment above the function of a kernel."""
    return comment(kernel.doc, kernel.reads, kernel.writes, print_count(kernel.count))


def wrapped_head(head: str) -> list[str]:
    """Return the head of a function in lines of at most WIDTH columns."""
    return wrap_statement("", re.sub(r"(?<!,) ", FIRM, head))


class PrintedFunction:
    """A printed function is the body of a kernel: loads, then named constants, then stores.

    Attributes:
        loads: {port: names and texts of the elements that are read}.
        stores: target of every store, its text, and a note.
        cleared: outputs that are set to zero before the other stores.
    """

    def __init__(self, kernel: Kernel, style: CStyle, others: Iterable[str] = ()) -> None:
        self.kernel, self.style, names = kernel, style, style.names
        taken = Taken(names, (*(p.name for p in (*kernel.reads, *kernel.writes)), *others))
        texts: dict[tuple[int, int], str] = {}
        self.loads: dict[Port, list[tuple[str, str]]] = {}
        for port, e in sorted(find_loads(kernel)):
            p = kernel.inputs[port]
            texts[port, e] = taken.of(names.signal(kernel.name, p.name, e, p.size), f"{p.name}_{e}")
            self.loads.setdefault(p, []).append((texts[port, e], f"{p.name}[{e}]"))
        self.expressions = NestedExpressions(kernel, style, lambda port, e: texts[port, e], taken)
        dense = any(p.flat for p in (*kernel.inputs, *kernel.outputs))
        zeros = [o for o, _, v in kernel.stores if kernel.is_zero(v)]
        outputs = enumerate(kernel.outputs)
        self.cleared = [o for o, port in outputs if dense and zeros.count(o) >= CLEARED]
        self.stores = [
            (f"{kernel.outputs[o].name}{at(kernel.outputs[o], e)}", self.expressions.text(v), self._note(o, e))
            for o, e, v in kernel.stores
            if o not in self.cleared or not kernel.is_zero(v)
        ]

    def lines(self) -> list[str]:
        """Return all statements."""
        indent = "    "
        declarations = [line for held in self.loads.values() for line in declare(self.style.real, held)]
        statements = (*declarations, *self.expressions.statements)
        lines = [part for line in statements for part in wrap_statement(indent, line)]
        for o in self.cleared:
            port = self.kernel.outputs[o]
            size = f"sizeof({self.style.real}[{port.size}])"
            lines.append(f"{indent}(void)memset({port.name}, 0, {size});")
        for target, text, note in self.stores:
            lines += statement(indent, f"{target} = {text}", note)
        return lines

    def _note(self, output: int, element: int) -> str:
        """Return the note on the element of an output."""
        port = self.kernel.outputs[output]
        return result_note(port.name, port.cols, element, self.style.names)


def result_note(name: str, columns: int, element: int, names: LocalNames) -> str:
    """Return ``phi+`` for an element of x_next, ``d omega+ / d phi`` for one of S."""
    row, column = divmod(element, columns) if columns else (element, 0)
    of_row, of_column = names.variable(row), names.variable(column)
    if not of_row:
        return ""
    if name == "S" and columns and of_column:
        return f"d {of_row}+ / d {of_column}"
    return {"x_next": f"{of_row}+", "g": f"d / d {of_row}"}.get(name, "") if not columns else ""


def first_short(cuts: Iterable[Cut], longest: Callable[[Cut], int]) -> Cut:
    """Return the first cut whose ``longest`` function has at most LONGEST_FUNCTION lines; by default the last cut."""
    for cut in cuts:
        if longest(cut) <= LONGEST_FUNCTION:
            break
    return cut


def pointer(ports: Iterable[Port]) -> str:
    """Return a name for a pointer to values that several functions of a kernel share; no port has this name."""
    names = {port.name for port in ports}
    return next(name for name in ("w", "work", "shared") if name not in names)


def at(port: Port, element: int) -> str:
    """Return the index of an element of a port."""
    return "[{}][{}]".format(*divmod(element, port.cols)) if port.cols else f"[{element}]"


def statement(indent: str, text: str, note: str) -> list[str]:
    """Return the lines of a statement, with a note after it, or above it if it does not fit."""
    lines = wrap_statement(indent, f"{text};")
    if not note:
        return lines
    beside = f"{lines[-1]} /* {note} */"
    return [*lines[:-1], beside] if len(beside) <= WIDTH else [f"{indent}/* {note} */", *lines]


def find_loads(kernel: Kernel) -> set[tuple[int, int]]:
    """Return (port, element) of all loads."""
    return {(ins.args[0], ins.args[1]) for ins in kernel.instructions if ins.opcode == ca.OP_INPUT}
