"""Butcher tableaus of explicit and implicit Runge-Kutta schemes validate themselves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from nmpc_codegen.errors import OptionError
from nmpc_codegen.ir.casadi_types import Expression

F = Fraction


#: A coefficient is exact, or a floating-point number if it is irrational.
Coefficient = Fraction | float

#: Residuals of order conditions up to this value come from rounding of irrational coefficients.
ROUNDING = 1e-13

#: Excess of |R| over 1 that counts as rounding; inverse of the number that stands for infinity.
UNSTABLE, FAR = 1e-9, 1e-6


#: Least determinant of the coefficients of stages that depend on each other.
REGULAR = 1e-9

#: Stability that a tableau may claim.
STABILITY = ("", "A", "L")


@dataclass(frozen=True)
class ButcherTableau:
    """The tableau defines the Runge-Kutta scheme X_i = x + h sum_j a_ij K_j, K_i = f(X_i), x+ = x + h sum_i b_i K_i.

    The tableau is checked on creation: a is lower triangular with a nonnegative diagonal, or regular. The order
    conditions up to min(order, 4), and the quadrature conditions beyond, hold exactly, or up to rounding with
    floating-point coefficients. The claimed stability holds for

        R(z) = 1 + z b' (I - z A)^{-1} 1 = det(I - z (A - 1 b')) / det(I - z A)

    Args:
        name: name in reports.
        a: (s, s), rows of fractions or numbers.
        b: (s,).
        order: order of convergence.
        stability: "A": |R(z)| <= 1 for Re z <= 0; "L": also R = 0 at infinity; "": nothing is claimed.

    Raises:
        OptionError: a condition does not hold.

    Examples:
        >>> from nmpc_codegen import ButcherTableau, ExplicitRungeKutta
        >>> ralston = ButcherTableau("Ralston", ((0, 0), (2 / 3, 0)), (1 / 4, 3 / 4), 2)
        >>> integrator = ExplicitRungeKutta(ralston, steps=3)
    """

    name: str
    a: tuple[tuple[Coefficient, ...], ...]
    b: tuple[Coefficient, ...]
    order: int
    stability: Literal["", "A", "L"] = ""

    def __post_init__(self) -> None:
        s = len(self.b)
        if len(self.a) != s or any(len(row) != s for row in self.a):
            raise OptionError(f"tableau {self.name}: a must be {s} x {s}, as b has {s} entries")
        full = self.kind == "fully implicit"
        if full and abs(np.linalg.det(np.array(self.a, dtype=float))) < REGULAR:
            raise OptionError(f"tableau {self.name}: a must be lower triangular or regular")
        if not full and any(self.a[i][i] < 0 for i in range(s)):
            raise OptionError(f"tableau {self.name}: the diagonal of a must not be negative")
        for order, residual in self.order_residuals():
            limit = 0.0 if isinstance(residual, Fraction) else ROUNDING
            if order <= self.order and abs(float(residual)) > limit:
                raise OptionError(f"tableau {self.name}: an order condition of order {order} is off by {residual}")
        if self.stability not in STABILITY:
            raise OptionError(f"tableau {self.name}: stability {self.stability!r}; expected one of {STABILITY}")
        if self.stability:
            self._check_stability()

    def _check_stability(self) -> None:
        """Raise OptionError unless the claimed stability holds.

        |R(iy)| <= 1 for all y, R has no pole with Re z <= 0, and for "L" R vanishes at infinity.
        """
        limit = abs(self.stability_function(-1 / FAR))
        along = np.tan(np.linspace(0, math.pi / 2, 2000, endpoint=False))
        most = max(abs(self.stability_function(complex(0, y))) for y in along)
        if self.kind == "explicit" or most > 1 + UNSTABLE or limit > 1 + UNSTABLE:
            raise OptionError(f"tableau {self.name}: it is not A-stable; |R(iy)| reaches {most:.3g}")
        if self.stability == "L" and limit > 10 * FAR:
            raise OptionError(f"tableau {self.name}: it is not L-stable; |R| at infinity is {limit:.3g}")

    def stability_function(self, z: complex) -> complex:
        """Return R(z): x+ = R(h lambda) x for x' = lambda x."""
        a, b = np.array(self.a, dtype=float), np.array(self.b, dtype=float)
        one = np.eye(len(b))
        with np.errstate(all="ignore"):  # NaN where a product overflows
            return complex(np.linalg.det(one - z * (a - b)) / np.linalg.det(one - z * a))

    @property
    def kind(self) -> str:
        """Return the kind of the scheme by the zeros of its matrix a.

        Explicit schemes have a zero diagonal; diagonally implicit ones may have a zero in its first entry; stages of
        fully implicit ones depend on later stages.
        """
        if any(self.a[i][j] for i in range(self.stages) for j in range(i + 1, self.stages)):
            return "fully implicit"
        zeros = [not self.a[i][i] for i in range(self.stages)]
        if all(zeros):
            return "explicit"
        return "implicit with explicit stages behind the first" if any(zeros[1:]) else "diagonally implicit"

    @property
    def stages(self) -> int:
        """Return the number of stages."""
        return len(self.b)

    @property
    def block(self) -> int:
        """Return the number of stages that are solved together."""
        return self.stages if self.kind == "fully implicit" else 1

    @property
    def c(self) -> tuple[Coefficient, ...]:
        """Return c_i = sum_j a_ij."""
        return tuple(sum(row, F(0)) for row in self.a)

    def order_residuals(self) -> list[tuple[int, Coefficient]]:
        """Return (order, residual) of the eight order conditions up to order 4, and of quadrature conditions.

        The order conditions are those of Hairer, Norsett, Wanner, table II.2.2; the quadrature conditions are b'c^(k-1)
        = 1 / k beyond, up to one more than the claimed order.
        """
        a, b, c = self.a, self.b, self.c
        s = range(len(b))

        def ac(power: int) -> list[Coefficient]:
            return [sum((a[i][j] * c[j] ** power for j in s), F(0)) for i in s]

        def weigh(values: list[Coefficient]) -> Coefficient:
            return sum((b[i] * values[i] for i in s), F(0))

        first, second = ac(1), ac(2)
        nested = [sum((a[i][j] * first[j] for j in s), F(0)) for i in s]
        return [
            (1, sum(b, F(0)) - 1),
            (2, weigh(list(c)) - F(1, 2)),
            (3, weigh([v**2 for v in c]) - F(1, 3)),
            (3, weigh(first) - F(1, 6)),
            (4, weigh([v**3 for v in c]) - F(1, 4)),
            (4, weigh([c[i] * first[i] for i in s]) - F(1, 8)),
            (4, weigh(second) - F(1, 12)),
            (4, weigh(nested) - F(1, 24)),
            *((k, weigh([v ** (k - 1) for v in c]) - F(1, k)) for k in range(5, self.order + 2)),
        ]


