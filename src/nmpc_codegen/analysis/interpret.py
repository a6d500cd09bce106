"""Upper bounds on the floating-point operations of C functions, from the structure of their loops and branches.

    cost(a; b) = cost(a) + cost(b)            cost(if c a else b) = cost(c) + max(cost(a), cost(b))
    cost(for i) = sum_i cost(body at i)       cost(f(...)) = cost of its body for the values of its integer arguments

Integers are intervals. Sizes, entries of constant tables and counters of loops are known; members that hold a number of
members or an index have declared ranges; all else is unknown. A branch whose condition is known is taken, a loop that
may end early runs to its end, and a loop of unknown length is an error: its first line must then bound its passes.

A variable that is set once has the value of its initialiser, which is evaluated where somebody asks for it. A loop
whose body asks for nothing that depends on its counter is evaluated once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from pycparser import c_ast

from nmpc_codegen.analysis.c_source import CFunction, CMacro, Type, assigned_names, parse, type_of
from nmpc_codegen.analysis.intervals import Range, combine, entries, truth, union
from nmpc_codegen.analysis.loops import (
    conjuncts,
    counter_of,
    is_plain,
    is_sum_with,
    items,
    leaves,
    names_in,
    stated_passes,
)
from nmpc_codegen.analysis.names import INT, Unit

#: Type of a pointer to integers, which may be a constant table.
POINTER = Type("int", 1)

#: Values of an integer, or the name of a constant table.
Value = Range | str

_COMPARING = ("<", ">", "<=", ">=", "==", "!=")


class UnboundedError(ValueError):
    """The passes of a loop, or the operations of a function of another library, do not follow from the text."""


class Variable:
    """A variable in scope: its type, and its value, which is computed when it is asked for the first time."""

    def __init__(self, type_: Type, value: Value = None, later: Callable[[], Value] | None = None) -> None:
        self.type, self.asked = type_, False
        self._value, self._later = value, later

    @property
    def value(self) -> Value:
        """Its values; for a pointer to integers the name of the table."""
        if self._later is not None:
            self._value, self._later = self._later(), None
        self.asked = True
        return self._value


Scope = dict[str, Variable]

#: Operations of a function, and the values that it returns.
Result = tuple[int, Range]


class WorstCase:
    """Bounds of the functions of one unit."""

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self.running: frozenset[str] = frozenset()  # functions that count passes and are being evaluated
        self.shared: dict[str, dict[str, int]] = {}  # function -> stated number of passes -> operations of all of them
        self.fixed: dict[c_ast.Node, int] = {}  # expression -> its operations, where they depend on no value
        # Function, functions that count passes -> arguments that were asked -> their values -> operations, result.
        self._results: dict[tuple[str, frozenset[str]], dict[tuple[int, ...], dict[tuple[Value, ...], Result]]] = {}
        self._constants: dict[str, Range] = {name: (size, size) for name, size in unit.sizes.items()}

    def operations(self, function: str) -> int:
        """Bound for a call with unknown arguments.

        Raises:
            UnboundedError: the number of passes of a loop is unknown.
        """
        parse(self.unit.functions_below(function))
        return self.call(function, [Variable(type_) for _, type_ in self.unit.functions[function].parameters])[0]

    def call(self, name: str, arguments: Sequence[Variable]) -> Result:
        """Operations and returned values of a function for these arguments; a result holds for all whose values agree
        where it asked for them."""
        outer = self.running
        if name in self.unit.counting:
            self.running = outer | {name}
        known = self._results.setdefault((name, self.running), {})
        for asked, results in known.items():
            found = results.get(tuple([arguments[i].value for i in asked]))
            if found is not None:
                break
        else:
            operations, value = _Body(self, self.unit.functions[name]).run(arguments)
            found = operations + sum(self.shared.get(name, {}).values()), value
            asked = tuple(i for i, argument in enumerate(arguments) if argument.asked)
            known.setdefault(asked, {})[tuple([arguments[i].value for i in asked])] = found
        self.running = outer
        return found

    def constant(self, name: str) -> Range:
        """Value of a size, or of a macro without parameters."""
        if name not in self._constants:
            macro = self.unit.macros.get(name)
            known = None if macro is None or macro.parameters else macro.expression
            self._constants[name] = _Body(self, None).value(known, {})
        return self._constants[name]


class _Body:
    """A function while it is evaluated; None: an expression outside of functions."""

    def __init__(self, analysis: WorstCase, function: CFunction | None) -> None:
        self._analysis, self._unit, self._function = analysis, analysis.unit, function
        self._name = "" if function is None else function.name
        self._changed = set() if function is None else assigned_names(function.tree.body)
        self._returned: list[Range] = []

    def run(self, arguments: Sequence[Variable]) -> Result:
        """Operations, and the values that are returned."""
        assert self._function is not None
        scope: Scope = {}
        for (name, type_), argument in zip(self._function.parameters, arguments, strict=True):
            scope[name] = Variable(type_) if name in self._changed else argument
        operations = self._block(items(self._function.tree.body), scope)
        return operations, union(self._returned) if self._returned else None

    # -- statements ---------------------------------------------------------------------------------------------------

    def _block(self, statements: Sequence[c_ast.Node], scope: Scope) -> int:
        """Statements in sequence, up to one that leaves the block."""
        total = 0
        for i, statement in enumerate(statements):
            if isinstance(statement, c_ast.If):
                return total + self._branch(statement, statements[i + 1 :], scope)
            total += self._statement(statement, scope)
            if leaves((statement,)):
                break
        return total

    def _branch(self, node: c_ast.If, rest: Sequence[c_ast.Node], scope: Scope) -> int:
        """An `if` and the statements after it, which a branch that leaves the block does not reach."""
        test, holds = self.cost(node.cond, scope), truth(self.value(node.cond, scope))
        possible = ((node.iftrue, True), (node.iffalse, False))
        branches = [items(branch) for branch, taken in possible if holds in (None, taken)]
        costs = [self._block(branch, dict(scope)) for branch in branches]
        ends = [leaves(branch) for branch in branches]
        after = 0 if all(ends) else self._block(rest, scope)
        return test + max(cost if end else cost + after for cost, end in zip(costs, ends, strict=True))

    def _statement(self, node: c_ast.Node | None, scope: Scope) -> int:
        match node:
            case None | c_ast.EmptyStatement() | c_ast.Break() | c_ast.Continue():
                return 0
            case c_ast.Decl():
                return self._declaration(node, scope)
            case c_ast.DeclList():
                return sum(self._declaration(d, scope) for d in node.decls)
            case c_ast.Compound() | c_ast.If():
                return self._block(items(node), dict(scope))
            case c_ast.For():
                return self._for(node, scope)
            case c_ast.While() | c_ast.DoWhile():
                test = self.cost(node.cond, scope)
                return self._bound_loop(node, test + self._statement(node.stmt, dict(scope)), scope) + test
            case c_ast.Return():
                if self._function is not None and self._function.result == INT:
                    self._returned.append(self.value(node.expr, scope))
            case c_ast.Pragma():
                return self._take_values(node, scope)
        expression = node.expr if isinstance(node, c_ast.Return) else node
        if expression is None or not is_plain(expression):
            return self.cost(expression, scope)
        fixed = self._analysis.fixed
        if expression not in fixed:
            fixed[expression] = self.cost(expression, scope)
        return fixed[expression]

    def _declaration(self, node: c_ast.Decl, scope: Scope) -> int:
        cost = self.cost(node.init, scope)
        constant = node.init is not None and node.name not in self._changed
        later = (lambda: self.value(node.init, scope)) if constant else None
        scope[node.name] = Variable(type_of(node.type), later=later)
        return cost

    def _take_values(self, node: c_ast.Pragma, scope: Scope) -> int:
        """Values of a variable as a comment states them."""
        name, separator, limits = node.string.partition(":")
        if separator:
            least, most = (self._stated_value(text, scope) for text in limits.split(";"))
            if least is None or most is None:
                raise UnboundedError(f"{self._name}: the stated values of {name} are unknown")
            scope[name] = Variable(scope[name].type if name in scope else INT, (least[0], most[1]))
        return 0

    def _stated_value(self, text: str, scope: Scope) -> Range:
        return self.value(CMacro((), text).expression, scope)

    # -- loops --------------------------------------------------------------------------------------------------------

    def _for(self, node: c_ast.For, outer: Scope) -> int:
        scope = dict(outer)
        counter = counter_of(node)
        first = step = None
        if counter is not None:
            first = self.value(counter.first, scope)
            step = (1, 1) if counter.step is None else self.value(counter.step, scope)
        start = self._statement(node.init, scope)
        for name in () if node.next is None else assigned_names(node.next):
            scope[name] = Variable(scope[name].type if name in scope else INT)
        if counter is not None and stated_passes(node) is None and first is not None and step is not None:
            limits = [limit for limit in self._limits(node.cond, counter.name, counter.up, scope) if limit is not None]
            if limits and step[0] > 0:
                values = (
                    range(first[0], min(high for _, high in limits), step[0])
                    if counter.up
                    else range(first[1], max(low for low, _ in limits), -step[0])
                )
                return start + self._sum_passes(node, counter.name, values, scope)
        test = self.cost(node.cond, scope)
        return start + self._bound_loop(node, test + self._pass(node, scope), scope) + test

    def _pass(self, node: c_ast.For, scope: Scope) -> int:
        """The body, and the step to the next pass."""
        return self._statement(node.stmt, dict(scope)) + self.cost(node.next, scope)

    def _sum_passes(self, node: c_ast.For, name: str, values: range, scope: Scope) -> int:
        """Sum over the passes for these values of a counter, and the last test."""
        total, type_ = 0, scope[name].type
        for value in values:
            scope[name] = Variable(type_, (value, value))
            one = self.cost(node.cond, scope) + self._pass(node, scope)
            if not scope[name].asked:
                total = one * len(values)
                break
            total += one
        scope[name] = Variable(type_, (values.stop, values.stop))
        return total + self.cost(node.cond, scope)

    def _limits(self, cond: c_ast.Node | None, counter: str, up: bool, scope: Scope) -> list[Range]:
        """Values that the counter does not reach, from comparisons of ``counter + constant`` with other values."""
        found = []
        start = scope | {counter: Variable(INT, (0, 0))}
        for part in conjuncts(cond):
            if not isinstance(part, c_ast.BinaryOp) or part.op not in (("<", "<=") if up else (">", ">=")):
                continue
            if is_sum_with(part.left, counter) and counter not in names_in(part.right):
                limit = combine("-", self.value(part.right, scope), self.value(part.left, start))
                found.append(combine("+" if up else "-", limit, (1, 1)) if "=" in part.op else limit)
        return found

    def _bound_loop(self, node: c_ast.Node, one_pass: int, scope: Scope) -> int:
        """Bound of a loop whose first line states the number of its passes, in one run or in a function."""
        if one_pass == 0:
            return 0
        text, _, function = (stated_passes(node) or "").partition(" in ")
        stated = self._stated_value(text, scope) if text else None
        if stated is None:
            raise UnboundedError(f"{self._name}: the passes of a loop are unknown; expected /* at most ... passes */")
        if function not in self._analysis.running:
            return stated[1] * one_pass
        shared = self._analysis.shared.setdefault(function, {})
        shared[text] = max(shared.get(text, 0), stated[1] * one_pass)
        return one_pass

    # -- expressions --------------------------------------------------------------------------------------------------

    def cost(self, node: c_ast.Node | None, scope: Scope) -> int:
        """Operations of an expression."""
        return self._measure(node, scope)[0]

    def _measure(self, node: c_ast.Node | None, scope: Scope) -> tuple[int, Type]:
        """Operations and type of an expression. Macros are expanded; their arguments count once."""
        match node:
            case c_ast.ID():
                return 0, scope[node.name].type if node.name in scope else self._unit.constant(node.name)
            case None | c_ast.Constant() | c_ast.Typename() | c_ast.UnaryOp(op="sizeof"):
                return 0, INT
            case c_ast.ArrayRef():
                name, of = self._measure(node.name, scope)
                return name + self.cost(node.subscript, scope), Type(of.base, of.depth - 1)
            case c_ast.StructRef():
                return self.cost(node.name, scope), self._unit.member(node.field.name)
            case c_ast.BinaryOp():
                return self._binary(node, scope)
            case c_ast.UnaryOp():
                cost, of = self._measure(node.expr, scope)
                shift = {"*": -1, "&": 1}.get(node.op, 0)
                return cost + (node.op == "-" and of.counts), INT if node.op == "!" else Type(of.base, of.depth + shift)
            case c_ast.Assignment():
                left, of = self._measure(node.lvalue, scope)
                return left + self.cost(node.rvalue, scope) + (node.op != "=" and of.counts), of
            case c_ast.Cast():
                return self.cost(node.expr, scope), type_of(node.to_type.type)
            case c_ast.TernaryOp():
                (then, of), holds = self._measure(node.iftrue, scope), truth(self.value(node.cond, scope))
                other = 0 if holds else self.cost(node.iffalse, scope)
                return self.cost(node.cond, scope) + (other if holds is False else max(then, other)), of
            case c_ast.FuncCall():
                return self._measure_call(node, scope)
            case c_ast.ExprList() | c_ast.InitList() | c_ast.NamedInitializer() | c_ast.CompoundLiteral():
                return sum(self.cost(child, scope) for _, child in node.children()), INT
        raise UnboundedError(f"{self._name}: {type(node).__name__} is not understood")

    def _binary(self, node: c_ast.BinaryOp, scope: Scope) -> tuple[int, Type]:
        left, a = self._measure(node.left, scope)
        if node.op in ("&&", "||"):
            ends = truth(self.value(node.left, scope)) is (node.op == "||")
            return left if ends else left + self.cost(node.right, scope), INT
        right, b = self._measure(node.right, scope)
        of = max(a, b, key=lambda t: (t.depth, t.base == "real"))
        return left + right + (a.counts or b.counts), INT if node.op in _COMPARING else of

    def _measure_call(self, node: c_ast.FuncCall, scope: Scope) -> tuple[int, Type]:
        name, passed = node.name.name, [] if node.args is None else node.args.exprs
        callee = self._unit.callee(name)
        arguments = sum(self.cost(argument, scope) for argument in passed)
        if callee.macro is not None:
            own, of = self._measure(callee.macro.expression, self._expand(callee.macro, passed, scope))
            return arguments + own, of
        if callee.kind == "unknown":
            raise UnboundedError(f"{self._name} calls {name}, which is not of this package")
        if callee.kind == "function":
            own = self._analysis.call(name, self._arguments(callee.parameters, passed, scope))[0]
            return arguments + own, callee.result
        return arguments + callee.operations, callee.result

    def _arguments(self, types: Sequence[Type], passed: Sequence[c_ast.Node], scope: Scope) -> list[Variable]:
        """Arguments with values of integer types; for pointers to integers the tables."""
        rules: dict[Type, Callable[[c_ast.Node, Scope], Value]] = {INT: self.value, POINTER: self._table}

        def bound(of: Type, argument: c_ast.Node) -> Variable:
            return Variable(of, later=partial(rules[of], argument, scope) if of in rules else None)

        return [bound(of, argument) for of, argument in zip(types, passed, strict=True)]

    def _table(self, node: c_ast.Node, scope: Scope) -> Value:
        """The constant table that an expression names; the start of another one is unknown."""
        if not isinstance(node, c_ast.ID):
            return None
        if node.name in scope:
            return scope[node.name].value if scope[node.name].type == POINTER else None
        return node.name if node.name in self._unit.tables else None

    def _expand(self, macro: CMacro, passed: Sequence[c_ast.Node], scope: Scope) -> Scope:
        """The scope in which the parameters of a macro are its arguments."""

        def bound(argument: c_ast.Node) -> Variable:
            return Variable(self._measure(argument, scope)[1], later=lambda: self.value(argument, scope))

        return scope | {p: bound(a) for p, a in zip(macro.parameters, passed, strict=True)}

    def value(self, node: c_ast.Node | None, scope: Scope) -> Range:
        """Value of an integer expression."""
        match node:
            case c_ast.Constant(type="int" | "unsigned int" | "long int"):
                number = int(node.value.rstrip("uUlL"), 0)
                return number, number
            case c_ast.ID():
                known = scope.get(node.name)
                if known is None:
                    return self._analysis.constant(node.name)
                found = None if known.type.depth else known.value
                return None if isinstance(found, str) else found
            case c_ast.BinaryOp():
                return combine(node.op, self.value(node.left, scope), self.value(node.right, scope))
            case c_ast.StructRef():
                return self._unit.ranges.get(node.field.name)
            case c_ast.ArrayRef(name=c_ast.ID()):
                table = self._table(node.name, scope)
                if not isinstance(table, str):
                    return None
                return entries(self._unit.tables[table], self.value(node.subscript, scope))
            case c_ast.FuncCall():
                return self._result(node, scope)
            case c_ast.UnaryOp(op="-"):
                return combine("-", (0, 0), self.value(node.expr, scope))
            case c_ast.UnaryOp(op="!"):
                holds = truth(self.value(node.expr, scope))
                return (0, 1) if holds is None else (int(not holds),) * 2
            case c_ast.Cast():
                return self.value(node.expr, scope) if type_of(node.to_type.type) == INT else None
            case c_ast.TernaryOp():
                holds = truth(self.value(node.cond, scope))
                possible = [(node.iftrue, True), (node.iffalse, False)]
                return union([self.value(branch, scope) for branch, taken in possible if holds in (None, taken)])
        return None

    def _result(self, node: c_ast.FuncCall, scope: Scope) -> Range:
        """Value of a call."""
        name, passed = node.name.name, [] if node.args is None else node.args.exprs
        callee = self._unit.callee(name)
        if callee.macro is not None:
            return self.value(callee.macro.expression, self._expand(callee.macro, passed, scope))
        if callee.kind == "function" and callee.result == INT:
            return self._analysis.call(name, self._arguments(callee.parameters, passed, scope))[1]
        return None
