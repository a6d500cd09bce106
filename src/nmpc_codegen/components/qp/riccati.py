"""Python side of the Riccati recursion (templates/riccati) that the Riccati QP solvers share: struct, sizes, counts.

M_k = Q_k + diag(diagonal) + sum_m weight_m a_m a_m' + S_k'P_{k+1}S_k,   K = -M_uu^{-1} M_ux,   P_k = M_xx + M_ux'K
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmpc_codegen.ir.cmodule import Field, Size, Struct
from nmpc_codegen.ir.kernel import OpCount

if TYPE_CHECKING:
    from nmpc_codegen.components.base import Dims

#: Rows of a product that are computed together.
BLOCK = 4


def _padded(n: int) -> int:
    return -(-n // BLOCK) * BLOCK


def riccati_sizes(dims: Dims) -> tuple[tuple[str, int, str], ...]:
    """Leading dimensions: (macro without prefix, value, meaning)."""
    nx, nus = dims.nxs.value, dims.nus.value
    return (
        ("LDX", _padded(nx), "NXS rounded up to 4"),
        ("LDU", _padded(nus), "NUS rounded up to 4"),
        ("LDZ", _padded(nx + nus), "NZS rounded up to 4"),
        ("LDW", _padded(nx + _padded(nus)), "NXS + LDU rounded up to 4"),
        ("LDT", max(_padded(nx), nx + nus), "rows of the stage product: LDX or NZS"),
    )


def riccati_struct(dims: Dims) -> Struct:
    """The struct ``riccati`` of the solver: data, factors, right-hand sides."""
    ldx, ldu, ldz, ldw, ldt = (Size(name, value) for name, value, _ in riccati_sizes(dims))
    stages, nodes = dims.ns, Size(f"{dims.ns.text} + 1", dims.ns.value + 1)
    return Struct(
        "riccati",
        "Riccati recursion on the stage QP",
        (
            Field("diagonal", (nodes, dims.nzs), "added to the diagonal of Q_k", "scratch"),
            Field("weight", (dims.ng,), "of a a' for the rows of the QP", "scratch"),
            Field("g", (nodes, dims.nzs), "gradient", "scratch"),
            Field("b", (stages, dims.nxs), "gaps of the dynamics", "scratch"),
            Field("du", (dims.nv,), "values of the fixed controls", "scratch"),
            Field("proximal", (stages, dims.nus), "added to pivots of M_uu that may be zero", "scratch"),
            Field("proximal_free", (dims.nf,), "added to pivots of P_0", "scratch"),
            Field("regularize_zero", (), "the least that is added", "scratch"),
            Field("shift", (), "last shift that made the Hessian convex, in its units", "keep"),
            Field("hold", (), "last hold on the controls of a working set, likewise", "keep"),
            Field("P", (nodes, ldx, ldx), "cost to go, symmetric", "scratch"),
            Field("M", (stages, ldu, ldz), "rows of the controls of M_k", "scratch"),
            Field("L", (stages, dims.nus, dims.nus), "M_uu = L D L'", "scratch"),
            Field("inverse", (stages, dims.nus), "1 / D", "scratch"),
            Field("K", (stages, dims.nus, ldx), "feedback", "scratch"),
            Field("F", (dims.nf, dims.nf), "L, D of P_0 for the free components of x_0", "scratch"),
            Field("p", (nodes, ldx), "linear part of the cost to go", "scratch"),
            Field("h", (stages, dims.nus), "gradient of the controls at z = 0", "scratch"),
            Field("feed", (stages, dims.nus), "controls at x = 0", "scratch"),
            Field("W", (ldt, ldw), "S_k, then -D^{-1}V", "scratch"),
            Field("T", (ldt, ldz), "P_{k+1}S_k, then V", "scratch"),
            Field("fixed", (dims.nv,), "1: the control is given", "scratch", "int32"),
            Field("regularize", (), "1: add to pivots that may be zero; 0: fail", "scratch", "int32"),
            Field("failed", (), "stage whose pivot was not positive; -1: x_0", "scratch", "int32"),
        ),
    )


def units_struct(dims: Dims) -> Struct:
    """The struct ``units`` of the solver: (a_c'H^{-1}a_c)^{1/2} of every row, and what it is computed with."""
    sizes = {name: Size(name, value) for name, value, _ in riccati_sizes(dims)}
    ldx, ldu = sizes["LDX"], sizes["LDU"]
    rows = Size(f"{dims.nv.text} + {dims.ng.text}", dims.nv.value + dims.ng.value)
    return Struct(
        "units",
        "units of the rows of the stage QP",
        (
            Field("reach", (rows,), "how far one half unit of cost moves a row", "keep"),
            Field("covariance", (ldx, ldx), "of the states of a stage under unit noise", "scratch"),
            Field("product", (ldx, ldx), "covariance times (A + B K)'", "scratch"),
            Field("closed", (ldx, ldx), "(A + B K)'", "scratch"),
            Field("push", (ldu, ldx), "(B G)'", "scratch"),
            Field("noise", (ldu, dims.nus), "G', G G' = M_uu^{-1}", "scratch"),
        ),
    )


def riccati_cost(dims: Dims) -> dict[str, OpCount]:
    """Operations of one recursion, one backward and one forward substitution over all stages.

    No row has a weight, no control is fixed, no pivot is regularised, and the dynamics have gaps.
    """
    ns, nx, nus, nf = (size.value for size in (dims.ns, dims.nxs, dims.nus, dims.nf))
    ldx, nz = _padded(nx), nx + nus
    backward = _combined(ldx, nx) + _combined(nz, nx) + _combined(ldx, nus)
    backward += OpCount(add=1, mul=1) * (nus * (nus - 1)) + OpCount(mul=nus)
    forward = (_dot(ldx) + OpCount(add=1)) * nus + (_dot(nz) + OpCount(add=1)) * nx
    pairs = nf * (nf - 1) // 2
    free = OpCount(add=nf, div=nf) + _dot(nx) * nf + OpCount(add=1, mul=1) * (2 * pairs)
    return {
        "riccati_factorize": _stage_recursion(nx, nus) * ns + OpCount(add=nx) + _free_factor(nf),
        "riccati_backward": backward * ns,
        "riccati_forward": forward * ns + free,
    }


def _stage_recursion(nx: int, nus: int) -> OpCount:
    ldx, ldz = _padded(nx), _padded(nx + nus)
    total = OpCount(add=nx + nus)
    total += _block(ldz, nx) * (ldx // BLOCK + -(-nus // BLOCK))
    for i in range(0, ldx, BLOCK):
        total += _block(i + BLOCK, nx + nus)
    for column in range(nus):
        total += OpCount(add=1, mul=1 + ldx, div=1)
        for row in range(column + 1, nus):
            total += OpCount(mul=1) + OpCount(add=1, mul=1) * (row - column + 2 * ldx)
    return total


def _free_factor(nf: int) -> OpCount:
    total = OpCount(mul=nf, div=nf * (nf - 1) // 2)
    for column in range(nf):
        total += OpCount(add=1, mul=2) * (column * (nf - column))
    return total


def _block(width: int, n: int) -> OpCount:
    """Four rows of a product of n terms each."""
    return OpCount(add=BLOCK * width * (n + 1), mul=BLOCK * width * n)


def _combined(width: int, n: int) -> OpCount:
    """A row plus a combination of n rows."""
    return OpCount(add=width * (n + 1), mul=width * n)


def _dot(n: int) -> OpCount:
    """A scalar product in partial sums."""
    return OpCount(add=n + 8, mul=n)
