"""States behind those of the user: what a node knows of the one before it, and its time.

    d_{k+1} = dt_k,   t_{k+1} = t_k + dt_k     (t' = 1 along an interval),   v_{k+1} = u_k

Their maps are constant, so that kernels, integrators and second derivatives stay as they are; at node 0 they are known.
"""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError, warn
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, Inner, Problem, Row, Signal, Stage, symbols
from nmpc_codegen.frontend.scales import Scales, scales
from nmpc_codegen.ir.casadi_types import Expression, Function, elements

#: Derivatives below this are rounding errors.
EQUAL = 1e-9


def inner_of(ocp: OCP) -> Inner:
    """The states that the expressions of the OCP need."""
    found = {symbol.element_hash() for expression in _expressions(ocp) for symbol in ca.symvar(expression)}
    held = tuple(sorted(ocp.blocks))
    previous = (j for j in sorted(ocp.remembered) if j in held or ocp.remembered[j].element_hash() in found)
    rates, time = (symbol.element_hash() in found for symbol in (ocp.interval_before, ocp.clock))
    return Inner(tuple(previous), rates, time, held, idle=not ocp.controls)


def control_signals(ocp: OCP) -> tuple[Signal, ...]:
    """The controls; one that acts on nothing where a problem has components of x_0 alone to choose."""
    found = tuple(d.signal for d in ocp.controls)
    return found or (Signal("none", 1, "", (0.0,), 0, True, (1.0,)),)


def block_starts(ocp: OCP) -> Array | None:
    """(N + 1, held controls): 1 where a block begins."""
    if not ocp.blocks:
        return None
    found = np.zeros((ocp.N + 1, len(ocp.blocks)))
    for i, j in enumerate(sorted(ocp.blocks)):
        found[np.cumsum((0, *ocp.blocks[j])), i] = 1.0
    return found


def block_signals(ocp: OCP) -> tuple[Signal, ...]:
    """The parameters that say where blocks begin."""
    names = [e for d in ocp.controls for e in d.signal.elements]
    first = ocp.p.numel()
    return tuple(
        Signal(f"block start({names[j]})", 1, "", (1.0,), first + i, True) for i, j in enumerate(sorted(ocp.blocks))
    )


def effective_controls(ocp: OCP, x: Expression, u: Expression, p: Expression) -> Expression:
    """The controls that act at a node: u_j where a block begins, else that of the node before."""
    inner, own, first = inner_of(ocp), ocp.x.numel(), ocp.p.numel()
    acting = [] if inner.idle else elements(u)
    for i, j in enumerate(inner.held):
        begins, before = p[first + i], x[own + inner.places[j]]
        acting[j] = begins * u[j] + (1 - begins) * before
    return ca.vertcat(ca.SX(0, 1), *acting)


def _with_ties(problem: Problem, sizes: Scales) -> Problem:
    """The problem with residuals that tie controls to those of the node before where no block begins."""
    held, path = problem.inner.held, problem.path
    ties = []
    for i, j in enumerate(held):
        begins = path.p[problem.np - len(held) + i]
        before = path.x[problem.measured + problem.inner.places[j]]
        weight = float(np.sqrt(sizes.cost)) / float(sizes.z[problem.nx + j])
        ties.append(weight * (1 - begins) * (path.u[j] - before))
    return replace(problem, path=replace(path, ties=ca.vertcat(*ties)))


def _expressions(ocp: OCP) -> list[Expression]:
    return [
        *ocp.derivatives.values(),
        *ocp.maps.values(),
        *(r.y for r in ocp.residuals),
        *(c.expression for c in ocp.costs),
        *(s.expression for s in ocp.statements),
    ]


def inner_symbols(ocp: OCP) -> list[Expression]:
    """The symbols of the OCP for these states."""
    inner = inner_of(ocp)
    previous = [ocp.remembered[j] for j in inner.previous]
    return [*([ocp.interval_before] * inner.interval), *([ocp.clock] * inner.time), *previous]


