"""Text of a function -> its operations over the values of its integer parameters and of the counters of its loops.

A variable that is set once stands for its expression. The result is kept by the text of the function, for all units
in which the names in it mean the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from pycparser import c_ast

from nmpc_codegen.bounds.c_source import CFunction, CMacro, assigned_names, declared
from nmpc_codegen.bounds.costs import Expected, Loop, Operations, Return, Stated, branched, total
from nmpc_codegen.bounds.expressions import UNKNOWN, Between, Expression, Passes, Slot, joined, made, number
from nmpc_codegen.bounds.measure import POINTER, Measure, Scope, Variable
from nmpc_codegen.bounds.names import INT, Names

_EXIT = c_ast.Return | c_ast.Break | c_ast.Continue


@dataclass(frozen=True)
class Program:
    """Operations of a function over its parameters and the counters of its loops."""

    operations: Operations
    counters: int


def program_of(function: CFunction, names: Names) -> Program:
    """The program of a function in the unit with these names."""
    known = _programs(function)
    for asked, program in known:
        if asked.same_in(names):
            return program
    own = names.another()
    program = _Translator(function, own).program()
    known.append((own, program))
    return program


def constant_value(macro: CMacro, names: Names) -> Expression:
    """Value of a macro without parameters."""
    return Measure("", names).value(macro.expression, {})


@lru_cache(maxsize=4096)
def _programs(function: CFunction) -> list[tuple[Names, Program]]:
    return []


class _Translator:
    """Translation of the statements of one function."""

    def __init__(self, function: CFunction, names: Names) -> None:
        self._function = function
        self._bodies: dict[c_ast.For, set[str]] = {}
        self._changed = assigned_names(function.tree.body, self._bodies)
        self._measure = Measure(function.name, names)
        self._counters = 0

    def program(self) -> Program:
        """The program of the function."""
        scope: Scope = {}
        for i, (name, ctype) in enumerate(self._function.parameters):
            known = name not in self._changed and ctype in (INT, POINTER)
            scope[name] = Variable(ctype, made(Slot, i) if known else UNKNOWN)
        operations = self._block(_items(self._function.tree.body), scope)
        return Program(operations, self._counters)

    def _block(self, items: Sequence[c_ast.Node], scope: Scope) -> Operations:
        """Statements in sequence, up to one that leaves the block."""
        parts: list[Operations] = []
        for i, item in enumerate(items):
            if isinstance(item, c_ast.If):
                return total((*parts, self._branch(item, items[i + 1 :], scope)))
            parts.append(self._statement(item, scope))
            if isinstance(item, _EXIT):
                break
        return total(parts)

    def _branch(self, item: c_ast.If, rest: Sequence[c_ast.Node], scope: Scope) -> Operations:
        """An `if` and the statements after it, which a branch that leaves the block does not reach."""
        test, condition = self._measure.cost(item.cond, scope), self._measure.value(item.cond, scope)
        then, other = _items(item.iftrue), _items(item.iffalse)
        leaves = (_leaves(then), _leaves(other))
        branches = (self._block(then, dict(scope)), self._block(other, dict(scope)))
        after = 0 if all(leaves) else self._block(rest, scope)
        return total((test, branched(condition, branches, leaves, after)))

    def _statement(self, node: c_ast.Node | None, scope: Scope) -> Operations:
        match node:
            case None | c_ast.EmptyStatement() | c_ast.Break() | c_ast.Continue():
                return 0
            case c_ast.Decl():
                return self._declaration(node, scope)
            case c_ast.DeclList():
                return total([self._declaration(d, scope) for d in node.decls])
            case c_ast.Compound() | c_ast.If():
                return self._block(_items(node), dict(scope))
            case c_ast.For():
                return self._for(node, scope)
            case c_ast.While() | c_ast.DoWhile():
                test = self._measure.cost(node.cond, scope)
                return self._loop(node, None, None, test, self._statement(node.stmt, dict(scope)), scope)
            case c_ast.Return():
                return self._return(node, scope)
            case c_ast.Pragma():
                return self._take_values(node, scope)
        return self._measure.cost(node, scope)

    def _return(self, node: c_ast.Return, scope: Scope) -> Operations:
        cost = self._measure.cost(node.expr, scope)
        if self._function.result != INT:
            return cost
        return total((cost, Return(self._measure.value(node.expr, scope))))

    def _declaration(self, node: c_ast.Decl, scope: Scope) -> Operations:
        constant = node.init is not None and node.name not in self._changed
        cost = self._measure.cost(node.init, scope)
        value = self._measure.value(node.init, scope) if constant else UNKNOWN
        scope[node.name] = Variable(declared(node.type), value)
        return cost

    def _take_values(self, node: c_ast.Pragma, scope: Scope) -> Operations:
        """Values of a variable as a comment states them."""
        name, separator, limits = node.string.partition(":")
        if not separator:
            return 0
        least, most = (self._stated_value(text, scope) for text in limits.split(";"))
        stated = made(Between, least, most)
        scope[name] = Variable(scope[name].type if name in scope else INT, stated)
        return Expected(stated, f"{self._function.name}: the stated values of {name} are unknown")

    def _stated_value(self, text: str, scope: Scope) -> Expression:
        return self._measure.value(CMacro((), text).expression, scope)

    # -- loops --------------------------------------------------------------------------------------------------------

    def _for(self, node: c_ast.For, outer: Scope) -> Operations:
        scope = dict(outer)
        counter = self._counter(node, scope)
        start = self._statement(node.init, scope)
        for name in _counters(node):
            scope[name] = Variable(scope[name].type if name in scope else INT)
        slot = passes = None
        if counter is not None and _stated(node) is None:
            name, first, step, up = counter
            limits = self._limits(node.cond, name, up, scope)
            slot, passes = len(self._function.parameters) + self._counters, made(Passes, first, step, up, limits)
            self._counters += 1
            scope[name] = Variable(scope[name].type, made(Slot, slot))
        test, after = self._measure.cost(node.cond, scope), self._measure.cost(node.next, scope)
        body = total((self._statement(node.stmt, dict(scope)), after))
        return total((start, self._loop(node, slot, passes, test, body, scope)))

    def _loop(
        self,
        node: c_ast.Node,
        slot: int | None,
        passes: Passes | None,
        test: Operations,
        body: Operations,
        scope: Scope,
    ) -> Operations:
        if test == 0 and body == 0:
            return 0
        comment, stated = _stated(node), None
        if comment is not None:
            text, _, function = comment.partition(" in ")
            stated = Stated(self._stated_value(text, scope), text, function)
        return Loop(self._function.name, slot, passes, test, body, stated)

    def _counter(self, node: c_ast.For, scope: Scope) -> tuple[str, Expression, Expression, bool] | None:
        """Name, first value and size of the steps of a counter, and whether it counts up."""
        started = _started(node.init)
        step, up = number(1), True
        match node.next:
            case c_ast.UnaryOp(op="p++" | "++", expr=c_ast.ID(name=changed)):
                pass
            case c_ast.UnaryOp(op="p--" | "--", expr=c_ast.ID(name=changed)):
                up = False
            case c_ast.Assignment(op="+=" | "-=", lvalue=c_ast.ID(name=changed)):
                step, up = self._measure.value(node.next.rvalue, scope), node.next.op == "+="
            case _:
                return None
        if changed not in started or changed in self._bodies[node]:
            return None
        return changed, self._measure.value(started[changed], scope), step, up

    def _limits(self, cond: c_ast.Node | None, counter: str, up: bool, scope: Scope) -> tuple[Expression, ...]:
        """Values that the counter does not reach, from comparisons of ``counter + constant`` with other values."""
        found = []
        start = scope | {counter: Variable(INT, number(0))}
        for part in _conjuncts(cond):
            if not isinstance(part, c_ast.BinaryOp) or part.op not in (("<", "<=") if up else (">", ">=")):
                continue
            if not _adds(part.left, counter) or _contains(part.right, counter):
                continue
            offset, limit = self._measure.value(part.left, start), self._measure.value(part.right, scope)
            limit = limit if offset is number(0) else joined("-", limit, offset)
            found.append(joined("+" if up else "-", limit, number(1)) if "=" in part.op else limit)
        return tuple(found)


def _started(init: c_ast.Node | None) -> Mapping[str, c_ast.Node]:
    """Variables that the start of a loop sets, with their values."""
    if isinstance(init, c_ast.DeclList):
        return {d.name: d.init for d in init.decls if d.init is not None}
    starts = init.exprs if isinstance(init, c_ast.ExprList) else (init,)
    return {
        s.lvalue.name: s.rvalue for s in starts if isinstance(s, c_ast.Assignment) and isinstance(s.lvalue, c_ast.ID)
    }


def _counters(node: c_ast.For) -> set[str]:
    """Variables that the steps of a loop change."""
    return set() if node.next is None else assigned_names(node.next, {})


def _items(node: c_ast.Node | None) -> Sequence[c_ast.Node]:
    if node is None:
        return ()
    return (node.block_items or ()) if isinstance(node, c_ast.Compound) else (node,)


def _leaves(items: Sequence[c_ast.Node]) -> bool:
    return bool(items) and isinstance(items[-1], _EXIT)


def _stated(loop: c_ast.Node) -> str | None:
    """What the first line of a loop says about its passes."""
    body = _items(loop.stmt)
    first = body[0].string if body and isinstance(body[0], c_ast.Pragma) else None
    return first if first is not None and ":" not in first else None


def _conjuncts(node: c_ast.Node | None) -> Iterator[c_ast.Node]:
    if isinstance(node, c_ast.BinaryOp) and node.op == "&&":
        yield from _conjuncts(node.left)
        yield from _conjuncts(node.right)
    elif node is not None:
        yield node


def _adds(node: c_ast.Node, counter: str) -> bool:
    """The expression is the counter plus terms without it."""
    match node:
        case c_ast.ID():
            return bool(node.name == counter)
        case c_ast.BinaryOp(op="+"):
            return _adds(node.left, counter) != _adds(node.right, counter) and not (
                _contains(node.left, counter) and _contains(node.right, counter)
            )
        case c_ast.BinaryOp(op="-"):
            return _adds(node.left, counter) and not _contains(node.right, counter)
    return False


def _contains(node: c_ast.Node, name: str) -> bool:
    return (isinstance(node, c_ast.ID) and node.name == name) or any(_contains(c, name) for _, c in node.children())
