"""Upper bounds on the floating-point operations of C functions follow from the structure of loops and branches.

    cost(a; b) = cost(a) + cost(b)            cost(if c a else b) = cost(c) + max(cost(a), cost(b))
    cost(for i) = sum_i cost(body at i)       cost(f(...)) = cost of its body for the values of its integer arguments

Integers are intervals. Sizes, entries of constant tables and counters of loops are known. Members that hold a count or
an index have declared ranges; everything else is unknown. A branch with a known condition is taken, and a loop that may
end early runs to its end. A loop of unknown length is an error, unless a comment in its first line bounds its passes:
``at most <expression> passes``, in one run or ``in <function>``. A comment ``<least> <= <variable> <= <most>`` states
the values of a variable.

A variable that is set once has the value of its initialiser, which is evaluated when it is first needed. A loop whose
body needs no value that depends on its counter is evaluated once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial

from nmpc_codegen.analysis.source import (
    ENUM,
    INT,
    Code,
    Function,
    TextMacro,
    Type,
    Unit,
    code_of,
    find_changes,
    split_head,
    type_of,
)
from nmpc_codegen.lowering.dialect.constants import Range, apply_operator, truth
from nmpc_codegen.lowering.dialect.scopes import DECLARATION, declarators, split
from nmpc_codegen.lowering.dialect.tree import Node

#: The type of a pointer to integers, which may be a constant table.
POINTER = Type("int", 1)

#: The values of an integer, or the name of a constant table.
Value = Range | None | str

_COMPARING = ("<", ">", "<=", ">=", "==", "!=")
_PASSES = re.compile(r"/\* at most ([^*]+?) passes(?: in (\w+))? \*/")
_STATED = re.compile(r"/\* (-?\w+) <= (\w+) <= ([^*]+?) \*/")
_NUMBER = re.compile(r"(0[xX][\da-fA-F]+|0|[1-9]\d*)[uUlL]*$")


class UnboundedError(ValueError):
    """The text does not bound the passes of a loop, or the operations of a function of another library."""


class Variable:
    """A variable in scope has a type and a value, which is computed when it is first needed."""

    def __init__(self, type_: Type, value: Value = None, later: Callable[[], Value] | None = None) -> None:
        self.type, self.asked = type_, False
        self._value, self._later = value, later

    @property
    def value(self) -> Value:
        """Return the values of the variable; for a pointer to integers the name of the table."""
        if self._later is not None:
            self._value, self._later = self._later(), None
        self.asked = True
        return self._value


Scope = dict[str, Variable]

#: Operations of a function, and the values that it returns.
Result = tuple[int, Range | None]


class WorstCase:
    """A worst case holds the bounds of the functions of one unit."""

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self.running: frozenset[str] = frozenset()  # functions that bound passes and are being evaluated
        self.shared: dict[str, dict[str, int]] = {}  # function -> stated number of passes -> operations of all passes
        # (function, functions that bound passes) -> needed arguments -> their values -> (operations, result).
        self._results: dict[tuple[str, frozenset[str]], dict[tuple[int, ...], dict[tuple[Value, ...], Result]]] = {}
        self._constants: dict[str, Range | None] = {name: (size, size) for name, size in unit.sizes.items()}

    def operations(self, function: str) -> int:
        """Return the bound for a call with unknown arguments.

        Raises:
            UnboundedError: the number of passes of a loop is unknown.
        """
        return self.call(function, [Variable(type_) for _, type_ in self.unit.functions[function].parameters])[0]

    def call(self, name: str, arguments: Sequence[Variable]) -> Result:
        """Return operations and value of a function for these arguments.

        A result also holds for all arguments that agree in the values which the function needed.
        """
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

    def constant(self, name: str) -> Range | None:
        """Return the value of a size, or of a macro without parameters."""
        if name not in self._constants:
            macro = self.unit.macros.get(name)
            text = "" if macro is None or macro.parameters else macro.text
            self._constants[name] = _Body(self, None).value(code_of(text), {})
        return self._constants[name]


class _Body:
    """A body is a function during its evaluation; None stands for an expression outside of functions."""

    def __init__(self, analysis: WorstCase, function: Function | None) -> None:
        self._analysis, self._unit, self._function = analysis, analysis.unit, function
        self._name = "" if function is None else function.name
        self._text, self._code = ("", "") if function is None else (function.text, function.code)
        self._changed = frozenset() if function is None else function.changed
        self._returned: list[Range | None] = []

    def run(self, arguments: Sequence[Variable]) -> Result:
        """Return the operations, and the returned values."""
        assert self._function is not None
        scope: Scope = {}
        for (name, type_), argument in zip(self._function.parameters, arguments, strict=True):
            scope[name] = Variable(type_) if name in self._changed else argument
        operations = self._block(self._function.body, scope)
        return operations, _union(self._returned) if self._returned else None

    # -- statements ---------------------------------------------------------------------------------------------------

    def _block(self, nodes: Sequence[Node], scope: Scope) -> int:
        """Return the operations of statements in sequence, up to one that leaves the block."""
        total = 0
        for i, node in enumerate(nodes):
            if node.kind == "if":
                return total + self._branch(node, nodes[i + 1 :], scope)
            total += self._statement(node, scope)
            if node.kind == "leave":
                break
        return total

    def _branch(self, node: Node, rest: Sequence[Node], scope: Scope) -> int:
        """Return the operations of an `if` and, unless a branch leaves the block, of the statements after the `if`."""
        condition = code_of(self._code[slice(*node.head)])
        test, holds = self.cost(condition, scope), truth(self.value(condition, scope))
        other = node.other
        otherwise = () if other is None else (other,) if other.kind == "if" else other.body
        branches = [branch for branch, taken in ((node.body, True), (otherwise, False)) if holds in (None, taken)]
        costs = [self._block(branch, dict(scope)) for branch in branches]
        ends = [bool(branch) and branch[-1].kind == "leave" for branch in branches]
        after = 0 if all(ends) else self._block(rest, scope)
        return test + max(cost if end else cost + after for cost, end in zip(costs, ends, strict=True))

    def _statement(self, node: Node, scope: Scope) -> int:
        text = self._code[node.start : node.end]
        match node.kind:
            case "comment":
                return self._take_values(self._text[node.start : node.end], scope)
            case "block":
                return self._block(node.body, dict(scope))
            case "loop":
                return self._loop(node, scope)
            case "statement":
                return self._execute(text, scope) + self._take_values(self._text[node.start : node.end], scope)
            case "leave":
                value = code_of(text.strip().removeprefix("return").removesuffix(";"))
                if not text.startswith("return") or value is None:
                    return 0
                if self._function is not None and self._function.result == INT:
                    self._returned.append(self.value(value, scope))
                return self.cost(value, scope)
        raise UnboundedError(f"{self._name}: {text.split(chr(10))[0]} is not understood")

    def _execute(self, text: str, scope: Scope) -> int:
        """Return the operations of a declaration or an expression."""
        if found := ENUM.match(text):
            for entry in split(found[1]):
                name, _, value = entry.partition("=")
                scope[name.strip()] = Variable(INT, self.value(code_of(value), scope))
            return 0
        if DECLARATION.match(text) is None:
            return self.cost(code_of(text.strip().removesuffix(";")), scope)
        base = DECLARATION.match(text)[0]  # type: ignore[index]
        total = 0
        for name, declarator in declarators(text):
            head, _, value = declarator.partition("=")
            init = code_of(value)
            total += self.cost(init, scope)
            later = partial(self.value, init, dict(scope)) if init is not None and name not in self._changed else None
            scope[name] = Variable(type_of(f"{base.strip()} {head}"), later=later)
        return total

    def _take_values(self, comment: str, scope: Scope) -> int:
        """Take the values of a variable from a comment."""
        if found := _STATED.search(comment):
            least, most = self.value(code_of(found[1]), scope), self.value(code_of(found[3]), scope)
            if least is None or most is None:
                raise UnboundedError(f"{self._name}: the stated values of {found[2]} are unknown")
            scope[found[2]] = Variable(scope[found[2]].type if found[2] in scope else INT, (least[0], most[1]))
        return 0

    # -- loops --------------------------------------------------------------------------------------------------------

    def _loop(self, node: Node, outer: Scope) -> int:
        start, condition, step = split_head(self._code, node)
        scope = dict(outer)
        cost = self._execute(start, scope) if start.strip() else 0
        values = None if self._stated_passes(node) else self._values(node, start, condition, step, scope)
        for name in _counters(step):
            scope[name] = Variable(scope[name].type if name in scope else INT)
        test, move = code_of(condition), code_of(step)
        if values is not None:
            return cost + self._sum_passes(node, *values, test, move, scope)
        tested = self.cost(test, scope)
        return cost + self._bound_loop(node, tested + self._pass(node, move, scope), scope) + tested

    def _values(self, node: Node, start: str, condition: str, step: str, scope: Scope) -> tuple[str, range] | None:
        """Return the counter of a loop and its values; None if the text does not determine them."""
        counters = _counters(step)
        name = next(iter(counters), "")
        move = code_of(step)
        if len(counters) != 1 or move is None or name in find_changes(self._code, node.body):
            return None
        first = self._first(name, start, scope)
        by = (1, 1) if len(move.tree.operands) == 1 else self.value(move.operands[1], scope)
        up = move.tree.word in ("++", "+=")
        if first is None or by is None or by[0] <= 0 or move.tree.word not in ("++", "--", "+=", "-="):
            return None
        limits = [limit for limit in self._limits(code_of(condition), name, up, scope) if limit is not None]
        if not limits:
            return None
        if up:
            return name, range(first[0], min(high for _, high in limits), by[0])
        return name, range(first[1], max(low for low, _ in limits), -by[0])

    def _first(self, name: str, start: str, scope: Scope) -> Range | None:
        """Return the value with which a loop starts a counter."""
        stated = dict(declarators(start))
        if name in stated:
            return self.value(code_of(stated[name].partition("=")[2]), scope)
        found = code_of(start)
        for part in () if found is None else (found, *found.operands):
            if (part.tree.kind, part.tree.word) == ("assign", "=") and part.operands[0].tree.word == name:
                return self.value(part.operands[1], scope)
        return None

    def _pass(self, node: Node, move: Code | None, scope: Scope) -> int:
        """Return the number of operations of one iteration: the loop body and the increment."""
        return self._block(node.body, dict(scope)) + self.cost(move, scope)

    def _sum_passes(
        self, node: Node, name: str, values: range, test: Code | None, move: Code | None, scope: Scope
    ) -> int:
        """Return the sum over the passes for these values of a counter, and the last test."""
        total, type_ = 0, scope[name].type
        for value in values:
            scope[name] = Variable(type_, (value, value))
            one = self.cost(test, scope) + self._pass(node, move, scope)
            if not scope[name].asked:
                total = one * len(values)
                break
            total += one
        scope[name] = Variable(type_, (values.stop, values.stop))
        return total + self.cost(test, scope)

    def _limits(self, condition: Code | None, counter: str, up: bool, scope: Scope) -> list[Range | None]:
        """Return values that the counter does not reach, from comparisons of ``counter + constant`` with others."""
        found = []
        start = scope | {counter: Variable(INT, (0, 0))}
        for part in _conjuncts(condition):
            if part.tree.kind != "binary" or part.tree.word not in (("<", "<=") if up else (">", ">=")):
                continue
            left, right = part.operands
            if _is_sum_with(left, counter) and counter not in _names(right):
                limit = apply_operator("-", self.value(right, scope), self.value(left, start))
                more = "=" in part.tree.word
                found.append(apply_operator("+" if up else "-", limit, (1, 1)) if more else limit)
        return found

    def _stated_passes(self, node: Node) -> re.Match[str] | None:
        """Return the statement on passes in the first line of a loop."""
        first = node.body[0] if node.body else None
        is_comment = first is not None and first.kind == "comment"
        return _PASSES.match(self._text, first.start) if first is not None and is_comment else None

    def _bound_loop(self, node: Node, one_pass: int, scope: Scope) -> int:
        """Return the bound of a loop whose first line states the number of its passes, in one run or in a function."""
        if one_pass == 0:
            return 0
        comment = self._stated_passes(node)
        stated = None if comment is None else self.value(code_of(comment[1]), scope)
        if comment is None or stated is None:
            raise UnboundedError(f"{self._name}: the passes of a loop are unknown; expected /* at most ... passes */")
        if comment[2] not in self._analysis.running:
            return stated[1] * one_pass
        shared = self._analysis.shared.setdefault(comment[2], {})
        shared[comment[1]] = max(shared.get(comment[1], 0), stated[1] * one_pass)
        return one_pass

    # -- expressions --------------------------------------------------------------------------------------------------

    def cost(self, code: Code | None, scope: Scope) -> int:
        """Return the operations of an expression."""
        return 0 if code is None else self._measure(code, scope)[0]

    def _measure(self, code: Code, scope: Scope) -> tuple[int, Type]:
        """Return operations and type of an expression; macros are expanded, and their arguments count once."""
        kind, word = code.tree.kind, code.tree.word
        if kind == "name":
            return 0, scope[word].type if word in scope else self._unit.constant(word)
        if kind == "call":
            return self._measure_call(code, scope)
        if kind in ("binary", "assign") and len(code.tree.operands) == 2:
            return self._measure_binary(code, scope)
        if (kind, word) == ("other", "?"):
            return self._measure_choice(code.operands, scope)
        if word == "sizeof":
            return 0, INT
        if not code.operands or word == "{":
            return sum(self.cost(operand, scope) for operand in code.operands), INT
        return self._measure_place(code, scope)

    def _measure_choice(self, operands: Sequence[Code], scope: Scope) -> tuple[int, Type]:
        """Return operations and type of condition ? first : second."""
        condition, first, second = operands
        (then, of), holds = self._measure(first, scope), truth(self.value(condition, scope))
        other = 0 if holds else self.cost(second, scope)
        return self.cost(condition, scope) + (other if holds is False else max(then, other)), of

    def _measure_place(self, code: Code, scope: Scope) -> tuple[int, Type]:
        """Return operations and type of an expression with one operand: element, member, cast, sign, group."""
        kind, word = code.tree.kind, code.tree.word
        cost, of = self._measure(code.operands[0], scope)
        match kind:
            case "index":
                return cost + self.cost(code.operands[1], scope), Type(of.base, of.depth - 1)
            case "member":
                return cost, self._unit.member(word)
            case "other" if word == "cast":
                return cost, code.cast
            case "unary":
                shift = {"*": -1, "&": 1}.get(word, 0)
                return cost + (word == "-" and of.counts), INT if word == "!" else Type(of.base, of.depth + shift)
        return cost, of

    def _measure_binary(self, code: Code, scope: Scope) -> tuple[int, Type]:
        """Return operations and type of an expression with a binary operator."""
        word = code.tree.word
        if word == ",":
            return sum(self.cost(part, scope) for part in code.operands), INT
        left_code, right_code = code.operands
        left, a = self._measure(left_code, scope)
        if word in ("&&", "||"):
            ends = truth(self.value(left_code, scope)) is (word == "||")
            return left if ends else left + self.cost(right_code, scope), INT
        right, b = self._measure(right_code, scope)
        if code.tree.kind == "assign":
            return left + right + (word != "=" and a.counts), a
        of = max(a, b, key=lambda t: (t.depth, t.base == "real"))
        return left + right + (a.counts or b.counts), INT if word in _COMPARING else of

    def _measure_call(self, code: Code, scope: Scope) -> tuple[int, Type]:
        callee = self._unit.callee(code.tree.word)
        if callee is None:
            raise UnboundedError(f"{self._name} calls {code.tree.word}, which is not of this package")
        arguments = sum(self.cost(argument, scope) for argument in code.operands)
        if callee.macro is not None:
            own, of = self._measure_macro(callee.macro, self._expand(callee.macro, code.operands, scope))
            return arguments + own, of
        if callee.function is not None:
            function = callee.function
            return arguments + self._analysis.call(function.name, self._bind(function, code, scope))[0], callee.result
        return arguments + (callee.operations or 0), callee.result

    def _measure_macro(self, macro: TextMacro, scope: Scope) -> tuple[int, Type]:
        found = code_of(macro.text)
        return (0, INT) if found is None else self._measure(found, scope)

    def _bind(self, function: Function, code: Code, scope: Scope) -> list[Variable]:
        """Return arguments with values for integer types, and with tables for pointers to integers."""
        rules: dict[Type, Callable[[Code, Scope], Value]] = {INT: self.value, POINTER: self._table}
        types = (of for _, of in function.parameters)
        return [
            Variable(of, later=partial(rules[of], argument, scope) if of in rules else None)
            for of, argument in zip(types, code.operands, strict=True)
        ]

    def _table(self, code: Code, scope: Scope) -> Value:
        """Return the constant table that an expression names; None if it is unknown."""
        name = code.tree.word
        if code.tree.kind != "name":
            return None
        if name in scope:
            return scope[name].value if scope[name].type == POINTER else None
        return name if name in self._unit.tables else None

    def _expand(self, macro: TextMacro, passed: Sequence[Code], scope: Scope) -> Scope:
        """Return the scope in which the parameters of a macro are its arguments."""

        def bound(argument: Code) -> Variable:
            return Variable(self._measure(argument, scope)[1], later=partial(self.value, argument, scope))

        return scope | {p: bound(a) for p, a in zip(macro.parameters, passed, strict=True)}

    def value(self, code: Code | None, scope: Scope) -> Range | None:
        """Return the value of an integer expression."""
        if code is None:
            return None
        word, operands = code.tree.word, code.operands
        match code.tree.kind:
            case "number":
                return _number(word)
            case "name":
                return self._value_of_name(word, scope)
            case "binary":
                return apply_operator(word, *(self.value(operand, scope) for operand in operands))
            case "unary" if word in "-!":
                return apply_operator(word, self.value(operands[0], scope))
            case "member":
                return self._unit.ranges.get(word)
            case "index":
                return self._value_of_entry(code, scope)
            case "call":
                return self._result(code, scope)
            case "group" | "other":
                return self._value_of_branches(code, scope)
        return None

    def _value_of_name(self, word: str, scope: Scope) -> Range | None:
        """Return the value of a variable or a constant."""
        known = scope.get(word)
        if known is None:
            return self._analysis.constant(word)
        return None if known.type.depth or isinstance(known.value, str) else known.value

    def _value_of_entry(self, code: Code, scope: Scope) -> Range | None:
        """Return the value of an entry of a constant table."""
        table = self._table(code.operands[0], scope)
        if not isinstance(table, str):
            return None
        return _entries(self._unit.tables[table], self.value(code.operands[1], scope))

    def _value_of_branches(self, code: Code, scope: Scope) -> Range | None:
        """Return the value of a group, of a cast, or of a choice between two expressions."""
        operands = code.operands
        if code.tree.kind == "group" or (code.tree.word == "cast" and code.cast == INT):
            return self.value(operands[0], scope)
        if code.tree.word != "?":
            return None
        holds = truth(self.value(operands[0], scope))
        possible = ((operands[1], True), (operands[2], False))
        return _union([self.value(branch, scope) for branch, taken in possible if holds in (None, taken)])

    def _result(self, code: Code, scope: Scope) -> Range | None:
        """Return the value of a call."""
        callee = self._unit.callee(code.tree.word)
        if callee is not None and callee.macro is not None:
            return self.value(code_of(callee.macro.text), self._expand(callee.macro, code.operands, scope))
        if callee is not None and callee.function is not None and callee.result == INT:
            return self._analysis.call(callee.function.name, self._bind(callee.function, code, scope))[1]
        return None


def _number(word: str) -> Range | None:
    found = _NUMBER.match(word)
    return None if found is None else (int(found[1], 0),) * 2


def _entries(table: Sequence[int], index: Range | None) -> Range | None:
    """Return the range of the entries of a table at these indices."""
    known = index is not None and 0 <= index[0] <= index[1] < len(table)
    among = table[index[0] : index[1] + 1] if known and index is not None else table
    return (min(among), max(among)) if among else None


def _union(ranges: Sequence[Range | None]) -> Range | None:
    """Return an interval that contains all given intervals."""
    known = [r for r in ranges if r is not None]
    if not known or len(known) < len(ranges):
        return None
    return min(low for low, _ in known), max(high for _, high in known)


@lru_cache(maxsize=4096)
def _counters(step: str) -> tuple[str, ...]:
    """Return the variables that the third part of a for loop changes."""
    found = code_of(step)
    if found is None:
        return ()
    parts = found.operands if found.tree.word == "," else (found,)
    return tuple(part.operands[0].tree.word for part in parts if part.tree.kind == "assign")


def _conjuncts(code: Code | None) -> Iterator[Code]:
    """Yield the conditions in ``a && b && ...``."""
    if code is not None and code.tree.word == "&&":
        for operand in code.operands:
            yield from _conjuncts(operand)
    elif code is not None:
        yield code


def _is_sum_with(code: Code, counter: str) -> bool:
    """Return True if the expression is the counter plus terms that do not contain the counter."""
    if code.tree.kind in ("name", "group"):
        return code.tree.word == counter or (code.tree.kind == "group" and _is_sum_with(code.operands[0], counter))
    if code.tree.kind != "binary" or code.tree.word not in ("+", "-"):
        return False
    left, right = code.operands
    if code.tree.word == "-":
        return _is_sum_with(left, counter) and counter not in _names(right)
    found = [side for side in (left, right) if counter in _names(side)]
    return len(found) == 1 and _is_sum_with(found[0], counter)


def _names(code: Code) -> frozenset[str]:
    """Return the names in an expression."""
    own = frozenset({code.tree.word} if code.tree.kind == "name" else ())
    return own.union(*(_names(operand) for operand in code.operands))