def inner_signals(ocp: OCP, path: Stage, rows: tuple[Row, ...], dt: tuple[float, ...]) -> tuple[Signal, ...]:
    """These states with what they are at first: references of controls inside their bounds, the first interval, 0."""
    inner, offset = inner_of(ocp), ocp.x.numel()
    names = [(e, d.signal.unit) for d in ocp.controls for e in d.signal.elements]
    found: list[tuple[str, str, float, tuple[float, ...]]] = []
    found += [("interval before", ocp.time_unit, dt[0], (dt[0],))] * inner.interval
    found += [("time", ocp.time_unit, 0.0, (sum(dt),))] * inner.time
    found += [(f"previous({names[j][0]})", names[j][1], _first_control(path, rows, j), ()) for j in inner.previous]
    return tuple(
        Signal(name, 1, unit, (value,), offset + i, True, scale) for i, (name, unit, value, scale) in enumerate(found)
    )


def _first_control(path: Stage, rows: tuple[Row, ...], j: int) -> float:
    """The reference of a control, 0 without one, inside its bounds."""
    place = path.y_elements.index(path.nx + j) if path.nx + j in path.y_elements else -1
    value = float(path.reference[place]) if place >= 0 else 0.0
    for row in rows:
        if row.kind == "control" and row.index == j:
            value = float(np.clip(value, row.lower, row.upper))
    return value


def dynamics_of(ocp: OCP, path: Stage, dt: tuple[float, ...]) -> tuple[Function, tuple[int, ...], Function | None]:
    """The dynamics f(x, u, p), with the derivative 0 of states that are maps; their positions and their values at the
    next node (x, u, p, dt). A discrete map has these states in itself.

    Raises:
        ProblemError: a discrete map on a grid of different intervals asks for their lengths.
    """
    inner, own, nu = inner_of(ocp), ocp.x.numel(), path.nu
    x, u, p, length = symbols(path.nx, nu, ocp.p.numel() + len(inner.held))
    acting = effective_controls(ocp, x, u, p)
    old = ca.vertcat(ocp.x, *inner_symbols(ocp), ocp.u, ocp.p)
    new = ca.vertcat(x, acting, *elements(p)[: ocp.p.numel()])
    stated = {**ocp.derivatives, **ocp.maps}
    f = elements(ca.substitute(ca.vertcat(*(stated[i] for i in range(own))), old, new))
    if ocp.discrete and (inner.interval or inner.time) and len(set(dt)) > 1:
        raise ProblemError(f"OCP '{ocp.name}': time and rate() of a discrete map require intervals of one length")
    step = ca.SX(dt[0]) if ocp.discrete else length
    controls = [acting[j] for j in inner.previous]
    time = [x[own + inner.interval] + step] if inner.time else []
    if ocp.discrete:
        return _function("f", [x, u, p], [*f, *([step] * inner.interval), *time, *controls]), (), None
    clock = own + inner.interval if inner.time else -1
    maps = (*sorted(ocp.maps), *(i for i in range(own, path.nx) if i != clock))
    jumps = [*(f[i] for i in sorted(ocp.maps)), *([step] * inner.interval), *controls]
    rates = [*(ca.SX(0) if i in ocp.maps else f[i] for i in range(own))]
    rates += [ca.SX(int(i == clock)) for i in range(own, path.nx)]
    return _function("f", [x, u, p], rates), maps, _function("g", [x, u, p, length], jumps) if maps else None


def _function(name: str, inputs: list[Expression], values: list[Expression]) -> Function:
    return ca.Function(name, inputs, [ca.densify(ca.vertcat(*values))], ["x", "u", "p", "dt"][: len(inputs)], [name])


def complete_inner(problem: Problem, sampling_time: float | None) -> Problem:
    """The problem with what is known of these states when the time between samples is known."""
    problem = _with_interval_before(problem, sampling_time)
    if problem.inner.idle:
        return replace(problem, path=replace(problem.path, ties=problem.path.u))
    return _with_ties(problem, scales(problem)) if problem.inner.held else problem


