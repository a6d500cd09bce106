"""Controller.diagnose() says what happened, where, and what to try with the options in force."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nmpc_codegen.package.program import NOT_FINITE, Array, in_words, locate
from nmpc_codegen.package.status import STALE, Status
from nmpc_codegen.runtime.diagnosis.advice import advice, has_qp, row_advice
from nmpc_codegen.runtime.diagnosis.plan_rows import parameters, plan_data, violations
from nmpc_codegen.runtime.diagnosis.poles import unstable_poles
from nmpc_codegen.runtime.memory import Memory

#: Relative KKT residual of a sample above which the Hessian of the samples, if solve() has another one, may be the
# cause.
FAR_FROM_OPTIMAL = 0.01
#: Gaps of a state below this value, relative to its scale and its largest value, explain no failure.
SMALL_GAP = 1e-6
#: Variables above this value, relative to their scale, show that the cost is unbounded below.
ENDLESS = 1e6
#: Largest number of lines of one kind, and of states in a list.
MOST, LISTED = 3, 12

#: Words before a warning of the compiler.
WARNED = "warning at build: "

#: Words in warnings that concern the first plan, and the number of samples after which they no longer matter.
FIRST_PLAN, EARLY = "first plan", 3

#: Statuses that a number that is not finite can cause.
_OF_NUMBERS = (Status.NUMERICAL_FAILURE, Status.STALLED, Status.ITERATION_LIMIT, Status.SUBPROBLEM_FAILED)
#: Statuses of calls that have evaluated nothing.
_BEFORE = (Status.OK, Status.NOT_FINITE, Status.NOT_PREPARED)


def diagnosis(ctrl: Memory, measured: Array, solved: bool) -> str:
    """Explain why the last call of a Controller was not OK, with node, state or row by name, and what to try.

    Args:
        ctrl: the controller.
        measured: the measured state (nx,) of that call.
        solved: the last call was solve().
    """
    status = ctrl.status
    stale = [_stale(ctrl)] if ctrl.stats.stale_hessian else []
    if status == Status.OK:
        spoilt = [f"since then: {text}" for text in _plan(ctrl)]
        return "\n".join([str(status), *spoilt, *_explain_plan(ctrl), *stale])
    broken = next(filter(None, (list(search) for search in _broken(ctrl, measured))), [])
    warned = [f"{WARNED}{text}" for text in _warnings(ctrl, solved) if not (broken and text.startswith(NOT_FINITE))]
    endless = [] if broken else [*_runaway(ctrl)]
    tried = [] if broken or endless else [*advice(ctrl, solved, bool(warned))]
    where = [] if broken or endless else [*_poles(ctrl), *_violated_rows(ctrl, solved), *_largest_gap(ctrl, solved)]
    found = [*broken, *endless, *where]
    return "\n".join(dict.fromkeys([_headline(ctrl, solved, bool(broken)), *found, *tried, *warned, *stale]))


def _warnings(ctrl: Memory, solved: bool) -> tuple[str, ...]:
    """Return the warnings of the compiler that still matter."""
    if ctrl.status in _BEFORE:
        return ()
    late = not solved and ctrl.member("samples").size and int(ctrl.member("samples")) > EARLY
    return tuple(text for text in ctrl.description.report.warnings if not (late and FIRST_PLAN in text))


def _headline(ctrl: Memory, solved: bool, broken: bool) -> str:
    """Return the status and its meaning, as far as it is known."""
    status = ctrl.status
    if broken and status == Status.NUMERICAL_FAILURE:
        return f"{status.name}: a number is not finite; the control is safe but not optimal"
    if not solved and has_qp(ctrl) and status in (Status.ITERATION_LIMIT, Status.STALLED):
        why = "stopped at its limit of iterations" if status == Status.ITERATION_LIMIT else "made no further progress"
        return f"{status.name}: the QP of the sample {why}; the control is safe but not optimal"
    return str(status)


def solves_exactly(ctrl: Memory) -> bool:
    """Return True if solve() has an exact Hessian, and samples the Gauss-Newton one."""
    return ctrl.description.options["hessian"] == "GaussNewton" and "in_solve" in ctrl.description.members("curved")


def _explain_plan(ctrl: Memory) -> list[str]:
    """Explain a plan that is not optimal, which may be due to the steps of the samples."""
    if not np.any(ctrl.member("samples")) or not has_qp(ctrl) or not ctrl.kkt().relative > FAR_FROM_OPTIMAL:
        return []
    remedy = ""
    if ctrl.description.options["hessian"] == "GaussNewton":
        remedy = (
            ": where it does not fall from sample to sample, Gauss-Newton steps leave the optimum that solve() finds: "
            "try Options(hessian=ExactHessian())"
        )
    return [f"the plan is not optimal, relative KKT residual {ctrl.kkt().relative:.1e}{remedy}"]


def _stale(ctrl: Memory) -> str:
    """Explain STALE, and list the parameters, bounds and penalties that differ from the declared ones."""
    description, changed = ctrl.description, []
    p, declared = ctrl.member("p"), [v for s in description.parameters for v in s.value]
    if p.size:
        differs = np.any(p[:, : len(declared)] != np.asarray(declared, dtype=p.dtype), axis=0)
        changed += [name for name, other in zip(ctrl.names.parameters, differs, strict=True) if other]
    for i, row in enumerate(description.rows if ctrl.member("lower").size else ()):
        bounds = ((ctrl.view("lower")[:, i], row.lower), (ctrl.view("upper")[:, i], row.upper))
        if any(np.any(present != present.dtype.type(bound)) for present, bound in bounds):
            changed.append(row.name)
    soft = [row for row in description.rows if row.soft is not None]
    for i, row in enumerate(soft if ctrl.member("soft_l1").size else ()):
        penalties = zip((ctrl.view("soft_l1"), ctrl.view("soft_l2")), row.soft or (), strict=True)
        if any(np.any(present[:, i] != present.dtype.type(value)) for present, value in penalties):
            changed.append(f"the penalty of {row.name}")
    return f"{STALE} (not at their declared values: {', '.join(changed)})" if changed else STALE


# -- what is not finite -----------------------------------------------------------------------------------------------


def _broken(ctrl: Memory, measured: Array) -> Iterator[Iterator[str]]:
    """Yield searches for numbers that are not finite; the first search that finds one explains the failure."""
    if ctrl.status == Status.NOT_FINITE:
        yield _find_measured(ctrl, measured)
    yield _plan(ctrl)
    if ctrl.status == Status.NOT_CONVERGED or ctrl.description.newton:
        yield _stages(ctrl)
    if ctrl.status in _OF_NUMBERS:
        yield _domains(ctrl)
        yield _stages(ctrl)
        yield _model(ctrl)
        yield _linearisation(ctrl)


def _find_measured(ctrl: Memory, measured: Array) -> Iterator[str]:
    unknown = [n for n, v in zip(ctrl.names.states, measured, strict=True) if not np.isfinite(v)]
    if unknown:
        yield f"measured {', '.join(unknown)} is not finite: hand over the last good value, or an estimate"


def _stages(ctrl: Memory) -> Iterator[str]:
    """Yield the stage of an implicit scheme whose equations could not be solved."""
    found = ctrl.member("failed_interval")
    if not found.size or int(found) < 0:
        return
    interval, step, stage = (int(ctrl.member(f"failed_{name}")) for name in ("interval", "step", "stage"))
    reason, sizes = int(ctrl.member("failed_state")), ctrl.description.sizes
    nx, count = sizes["NX"], sizes["NXA"]
    what = "the Newton matrix is singular" if reason < count else "Newton's method does not converge"
    number = reason % count
    name = f"state {ctrl.names.states[number]}" if number < nx else ctrl.description.newton[number - nx]
    if step < 0:
        yield (
            f"the algebraic equations are not solved at node {interval}: {what}: {name}; check the model there, or "
            "give another initial="
        )
        return
    first = stage * sizes["GROUP"] + 1
    stages = f"stage {first}" if sizes["GROUP"] == 1 else f"stages {first} to {first + sizes['GROUP'] - 1}"
    yield (
        f"{what} in interval {interval}, step {step + 1}, {stages}: {name}; "
        "check the model there, or take more steps: ImplicitRungeKutta(steps=...), "
        "--set integrator=implicit_runge_kutta --set integrator.steps=..."
    )


def _plan(ctrl: Memory) -> Iterator[str]:
    """Yield the first number of the plan or of the parameters that is not finite."""
    names = ctrl.names
    for what, array, columns, remedy in (
        ("state", ctrl.x, names.states, "of the plan is not finite: call reset(), or write the plan"),
        ("control", ctrl.u, names.controls, "of the plan is not finite: call reset(), or write the plan"),
        ("parameter", parameters(ctrl), names.parameters, "is not finite: set_parameter()"),
    ):
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            node, i = bad[0]
            yield f"{what} {columns[i]} at node {node} {remedy}"
            return


def _domains(ctrl: Memory) -> Iterator[str]:
    """Yield operations without a finite value or derivative at the plan, and what to write instead."""
    second = ctrl.description.options["hessian"] == "ExactHessian" or solves_exactly(ctrl)
    x, u = (np.asarray(v, dtype=np.float64) for v in (ctrl.whole_x, ctrl.u))
    found = locate(ctrl.description.program, x, u, plan_data(ctrl), second)
    yield from list(in_words(found))[:MOST]


def _model(ctrl: Memory) -> Iterator[str]:
    """Yield the first interval over which the model yields no finite state."""
    for k, end in enumerate(_ends(ctrl)):
        bad = [name for name, value in zip(ctrl.names.states, end, strict=True) if not np.isfinite(value)]
        if bad:
            pairs = zip(ctrl.names.states, ctrl.x[k], strict=True)
            start = ", ".join(f"{name} = {value:.4g}" for name, value in list(pairs)[:LISTED])
            first = "check the measured state and its units; " if k == 0 else "bound the states; "
            yield (
                f"the model yields no finite {', '.join(bad)} at the end of interval {k}, from {start}: {first}or take "
                "more integration steps"
            )
            return


#: Members of the struct of a linearised node.
_PARTS = ("b", "S", "h", "J", "g")


def _linearisation(ctrl: Memory) -> Iterator[str]:
    """Yield the first interval whose linearisation is not finite; it may belong to a plan that was given up since."""
    first: dict[str, int] = {}
    for part in _PARTS:
        if part in ctrl.description.members("node"):
            array = ctrl.view(f"node.{part}")
            bad = np.flatnonzero(~np.isfinite(array.reshape(ctrl.dims.N, -1)).all(axis=1))
            if len(bad):
                first[part] = int(bad[0])
    if first:
        part = min(first, key=lambda name: first[name])
        k = first[part]
        what, parts = _part(ctrl, part, k)
        suspects = [o.text for o in ctrl.description.program.operations if any(q.name in parts for q in o.quantities)]
        look = f" (look at {', '.join(dict.fromkeys(suspects[:MOST]))})" if suspects else ""
        yield (
            f"not finite in the plan that was linearised: {what}{look}; the plan has been restarted at the measured "
            "state; if that happens again, check what writes to ctrl.x and ctrl.u, and bound the states"
        )


def _part(ctrl: Memory, part: str, k: int) -> tuple[str, list[str]]:
    """Return which numbers are not finite in a member of linearised node ``k``, and the quantities they belong to."""
    if part == "g":
        found = {q.name for o in ctrl.description.program.operations for q in o.quantities}
        return f"gradient of the cost at node {k}", [name for name in found if "residual" in name or "cost" in name]
    values = ctrl.view(f"node.{part}")[k]
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    if part in "hJ":
        rows = [r.name for r in ctrl.description.rows if r.is_general and r.index >= 0 and bad[r.index]]
        words = f"{'derivatives of ' if part == 'J' else ''}row {', '.join(map(repr, rows))} at node {k}"
        return words, [f"row {name!r}" for name in rows]
    states = [name for name, is_bad in zip(ctrl.names.states, bad, strict=False) if is_bad]
    parts = [f"the {kind} of {name}" for name in states for kind in ("equation", "map")]
    listed = ", ".join(states)
    return f"state {listed} at node {k + 1}" if part == "b" else f"derivatives of {listed} at node {k + 1}", parts


# -- where it is far from a solution ----------------------------------------------------------------------------------


def _runaway(ctrl: Memory) -> Iterator[str]:
    """Yield the variables without bounds along which the cost decreases without limit."""
    if ctrl.status not in _OF_NUMBERS or not ctrl.cost < 0:
        return
    names = (*ctrl.names.states, *ctrl.names.controls)
    bounded = {row.name: np.isfinite(row.lower) and np.isfinite(row.upper) for row in ctrl.description.rows}
    most = np.concatenate([np.max(np.abs(ctrl.x), axis=0), np.max(np.abs(ctrl.u), axis=0)])
    relative = most / np.asarray(ctrl.description.scales)
    for i in np.argsort(-relative)[:MOST]:
        if relative[i] > ENDLESS and not bounded.get(names[i], False):
            yield (
                f"the cost falls without limit along {names[i]}, which has come to {most[i]:.2g}: give it a bound, "
                f"subject_to(lower, {names[i]}, upper)"
            )


def _poles(ctrl: Memory) -> Iterator[str]:
    """Yield a pole of the model that its scheme does not damp, after a plan that could not be followed."""
    if ctrl.status == Status.NOT_CONVERGED or ctrl.status in _OF_NUMBERS:
        yield from unstable_poles(ctrl)


def _violated_rows(ctrl: Memory, solved: bool) -> Iterator[str]:
    """Yield the hard rows that the last QP, or the plan, violates most."""
    status, stats = ctrl.status, ctrl.stats
    if status in (Status.INFEASIBLE, Status.RELAXED) and stats.violated_row is not None:
        worst = f"row {stats.violated_row!r} at node {stats.violated_node} is violated by {stats.violation:.3g}"
        yield f"{worst}: {row_advice(ctrl, stats.violated_node)}"
        others = [] if status == Status.INFEASIBLE and not solved else violations(ctrl)
        more = [str(v) for v in others if v.row.name != stats.violated_row][: MOST - 1]
        if more:
            yield f"of the plan, also {'; '.join(more)}"
        if solved and status == Status.INFEASIBLE:
            yield "that is so near the plans that were tried: another guess, written to ctrl.x and ctrl.u, may lead on"
    elif status not in _BEFORE:
        yield from map(str, violations(ctrl)[:MOST])


def _ends(ctrl: Memory) -> list[Array]:
    """Return the ends of all intervals, integrated with the parameters of their nodes.

    integrate() takes the parameters of node 0, so they are replaced for each interval.
    """
    stored = ctrl.member("p")
    own = len(stored) == ctrl.dims.N + 1
    first, known, found = stored[:1].copy(), ctrl.known.copy(), []
    try:
        for k, dt in enumerate(ctrl.description.dt):
            if own:
                stored[0] = stored[k]
            ctrl.known[:] = ctrl.whole_x[k, ctrl.dims.nx :]
            found.append(np.array(ctrl.integrate(ctrl.x[k], ctrl.u[k], dt)))
    finally:
        stored[:1], ctrl.known[:] = first, known
    return found


def _largest_gap(ctrl: Memory, solved: bool) -> Iterator[str]:
    """Yield where the plan is farthest from the model, relative to the state's scale and largest value."""
    if ctrl.status in (Status.INFEASIBLE, Status.RELAXED) or not (solved or ctrl.status == Status.NOT_CONVERGED):
        return
    gaps = np.abs(np.asarray(_ends(ctrl), dtype=np.float64) - ctrl.x[1:])
    relative = gaps / (np.asarray(ctrl.description.scales[: ctrl.dims.nx]) + np.max(np.abs(ctrl.x), axis=0))
    if np.all(np.isfinite(relative)) and np.max(relative) >= SMALL_GAP:
        node, i = divmod(int(np.argmax(relative)), relative.shape[1])
        state = f"{ctrl.names.states[i]} at node {node + 1}"
        yield f"the plan misses the model most in state {state}: by {gaps[node, i]:.3g}"
