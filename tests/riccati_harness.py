"""The Riccati recursion and the solvers on it alone in a shared library, behind hand-made accessors of the stage seam.

Every array of the solver struct is a NumPy view, so no optimal control problem is needed.
"""

from __future__ import annotations

import ctypes
import functools
import subprocess
import types
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from qp_harness import FAST, SCALARS, STATUSES, TEMPLATES, WARNINGS, build_directory, members

from nmpc_codegen.cmodule import Field, Size, Struct
from nmpc_codegen.riccati import riccati_sizes, riccati_struct
from nmpc_codegen.tolerances import tolerance


@dataclass(frozen=True)
class Shape:
    """Sizes of a stage QP. ``rows``: (stage, state index or -1: general), sorted; ``free``: components of x_0."""

    ns: int
    nx: int
    nus: int
    rows: tuple[tuple[int, int], ...] = ()
    free: tuple[int, ...] = ()

    @property
    def dims(self) -> Any:
        """The members of Dims that the Riccati components look at."""
        named = {"ns": self.ns, "nx": self.nx, "nus": self.nus, "nzs": self.nx + self.nus, "nf": len(self.free)}
        named |= {"nv": self.ns * self.nus, "ng": len(self.rows)}
        return types.SimpleNamespace(**{name: Size(name.upper(), value) for name, value in named.items()})

    @property
    def first(self) -> list[int]:
        """First row of the stages 0 .. NS + 1."""
        return [sum(1 for k, _ in self.rows if k < stage) for stage in range(self.ns + 2)]


def _data(dims: Any) -> tuple[Struct, ...]:
    """What condensing, Hessian and algorithm own in a real package."""
    nodes = Size("NS + 1", dims.ns.value + 1)

    def field(name: str, *shape: Size) -> Field:
        return Field(name, shape, "", "data")

    return (
        Struct("hessian", "", (field("Q", dims.ns, dims.nzs, dims.nzs), field("Q_N", dims.nx, dims.nx))),
        Struct(
            "stage",
            "",
            (
                field("S", dims.ns, dims.nx, dims.nzs),
                field("b", dims.ns, dims.nx),
                field("g", nodes, dims.nzs),
                field("J", dims.ng, dims.nzs),
            ),
        ),
        Struct("step", "", (field("dx", nodes, dims.nx),)),
    )


ACCESSORS = """
static inline test_real (*stage_S(test_solver_t *s, int k))[TEST_NZS] { return s->stage.S[k]; }
static inline test_real *stage_b(test_solver_t *s, int k) { return s->stage.b[k]; }
static inline test_real *stage_g(test_solver_t *s, int k) { return s->stage.g[k]; }
static inline test_real (*stage_Q(test_solver_t *s, int k))[TEST_NZS] { return s->hessian.Q[k]; }
static inline const test_real *stage_row(const test_solver_t *s, int m) { return s->stage.J[m]; }
"""

KERNEL = """
int test_factorize(test_solver_t *s, int last) { return riccati_factorize(s, last); }
void test_backward(test_solver_t *s, int last) { riccati_backward(s, last); }
void test_forward(test_solver_t *s, test_real *x, test_real *u) { riccati_forward(s, (test_real (*)[TEST_NX])x, u); }
void test_adjoint(test_solver_t *s, int k, test_real *x, test_real *lam) { riccati_adjoint(&s->riccati, k, x, lam); }
test_real test_gradient(test_solver_t *s, int k, int j, test_real *x, test_real *u)
{
    return riccati_control_gradient(&s->riccati, k, j, x, u);
}
void test_init(test_solver_t *s) { riccati_init(s); }
"""


def structs(shape: Shape, extra: tuple[Struct, ...] = ()) -> tuple[Struct, ...]:
    """All structs, the solver last."""
    inner = (*_data(shape.dims), riccati_struct(shape.dims), *extra)
    return (*inner, Struct("solver", "", tuple(Field(s.name, (), "", "data", s.name) for s in inner)))


def source(
    shape: Shape,
    template: str = "riccati/kernel.c.jinja",
    sizes: tuple[tuple[str, int, str], ...] = (),
    extra: tuple[Struct, ...] = (),
    precision: str = "double",
) -> str:
    """Self-contained C text of a template on the stage seam."""
    single = precision == "single"

    def literal(value: float) -> str:
        return repr(float(value)) + ("f" if single else "")

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,
        keep_trailing_newline=True,
    )
    body = environment.get_template(template).render(
        p="test",
        P="TEST",
        real="test_real",
        lit=literal,
        fn=lambda name: name + ("f" if single else ""),
        tol=lambda name: literal(tolerance(name, precision)),
    )
    dims = vars(shape.dims)
    macros = [(size.text, size.value) for size in dims.values()]
    macros += [(name, value) for name, value, _ in (*riccati_sizes(shape.dims), *sizes)]
    measured = [int(i not in shape.free) for i in range(shape.nx)]
    tables = {
        "stage_first": shape.first,
        "stage_of_row": [k for k, _ in shape.rows],
        "stage_state": [i for _, i in shape.rows],
        "free_state": shape.free,
        "is_measured": measured,
        "is_accumulator": [0] * shape.nx,
    }
    lines = ["#include <math.h>", "#include <stdint.h>", "#include <string.h>"]
    lines += [f"#define TEST_{name} {value}" for name, value in macros]
    lines += [f"typedef {'float' if single else 'double'} test_real;"]
    lines += ["typedef enum { " + ", ".join(f"TEST_{s}" for s in STATUSES) + " } test_status_t;"]
    for name, values in tables.items():
        text = ", ".join(map(str, values)) or "0"
        lines.append(f"static const int {name}[{max(1, len(values))}] = {{ {text} }};")
    for struct in structs(shape, extra):
        lines += ["typedef struct {", *(f"    {line}" for line in _members(struct)), f"}} test_{struct.name}_t;"]
    return "\n".join(lines) + ACCESSORS + body


def _members(struct: Struct) -> list[str]:
    return [
        f"test_{f.ctype}_t {f.name};" if f.ctype not in ("real", "int32") else members(replace(struct, fields=(f,)))[0]
        for f in struct.fields
    ]


def compiled(text: str, flags: tuple[str, ...] = FAST) -> ctypes.CDLL:
    """Shared library of a C text, all warnings being errors; built once per session and text."""
    return _compiled(text, flags)


@functools.cache
def _compiled(text: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    stem = Path(build_directory().name) / f"riccati_{abs(hash((text, flags)))}"
    stem.with_suffix(".c").write_text(text)
    command = [
        "gcc",
        "-std=c99",
        *WARNINGS,
        "-Wno-unused-const-variable",
        "-Wno-unused-function",
        *flags,
        "-shared",
        "-fPIC",
    ]
    subprocess.run([*command, "-o", stem.with_suffix(".so"), stem.with_suffix(".c"), "-lm"], check=True)
    return ctypes.CDLL(str(stem.with_suffix(".so")))


def memory_layout(shape: Shape, extra: tuple[Struct, ...] = (), precision: str = "double") -> np.dtype[Any]:
    """NumPy type of the solver struct."""
    scalars: dict[str, Any] = {"real": SCALARS[precision], "int32": np.int32}
    for struct in structs(shape, extra):
        fields = [(f.name, scalars[f.ctype], f.padded) for f in struct.fields]
        scalars[struct.name] = np.dtype(fields, align=True)
    return np.dtype(scalars["solver"])
