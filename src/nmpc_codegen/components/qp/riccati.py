"""Python side of the Riccati recursion (templates/riccati) that the Riccati QP solvers share: struct, sizes, counts.

M_k = Q_k + diag(0, diagonal) + sum_m weight_m a_m a_m' + S_k'P_{k+1}S_k,   K = -M_uu^{-1} M_ux,   P_k = M_xx + M_ux'K
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


def riccati_structs(
    dims: Dims, scratch: tuple[Field, ...] = (), corrected: tuple[Field, ...] = ()
) -> tuple[Struct, ...]:
    """The struct ``riccati`` of the solver, data and factors of the recursion, and the structs that it holds.

    Its member ``work`` is a union: a stage of the factorisation, the vectors of a substitution, and what else is read
    by neither, ``scratch``. ``corrected``: what goes with the vectors while a minimiser is corrected.
    """
    ldx, ldu, ldz, ldw, ldt = (Size(name, value) for name, value, _ in riccati_sizes(dims))
    stages, nodes = dims.ns, Size(f"{dims.ns.text} + 1", dims.ns.value + 1)
    return (
        Struct(
            "recursion",
            "one stage of the factorisation",
            (
                Field("W", (ldt, ldw), "S_k, then -D^{-1}V", "scratch"),
                Field("T", (ldt, ldz), "P_{k+1}S_k, then V", "scratch"),
            ),
        ),
        Struct(
            "direction",
            "minimiser of the recursion for residuals on its right-hand side",
            (
                Field("dx", (nodes, dims.nxs), "of the states", "scratch"),
                Field("du", (dims.nv,), "of the controls", "scratch"),
            ),
        ),
        Struct(
            "rhs",
            "the gradient is read before the direction is written",
            (
                Field("g", (nodes, dims.nzs), "gradient", "scratch"),
                Field("direction", (), "what follows from it", "scratch", "direction"),
            ),
            union=True,
        ),
        Struct(
            "vectors",
            "vectors of a substitution",
            (Field("rhs", (), "gradient, then direction", "scratch", "rhs"), *corrected),
        ),
        Struct(
            "riccati_work",
            "memory of phases that never overlap",
            (
                Field("recursion", (), "while a stage is factorised", "scratch", "recursion"),
                Field("vectors", (), "while vectors are substituted", "scratch", "vectors"),
                *scratch,
            ),
            union=True,
        ),
        Struct(
            "riccati",
            "Riccati recursion on the stage QP",
            (
                Field("diagonal", (stages, dims.nus), "added to the diagonal of M_uu", "scratch"),
                Field("diagonal_free", (dims.nf,), "added to that of P_0", "scratch"),
                Field("weight", (dims.ng,), "of a a' for the rows of the QP", "scratch"),
                Field("b", (stages, dims.nxs), "gaps of the dynamics", "scratch"),
                Field("du", (dims.nv,), "values of the fixed controls", "scratch"),
                Field("P", (nodes, ldx, ldx), "cost to go, symmetric", "scratch"),
                Field("M", (stages, ldu, ldz), "rows of the controls of M_k", "scratch"),
                Field("L", (stages, dims.nus, dims.nus), "M_uu = L D L', 1 / D on the diagonal", "scratch"),
                Field("K", (stages, dims.nus, ldx), "feedback", "scratch"),
                Field("F", (dims.nf, dims.nf), "L, D of P_0 for the free components of x_0", "scratch"),
                Field("p", (nodes, ldx), "linear part of the cost to go", "scratch"),
                Field("h", (stages, dims.nus), "gradient of the controls at z = 0", "scratch"),
                Field("feed", (stages, dims.nus), "controls at x = 0", "scratch"),
                Field("work", (), "of one phase", "scratch", "riccati_work"),
                Field("regularize_zero", (), "the least that is added to a pivot that may be zero", "scratch"),
                Field("shift", (), "last shift that made the Hessian convex", "keep", only="REGULARIZE_REDUCED"),
                Field("hold", (), "last hold on a working set's controls", "keep", only="REGULARIZE_REDUCED"),
                Field("fixed", (dims.nv,), "1: the control is given", "scratch", "int32"),
                Field("raised", (nodes,), "1: a pivot of the stage was raised, of x_0 the last", "scratch", "int32"),
                Field("regularize", (), "1: add to pivots that may be zero; 0: fail", "scratch", "int32"),
                Field("failed", (), "stage whose pivot was not positive; -1: x_0", "scratch", "int32"),
            ),
        ),
    )


def units_structs(dims: Dims) -> tuple[tuple[Struct, ...], Field]:
    """The struct ``units`` of the solver, (a_c'H^{-1}a_c)^{1/2} of every row, and what it is computed with.

    That is the struct ``noise``, which the second value puts into the scratch of the recursion.
    """
    sizes = {name: Size(name, value) for name, value, _ in riccati_sizes(dims)}
    ldx, ldu = sizes["LDX"], sizes["LDU"]
    rows = Size(f"{dims.nv.text} + {dims.ng.text}", dims.nv.value + dims.ng.value)
    structs = (
        Struct(
            "noise",
            "a stage under unit noise",
            (
                Field("covariance", (ldx, ldx), "of the states", "scratch"),
                Field("product", (ldx, ldx), "covariance times (A + B K)'", "scratch"),
                Field("closed", (ldx, ldx), "(A + B K)'", "scratch"),
                Field("push", (ldu, ldx), "(B G)'", "scratch"),
                Field("gain", (ldu, dims.nus), "G', G G' = M_uu^{-1}", "scratch"),
            ),
        ),
        Struct(
            "units",
            "units of the rows of the stage QP",
            (Field("reach", (rows,), "how far one half unit of cost moves a row", "keep"),),
        ),
    )
    return structs, Field("noise", (), "while units of the rows are computed", "scratch", "noise")


def stage_qp_fields(dims: Dims) -> tuple[Field, ...]:
    """Bounds, penalties and results: what every solver of the stage QP has in its struct ``qp``."""
    nv, ng = dims.nv, dims.ng
    rows = Size(f"{nv.text} + {ng.text}", nv.value + ng.value)
    nodes = Size(f"{dims.ns.text} + 1", dims.ns.value + 1)
    doc = "if INFEASIBLE: weights of a contradiction"
    certificate = (Field("certificate", (rows,), doc, "result", only="INTERIOR_POINT"),)
    return (
        Field("lower", (rows,), "lower bounds of controls, then of rows", "scratch"),
        Field("upper", (rows,), "upper bounds", "scratch"),
        Field("penalty", (ng,), "l1 penalty of violating a row; infinite: hard", "keep"),
        Field("curvature", (ng,), "l2 penalty", "keep"),
        Field("x", (nodes, dims.nxs), "minimiser: states", "result"),
        Field("z", (nv,), "minimiser: controls", "result"),
        Field("mult", (rows,), "multipliers, > 0 at the upper bound, < 0 at the lower", "result"),
        *(certificate if ng.value else ()),
        Field("side", (rows,), "+-1: at the upper, lower bound; +-2: soft, violated; else 0", "keep", "int32"),
        Field("iterations", (), "iterations, or changes of the working set, of the last qp_solve", "result", "int32"),
        Field("changes", (), "rows that became active or inactive in it", "result", "int32"),
        Field("dropped", (), "equalities left out as redundant", "result", "int32"),
        Field("relaxed", (), "soft rows that are violated", "result", "int32"),
    )


def riccati_cost(dims: Dims) -> dict[str, OpCount]:
    """Operations of one recursion, one backward and one forward substitution over all stages.

    No row has a weight, no control is fixed, no pivot is regularised, and the dynamics have gaps.
    """
    ns, nx, nus, nf = (size.value for size in (dims.ns, dims.nxs, dims.nus, dims.nf))
    ldx, nz, copies = _padded(nx), nx + nus, nx - dims.nx.value
    fold = OpCount(add=copies * (ldx + nx), mul=copies * ldx)
    backward = _combined(ldx, nx) + _combined(nz, nx) + _combined(ldx, nus)
    backward += OpCount(add=1, mul=1) * (nus * (nus - 1)) + OpCount(mul=nus)
    forward = (_dot(ldx) + OpCount(add=1)) * nus + (_dot(nz) + OpCount(add=1)) * nx
    pairs = nf * (nf - 1) // 2
    free = OpCount(add=nf, div=nf) + _dot(nx) * nf + OpCount(add=1, mul=1) * (2 * pairs)
    return {
        "riccati_factorize": _stage_recursion(nx, nus) * ns + fold + _free_factor(nf),
        "riccati_backward": backward * ns + OpCount(add=copies),
        "riccati_forward": forward * ns + free,
    }


def _stage_recursion(nx: int, nus: int) -> OpCount:
    ldx, ldz = _padded(nx), _padded(nx + nus)
    total = OpCount(add=nus)
    total += _block(ldz, nx) * (ldx // BLOCK + -(-nus // BLOCK))
    for i in range(0, ldx, BLOCK):
        total += _block(i + BLOCK, nx + nus)
    for column in range(nus):
        total += OpCount(add=1, mul=1 + ldx, div=1)
        for row in range(column + 1, nus):
            total += OpCount(mul=1) + OpCount(add=1, mul=1) * (row - column + 2 * ldx)
    return total


def _free_factor(nf: int) -> OpCount:
    total = OpCount(add=nf, mul=nf, div=nf * (nf - 1) // 2)
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
