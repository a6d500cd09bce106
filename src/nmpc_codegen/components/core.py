"""The core has structs for algorithms that use them: linearised nodes, multipliers, KKT residuals."""

from __future__ import annotations

from collections.abc import Iterable

from nmpc_codegen.components.base import Core, Dims
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.tuning import COLUMNS
from nmpc_codegen.package.struct_layout import Field, Struct, only_if


def core_structs(core: Iterable[Core], dims: Dims) -> tuple[Struct, ...]:
    """Return the structs for the words in ``core``; a struct named "solver" lists further members of the solver struct.

    Structs of other words are stated as absent, for parts that name them.
    """
    wanted = set(core)
    return (
        *only_if("nodes" in wanted, _node(dims), _terminal(dims), _coupled_struct(dims), _renewal()),
        *only_if("multipliers" in wanted, _multipliers(dims)),
        *only_if("kkt" in wanted, _kkt()),
        _row_members(dims),
    )


def _node(dims: Dims) -> Struct:
    return Struct(
        "node",
        "linearisation of a path node",
        (
            Field("S", (dims.nx, dims.nz), "[A_k B_k] = d Phi / d(x, u)", "data"),
            Field("b", (dims.nx,), "gap Phi(x_k, u_k) - x_{k+1}", "data"),
            Field("g", (dims.nz,), "gradient (q_k, r_k)", "data"),
            Field("h", (dims.nh,), "general rows", "data"),
            Field("J", (dims.nh, dims.nz), "Jacobian [C_k D_k] of the general rows", "data"),
        ),
        shape=(dims.N,),
    )


def _terminal(dims: Dims) -> Struct:
    return Struct(
        "terminal",
        "linearisation of the terminal node",
        (
            Field("g", (dims.nx,), "gradient q_N", "data"),
            Field("h", (dims.nh_N,), "general rows", "data"),
            Field("J", (dims.nh_N, dims.nx), "Jacobian C_N of the general rows", "data"),
        ),
    )


def _coupled_struct(dims: Dims) -> Struct:
    return Struct(
        "coupled",
        "linearisation of the coupled rows",
        (
            Field("r", (dims.ne,), "values r(x_0, x_N)", "data"),
            Field("J_0", (dims.ne, dims.nx), "Jacobian E_0 = d r / d x_0", "data"),
            Field("J_N", (dims.ne, dims.nx), "Jacobian E_N = d r / d x_N", "data"),
        ),
    )


def _renewal() -> Struct:
    doc = "1: references are newer than the gradients, 2: so are weights or parameters"
    return Struct("solver", "", (Field("renewal", (), doc, "keep", "int32", only=lambda f: f.set_reference),))


def _multipliers(dims: Dims) -> Struct:
    nodes = dims.nodes
    return Struct(
        "solver",
        "",
        (
            Field("lam", (nodes, dims.nx), "multipliers of the dynamics; lam_0 belongs to x_0 = xhat", "iterate"),
            Field("mu_u", (dims.N, dims.nu), "multipliers of the control bounds, > 0 at the upper one", "iterate"),
            Field("mult", (dims.ng,), "multipliers of the other rows, sorted by node", "iterate"),
        ),
    )


def _row_members(dims: Dims) -> Struct:
    """Return the members that parts of the core keep about rows."""
    nodes = dims.nodes
    penalty = "l1 penalty of hard rows while a QP is relaxed, else infinite"
    left = "of the hard rows, left by the last step"
    price = "of relaxed rows on states, relative to that at the last node"
    return Struct(
        "solver",
        "",
        (
            Field("row_scale", (dims.nr,), "largest terms of the rows", "keep", only=lambda f: f.row_scales),
            Field("relaxation", (), penalty, "scratch", only=lambda f: f.relaxation),
            Field("row_residual", (), left, "keep", only=lambda f: f.nonlinear_rows),
            Field("price", (nodes,), price, "keep", only=lambda f: f.priced_rows),
        ),
        only=lambda f: f.has_qp,
    )


#: Sizes, and tables without values, that some components state and parts of other components name.
SIZES_OF_OTHERS = (
    ("NEWTON", 0, "no stages"),
    ("NEWTON_LIMIT", 0, "no stages"),
    ("COLUMNS", COLUMNS, "columns of G_k that are processed together"),
    ("MIRROR", 0, "no Hessian"),
    ("MAX_SHIFTS", 0, "no shifts of a Hessian"),
)
TABLES_OF_OTHERS = (Table("is_measured", "int", (), "1: x_0 is the measured state"),)


#: Members of packages whose integrator solves stages.
_OF_STAGES = ("newton", "failed_interval", "failed_step", "failed_stage", "failed_state")


def structs_of_others(dims: Dims) -> tuple[Struct, ...]:
    """Return members that some components state and parts of the core name."""
    return only_if(
        False,
        Struct("solver", "", tuple(Field(name, (), "", "keep", "int32") for name in _OF_STAGES)),
        Struct("node", "", (Field("left", (dims.nx,), "", "data"),), shape=(dims.N,)),
        Struct("hessian", "", tuple(Field(name, (), "", "scratch", "int32") for name in ("changed", "new_data"))),
        Struct("condensed", "", (Field("regularized", (), "", "data", "int32"),)),
        Struct("qp", "", (Field("inverse", (dims.nu,), "", "scratch"), Field("nw", (), "", "keep", "int32"))),
        Struct("qp", "", (Field("row", (dims.nu,), "", "keep", "int32"),)),
        Struct("near", "", (Field("trusted", (), "", "keep", "int32"),)),
    )


def _kkt() -> Struct:
    def real(name: str, doc: str) -> Field:
        return Field(name, (), doc, "result")

    return Struct(
        "kkt",
        "KKT residuals, largest absolute values",
        (
            real("stationarity", "gradient of the Lagrangian"),
            real("equality", "gaps of the dynamics and x_0 - xhat"),
            real("inequality", "violation of bounds and rows"),
            real("complementarity", "multiplier times distance to its bound"),
            real("relative", "the largest of all, divided by its scale + the magnitudes of the terms that it sums"),
        ),
    )
