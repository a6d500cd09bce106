"""Type aliases for CasADi objects, so that one place decides which of its symbolic types the compiler uses."""

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
    """All entries, column by column; the cast is needed because CasADi's stubs declare a type that does not exist."""
    return cast("list[Expression]", matrix.elements())


def part(vector: Expression, first: int, last: int | None = None) -> Expression:
    """Elements of a column as a column, of none (0, 1): a slice of one element of CasADi is a row."""
    return ca.vertcat(ca.SX(0, 1), *elements(vector)[first:last])


def nonzeros(matrix: Expression) -> list[Expression]:
    """Entries that are not structurally zero, column by column."""
    return cast("list[Expression]", matrix.nonzeros())


def curved_rows(h: Expression, z: Expression) -> set[int]:
    """Numbers of the elements of h that are no affine functions of z."""
    return {i for i, bent in enumerate(ca.which_depends(h, z, 2, True)) if bent} if h.numel() else set()
