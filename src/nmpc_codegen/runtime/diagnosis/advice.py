"""Advice follows from a status and the options of the package."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.memory import Memory

#: Relative KKT residual that solve() reaches on badly scaled problems in spite of rounding.
NEARLY_SOLVED = 1e-5
#: Number of iterations of solve() above which the advice is not only to allow more of them.
MANY = 50


def advice(ctrl: Memory, solved: bool, warned: bool) -> Iterator[str]:
    """Yield what to try, the most likely remedy first.

    Args:
        ctrl: the controller.
        solved: the last call was solve().
        warned: the compiler has issued warnings, which come before advice that fits every failure.
    """
    status = ctrl.status
    if status == Status.NOT_PREPARED:
        yield "call prepare() before feedback(), or step()"
    elif status == Status.NUMERICAL_FAILURE:
        yield from _numerical(ctrl)
        yield from () if warned else _of_qp(ctrl)
    elif status == Status.NOT_CONVERGED:
        yield from _advise_convergence(ctrl)
    elif status in (Status.ITERATION_LIMIT, Status.STALLED, Status.SUBPROBLEM_FAILED):
        if solved:
            yield from _of_solve(ctrl, warned)
        else:
            yield from _of_qp(ctrl) if has_qp(ctrl) else _advise_convergence(ctrl)


def has_qp(ctrl: Memory) -> bool:
    """Return True if the algorithm solves QPs."""
    return ctrl.description.options["qp"] is not None


def row_advice(ctrl: Memory, node: int | None) -> str:
    """Return what to do about a row that cannot hold at a node."""
    longer = "lengthen the horizon, " if node == ctrl.dims.N else ""
    hard = ctrl.description.options.get("algorithm.relaxation", "auto") is None
    choose = ', or choose RealTimeIteration(relaxation="auto")' if hard else ""
    return f"{longer}widen it or the bounds of the controls, or make it soft, subject_to(..., soft=(l1, l2)){choose}"


def _numerical(ctrl: Memory) -> Iterator[str]:
    options = ctrl.description.options
    if options.get("hessian.regularization", "") is None and has_qp(ctrl):
        yield "the Hessian may be indefinite: try ExactHessian(regularization=Mirror())"
    if options["algorithm"] == "AdjointShooting":
        yield "the simulation of the plan may have left the numbers: write controls that keep it finite to ctrl.u"
    if options["precision"] == "single":
        yield 'rounding may be the cause: try Options(precision="double")'


def _advise_convergence(ctrl: Memory) -> Iterator[str]:
    options = ctrl.description.options
    name, tolerance, residual = options["algorithm"], options["algorithm.tolerance"], ctrl.stats.residual
    repairs, most = options.get("algorithm.repair"), options.get("algorithm.iterations")
    if name == "RealTimeIteration":
        if residual > tolerance:
            yield (
                f"residual of the plan: {residual:.3g}, above the tolerance of {tolerance:g} after "
                f"{ctrl.stats.iterations} QPs; the next samples go on from it"
            )
        else:
            yield "at the new plan, the model or a row has no finite value"
        if most == 1:
            yield "let a sample iterate until its plan is near a solution: RealTimeIteration(iterations=10)"
        elif ctrl.stats.iterations == most:
            yield f"more of them, if the plan does not come nearer: RealTimeIteration(iterations={3 * most})"
    else:
        if residual <= tolerance:
            yield f"the plan is near the model, residual {residual:.2g}, but its last step was cut or refused"
            now = options["algorithm.iterations"]
            yield f"more iterations per sample: {name}(iterations={3 * now if now else '...'})"
        else:
            yield f"RealTimeIteration(), whose steps follow plans that {name} loses"
        if name == "AugmentedLagrangian" and repairs == 0:
            yield "let prepare() repair the plan: AugmentedLagrangian(repair=3)"
    if ctrl.description.offers("solve"):
        yield "call solve() before the first step(), or simulate(..., warm_start=True)"
    yield "if it goes on, sample more often, or bound the states where the model is strongly nonlinear"


def _of_solve(ctrl: Memory, warned: bool) -> Iterator[str]:
    options, status, kkt = ctrl.description.options, ctrl.status, ctrl.kkt()
    part = max(kkt.parts, key=lambda name: float(np.nan_to_num(kkt.parts[name], nan=np.inf)))
    count = int(ctrl.stats.sqp_iterations)
    largest = f"the largest one is that of {part}, {kkt.parts[part]:.1e} in its units"
    yield f"relative KKT residual {kkt.relative:.1e} after {count} iterations; {largest}"
    if kkt.relative < NEARLY_SOLVED:
        yield f"that is nearly a solution, and rounding may forbid less: solve(tol={2 * kkt.relative:.0e}) accepts it"
        return
    if status == Status.ITERATION_LIMIT:
        yield f"more iterations: solve(max_iterations={10 * max(count, 1)})"
    if options["hessian"] == "GaussNewton" and has_qp(ctrl) and "in_solve" not in ctrl.description.members("curved"):
        yield "if that is not enough: Options(hessian=ExactHessian()), as Gauss-Newton steps ignore curvature"
    limited = list(_more_qp_iterations(ctrl)) if status == Status.SUBPROBLEM_FAILED else []
    yield from limited
    if not warned and not limited and (count >= MANY or status != Status.ITERATION_LIMIT):
        yield "start from another plan: write ctrl.x and ctrl.u before solve()"


def _of_qp(ctrl: Memory) -> Iterator[str]:
    """Yield what ends failures of QPs; verification/strangers/remedies.py has tested this advice in closed loops."""
    options, choices = ctrl.description.options, ctrl.description.report.choices
    if not has_qp(ctrl):
        return
    limited = list(_more_qp_iterations(ctrl))
    yield from limited
    if limited:
        return
    if options.get("qp.fallback", "") is None:
        yield "let the interior point method take over: leave fallback=None out"
    if options["hessian"] == "ExactHessian" and not any(c.startswith("hessian:") for c in choices):
        yield "leave the Hessian to the compiler"
    if not any("qp: " in c for c in choices):
        yield "leave condensing and qp to the compiler"
    if options["precision"] == "single" and ctrl.status != Status.NUMERICAL_FAILURE:
        yield 'rounding may be the cause: try Options(precision="double")'


def _more_qp_iterations(ctrl: Memory) -> Iterator[str]:
    """Yield the advice to raise the limit of QP iterations, if a limit was stated."""
    options = ctrl.description.options
    limit = options.get("qp.max_iterations")
    if limit is not None:
        more = f"Options(qp={options['qp']}(max_iterations={10 * limit}))"
        yield f"the QP solver stops at max_iterations={limit}: {more}, or leave it out"
