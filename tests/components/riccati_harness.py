"""The Riccati recursion in a shared library, with hand-written accessors of the stages.

Every array of the solver struct is a NumPy view, so no optimal control problem is needed.
"""

from __future__ import annotations

import ctypes
import functools
import re
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmpc_codegen.components.base import Dims
from nmpc_codegen.components.qp.riccati import riccati_sizes, riccati_structs
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.package.description import union_dtype
from nmpc_codegen.package.struct_layout import Field, Size, Struct
from nmpc_codegen.runtime.compilers import find_compiler, with_required_options
from verification.qp.harness import (
    FAST,
    FEATURES,
    SCALARS,
    WARNINGS,
    build_directory,
    dims_with,
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
    def dims(self) -> Dims:
        """The members of Dims that the Riccati components use."""
        return dims_with(
            1 if self.form == "small" else PANEL,
            N=self.ns,
            nx=self.nx,
            nu=self.nus,
            nz=self.nx + self.nus,
            nf=len(self.free),
            nv=self.ns * self.nus,
            ng=len(self.rows),
        )

    @property
    def first(self) -> list[int]:
        """First row of the stages 0 .. N + 1."""
        return [sum(1 for k, _ in self.rows if k < stage) for stage in range(self.ns + 2)]


def _data(dims: Dims) -> tuple[Struct, ...]:
    """The members that condensing, Hessian and algorithm own in a real package."""
    nodes = dims.nodes

    def field(name: str, *shape: Size) -> Field:
        return Field(name, shape, "", "data")

    return (
        Struct("hessian", "", (field("Q", dims.N, dims.nz, dims.nz), field("Q_N", dims.nx, dims.nx))),
        Struct(
            "stage",
            "",
            (
                field("S", dims.N, dims.nx, dims.nz),
                field("b", dims.N, dims.nx),
                field("g", nodes, dims.nz),
                field("J", dims.ng, dims.nz),
            ),
        ),
        Struct("step", "", (field("dx", nodes, dims.nx),)),
    )


ACCESSORS = """
static inline real_t (*stage_S(solver_t *s, int k))[NZ] { return s->stage.S[k]; }
static inline real_t *stage_b(solver_t *s, int k) { return s->stage.b[k]; }
static inline real_t *stage_g(solver_t *s, int k) { return s->stage.g[k]; }
static inline real_t (*stage_Q(solver_t *s, int k))[NZ] { return s->hessian.Q[k]; }
static inline real_t (*stage_Q_N(solver_t *s))[NX] { return s->hessian.Q_N; }
static inline real_t row_constant(const solver_t *s, int m) { (void)s; (void)m; return R(0); }
static inline int row_id(int m) { return m; }
"""
ROW_ACCESSORS = """
static inline const real_t *row_gradient(const solver_t *s, int m) { return s->stage.J[m]; }
static inline int row_node(int m) { return node_of_row[m]; }
static inline int row_index(int m) { return state_of_row[m]; }
static inline int row_is_state(int m) { return state_of_row[m] >= 0; }
"""

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


def structs(shape: Shape) -> tuple[Struct, ...]:
    """All structs without members of size 0, the solver last."""
    inner = tuple(_existing(s) for s in (*_data(shape.dims), *riccati_structs(shape.dims)))
    held = {f.ctype for s in inner for f in s.fields}
    members = tuple(Field(s.name, (), "", "data", s.name) for s in inner if s.name not in held)
    return (*inner, Struct("solver", "", members))


def _existing(struct: Struct) -> Struct:
    fields = (f for f in struct.fields if all(f.values) and (f.only is None or f.only(FEATURES)))
    return replace(struct, fields=tuple(fields))


def source(shape: Shape, precision: str = "double", lanes: int = 1) -> str:
    """Self-contained C text of the recursion, with entry points; ``lanes`` > 1: in register tiles."""
    sizes = vars(shape.dims) | vars(shape.dims.qp)
    values = {size.text: int(size) for size in sizes.values() if isinstance(size, Size)}
    values |= {"PACK_WIDTH": lanes, "TILES": int(lanes > 1)}
    values |= {name: value for name, value, _ in riccati_sizes(shape.dims)}
    measured = [int(i not in shape.free) for i in range(shape.nx)]
    tables = {
        "row_first": shape.first,
        "node_of_row": [k for k, _ in shape.rows],
        "state_of_row": [i for _, i in shape.rows],
        "free_state": shape.free,
        "is_measured": measured,
        "is_accumulator": [0] * shape.nx,
    }
    lines = [unit_head(values, precision)]
    for name, numbers in tables.items():
        if "row" in name and not shape.rows:
            continue
        text = ", ".join(map(str, numbers)) or "0"
        lines.append(f"static const int {name}[{max(1, len(numbers))}] = {{ {text} }};")
    # the data are drawn in all sizes: rounding is judged by them alone
    nz = shape.nx + max(1, shape.nus)
    scales = {"z_scale": nz, "row_magnitude": max(1, len(shape.rows)), "force_size": nz}
    lines += [f"static const real_t {name}[{size}] = {{ R(0) }};" for name, size in scales.items()]
    lines.append("static const real_t cost_size[1] = { R(1e-27) };")
    lines += [struct_text(struct) for struct in structs(shape)]
    accessors = part_text("core/sizes.c", values | shape.switches) + ACCESSORS + (ROW_ACCESSORS if shape.rows else "")
    text = _in_lines(accessors) + part_text("riccati/kernel.c", values | shape.switches) + _in_lines(KERNEL)
    stated = {(s.name, f.name) for s in (*_data(shape.dims), *riccati_structs(shape.dims)) for f in s.fields}
    absent = stated - {(s.name, f.name) for s in structs(shape) for f in s.fields}
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


def memory_layout(shape: Shape, precision: str = "double") -> np.dtype[Any]:
    """NumPy type of the solver struct."""
    scalars: dict[str, Any] = {"real": SCALARS[precision], "int32": np.int32}
    for struct in structs(shape):
        fields = [(f.name, np.dtype(scalars[f.ctype]), f.padded) for f in struct.fields]
        scalars[struct.name] = union_dtype(fields) if struct.union else np.dtype(fields, align=True)
    return np.dtype(scalars["solver"])


def drawn_rows(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """Gradients of the rows; unit vectors if the shape requires them."""
    rows = rng.normal(size=(len(shape.rows), shape.nx + shape.nus))
    for m, (k, state) in enumerate(shape.rows):
        if state >= 0:
            rows[m] = np.eye(1, rows.shape[1], state)
        elif k == shape.ns:
            rows[m, shape.nx :] = 0
    return rows
