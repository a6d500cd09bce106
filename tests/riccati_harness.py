"""The Riccati recursion and its solvers in a shared library, with hand-written accessors of the stages.

Every array of the solver struct is a NumPy view, so no optimal control problem is needed.
"""

from __future__ import annotations

import ctypes
import functools
import re
import subprocess
import types
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmpc_codegen.components.qp.riccati import riccati_sizes, riccati_structs
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.package.description import union_dtype
from nmpc_codegen.package.memory import Field, Size, Struct
from nmpc_codegen.runtime.compilers import find_compiler, with_required_options
from verification.qp.harness import (
    FAST,
    FEATURES,
    SCALARS,
    STATUSES,
    WARNINGS,
    build_directory,
    part_text,
    pruned,
    struct_text,
    unit_head,
)


@dataclass(frozen=True)
class Shape:
    """Sizes of a stage QP. ``rows``: (stage, state index or -1: general), sorted; ``free``: components of x_0.

    ``form``: "vector"; "scalar": sums are variables; "small": also matrices without padding.
    """

    ns: int
    nx: int
    nus: int
    rows: tuple[tuple[int, int], ...] = ()
    free: tuple[int, ...] = ()
    form: str = "vector"

    @property
    def switches(self) -> dict[str, int]:
        """Those that select the form."""
        return {"SCALAR": int(self.form != "vector"), "SMALL": int(self.form == "small")}

    @property
    def dims(self) -> Any:
        """The members of Dims that the Riccati components use."""
        named = {
            "ns": self.ns,
            "nx": self.nx,
            "nu": self.nus,
            "nus": self.nus,
            "nxs": self.nx,
            "nzs": self.nx + self.nus,
            "nf": len(self.free),
        }
        named |= {"nv": self.ns * self.nus, "ng": len(self.rows)}
        found = types.SimpleNamespace(**{name: Size(name.upper(), value) for name, value in named.items()})
        found.qp, found.multiple = found, 1 if self.form == "small" else PANEL
        return found

    @property
    def first(self) -> list[int]:
        """First row of the stages 0 .. NS + 1."""
        return [sum(1 for k, _ in self.rows if k < stage) for stage in range(self.ns + 2)]


def _data(dims: Any) -> tuple[Struct, ...]:
    """The members that condensing, Hessian and algorithm own in a real package."""
    nodes = Size("NS + 1", dims.qp.ns.value + 1)

    def field(name: str, *shape: Size) -> Field:
        return Field(name, shape, "", "data")

    return (
        Struct("hessian", "", (field("Q", dims.qp.ns, dims.qp.nzs, dims.qp.nzs), field("Q_N", dims.nx, dims.nx))),
        Struct(
            "stage",
            "",
            (
                field("S", dims.qp.ns, dims.nx, dims.qp.nzs),
                field("b", dims.qp.ns, dims.nx),
                field("g", nodes, dims.qp.nzs),
                field("J", dims.ng, dims.qp.nzs),
            ),
        ),
        Struct("step", "", (field("dx", nodes, dims.nx),)),
    )


ACCESSORS = """
static inline real_t (*stage_S(solver_t *s, int k))[NZS] { return s->stage.S[k]; }
static inline real_t *stage_b(solver_t *s, int k) { return s->stage.b[k]; }
static inline real_t *stage_g(solver_t *s, int k) { return s->stage.g[k]; }
static inline real_t (*stage_Q(solver_t *s, int k))[NZS] { return s->hessian.Q[k]; }
static inline real_t (*stage_Q_N(solver_t *s))[NXS] { return s->hessian.Q_N; }
static inline real_t stage_row_value(const solver_t *s, int m) { (void)s; (void)m; return R(0); }
static inline int row_id(int m) { return m; }
"""
ROW_ACCESSOR = "static inline const real_t *stage_row(const solver_t *s, int m) { return s->stage.J[m]; }\n"

KERNEL = """
int test_factorize(solver_t *s, int last) { return riccati_factorize(s, last); }
void test_backward(solver_t *s, int last) { riccati_backward(s, last); }
void test_forward(solver_t *s, real_t *x, real_t *u) { riccati_forward(s, (real_t (*)[NX])x, u); }
void test_adjoint(solver_t *s, int k, real_t *x, real_t *lam) { riccati_adjoint(&s->riccati, k, x, lam); }
real_t test_gradient(solver_t *s, int k, int j, real_t *x, real_t *u)
{
    return riccati_control_gradient(&s->riccati, k, j, x, u);
}
void test_init(solver_t *s) { riccati_init(s); }
"""


def structs(shape: Shape, owned: tuple[Struct, ...] = ()) -> tuple[Struct, ...]:
    """All structs without members of size 0, the solver last; ``owned``: by the component, or else by the recursion."""
    inner = tuple(_existing(s) for s in (*_data(shape.dims), *(owned or riccati_structs(shape.dims))))
    held = {f.ctype for s in inner for f in s.fields}
    members = tuple(Field(s.name, (), "", "data", s.name) for s in inner if s.name not in held)
    return (*inner, Struct("solver", "", members))


