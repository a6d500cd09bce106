"""The Riccati QP solvers share structs, sizes and operation counts of the Riccati recursion (templates/riccati).

M_k = Q_k + diag(0, diagonal) + sum_m weight_m a_m a_m' + S_k'P_{k+1}S_k,   K = -M_uu^{-1} M_ux,   P_k = M_xx + M_ux'K
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.struct_layout import Field, Size, Struct, only_if

if TYPE_CHECKING:
    from nmpc_codegen.components.base import Dims

#: Number of rows of a product that are computed together.
BLOCK = 4


def _pad(n: int, dims: Dims) -> int:
    return -(-n // dims.multiple) * dims.multiple


def riccati_sizes(dims: Dims) -> tuple[tuple[str, int, str], ...]:
    """Return the leading dimensions: (macro without prefix, value, meaning)."""
    nx, nus = dims.nx, dims.nu
    ldx, ldu = _pad(nx, dims), _pad(nus, dims)
    rounded = "" if dims.multiple == 1 else f" rounded up to {dims.multiple}"
    return (
        ("LDX", ldx, f"NX{rounded}"),
        ("LDU", ldu, f"NU{rounded}"),
        ("LDZ", _pad(nx + nus, dims), f"NZ{rounded}"),
        ("LDW", _pad(nx + ldu, dims), f"NX + LDU{rounded}"),
        ("LDT", max(ldx, nx + nus), "rows of the stage product: LDX or NZ"),
    )


def riccati_structs(
    dims: Dims, scratch: tuple[Field, ...] = (), corrected: tuple[Field, ...] = ()
) -> tuple[Struct, ...]:
    """Return the struct ``riccati`` of the solver, data and factors of the recursion, and the structs that it contains.

    Its member ``work`` is a union of a stage of the factorisation, the vectors of a substitution, and ``scratch``,
    which neither of them reads. ``corrected`` holds fields for the correction of a minimiser beside the vectors.
    """
    ldx, ldu, ldz, _, _ = (Size(name, value) for name, value, _ in riccati_sizes(dims))
    stages, nodes = dims.N, dims.nodes
    return (
        *_work(dims, scratch, corrected),
        Struct(
            "riccati",
            "Riccati recursion on the stage QP",
            (
                Field("diagonal", (stages, dims.nu), "term added to the diagonal of M_uu", "scratch"),
                Field("diagonal_free", (dims.nf,), "term added to the diagonal of P_0", "scratch"),
                Field("weight", (dims.ng,), "weights of a a' for the rows of the QP", "scratch"),
                Field("b", (stages, dims.nx), "gaps of the dynamics", "scratch"),
                Field("du", (dims.qp.nv,), "values of the fixed controls", "scratch"),
                Field("P", (nodes, ldx, ldx), "cost to go, symmetric", "scratch"),
                Field("M", (stages, ldu, ldz), "rows of the controls of M_k", "scratch"),
                Field("L", (stages, dims.nu, dims.nu), "M_uu = L D L', 1 / D on the diagonal", "scratch"),
                Field("K", (stages, dims.nu, ldx), "feedback matrix K_k", "scratch"),
                Field("F", (dims.nf, dims.nf), "L, D of P_0 for the free components of x_0", "scratch"),
                Field("p", (nodes, ldx), "linear part of the cost to go", "scratch"),
                Field("h", (stages, dims.nu), "gradient of the controls at z = 0", "scratch"),
                Field("feed", (stages, dims.nu), "feed = controls at x = 0", "scratch"),
                Field("work", (), "memory of one phase", "scratch", "riccati_work"),
                Field("regularize_zero", (), "least value added to a pivot that may be zero", "scratch"),
                Field(
                    *(
                        "held",
                        (dims.ng,),
                        "weights of a a' that belong to the Hessian: rows that make it convex",
                        "data",
                    ),
                    only=lambda f: f.regularize_reduced,
                ),
                Field(
                    *("unit", (dims.nz,), "curvature that is typical of each variable", "scratch"),
                    only=lambda f: f.regularize_reduced,
                ),
                Field(
                    "shift", (), "last shift that made the Hessian convex", "keep", only=lambda f: f.regularize_reduced
                ),
                Field("fixed", (dims.qp.nv,), "1: the control is fixed", "scratch", "int32"),
                Field("raised", (nodes,), "1: a pivot of the stage was raised; last: of x_0", "scratch", "int32"),
                Field("regularize", (), "1: add to pivots that may be zero; 0: fail", "scratch", "int32"),
                Field("failed", (), "stage with a pivot that was not positive; -1: x_0", "scratch", "int32"),
            ),
        ),
    )


def _work(dims: Dims, scratch: tuple[Field, ...], corrected: tuple[Field, ...]) -> tuple[Struct, ...]:
    """Return the union ``riccati_work``, after the structs that are its members."""
    ldz, ldw, ldt = (Size(name, value) for name, value, _ in riccati_sizes(dims)[2:])
    nodes = dims.nodes
    return (
        Struct(
            "recursion",
            "one stage of the factorisation",
            (
                Field("W", (ldt, ldw), "S_k, later -D^{-1}V", "scratch"),
                Field("T", (ldt, ldz), "P_{k+1}S_k, later V", "scratch"),
            ),
        ),
        Struct(
            "direction",
            "minimiser that the recursion yields for residuals as its right-hand side",
            (
                Field("dx", (nodes, dims.nx), "states", "scratch"),
                Field("du", (dims.qp.nv,), "controls", "scratch"),
            ),
        ),
        Struct(
            "rhs",
            "gradient, which is read before the direction is written",
            (
                Field("g", (nodes, dims.nz), "gradient", "scratch"),
                Field("direction", (), "direction that belongs to this gradient", "scratch", "direction"),
            ),
            union=True,
        ),
        Struct(
            "vectors",
            "vectors of a substitution",
            (Field("rhs", (), "gradient, later direction", "scratch", "rhs"), *corrected),
        ),
        Struct(
            "riccati_work",
            "memory of phases that do not overlap",
            (
                Field("recursion", (), "while a stage is factorised", "scratch", "recursion"),
                Field("vectors", (), "while vectors are substituted", "scratch", "vectors"),
                *scratch,
            ),
            union=True,
        ),
    )


def units_structs(dims: Dims) -> tuple[tuple[Struct, ...], Field]:
    """Return the struct ``units`` of the solver, which holds (a_c'H^{-1}a_c)^{1/2} of every row, and a field.

    The struct ``noise`` is memory for this computation; the field places it in the recursion's scratch.
    """
    sizes = {name: Size(name, value) for name, value, _ in riccati_sizes(dims)}
    ldx, ldu = sizes["LDX"], sizes["LDU"]
    rows = dims.constraints
    structs = (
        Struct(
            "noise",
            "a stage under unit noise",
            (
                Field("covariance", (ldx, ldx), "covariance of the states", "scratch"),
                Field("product", (ldx, ldx), "covariance times (A + B K)'", "scratch"),
                Field("closed", (ldx, ldx), "(A + B K)'", "scratch"),
                Field("push", (ldu, ldx), "(B G)'", "scratch"),
                Field("gain", (ldu, dims.nu), "G', G G' = M_uu^{-1}", "scratch"),
            ),
        ),
        Struct(
            "units",
            "units of the rows of the stage QP",
            (Field("reach", (rows,), "distance by which half a unit of cost moves a row", "keep"),),
        ),
    )
    return structs, Field("noise", (), "while units of the rows are computed", "scratch", "noise")


def stage_qp_fields(dims: Dims) -> tuple[Field, ...]:
    """Return bounds, penalties and results, which every solver of the stage QP has in its struct ``qp``."""
    nv, ng = dims.qp.nv, dims.ng
    rows = dims.constraints
    nodes = dims.nodes
    doc = "if INFEASIBLE: weights of a contradiction"
    certificate = (Field("certificate", (rows,), doc, "result", only=lambda f: f.interior_point),)
    return (
        Field("lower", (rows,), "lower bounds of controls, then of rows", "scratch"),
        Field("upper", (rows,), "upper bounds", "scratch"),
        Field("penalty", (ng,), "l1 penalty of violating a row; infinite: hard", "keep"),
        Field("curvature", (ng,), "l2 penalty", "keep"),
        Field("x", (nodes, dims.nx), "minimiser: states", "result"),
        Field("z", (nv,), "minimiser: controls", "result"),
        Field("mult", (rows,), "multipliers, > 0 at the upper bound, < 0 at the lower", "result"),
        *only_if(ng, *certificate),
        Field(
            "least", (), "least magnitude of a row in units of its reach", "scratch", only=lambda f: f.interior_point
        ),
        Field("side", (rows,), "+-1: at the upper, lower bound; +-2: soft, violated; else 0", "keep", "int32"),
        Field("iterations", (), "iterations, or changes of the working set, of the last qp_solve", "result", "int32"),
        Field("changes", (), "rows that became active or inactive in the last qp_solve", "result", "int32"),
        Field("dropped", (), "equalities left out as redundant", "result", "int32"),
        Field("relaxed", (), "soft rows that are violated", "result", "int32"),
    )


def riccati_cost(dims: Dims) -> dict[str, OpCount]:
    """Count one recursion, one backward and one forward substitution over all stages.

    The counts are for dynamics with gaps, if no row has a weight, no control is fixed and no pivot is regularised.
    """
    ns, nx, nus, nf = dims.N, dims.nx, dims.nu, dims.nf
    ldx, nz = _pad(nx, dims), nx + nus
    backward = _combination(ldx, nx) + _combination(nz, nx) + _combination(ldx, nus)
    backward += OpCount(add=1, mul=1) * (nus * (nus - 1)) + OpCount(mul=nus)
    forward = (_dot(ldx) + OpCount(add=1)) * nus + (_dot(nz) + OpCount(add=1)) * nx
    pairs = nf * (nf - 1) // 2
    free = OpCount(add=nf, div=nf) + _dot(nx) * nf + OpCount(add=1, mul=1) * (2 * pairs)
    return {
        "riccati_factorize": _stage_recursion(dims) * ns + _free_factor(nf),
        "riccati_backward": backward * ns,
        "riccati_forward": forward * ns + free,
    }


def riccati_search(dims: Dims) -> OpCount:
    """Estimate a search by ten interior point iterations, typical if a working set is far from the predicted one.

    A row takes about 40 operations of each kind, its products with a point, and its products with itself.
    """
    counts, nz = riccati_cost(dims), dims.nz
    iteration = counts["riccati_factorize"] + (counts["riccati_backward"] + counts["riccati_forward"]) * 2
    iteration += OpCount(add=40, mul=40) * dims.qp.nv
    iteration += OpCount(add=1, mul=1) * (40 + 4 * nz + nz * nz) * dims.ng
    return iteration * 10


def _stage_recursion(dims: Dims) -> OpCount:
    nx, nus = dims.nx, dims.nu
    ldx, ldu, ldz = (value for _, value, _ in riccati_sizes(dims)[:3])
    total = OpCount(add=nus)
    total += _entries((ldx + ldu) * ldz, nx)
    for i in range(0, ldx, BLOCK):
        end = min(i + BLOCK, ldx)
        total += _entries((end - i) * end, nx + nus)
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


def _entries(number: int, n: int) -> OpCount:
    """Count entries of a product with n terms each."""
    return OpCount(add=number * (n + 1), mul=number * n)


def _combination(width: int, n: int) -> OpCount:
    """Count a row plus a linear combination of n rows."""
    return OpCount(add=width * (n + 1), mul=width * n)


def _dot(n: int) -> OpCount:
    """Count a scalar product that is computed in partial sums."""
    return OpCount(add=n + 8, mul=n)
