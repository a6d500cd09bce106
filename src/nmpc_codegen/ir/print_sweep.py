"""Print routines as C: one function, preceded by its leaves if it contains loops."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.ir.print_c import CStyle, comment, print_body, print_kernel, signature
from nmpc_codegen.ir.print_framed import print_framed
from nmpc_codegen.ir.sweep import Affine, Call, For, LoopedRoutine, Node, Routine, Slice, calls, passed


@lru_cache(maxsize=256)
def print_routine(routine: Routine, style: CStyle) -> str:
    """C text of a routine; a package reads it twice, for its bounds and for its file."""
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
