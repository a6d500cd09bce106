"""Upper bounds on the floating-point operations of C functions, from the structure of their loops and branches.

    cost(a; b) = cost(a) + cost(b)            cost(if c a else b) = cost(c) + max(cost(a), cost(b))
    cost(for i) = sum_i cost(body at i)       cost(f(...)) = cost of its body for the values of its integer arguments

Integers are intervals. Sizes, entries of constant tables and counters of loops are known; members that hold a number of
members or an index have declared ranges; all else is unknown. A branch whose condition is known is taken, a loop that
may end early runs to its end, and a loop of unknown length is an error: its first line must then bound its passes.

In a package with a budget a statement ``if (!qp_afford(q, COST)) ...`` charges all that follows it in its block. The
block costs its caller nothing then, and COST is the bound on what follows, where blocks inside charge for themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

from pycparser import c_ast

from nmpc_codegen.bounds.c_source import MATH, CFunction, CMacro, Type, assigned_names, declared
from nmpc_codegen.bounds.intervals import Range, combined, entries, truth, union

#: What is known about an argument: the values of an integer, or the name of a constant table.
Argument = Range | str

#: The function that charges operations to the budget of a sample.
AFFORD = "qp_afford"

_INT = Type("int")
_EXIT = c_ast.Return | c_ast.Break | c_ast.Continue


class UnboundedError(ValueError):
    """The passes of a loop, or the operations of a function of another library, do not follow from the text."""


@dataclass(frozen=True)
class Unit:
    """What is known about a translation unit.

    ``counts``: functions whose operations are known; ``sizes``: integer constants; ``tables``: entries of constant
    integer tables; ``ranges``: values that integer members can have; ``members``: types of the members of all structs.
    """

    functions: Mapping[str, CFunction]
    macros: Mapping[str, CMacro]
    counts: Mapping[str, int]
    sizes: Mapping[str, int]
    tables: Mapping[str, Sequence[int]]
    ranges: Mapping[str, tuple[int, int]]
    members: Mapping[str, Sequence[Type]]


@dataclass
class _Frame:
    """A function or macro while it is evaluated; ``read``: names whose values the result depends on."""

    name: str
    types: dict[str, Type]
    values: dict[str, Range]
    changed: frozenset[str] = frozenset()
    tables: dict[str, str] = field(default_factory=dict)  # parameter -> table
    read: set[str] = field(default_factory=set)
    returned: list[Range] = field(default_factory=list)
    expands: bool = False  # it is a macro


@dataclass(frozen=True)
class _Summary:
    """Bound and returned values of a function for those arguments that it depends on."""

    operations: int
    value: Range
    read: tuple[str, ...]


class WorstCase:
    """Bounds of the functions of one unit; ``charges``: COST of every charge that has been met -> its operations."""

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self.charges: dict[str, int] = {}
        self._known: dict[tuple[str, frozenset[str]], dict[tuple[str, ...], dict[tuple[Argument, ...], _Summary]]] = {}
        self._counting = frozenset(name for f in unit.functions.values() for name in f.counting)
        self._running: frozenset[str] = frozenset()  # those of them that are being evaluated
        self._plain: dict[c_ast.Node | None, int] = {}
        self._shared: dict[str, dict[str, int]] = {}  # function -> stated number of passes -> operations of all of them

    def operations(self, function: str) -> int:
        """Bound for a call with unknown arguments.

        Raises:
            UnboundedError: the number of passes of a loop is unknown.
        """
        return self._summary(function, {}).operations

    # -- functions ----------------------------------------------------------------------------------------------------

    def _summary(self, name: str, arguments: Mapping[str, Argument]) -> _Summary:
        outer = self._running
        self._running = outer | ({name} & self._counting)
        summaries = self._known.setdefault((name, self._running), {})
        for read, found in summaries.items():
            known = found.get(tuple(map(arguments.get, read)))
            if known is not None:
                self._running = outer
                return known
        tree = self.unit.functions[name].tree
        types = dict(self.unit.functions[name].parameters)
        tables = {p: given for p in types if isinstance(given := arguments.get(p), str)}
        values = {p: None if isinstance(given := arguments.get(p), str) else given for p in types}
        frame = _Frame(name, types, values, _changed(tree.body), tables)
        operations = self._block(tree.body.block_items or [], frame)
        operations += sum(self._shared.get(name, {}).values())
        value = union(frame.returned) if frame.returned else None
        read = tuple(parameter for parameter, _ in self.unit.functions[name].parameters if parameter in frame.read)
        summary = _Summary(operations, value, read)
        summaries.setdefault(read, {})[tuple(map(arguments.get, read))] = summary
        self._running = outer
        return summary

    # -- statements ---------------------------------------------------------------------------------------------------

    def _block(self, items: Sequence[c_ast.Node], frame: _Frame) -> int:
        """Bound of statements in sequence."""
        total = 0
        for i, item in enumerate(items):
            if isinstance(item, c_ast.If):
                price = _charge(item.cond)
                if price is not None:
                    rest = self._block(items[i + 1 :], frame)
                    self.charges[price] = max(self.charges.get(price, 0), rest)
                    return total
                return total + self._branch(item, items[i + 1 :], frame)
            total += self._statement(item, frame)
            if isinstance(item, _EXIT):
                break
        return total

    def _branch(self, item: c_ast.If, rest: Sequence[c_ast.Node], frame: _Frame) -> int:
        """Bound of an `if` and of the statements after it, which a branch that leaves the block does not reach."""
        test, holds = self._cost(item.cond, frame), truth(self._range(item.cond, frame))
        branches = [_items(b) for b, taken in ((item.iftrue, True), (item.iffalse, False)) if holds in (None, taken)]
        ends = [bool(b) and isinstance(b[-1], _EXIT) for b in branches]
        costs = [self._block(b, frame) for b in branches]
        if all(ends):
            return test + max(costs)
        after = self._block(rest, frame)
        return test + max(cost if end else cost + after for cost, end in zip(costs, ends, strict=True))

    def _statement(self, node: c_ast.Node | None, frame: _Frame) -> int:
        match node:
            case c_ast.Pragma():
                self._take_values(node, frame)
                return 0
            case None | c_ast.EmptyStatement() | c_ast.Break() | c_ast.Continue():
                return 0
            case c_ast.Compound():
                return self._block(node.block_items or [], frame)
            case c_ast.If():
                return self._block([node], frame)
            case c_ast.Return():
                if node.expr is None:
                    return 0
                frame.returned.append(self._range(node.expr, frame))
                return self._cost(node.expr, frame)
            case c_ast.For():
                return self._for(node, frame)
            case c_ast.While() | c_ast.DoWhile():
                test = self._cost(node.cond, frame)
                return self._repeated(node, test + self._statement(node.stmt, frame), frame) + test
            case c_ast.DeclList():
                return sum(self._declaration(d, frame) for d in node.decls)
            case c_ast.Decl():
                return self._declaration(node, frame)
            case _:
                return self._cost(node, frame)

    def _declaration(self, node: c_ast.Decl, frame: _Frame) -> int:
        frame.types[node.name] = declared(node.type)
        constant = node.init is not None and node.name not in frame.changed
        frame.values[node.name] = self._range(node.init, frame) if constant else None
        return 0 if node.init is None else self._cost(node.init, frame)

    def _take_values(self, node: c_ast.Pragma, frame: _Frame) -> None:
        """Values of a variable as a comment states them."""
        name, separator, limits = node.string.partition(":")
        if separator:
            least, most = (self._range(CMacro((), text).expression, frame) for text in limits.split(";"))
            if least is None or most is None:
                raise UnboundedError(f"{frame.name}: the stated values of {name} are unknown")
            frame.values[name] = (least[0], most[1])

    def _repeated(self, loop: c_ast.Node, one_pass: int, frame: _Frame) -> int:
        """Bound of a loop whose first line states the number of its passes, in one run or in a function."""
        if one_pass == 0:
            return 0
        body, comment = _items(loop.stmt), _stated(loop)
        if comment is not None:
            text, _, function = comment.partition(" in ")
            stated = self._range(CMacro((), text).expression, frame)
            if stated is not None and function not in self._running:
                return stated[1] * one_pass
            if stated is not None:
                shared = self._shared.setdefault(function, {})
                shared[text] = max(shared.get(text, 0), stated[1] * one_pass)
                return one_pass
        if body and isinstance(body[0], c_ast.If) and _charge(body[0].cond) is not None:
            return one_pass  # every pass charges for itself before it computes
        raise UnboundedError(f"{frame.name}: the passes of a loop are unknown; expected /* at most ... passes */")

    def _for(self, node: c_ast.For, frame: _Frame) -> int:
        counter, first, step = self._counter(node, frame)
        start = 0 if node.init is None else self._statement(node.init, frame)
        if counter is not None:
            frame.types.setdefault(counter, Type("int"))
        outer = frame.values.get(counter) if counter is not None else None
        known = counter is not None and _stated(node) is None
        values = self._visited(node.cond, counter or "", first, step, frame) if known else None

        def test(value: Range) -> int:
            if counter is not None:
                frame.values[counter] = value
            return 0 if node.cond is None else self._cost(node.cond, frame)

        def one_pass(value: Range) -> int:
            return test(value) + self._statement(node.stmt, frame) + self._cost(node.next, frame)

        if values is None:
            total = self._repeated(node, one_pass(None), frame) + test(None)
        else:
            total = self._sum(values, counter or "", one_pass, frame) + test((values.stop, values.stop))
        if counter is not None:
            frame.values[counter] = outer if isinstance(node.init, c_ast.DeclList) else None
        return start + total

    def _sum(self, values: range, counter: str, one_pass: Callable[[Range], int], frame: _Frame) -> int:
        """Sum over the passes; one is enough if it does not depend on the counter."""
        before, frame.read = frame.read, set()
        total = 0
        for done, value in enumerate(values):
            total += one_pass((value, value))
            if done == 0 and counter not in frame.read:
                total *= len(values)
                break
        frame.read = before | (frame.read - {counter})
        return total

    def _counter(self, node: c_ast.For, frame: _Frame) -> tuple[str | None, Range, int]:
        """Name, first value and step of the counter of a loop."""
        name, first, step = None, None, 0
        if isinstance(node.init, c_ast.DeclList) and len(node.init.decls) == 1:
            name, start = node.init.decls[0].name, node.init.decls[0].init
            first = self._range(start, frame)
        for start in node.init.exprs if isinstance(node.init, c_ast.ExprList) else (node.init,):
            if isinstance(start, c_ast.Assignment) and node.next and assigned_names(start) <= assigned_names(node.next):
                name, first = start.lvalue.name, self._range(start.rvalue, frame)
        match node.next:
            case c_ast.UnaryOp(op="p++" | "++", expr=c_ast.ID(name=changed)) if changed == name:
                step = 1
            case c_ast.UnaryOp(op="p--" | "--", expr=c_ast.ID(name=changed)) if changed == name:
                step = -1
            case c_ast.Assignment(op="+=" | "-=", lvalue=c_ast.ID(name=changed)) if changed == name:
                by = self._range(node.next.rvalue, frame)
                step = 0 if by is None or by[0] <= 0 else by[0] if node.next.op == "+=" else -by[0]
        unsteady = name is not None and name in _changed(node.stmt)
        return (None, None, 0) if step == 0 or unsteady else (name, first, step)

    def _visited(self, cond: c_ast.Node, counter: str, first: Range, step: int, frame: _Frame) -> range | None:
        """Values that a counter can take; None: unknown."""
        if first is None:
            return None
        limits = [limit for part in _conjuncts(cond) if (limit := self._limit(part, counter, frame)) is not None]
        if step > 0:
            ends = [high + (op == "<=") for op, (_, high) in limits if op in ("<", "<=")]
            return range(first[0], min(ends), step) if ends else None
        ends = [low - (op == ">=") for op, (low, _) in limits if op in (">", ">=")]
        return range(first[1], max(ends), step) if ends else None

    def _limit(self, node: c_ast.Node, counter: str, frame: _Frame) -> tuple[str, tuple[int, int]] | None:
        """(operator, limit) of a comparison of ``counter + constant`` with a known value."""
        if not isinstance(node, c_ast.BinaryOp) or node.op not in ("<", "<=", ">", ">="):
            return None
        kept, frame.values = frame.values, {**frame.values, counter: (0, 0)}
        left, right = self._range(node.left, frame), self._range(node.right, frame)
        frame.values = kept
        if not _adds(node.left, counter) or _contains(node.right, counter) or left is None or right is None:
            return None
        return node.op, (right[0] - left[1], right[1] - left[0])

    # -- expressions --------------------------------------------------------------------------------------------------

    def _cost(self, node: c_ast.Node | None, frame: _Frame) -> int:
        """Operations of an expression; one without calls and choices has the same in every run of its function."""
        if frame.expands or not _is_plain(node):
            return self._evaluated(node, frame)
        if node not in self._plain:
            self._plain[node] = self._evaluated(node, frame)
        return self._plain[node]

    def _evaluated(self, node: c_ast.Node | None, frame: _Frame) -> int:
        match node:
            case None | c_ast.ID() | c_ast.Constant() | c_ast.Typename():
                return 0
            case c_ast.BinaryOp(op="&&" | "||"):
                left = truth(self._range(node.left, frame))
                skipped = left is (node.op == "||") and left is not None
                return self._cost(node.left, frame) + (0 if skipped else self._cost(node.right, frame))
            case c_ast.BinaryOp():
                own = self._type(node.left, frame).counts or self._type(node.right, frame).counts
                return self._cost(node.left, frame) + self._cost(node.right, frame) + own
            case c_ast.UnaryOp(op="sizeof"):
                return 0
            case c_ast.UnaryOp():
                own = node.op == "-" and self._type(node.expr, frame).counts
                return self._cost(node.expr, frame) + own
            case c_ast.Assignment():
                own = node.op != "=" and self._type(node.lvalue, frame).counts
                return self._cost(node.lvalue, frame) + self._cost(node.rvalue, frame) + own
            case c_ast.TernaryOp():
                return self._cost(node.cond, frame) + self._chosen(node, frame)
            case c_ast.FuncCall():
                return self._call(node, frame)[0]
            case _:
                return sum(self._cost(child, frame) for _, child in node.children())

    def _chosen(self, node: c_ast.TernaryOp, frame: _Frame) -> int:
        holds = truth(self._range(node.cond, frame))
        return max(
            0 if holds is False else self._cost(node.iftrue, frame),
            0 if holds is True else self._cost(node.iffalse, frame),
        )

    def _target(self, node: c_ast.FuncCall) -> str:
        """Name of what is called; SQRT is another name of sqrt or sqrtf."""
        macro = self.unit.macros.get(node.name.name)
        return node.name.name if macro is None or macro.parameters else macro.text

    def _call(self, node: c_ast.FuncCall, frame: _Frame) -> tuple[int, Range]:
        """(operations, value) of a call of a function or macro."""
        name = self._target(node)
        passed = [] if node.args is None else node.args.exprs
        cost = sum(self._cost(argument, frame) for argument in passed)
        unit = self.unit
        if name in unit.counts:
            return cost + unit.counts[name], None
        if name in unit.functions:
            summary, read = self._called(name, passed, frame)
            frame.read |= read
            return cost + summary.operations, summary.value
        if name in unit.macros:
            macro = self._expanded(unit.macros[name], passed, frame)
            operations, value = self._cost(macro[0], macro[1]), self._range(*macro)
            return cost + operations, value
        word = name if name in MATH else name.removesuffix("f")
        if word not in MATH:
            raise UnboundedError(f"{frame.name} calls {name}, which is not of this package")
        return cost + MATH[word], None

    def _called(self, name: str, passed: Sequence[c_ast.Node], frame: _Frame) -> tuple[_Summary, set[str]]:
        """Summary of a function for these arguments, and the names here that it depends on."""
        values: dict[str, Argument] = {}
        sources: dict[str, set[str]] = {}
        kept = frame.read
        for (parameter, ctype), argument in zip(self.unit.functions[name].parameters, passed, strict=True):
            if ctype != _INT:
                values[parameter] = self._table(argument, frame)
                continue
            frame.read = set()
            values[parameter] = self._range(argument, frame)
            sources[parameter] = frame.read
        frame.read = kept
        summary = self._summary(name, values)
        return summary, {read for parameter in summary.read for read in sources.get(parameter, ())}

    def _table(self, node: c_ast.Node, frame: _Frame) -> str | None:
        """The constant table of integers that an expression names; the start of another one is unknown."""
        if not isinstance(node, c_ast.ID):
            return None
        if node.name in frame.tables:
            frame.read.add(node.name)
            return frame.tables[node.name]
        return node.name if node.name in self.unit.tables and node.name not in frame.types else None

    def _expanded(self, macro: CMacro, passed: Sequence[c_ast.Node], frame: _Frame) -> tuple[c_ast.Node, _Frame]:
        """The expression of a macro, and a frame in which its parameters are the arguments."""
        named = list(zip(macro.parameters, passed, strict=True))
        inner = _Frame(
            frame.name,
            frame.types | {p: self._type(a, frame) for p, a in named},
            frame.values | {p: self._range(a, frame) for p, a in named},
            tables=frame.tables,
            read=frame.read,
            expands=True,
        )
        return macro.expression, inner

    def _type(self, node: c_ast.Node | None, frame: _Frame) -> Type:
        match node:
            case c_ast.ID():
                if node.name in frame.types:
                    return frame.types[node.name]
                macro = self.unit.macros.get(node.name)
                real = macro is not None and ("real_t" in macro.text or node.name.startswith("TOL_"))
                return Type("real") if real else Type("int")
            case c_ast.Cast():
                return declared(node.to_type.type)
            case c_ast.StructRef():
                known = self.unit.members.get(node.field.name, ())
                return next((t for t in known if t.base == "real"), known[0] if known else Type("int"))
            case c_ast.ArrayRef():
                inner = self._type(node.name, frame)
                return Type(inner.base, inner.depth - 1)
            case c_ast.UnaryOp():
                inner = self._type(node.expr, frame)
                shift = {"*": -1, "&": 1}.get(node.op, 0)
                return Type("int") if node.op in ("!", "sizeof") else Type(inner.base, inner.depth + shift)
            case c_ast.BinaryOp():
                if node.op in ("<", ">", "<=", ">=", "==", "!=", "&&", "||"):
                    return Type("int")
                left, right = self._type(node.left, frame), self._type(node.right, frame)
                return max(left, right, key=lambda t: (t.depth, t.base == "real"))
            case c_ast.TernaryOp():
                return self._type(node.iftrue, frame)
            case c_ast.Assignment():
                return self._type(node.lvalue, frame)
            case c_ast.FuncCall():
                return self._result_type(node, frame)
            case _:
                return Type("int")

    def _result_type(self, node: c_ast.FuncCall, frame: _Frame) -> Type:
        name = self._target(node)
        if name in self.unit.macros:
            passed = [] if node.args is None else node.args.exprs
            return self._type(*self._expanded(self.unit.macros[name], passed, frame))
        if name in self.unit.functions:
            return declared(self.unit.functions[name].tree.decl.type)
        return Type("real" if MATH.get(name, MATH.get(name.removesuffix("f"), 0)) else "int")

    def _range(self, node: c_ast.Node | None, frame: _Frame) -> Range:
        """Values of an integer expression."""
        match node:
            case c_ast.Constant():
                return _literal(node)
            case c_ast.ID():
                return self._variable(node.name, frame)
            case c_ast.Cast():
                return self._range(node.expr, frame) if declared(node.to_type.type) == Type("int") else None
            case c_ast.StructRef():
                return self.unit.ranges.get(node.field.name)
            case c_ast.ArrayRef(name=c_ast.ID()):
                table = self._table(node.name, frame)
                return None if table is None else entries(self.unit.tables[table], self._range(node.subscript, frame))
            case c_ast.UnaryOp(op="-"):
                inner = self._range(node.expr, frame)
                return None if inner is None else (-inner[1], -inner[0])
            case c_ast.UnaryOp(op="!"):
                holds = truth(self._range(node.expr, frame))
                return (0, 1) if holds is None else (int(not holds), int(not holds))
            case c_ast.BinaryOp():
                return combined(node.op, self._range(node.left, frame), self._range(node.right, frame))
            case c_ast.TernaryOp():
                holds = truth(self._range(node.cond, frame))
                taken = [n for n, t in ((node.iftrue, True), (node.iffalse, False)) if holds in (None, t)]
                return union([self._range(n, frame) for n in taken])
            case c_ast.FuncCall():
                return self._call(node, frame)[1]
            case _:
                return None

    def _variable(self, name: str, frame: _Frame) -> Range:
        if name in frame.values:
            frame.read.add(name)
            return frame.values[name]
        if name in self.unit.sizes:
            return (self.unit.sizes[name],) * 2
        macro = self.unit.macros.get(name)
        return None if macro is None or macro.parameters else self._range(macro.expression, frame)


@cache
def _changed(node: c_ast.Node) -> frozenset[str]:
    return frozenset(assigned_names(node))


@cache
def _is_plain(node: c_ast.Node | None) -> bool:
    """The expression has neither calls nor parts that may be skipped."""
    if isinstance(node, c_ast.FuncCall | c_ast.TernaryOp) or getattr(node, "op", "") in ("&&", "||"):
        return False
    return node is None or all(_is_plain(child) for _, child in node.children())


def _items(node: c_ast.Node | None) -> Sequence[c_ast.Node]:
    if node is None:
        return ()
    return (node.block_items or ()) if isinstance(node, c_ast.Compound) else (node,)


def _stated(loop: c_ast.Node) -> str | None:
    """What the first line of a loop says about its passes."""
    body = _items(loop.stmt)
    first = body[0].string if body and isinstance(body[0], c_ast.Pragma) else None
    return first if first is not None and ":" not in first else None


def _charge(cond: c_ast.Node) -> str | None:
    """COST in ``!qp_afford(q, COST)``."""
    match cond:
        case c_ast.UnaryOp(op="!", expr=c_ast.FuncCall(name=c_ast.ID(name=called), args=arguments)) if called == AFFORD:
            return str(arguments.exprs[1].name)
    return None


def _conjuncts(node: c_ast.Node | None) -> Iterable[c_ast.Node]:
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


def _literal(node: c_ast.Constant) -> Range:
    if node.type not in ("int", "unsigned int", "long int"):
        return None
    value = int(node.value.rstrip("uUlL"), 0)
    return value, value