def combine(
    x: Expression, h: Expression, slopes: Sequence[Expression], coefficients: Sequence[Coefficient]
) -> Expression:
    """Return x + h sum_j c_j K_j; ``slopes`` are the K_j with nonzero c_j, and equal coefficients share a product."""
    values = [c for c in coefficients if c]
    for c in dict.fromkeys(values):
        same = [k for k, v in zip(slopes, values, strict=True) if v == c]
        total = same[0]
        for k in same[1:]:
            total = total + k
        x = x + (h if c == 1 else h * float(c)) * total
    return x


def _fractions(*rows: tuple[Fraction | int, ...]) -> tuple[tuple[Fraction, ...], ...]:
    s = len(rows)
    return tuple(tuple(F(v) for v in row) + (F(0),) * (s - len(row)) for row in rows)


def _values(*values: Fraction | int) -> tuple[Fraction, ...]:
    return tuple(F(v) for v in values)


Euler = ButcherTableau("Euler", _fractions(()), _values(1), 1)
"""One stage, order 1, explicit."""
Midpoint = ButcherTableau("Midpoint", _fractions((), (F(1, 2),)), _values(0, 1), 2)
"""Two stages, order 2, explicit."""
Heun = ButcherTableau("Heun", _fractions((), (1,)), _values(F(1, 2), F(1, 2)), 2)
"""Two stages, order 2, explicit: the trapezoidal rule."""
SSPRK3 = ButcherTableau("SSPRK3", _fractions((), (1,), (F(1, 4), F(1, 4))), _values(F(1, 6), F(1, 6), F(2, 3)), 3)
"""Three stages, order 3, explicit: convex combinations of Euler steps (Shu and Osher 1988)."""
RK4 = ButcherTableau(
    "RK4",
    _fractions((), (F(1, 2),), (0, F(1, 2)), (0, 0, 1)),
    _values(F(1, 6), F(1, 3), F(1, 3), F(1, 6)),
    4,
)
"""Four stages, order 4, explicit: the classical scheme, and the default."""

#: Explicit schemes by name.
TABLEAUS: dict[str, ButcherTableau] = {t.name: t for t in (Euler, Midpoint, Heun, SSPRK3, RK4)}


