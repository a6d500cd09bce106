"""What to try after a status, with the options that the package has."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from nmpc_codegen.runtime.status import Status

if TYPE_CHECKING:
    from nmpc_codegen.runtime.controller import Controller

#: Relative KKT residual that is as small as rounding lets solve() come on badly scaled problems.
NEARLY_SOLVED = 1e-5


def advice(ctrl: Controller, solved: bool) -> Iterator[str]:
    """What to try; ``solved``: the last call was solve()."""
    options, status = ctrl.description.options, ctrl.status
    if status == Status.NOT_PREPARED:
        yield "call prepare() before feedback(), or step()"
    elif status == Status.NUMERICAL_FAILURE:
        yield from _numerical(options)
    elif status == Status.NOT_CONVERGED:
        yield from _not_converged(ctrl)
    elif status in (Status.ITERATION_LIMIT, Status.STALLED, Status.SUBPROBLEM_FAILED):
        yield from _of_solve(ctrl) if solved else _of_qp(ctrl)


def row_advice(ctrl: Controller) -> str:
    """What to do about a row that cannot hold."""
    hard = "relaxation=None" in ctrl.description.options
    choose = ', or choose RealTimeIteration(relaxation="auto")' if hard else ""
    return f"make it soft, soft=(l1, l2), or widen it{choose}"


def _numerical(options: str) -> Iterator[str]:
    if "regularization=None" in options:
        yield "the Hessian may be indefinite: try ExactHessian(regularization=Mirror())"
    elif "hessian=GaussNewton(" in options and "levenberg_marquardt=0.0" in options:
        yield "if a control has no weight, give it one, or try Options(hessian=GaussNewton(levenberg_marquardt=1e-8))"
    if "precision='single'" in options:
        yield 'rounding may be the cause: try Options(precision="double")'
    yield "scale states, controls and rows to magnitudes near 1"
    yield from _another_qp(options)


def _not_converged(ctrl: Controller) -> Iterator[str]:
    options, sampled = ctrl.description.options, "algorithm=RealTimeIteration(" in ctrl.description.options
    if sampled:
        yield (
            f"residual of the plan that was linearised: {ctrl.stats.residual:.2g}, tolerance "
            f"{_value(options, 'tolerance')}; one QP per sample does not follow it"
        )
        if "repair=0" in options:
            yield "let prepare() repair the plan: RealTimeIteration(repair=3)"
    else:
        name = options.partition("algorithm=")[2].partition("(")[0]
        yield f"the plan is far from its rows or the model: more iterations per sample, {name}(iterations=...)"
    if "solve" in {e.name for e in ctrl.description.entry_points}:
        yield "call solve() before the first step(), or simulate(..., warm_start=True)"
    yield "sample more often, or bound the states"


def _of_solve(ctrl: Controller) -> Iterator[str]:
    options, status, kkt = ctrl.description.options, ctrl.status, ctrl.kkt()
    part = max(kkt.parts, key=lambda name: float(np.nan_to_num(kkt.parts[name], nan=np.inf)))
    count = int(ctrl.stats.sqp_iterations)
    largest = f"the largest part is {part}, {kkt.parts[part]:.1e}"
    yield f"relative KKT residual {kkt.relative:.1e} after {count} iterations; {largest}"
    if kkt.relative < NEARLY_SOLVED:
        yield f"that is nearly a solution: solve(tol={2 * kkt.relative:.0e}) accepts it"
        return
    if status == Status.ITERATION_LIMIT:
        yield f"more iterations: solve(max_iterations={10 * max(count, 1)})"
    if "hessian=GaussNewton(" in options and "in_solve" not in ctrl.description.members("curved"):
        yield "Gauss-Newton steps ignore curvature and may cycle: try Options(hessian=ExactHessian())"
    if status == Status.SUBPROBLEM_FAILED:
        yield from _more_qp_iterations(options)
        yield from _another_qp(options)
        yield "scale states, controls and rows to magnitudes near 1"
    yield "start from another plan: write ctrl.x and ctrl.u before solve()"


def _of_qp(ctrl: Controller) -> Iterator[str]:
    options = ctrl.description.options
    if ctrl.status == Status.ITERATION_LIMIT:
        yield from _more_qp_iterations(options)
    yield from _another_qp(options)
    yield "scale states, controls and rows to magnitudes near 1"


def _more_qp_iterations(options: str) -> Iterator[str]:
    """That the QP solver has a limit, and a higher one."""
    solver, _, limits = options.partition("qp=")[2].partition("(")
    limit = _value(limits, "max_iterations")
    if limit.isdigit():
        more = f"Options(qp={solver}(max_iterations={10 * int(limit)}))"
        yield f"the QP solver stops at max_iterations={limit}: try {more}"


def _another_qp(options: str) -> Iterator[str]:
    """Another way to solve the QP than the one in force."""
    if "qp=" not in options:
        return
    if "condensing=NoCondensing(" not in options:
        yield "try another QP solver: Options(condensing=NoCondensing())"
    elif "qp=RiccatiActiveSet(" in options:
        yield "try another QP solver: Options(condensing=NoCondensing(), qp=RiccatiInteriorPoint())"
    else:
        yield "try another QP solver: Options(condensing=NoCondensing(), qp=RiccatiActiveSet())"


def _value(options: str, name: str) -> str:
    """The value of an option in the text of the options; "" if it is not there."""
    found = re.search(rf"\b{name}=([^,()]+)", options)
    return found[1] if found else ""
