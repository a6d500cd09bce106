"""Stage QPs are solved in the C of complete packages, whose solver structs receive the problem data.

A package is generated only for the dimensions of a Shape; its model is as short as dense patterns allow and is never
evaluated. ``build_all`` compiles several packages side by side; a package is built once per session.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import os
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Online, Options
from nmpc_codegen.compiler import text_of
from nmpc_codegen.components import condensing, qp
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.compilers import find_compiler
from verification.c_harness import memory_layout, module_of
from verification.oracles.stage_qp import (
    Array,
    Point,
    Shape,
    StageQP,
    condition,
    distance,
    objective_error,
    residuals,
    rows_of,
)
from verification.oracles.stage_qp_random import SEMIDEFINITE, condensed_rows

MAIN = """
#include "stage.c"
#if defined(__clang__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT __attribute__((externally_visible)) __attribute__((visibility("default")))
#endif
EXPORT int call_size(void);
EXPORT void call_init(stage_solver_t *s);
EXPORT int call_prepare(stage_solver_t *s);
EXPORT int call_solve(stage_solver_t *s);
int call_size(void) { return (int)sizeof(stage_solver_t); }
void call_init(stage_solver_t *s) { stage_init(s); }
int call_prepare(stage_solver_t *s) { return (int)condense_prepare(s); }
int call_solve(stage_solver_t *s) { return (int)condense_solve(s); }
"""


def solvers() -> dict[str, Options]:
    """Return the options of every matching pair of condensing and generated QP solver, by "condensing+qp"."""
    ours = [q for q in qp.REGISTRY.values() if q is not qp.Osqp]
    pairs = itertools.product(condensing.REGISTRY.values(), ours)
    return {f"{c.name}+{q.name}": solver_options(c(), q()) for c, q in pairs if c.gives == q.takes}


def holds(options: Options, shape: Shape) -> bool:
    """Return False for stages with rows that couple x_N with free components of x_0, which the compiler refuses."""
    return not (shape.coupled and shape.free) or options.condensing == condensing.FullCondensing()


def solver_options(condense: Any, solver: Any) -> Options:
    """Return options in which every node has its own bounds and weight."""
    return Options(condensing=condense, qp=solver, online=Online(weight="node", bounds="node"))


def stage_ocp(shape: Shape) -> OCP:
    """Return the OCP of an OCP of that shape with dense S, Q_k of every node, Q_N and rows.

    Its stable model's data are replaced.
    """
    ocp = OCP("stage", N=shape.N)
    x, u = ocp.state("x", size=shape.nx), ocp.control("u", size=shape.nu)
    total = ca.sum1(x) + ca.sum1(u)
    ocp.dynamics(total / (2 * shape.nx) * ca.SX.ones(shape.nx), discrete=True)
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


GIVEN_UP = (Status.ITERATION_LIMIT, Status.STALLED, Status.NUMERICAL_FAILURE)

# Limits of wrong_answer(): relative residuals of stage QPs in double precision, and of the minimiser (docs: 1e-7).
STATIONARITY, DYNAMICS, FEASIBILITY, ROWS, OBJECTIVE, MINIMISER = 1e-8, 1e-9, 1e-8, 1e-7, 1e-8, 1e-7


def wrong_answer(qp: StageQP, p: Point) -> str:
    """Return the faults of a point that should be the optimum, with their figures; empty if there is none.

    Residuals and objective are always checked; the minimiser to 1e-7 max(1, 1e-8 condition) if it is unique.
    """
    r = residuals(qp, p)
    for name, limit in (("stationarity", STATIONARITY), ("dynamics", DYNAMICS), ("feasibility", FEASIBILITY)):
        if not getattr(r, name) <= limit:
            return f"{name} {getattr(r, name):.1e}"
    if not r.rows <= ROWS:
        return f"complementarity {r.rows:.1e}"
    error = objective_error(qp, p)
    if not error <= OBJECTIVE:
        return f"objective {error:.1e}"
    error = distance(qp, p) if qp.unique else 0.0
    if error <= MINIMISER:
        return ""
    exact = condition(qp, exact=True)
    return "" if error <= MINIMISER * 1e-8 * exact else f"minimiser {error:.1e}, condition {exact:.1e}"


def wrong_certificate(qp: StageQP, weights: Array) -> str:
    """Return the faults of weights of (du, rows): the same combination of their bounds must be negative for all du.

    weights' (du, A du) <= weights' bounds < -|weights' (I, A)| reach;  reach: bound of |du|, 1000 where there is none.
    """
    A, value = condensed_rows(qp)
    rest = weights[: A.shape[1]] + weights[A.shape[1] :] @ A
    lower = np.concatenate([(qp.lower_u - qp.u).ravel(), qp.lower - value])
    upper = np.concatenate([(qp.upper_u - qp.u).ravel(), qp.upper - value])
    used = weights != 0
    bound = np.where(weights > 0, upper, lower)[used]
    if not np.all(np.isfinite(bound)):
        return "certificate with an infinite bound"
    largest = np.maximum(np.abs(lower), np.abs(upper))[: A.shape[1]]
    total = float(weights[used] @ bound + np.abs(rest) @ np.where(np.isfinite(largest), largest, 1e3))
    return "" if total < 0 else f"certificate proves nothing: {total:.1e}"


@functools.cache
def build_directory() -> tempfile.TemporaryDirectory[str]:
    """Return the temporary directory of this process, which is removed at exit."""
    return tempfile.TemporaryDirectory(prefix="stage_qp_")


@dataclass(frozen=True, eq=False)
class Built:
    """A built package has its library and the NumPy type of its struct."""

    library: ctypes.CDLL
    layout: np.dtype[Any]


def _sources(shape: Shape, options: Options) -> tuple[Any, np.dtype[Any]]:
    """Return the texts of a package and the layout of its struct."""
    ocp = stage_ocp(shape)
    module = module_of(ocp, options, "stage")
    assert module.value("NQ") == shape.N
    stated = [(k, kind, index, user - shape.bounded) for k, kind, index, user in classify(ocp).qp_rows]
    rows = rows_of(shape)
    assert stated == list(zip(rows.node, rows.kind, rows.index, rows.user, strict=True))
    return text_of(module), memory_layout(module)


def _compile(sources: Any, folder: Path) -> Path:
    for name in ("stage.h", "stage.c"):
        (folder / name).write_text(sources[name], encoding="utf-8")
    (folder / "main.c").write_text(MAIN, encoding="utf-8")
    compiler = find_compiler()
    # gcc drops functions that main.c does not call before it compiles them: most of a package.
    alone = ("-fwhole-program",) if "gcc" in compiler[0] else ()
    command = [
        *compiler,
        *PROFILES["test"].flags,
        *alone,
        "-w",
        "-shared",
        "-fPIC",
        "main.c",
        "-o",
        "library.so",
        "-lm",
    ]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return folder / "library.so"


@functools.cache
def generated(shape: Shape, options: Options) -> tuple[Any, np.dtype[Any], Path]:
    """Return texts, layout and folder of the package of a shape.

    CasADi counts references to its objects without locks, so call it in the thread that uses CasADi, before built() in
    another one.
    """
    return *_sources(shape, options), Path(tempfile.mkdtemp(dir=build_directory().name))


@functools.cache
def built(shape: Shape, options: Options) -> Built:
    """Return the package of a shape with these options (condensing and qp), compiled once."""
    sources, layout, folder = generated(shape, options)
    library = ctypes.CDLL(str(_compile(sources, folder)))
    assert library.call_size() == layout.itemsize
    return Built(library, layout)


def build_all(wanted: Iterable[tuple[Shape, Options]], workers: int | None = None) -> None:
    """Compile packages in parallel, each once, after their texts have been generated here."""
    wanted = list(dict.fromkeys(wanted))
    for pair in wanted:
        generated(*pair)
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        list(pool.map(lambda pair: built(*pair), wanted))


def write_qp(memory: Any, qp: StageQP) -> None:
    """Write all data of a QP except its bounds and dx_0 to a solver struct whose rows are those of the QP."""
    N, nx, rows = qp.shape.N, qp.shape.nx, qp.rows
    node, terminal, hessian = (memory[name] for name in ("node", "terminal", "hessian"))
    memory["x"], memory["u"] = qp.x, qp.u
    node["S"], node["b"], node["g"] = qp.S, qp.b, qp.g
    terminal["g"] = qp.g_N
    hessian["Q"], hessian["Q_N"] = np.tril(qp.Q[: len(hessian["Q"])]), np.tril(qp.Q_N)
    path = (rows.kind == 1) & (rows.node < N)
    if path.any():
        node["h"][rows.node[path], rows.index[path]] = qp.c[path]
        node["J"][rows.node[path], rows.index[path]] = qp.C[path]
    end, both = (rows.kind == 1) & (rows.node == N), rows.kind == 2
    if end.any():
        terminal["h"][rows.index[end]], terminal["J"][rows.index[end]] = qp.c[end], qp.C[end, :nx]
    if both.any():
        coupled = memory["coupled"]
        coupled["r"][rows.index[both]], coupled["J_0"][rows.index[both]] = qp.c[both], qp.C0[both]
        coupled["J_N"][rows.index[both]] = qp.C[both, :nx]


class StageSolver:
    """A stage solver runs preparation and feedback phase of the generated C for a stage QP, in one solver struct."""

    def __init__(self, shape: Shape, options: Options) -> None:
        self.shape, self.package = shape, built(shape, options)
        self.memory = np.zeros((), self.package.layout)
        self.rows = rows_of(shape)
        self.reset()

    @property
    def pointer(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.memory.ctypes.data)

    def reset(self) -> None:
        """Reset as after init: no working set is predicted."""
        self.package.library.call_init(self.pointer)

    def load(self, qp: StageQP) -> None:
        """Write all data that the preparation phase reads, and the bounds."""
        write_qp(self.memory, qp)
        self.load_bounds(qp)

    def load_bounds(self, qp: StageQP) -> None:
        """Write the bounds of controls and rows at their nodes (those of coupled rows at node N), if there are any."""
        n = self.shape.bounded
        if n + len(self.rows) == 0:
            return
        for name, of_u, of_rows in (("lower", qp.lower_u, qp.lower), ("upper", qp.upper_u, qp.upper)):
            self.memory[name][:-1, :n] = of_u[:, :n]
            self.memory[name][self.rows.node, n + self.rows.user] = of_rows

    def solve(self, qp: StageQP) -> Status:
        """Run both phases; return the status of the phase that failed, or that of the second."""
        self.load(qp)
        prepared = Status(self.package.library.call_prepare(self.pointer))
        return prepared if prepared != Status.OK else self.feedback(qp)

    def feedback(self, qp: StageQP) -> Status:
        """Run the second phase for dx_0 and the bounds of the QP; free entries of dx_0 are NaN."""
        self.load_bounds(qp)
        dx0 = qp.dx0.copy()
        dx0[: self.shape.free] = np.nan
        self.memory["step"]["dx"][0] = dx0
        return Status(self.package.library.call_solve(self.pointer))

    @property
    def point(self) -> Point:
        """Return the step and the multipliers of the last feedback."""
        step, n = self.memory["step"], len(self.rows)
        mult = step["mult"][:n].copy() if n else np.zeros(0)  # no member of the struct without rows
        return Point(step["dx"].copy(), step["du"].copy(), step["mult_u"].copy(), mult)

    @property
    def certificate(self) -> Array | None:
        """Return weights of the bounds of du, then of the rows, that contradict one another.

        None if there are none for du.
        """
        weights = self.memory["qp"]["certificate"]
        n = self.shape.N * self.shape.nu
        if len(weights) != n + max(1, len(self.rows)):
            return None
        return np.array(weights[: n + len(self.rows)]) if np.any(weights) else None

    def verdict(self, qp: StageQP, status: Status) -> str:
        """Return the faults of the last answer, or "". With a singular reduced Hessian the solver may fail."""
        if status == Status.OK:
            return wrong_answer(qp, self.point) if qp.optimum is not None else "OK though infeasible"
        if qp.optimum is None and status == Status.INFEASIBLE:
            weights = self.certificate
            return "" if weights is None else wrong_certificate(qp, weights)
        if qp.kind == SEMIDEFINITE and status in GIVEN_UP:
            return ""
        return status.name

    @property
    def iterations(self) -> int:
        return int(self.memory["qp"]["iterations"])