def _sdirk3() -> ButcherTableau:
    """Return the scheme of Alexander (1977): three stages, with g the root of g^3 - 3 g^2 + 3/2 g - 1/6."""
    g = _ROOT
    b1, b2 = -(6 * g**2 - 16 * g + 1) / 4, (6 * g**2 - 20 * g + 5) / 4
    return ButcherTableau("SDIRK3", ((g, 0.0, 0.0), ((1 - g) / 2, g, 0.0), (b1, b2, g)), (b1, b2, g), 3, "L")


def _esdirk3() -> ButcherTableau:
    """Return a scheme of four stages of order 2 with an explicit first stage, c = (0, 2 g, 3/5, 1).

    Source: Kennedy and Carpenter, NASA/TM-2016-219173, ESDIRK3(2)4L[2]SA.
    """
    g, c3 = _ROOT, 0.6
    c2 = 2 * g
    a32 = c3 * (c3 - c2) / (2 * c2)
    b3 = (1 / 3 - g - c2 * (1 / 2 - g)) / (c3 * (c3 - c2))
    b2 = (1 / 2 - g - b3 * c3) / c2
    b = (1 - b2 - b3 - g, b2, b3, g)
    rows = ((0.0, 0.0, 0.0, 0.0), (g, g, 0.0, 0.0), (c3 - a32 - g, a32, g, 0.0), b)
    return ButcherTableau("ESDIRK3", rows, b, 3, "L")


_G2 = 1 - math.sqrt(0.5)
#: Root of g^3 - 3 g^2 + 3/2 g - 1/6 between 1/6 and 1/2, with which three implicit stages of order 3 are L-stable.
_ROOT = 0.43586652150845899942

ImplicitEuler = ButcherTableau("ImplicitEuler", ((F(1),),), _values(1), 1, "L")
"""One stage, order 1, L-stable."""
ImplicitMidpoint = ButcherTableau("ImplicitMidpoint", ((F(1, 2),),), _values(1), 2, "A")
"""One stage, order 2, A-stable."""
SDIRK2 = ButcherTableau("SDIRK2", ((_G2, 0.0), (1 - _G2, _G2)), (1 - _G2, _G2), 2, "L")
"""Two stages, order 2, L-stable, one factorisation for both."""
SDIRK3 = _sdirk3()
"""Three stages, order 3, L-stable (Alexander 1977): what stiff models and equations get by default."""
ESDIRK3 = _esdirk3()
"""Four stages, the first one explicit, order 3, L-stable, stages of order 2 (Kennedy and Carpenter 2016)."""


def _collocation(name: str, c: Sequence[float], order: int, stability: Literal["A", "L"]) -> ButcherTableau:
    """Return the scheme whose stages are the points c of a polynomial: sum_j a_ij c_j^(k-1) = c_i^k / k.

    Source: Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.5.
    """
    s = np.arange(len(c))
    powers = np.array(c)[:, None] ** s  # c_j^(k-1)
    ends = np.array([*c, 1.0])[:, None] ** (s + 1) / (s + 1)
    weights = np.linalg.solve(powers.T, ends.T).T
    rows = tuple(tuple(map(float, row)) for row in weights)
    return ButcherTableau(name, rows[:-1], rows[-1], order, stability)


_R6, _R15 = math.sqrt(6), math.sqrt(15)
GaussLegendre2 = _collocation("GaussLegendre2", (0.5 - math.sqrt(3) / 6, 0.5 + math.sqrt(3) / 6), 4, "A")
"""Two stages that depend on each other, order 4, A-stable, symmetric."""
GaussLegendre3 = _collocation("GaussLegendre3", (0.5 - _R15 / 10, 0.5, 0.5 + _R15 / 10), 6, "A")
"""Three stages that depend on each other, order 6, A-stable, symmetric."""
RadauIIA2 = _collocation("RadauIIA2", (1 / 3, 1.0), 3, "L")
"""Two stages that depend on each other, order 3, L-stable."""
RadauIIA3 = _collocation("RadauIIA3", ((4 - _R6) / 10, (4 + _R6) / 10, 1.0), 5, "L")
"""Three stages that depend on each other, order 5, L-stable."""

#: Implicit schemes by name.
IMPLICIT: dict[str, ButcherTableau] = {
    t.name: t
    for t in (
        *(ImplicitEuler, ImplicitMidpoint, SDIRK2, SDIRK3, ESDIRK3),
        *(GaussLegendre2, GaussLegendre3, RadauIIA2, RadauIIA3),
    )
}
