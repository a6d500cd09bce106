"""Second derivatives by arithmetic with Taylor polynomials of degree 2, independent of CasADi and the generated C.

A Jet is (value, gradient, Hessian) with respect to z; f is run instruction by instruction on Jets, and CasADi only
provides its text. The scheme is the definition of the Butcher tableau.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Jet:
    """v + g'dz + 1/2 dz'H dz."""

    v: float
    g: Array
    H: Array

    def __add__(self, o: Jet) -> Jet:
        return Jet(self.v + o.v, self.g + o.g, self.H + o.H)

    def __mul__(self, o: Jet) -> Jet:
        cross = np.outer(self.g, o.g)
        return Jet(self.v * o.v, self.v * o.g + o.v * self.g, self.v * o.H + o.v * self.H + cross + cross.T)

    def times(self, a: float) -> Jet:
        return Jet(a * self.v, a * self.g, a * self.H)

    def through(self, value: float, first: float, second: float) -> Jet:
        """phi(self) from phi and its derivatives."""
        return Jet(value, first * self.g, first * self.H + second * np.outer(self.g, self.g))


def _power(a: Jet, b: Jet) -> Jet:
    n = b.v
    assert not b.g.any(), "a constant exponent"
    return a.through(a.v**n, n * a.v ** (n - 1), n * (n - 1) * a.v ** (n - 2))


def _inverse(a: Jet) -> Jet:
    return a.through(1 / a.v, -1 / a.v**2, 2 / a.v**3)


_UNARY: dict[int, Callable[[Jet], Jet]] = {
    ca.OP_NEG: lambda a: a.times(-1.0),
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a.times(2.0),
    ca.OP_INV: _inverse,
    ca.OP_SQRT: lambda a: a.through(np.sqrt(a.v), 0.5 / np.sqrt(a.v), -0.25 / a.v**1.5),
    ca.OP_EXP: lambda a: a.through(np.exp(a.v), np.exp(a.v), np.exp(a.v)),
    ca.OP_SIN: lambda a: a.through(np.sin(a.v), np.cos(a.v), -np.sin(a.v)),
    ca.OP_COS: lambda a: a.through(np.cos(a.v), -np.sin(a.v), -np.cos(a.v)),
    ca.OP_TAN: lambda a: a.through(np.tan(a.v), 1 + np.tan(a.v) ** 2, 2 * np.tan(a.v) * (1 + np.tan(a.v) ** 2)),
}

_BINARY: dict[int, Callable[[Jet, Jet], Jet]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a + b.times(-1.0),
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a * _inverse(b),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
}


def run(function: Any, arguments: Sequence[Sequence[Jet]], size: int) -> list[Jet]:
    """The dense first output of a CasADi SX Function on Jets in ``size`` variables."""
    zero = Jet(0.0, np.zeros(size), np.zeros((size, size)))
    work: dict[int, Jet] = {}
    result = [zero] * function.numel_out(0)
    rows = function.sparsity_out(0).row()
    for k in range(function.n_instructions()):
        op, o, i = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if op == ca.OP_OUTPUT:
            result[rows[o[1]]] = work[i[0]]
        elif op == ca.OP_INPUT:
            work[o[0]] = arguments[i[0]][i[1]]
        elif op == ca.OP_CONST:
            work[o[0]] = Jet(float(function.instruction_constant(k)), zero.g, zero.H)
        elif op in _UNARY:
            work[o[0]] = _UNARY[op](work[i[0]])
        else:
            work[o[0]] = _BINARY[op](work[i[0]], work[i[1]])
    return result


def interval(
    f: Any, rate: Any, scheme: tuple[Any, Any], steps: int, dt: float, x: Array, u: Array, p: Array
) -> tuple[list[Jet], Jet]:
    """x(dt) and the integral of the rate (None: 0) as Jets in z = (x, u); f(x, u, p) and rate(x, u, p) from CasADi."""
    nx, size = len(x), len(x) + len(u)
    unit, flat = np.eye(size), np.zeros((size, size))
    state = [Jet(float(v), unit[i], flat) for i, v in enumerate(x)]
    controls = [Jet(float(v), unit[nx + i], flat) for i, v in enumerate(u)]
    parameters = [Jet(float(v), np.zeros(size), flat) for v in p]
    total, h = Jet(0.0, np.zeros(size), flat), dt / steps
    a, b = scheme
    for _ in range(steps):
        slopes: list[list[Jet]] = []
        for i in range(len(b)):
            X = list(state)
            for j in range(i):
                if a[i][j]:
                    X = [s + k.times(h * a[i][j]) for s, k in zip(X, slopes[j], strict=True)]
            slopes.append(run(f, (X, controls, parameters), size))
            if rate is not None:
                total = total + run(rate, (X, controls, parameters), size)[0].times(h * b[i])
        for i, K in enumerate(slopes):
            state = [s + k.times(h * b[i]) for s, k in zip(state, K, strict=True)]
    return state, total
