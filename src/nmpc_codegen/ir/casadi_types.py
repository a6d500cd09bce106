"""Type aliases for CasADi objects decide in one place which symbolic types the compiler uses."""

from __future__ import annotations

from typing import TypeAlias, cast

import casadi as ca

#: A symbolic scalar, vector or matrix.
Expression: TypeAlias = ca.SX

#: A function from expressions to expressions.
Function: TypeAlias = ca.Function

#: The sparsity pattern of a matrix.
Sparsity: TypeAlias = ca.Sparsity


def elements(matrix: Expression) -> list[Expression]:
    """Return all entries, column by column; CasADi's stubs declare a type that does not exist, hence the cast."""
    return cast("list[Expression]", matrix.elements())


def part(vector: Expression, first: int, last: int | None = None) -> Expression:
    """Return elements of a column as a column, (0, 1) if there are none; CasADi's slice of one element is a row."""
    return ca.vertcat(ca.SX(0, 1), *elements(vector)[first:last])


def nonzeros(matrix: Expression) -> list[Expression]:
    """Return the entries that are not structurally zero, column by column."""
    return cast("list[Expression]", matrix.nonzeros())


def curved_rows(h: Expression, z: Expression) -> set[int]:
    """Return the numbers of the elements of h that are no affine functions of z."""
    return {i for i, bent in enumerate(ca.which_depends(h, z, 2, True)) if bent} if h.numel() else set()
