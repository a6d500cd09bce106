"""Passes on sweeps: fuse or expand the loops over steps, fix or shift the step of a node.

A loop over steps has the index ``step``; the data of one step are at an offset that is linear in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca

from nmpc_codegen.ir.casadi_types import Function
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, Sweep, Written, unroll


def copy(name: str, n: int) -> Function:
    """y = x."""
    x = ca.SX.sym("x", n)
    return ca.Function(name, [x], [x], ["x"], ["y"])


def fuse_steps(sweep: Sweep) -> Sweep:
    """The sweep with the body of every loop over steps unrolled into one leaf."""
    sizes = dict(sweep.locals) | {p.name: p.size for p in (*sweep.inputs, *sweep.outputs)}
    users = [_slices(node) for node in sweep.body]
    body: list[Node] = []
    for node, own in zip(sweep.body, users, strict=True):
        if isinstance(node, For) and node.index == "step":
            others = {s.buffer for found in users if found is not own for s, _ in found}
            node = replace(node, body=(_fuse(node, own, others, sizes, len(body)),))
        body.append(node)
    used = {s.buffer for node in body for s, _ in _slices(node)}
    kept = tuple(local for local in sweep.locals if local[0] in used)
    return replace(sweep, locals=kept, body=tuple(body))


def _slices(node: Node) -> list[tuple[Slice, bool]]:
    """(slice, written) of all calls of a node, in the order of execution."""
    if isinstance(node, Written):
        return [(s, False) for s in node.ins if isinstance(s, Slice)] + [(s, True) for s in node.outs]
    if not isinstance(node, Call):
        return [found for inner in node.body for found in _slices(inner)]
    return [(s, False) for s in node.ins] + [(s, True) for s in node.outs]


def _fuse(loop: For, own: list[tuple[Slice, bool]], others: set[str], sizes: dict[str, int], number: int) -> Call:
    """One iteration of the loop as a leaf on the buffers that are visible outside, whole or their part of a step."""
    written = dict.fromkeys(s.buffer for s, out in own if out)
    first: dict[str, bool] = {}
    for s, out in own:
        first.setdefault(s.buffer, out)
    part: dict[str, int] = {}
    for s, _ in own:
        step = dict(s.offset.terms).get("step", 0)
        part[s.buffer] = max(part.get(s.buffer, 0), step)
    visible = [b for b in first if b in others or (b in sizes and not first[b])]
    slices = {b: Slice(b, part[b], Affine(0, (("step", part[b]),))) if part[b] else Slice(b, sizes[b]) for b in visible}
    ports = {b: Port(f"{b}_0", slices[b].size) for b in visible}
    load: tuple[Node, ...] = tuple(
        Call(copy(f"load_{b}", s.size), (Slice(ports[b].name, s.size),), (Slice(b, s.size),)) for b, s in slices.items()
    )
    outs = [b for b in visible if b in written]
    inner = tuple((b, part[b] or sizes[b]) for b in first if b not in outs)
    results = tuple(Port(b, slices[b].size) for b in outs)
    body = (*load, For("step", 0, 1, loop.body))
    once = Sweep(f"step_{number}", "one step", tuple(ports.values()), results, inner, body)
    return Call(unroll(once), tuple(slices.values()), tuple(slices[b] for b in outs))


def expand_steps(sweep: Sweep) -> Sweep:
    """The sweep with loops over steps unrolled and every leaf printed inline; loops over columns remain."""
    body: list[Node] = []
    for node in sweep.body:
        if isinstance(node, For) and node.index == "step":
            for value in node.values({}):
                body += [fix_step(inner, value, inline=True) for inner in node.body]
        else:
            body.append(_map(node, lambda s: s, True))
    return replace(sweep, body=tuple(body))


def fix_step(node: Node, step: int, inline: bool = False) -> Node:
    """The node at one step; ``inline`` prints all of its leaves inline."""
    return bound(node, "step", step, inline)


def bound(node: Node, index: str, value: int, inline: bool = False) -> Node:
    """The node with a value in the place of an index."""

    def at(s: Slice) -> Slice:
        terms = tuple(t for t in s.offset.terms if t[0] != index)
        return Slice(s.buffer, s.size, Affine(s.offset.at_one(index, value), terms), s.stride)

    return _map(node, at, inline, lambda call: replace(call, step=value) if index == "step" else call)


def shift_steps(node: Node, by: int) -> Node:
    """The node with all offsets moved forward ``by`` steps."""

    def later(s: Slice) -> Slice:
        return Slice(s.buffer, s.size, Affine(s.offset.at_one("step", by), s.offset.terms), s.stride)

    return _map(node, later)


def _map(
    node: Node,
    change: Callable[[Slice], Slice],
    inline: bool = False,
    mark: Callable[[Call], Call] = lambda call: call,
) -> Node:
    if isinstance(node, Written):
        return replace(
            node,
            ins=tuple(change(s) if isinstance(s, Slice) else s for s in node.ins),
            outs=tuple(map(change, node.outs)),
        )
    if not isinstance(node, Call):
        return replace(node, body=tuple(_map(n, change, inline, mark) for n in node.body))
    ins, outs = tuple(map(change, node.ins)), tuple(map(change, node.outs))
    return replace(mark(node), ins=ins, outs=outs, inline=node.inline or inline)
