"""The rows of a problem, and operations whose value or derivatives need not be finite, as a program that runs in NumPy.

frontend/program.py takes it from the problem; it is part of <name>.json, so that a package can be diagnosed where
CasADi is not installed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

#: Name, first and second operand (those of an input: port and element), value of a constant.
Step = tuple[str, int, int, float]


@dataclass(frozen=True)
class Quantity:
    """A part of the problem by its name, e.g. "row 'leash'", that is evaluated at the nodes first..last.

    ``squares``: the bound may be stated on the square instead: a hard row without a lower bound above 0.
    """

    name: str
    first: int
    last: int
    squares: bool = False


@dataclass(frozen=True)
class Operation:
    """An operation and its text; ``operands``: two steps of the program, twice the same one if there is one operand.

    ``texts``: those of the operands; ``moved``: which of them depend on states and controls; ``quantities``: the parts
    that it occurs in.
    """

    name: str
    text: str
    texts: tuple[str, str]
    operands: tuple[int, int]
    moved: tuple[bool, bool]
    quantities: tuple[Quantity, ...]


@dataclass(frozen=True)
class Program:
    """Steps, each of which refers to steps before it or to an input: x, u or p.

    ``rows``: for every row of the problem the steps of its value at the nodes before the end and at the end; -1: none,
    or the row is no general one. ``operations``: those with an edge.
    """

    steps: tuple[Step, ...] = ()
    rows: tuple[tuple[int, int], ...] = ()
    operations: tuple[Operation, ...] = ()

    def check(self, sizes: Sequence[int], rows: int, edges: Container[str]) -> None:
        """ValueError unless all that it refers to exists.

        Args:
            sizes: of x, u and p.
            rows: number of rows of the problem.
            edges: names of the operations that may occur in ``operations``.
        """
        if len(self.rows) != rows:
            raise ValueError(f"the program has {len(self.rows)} rows, expected {rows}")
        for i, (name, first, second, _) in enumerate(self.steps):
            if name == "input":
                known = 0 <= first < len(sizes) and 0 <= second < sizes[first]
            else:
                known = name == "const" or (name in VALUES and 0 <= first < i and 0 <= second < i)
            if not known:
                raise ValueError(f"step {i} of the program is {name} {first} {second}")
        for steps, least in ((self.rows, -1), ([o.operands for o in self.operations], 0)):
            if not all(least <= i < len(self.steps) for pair in steps for i in pair):
                raise ValueError("the program lacks a step of a row or an operand")
        unknown = [o.name for o in self.operations if o.name not in edges]
        if unknown:
            raise ValueError(f"the program contains the operations {', '.join(unknown)}")

    def values(self, x: Array, u: Array, p: Array) -> list[Array]:
        """Values of all steps at nodes: x (n, nx), u (n, nu), p (n, np) -> arrays (n,)."""
        inputs, found = (x, u, p), []
        for name, first, second, constant in self.steps:
            if name == "input":
                found.append(np.asarray(inputs[first][:, second], dtype=np.float64))
            elif name == "const":
                found.append(np.full(len(x), constant))
            else:
                found.append(np.asarray(VALUES[name](found[first], found[second]), dtype=np.float64))
        return found


_remainder = np.vectorize(lambda a, b: math.remainder(a, b) if b and math.isfinite(a) else math.nan, otypes=[float])
_erf = np.vectorize(math.erf, otypes=[float])

#: Functions of math.h by their names: of one operand, and of two.
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


def _of_first(function: Callable[[Array], Any]) -> Callable[[Array, Array], Any]:
    """A function of the first operand as one of both."""
    return lambda a, b: function(a)


#: Values of the operations of a program; those of one operand ignore the second.
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
    **{name: _of_first(function) for name, function in OF_ONE.items()},
}
