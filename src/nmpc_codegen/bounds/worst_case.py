"""Upper bounds on the floating-point operations of C functions, from the structure of their loops and branches.

    cost(a; b) = cost(a) + cost(b)            cost(if c a else b) = cost(c) + max(cost(a), cost(b))
    cost(for i) = sum_i cost(body at i)       cost(f(...)) = cost of its body for the values of its integer arguments

Integers are intervals. Sizes, entries of constant tables and counters of loops are known; members that hold a number of
members or an index have declared ranges; all else is unknown. A branch whose condition is known is taken, a loop that
may end early runs to its end, and a loop of unknown length is an error: its first line must then bound its passes.

What is asked about the values of arguments and counters is kept: the bound of a function (of a pass of a loop) is that
for other arguments (another value of the counter) to which all expressions that were asked have the same values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from nmpc_codegen.bounds.c_source import parse
from nmpc_codegen.bounds.costs import (
    Branch,
    Call,
    Cost,
    Counted,
    Expected,
    Impossible,
    Loop,
    Operations,
    Return,
    Sum,
)
from nmpc_codegen.bounds.expressions import Called, Either, Expression, Value
from nmpc_codegen.bounds.facts import Facts, Results, without
from nmpc_codegen.bounds.intervals import Range, truth, union
from nmpc_codegen.bounds.names import Names, Unit
from nmpc_codegen.bounds.translate import Program, constant_value, program_of


class UnboundedError(ValueError):
    """The passes of a loop, or the operations of a function of another library, do not follow from the text."""


@dataclass
class _Frame:
    """A function while it is evaluated: values of its slots, facts that were asked, returned values."""

    slots: list[Value]
    facts: Facts = field(default_factory=dict)
    returned: list[Range] = field(default_factory=list)


@dataclass(frozen=True)
class _Summary:
    """Bound and returned values of a function, and the facts about its arguments on which they depend."""

    operations: int
    value: Range
    facts: Facts


class _Constants:
    """Values of the constants of a unit."""

    def __init__(self, unit: Unit, names: Names) -> None:
        self.tables, self.ranges = unit.tables, unit.ranges
        self._unit, self._names = unit, names
        self._known: dict[str, Range] = {name: (size, size) for name, size in unit.sizes.items()}

    def constant(self, name: str) -> Range:
        """Value of a size, or of a macro without parameters."""
        if name not in self._known:
            macro = self._unit.macros.get(name)
            known = None if macro is None or macro.parameters else constant_value(macro, self._names)
            self._known[name] = None if known is None else known.value((), self)
        return self._known[name]


class WorstCase:
    """Bounds of the functions of one unit."""

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self._names = Names(unit)
        self._constants = _Constants(unit, self._names)
        self._programs: dict[str, Program] = {}
        self._known: dict[tuple[str, frozenset[str]], dict[tuple[Value, ...], _Summary]] = {}
        self._results: dict[tuple[str, frozenset[str]], Results[_Summary]] = {}
        self._running: frozenset[str] = frozenset()  # functions that count passes and are being evaluated
        self._shared: dict[str, dict[str, int]] = {}  # function -> stated number of passes -> operations of all of them
        self._rules: Mapping[type[Cost], Callable[[Any, _Frame], int]] = {
            Sum: self._sum,
            Branch: self._branch,
            Call: lambda cost, frame: self._call(cost.function, cost.arguments, frame).operations,
            Counted: lambda cost, frame: unit.counts[cost.function],
            Loop: self._loop,
            Return: self._return,
            Expected: self._expected,
            Impossible: self._impossible,
        }

    def operations(self, function: str) -> int:
        """Bound for a call with unknown arguments.

        Raises:
            UnboundedError: the number of passes of a loop is unknown.
        """
        parse(self.unit.reached(function))
        return self._summary(function, (None,) * len(self.unit.functions[function].parameters)).operations

    # -- functions ----------------------------------------------------------------------------------------------------

    def _summary(self, name: str, arguments: tuple[Value, ...]) -> _Summary:
        outer = self._running
        if name in self.unit.counting:
            self._running = outer | {name}
        key = name, self._running
        exact = self._known.setdefault(key, {})
        if (summary := exact.get(arguments)) is None:
            results = self._results.setdefault(key, Results(self._constants))
            if (summary := results.find(arguments)) is None:
                summary = self._evaluated(name, arguments)
                results.keep(summary.facts, summary)
            exact[arguments] = summary
        self._running = outer
        return summary

    def _evaluated(self, name: str, arguments: tuple[Value, ...]) -> _Summary:
        if name not in self._programs:
            self._programs[name] = program_of(self.unit.functions[name], self._names)
        program = self._programs[name]
        frame = _Frame([*arguments, *(None for _ in range(program.counters))])
        operations = self._cost(program.operations, frame) + sum(self._shared.get(name, {}).values())
        return _Summary(operations, union(frame.returned) if frame.returned else None, frame.facts)

    def _call(self, name: str, arguments: tuple[Expression, ...], frame: _Frame) -> _Summary:
        """Summary for these arguments; its facts become facts about the slots of the caller."""
        summary = self._summary(name, tuple([self._value(argument, frame) for argument in arguments]))
        for question, answer in summary.facts.items():
            if not any(arguments[slot].calls for slot in question.slots):
                asked = question.given(arguments)
                if asked.slots:
                    frame.facts[asked] = answer
            else:
                for slot in question.slots:
                    self._ask(arguments[slot], frame)
        return summary

    def _value(self, expression: Expression, frame: _Frame) -> Any:
        """Value of an expression; nothing depends on it yet, except on the facts that imply the value of a call."""
        return self._ask(expression, frame) if expression.calls else expression.value(frame.slots, self._constants)

    def _ask(self, question: Expression, frame: _Frame) -> Any:
        """Value of an expression, which becomes a fact on which the result depends."""
        if not question.calls:
            value = question.value(frame.slots, self._constants)
            if question.slots:
                frame.facts[question] = value
            return value
        if isinstance(question, Called):
            return self._call(question.function, question.arguments, frame).value
        if isinstance(question, Either):
            holds = truth(self._ask(question.condition, frame))
            taken = [e for e, t in ((question.then, True), (question.other, False)) if holds in (None, t)]
            return union([self._ask(e, frame) for e in taken])
        return question.combine([self._ask(part, frame) for part in question.parts], self._constants)

    # -- statements ---------------------------------------------------------------------------------------------------

    def _cost(self, cost: Operations, frame: _Frame) -> int:
        return cost if isinstance(cost, int) else self._rules[type(cost)](cost, frame)

    def _sum(self, cost: Sum, frame: _Frame) -> int:
        total = cost.fixed
        for part in cost.parts:
            total += self._rules[type(part)](part, frame)
        return total

    def _branch(self, cost: Branch, frame: _Frame) -> int:
        holds = truth(self._ask(cost.condition, frame))
        possible = range(2) if holds is None else (0,) if holds else (1,)
        costs = [self._cost(cost.branches[i], frame) for i in possible]
        ends = [cost.leaves[i] for i in possible]
        rest = 0 if all(ends) else self._cost(cost.rest, frame)
        return max(c if end else c + rest for c, end in zip(costs, ends, strict=True))

    def _return(self, cost: Return, frame: _Frame) -> int:
        frame.returned.append(self._ask(cost.value, frame))
        return 0

    def _expected(self, cost: Expected, frame: _Frame) -> int:
        if self._ask(cost.value, frame) is None:
            raise UnboundedError(cost.otherwise)
        return 0

    def _impossible(self, cost: Impossible, frame: _Frame) -> int:
        raise UnboundedError(cost.why)

    # -- loops --------------------------------------------------------------------------------------------------------

    def _loop(self, loop: Loop, frame: _Frame) -> int:
        if loop.slot is not None and loop.passes is not None:
            parts = loop.passes.parts
            values = loop.passes.visited([self._value(part, frame) for part in parts])
            if values is not None:
                total, depends = self._counted(loop, loop.slot, values, frame)
                for question in parts if depends else (loop.passes,):
                    self._ask(question, frame)
                return total
            self._ask(loop.passes, frame)
        outer, frame.facts = frame.facts, {}
        test = self._cost(loop.test, frame)
        total = self._repeated(loop, test + self._cost(loop.body, frame), frame) + test
        frame.facts = outer | (frame.facts if loop.slot is None else without(loop.slot, frame.facts, frame.slots))
        return total

    def _counted(self, loop: Loop, slot: int, values: range, frame: _Frame) -> tuple[int, bool]:
        """Sum over the passes for these values of a counter and the last test, and whether it depends on the values."""
        if isinstance(loop.test, int) and isinstance(loop.body, int):
            return len(values) * (loop.test + loop.body) + loop.test, False
        outer, among = frame.facts, Facts()
        results: Results[int] = Results(self._constants)
        total, depends = 0, not isinstance(loop.test, int)
        for value in values:
            frame.slots[slot] = (value, value)
            if (one_pass := results.find(frame.slots)) is None:
                frame.facts = {}
                one_pass = self._cost(loop.test, frame) + self._cost(loop.body, frame)
                among |= frame.facts
                own = {question: answer for question, answer in frame.facts.items() if slot in question.slots}
                if not own:
                    total = one_pass * len(values)
                    break
                results.keep(own, one_pass)
                depends = True
            total += one_pass
        frame.facts = among
        frame.slots[slot] = (values.stop, values.stop)
        total += self._cost(loop.test, frame)
        frame.facts = outer | without(slot, among, frame.slots)
        return total, depends

    def _repeated(self, loop: Loop, one_pass: int, frame: _Frame) -> int:
        """Bound of a loop whose first line states the number of its passes, in one run or in a function."""
        if one_pass == 0:
            return 0
        stated = None if loop.stated is None else self._ask(loop.stated.passes, frame)
        if loop.stated is not None and stated is not None:
            if loop.stated.function not in self._running:
                return int(stated[1]) * one_pass
            shared = self._shared.setdefault(loop.stated.function, {})
            shared[loop.stated.text] = max(shared.get(loop.stated.text, 0), stated[1] * one_pass)
            return one_pass
        raise UnboundedError(f"{loop.function}: the passes of a loop are unknown; expected /* at most ... passes */")
