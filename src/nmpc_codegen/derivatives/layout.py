"""Sizes, structs and functions of a package of derivatives: what its header declares and Python reads."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nmpc_codegen.derivatives.model import DerivativeModel

#: Size in bytes of a number.
BYTES = {"double": 8, "single": 4}


@dataclass(frozen=True)
class Member:
    """A member of a struct: an array of numbers, or a struct (``struct`` is its name)."""

    name: str
    shape: tuple[int, ...]
    macros: tuple[str, ...]
    doc: str
    struct: str = ""

    @property
    def count(self) -> int:
        """Numbers of an array."""
        return math.prod(self.shape)

    @property
    def length(self) -> str:
        """C text of the number of numbers of an array of one or two dimensions."""
        return " * ".join(f"({m})" if "+" in m else m for m in self.macros)

    @property
    def outer(self) -> tuple[str, ...]:
        """The first size of an array of two dimensions."""
        return self.macros[:-1]

    @property
    def element(self) -> str:
        """C text of the index of entry i, of node k in an array of two dimensions."""
        return "[k]" * len(self.outer) + "[i]"

    @property
    def value(self) -> str:
        """C text of the declared value of entry i of a member of the data: controls are zero."""
        return "R(0)" if self.name == "u" else f"default_{self.name}[i]"

    def first(self, prefix: str) -> str:
        """C text of the address of its first number."""
        return f"&{prefix}{self.name}" + "[0]" * len(self.shape)


@dataclass(frozen=True)
class Struct:
    """A struct that the caller owns."""

    name: str
    doc: str
    members: tuple[Member, ...]


@dataclass(frozen=True)
class Function:
    """An entry point: its arguments as C text in the short names of the unit, and its description."""

    name: str
    arguments: tuple[str, ...]
    doc: str

    @property
    def brief(self) -> str:
        """The first clause of the description."""
        return self.doc.split(";")[0].rstrip(".")


Macro = tuple[str, int, str]


def macros(model: DerivativeModel) -> tuple[Macro, ...]:
    """(name, value, meaning) of the sizes that are not zero."""
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
    return tuple(macro for macro in found if macro[1])


def structs(model: DerivativeModel) -> tuple[Struct, ...]:
    """The structs in the order of their declarations."""
    size = {name: value for name, value, _ in macros(model)}
    nz = size["NX"] + size["NU"]

    def array(name: str, sizes: str, doc: str) -> Member | None:
        """``sizes`` are macros, or macros + 1, separated by blanks; None if one of them is zero."""
        words = [word.partition("+") for word in sizes.split()]
        if any(macro not in size for macro, _, _ in words):
            return None
        shape = tuple(size[macro] + int(more or 0) for macro, _, more in words)
        return Member(name, shape, tuple(f"{macro} + 1" if more else macro for macro, _, more in words), doc)

    def struct(name: str, doc: str, *members: Member | None) -> Struct:
        return Struct(name, doc, tuple(member for member in members if member is not None))

    nodes = Member("nodes", (), (), "trajectory and gradients", "nodes")
    return (
        struct(
            "data",
            "what the functions depend on; set by init, free to change",
            array("x0", "NX", "initial state"),
            array("u", "N NU", "controls"),
            array("p", "N+1 NP", "parameters of every node"),
            array("yref", "N NY", "references"),
            array("yref_N", "NY_N", "terminal reference"),
            array("W", "NW", "weight: its diagonal, or all entries row by row"),
            array("W_N", "NW_N", "terminal weight"),
        ),
        struct(
            "trajectory",
            "a simulation",
            array("x", "N+1 NX", "states"),
            array("z", "N NOUT", "outputs"),
            array("partial", "N+1", "sum of the costs of the nodes before k"),
            Member("J", (), (), "cost"),
        ),
        struct(
            "nodes",
            "a trajectory with the gradients of its nodes; work memory of the adjoint methods",
            array("x", "N+1 NX", "states"),
            Member("g", (size["N"], nz), ("N", "NX + NU"), "gradient of the cost"),
            array("g_N", "NX", "gradient of the terminal cost"),
            Member("G", (size["N"], model.outputs, nz), ("N", "NOUT", "NX + NU"), "[C D]") if model.outputs else None,
        ),
        struct(
            "linearization",
            "result of sensitivities: states and [A B] of every interval",
            nodes,
            Member("S", (size["N"], size["NX"], nz), ("N", "NX", "NX + NU"), "[A B]"),
        ),
        struct(
            "response",
            "response of all states to one control; work memory of the alternative methods",
            nodes,
            array("S", "N+1 NX NU", "dx_n / du_k"),
        ),
    )


def size_of(struct: Struct, every: tuple[Struct, ...], precision: str) -> int:
    """Bytes of a struct of numbers, which has no padding."""
    named = {s.name: s for s in every}
    return sum(
        size_of(named[m.struct], every, precision) if m.struct else m.count * BYTES[precision] for m in struct.members
    )


_DATA, _OUT = "const data_t *d", "real_t g[N][NU]"
_XI, _STEP, _ROWS = "real_t Xi[][N][NU]", "real_t step", ("const int *rows", "int n_rows")

_GRADIENT = (
    Function(
        "simulate",
        (_DATA, "trajectory_t *t"),
        "States, outputs and cost of the controls.",
    ),
    Function(
        "sensitivities",
        (_DATA, "linearization_t *m"),
        "States and [A B] of every interval, Algorithm 6.7.",
    ),
    Function(
        "sensitivities_alternative",
        (_DATA, "int k", "response_t *s"),
        "dx_n / du_k of all n for one k, Algorithm 6.8; BAD_INDEX unless 0 <= k < N.",
    ),
    Function(
        "gradient_finite_differences",
        (_DATA, "trajectory_t *t", _STEP, _OUT),
        "g[k][j] = dJ / du_k[j] by simulations with u_k[j] + step max(1, |u_k[j]|), Algorithm 6.1; t gets the "
        "simulation of the controls themselves. BAD_ARGUMENT for a step below the machine epsilon.",
    ),
    Function(
        "gradient_forward",
        (_DATA, "linearization_t *m", _OUT),
        "g by the forward method, Algorithm 6.2; m is the result of sensitivities.",
    ),
    Function(
        "gradient_adjoint",
        (_DATA, "nodes_t *nodes", _OUT),
        "g by the adjoint method, Algorithm 6.3 with products in place of matrices; nodes is work memory.",
    ),
    Function(
        "gradient_adjoint_matrices",
        (_DATA, "linearization_t *m", _OUT),
        "g by the adjoint method, Algorithm 6.3 with matrices; m is the result of sensitivities.",
    ),
    Function(
        "gradient_alternative",
        (_DATA, "response_t *s", _OUT),
        "g by the alternative integration, Algorithms 6.8 and 6.9; s is work memory.",
    ),
)
_IMPULSE_RESPONSE = (
    Function(
        "impulse_response_finite_differences",
        (_DATA, "trajectory_t *t", _STEP, _XI),
        "Xi[n * NOUT + i][k][j] = dz_n[i] / du_k[j] by simulations, Algorithm 6.4; see gradient_finite_differences.",
    ),
    Function(
        "impulse_response_forward",
        (_DATA, "linearization_t *m", _XI),
        "Xi by the forward method, Algorithm 6.5; m is the result of sensitivities.",
    ),
    Function(
        "impulse_response_adjoint",
        (_DATA, "nodes_t *nodes", *_ROWS, _XI),
        "n_rows rows of Xi by the adjoint method, Algorithm 6.6 with products in place of matrices; nodes is work "
        "memory. Each of rows is n * NOUT + i, else BAD_INDEX.",
    ),
    Function(
        "impulse_response_adjoint_matrices",
        (_DATA, "linearization_t *m", *_ROWS, _XI),
        "n_rows rows of Xi by the adjoint method, Algorithm 6.6 with matrices; m is the result of sensitivities.",
    ),
    Function(
        "impulse_response_alternative",
        (_DATA, "response_t *s", _XI),
        "Xi by the alternative integration, Algorithms 6.8 and 6.10; s is work memory.",
    ),
)


def functions(model: DerivativeModel) -> tuple[Function, ...]:
    """All entry points besides init."""
    return (*_GRADIENT, *(_IMPULSE_RESPONSE if model.outputs else ()))
