"""Algebraic equations and implicit dynamics are solved by expressions as far as possible.

    0 = r(v; x, u, p),   v: algebraic variables, and derivatives of states that dynamics() does not give

A permutation brings dr/dv to block triangular form (Duff and Reid, ACM Trans. Math. Softw. 4, 1978). A block that is
linear in its own variables is eliminated. The variables of all other blocks are left to Newton's method, which solves
their equations together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.algebra import newton
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.frontend.statement import Equation
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.package.signals import list_some

#: A pivot below this value, relative to the largest entry of its row, is a rounding error.
SINGULAR = 1e-12
#: Size of a variable that starts at 0; least pivot relative to its row; most unknowns that are solved by determinants.
SMALL, DETERMINANTS = 1e-3, 3


@dataclass(frozen=True, eq=False)
class Unknown:
    """An unknown is a scalar v_i that the equations determine."""

    symbol: Any
    name: str
    initial: float


@dataclass(frozen=True, eq=False)
class Solved:
    """The result of the elimination has expressions and the remaining equations.

    values: every unknown, in the given symbols and those of ``newton``; newton: indices of the unknowns that Newton's
    method solves for; rest: their equations; inverse: 1 where the inverse of their Jacobian may be nonzero; at: values
    of all unknowns at the first plan, NaN where Newton's method finds none.
    """

    values: tuple[Any, ...]
    newton: tuple[int, ...]
    rest: Any
    inverse: Array
    at: Array


def solve_equations(
    unknowns: Sequence[Unknown], equations: Sequence[Equation], given: Sequence[tuple[Any, Array]], moving: Any
) -> Solved:
    """Eliminate the linear blocks of equations.

    ``given`` holds the other symbols with their values at the first plan; ``moving`` those of them that are no
    parameters.

    Raises:
        ProblemError: there are more or fewer equations than unknowns, or the equations do not determine the unknowns
            (index 2).
    """
    _check_count(unknowns, equations)
    v, r = ca.vertcat(*(each.symbol for each in unknowns)), ca.vertcat(*(e.expression for e in equations))
    pattern = ca.sparsify(ca.jacobian(r, v)).sparsity()
    matched = _match(pattern)
    if len(matched) < len(unknowns):
        raise ProblemError(_describe_structure(pattern, matched, unknowns, equations))
    values: list[Any] = [each.symbol for each in unknowns]
    unsolved: list[int] = []
    left: list[int] = []
    at = np.array([each.initial for each in unknowns])
    for rows, columns in _blocks(pattern):
        block = ca.substitute(r[rows], v, ca.vertcat(*values))
        own = v[columns]
        here, rows_of = [unknowns[c] for c in columns], [equations[i] for i in rows]
        slopes = _slopes(block, own, v, given, at)
        _check_pivots(slopes, here, rows_of)
        J = ca.jacobian(block, own)
        if not ca.depends_on(J, own):
            right = -ca.substitute(block, own, ca.SX.zeros(len(columns)))
            found = _solve_linear(J, right, slopes, ca.vertcat(v, moving))
            for place, value in zip(columns, ca.vertsplit(found), strict=True):
                values[place] = value
        else:
            unsolved += columns
            left += rows
        at[columns] = _solve_here(block, own, v, given, at, columns)
        _check_pivots(_slopes(block, own, v, given, at), here, rows_of)
    rest = ca.substitute(r[left], v, ca.vertcat(*values)) if left else ca.SX(0, 1)
    inverse = _inverse_pattern(ca.sparsify(ca.jacobian(rest, v[unsolved])).sparsity()) if left else np.zeros((0, 0))
    return Solved(tuple(values), tuple(unsolved), rest, inverse, at)


def _check_count(unknowns: Sequence[Unknown], equations: Sequence[Equation]) -> None:
    if len(unknowns) != len(equations) or not unknowns:
        names, of = list_some([each.name for each in unknowns]), list_some([e.name for e in equations]) or "none"
        raise ProblemError(
            f"{len(equations)} algebraic equations ({of}) for {len(unknowns)} variables ({names}); expected one scalar "
            "equation per variable: ocp.algebraic_equation(g), or ocp.implicit_dynamics(f) for derivatives"
        )


# Structure -----------------------------------------------------------------------------------------------------------


def _match(pattern: Any) -> dict[int, int]:
    """Return a maximum matching {column: row}, found by augmenting paths."""
    n = pattern.size2()
    rows: list[list[int]] = [[] for _ in range(n)]
    for i, j in zip(*pattern.get_triplet(), strict=True):
        rows[j].append(i)
    of_row: dict[int, int] = {}

    def augment(j: int, seen: set[int]) -> bool:
        for i in rows[j]:
            if i not in seen:
                seen.add(i)
                if i not in of_row or augment(of_row[i], seen):
                    of_row[i] = j
                    return True
        return False

    for j in range(n):
        augment(j, set())
    return {j: i for i, j in of_row.items()}


def _inverse_pattern(pattern: Any) -> Array:
    """Return 1 in (j, i) where unknown j may depend on residual i.

    Unknown j depends on residual i if a path over equations and unknowns connects them.
    """
    matched, size = _match(pattern), pattern.size2()
    if len(matched) < size:
        return np.ones((size, size))
    rows = [matched[j] for j in range(size)]
    reach = np.asarray(ca.DM(pattern, 1.0))[rows] > 0
    for _ in range(size.bit_length()):
        reach = reach @ reach | reach
    return np.asarray(reach[:, np.argsort(rows)], dtype=float)


def _describe_structure(
    pattern: Any, matched: dict[int, int], unknowns: Sequence[Unknown], equations: Sequence[Equation]
) -> str:
    """Describe which variable has no equation of its own, and which equation remains."""
    j = next(j for j in range(len(unknowns)) if j not in matched)
    extra = next(e.name for i, e in enumerate(equations) if i not in matched.values())
    entries = list(zip(*pattern.get_triplet(), strict=True))
    where = [equations[i].name for i, column in entries if column == j]
    occurs = f"occurs in {list_some(where)} alone, which determine others" if where else "occurs in no equation"
    return (
        f"'{unknowns[j].name}' {occurs}, and '{extra}' determines nothing new: index 2 or higher; differentiate "
        f"'{extra}' with respect to time until it contains '{unknowns[j].name}', and state that instead"
    )


def _blocks(pattern: Any) -> Iterator[tuple[list[int], list[int]]]:
    """Yield (rows, columns) of the diagonal blocks, in an order in which each depends only on earlier ones."""
    count, row, column, first, first_column, *_ = pattern.btf()
    blocks = [
        (sorted(row[first[b] : first[b + 1]]), sorted(column[first_column[b] : first_column[b + 1]]))
        for b in range(count)
    ]
    needs: dict[int, set[int]] = {}
    for i, j in zip(*pattern.get_triplet(), strict=True):
        needs.setdefault(i, set()).add(j)
    known: set[int] = set()
    while blocks:
        ready = next(b for b in blocks if set().union(*(needs[i] for i in b[0])) <= known | set(b[1]))
        blocks.remove(ready)
        known |= set(ready[1])
        yield ready


# Linear blocks -------------------------------------------------------------------------------------------------------


def _check_pivots(J: Array, unknowns: Sequence[Unknown], equations: Sequence[Equation]) -> None:
    """Raise ProblemError if the equations of a block do not determine its variables at the first plan."""
    rows = list(range(len(J)))
    if not np.all(np.isfinite(J)):
        return
    A = J / np.where((size := np.max(np.abs(J), axis=1, keepdims=True)) > 0, size, 1.0)
    for j in rows.copy():
        best = j + int(np.argmax(np.abs(A[j:, j])))
        if abs(A[best, j]) <= SINGULAR:
            raise ProblemError(
                f"'{unknowns[j].name}' is not determined at the first plan: the derivatives of "
                f"{', '.join(repr(equations[i].name) for i in rows[j:])} with respect to it are 0 there, or those with "
                "respect to other variables make up for them: index 2, or a singular point; differentiate such an "
                "equation with respect to time, or give other initial= values"
            )
        A[[j, best]], rows[j], rows[best] = A[[best, j]], rows[best], rows[j]
        A[j + 1 :] -= np.outer(A[j + 1 :, j] / A[j, j], A[j])


def _solve_linear(J: Expression, right: Expression, at: Array, moving: Expression) -> Expression:
    """Return J^-1 right without pivots that may vanish along a plan.

    Pivots are entries that do not change along a plan. The remaining equations are solved by determinants for up to
    three unknowns, else by Householder reflections. ``at`` is J at the first plan.
    """
    n = J.shape[0]
    rows = [{j: J[i, j] for j in range(n) if J[i, j].nnz()} for i in range(n)]
    values = [right[i] for i in range(n)]
    pivots: list[tuple[int, int]] = []
    at = at.copy()
    while found := _fixed_pivot(rows, pivots, at, moving):
        i, j = found
        pivots.append(found)
        for k in (k for k in range(n) if k not in [row for row, _ in pivots] and j in rows[k]):
            factor = rows[k].pop(j) / rows[i][j]
            for c, value in rows[i].items():
                if c != j:
                    rows[k][c] = rows[k].get(c, ca.SX(0)) - factor * value
            values[k] = values[k] - factor * values[i]
            at[k] -= at[k, j] / at[i, j] * at[i]
    left = [i for i in range(n) if i not in [row for row, _ in pivots]]
    columns = [j for j in range(n) if j not in [column for _, column in pivots]]
    solution: dict[int, Any] = {}
    if left:
        rest = ca.vertcat(*(ca.horzcat(*(rows[i].get(j, ca.SX(0)) for j in columns)) for i in left))
        solution = dict(zip(columns, _solve_moving(rest, [values[i] for i in left]), strict=True))
    for i, j in reversed(pivots):
        known = sum((value * solution[c] for c, value in rows[i].items() if c != j), ca.SX(0))
        solution[j] = (values[i] - known) / rows[i][j]
    return ca.SX(ca.vertcat(*(solution[j] for j in range(n))))


def _fixed_pivot(
    rows: Sequence[dict[int, Any]], pivots: Sequence[tuple[int, int]], at: Array, moving: Expression
) -> tuple[int, int] | None:
    """Return (row, column) of an entry that is constant along a plan and not small at the first plan.

    The entry lies in the row and column with the fewest other entries.
    """
    used = [{row for row, _ in pivots}, {column for _, column in pivots}]
    active = {(i, j) for i, row in enumerate(rows) if i not in used[0] for j in row if j not in used[1]}
    counts = [Counter(pair[n] for pair in active) for n in (0, 1)]
    for i, j in sorted(active, key=lambda pair: (counts[0][pair[0]] - 1) * (counts[1][pair[1]] - 1)):
        largest = np.max(np.abs(at[i]), initial=0.0, where=np.isfinite(at[i]))
        if at[i, j] and abs(at[i, j]) >= SMALL * largest and not ca.depends_on(rows[i][j], moving):
            return i, j
    return None


def _solve_moving(A: Expression, b: list[Any]) -> list[Any]:
    """Return A^-1 b by determinants, or by reflections."""
    n = A.shape[0]
    if n > DETERMINANTS:
        return _reflect(A, b)
    det = ca.det(A)
    found = []
    for j in range(n):
        replaced = ca.SX(A)
        replaced[:, j] = ca.vertcat(*b)
        found.append(ca.det(replaced) / det)
    return found


def _reflect(A: Expression, b: list[Any]) -> list[Any]:
    """Return A^-1 b by the QR factorisation with Householder reflections; no pivot vanishes where A is regular.

    Source: Golub and Van Loan, Matrix Computations, section 5.2.
    """
    n = A.shape[0]
    R = [[A[i, j] for j in range(n)] + [b[i]] for i in range(n)]
    for j in range(n):
        length = ca.sqrt(sum(R[i][j] ** 2 for i in range(j, n)))
        if j == n - 1:
            break
        alpha = -ca.copysign(length, R[j][j])
        v = [R[j][j] - alpha, *(R[i][j] for i in range(j + 1, n))]
        half = length**2 - alpha * R[j][j]  # |v|^2 / 2
        for c in range(j + 1, n + 1):
            factor = sum(v[i - j] * R[i][c] for i in range(j, n)) / half
            for i in range(j, n):
                R[i][c] = R[i][c] - factor * v[i - j]
        R[j][j] = alpha
    found: list[Any] = [None] * n
    for i in reversed(range(n)):
        known = sum((R[i][c] * found[c] for c in range(i + 1, n)), ca.SX(0))
        found[i] = (R[i][n] - known) / R[i][i]
    return found


# The first plan ------------------------------------------------------------------------------------------------------


def _evaluate(block: Any, own: Any, v: Any, given: Sequence[tuple[Any, Array]], at: Array) -> tuple[Array, Array]:
    """Return residuals and Jacobian of a block at the first plan."""
    symbols = [v, *(symbol for symbol, _ in given)]
    f = ca.Function("block", symbols, [ca.densify(block), ca.densify(ca.jacobian(block, own))])
    value, J = f(at, *(value for _, value in given))
    return np.asarray(value, dtype=float).ravel(), np.asarray(J, dtype=float)


def _slopes(block: Any, own: Any, v: Any, given: Sequence[tuple[Any, Array]], at: Array) -> Array:
    return _evaluate(block, own, v, given, at)[1]


def _solve_here(
    block: Any, own: Any, v: Any, given: Sequence[tuple[Any, Array]], at: Array, columns: Sequence[int]
) -> Array:
    """Return the variables of a block at the first plan; NaN if they are not found."""

    def evaluate(found: Array) -> tuple[Array, Array]:
        point = at.copy()
        point[columns] = found
        return _evaluate(block, own, v, given, point)

    return newton.solve(evaluate, at[columns], np.maximum(np.abs(at[columns]), SMALL))
