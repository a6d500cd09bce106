"""A QP component is tested in a shared library with only its template and its struct.

The header text comes from the component's own Struct, so no optimal control problem is needed.
"""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Collection, Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from nmpc_codegen.components.base import Dims, QpDims
from nmpc_codegen.components.qp import DenseActiveSet
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.tolerances import TOLERANCES
from nmpc_codegen.lowering.unit.macros import CHOSEN, REAL_CONSTANT, arithmetic, print_macro
from nmpc_codegen.lowering.unit.pipeline import run
from nmpc_codegen.lowering.unit.read import items_of, read_part
from nmpc_codegen.package.description import union_dtype
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.status import Status
from nmpc_codegen.package.struct_layout import Size, Struct
from nmpc_codegen.runtime.compilers import find_compiler, with_required_options

STATUSES: tuple[str, ...] = tuple(Status.__members__)
WARNINGS = ("-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror")
FAST = ("-O1", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")
SCALARS = {"double": np.float64, "single": np.float32}


#: Features for tests of single parts: all kinds of rows, and the fallback of the active-set method.
FEATURES = Features(
    solve=True,
    state_rows=True,
    end_equations=True,
    general_rows=True,
    interior_point=True,
    set_reference=True,
)


def dims_with(multiple: int = PANEL, **sizes: int) -> Dims:
    """Return Dims with these sizes, for a component that uses no other ones."""

    def found(cls: type) -> dict[str, Any]:
        names = (f.name for f in fields(cls) if f.type == "Size")
        return {name: Size({"ld": "LDV"}.get(name, name.upper()), sizes.get(name, 0)) for name in names}

    return Dims(**found(Dims), condensed=QpDims(**found(QpDims)), multiple=multiple)


def qp_dims(nv: int, ng: int) -> Dims:
    """Return the Dims of a QP with nv variables and ng general rows."""
    padded = -(-nv // PANEL) * PANEL
    return dims_with(nvu=nv, nv=nv, ng=ng, ld=padded, ldh=padded)


def source(nv: int, ng: int, precision: str = "double", component: DenseActiveSet | None = None) -> str:
    """Return the C text of the component with exported entry points test_init, test_factorize, ..."""
    component = component or DenseActiveSet()
    dims = qp_dims(nv, ng)
    sizes = {
        "NVU": nv,
        "NV": nv,
        "NG": ng,
        "LDV": int(dims.qp.ld),
        "LDH": int(dims.qp.ldh),
        "NSL": 0,
        "ELASTIC": int(ng > 0),
    }
    sizes |= {name: value for name, value, _ in component.sizes(dims)}
    head = [unit_head(sizes, precision), *(struct_text(struct) for struct in component.structs(dims)), DECLARATIONS]
    return "\n".join([*head, pruned(part_text(component.template, sizes) + ENTRY_POINTS, sizes, precision)])


def unit_head(sizes: Mapping[str, int], precision: str) -> str:
    """Return the text that a part needs besides its structs: includes, sizes, types, statuses, arithmetic."""
    lines = ["#include <math.h>", "#include <stdint.h>", "#include <string.h>"]
    lines += [f"#define {name} {value}" for name, value in sizes.items()]
    lines += [print_macro(item, {}) for item in (*arithmetic(precision), REAL_CONSTANT)]
    lines += [f"typedef {'float' if precision == 'single' else 'double'} real_t;", *CHOSEN.values()]
    return "\n".join(
        [*lines, "typedef enum { " + ", ".join(STATUSES) + " } status_t;", part_text("core/clip.c", sizes)]
    )


def struct_text(struct: Struct) -> str:
    """Return the type definition of a struct."""
    kind = "union" if struct.union else "struct"
    return "\n".join([f"typedef {kind} {{", *(f"    {line}" for line in members(struct)), f"}} {struct.name}_t;"])


def part_text(path: str, sizes: Mapping[str, int]) -> str:
    """Return a part with its included parts and its conditions resolved."""
    return read_part(path, sizes={**FEATURES.macros, **sizes})


def pruned(
    text: str,
    sizes: Mapping[str, int],
    precision: str,
    absent: Collection[tuple[str, str]] = (),
    ranges: Mapping[str, tuple[int, int]] = MappingProxyType({}),
) -> str:
    """Return parts with the functions that call them, without what the sizes exclude.

    ``absent``: members of no struct; ``ranges``: least and greatest entries of tables.
    """
    known = Constants({**FEATURES.macros, **sizes}, dict(ranges), absent=frozenset(absent))
    unit = run((*arithmetic(precision), REAL_CONSTANT, *items_of(text)), known)
    return "\n\n".join(item.text for item in unit if item.kind != "macro") + "\n"


def members(struct: Struct) -> list[str]:
    """Return the C member declarations of a struct; zero sizes are padded to 1."""
    types = {"real": "real_t", "int32": "int32_t", "int64": "int64_t"}
    return [
        f"{types.get(f.ctype, f.ctype + '_t')} {f.name}{''.join(f'[{n}]' for n in f.padded)};" for f in struct.fields
    ]


DECLARATIONS = """
#ifdef __cplusplus
extern "C" {
#endif
void test_init(qp_t *q);
int test_factorize(qp_t *q);
int test_solve(qp_t *q);
void test_shift(qp_t *q, int n, const int *source);
int test_size(void);
#ifdef __cplusplus
}
#endif
"""
ENTRY_POINTS = """
void test_init(qp_t *q)
{
    qp_init(q);
}

int test_factorize(qp_t *q)
{
    return (int)qp_factorize(q);
}

int test_solve(qp_t *q)
{
    return (int)qp_solve(q);
}

void test_shift(qp_t *q, int n, const int *source)
{
    qp_shift_controls(q, n);
    qp_shift_rows(q, source);
}

int test_size(void)
{
    return (int)sizeof(qp_t);
}
"""


@functools.cache
def build_directory() -> tempfile.TemporaryDirectory[str]:
    """Return the temporary directory of this process, which is removed at exit."""
    return tempfile.TemporaryDirectory(prefix="qp_harness_")


@functools.cache
def library(
    nv: int,
    ng: int,
    precision: str = "double",
    max_iterations: int | None = None,
    flags: tuple[str, ...] = FAST,
) -> ctypes.CDLL:
    """Build the shared library of the component once per session and configuration; all warnings are errors."""
    stem = (
        Path(build_directory().name)
        / f"qp_{nv}_{ng}_{precision}_{max_iterations}_{'fast' if flags == FAST else 'plain'}"
    )
    stem.with_suffix(".c").write_text(source(nv, ng, precision, DenseActiveSet(max_iterations)))
    compiler = with_required_options(("gcc",)) if flags == FAST else find_compiler()
    subprocess.run(
        [*compiler, "-std=c99", *WARNINGS, *flags, "-shared", "-fPIC",
         "-o", stem.with_suffix(".so"), stem.with_suffix(".c"), "-lm"],
        check=True,
    )  # fmt: skip
    return ctypes.CDLL(str(stem.with_suffix(".so")))


@functools.cache
def memory_layout(nv: int, ng: int, precision: str) -> np.dtype[Any]:
    """Return the NumPy type of the C struct."""
    types: dict[str, Any] = {"real": SCALARS[precision], "int32": np.int32, "int64": np.int64}
    for struct in DenseActiveSet().structs(qp_dims(nv, ng)):
        members = [(f.name, np.dtype(types[f.ctype]), f.padded) for f in struct.fields]
        types[struct.name] = union_dtype(members) if struct.union else np.dtype(members, align=True)
    found: np.dtype[Any] = types["qp"]
    return found


class QP:
    """A QP is one instance of the C struct; ``self["z"]`` is the view of its member z."""

    def __init__(
        self,
        nv: int,
        ng: int,
        precision: str = "double",
        max_iterations: int | None = None,
        flags: tuple[str, ...] = FAST,
    ) -> None:
        self.nv, self.ng = nv, ng
        self.library = library(nv, ng, precision, max_iterations, flags)
        self.memory = np.zeros((), memory_layout(nv, ng, precision))
        assert self.library.test_size() == self.memory.nbytes
        self.library.test_init(self._pointer)

    @property
    def _pointer(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.memory.ctypes.data)

    def __getitem__(self, name: str) -> np.ndarray:
        return np.asarray(self.memory[name])

    def load(self, H: Any, A: Any, lower: Any, upper: Any) -> None:
        """Write the data of the preparation phase; only the lower triangle of H is written."""
        inside = np.tril(np.ones((self.nv, self.nv), bool))
        self["H"][: self.nv, : self.nv][inside] = np.asarray(H)[inside]
        if self.ng:
            self["A"][:, : self.nv] = A
        self.load_bounds(lower, upper)

    def load_bounds(self, lower: Any, upper: Any) -> None:
        self["lower"][: self.nv + self.ng] = lower
        self["upper"][: self.nv + self.ng] = upper

    def factorize(self) -> str:
        return STATUSES[int(self.library.test_factorize(self._pointer))]

    def solve(self, g: Any) -> str:
        self["g"][: self.nv] = g
        return STATUSES[int(self.library.test_solve(self._pointer))]

    def run(self, H: Any, g: Any, A: Any, lower: Any, upper: Any, penalty: Any = np.inf) -> str:
        """Run both phases; return the status of the phase that failed, or that of qp_solve."""
        self.load(H, A, lower, upper)
        self["penalty"][self.nv : self.nv + self.ng] = penalty
        status = self.factorize()
        return status if status != "OK" else self.solve(g)

    def shift(self, n: int, source: Any = None) -> None:
        """Shift the predictions.

        ``source``: for each general row, the row whose prediction it takes, by default itself.
        """
        rows = np.arange(self.ng) if source is None else source
        self.library.test_shift(self._pointer, n, (ctypes.c_int * max(1, self.ng))(*rows))

    @property
    def z(self) -> np.ndarray:
        return self["z"][: self.nv].astype(float)

    @property
    def mult(self) -> np.ndarray:
        return self["mult"][: self.nv + self.ng].astype(float)


__all__ = ["FAST", "QP", "TOLERANCES", "WARNINGS", "library", "qp_dims", "source"]
