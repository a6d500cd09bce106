"""Stage QPs put into the C of whole packages: the problem data written into the solver struct, the QP solved there.

A package is generated for the dimensions of a Shape only; its model is as short as dense patterns allow and is never
evaluated. ``build_all`` compiles several packages side by side; a package is built once per session.
"""

from __future__ import annotations

import ctypes
import functools
import os
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Online, Options
from nmpc_codegen.build import PROFILES, find_compiler
from nmpc_codegen.lower import qp_rows
from nmpc_codegen.render import render
from nmpc_codegen.status import Status
from nmpc_codegen.analyse import analyse
from tests.c_harness import memory_layout, module_of
from tests.oracles.stage_qp import Point, Shape, StageQP, rows_of

#: All that is not called from main.c is left out before it is compiled: most of a package.
FLAGS = (*PROFILES["test"].flags, "-fwhole-program", "-w")

MAIN = """
#include "q.c"
#define EXPORT __attribute__((externally_visible)) __attribute__((visibility("default")))
EXPORT int call_size(void);
EXPORT void call_init(q_solver_t *s);
EXPORT int call_prepare(q_solver_t *s);
EXPORT int call_solve(q_solver_t *s);
int call_size(void) { return (int)sizeof(q_solver_t); }
void call_init(q_solver_t *s) { memset(s, 0, sizeof *s); q_init(s); }
int call_prepare(q_solver_t *s) { return (int)condense_prepare(s); }
int call_solve(q_solver_t *s) { return (int)condense_solve(s); }
"""


def stage_ocp(shape: Shape) -> OCP:
    """An OCP of that shape with dense S, Q_k of every node, Q_N and rows."""
    ocp = OCP("q", N=shape.N)
    x, u = ocp.state("x", size=shape.nx), ocp.control("u", size=shape.nu)
    total = ca.sum1(x) + ca.sum1(u)
    ocp.dynamics(total * ca.SX.ones(shape.nx), discrete=True)
    ocp.least_squares(total, weight=[1.0])  # Q_k = W_k 1 1': the weights of the nodes differ
    ocp.terminal_least_squares(ca.sum1(x), weight=[1.0])
    if shape.free:
        ocp.free_initial(x[: shape.free])
    if shape.bounded:
        ocp.subject_to(-1, u[: shape.bounded], 1, name="control")
    of_x, of_both = ca.sum1(x), total
    kinds = (
        *(("state", x[i], "path") for i in range(shape.states)),
        *(("path", (i + 2) * of_both, "path") for i in range(shape.path)),
        *(("pure", (i + 2) * of_x, "path") for i in range(shape.pure)),
        *(("end", (i + 2 + shape.pure) * of_x, "end") for i in range(shape.end)),
    )
    for i, (kind, expression, at) in enumerate(kinds):
        ocp.subject_to(-1, expression, 1, at=at, soft=shape.penalties[i], name=f"{kind}_{i}")
    for i in range(shape.coupled):
        r = ca.sum1(ocp.at_start(ocp.x)) + (i + 2) * ca.sum1(ocp.at_end(ocp.x))
        ocp.boundary(-1, r, 1, soft=shape.penalties[len(kinds) + i], name=f"coupled_{i}")
    return ocp


@functools.cache
def build_directory() -> tempfile.TemporaryDirectory[str]:
    """One temporary directory per session; removed at exit."""
    return tempfile.TemporaryDirectory(prefix="stage_qp_")


@dataclass(frozen=True, eq=False)
class Built:
    """A loaded package: its library, the NumPy type of its struct."""

    library: ctypes.CDLL
    layout: np.dtype[Any]


@functools.cache
def _sources(shape: Shape, options: Options) -> tuple[Any, np.dtype[Any]]:
    """Texts of a package and the layout of its struct."""
    ocp = stage_ocp(shape)
    module = module_of(ocp, options, "q")
    assert module.value("NQ") == shape.N
    stated = [(r[0], int(r[1]), r[2], r[3] - shape.bounded) for r in qp_rows(analyse(ocp))]
    rows = rows_of(shape)
    assert stated == list(zip(rows.node, rows.kind, rows.index, rows.user, strict=True))
    return render(module), memory_layout(module)


def _compile(sources: Any, flags: Sequence[str]) -> Path:
    folder = Path(tempfile.mkdtemp(dir=build_directory().name))
    for name in ("q.h", "q.c"):
        (folder / name).write_text(sources[name], encoding="utf-8")
    (folder / "main.c").write_text(MAIN, encoding="utf-8")
    command = [*find_compiler(), *flags, "-shared", "-fPIC", "main.c", "-o", "library.so", "-lm"]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return folder / "library.so"


@functools.cache
def built(shape: Shape, options: Options, flags: tuple[str, ...] = FLAGS) -> Built:
    """The package of a shape with these options (condensing and qp), compiled once."""
    sources, layout = _sources(shape, options)
    library = ctypes.CDLL(str(_compile(sources, flags)))
    assert library.call_size() == layout.itemsize
    return Built(library, layout)


def build_all(wanted: Iterable[tuple[Shape, Options]], workers: int | None = None) -> None:
    """Compile packages side by side, each once: texts one after the other, compilers in parallel."""
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        list(pool.map(lambda pair: built(*pair), dict.fromkeys(wanted)))
