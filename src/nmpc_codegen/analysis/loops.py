"""What the text of a loop or block says, before anything is evaluated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from pycparser import c_ast

from nmpc_codegen.analysis.c_source import assigned_names

_EXIT = c_ast.Return | c_ast.Break | c_ast.Continue


@dataclass(frozen=True)
class Counter:
    """The counter of a loop: its first value, the size of its steps (None: 1), and whether it counts up."""

    name: str
    first: c_ast.Node
    step: c_ast.Node | None
    up: bool


def counter_of(node: c_ast.For) -> Counter | None:
    """The variable that the loop starts, steps and does not change otherwise; None: there is none."""
    step, up = None, True
    match node.next:
        case c_ast.UnaryOp(op="p++" | "++", expr=c_ast.ID(name=changed)):
            pass
        case c_ast.UnaryOp(op="p--" | "--", expr=c_ast.ID(name=changed)):
            up = False
        case c_ast.Assignment(op="+=" | "-=", lvalue=c_ast.ID(name=changed)):
            step, up = node.next.rvalue, node.next.op == "+="
        case _:
            return None
    started = _start_values(node.init)
    if changed not in started or changed in assigned_names(node.stmt):
        return None
    return Counter(changed, started[changed], step, up)


def _start_values(init: c_ast.Node | None) -> Mapping[str, c_ast.Node]:
    """Variables that the start of a loop sets, with their values."""
    if isinstance(init, c_ast.DeclList):
        return {d.name: d.init for d in init.decls if d.init is not None}
    starts = init.exprs if isinstance(init, c_ast.ExprList) else (init,)
    return {
        s.lvalue.name: s.rvalue for s in starts if isinstance(s, c_ast.Assignment) and isinstance(s.lvalue, c_ast.ID)
    }


def items(node: c_ast.Node | None) -> Sequence[c_ast.Node]:
    """The statements of a block."""
    if node is None:
        return ()
    return (node.block_items or ()) if isinstance(node, c_ast.Compound) else (node,)


def leaves(statements: Sequence[c_ast.Node]) -> bool:
    """True if a block does not run to its end."""
    return bool(statements) and isinstance(statements[-1], _EXIT)


def stated_passes(loop: c_ast.Node) -> str | None:
    """What the first line of a loop says about its passes."""
    body = items(loop.stmt)
    first = body[0].string if body and isinstance(body[0], c_ast.Pragma) else None
    return first if first is not None and ":" not in first else None


def conjuncts(node: c_ast.Node | None) -> Iterator[c_ast.Node]:
    """The conditions of which ``a && b && ...`` consists."""
    if isinstance(node, c_ast.BinaryOp) and node.op == "&&":
        yield from conjuncts(node.left)
        yield from conjuncts(node.right)
    elif node is not None:
        yield node


def is_sum_with(node: c_ast.Node, counter: str) -> bool:
    """True if the expression is the counter plus terms without it."""
    match node:
        case c_ast.ID():
            return bool(node.name == counter)
        case c_ast.BinaryOp(op="+"):
            found = [side for side in (node.left, node.right) if counter in names_in(side)]
            return len(found) == 1 and is_sum_with(found[0], counter)
        case c_ast.BinaryOp(op="-"):
            return is_sum_with(node.left, counter) and counter not in names_in(node.right)
    return False


@lru_cache(maxsize=1 << 16)
def is_plain(node: c_ast.Node) -> bool:
    """True if an expression neither calls nor chooses, so that its operations depend on no value."""
    chooses = isinstance(node, c_ast.TernaryOp | c_ast.FuncCall) or getattr(node, "op", "") in ("&&", "||")
    return not chooses and all(is_plain(child) for _, child in node.children())


@lru_cache(maxsize=1 << 16)
def names_in(node: c_ast.Node) -> frozenset[str]:
    """The names in an expression."""
    own = frozenset({node.name} if isinstance(node, c_ast.ID) else ())
    return own.union(*(names_in(child) for _, child in node.children()))
