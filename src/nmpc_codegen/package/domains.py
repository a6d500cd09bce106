"""Where operations of a problem leave their domain, so that a value or a derivative is not finite."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nmpc_codegen.package.program import VALUES, Array, Operation, Program

#: How a warning of the compiler begins that repeats what locate() finds at the first plan.
NOT_FINITE = "the first plan has no finite derivatives"

#: Most parts of a problem that a text names besides the first.
MOST = 3

Test = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Finding:
    """An operation that leaves its domain at ``nodes``, in the part ``where``; ``operands`` at the first of them.

    order: 0 if the value is not finite there, 1 for a first derivative, 2 for a second one.
    """

    where: str
    nodes: tuple[int, ...]
    operation: Operation
    operands: tuple[float, float]
    order: int
    squares: bool = False

    @property
    def arguments(self) -> str:
        """The operands in words: "its argument is 0"."""
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
        """True if only parameters decide whether the operand is inside the domain."""
        first, second = self.operation.moved
        return not second if self.operation.name == "div" else not (first or second)

    @property
    def remedy(self) -> str:
        """What to write instead, and where the plan has to stay."""
        if self.given:
            return "set the parameters in it: parameter(name, value=...), set_parameter()"
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
    """Operations that leave their domain at a plan, those of the first such node.

    Args:
        program: with the operations.
        x: (N+1, nx) states of the plan.
        u: (N, nu) controls.
        p: (N+1, np) parameters.
        second: second derivatives count.
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
    """One text per operation: where it leaves its domain first, in which other parts, and what to do.

    Operations that contain another one of them are left out.
    """
    groups: dict[str, list[Finding]] = {}
    for finding in found:
        groups.setdefault(finding.operation.text, []).append(finding)
    inner = [text for text in groups if not any(other != text and other in text for other in groups)]
    for first, *others in (groups[text] for text in inner):
        names = list(dict.fromkeys(f.where for f in others))
        listed = ", ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "")
        yield f"{first}{', also in ' if names else ''}{listed}; {first.remedy}"


def _of_operation(operation: Operation, values: Sequence[Array], second: bool) -> list[Finding]:
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
    """Where derivatives of an operation are not finite although its value is: of first, and only of second order.

    ``instead``: what is finite there, with the operands {a} and {b}, {sum} for the first one in a sum, {eps} for a
    small number, which makes equations less stiff if it is larger; "" if there is nothing of the kind. ``root``: it is
    a norm.
    """

    first: Test
    second: Test = _never
    instead: str = ""
    root: bool = False


def _power_first(a: Array, b: Array) -> Array:
    return np.asarray((a == 0) & (b < 1))


def _power_second(a: Array, b: Array) -> Array:
    return np.asarray((a == 0) & (b < 2) & (b != 1))


#: Parts of an expression that are finite everywhere.
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
