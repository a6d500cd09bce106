"""The header of a package of derivatives declares sizes, structs and functions, which Python reads from here."""

from __future__ import annotations

from nmpc_codegen.decisions.dimensions import dimensions
from nmpc_codegen.derivatives.derivative_model import DerivativeModel
from nmpc_codegen.ir.cmodule import Macro, Setting
from nmpc_codegen.ir.sweep import LoopedRoutine
from nmpc_codegen.package.features import KERNELS
from nmpc_codegen.package.signals import Argument, EntryPoint
from nmpc_codegen.package.struct_layout import Field, Size, Struct


def macros(model: DerivativeModel) -> tuple[Macro, ...]:
    """Return the sizes that are not zero."""
    problem = model.problem
    path, terminal = problem.path, problem.terminal
    found = (
        ("N", problem.N, "intervals"),
        ("NX", problem.nx, "states"),
        ("NU", problem.nu, "controls"),
        ("NP", problem.np, "parameters"),
        ("NY", path.ny, "path residuals"),
        ("NW", path.ny if path.diagonal_weight else path.ny**2, "entries of the path weight"),
        ("NY_N", terminal.ny, "terminal residuals"),
        ("NW_N", terminal.ny if terminal.diagonal_weight else terminal.ny**2, "entries of the terminal weight"),
        ("NOUT", model.outputs, "outputs of a node"),
    )
    return tuple(Macro(name, value, doc, public=True) for name, value, doc in found if value)


def scheme_sizes(model: DerivativeModel) -> dict[str, int]:
    """Return the C macros that only interval functions use: dimensions of the scheme, flags of its stage kernels."""
    if not calls_parts(model):
        return {}
    known = {routine.name for routine in model.routines}
    has = {f"HAS_{name.upper()}": int(name in known) for name in KERNELS if name.startswith("stage_")}
    nz = {"NZ": model.problem.nx + model.problem.nu, "NALG": len(model.problem.newton_names)}
    return nz | {name: value for name, value, _ in model.integrator.sizes(dimensions(model.problem, None, True))} | has


def calls_parts(model: DerivativeModel) -> bool:
    """Return True if functions of an interval call a part."""
    return any(isinstance(r, LoopedRoutine) and r.calls_parts for r in model.routines)


def _sizes(model: DerivativeModel) -> dict[str, Size]:
    """Return every size by its text; absent sizes are 0."""
    values = dict.fromkeys(("NP", "NY", "NW", "NY_N", "NW_N", "NOUT"), 0) | {m.name: m.value for m in macros(model)}
    values |= {"1": 1, "N + 1": values["N"] + 1, "NX + NU": values["NX"] + values["NU"]}
    return {text: Size(text, value) for text, value in values.items()}


def settings(model: DerivativeModel) -> tuple[Setting, ...]:
    """Return the data with declared values: member, its table, number of copies, entries of a copy."""
    sizes = _sizes(model)
    found = (
        ("x0", "1", "NX", "initial state"),
        ("p", "N + 1", "NP", "parameters of every node"),
        ("yref", "N", "NY", "references"),
        ("yref_N", "1", "NY_N", "terminal reference"),
        ("W", "1", "NW", "weight: its diagonal, or all entries row by row"),
        ("W_N", "1", "NW_N", "terminal weight"),
    )
    return tuple(
        Setting(
            Field(name, tuple(sizes[text] for text in (copies, entries) if text != "1"), doc, "setting"),
            *(f"default_{name}", sizes[copies], sizes[entries]),
        )
        for name, copies, entries, doc in found
        if sizes[entries]
    )


def structs(model: DerivativeModel) -> tuple[Struct, ...]:
    """Return the structs in the order of their declarations."""
    size = _sizes(model)
    N, nx, nu, nodes, nz = (size[text] for text in ("N", "NX", "NU", "N + 1", "NX + NU"))

    def real(name: str, shape: tuple[Size, ...], doc: str) -> Field:
        return Field(name, shape, doc, "data")

    def struct(name: str, doc: str, *fields: Field) -> Struct:
        return Struct(name, doc, tuple(f for f in fields if all(f.shape)))

    states, jacobians = real("x", (nodes, nx), "states"), real("S", (N, nx, nz), "[A B]")
    of_nodes = Field("nodes", (), "trajectory and gradients", "data", "nodes")
    found = (
        struct(
            "data",
            "what the functions depend on; set by init, free to change",
            real("u", (N, nu), "controls"),
            *(setting.field for setting in settings(model)),
        ),
        struct(
            "trajectory",
            "a simulation",
            states,
            real("z", (N, size["NOUT"]), "outputs"),
            real("partial", (nodes,), "sum of the costs of the nodes before k"),
            real("J", (), "cost"),
        ),
        struct(
            "nodes",
            "a trajectory with the gradients of its nodes; work memory of the adjoint methods",
            states,
            real("g", (N, nz), "gradient of the cost"),
            real("g_N", (nx,), "gradient of the terminal cost"),
            real("G", (N, size["NOUT"], nz), "[C D]"),
        ),
        struct("linearization", "result of sensitivities: states and [A B] of every interval", of_nodes, jacobians),
        struct(
            "response",
            "response of all states to one control; work memory of the alternative methods",
            of_nodes,
            real("S", (nodes, nx, nu), "dx_n / du_k"),
        ),
        struct(
            "hessians",
            "states, [A B] and second derivatives of every interval",
            states,
            jacobians,
            real("H", (N, nz, nz), "d2 (lam' Phi) / d(x, u)^2"),
        ),
    )
    return found if model.second_order else found[:-1]