def _with_interval_before(problem: Problem, sampling_time: float | None) -> Problem:
    """The problem with the time since the sample before as the length of the interval before node 0, and without such
    lengths where all are the same."""
    if not problem.inner.interval:
        return problem
    at, period = problem.measured, sampling_time or problem.dt[0]
    if not problem.uniform or period != problem.dt[0]:
        timed = (replace(s, value=(period,)) if s.offset == at else s for s in problem.states)
        return replace(problem, states=tuple(timed))
    kept = [i for i in range(problem.nx) if i != at]

    def without(x: Expression) -> Expression:
        """x with the length at its place, from a vector without it."""
        parts = elements(x)
        return ca.vertcat(*parts[:at], problem.dt[0], *parts[at:])

    def stage(old: Stage) -> Stage:
        x = ca.SX.sym("x", len(kept))

        def reduce(value: Expression) -> Expression:
            return ca.densify(ca.substitute(value, old.x, without(x)))

        return replace(
            old,
            x=x,
            y=reduce(old.y),
            h=reduce(old.h),
            cost=None if old.cost is None else reduce(old.cost),
            cost_rate=None if old.cost_rate is None else reduce(old.cost_rate),
            bare=None if old.bare is None else tuple(i - (i > at) for i in old.bare),
        )

    x, u, p, dt = symbols(len(kept), problem.nu, problem.np)
    f = problem.dynamics(without(x), u, p)[kept]
    maps = tuple(i - (i > at) for i in problem.maps if i != at)
    jump = None
    if problem.jump is not None and maps:
        values = problem.jump(without(x), u, p, dt)[[n for n, i in enumerate(problem.maps) if i != at]]
        jump = _function("g", [x, u, p, dt], [values])
    coupled = None
    if problem.coupled is not None:
        x_0, x_N = ca.SX.sym("x_0", len(kept)), ca.SX.sym("x_N", len(kept))
        coupled = ca.Function("r", [x_0, x_N], [problem.coupled(without(x_0), without(x_N))], ["x_0", "x_N"], ["r"])
    states = [replace(s, offset=s.offset - (s.offset > at)) for s in problem.states if s.offset != at]
    return replace(
        problem,
        states=tuple(states),
        dynamics=_function("f", [x, u, p], [f]),
        start=stage(problem.start),
        path=stage(problem.path),
        terminal=stage(problem.terminal),
        coupled=coupled,
        inner=replace(problem.inner, interval=False),
        maps=maps,
        jump=jump,
    )


#: Names of states that are meant to be controls of the node before.
_MEANT = re.compile(r"(^|_)(last|prev|previous|old|before|delayed)(_|$|\d)", re.IGNORECASE)


def warn_of_integrals(ocp: OCP) -> None:
    """Warn of a state that is meant to remember a control and integrates it: last' = u, and u - last in the problem."""
    names = [e for d in ocp.states for e in d.signal.elements]
    for i, derivative in sorted(ocp.derivatives.items()):
        control = ocp.element(derivative)
        if ocp.discrete or control is None or control.kind != "control":
            continue
        u, x = ocp.u[control.index], ocp.x[i]
        compared = any(_is_difference(e, u, x) for expression in _expressions(ocp) for e in elements(expression))
        if compared or _MEANT.search(names[i]):
            warn(
                f"dynamics: '{names[i]}' is the integral of {control.name}, not its last value; the control of the "
                f"node before is ocp.previous({control.name}), its slope ocp.rate({control.name})"
            )


def _is_difference(expression: Expression, u: Expression, x: Expression) -> bool:
    """True if the expression depends on u and x through u - x alone."""
    found = {s.element_hash() for s in ca.symvar(expression)}
    if not {u.element_hash(), x.element_hash()} <= found:
        return False
    change = ca.jacobian(expression, u) + ca.jacobian(expression, x)
    free = ca.symvar(change)
    at = ca.Function("change", [ca.vertcat(ca.SX(0, 1), *free)], [ca.densify(change)])
    draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, len(free)))
    return all(abs(float(at(draw))) < EQUAL for draw in draws)