def _existing(struct: Struct) -> Struct:
    fields = (f for f in struct.fields if all(f.values) and (f.only is None or f.only(FEATURES)))
    return replace(struct, fields=tuple(fields))


def source(
    shape: Shape,
    part: str = "riccati/kernel.c",
    sizes: tuple[tuple[str, int, str], ...] = (),
    owned: tuple[Struct, ...] = (),
    precision: str = "double",
    lanes: int = 1,
    entries: str = KERNEL,
) -> str:
    """Self-contained C text of a part that works on stages, with entry points; ``lanes`` > 1: in register tiles."""
    dims = vars(shape.dims)
    values = {size.text: size.value for size in dims.values() if isinstance(size, Size)}
    values |= {"PACK_WIDTH": lanes, "TILES": int(lanes > 1)}
    values |= {name: value for name, value, _ in (*riccati_sizes(shape.dims), *sizes)}
    measured = [int(i not in shape.free) for i in range(shape.nx)]
    tables = {
        "stage_first": shape.first,
        "stage_of_row": [k for k, _ in shape.rows],
        "stage_state": [i for _, i in shape.rows],
        "free_state": shape.free,
        "copied_state": (),
        "is_measured": measured,
        "is_accumulator": [0] * shape.nx,
    }
    lines = [unit_head(values, precision)]
    for name, numbers in tables.items():
        if name.startswith("stage_") and not shape.rows:
            continue
        text = ", ".join(map(str, numbers)) or "0"
        lines.append(f"static const int {name}[{max(1, len(numbers))}] = {{ {text} }};")
    # the data are drawn in all sizes: rounding is judged by them alone
    nz = shape.nx + max(1, shape.nus)
    scales = {"z_scale": nz, "row_magnitude": max(1, len(shape.rows)), "force_size": nz}
    lines += [f"static const real_t {name}[{size}] = {{ R(0) }};" for name, size in scales.items()]
    lines.append("static const real_t cost_size[1] = { R(1e-27) };")
    lines += [struct_text(struct) for struct in structs(shape, owned)]
    accessors = part_text("core/sizes.c", values | shape.switches) + ACCESSORS + (ROW_ACCESSOR if shape.rows else "")
    text = _in_lines(accessors) + part_text(part, values | shape.switches) + _in_lines(entries)
    stated = {(s.name, f.name) for s in (*_data(shape.dims), *(owned or riccati_structs(shape.dims))) for f in s.fields}
    absent = stated - {(s.name, f.name) for s in structs(shape, owned) for f in s.fields}
    ranges = {name: (min(numbers), max(numbers)) for name, numbers in tables.items() if numbers}
    return "\n".join([*lines, pruned(text, values | shape.switches, precision, absent, ranges)])


def _in_lines(text: str) -> str:
    """A text with the functions of one line written as parts are."""

    def written(found: re.Match[str]) -> str:
        statements = (f"    {statement.strip()};" for statement in found[2].rstrip(";").split("; "))
        return "\n".join([found[1], "{", *statements, "}"])

    return re.sub(r"^(\w[^\n{;]*\)(?:\[\w+\])?) \{ (.*) \}$", written, text, flags=re.MULTILINE)


@functools.cache
def compiled(text: str, flags: tuple[str, ...] = FAST) -> ctypes.CDLL:
    """Shared library of a C text, all warnings being errors; built once per session and text."""
    stem = Path(build_directory().name) / f"riccati_{abs(hash((text, flags)))}"
    stem.with_suffix(".c").write_text(text)
    unused = ("-Wno-unused-const-variable", "-Wno-unused-function")
    command = [*(with_required_options(("gcc",)) if flags == FAST else find_compiler())]
    command += ["-std=c99", *WARNINGS, *unused, *flags, "-shared", "-fPIC"]
    subprocess.run([*command, "-o", stem.with_suffix(".so"), stem.with_suffix(".c"), "-lm"], check=True)
    return ctypes.CDLL(str(stem.with_suffix(".so")))


def memory_layout(shape: Shape, owned: tuple[Struct, ...] = (), precision: str = "double") -> np.dtype[Any]:
    """NumPy type of the solver struct."""
    scalars: dict[str, Any] = {"real": SCALARS[precision], "int32": np.int32}
    for struct in structs(shape, owned):
        fields = [(f.name, np.dtype(scalars[f.ctype]), f.padded) for f in struct.fields]
        scalars[struct.name] = union_dtype(fields) if struct.union else np.dtype(fields, align=True)
    return np.dtype(scalars["solver"])