_DATA, _STEP = Argument("d", "data"), Argument("step", "real")
_T, _M, _S = Argument("t", "trajectory"), Argument("m", "linearization"), Argument("s", "response")
_NODES, _H = Argument("nodes", "nodes"), Argument("h", "hessians")
_OUT, _XI = Argument("g", "real", ("N", "NU")), Argument("Xi", "real", ("", "N", "NU"))
_LAM = Argument("lam", "real", ("N * NX",))
_ROWS = (Argument("rows", "int", ("",)), Argument("n_rows", "int"))

_GRADIENT = (
    EntryPoint("simulate", "Simulate states, outputs and cost of the controls.", (_DATA,), (_T,)),
    EntryPoint("sensitivities", "Compute states and [A B] of every interval, Algorithm 6.7.", (_DATA,), (_M,)),
    EntryPoint(
        "sensitivities_alternative",
        "Compute dx_n / du_k of all n for one k, Algorithm 6.8; BAD_INDEX unless 0 <= k < N.",
        (_DATA, Argument("k", "int")),
        (_S,),
    ),
    EntryPoint(
        "gradient_finite_differences",
        "Compute g[k][j] = dJ / du_k[j] by simulations with u_k[j] + step max(1, |u_k[j]|), Algorithm 6.1; "
        "t receives the simulation of the given controls. BAD_ARGUMENT for a step below the machine epsilon.",
        (_DATA, _STEP),
        (_T, _OUT),
    ),
    EntryPoint(
        "gradient_forward",
        "Compute g by the forward method, Algorithm 6.2; m is the result of sensitivities.",
        (_DATA,),
        (_M, _OUT),
    ),
    EntryPoint(
        "gradient_adjoint",
        "Compute g by the adjoint method, Algorithm 6.3 with products instead of matrices; nodes is work memory.",
        (_DATA,),
        (_NODES, _OUT),
    ),
    EntryPoint(
        "gradient_adjoint_matrices",
        "Compute g by the adjoint method, Algorithm 6.3 with matrices; m is the result of sensitivities.",
        (_DATA,),
        (_M, _OUT),
    ),
    EntryPoint(
        "gradient_alternative",
        "Compute g by the alternative integration, Algorithms 6.8 and 6.9; s is work memory.",
        (_DATA,),
        (_S, _OUT),
    ),
)
_IMPULSE_RESPONSE = (
    EntryPoint(
        "impulse_response_finite_differences",
        "Compute Xi[n * NOUT + i][k][j] = dz_n[i] / du_k[j] by simulations, Algorithm 6.4; see "
        "gradient_finite_differences.",
        (_DATA, _STEP),
        (_T, _XI),
    ),
    EntryPoint(
        "impulse_response_forward",
        "Compute Xi by the forward method, Algorithm 6.5; m is the result of sensitivities.",
        (_DATA,),
        (_M, _XI),
    ),
    EntryPoint(
        "impulse_response_adjoint",
        "Compute n_rows rows of Xi by the adjoint method, Algorithm 6.6 with products instead of matrices; nodes is "
        "work memory. Each of rows is n * NOUT + i, else BAD_INDEX.",
        (_DATA, *_ROWS),
        (_NODES, _XI),
    ),
    EntryPoint(
        "impulse_response_adjoint_matrices",
        "Compute n_rows rows of Xi by the adjoint method, Algorithm 6.6 with matrices; m is as for gradient_forward.",
        (_DATA, *_ROWS),
        (_M, _XI),
    ),
    EntryPoint(
        "impulse_response_alternative",
        "Compute Xi by the alternative integration, Algorithms 6.8 and 6.10; s is work memory.",
        (_DATA,),
        (_S, _XI),
    ),
)
_HESSIANS = (
    EntryPoint(
        "hessians_symmetric",
        "Compute h->H[k] = d2 (lam_k' Phi(x_k, u_k, p_k)) / d(x, u)^2, lam_k = lam[k * NX], with states and "
        "[A B], by three symmetric sweeps over every interval.",
        (_DATA, _LAM),
        (_H,),
    ),
    EntryPoint(
        "hessians_forward_over_adjoint",
        "Compute h->H, states and [A B] like hessians_symmetric, by the forward mode over the adjoint.",
        (_DATA, _LAM),
        (_H,),
    ),
)


def functions(model: DerivativeModel) -> tuple[EntryPoint, ...]:
    """Return all entry points except init."""
    outputs = _IMPULSE_RESPONSE if model.outputs else ()
    return (*_GRADIENT, *outputs, *(_HESSIANS if model.second_order else ()))
