"""The calls of an OCP are recorded as declared signals, cost terms and rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.problem import Array, LqrRequest, Signal

Kind = Literal[
    "state", "control", "parameter", "algebraic", "derivative", "previous", "interval", "time", "start", "end"
]
StageName = Literal["start", "path", "terminal"]
At = Literal["path", "start", "end"] | tuple[int, ...]
Penalty = tuple[float, float] | None
Side = Literal["", "lower", "upper"]

#: This is created at import, because CasADi's first SX takes a lock, which a fork must not copy.
NOTHING = ca.SX(0, 1)


@dataclass(frozen=True, eq=False)
class Declared:
    """A declared signal has an SX symbol."""

    signal: Signal
    symbol: Any


@dataclass(frozen=True)
class Element:
    """An element is one scalar symbol: its kind, its index in the stacked vector of that kind, its name."""

    kind: Kind
    index: int
    name: str


@dataclass(frozen=True, eq=False)
class ResidualTerm:
    """The term 1/2 (y - reference)' weight (y - reference) is imposed at node 0, at every path node, or at node N."""

    y: Any
    names: tuple[str, ...]
    reference: Array
    weight: Array
    scale_with_dt: bool
    stage: StageName
    scale: tuple[float, ...] = ()  # declared scales of y; empty: none


@dataclass(frozen=True, eq=False)
class GeneralCost:
    """The term is a scalar cost at node 0, at every path node, along every interval, or at the terminal node."""

    expression: Any
    integrate: bool
    scale_with_dt: bool
    stage: StageName


@dataclass(frozen=True, eq=False)
class Statement:
    """A statement is scalar rows lower <= expression <= upper; ``at`` is None for a coupled condition.

    ``stated`` holds the names that the user gave. Rows with different penalties on their sides become two statements,
    one for each ``side``, and their names say so, unless only one side exists: it is ``alone``.
    """

    lower: Array
    expression: Any
    upper: Array
    at: At | None
    soft: Penalty
    stated: tuple[str, ...]
    scaled: bool = False
    side: Side = ""
    alone: bool = True
    end: Any = None  # the expression at node N, if it differs

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the rows."""
        return self.stated if self.alone else tuple(f"{name}_{self.side}" for name in self.stated)


@dataclass(frozen=True, eq=False)
class Equation:
    """An equation states expression = 0 in derivatives, algebraic variables and other symbols of a node."""

    name: str
    expression: Any


class StatedProblem:
    """A stated problem has the name and grid of an OCP, and all its statements in the order of the calls.

    Attributes:
        states: declarations of the states.
        controls: declarations of the controls.
        parameters: declarations of the parameters.
        algebraics: declarations of the algebraic variables.
        equations: equations of algebraic_equation() and implicit_dynamics().
        slopes: {index in x: SX}, der(x) of a state in implicit equations.
        derivatives: {index in x: SX}, the derivative of a state.
        maps: {index in x: SX}, the value of a discrete state at the next node.
        remembered: {index in u: SX}, the control at the previous node.
        blocks: {index in u: lengths of the blocks of intervals}.
        node_data: symbols after all parameters, for results of Newton's method at a node.
        residuals: least-squares terms.
        costs: general costs.
        statements: rows.
        free: indices in x that the solver chooses at node 0.
        accumulators: indices in x that are reset to 0 at every sample.
        cyclic_states: indices in x that grow without bound.
    """

    def __init__(self, name: str, N: int, dt: tuple[float, ...] | None, time_unit: str) -> None:
        self.name, self.N, self.dt, self.time_unit = name, N, dt, time_unit
        self.states: list[Declared] = []
        self.controls: list[Declared] = []
        self.parameters: list[Declared] = []
        self.algebraics: list[Declared] = []
        self.equations: list[Equation] = []
        self.slopes: dict[int, Any] = {}
        self.derivatives: dict[int, Any] = {}
        self.maps: dict[int, Any] = {}
        self.remembered: dict[int, Any] = {}
        self.blocks: dict[int, tuple[int, ...]] = {}
        self.node_data = NOTHING
        self.interval_before, self.clock = ca.SX.sym("interval"), ca.SX.sym("time")
        self._discrete: bool | None = None
        self.residuals: list[ResidualTerm] = []
        self.costs: list[GeneralCost] = []
        self.statements: list[Statement] = []
        self._terminal_lqr: LqrRequest | None = None
        self.free: set[int] = set()
        self.accumulators: set[int] = set()
        self.cyclic_states: set[int] = set()
        self._symbols: dict[str, Any] = {}  # declared signals by name
        self._elements: dict[int, Element] = {  # by the hash of its symbol
            self.interval_before.element_hash(): Element("interval", 0, "rate()"),
            self.clock.element_hash(): Element("time", 0, "time"),
        }

    @property
    def discrete(self) -> bool | None:
        """Return True if the dynamics are a discrete map, None before the first call of dynamics()."""
        return self._discrete

    @property
    def terminal_lqr(self) -> LqrRequest | None:
        """Return the request of lqr_terminal_cost(), None without one (internal)."""
        return self._terminal_lqr

    def element(self, scalar: Any) -> Element | None:
        """Return kind, index and name of a declared symbol; None for any other expression (internal)."""
        is_bare = scalar.is_scalar() and scalar.is_symbolic()
        return self._elements.get(scalar.element_hash()) if is_bare else None


def intersection(new: Statement, i: int, old: Statement, j: int, what: str) -> tuple[float, float]:
    """Return the intersection of the bounds of row i of ``new`` and row j of ``old``, which have the same name.

    Raises:
        ProblemError: the intersection is empty.
    """
    lower, upper = max(new.lower[i], old.lower[j]), min(new.upper[i], old.upper[j])
    if lower > upper:
        raise ProblemError(
            f"{what}: the row '{new.names[i]}' in [{new.lower[i]:g}, {new.upper[i]:g}] contradicts the row "
            f"'{old.names[j]}' stated before, in [{old.lower[j]:g}, {old.upper[j]:g}]"
        )
    return float(lower), float(upper)


def explain_misplacement(element: Element, kinds: tuple[Kind, ...]) -> str:
    """Explain why this symbol is not allowed in an expression of the given kinds."""
    if element.kind in ("start", "end"):
        return f"at_{element.kind}({element.name}), which is allowed in boundary() only"
    if element.kind == "derivative":
        return f"{element.name}, which is allowed in implicit_dynamics() only"
    if element.kind in ("previous", "interval", "time"):
        return f"ocp.{element.name}, which may not occur there; only these may: {', '.join(kinds)}"
    if kinds == ("start", "end"):
        return f"the {element.kind} '{element.name}'; write at_start(...) or at_end(...) of states"
    return f"the {element.kind} '{element.name}'; only these may occur: {', '.join(kinds)}"