SOLVER = """
void test_qp_init(solver_t *s) { qp_init(s); }
int test_qp_factorize(solver_t *s) { return (int)qp_factorize(s); }
void test_qp_gradient(solver_t *s) { qp_gradient(s); }
int test_qp_solve(solver_t *s) { return (int)qp_solve(s); }
void test_qp_shift(solver_t *s, int n, const int *source)
{
    qp_shift_controls(s, n);
    qp_shift_rows(s, source);
}
int test_qp_size(void) { return (int)sizeof(solver_t); }
"""


def solver_source(shape: Shape, component: Any, precision: str = "double", lanes: int = 1) -> str:
    """Self-contained C text of a solver with its exported entry points."""
    known = {name for name, _, _ in riccati_sizes(shape.dims)}
    sizes = tuple(entry for entry in component.sizes(shape.dims) if entry[0] not in known)
    return source(shape, component.template, sizes, component.structs(shape.dims), precision, lanes, SOLVER)


@functools.cache
def solver_library(
    shape: Shape, component: Any, precision: str, flags: tuple[str, ...], lanes: int = 1
) -> tuple[ctypes.CDLL, np.dtype[Any]]:
    """The library of a solver and the type of its struct, once per session."""
    layout = memory_layout(shape, component.structs(shape.dims), precision)
    return compiled(solver_source(shape, component, precision, lanes), flags), layout


class RiccatiQP:
    """A solver on stages; ``self["z"]`` is the view of the member z of its struct qp."""

    def __init__(
        self,
        shape: Shape,
        component: Any,
        precision: str = "double",
        flags: tuple[str, ...] = FAST,
        lanes: int = 1,
    ) -> None:
        self.shape = shape
        self.library, layout = solver_library(shape, component, precision, flags, lanes)
        self.memory = np.zeros((), layout)
        assert self.library.test_qp_size() == self.memory.nbytes
        self.library.test_qp_init(self.pointer)

    @property
    def pointer(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.memory.ctypes.data)

    def __getitem__(self, name: str) -> np.ndarray:
        """A member; one of size 0, which does not exist, is an empty array."""
        qp = self.memory["qp"]
        return qp[name] if name in qp.dtype.names else np.zeros(0)

    def load(self, qp: Any) -> None:
        """All data of a StageQP; strict upper triangles are NaN, because they must not be read."""
        problem, stage, hessian = qp.problem, self.memory["stage"], self.memory["hessian"]
        nx = self.shape.nx
        upper = np.triu(np.full(problem.Q[0].shape, np.nan), 1)
        stage["S"][...], stage["b"][...] = problem.S, problem.b
        hessian["Q"][...], hessian["Q_N"][...] = problem.Q + upper, problem.Q_N + upper[:nx, :nx]
        if len(qp.rows):
            stage["J"][...] = qp.rows
            self["penalty"][...], self["curvature"][...] = qp.penalty, qp.curvature
        self.load_gradient(qp)
        self.load_bounds(qp)

    def load_gradient(self, qp: Any) -> None:
        self.memory["stage"]["g"][:-1] = qp.problem.g
        self.memory["stage"]["g"][-1, : self.shape.nx] = qp.problem.g_N

    def load_bounds(self, qp: Any) -> None:
        n = self.shape.ns * self.shape.nus + len(self.shape.rows)
        self["lower"][:n], self["upper"][:n] = qp.lower, qp.upper

    def factorize(self) -> str:
        return STATUSES[self.library.test_qp_factorize(self.pointer)]

    def solve(self, x_0: np.ndarray) -> str:
        """``x_0``: its free components are overwritten by NaN, because they must not be read."""
        start = np.array(x_0, dtype=float)
        start[list(self.shape.free)] = np.nan
        self.memory["step"]["dx"][0] = start
        return STATUSES[self.library.test_qp_solve(self.pointer)]

    def run(self, qp: Any) -> str:
        """Run both phases; returns the status of the phase that failed, else that of qp_solve."""
        self.load(qp)
        status = self.factorize()
        return status if status != "OK" else self.solve(qp.problem.x_0)

    def shift(self, n: int, source: Any = None) -> None:
        rows = np.arange(len(self.shape.rows)) if source is None else source
        self.library.test_qp_shift(self.pointer, n, (ctypes.c_int * max(1, len(rows)))(*rows))

    @property
    def x(self) -> np.ndarray:
        return self["x"].astype(float)

    @property
    def u(self) -> np.ndarray:
        return self["z"].astype(float).reshape(self.shape.ns, self.shape.nus)

    @property
    def mult(self) -> np.ndarray:
        n = self.shape.ns * self.shape.nus + len(self.shape.rows)
        return self["mult"][:n].astype(float)


def drawn_rows(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """Gradients of the rows; unit vectors if the shape requires them."""
    rows = rng.normal(size=(len(shape.rows), shape.nx + shape.nus))
    for m, (k, state) in enumerate(shape.rows):
        if state >= 0:
            rows[m] = np.eye(1, rows.shape[1], state)
        elif k == shape.ns:
            rows[m, shape.nx :] = 0
    return rows
