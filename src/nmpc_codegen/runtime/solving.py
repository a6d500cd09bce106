"""solve() of a controller iterates to convergence and logs its iterations."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Kkt, Status
from nmpc_codegen.runtime.given import is_integer, is_positive
from nmpc_codegen.runtime.memory import Memory
from nmpc_codegen.runtime.records import iterations
from nmpc_codegen.runtime.records.iterations import Iteration
from nmpc_codegen.runtime.records.one_plan import Plan, take_plan

Array = NDArray[Any]
Globalization = Literal["filter", "full_step"]
MULTIPLIERS = ("lam", "mu_x", "mu_u", "mu", "mu_N", "eta")


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """The result of solve(); arrays are copies, and multipliers are positive at upper, negative at lower bounds.

    print(solution) shows status, cost, iterations, time, KKT residuals, first control, shapes.

    Attributes:
        status: OK if the KKT residual is at most ``tol``.
        x: (N+1, nx), states.
        u: (N, nu), controls.
        z: (N+1, number), algebraic variables, at node N with u_{N-1}.
        lam: (N+1, nx), multipliers: lam[0] belongs to x_0 = xhat, lam[k+1] to x_{k+1} = Phi_k.
        mu_x: (N+1, nx), multipliers of bounds of states.
        mu_u: (N, nu), multipliers of bounds of controls.
        mu: (N, nh), multipliers of the general rows of the path.
        mu_N: (nh_N,), multipliers of the general rows of the end.
        eta: (number,), multipliers of coupled rows.
        cost: cost of the plan.
        kkt: KKT residuals of the plan.
        iterations: number of iterations of the SQP method.
        time_ns: computing time (ns).
        controls: names of the controls.
        log: one entry per iteration; convergence_table() prints it.
        plan: the plan with its rows, bounds and references, for plot().
    """

    status: Status
    x: Array
    u: Array
    z: Array
    lam: Array
    mu_x: Array
    mu_u: Array
    mu: Array
    mu_N: Array
    eta: Array
    cost: float
    kkt: Kkt
    iterations: int
    time_ns: int
    controls: tuple[str, ...] = ()
    log: tuple[Iteration, ...] = ()
    plan: Plan | None = None

    def convergence_table(self, file: str | os.PathLike[str] | None = None) -> str:
        """Return the iterations as text in aligned columns; write them to ``file``, comma-separated, if it is given.

        The columns are cost, KKT residuals by parts and relative, length of the step, shift of the Hessian, iterations
        of the QP, active bounds and rows.
        """
        if file is not None:
            Path(file).write_text(iterations.write_csv(self.log), encoding="utf-8")
        return iterations.table(self.log)

    def plot(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot the plan over its nodes, as Log.plot() does; write the figure to ``file`` if it is given.

        The figure shows states, controls, algebraic variables and rows, with bounds and references.

        Raises:
            ExtraError: matplotlib is not installed.
        """
        if self.plan is None:
            raise ControllerError("plot(): this solution was not made by solve()")
        from nmpc_codegen.pictures.plans import draw_plan

        title = f"{self.plan.name}: {self.status.name} after {self.iterations} iterations, cost {self.cost:.6g}"
        return draw_plan(self.plan, title, self.status != Status.OK, file)

    def _repr_html_(self) -> str:
        from nmpc_codegen.pictures.notebook import of_solution

        return of_solution(self.plan, self.kkt, "\n".join(str(self).splitlines()[:-2]))

    def plot_convergence(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot residuals, step lengths and shifts of all iterations; write the figure to ``file`` if it is given.

        Raises:
            ControllerError: there is no iteration.
            ExtraError: matplotlib is not installed.
        """
        if not self.log:
            raise ControllerError("plot_convergence(): solve() took no iteration; expected at least one")
        from nmpc_codegen.pictures import convergence

        title = f"{self.status.name} after {self.iterations} iterations, cost {self.cost:.6g}"
        return convergence.draw(self.log, title, self.status != Status.OK, file)

    def __str__(self) -> str:
        names = self.controls or tuple(f"u[{j}]" for j in range(self.u.shape[1]))
        first = ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, self.u[0], strict=True))
        return "\n".join(
            (
                str(self.status),
                f"cost {self.cost:.8g} after {self.iterations} iterations, {self.time_ns / 1e3:.1f} us",
                f"KKT: {self.kkt}",
                f"first control: {first}",
                f"x {self.x.shape}, u {self.u.shape}",
            )
        )

    def __repr__(self) -> str:
        sizes = f"x {self.x.shape}, u {self.u.shape}"
        return f"<Solution {self.status.name}: cost {self.cost:.8g}, {self.iterations} iterations, {sizes}>"


@dataclass
class _Run:
    """A run has the log of the iterations so far, and their time."""

    log: list[Iteration]
    time_ns: int = 0


#: Precision -> default tolerance of the KKT residual.
TOLERANCE = {"double": 1e-8, "single": 1e-4}


def limits(precision: str, tol: float | None, max_iterations: int) -> tuple[float, int]:
    """Return tolerance and largest number of iterations of solve(); raise ControllerError if one is wrong."""
    tol = TOLERANCE[precision] if tol is None else tol
    if not is_positive(tol):
        raise ControllerError(f"tol is {tol!r}; expected a positive number")
    if not is_integer(max_iterations) or not 1 <= max_iterations < 2**31:
        raise ControllerError(f"max_iterations is {max_iterations!r}; expected an integer >= 1 of 32 bits")
    return float(tol), int(max_iterations)


def solve(ctrl: Memory, tol: float | None, max_iterations: int, globalization: Globalization) -> Solution:
    """Iterate from the present plan for the state last measured; see Controller.solve()."""
    tol, max_iterations = limits(ctrl.description.precision, tol, max_iterations)
    methods = {"filter": (_search, "solve"), "full_step": (_full_steps, "feedback")}
    if globalization not in methods:
        raise ControllerError(f"globalization is {globalization!r}; expected 'filter' or 'full_step'")
    method, function = methods[globalization]
    name = ctrl.description.name
    if not ctrl.description.offers(function):
        raise ControllerError(
            f"{name} was exported without {function}(): by Options(solve=False) (--set solve=False), or with an "
            "algorithm that has none"
        )
    run = _Run([])
    status = method(ctrl, run, tol, max_iterations)
    parts = {part: np.array(getattr(ctrl, part, ())) for part in ("x", "u", "z", *MULTIPLIERS)}
    return Solution(
        status,
        **parts,
        cost=ctrl.cost,
        kkt=ctrl.kkt(),
        iterations=_count(ctrl, "sqp_iterations"),
        time_ns=run.time_ns,
        controls=ctrl.names.controls,
        log=tuple(run.log),
        plan=take_plan(ctrl),
    )


def _search(ctrl: Memory, run: _Run, tol: float, most: int) -> Status:
    """Run the iterations in C, one by one if the package can resume them."""
    status = Status.ITERATION_LIMIT
    steps = "resumes" in ctrl.description.members("sqp")
    for last in range(1 if steps else most, most + 1):
        if steps:
            ctrl.view("sqp.resumes")[...] = last > 1
        before = _count(ctrl, "sqp_iterations") if last > 1 else 0
        start = perf_counter_ns()
        status = ctrl.call_solve(tol, last)
        run.time_ns += perf_counter_ns() - start
        if steps and _count(ctrl, "sqp_iterations") > before:
            length = float(ctrl.view("trial.length"))
            run.log.append(_entry(ctrl, ctrl.kkt(), length, bool(ctrl.view("sqp.restoring"))))
        if status != Status.ITERATION_LIMIT:
            break
    if steps:
        ctrl.view("sqp.resumes")[...] = 0
    return status


def _full_steps(ctrl: Memory, run: _Run, tol: float, most: int) -> Status:
    """Repeat the real-time iteration for the same state, without shifting the plan."""
    members = ctrl.description.members("solver")
    left = {name: ctrl.view(name).copy() for name in ("previous", "time", "time_rest") if name in members}
    usual = ctrl.member("most_iterations").copy()
    ctrl.member("most_iterations")[...] = 1
    try:
        return _repeat(ctrl, run, tol, most, left)
    finally:
        ctrl.member("most_iterations")[...] = usual
        ctrl.member("solved")[...] = 1


def _repeat(ctrl: Memory, run: _Run, tol: float, most: int, left: Mapping[str, Array]) -> Status:
    members = ctrl.description.members("solver")
    for number in range(1, most + 1):
        if "samples" in members:
            ctrl.view("samples")[...] = 0
        start = perf_counter_ns()
        status = ctrl.call_iteration()
        run.time_ns += perf_counter_ns() - start
        for name, value in left.items():
            ctrl.view(name)[...] = value
        if "stats" in members:
            ctrl.view("stats.sqp_iterations")[...] = number
        if status != Status.OK:
            return status
        run.log.append(_entry(ctrl, ctrl.kkt(), 1.0, False))
        kkt = run.log[-1].kkt
        if (max(kkt.parts.values()) if np.isnan(kkt.relative) else kkt.relative) <= tol:
            return status
    ctrl.view("status")[...] = Status.ITERATION_LIMIT
    return Status.ITERATION_LIMIT


def _entry(ctrl: Memory, kkt: Kkt, length: float, restoring: bool) -> Iteration:
    active = sum(int(np.count_nonzero(ctrl.member(part))) for part in ("mu_u", "mult"))
    shift = float(ctrl.view("curved.used")) if "curved" in ctrl.description.members("solver") else 0.0
    return Iteration(kkt, length, _count(ctrl, "qp_iterations"), active, restoring, ctrl.cost, shift)


def _count(ctrl: Memory, name: str) -> int:
    """Return a counter of the last call, 0 if the algorithm has none; residuals are not included."""
    return int(ctrl.view(f"stats.{name}")) if name in ctrl.description.members("stats") else 0
