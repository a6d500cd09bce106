"""Long straight-line kernels are printed as several C functions; a struct holds the values that later ones read.

The pieces begin where the stages of a scheme begin. Compilers inline them and keep the members in registers, so that
the program is the same as one function.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from nmpc_codegen.ir.kernel import Kernel, Port
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.kernels import (
    LONGEST_FUNCTION,
    PrintedFunction,
    describe,
    first_short,
    parameters,
    pointer,
    print_kernel,
    signature,
    statement,
    wrapped_head,
)
from nmpc_codegen.ir.printing.nested_expressions import declare, wrap_statement

#: Lengths of a piece between its loads and its end, in lines; the first one is used that makes no function too long.
LENGTHS = (50, 46, 42, 38, 32, 26, 20)

_NAME = re.compile(r"(?<![.\w])(?<!->)[A-Za-z_]\w*")


@dataclass(frozen=True)
class PieceStep:
    """A step is a constant with this name, or a store to a target with a note, and its text."""

    name: str
    target: str
    text: str
    note: str

    @property
    def names(self) -> set[str]:
        """Return the names that the step reads."""
        return set(_NAME.findall(self.text))

    @property
    def length(self) -> int:
        """Return the approximate number of lines of the step."""
        return len(wrap_statement("    ", f"{self.target or f'const real_t {self.name}'} = {self.text};"))


def print_straight(kernel: Kernel, style: CStyle) -> str:
    """Return the C function of a kernel; several functions if it is a long program of stages."""
    text = print_kernel(kernel, style)
    if not kernel.parts or text[text.index("*/") :].count("\n") <= LONGEST_FUNCTION:
        return text
    return first_short((_Pieces(kernel, style, n) for n in LENGTHS), lambda cut: cut.longest).text()


class _Pieces:
    """A kernel that is cut into functions."""

    def __init__(self, kernel: Kernel, style: CStyle, length: int) -> None:
        self.kernel, self.style = kernel, style
        self.pointer = pointer((*kernel.reads, *kernel.writes))
        self.function = PrintedFunction(kernel, style, (self.pointer,))
        self.ports = {name: port for port, held in self.function.loads.items() for name, _ in held}
        self.texts = {name: text for held in self.function.loads.values() for name, text in held}
        self.pieces = _cut(self._steps(), length)
        self.first_store = next(n for n, piece in enumerate(self.pieces) if any(step.target for step in piece))
        self.crossing = self._find_crossing()
        self.struct = f"{kernel.name}_values_t"

    def _steps(self) -> list[list[PieceStep]]:
        """Return the steps of every stage, and the stores."""
        stages: list[list[PieceStep]] = []
        for constant in self.function.expressions.constants:
            if constant.note or not stages:
                stages.append([])
            stages[-1].append(PieceStep(constant.name, "", constant.text, constant.note))
        return [*stages, [PieceStep("", target, text, note) for target, text, note in self.function.stores]]

    def _find_crossing(self) -> dict[str, int]:
        """Return {name that a later piece reads: piece that defines it}.

        An input counts as defined by the piece with the first store, which may change it.
        """
        defined = {step.name: n for n, piece in enumerate(self.pieces) for step in piece if step.name}
        found: dict[str, int] = {}
        for n, piece in enumerate(self.pieces):
            for name in _read(piece):
                place = self.first_store if name in self.texts else defined.get(name, n)
                if place < n:
                    found[name] = place
        order = [*self.texts, *defined]
        return {name: found[name] for name in order if name in found}

    @property
    def longest(self) -> int:
        """Return the number of lines of the longest function of a piece."""
        return max(self._piece(n).count("\n") for n in range(len(self.pieces)))

    def text(self) -> str:
        """Return the struct, the pieces, and the function that calls them."""
        pieces = [self._piece(n) for n in range(len(self.pieces))]
        calls = [f"    {self.struct} {self.pointer};"]
        for n in range(len(self.pieces)):
            passed = [*(p.name for p in self._ports(n)), *([f"&{self.pointer}"] if self._crosses(n) else [])]
            calls += wrap_statement("    ", f"{self._name(n)}({', '.join(passed)});")
        head = wrapped_head(signature(self.kernel.name, self.kernel.reads, self.kernel.writes, self.style))
        main = "\n".join([describe(self.kernel), *head, "{", *calls, "}"])
        return "\n\n".join([self._struct(), *pieces, main])

    def _name(self, n: int) -> str:
        return f"{self.kernel.name}_part_{n + 1}"

    def _struct(self) -> str:
        what = f"values of {self.kernel.name} that several of its parts read; t1, t2, ...: factors"
        lines = [f"typedef struct {{ /* {what} */"]
        for n in range(len(self.pieces)):
            names = [name for name, place in self.crossing.items() if place == n]
            if names:
                lines.append(f"    /* {self._describe_stages(n)} */")
                lines += wrap_statement("    ", f"{self.style.real} {', '.join(names)};")
        return "\n".join([*lines, f"}} {self.struct};"])

    def _describe_stages(self, n: int) -> str:
        """Return the stages of a piece in words."""
        notes = [step.note for piece in self.pieces[: n + 1] for step in piece if step.note and not step.target]
        own = [step.note for step in self.pieces[n] if step.note and not step.target]
        if all(step.target for step in self.pieces[n]):
            return "results"
        begins = self.pieces[n][0].note
        first = begins or next(reversed(notes[: len(notes) - len(own)]), "values")
        last = own[-1] if own else first
        return first if first == last else f"{first} - {last}"

    def _ports(self, n: int) -> list[Port]:
        """Return the ports that a piece reads or writes."""
        piece = self.pieces[n]
        read = {self.ports[name].name for name in _read(piece) if name in self.ports and n <= self.first_store}
        if n == self.first_store:
            read |= {self.ports[name].name for name in self.crossing if name in self.ports}
        written = {_NAME.findall(step.target)[0] for step in piece if step.target}
        kernel = self.kernel
        return [
            *(p for p in kernel.reads if p.name in read),
            *(p for p in kernel.writes if p.name in written),
        ]

    def _crosses(self, n: int) -> bool:
        """Return True if a piece defines or reads values that other pieces share."""
        read = {name for name in _read(self.pieces[n]) if self.crossing.get(name, n) < n}
        return bool(read) or n in self.crossing.values()

    def _piece(self, n: int) -> str:
        """Return the function of a piece."""
        piece, indent = self.pieces[n], "    "
        own = {name for name, place in self.crossing.items() if place == n}
        read = [name for name in self.texts if name in _read(piece) and n <= self.first_store]
        lines: list[str] = []
        for held in self.function.loads.values():
            names = [(name, text) for name, text in held if name in read and name not in own]
            lines += [part for line in declare(self.style.real, names) for part in wrap_statement(indent, line)]
        for name in self.texts:
            if name in own:
                lines.append(f"{indent}{self.pointer}->{name} = {self.texts[name]};")
        member = {*self.crossing} - ({*self.texts} if n < self.first_store else set())
        for step in piece:
            text = _NAME.sub(lambda found: f"{self.pointer}->{found[0]}" if found[0] in member else found[0], step.text)
            if step.target:
                lines += statement(indent, f"{step.target} = {text}", step.note)
                continue
            lines += [f"{indent}/* {step.note} */"] if step.note and step is not piece[0] else []
            target = f"{self.pointer}->{step.name}" if step.name in own else f"const {self.style.real} {step.name}"
            lines += wrap_statement(indent, f"{target} = {text};")
        values = [f"{'' if own else 'const '}{self.struct} *{self.pointer}"] if self._crosses(n) else []
        arguments = [*parameters(self._ports(n), self.kernel.writes, self.style), *values]
        head = wrapped_head(f"static void {self._name(n)}({', '.join(arguments)})")
        return "\n".join([f"/* {self.kernel.name}: {self._describe_stages(n)} */", *head, "{", *lines, "}"])


def _read(piece: Iterable[PieceStep]) -> Collection[str]:
    """Return the names that a piece reads."""
    return set[str]().union(*(step.names for step in piece))


def _cut(stages: Sequence[Sequence[PieceStep]], longest: int) -> list[list[PieceStep]]:
    """Return pieces of whole stages, as long as allowed; a longer stage becomes several pieces of similar length."""
    pieces: list[list[PieceStep]] = []
    length = 0
    for stage in stages:
        own = sum(step.length for step in stage)
        if pieces and length + own <= longest:
            pieces[-1] += stage
            length += own
            continue
        number = -(-own // longest)
        pieces.append([])
        length = 0
        for step in stage:
            if length >= own / number:
                pieces.append([])
                length = 0
            pieces[-1].append(step)
            length += step.length
    return pieces
