"""Syntax trees of expressions -> their operations, types and integer values over the slots of a function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pycparser import c_ast

from nmpc_codegen.bounds.c_source import CMacro, Type, declared
from nmpc_codegen.bounds.costs import Call, Counted, Impossible, Operations, branched, total
from nmpc_codegen.bounds.expressions import (
    UNKNOWN,
    Called,
    Either,
    Entry,
    Expression,
    Known,
    Member,
    Named,
    Negation,
    Table,
    joined,
    made,
    number,
)
from nmpc_codegen.bounds.names import INT, Names

#: Type of a pointer to integers, which may be a constant table.
POINTER = Type("int", 1)
_COMPARING = ("<", ">", "<=", ">=", "==", "!=")


@dataclass(frozen=True)
class Variable:
    """A variable in scope: its type, and its value or, for a pointer to integers, the table."""

    type: Type
    value: Expression = UNKNOWN


#: Variables by name.
Scope = dict[str, Variable]


class Measure:
    """Operations, types and values of the expressions of a function in a unit with these names."""

    def __init__(self, function: str, names: Names) -> None:
        self.function = function
        self.names = names

    def cost(self, node: c_ast.Node | None, scope: Scope) -> Operations:
        """Operations of an expression."""
        return self.measured(node, scope)[0]

    def measured(self, node: c_ast.Node | None, scope: Scope) -> tuple[Operations, Type]:
        """Operations and type of an expression. Macros are expanded; their arguments count once."""
        match node:
            case c_ast.ID():
                known = scope.get(node.name)
                return 0, self.names.constant(node.name) if known is None else known.type
            case None | c_ast.Constant() | c_ast.Typename() | c_ast.UnaryOp(op="sizeof"):
                return 0, INT
            case c_ast.ArrayRef():
                name, of = self.measured(node.name, scope)
                return total((name, self.cost(node.subscript, scope))), Type(of.base, of.depth - 1)
            case c_ast.StructRef():
                return self.cost(node.name, scope), self.names.member(node.field.name)
            case c_ast.BinaryOp():
                return self._binary(node, scope)
            case c_ast.UnaryOp():
                cost, of = self.measured(node.expr, scope)
                shift = {"*": -1, "&": 1}.get(node.op, 0)
                own = int(node.op == "-" and of.counts)
                return total((cost, own)), INT if node.op == "!" else Type(of.base, of.depth + shift)
            case c_ast.Assignment():
                (left, of), right = self.measured(node.lvalue, scope), self.cost(node.rvalue, scope)
                return total((left, right, int(node.op != "=" and of.counts))), of
            case c_ast.Cast():
                return self.cost(node.expr, scope), declared(node.to_type.type)
            case c_ast.TernaryOp():
                (then, of), other = self.measured(node.iftrue, scope), self.cost(node.iffalse, scope)
                chosen = branched(self.value(node.cond, scope), (then, other))
                return total((self.cost(node.cond, scope), chosen)), of
            case c_ast.FuncCall():
                return self._call(node, scope)
            case c_ast.ExprList() | c_ast.InitList() | c_ast.NamedInitializer() | c_ast.CompoundLiteral():
                return total([self.cost(child, scope) for _, child in node.children()]), INT
        return Impossible(f"{self.function}: {type(node).__name__} is not understood"), INT

    def _binary(self, node: c_ast.BinaryOp, scope: Scope) -> tuple[Operations, Type]:
        (left, a), (right, b) = self.measured(node.left, scope), self.measured(node.right, scope)
        if node.op in ("&&", "||"):
            evaluated = (right, 0) if node.op == "&&" else (0, right)
            return total((left, branched(self.value(node.left, scope), evaluated))), INT
        of = max(a, b, key=lambda t: (t.depth, t.base == "real"))
        return total((left, right, int(a.counts or b.counts))), INT if node.op in _COMPARING else of

    def _call(self, node: c_ast.FuncCall, scope: Scope) -> tuple[Operations, Type]:
        name, passed = node.name.name, [] if node.args is None else node.args.exprs
        callee = self.names.callee(name)
        arguments = total([self.cost(argument, scope) for argument in passed])
        if callee.macro is not None:
            own, of = self.measured(callee.macro.expression, self._expanded(callee.macro, passed, scope))
            return total((arguments, own)), of
        called: Operations = callee.operations
        if callee.kind == "counted":
            called = Counted(name)
        elif callee.kind == "function":
            called = Call(name, self._arguments(callee.parameters, passed, scope))
        elif callee.kind == "unknown":
            called = Impossible(f"{self.function} calls {name}, which is not of this package")
        return total((arguments, called)), callee.result

    def _arguments(self, types: Sequence[Type], passed: Sequence[c_ast.Node], scope: Scope) -> tuple[Expression, ...]:
        """Values of arguments of integer types; for pointers to integers the tables."""
        rules = {INT: self.value, POINTER: self._table}
        return tuple(
            rules[of](argument, scope) if of in rules else UNKNOWN for of, argument in zip(types, passed, strict=True)
        )

    def _table(self, node: c_ast.Node, scope: Scope) -> Expression:
        """The constant table that an expression names; the start of another one is unknown."""
        if not isinstance(node, c_ast.ID):
            return UNKNOWN
        known = scope.get(node.name)
        if known is None:
            return made(Table, node.name)
        return known.value if known.type == POINTER else UNKNOWN

    def _expanded(self, macro: CMacro, passed: Sequence[c_ast.Node], scope: Scope) -> Scope:
        """The scope in which the parameters of a macro are its arguments."""
        named = zip(macro.parameters, passed, strict=True)
        return scope | {p: Variable(self.measured(a, scope)[1], self.value(a, scope)) for p, a in named}

    def value(self, node: c_ast.Node | None, scope: Scope) -> Expression:
        """Value of an integer expression."""
        match node:
            case c_ast.Constant():
                return _literal(node)
            case c_ast.ID():
                known = scope.get(node.name)
                return made(Named, node.name) if known is None else UNKNOWN if known.type.depth else known.value
            case c_ast.BinaryOp():
                return joined(node.op, self.value(node.left, scope), self.value(node.right, scope))
            case c_ast.StructRef():
                return made(Member, node.field.name)
            case c_ast.ArrayRef(name=c_ast.ID()):
                table = self._table(node.name, scope)
                return UNKNOWN if table is UNKNOWN else made(Entry, table, self.value(node.subscript, scope))
            case c_ast.FuncCall():
                return self._returned(node, scope)
            case c_ast.UnaryOp(op="-"):
                return joined("-", number(0), self.value(node.expr, scope))
            case c_ast.UnaryOp(op="!"):
                operand = self.value(node.expr, scope)
                return made(Known, (0, 1)) if operand is UNKNOWN else made(Negation, operand)
            case c_ast.Cast():
                return self.value(node.expr, scope) if declared(node.to_type.type) == INT else UNKNOWN
            case c_ast.TernaryOp():
                parts = [self.value(n, scope) for n in (node.cond, node.iftrue, node.iffalse)]
                return made(Either, *parts)
        return UNKNOWN

    def _returned(self, node: c_ast.FuncCall, scope: Scope) -> Expression:
        """Value of a call."""
        name, passed = node.name.name, [] if node.args is None else node.args.exprs
        callee = self.names.callee(name)
        if callee.macro is not None:
            return self.value(callee.macro.expression, self._expanded(callee.macro, passed, scope))
        if callee.kind == "function" and callee.result == INT:
            return made(Called, name, self._arguments(callee.parameters, passed, scope))
        return UNKNOWN


def _literal(node: c_ast.Constant) -> Expression:
    if node.type not in ("int", "unsigned int", "long int"):
        return UNKNOWN
    return number(int(node.value.rstrip("uUlL"), 0))
