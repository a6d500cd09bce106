"""Sweeps whose buffers are members of structs (a frame) are printed as C functions.

Every leaf is printed inline, as nested expressions on the members. Outputs may alias inputs, so either all loads or all
results are first stored in named constants: inside a loop the loads, with loop-invariant loads before it; elsewhere the
results. A direct call needs neither.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache

from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.kernels import block, find_loads, print_count, wrapped_head
from nmpc_codegen.ir.printing.nested_expressions import NestedExpressions, declare, wrap_statement
from nmpc_codegen.ir.sweep import Affine, Block, Call, Entries, For, Frame, If, LoopedRoutine, Node, Slice, calls

#: Text of a load -> name of the constant that holds it.
Names = dict[str, str]


def print_frame(routine: LoopedRoutine, style: CStyle) -> str:
    """Return the C function of a sweep with a frame, with its formula and operation count above it."""
    sweep, frame = routine.sweep, routine.sweep.frame
    assert frame is not None
    lines = _body(routine, style)
    parameters = [text for name, text in name_parameters(frame).items() if name in _names(lines)]
    head = f"static {'inline ' if frame.inline else ''}void {sweep.name}({', '.join(parameters)})"
    return "\n".join([block(sweep.doc, print_count(routine.count)), *wrapped_head(head), "{", *lines, "}"])


def call(routine: LoopedRoutine, style: CStyle) -> tuple[tuple[str, ...], str]:
    """Return the names of all parameters of a product, and its call with the parameters that it reads or writes."""
    frame = routine.sweep.frame
    assert frame is not None
    names = tuple(name_parameters(frame))
    used = _names(_body(routine, style))
    return names, f"{routine.name}({', '.join(name for name in names if name in used)})"


def name_parameters(frame: Frame) -> dict[str, str]:
    """Return {name: declaration} of every parameter."""
    stripped = (re.sub(r"\W*(?:\[\w+\])*$", "", p) for p in frame.parameters)
    return {s.split("*")[-1].split(" ")[-1]: p for s, p in zip(stripped, frame.parameters, strict=True)}


@lru_cache(maxsize=256)
def _body(routine: LoopedRoutine, style: CStyle) -> tuple[str, ...]:
    """Return the statements of the function; definition and calls name only the parameters that these use."""
    frame = routine.sweep.frame
    assert frame is not None
    printer = _Printer(routine, frame, style)
    return (*_declarations(routine, frame, style), *printer.block(routine.sweep.body, "    ", {}, set()))


def _names(lines: Iterable[str]) -> set[str]:
    return set(re.findall(r"\w+", "\n".join(lines)))


def _declarations(routine: LoopedRoutine, frame: Frame, style: CStyle) -> list[str]:
    """Return declarations of the local arrays; scalars are declared at their first assignment."""
    arrays = [frame.places[name] for name, _ in routine.sweep.locals if name in routine.touched]
    return [f"    {style.real} {a.text}{''.join(f'[{n}]' for n in a.shape)};" for a in arrays if a.shape]


class _Printer:
    """A printer prints the nodes of one sweep."""

    def __init__(self, routine: LoopedRoutine, frame: Frame, style: CStyle) -> None:
        self._leaves, self._places, self._style = routine.leaves, frame.places, style
        self._stored = {s.buffer for call in calls(routine.sweep.body) for s in call.outs}

    def block(self, nodes: tuple[Node, ...], indent: str, names: Names, scalars: set[str]) -> list[str]:
        """Return the statements of a block; its declarations are in scope until its end."""
        names, scalars = dict(names), set(scalars)
        lines: list[str] = []
        for node in nodes:
            if isinstance(node, Block):
                lines += self._print_nest(node, indent, names, scalars)
            else:
                assert isinstance(node, Call), "functions that are written in C are called in no frame"
                lines += self._call(node, indent, names, scalars)
        return lines

    def _print_nest(self, node: Block, indent: str, names: Names, scalars: set[str]) -> list[str]:
        """Print a loop or a condition; loads that do not depend on an innermost loop come before it."""
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
        """Return constants that hold loads: all, or for a loop ``index`` those that the loop does not change."""
        held: list[tuple[str, str]] = []
        for port, element in sorted(find_loads(self._leaves[call.leaf.name()])):
            s = call.ins[port]
            text, name = self._element(s, element), self._name(s, element)
            fixed = s.buffer not in self._stored and all(i != index for i, _ in s.offset.terms)
            if text not in names and name not in names.values() and (fixed or index is None):
                names[text] = name
                held.append((name, text))
        return [part for line in declare(self._style.real, held) for part in wrap_statement(indent, line)]

    def _stores(self, call: Call, indent: str, names: Names, scalars: set[str], named: bool) -> list[str]:
        """Return statements that store the results; if ``named``, all are computed as constants before any store."""
        kernel = self._leaves[call.leaf.name()]

        def load(port: int, element: int) -> str:
            text = self._element(call.ins[port], element)
            return names.get(text, text)

        expressions = NestedExpressions(kernel, self._style, load)
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
        return [part for line in lines + last for part in wrap_statement(indent, line)]

    def _element(self, s: Slice, element: int) -> str:
        """Return the C text of an element of a slice."""
        place = self._places[s.buffer]
        constant = s.offset.constant + s.stride * element if element else s.offset.constant
        if not place.shape:
            return place.text
        if len(place.shape) == 1:
            return f"{place.text}[{Affine(constant, s.offset.terms).c()}]"
        row, column = Affine(constant, s.offset.terms).split(int(place.shape[1]))
        return f"{place.text}[{row.c()}][{column.c()}]"

    def _name(self, s: Slice, element: int) -> str:
        """Return the name of the constant that holds the element."""
        place = self._places[s.buffer]
        if len(place.shape) == 2 and not s.offset.terms:
            return "_".join(map(str, (s.buffer, *divmod(s.offset.constant + s.stride * element, int(place.shape[1])))))
        return f"{s.buffer}_{element}"


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
