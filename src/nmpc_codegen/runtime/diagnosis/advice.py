"""What to try after a status, with the options that the package has."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.memory import Memory

#: Relative KKT residual that is as small as rounding lets solve() come on badly scaled problems.
NEARLY_SOLVED = 1e-5
#: Iterations of solve() after which more of them are not all that may help.
MANY = 50


def advice(ctrl: Memory, solved: bool, warned: bool) -> Iterator[str]:
    """What to try, the most likely remedy first.

    Args:
        ctrl: the controller.
        solved: the last call was solve().
        warned: the compiler has warned of something, which comes before advice that fits every failure.
    """
    options, status = ctrl.description.options, ctrl.status
    if status == Status.NOT_PREPARED:
        yield "call prepare() before feedback(), or step()"
    elif status == Status.NUMERICAL_FAILURE:
        yield from _numerical(options)
        yield from () if warned else _of_qp(ctrl)
    elif status == Status.NOT_CONVERGED:
        yield from _not_converged(ctrl)
    elif status in (Status.ITERATION_LIMIT, Status.STALLED, Status.SUBPROBLEM_FAILED):
        if solved:
            yield from _of_solve(ctrl, warned)
        else:
            yield from _of_qp(ctrl) if has_qp(options) else _not_converged(ctrl)


def has_qp(options: str) -> bool:
    """Whether the algorithm solves QPs."""
    return "qp=None" not in options


def row_advice(ctrl: Memory, node: int | None) -> str:
    """What to do about a row that cannot hold at a node."""
    longer = "lengthen the horizon, " if node == ctrl.dims.N else ""
    hard = "relaxation=None" in ctrl.description.options
    choose = ', or choose RealTimeIteration(relaxation="auto")' if hard else ""
    return f"{longer}widen it or the bounds of the controls, or make it soft, subject_to(..., soft=(l1, l2)){choose}"


def _numerical(options: str) -> Iterator[str]:
    if "regularization=None" in options and has_qp(options):
        yield "the Hessian may be indefinite: try ExactHessian(regularization=Mirror())"
    if "algorithm=AdjointShooting(" in options:
        yield "the simulation of the plan may have left the numbers: write controls that keep it finite to ctrl.u"
    if "precision='single'" in options:
        yield 'rounding may be the cause: try Options(precision="double")'


def _not_converged(ctrl: Memory) -> Iterator[str]:
    options = ctrl.description.options
    if "algorithm=RealTimeIteration(" in options:
        more = ": let prepare() repair the plan, RealTimeIteration(repair=3)" if "repair=0" in options else ""
        tolerance = float(_value(options, "tolerance"))
        if ctrl.stats.residual > tolerance:
            yield (
                f"residual of the plan: {ctrl.stats.residual:.3g}, above the tolerance of {tolerance:g}; one QP per "
                f"sample does not follow it{more}"
            )
        else:
            yield (
                f"the first control of a new plan still moves; the residual of the plan, {ctrl.stats.residual:.2g}, is "
                f"below the tolerance of {tolerance:g}"
            )
    else:
        name, _, given = options.partition("algorithm=")[2].partition("(")
        if ctrl.stats.residual <= float(_value(given, "tolerance")):
            near = f"the plan is near the model, residual {ctrl.stats.residual:.2g}"
            yield f"{near}, but its last step was cut or refused"
            now = _value(given, "iterations")
            count = str(3 * int(now)) if now.isdigit() else "..."
            yield f"more iterations per sample: {name}(iterations={count})"
        else:
            yield f"RealTimeIteration(), whose steps follow plans that {name} loses"
        if "AugmentedLagrangian(" in options and "repair=0" in options:
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
    if "hessian=GaussNewton(" in options and has_qp(options) and "in_solve" not in ctrl.description.members("curved"):
        yield "if that is not enough: Options(hessian=ExactHessian()), as Gauss-Newton steps ignore curvature"
    limited = list(_more_qp_iterations(options)) if status == Status.SUBPROBLEM_FAILED else []
    yield from limited
    if not warned and not limited and (count >= MANY or status != Status.ITERATION_LIMIT):
        yield "start from another plan: write ctrl.x and ctrl.u before solve()"


def _of_qp(ctrl: Memory) -> Iterator[str]:
    """What ends failures of QPs; verification/strangers/remedies.py has flown it."""
    options, choices = ctrl.description.options, ctrl.description.report.choices
    if not has_qp(options):
        return
    limited = list(_more_qp_iterations(options))
    yield from limited
    if limited:
        return
    if "fallback=None" in options:
        yield "let the interior point method take over: leave fallback=None out"
    given = "hessian=ExactHessian(" in options and not any(c.startswith("hessian:") for c in choices)
    if given and "levenberg_marquardt=0.0" in options:
        yield "leave the Hessian to the compiler, or damp it: ExactHessian(levenberg_marquardt=1e-4)"
    if not any("qp: " in c for c in choices):
        yield "leave condensing and qp to the compiler"
    if "precision='single'" in options and ctrl.status != Status.NUMERICAL_FAILURE:
        yield 'rounding may be the cause: try Options(precision="double")'


def _more_qp_iterations(options: str) -> Iterator[str]:
    """That the QP solver has a limit that was stated, and a higher one."""
    solver, _, limits = options.partition("qp=")[2].partition("(")
    limit = _value(limits, "max_iterations")
    if limit.isdigit():
        more = f"Options(qp={solver}(max_iterations={10 * int(limit)}))"
        yield f"the QP solver stops at max_iterations={limit}: {more}, or leave it out"


def _value(options: str, name: str) -> str:
    """The value of an option in the text of the options; "" if it is not there."""
    found = re.search(rf"\b{name}=([^,()]+)", options)
    return found[1] if found else ""
