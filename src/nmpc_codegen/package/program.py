"""The rows of a problem, and operations with restricted domains, form a program that runs in NumPy.

frontend/row_program.py extracts it from the problem; it is part of <name>.json, so that a package can be diagnosed
without CasADi. EDGES says where the value or the derivatives of an operation need not be finite; locate() finds the
operations that are there, and in_words() describes them, in the user's names, with the remedy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.lookup import Lookup

Array = NDArray[Any]

#: Name, first and second operand (for an input: port and element), value of a constant.
Step = tuple[str, int, int, float]


@dataclass(frozen=True)
class Quantity:
    """A quantity is a named part of the problem, e.g. "row 'leash'", which is evaluated at the nodes first..last.

    ``squares`` marks a hard row without a lower bound above 0, whose bound may be stated on the square instead.
    """

    name: str
    first: int
    last: int
    squares: bool = False


@dataclass(frozen=True)
class EdgeOperation:
    """An operation with a restricted domain has operands that may leave the domain.

    operands: indices of the two operands among the steps of the program, equal for a single operand; texts: the
    operands as text; moved: True for operands that depend on states or controls; quantities: the parts of the problem
    that contain the operation.
    """

    name: str
    text: str
    texts: tuple[str, str]
    operands: tuple[int, int]
    moved: tuple[bool, bool]
    quantities: tuple[Quantity, ...]


@dataclass(frozen=True)
class Program:
    """A program has steps, each of which uses earlier steps or an input: x, u or p.

    rows: for every row of the problem the steps of its value at the nodes before the end and at the end; -1 if there is
    none, or the row is not general. operations: those with restricted domains. lookups: tables, which a step "lookup"
    reads by the number that is its constant. residuals: steps of the path residual; scaled: True for those whose weight
    is multiplied by the length of the interval; costs: steps of the general cost of a node and of the integrated one,
    -1 for none. weight: the declared weight of the path residual, its diagonal, or all entries row by row. resets: rows
    that contain states which every sample resets.
    """

    steps: tuple[Step, ...] = ()
    rows: tuple[tuple[int, int], ...] = ()
    operations: tuple[EdgeOperation, ...] = ()
    lookups: tuple[Lookup, ...] = ()
    residuals: tuple[int, ...] = ()
    scaled: tuple[bool, ...] = ()
    costs: tuple[int, int] = (-1, -1)
    weight: tuple[float, ...] = ()
    resets: tuple[int, ...] = ()

    def check(self, sizes: Sequence[int], rows: int, edges: Container[str]) -> None:
        """Raise ValueError unless everything to which the program refers exists.

        Args:
            sizes: sizes of x, u and p.
            rows: number of rows of the problem.
            edges: names of the operations that may occur in ``operations``.
        """
        if len(self.rows) != rows:
            raise ValueError(f"the program has {len(self.rows)} rows, expected {rows}")
        self._check_steps(sizes)
        if len(self.residuals) != len(self.scaled):
            raise ValueError(f"the program has {len(self.residuals)} residuals, of which {len(self.scaled)} are scaled")
        if len(self.weight) not in (len(self.residuals), len(self.residuals) ** 2):
            raise ValueError(f"the program has {len(self.residuals)} residuals and {len(self.weight)} weights")
        operands = [o.operands for o in self.operations]
        for steps, least in ((self.rows, -1), (operands, 0), ([self.residuals], 0), ([self.costs], -1)):
            if not all(least <= i < len(self.steps) for pair in steps for i in pair):
                raise ValueError("the program lacks a step of a row or an operand")
        unknown = [o.name for o in self.operations if o.name not in edges]
        if unknown:
            raise ValueError(f"the program contains the operations {', '.join(unknown)}")

    def _check_steps(self, sizes: Sequence[int]) -> None:
        """Raise ValueError unless every step reads only inputs, tables and earlier steps."""
        for i, (name, first, second, constant) in enumerate(self.steps):
            if name == "input":
                known = 0 <= first < len(sizes) and 0 <= second < sizes[first]
            elif name == "lookup":
                known = 0 <= first < i and constant in range(len(self.lookups))
            else:
                known = name == "const" or (name in VALUES and 0 <= first < i and 0 <= second < i)
            if not known:
                raise ValueError(f"step {i} of the program is {name} {first} {second}")

    def values(self, x: Array, u: Array, p: Array, wanted: Iterable[int] | None = None) -> list[Array]:
        """Return the values of all steps at nodes: x (n, nx), u (n, nu), p (n, np) -> arrays (n,).

        With ``wanted``, only these steps and their operands have values, and the other arrays are empty.
        """
        inputs, found = (x, u, p), []
        needed = range(len(self.steps)) if wanted is None else self._behind(*wanted)
        for i, (name, first, second, constant) in enumerate(self.steps):
            if i not in needed:
                found.append(np.zeros(0))
            elif name == "input":
                found.append(np.asarray(inputs[first][:, second], dtype=np.float64))
            elif name == "const":
                found.append(np.full(len(x), constant))
            elif name == "lookup":
                found.append(self.lookups[int(constant)](found[first]))
            else:
                found.append(np.asarray(VALUES[name](found[first], found[second]), dtype=np.float64))
        return found

    def inputs(self, step: int) -> frozenset[tuple[int, int]]:
        """Return port and element of every input on which a step depends."""
        return frozenset(self.steps[i][1:3] for i in self._behind(step) if self.steps[i][0] == "input")

    def _behind(self, *steps: int) -> set[int]:
        """Return the given steps, and all steps from which they are computed."""
        found, waiting = set(steps), list(steps)
        while waiting:
            name, first, second, _ = self.steps[waiting.pop()]
            operands = () if name in ("input", "const") else (first,) if name == "lookup" else (first, second)
            waiting += [i for i in operands if i not in found]
            found.update(operands)
        return found


_remainder = np.vectorize(lambda a, b: math.remainder(a, b) if b and math.isfinite(a) else math.nan, otypes=[float])
_erf = np.vectorize(math.erf, otypes=[float])

#: Functions of math.h by name: those of one operand, and those of two.
OF_ONE: Mapping[str, Callable[..., Any]] = {
    "sqrt": np.sqrt,
    "exp": np.exp,
    "expm1": np.expm1,
    "log": np.log,
    "log1p": np.log1p,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "fabs": np.abs,
    "floor": np.floor,
    "ceil": np.ceil,
}
OF_TWO: Mapping[str, Callable[..., Any]] = {
    "pow": np.power,
    "atan2": np.arctan2,
    "hypot": np.hypot,
    "fmod": np.fmod,
    "fmin": np.fmin,
    "fmax": np.fmax,
    "copysign": np.copysign,
}


def _ignore_second(function: Callable[[Array], Any]) -> Callable[[Array, Array], Any]:
    """Return a function of the first operand as a function of both."""
    return lambda a, b: function(a)


#: Operation -> its value; operations of one operand ignore the second.
VALUES: Mapping[str, Callable[[Array, Array], Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": lambda a, b: -a,
    "sq": lambda a, b: a * a,
    "twice": lambda a, b: a + a,
    "inv": lambda a, b: 1 / a,
    "constpow": np.power,
    "remainder": _remainder,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "not": lambda a, b: a == 0,
    "and": lambda a, b: (a != 0) & (b != 0),
    "or": lambda a, b: (a != 0) | (b != 0),
    "if_else_zero": lambda a, b: np.where(a != 0, b, 0.0),
    "erf": lambda a, b: _erf(a),
    "sign": lambda a, b: np.sign(a),
    **OF_TWO,
    **{name: _ignore_second(function) for name, function in OF_ONE.items()},
}


# -- where operations have an edge ------------------------------------------------------------------------------------

#: Beginning of the warning with the results of locate() at the first plan.
NOT_FINITE = "the first plan has no finite derivatives"

#: Largest number of parts of a problem that a text names besides the first.
MOST = 3

Test = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Finding:
    """A finding is an operation that leaves its domain at ``nodes``, in the part ``where`` of the problem.

    ``operands`` are the values of the operands at the first node; ``order`` is 0 if the value is not finite there, 1
    for a first derivative, 2 for a second one.
    """

    where: str
    nodes: tuple[int, ...]
    operation: EdgeOperation
    operands: tuple[float, float]
    order: int
    squares: bool = False

    @property
    def arguments(self) -> str:
        """Return the operands in words: "its argument is 0"."""
        first, second = (f"{value + 0.0:.3g}" for value in self.operands)
        if self.operation.name in ("div", "inv"):
            return f"the denominator is {second if self.operation.name == 'div' else first}"
        if self.operation.operands[0] == self.operation.operands[1] or self.operation.name == "constpow":
            return f"its argument is {first}"
        return f"its arguments are {first} and {second}"

    def __str__(self) -> str:
        what = ("is not finite", "has no finite derivative", "has no finite second derivative")[self.order]
        return f"{self.where} at {_nodes(self.nodes)}: {self.operation.text} {what} where {self.arguments}"

    @property
    def given(self) -> bool:
        """Return True if only parameters decide whether the operand is inside the domain."""
        first, second = self.operation.moved
        return not second if self.operation.name == "div" else not (first or second)

    @property
    def remedy(self) -> str:
        """Return what to write instead, and where the plan has to stay."""
        if self.given:
            return "set the parameters in it: parameter(name, value=..., bounds=...), set_parameter()"
        edge = EDGES[self.operation.name]
        a, b = (f"({text})" if " " in text else text for text in self.operation.texts)
        found = ["bound the square instead"] if self.squares and edge.root else []
        if edge.instead and (self.order or not edge.root):
            eps = "1e-3" if self.where.startswith(("the equation", "the map")) else "1e-6"
            found.append(f"write {edge.instead.format(a=a, b=b, sum=self.operation.texts[0], eps=eps)}")
        if self.nodes[-1] > 0:
            found.append("keep the plan away from there: bounds, initial=, ctrl.x, ctrl.u")
        return "; or ".join(found) or "the measured state is outside of the domain: check its units"


def _nodes(nodes: tuple[int, ...]) -> str:
    if len(nodes) == 1:
        return f"node {nodes[0]}"
    if nodes == tuple(range(nodes[0], nodes[-1] + 1)):
        return f"nodes {nodes[0]}..{nodes[-1]}"
    return f"nodes {', '.join(map(str, nodes))}"


def locate(program: Program, x: Array, u: Array, p: Array, second: bool) -> list[Finding]:
    """Return the operations that leave their domain at a plan, those of the first such node.

    Args:
        program: the program with the operations.
        x: (N+1, nx) states of the plan.
        u: (N, nu) controls.
        p: (N+1, np) parameters.
        second: True if second derivatives count.
    """
    if not program.operations:
        return []
    held = np.append(u, u[-1:], axis=0)
    with np.errstate(all="ignore"):
        values = program.values(x, held, p)
        found = [f for o in program.operations for f in _of_operation(o, values, second)]
    first = min((f.nodes[0] for f in found), default=0)
    return [f for f in found if f.nodes[0] == first]


def in_words(found: Sequence[Finding]) -> Iterator[str]:
    """Yield one text per operation: where it leaves its domain first, in which other parts, and what to do.

    An operation that contains another one of them is left out.
    """
    groups: dict[str, list[Finding]] = {}
    for finding in found:
        groups.setdefault(finding.operation.text, []).append(finding)
    inner = [text for text in groups if not any(other != text and other in text for other in groups)]
    for first, *others in (groups[text] for text in inner):
        names = list(dict.fromkeys(f.where for f in others))
        listed = ", ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "")
        yield f"{first}{', also in ' if names else ''}{listed}; {first.remedy}"


def _of_operation(operation: EdgeOperation, values: Sequence[Array], second: bool) -> list[Finding]:
    a, b = (values[i] for i in operation.operands)
    edge = EDGES[operation.name]
    value = np.asarray(VALUES[operation.name](a, b), dtype=np.float64)
    undefined = ~np.isfinite(value)
    order = np.where(undefined, 0, np.where(edge.first(a, b), 1, np.where(edge.second(a, b), 2, 3)))
    if operation.name == "pow" and operation.moved[1]:  # the derivative by the exponent contains log(a)
        order = np.where(~undefined & (a <= 0), 1, order)
    if not any(operation.moved):
        order = np.where(order == 0, 0, 3)
    bad = (order < (3 if second else 2)) & np.isfinite(a) & np.isfinite(b)
    found = []
    for part in operation.quantities:
        nodes = tuple(int(k) for k in np.flatnonzero(bad) if part.first <= k <= part.last)
        if nodes:
            k = nodes[0]
            operands = (float(a[k]), float(b[k]))
            found.append(Finding(part.name, nodes, operation, operands, int(order[k]), part.squares))
    return found


# -- what is known of every operation ---------------------------------------------------------------------------------


def _never(a: Array, b: Array) -> Array:
    return np.zeros(a.shape, dtype=bool)


@dataclass(frozen=True)
class Edge:
    """An edge states where derivatives of an operation are not finite although its value is.

    ``first`` tests for the first order, ``second`` for only the second order. ``instead`` is a finite replacement, with
    the operands {a} and {b}, {sum} for the first one in a sum, {eps} for a small number, which makes equations less
    stiff if it is larger; "" if there is none. ``root`` marks a norm.
    """

    first: Test
    second: Test = _never
    instead: str = ""
    root: bool = False


def _power_first(a: Array, b: Array) -> Array:
    return np.asarray((a == 0) & (b < 1))


def _power_second(a: Array, b: Array) -> Array:
    return np.asarray((a == 0) & (b < 2) & (b != 1))


#: An expression that is finite everywhere.
_POWER = "pow(sqrt({a}**2 + 1e-6), {b}) if {a} >= 0"
_LOG = "log(fmax({a}, 1e-3))"
_QUOTIENT = "{a} * {b} / ({b}**2 + 1e-6)"
_INVERSE = "{a} / ({a}**2 + 1e-6)"
_ANGLE = "the direction (sin, cos) instead of the angle, or atan2({a}, {b} + 1e-3) if {b} >= 0"

EDGES: Mapping[str, Edge] = {
    "sqrt": Edge(lambda a, b: a <= 0, instead="sqrt({sum} + {eps})", root=True),
    "hypot": Edge(lambda a, b: (a == 0) & (b == 0), instead="sqrt({a}**2 + {b}**2 + {eps})", root=True),
    "atan2": Edge(lambda a, b: (a == 0) & (b == 0), instead=_ANGLE),
    "pow": Edge(_power_first, _power_second, instead=_POWER),
    "constpow": Edge(_power_first, _power_second, instead=_POWER),
    "log": Edge(lambda a, b: a <= 0, instead=_LOG),
    "log1p": Edge(lambda a, b: a <= -1),
    "asin": Edge(lambda a, b: np.abs(a) >= 1),
    "acos": Edge(lambda a, b: np.abs(a) >= 1),
    "acosh": Edge(lambda a, b: a <= 1),
    "atanh": Edge(lambda a, b: np.abs(a) >= 1),
    "div": Edge(lambda a, b: b == 0, instead=_QUOTIENT),
    "inv": Edge(lambda a, b: a == 0, instead=_INVERSE),
    "exp": Edge(_never),
    "expm1": Edge(_never),
    "sinh": Edge(_never),
    "cosh": Edge(_never),
}
