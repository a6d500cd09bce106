"""Passes on sweeps and nodes replace a buffer or an index by a number, or copy a buffer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import casadi as ca

from nmpc_codegen.ir.casadi_types import Function
from nmpc_codegen.ir.sweep import Affine, Call, Node, Slice, Sweep, Written


def copy(name: str, n: int) -> Function:
    """Return the leaf y = x."""
    x = ca.SX.sym("x", n)
    return ca.Function(name, [x], [x], ["x"], ["y"])


def bound(node: Node, index: str, value: int) -> Node:
    """Return the node with a value instead of an index."""

    def at(s: Slice) -> Slice:
        terms = tuple(t for t in s.offset.terms if t[0] != index)
        return Slice(s.buffer, s.size, Affine(s.offset.at_one(index, value), terms), s.stride)

    return _map(node, at)


def _map(node: Node, change: Callable[[Slice], Slice]) -> Node:
    if isinstance(node, Written):
        ins = tuple(change(s) if isinstance(s, Slice) else s for s in node.ins)
        return replace(node, ins=ins, outs=tuple(map(change, node.outs)))
    if isinstance(node, Call):
        return replace(node, ins=tuple(map(change, node.ins)), outs=tuple(map(change, node.outs)))
    return replace(node, body=tuple(_map(n, change) for n in node.body))


def with_number(sweep: Sweep, buffer: str, value: float) -> Sweep:
    """Return the sweep with a number instead of a local buffer of one element; its leaves compute with the number."""
    return replace(
        sweep,
        locals=tuple(local for local in sweep.locals if local[0] != buffer),
        body=tuple(_with_number(sweep.body, buffer, value)),
    )


def _with_number(nodes: Iterable[Node], buffer: str, value: float) -> Iterator[Node]:
    for node in nodes:
        if isinstance(node, Written):
            yield node
        elif not isinstance(node, Call):
            yield replace(node, body=tuple(_with_number(node.body, buffer, value)))
        elif any(s.buffer == buffer for s in node.ins):
            yield _call_with_number(node, buffer, value)
        elif all(s.buffer != buffer for s in node.outs):
            yield node


def _call_with_number(call: Call, buffer: str, value: float) -> Call:
    leaf, symbols = call.leaf, call.leaf.sx_in()
    kept = [i for i, s in enumerate(call.ins) if s.buffer != buffer]
    results = leaf.call([symbols[i] if i in kept else ca.SX(value) for i in range(len(symbols))])
    names = [leaf.name_in(i) for i in kept]
    fixed = ca.Function(leaf.name(), [symbols[i] for i in kept], results, names, leaf.name_out())
    return replace(call, leaf=fixed, ins=tuple(call.ins[i] for i in kept))
