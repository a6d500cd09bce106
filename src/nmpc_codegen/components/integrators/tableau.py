"""Butcher tableaus of explicit Runge-Kutta schemes, which validate themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from nmpc_codegen.errors import OptionError
from nmpc_codegen.ir.casadi_types import Expression

F = Fraction


@dataclass(frozen=True)
class ButcherTableau:
    """Explicit scheme X_i = x + h sum_{j<i} a_ij K_j, K_i = f(X_i), x+ = x + h sum_i b_i K_i, of the given order.

    Checked on creation: a is strictly lower triangular and the order conditions hold exactly up to min(order, 4).
    """

    name: str
    a: tuple[tuple[Fraction, ...], ...]
    b: tuple[Fraction, ...]
    order: int

    def __post_init__(self) -> None:
        s = len(self.b)
        if len(self.a) != s or any(len(row) != s for row in self.a):
            raise OptionError(f"tableau {self.name}: a must be {s} x {s}, as b has {s} entries")
        if any(self.a[i][j] for i in range(s) for j in range(i, s)):
            raise OptionError(f"tableau {self.name}: a must be strictly lower triangular (explicit scheme)")
        for order, residual in self.order_residuals():
            if order <= self.order and residual:
                raise OptionError(f"tableau {self.name}: an order condition of order {order} is off by {residual}")

    @property
    def stages(self) -> int:
        return len(self.b)

    @property
    def c(self) -> tuple[Fraction, ...]:
        """c_i = sum_j a_ij."""
        return tuple(sum(row, F(0)) for row in self.a)

    def order_residuals(self) -> list[tuple[int, Fraction]]:
        """(order, residual) of the eight order conditions up to order 4 (Hairer, Norsett, Wanner, table II.2.2)."""
        a, b, c = self.a, self.b, self.c
        s = range(len(b))

        def ac(power: int) -> list[Fraction]:
            return [sum((a[i][j] * c[j] ** power for j in s), F(0)) for i in s]

        def weigh(values: list[Fraction]) -> Fraction:
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
        ]


def combine(x: Expression, h: Expression, slopes: Sequence[Expression], coefficients: Sequence[Fraction]) -> Expression:
    """x + h sum_j c_j K_j; ``slopes`` are the K_j with nonzero c_j, and equal coefficients share a product."""
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
Midpoint = ButcherTableau("Midpoint", _fractions((), (F(1, 2),)), _values(0, 1), 2)
Heun = ButcherTableau("Heun", _fractions((), (1,)), _values(F(1, 2), F(1, 2)), 2)
SSPRK3 = ButcherTableau("SSPRK3", _fractions((), (1,), (F(1, 4), F(1, 4))), _values(F(1, 6), F(1, 6), F(2, 3)), 3)
RK4 = ButcherTableau(
    "RK4",
    _fractions((), (F(1, 2),), (0, F(1, 2)), (0, 0, 1)),
    _values(F(1, 6), F(1, 3), F(1, 3), F(1, 6)),
    4,
)

TABLEAUS: dict[str, ButcherTableau] = {t.name: t for t in (Euler, Midpoint, Heun, SSPRK3, RK4)}
