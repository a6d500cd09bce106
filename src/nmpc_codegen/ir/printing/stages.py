"""A sweep is cut into pieces under one comment each; pieces of stages that differ only by an index become a loop."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.ir.passes import bound
from nmpc_codegen.ir.sweep import Affine, Call, For, Node, Slice, calls

#: STAGE: index of a loop over stages. SHORT_COLUMN: largest number of instructions of a leaf in a loop over columns
#: inside such a loop; for longer leaves a variable index costs more than a tenth of the time.
STAGE, SHORT_COLUMN = "stage", 12

_OF_STAGE = re.compile(r"(.*\b)stage (\d+)$")

Leaves = Mapping[str, Kernel]


@dataclass(eq=False)
class Piece:
    """A piece is a group of nodes that are printed under one comment.

    ``name``: C function that contains the nodes, "" for the function of the sweep itself.
    """

    note: str
    nodes: list[Node] = field(default_factory=list)
    name: str = ""


@dataclass(frozen=True, eq=False)
class StageLoop:
    """A stage loop is a loop whose body is a sequence of pieces."""

    loop: For
    pieces: tuple[Piece | StageLoop, ...]


def cut(nodes: tuple[Node, ...], leaves: Leaves) -> tuple[Piece | StageLoop, ...]:
    """Return the pieces of nodes, each with the nodes under one comment.

    A loop over several comments is a loop over pieces.
    """
    found: list[Piece | StageLoop] = []
    for node in once(nodes):
        notes = {c.note for c in calls((node,)) if c.note}
        last = found[-1] if found else None
        if isinstance(node, For) and len(notes) > 1:
            found.append(StageLoop(node, cut(node.body, leaves)))
        elif isinstance(last, Piece) and (not notes or last.note in notes):
            last.nodes.append(node)
        else:
            found.append(Piece(note_of(node), [node]))
    return tuple(_loop_over_stages(found, leaves))


def flat(pieces: Iterable[Piece | StageLoop]) -> Iterator[Piece]:
    """Yield all pieces, including those of loops."""
    for piece in pieces:
        if isinstance(piece, StageLoop):
            yield from flat(piece.pieces)
        else:
            yield piece


def note_of(node: Node) -> str:
    """Return the comment of a node, "" if it has none or several."""
    notes = {c.note for c in calls((node,)) if c.note}
    return notes.pop() if len(notes) == 1 else ""


def once(nodes: tuple[Node, ...]) -> Iterator[Node]:
    """Yield the nodes; a loop that runs once is replaced by its body."""
    for node in nodes:
        if isinstance(node, For) and node.count == 1:
            yield from once(tuple(bound(inner, node.index, node.start) for inner in node.body))
        else:
            yield node


def _loop_over_stages(pieces: Sequence[Piece | StageLoop], leaves: Leaves) -> Iterator[Piece | StageLoop]:
    """Yield the pieces, with loops over those of adjacent equal stages."""
    place = 0
    while place < len(pieces):
        first, count, along = pieces[place], 1, None
        while place + count < len(pieces):
            step = _step(pieces[place + count - 1], pieces[place + count], leaves)
            if step is None or (along is not None and step != along):
                break
            along, count = step, count + 1
        if count > 1 and isinstance(first, Piece) and along is not None:
            yield _stages(first, count, along)
        else:
            yield first
            count = 1
        place += count


def _stages(first: Piece, count: int, along: Sequence[int]) -> StageLoop:
    """Return a loop over stages from that of the first piece."""
    found = _OF_STAGE.match(first.note)
    assert found is not None
    begin = int(found[2]) - 1
    note = f"{found[1]}stages {begin + 1} {'and' if count == 2 else 'to'} {begin + count}"
    steps = iter(along)
    nodes = [_move(node, begin, note, steps) for node in first.nodes]
    return StageLoop(For(STAGE, begin, count, tuple(nodes)), (Piece(note, nodes),))


def _move(node: Node, begin: int, note: str, steps: Iterator[int]) -> Node:
    """Return the node of stage ``begin`` for any stage; ``steps`` yields the offset between stages for every slice."""

    def move(s: Slice) -> Slice:
        step = next(steps)
        terms = (*s.offset.terms, *(((STAGE, step),) if step else ()))
        return replace(s, offset=Affine(s.offset.constant - step * begin, terms))

    if isinstance(node, For):
        return replace(node, body=tuple(_move(n, begin, note, steps) for n in node.body))
    assert isinstance(node, Call)
    ins, outs = tuple(map(move, node.ins)), tuple(map(move, node.outs))
    return replace(node, ins=ins, outs=outs, note=note)


def _step(one: Piece | StageLoop, two: Piece | StageLoop, leaves: Leaves) -> tuple[int, ...] | None:
    """Return the distances of the slices of two pieces if these are equal and belong to adjacent stages."""
    if isinstance(one, StageLoop) or isinstance(two, StageLoop):
        return None
    a, b = _OF_STAGE.match(one.note), _OF_STAGE.match(two.note)
    if not (a and b and a[1] == b[1] and int(b[2]) == int(a[2]) + 1):
        return None
    found = _apart(one.nodes, two.nodes, leaves)
    return found if found is not None and any(found) else None


def _apart(one: Sequence[Node], two: Sequence[Node], leaves: Leaves) -> tuple[int, ...] | None:
    each = [_apart_of_nodes(a, b, leaves) for a, b in zip(one, two, strict=False)]
    if len(one) != len(two) or None in each:
        return None
    return tuple(n for found in each if found for n in found)


def _apart_of_nodes(a: Node, b: Node, leaves: Leaves) -> tuple[int, ...] | None:
    if isinstance(a, For) and isinstance(b, For):
        if any(len(leaves[c.leaf.name()].instructions) > SHORT_COLUMN for c in calls(a.body)):
            return None
        same = (a.index, a.start, a.count, a.down) == (b.index, b.start, b.count, b.down)
        return _apart(a.body, b.body, leaves) if same else None
    if not (isinstance(a, Call) and isinstance(b, Call)):
        return None
    x, y = leaves[a.leaf.name()], leaves[b.leaf.name()]
    if (x.instructions, x.stores, a.inline) != (y.instructions, y.stores, b.inline):
        return None
    if (len(a.ins), len(a.outs)) != (len(b.ins), len(b.outs)):
        return None
    pairs = list(zip((*a.ins, *a.outs), (*b.ins, *b.outs), strict=True))
    if any(
        (s.buffer, s.size, s.stride, s.offset.terms) != (t.buffer, t.size, t.stride, t.offset.terms) for s, t in pairs
    ):
        return None
    return tuple(t.offset.constant - s.offset.constant for s, t in pairs)
