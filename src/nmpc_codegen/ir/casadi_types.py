"""The types of CasADi under one set of names: the only place that says which of its symbols are used."""

from __future__ import annotations

from typing import TypeAlias

import casadi as ca

#: A symbolic scalar, vector or matrix.
Expression: TypeAlias = ca.SX

#: A program from expressions to expressions.
Function: TypeAlias = ca.Function

#: Where a matrix may have entries that are not zero.
Sparsity: TypeAlias = ca.Sparsity
