"""A QP component alone in a shared library: the template, its struct and nothing else.

The header text comes from the component's own Struct, so no optimal control problem is needed.
"""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from pathlib import Path

import jinja2
import numpy as np

from nmpc_codegen.components.base import Dims
from nmpc_codegen.components.qp import DenseActiveSet
from nmpc_codegen.ir.cmodule import Size, Struct
from nmpc_codegen.lowering.tolerances import TOLERANCES, tolerance

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
STATUSES = (
    "OK", "ITERATION_LIMIT", "INFEASIBLE", "RELAXED", "NUMERICAL_FAILURE", "NOT_FINITE", "NOT_PREPARED",
    "NOT_INITIALIZED", "BAD_INDEX", "BAD_BOUNDS", "BAD_ARGUMENT", "STALLED",
)  # fmt: skip
WARNINGS = ("-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror")
FAST = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")
SCALARS = {"double": np.float64, "single": np.float32}


def qp_dims(nv: int, ng: int) -> Dims:
    """Dims of a QP with nv variables and ng general rows; the other sizes are not looked at."""
    zero = Size("0", 0)
    named = dict.fromkeys(Dims.__dataclass_fields__, zero)
    named |= {
        "ns": Size("NS", 1),
        "nus": Size("NUS", nv),
        "nv": Size("NV", nv),
        "ng": Size("NG", ng),
        "ld": Size("LDV", -(-nv // 4) * 4),
    }
    return Dims(**named)


def source(nv: int, ng: int, precision: str = "double", component: DenseActiveSet | None = None) -> str:
    """Self-contained C text of the component with exported entry points test_init, test_factorize, ..."""
    component = component or DenseActiveSet()
    dims = qp_dims(nv, ng)
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
    names = {
        "p": "test",
        "P": "TEST",
        "real": "test_real",
        "lit": literal,
        "fn": lambda name: name + ("f" if single else ""),
        "tol": lambda name: literal(tolerance(name, precision)),
    }
    templates = (component.template, component.shift_template)
    body = "\n".join(environment.get_template(template).render(names) for template in templates)
    head = ["#include <math.h>", "#include <stdint.h>"]
    sizes = [
        ("NS", 1, ""),
        ("NUS", nv, ""),
        ("NV", nv, ""),
        ("NG", ng, ""),
        ("LDV", dims.ld.value, ""),
        *component.sizes(dims),
    ]
    head += [f"#define TEST_{name} {value}" for name, value, _ in sizes]
    head += [f"typedef {'float' if single else 'double'} test_real;"]
    head += ["typedef enum { " + ", ".join(f"TEST_{s}" for s in STATUSES) + " } test_status_t;"]
    for struct in component.structs(dims):
        head += ["typedef struct {", *(f"    {line}" for line in members(struct)), f"}} test_{struct.name}_t;"]
    return "\n".join(head) + "\n" + body


def members(struct: Struct) -> list[str]:
    """C member declarations of a struct; zero sizes are padded to 1."""
    types = {"real": "test_real", "int32": "int32_t", "int64": "int64_t"}
    return [f"{types[f.ctype]} {f.name}{''.join(f'[{n}]' for n in f.padded)};" for f in struct.fields]


ENTRY_POINTS = """
#ifdef __cplusplus
extern "C" {
#endif
void test_init(test_qp_t *q);
int test_factorize(test_qp_t *q);
int test_solve(test_qp_t *q);
void test_shift(test_qp_t *q, int n, const int *source);
int test_size(void);
void test_init(test_qp_t *q) { qp_init(q); }
int test_factorize(test_qp_t *q) { return (int)qp_factorize(q); }
int test_solve(test_qp_t *q) { return (int)qp_solve(q); }
void test_shift(test_qp_t *q, int n, const int *source) { qp_shift_working_set(q, n, source); }
int test_size(void) { return (int)sizeof(test_qp_t); }
#ifdef __cplusplus
}
#endif
"""


@functools.cache
def build_directory() -> tempfile.TemporaryDirectory[str]:
    """One temporary directory per session; removed at exit."""
    return tempfile.TemporaryDirectory(prefix="qp_harness_")


@functools.cache
def library(nv: int, ng: int, precision: str = "double", max_iterations: int | None = None) -> ctypes.CDLL:
    """Shared library of the component, built once per session and configuration, all warnings being errors."""
    stem = Path(build_directory().name) / f"qp_{nv}_{ng}_{precision}_{max_iterations}"
    stem.with_suffix(".c").write_text(source(nv, ng, precision, DenseActiveSet(max_iterations)) + ENTRY_POINTS)
    subprocess.run(
        ["gcc", "-std=c99", *WARNINGS, *FAST, "-shared", "-fPIC",
         "-o", stem.with_suffix(".so"), stem.with_suffix(".c"), "-lm"],
        check=True,
    )  # fmt: skip
    return ctypes.CDLL(str(stem.with_suffix(".so")))


def memory_layout(nv: int, ng: int, precision: str) -> np.dtype:
    """NumPy view of the C struct."""
    types = {"real": SCALARS[precision], "int32": np.int32, "int64": np.int64}
    (struct,) = DenseActiveSet().structs(qp_dims(nv, ng))
    return np.dtype([(f.name, types[f.ctype], f.padded) for f in struct.fields], align=True)


class QP:
    """One instance of the C struct; ``self["z"]`` is the view on its member z."""

    def __init__(self, nv: int, ng: int, precision: str = "double", max_iterations: int | None = None) -> None:
        self.nv, self.ng = nv, ng
        self.library = library(nv, ng, precision, max_iterations)
        self.memory = np.zeros((), memory_layout(nv, ng, precision))
        assert self.library.test_size() == self.memory.nbytes
        self.library.test_init(self._pointer)

    @property
    def _pointer(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.memory.ctypes.data)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.memory[name]

    def load(self, H, A, lower, upper) -> None:
        """Data of the preparation phase; nothing but the lower triangle of H is written."""
        inside = np.tril(np.ones((self.nv, self.nv), bool))
        self["H"][: self.nv, : self.nv][inside] = np.asarray(H)[inside]
        if self.ng:
            self["A"][:, : self.nv] = A
        self.load_bounds(lower, upper)

    def load_bounds(self, lower, upper) -> None:
        self["lower"][: self.nv + self.ng] = lower
        self["upper"][: self.nv + self.ng] = upper

    def factorize(self) -> str:
        return STATUSES[self.library.test_factorize(self._pointer)]

    def solve(self, g) -> str:
        self["g"][: self.nv] = g
        return STATUSES[self.library.test_solve(self._pointer)]

    def run(self, H, g, A, lower, upper, penalty=np.inf) -> str:
        """Both phases; the status of the one that failed, else of qp_solve."""
        self.load(H, A, lower, upper)
        self["penalty"][self.nv : self.nv + self.ng] = penalty
        status = self.factorize()
        return status if status != "OK" else self.solve(g)

    def shift(self, n: int, source=None) -> None:
        """``source``: per general row the row whose prediction it takes, default itself."""
        rows = np.arange(self.ng) if source is None else source
        self.library.test_shift(self._pointer, n, (ctypes.c_int * max(1, self.ng))(*rows))

    @property
    def z(self) -> np.ndarray:
        return self["z"][: self.nv].astype(float)

    @property
    def mult(self) -> np.ndarray:
        return self["mult"][: self.nv + self.ng].astype(float)


__all__ = ["FAST", "QP", "TOLERANCES", "WARNINGS", "library", "qp_dims", "source"]
