"""The types of CasADi under one set of names: the only place that says which of its symbols are used."""

from __future__ import annotations

from typing import TypeAlias, cast

import casadi as ca

#: A symbolic scalar, vector or matrix.
Expression: TypeAlias = ca.SX

#: A program from expressions to expressions.
Function: TypeAlias = ca.Function

#: Where a matrix may have entries that are not zero.
Sparsity: TypeAlias = ca.Sparsity


def elements(matrix: Expression) -> list[Expression]:
    """All entries, column by column; CasADi declares a type for them that it does not have."""
    return cast("list[Expression]", matrix.elements())


def nonzeros(matrix: Expression) -> list[Expression]:
    """Entries that are not structurally zero, column by column."""
    return cast("list[Expression]", matrix.nonzeros())
