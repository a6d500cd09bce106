"""classify() turns an OCP into a Problem: the user's statements are classified and frozen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.algebra.resolution import Resolved, resolve
from nmpc_codegen.frontend.augmentation import Augmented, warn_of_integrals
from nmpc_codegen.frontend.checks import element_names
from nmpc_codegen.frontend.completion.first_plan import first_plan
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Algebra, Array, Problem, Row, RowKind, Stage, symbols
from nmpc_codegen.frontend.statement import At, Element, Penalty, ResidualTerm, StageName, Statement
from nmpc_codegen.ir.casadi_types import elements, part


def classify(ocp: OCP, period: float | None = None) -> Problem:
    """Return the problem that ``ocp`` states at present; the OCP may be changed and classified again.

    Args:
        ocp: the problem.
        period: time between samples, which rates at node 0 use; None: the first interval.

    Raises:
        ProblemError: a part is missing (state, control, derivative, cost), or a row constrains a measured x_0.
    """
    _require(ocp)
    warn_of_integrals(ocp)
    resolved = resolve(ocp)
    augmented = Augmented(ocp if resolved is None else resolved.ocp, period)
    ocp = augmented.ocp
    rows, path_h, terminal_h = _classify_rows(ocp)
    start = _stage(augmented, [], rows, "start")
    path = _stage(augmented, path_h, rows, "path")
    terminal = _stage(augmented, terminal_h, rows, "terminal")
    dynamics, maps, jump = augmented.dynamics()
    problem = Problem(
        name=ocp.name,
        N=ocp.N,
        dt=augmented.dt,
        states=augmented.states(),
        controls=augmented.controls(),
        parameters=augmented.parameters(),
        dynamics=dynamics,
        discrete=bool(ocp.discrete),
        start=start,
        path=path,
        terminal=terminal,
        coupled=_coupled_rows(augmented),
        rows=rows,
        free_initial=tuple(sorted(ocp.free)),
        uses=_uses(augmented, rows),
        accumulators=tuple(sorted(ocp.accumulators)),
        cyclic=tuple(sorted(ocp.cyclic_states)),
        terminal_lqr=ocp.terminal_lqr,
        time_unit=ocp.time_unit,
        augmentation=augmented.added,
        maps=maps,
        jump=jump,
        node_data=augmented.node_data(),
        algebra=None if resolved is None else _algebra(resolved, augmented, path),
    )
    return _with_first_controls(problem) if augmented.added.previous else problem


def _with_first_controls(problem: Problem) -> Problem:
    """Return the problem whose remembered controls start at those of the first plan."""
    u, states = first_plan(problem)[1], list(problem.states)
    for j, place in problem.augmentation.places.items():
        at = place - problem.augmentation.count
        states[at] = replace(states[at], value=(float(u[j]),))
    return replace(problem, states=tuple(states))


def _algebra(resolved: Resolved, augmented: Augmented, path: Stage) -> Algebra:
    """Return values and equations of algebraic variables in the symbols of the path stage."""
    z = ca.SX.sym("z", len(resolved.names))
    stated = [ca.substitute(e, resolved.newton, z) for e in (resolved.values, resolved.rest)]
    found = augmented.put_in(stated, path.x, path.u, path.p)
    p = part(path.p, 0, path.p.numel() - augmented.ocp.node_data.numel())
    values, equations = (ca.Function("of_z", [path.x, path.u, p, z], [ca.densify(e)]) for e in found)
    of_newton = resolved.names, resolved.start, resolved.scale, resolved.found, resolved.inverse
    return Algebra(tuple(d.signal for d in augmented.ocp.algebraics), values, equations, *of_newton)


def outputs_of(ocp: OCP, problem: Problem, outputs: Any, names: Any) -> tuple[tuple[str, ...], Any]:
    """Return (names, z): the outputs z = g(x, u, p) of a node in the symbols of the path stage; z may be empty.

    ``problem`` is classify(ocp), without a period.

    Raises:
        ProblemError: the outputs contain other symbols than states, controls and parameters, or the names do not fit.
    """
    if outputs is None:
        if names is not None:
            raise ProblemError("output names are given without outputs; expected outputs=expression")
        return (), ca.SX(0, 1)
    z = ocp._expression(outputs, "outputs", ("state", "control", "parameter"))
    if not z.numel():
        raise ProblemError("outputs are empty; expected an expression with at least one element, or None")
    stage = problem.path
    found = [f"z[{i}]" for i in range(z.numel())] if names is None else element_names(names, z.numel(), "outputs")
    return tuple(found), Augmented(ocp).put_in([z], stage.x, stage.u, stage.p)[0]


def _require(ocp: OCP) -> None:
    """Raise ProblemError if a part of the OCP is missing or two of its declarations clash."""
    if not ocp.states:
        raise ProblemError(f"OCP '{ocp.name}' has no state; declare one with ocp.state(name)")
    if not ocp.controls and not ocp.free:
        raise ProblemError(
            f"OCP '{ocp.name}' has no control, so there is nothing to optimise; use ocp.control(name), or "
            "ocp.free_initial(state) for components of x_0 that are to be found"
        )
    names = [e for d in ocp.states for e in d.signal.elements]
    known = {*ocp.derivatives, *ocp.maps, *ocp.slopes}
    missing = [name for i, name in enumerate(names) if i not in known]
    if missing:
        word = "next value" if ocp.discrete else "derivative"
        raise ProblemError(f"OCP '{ocp.name}': the {word} of {', '.join(missing)} is missing; use ocp.dynamics")
    if not ocp.residuals and not ocp.costs:
        raise ProblemError(
            f"OCP '{ocp.name}' has no cost; use least_squares, terminal_least_squares, stage_cost or terminal_cost"
        )
    if ocp.discrete and any(c.integrate for c in ocp.costs):
        raise ProblemError("stage_cost(integrate=True) needs continuous dynamics; a discrete map has no quadrature")
    both = sorted(ocp.free & ocp.accumulators)
    if both:
        raise ProblemError(f"state '{names[both[0]]}' cannot be both free_initial and accumulator (reset to 0)")


# Rows ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Scalar:
    """A scalar is one scalar row of a statement."""

    name: str
    expression: Any
    end: Any  # the expression at node N
    element: Element | None  # the state or control, if the expression is a single symbol
    coupled: bool
    nodes: tuple[int, ...]
    lower: float
    upper: float
    on_path: bool
    statement: Statement

    @property
    def soft(self) -> Penalty:
        return self.statement.soft

    @property
    def stated(self) -> str:
        """Return the name that the user gave, if this is one side of a row."""
        side = self.statement.side
        return self.name if self.statement.alone and side else self.name.removesuffix(f"_{side}") if side else ""


def _classify_rows(ocp: OCP) -> tuple[tuple[Row, ...], list[Any], list[Any]]:
    """Return all rows in the order of their statements, and the general rows of path and terminal stage."""
    scalars = [_take_apart(ocp, s, i) for s in ocp.statements for i in range(len(s.names))]
    bound_nodes = _simple_bounds(ocp, scalars)
    rows: list[Row] = []
    path_h: list[Any] = []
    terminal_h: list[Any] = []
    coupled = 0
    for i, s in enumerate(scalars):
        nodes, index, index_terminal = s.nodes, -1, -1
        kind: RowKind
        if s.coupled:
            kind, index, coupled = "coupled", coupled, coupled + 1
        elif i in bound_nodes:
            assert s.element is not None
            kind = "control" if s.element.kind == "control" else "state"
            index, nodes = s.element.index, bound_nodes[i]
        else:
            kind = "general"
            if nodes[0] < ocp.N:
                index = len(path_h)
                path_h.append(s.expression)
            if nodes[-1] == ocp.N:
                index_terminal = len(terminal_h)
                terminal_h.append(s.end)
        of_side = (s.soft, s.statement.scaled, s.stated, s.statement.side)
        rows.append(Row(s.name, kind, index, index_terminal, nodes, s.lower, s.upper, *of_side))
    return tuple(rows), path_h, terminal_h


def _take_apart(ocp: OCP, statement: Any, i: int) -> _Scalar:
    h, name = statement.expression[i], statement.names[i]
    end = h if statement.end is None else statement.end[i]
    bounds = float(statement.lower[i]), float(statement.upper[i])
    if statement.at is None:
        return _Scalar(name, h, h, None, True, (0, ocp.N), *bounds, False, statement)
    elements = [e for e in map(ocp.element, ca.symvar(h)) if e is not None]
    on_states = all(e.kind != "control" for e in elements)
    free = any(e.kind == "state" and e.index in ocp.free for e in elements)
    path = _path_nodes(ocp, on_states, free)
    nodes = _nodes(ocp, statement.at, path)
    if on_states and not free and nodes[0] == 0:
        raise ProblemError(
            f"row '{name}' constrains states alone at node 0, where x_0 is given; "
            "leave node 0 out, or let the solver choose them with ocp.free_initial(...)"
        )
    return _Scalar(name, h, end, ocp.element(h), False, nodes, *bounds, nodes == path, statement)


def _path_nodes(ocp: OCP, on_states: bool, free: bool) -> tuple[int, ...]:
    """Return the nodes of a path row: 0..N-1 with a control, else 1..N, and 0 if one of its states is free there."""
    if not on_states:
        return tuple(range(ocp.N))
    return tuple(range(0 if free else 1, ocp.N + 1))


def _nodes(ocp: OCP, at: At, path: tuple[int, ...]) -> tuple[int, ...]:
    if at == "path":
        return path
    if at == "start":
        return (0,)
    if at == "end":
        return (ocp.N,)
    assert isinstance(at, tuple)
    return at


def _simple_bounds(ocp: OCP, scalars: list[_Scalar]) -> dict[int, tuple[int, ...]]:
    """Return {index in ``scalars`` of a row that becomes a simple bound: nodes of the bound}.

    For a control, the bound is the first hard row over the whole path. For a state, path rows are considered first,
    then the others in the order of statement; a row becomes a bound if none of its nodes has a bound on this state yet.
    A hard equality at the end replaces the path row of its state at node N.
    """
    bounds: dict[int, tuple[int, ...]] = {}
    controls: set[int] = set()
    taken: dict[int, set[int]] = {}
    replaced: set[int] = set()
    bare = [(i, s, s.element) for i, s in enumerate(scalars) if s.element is not None]
    for i, s, element in bare:
        if element.kind == "control" and s.on_path and s.soft is None and element.index not in controls:
            controls.add(element.index)
            bounds[i] = s.nodes
        elif _end_equality(ocp, s) and element.kind == "state" and element.index not in replaced:
            replaced.add(element.index)
            taken.setdefault(element.index, set()).add(ocp.N)
            bounds[i] = s.nodes
    for on_path in (True, False):
        for i, s, element in bare:
            if element.kind != "state" or s.on_path != on_path or i in bounds:
                continue
            used = taken.setdefault(element.index, set())
            nodes = s.nodes[:-1] if on_path and element.index in replaced else s.nodes
            if not used & set(nodes):
                used.update(nodes)
                bounds[i] = nodes
    return bounds


def _end_equality(ocp: OCP, s: _Scalar) -> bool:
    return s.nodes == (ocp.N,) and s.lower == s.upper and s.soft is None


# Stages --------------------------------------------------------------------------------------------------------------


def _stage(augmented: Augmented, h: list[Any], rows: tuple[Row, ...], stage: StageName) -> Stage:
    ocp = augmented.ocp
    x, u, p, dt = symbols(augmented.nx, augmented.nu if stage == "path" else 0, augmented.np)
    residuals = [r for r in ocp.residuals if r.stage == stage]
    costs = [c for c in ocp.costs if c.stage == stage]
    nodal = [c.expression * (dt if c.scale_with_dt else 1) for c in costs if not c.integrate]
    rates = [c.expression for c in costs if c.integrate]
    empty = ca.SX(0, 1)
    stacked = ca.vertcat(empty, *(r.y for r in residuals))
    stated = [stacked, ca.vertcat(empty, *h), ca.SX(sum(nodal)), ca.SX(sum(rates))]
    y, general, cost, rate = augmented.put_in(stated, x, u, p)
    places = [{"start": -1, "path": row.index, "terminal": row.index_terminal}[stage] for row in rows]
    positions = [(place, row) for place, row in zip(places, rows, strict=True) if row.is_general]
    return Stage(
        x=x,
        u=u,
        p=p,
        dt=dt,
        y=y,
        y_names=tuple(n for r in residuals for n in r.names),
        reference=_frozen(np.concatenate([np.zeros(0), *(r.reference for r in residuals)])),
        weight=_block_diagonal([r.weight for r in residuals]),
        scale_with_dt=tuple(r.scale_with_dt for r in residuals for _ in r.names),
        cost=cost if nodal else None,
        h=general,
        y_scale=tuple(value for r in residuals for value in r.scale or (0.0,) * len(r.names)),
        h_names=tuple(row.name for position, row in positions if position >= 0),
        cost_rate=rate if rates else None,
        bare=_bare(ocp, residuals, augmented.nx) if augmented.added.held else None,
    )


def _bare(ocp: OCP, residuals: list[ResidualTerm], nx: int) -> tuple[int, ...]:
    """Return for every residual the index in (x, u) of its state or control, -1 for other expressions."""
    found = [ocp.element(r.y[i]) for r in residuals for i in range(r.y.numel())]
    first = {"state": 0, "control": nx}
    return tuple(-1 if e is None or e.kind not in first else first[e.kind] + e.index for e in found)


def _frozen(array: Array) -> Array:
    array.flags.writeable = False
    return array


def _block_diagonal(blocks: list[Array]) -> Array:
    n = sum(b.shape[0] for b in blocks)
    W, at = np.zeros((n, n)), 0
    for b in blocks:
        W[at : at + b.shape[0], at : at + b.shape[0]] = b
        at += b.shape[0]
    return _frozen(W)


def _coupled_rows(augmented: Augmented) -> Any:
    ocp = augmented.ocp
    r = [s.expression for s in ocp.statements if s.at is None]
    if not r:
        return None
    x0, xN = ca.SX.sym("x_0", augmented.nx), ca.SX.sym("x_N", augmented.nx)
    old, new = (
        ca.vertcat(ocp.x_start, ocp.x_end),
        ca.vertcat(*elements(x0)[: augmented.own], *elements(xN)[: augmented.own]),
    )
    return ca.Function("r", [x0, xN], [ca.densify(ca.substitute(ca.vertcat(*r), old, new))], ["x_0", "x_N"], ["r"])


def _uses(augmented: Augmented, rows: tuple[Row, ...]) -> frozenset[str]:
    ocp, added = augmented.ocp, augmented.added
    used = {
        "previous controls": bool(added.previous),
        "time": added.time,
        "blocks of controls": bool(added.held),
        "discrete states": bool(ocp.maps),
        "soft rows": any(r.soft is not None for r in rows),
        "rows with an infinite penalty": any(r.soft is not None and r.hard for r in rows),
        "coupled rows": any(r.is_coupled for r in rows),
        "rows that couple x_N with free components of x_0": any(r.is_coupled for r in rows) and bool(ocp.free),
        "free initial state": bool(ocp.free),
        "general cost": bool(ocp.costs),
        "integrated cost": any(c.integrate for c in ocp.costs),
        "accumulators": bool(ocp.accumulators),
        "nonlinear algebraic equations": bool(ocp.node_data.numel()),
    }
    return frozenset(name for name, is_used in used.items() if is_used)
