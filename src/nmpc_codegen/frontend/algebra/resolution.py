"""The algebraic variables of an OCP are replaced by expressions z(x, u, p).

Variables that Newton's method solves for have symbols z and W = -(dr/dz)^-1 at a node, which are data of the node like
parameters. Two steps with the same W start from z:

    z_1 = z + W r(x, z, u, p),   z_2 = z_1 + W r(x, z_1, u, p)

Value, first and second derivatives of z_2 with respect to (x, u) are those of the solution where r(x, z, u, p) = 0,
because each step makes one more order of them exact. With W = 0, z_2 is z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.algebra import newton
from nmpc_codegen.frontend.algebra.elimination import Solved, Unknown, solve_equations
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.frontend.statement import Declared, Statement
from nmpc_codegen.package.signals import list_some


@dataclass(frozen=True, eq=False)
class Resolved:
    """The OCP ``ocp`` has no algebraic variables any more.

    values: all of them, in its symbols and those of ``newton``, for which Newton's method solves ``rest`` = 0; names,
    start, scale: of the latter; found: their values at the first plan, NaN if Newton's method finds none; inverse: 1
    where W may be nonzero.
    """

    ocp: OCP
    values: Any
    newton: Any
    rest: Any
    names: tuple[str, ...]
    start: tuple[float, ...]
    scale: tuple[float, ...]
    found: Array
    inverse: Array


def resolve(ocp: OCP) -> Resolved | None:
    """Replace the algebraic variables of an OCP; return None if there are neither algebraic nor implicit equations.

    Raises:
        ProblemError: the equations do not determine the variables.
    """
    implied = [i for i in ocp.slopes if i not in ocp.derivatives]
    if not (ocp.algebraics or ocp.equations or implied):
        return None
    stated = [i for i in ocp.slopes if i in ocp.derivatives]
    known = ca.vertcat(ca.SX(0, 1), *(ocp.slopes[i] for i in stated))
    values = ca.vertcat(ca.SX(0, 1), *(ocp.derivatives[i] for i in stated))
    equations = [replace(e, expression=ca.substitute(e.expression, known, values)) for e in ocp.equations]
    unknowns = [Unknown(ocp.slopes[i], str(ocp.slopes[i]), 0.0) for i in implied]
    unknowns += [Unknown(*each) for each in _scalars(ocp.algebraics)]
    known_values = _known_values(ocp)
    x, u, _, *others = (symbol for symbol, _ in known_values)
    moving = ca.vertcat(x, u, *others)
    solved = solve_equations(unknowns, equations, known_values, moving)
    return _without(ocp, unknowns, implied, solved)


def _scalars(declared: Sequence[Declared]) -> list[tuple[Any, str, float]]:
    return [
        (d.symbol[i], name, value)
        for d in declared
        for i, (name, value) in enumerate(zip(d.signal.elements, d.signal.value, strict=True))
    ]


def _known_values(ocp: OCP) -> list[tuple[Any, Array]]:
    """Return states, controls, parameters and all other symbols of equations, with their values at the first plan."""
    u = _first_controls(ocp)
    before = sorted(ocp.remembered)
    first = 1.0 if ocp.dt is None else ocp.dt[0]
    x, p = (np.array([v for d in of for v in d.signal.value]) for of in (ocp.states, ocp.parameters))
    symbols = ca.vertcat(ca.SX(0, 1), *(ocp.remembered[j] for j in before))
    return [
        (ocp.x, x),
        (ocp.u, u),
        (ocp.p, p),
        (symbols, u[before]),
        (ocp.interval_before, np.array([first])),
        (ocp.clock, np.zeros(1)),
    ]


def _first_controls(ocp: OCP) -> Array:
    """Return the controls at their references, 0 without a reference, clipped to their bounds."""
    u = np.zeros(ocp.u.numel())
    for r in (r for r in ocp.residuals if r.stage == "path"):
        for i in range(r.y.numel()):
            element = ocp.element(r.y[i])
            if element is not None and element.kind == "control":
                u[element.index] = r.reference[i]
    for s in ocp.statements:
        for i in range(s.expression.numel()):
            element = ocp.element(s.expression[i])
            if element is not None and element.kind == "control":
                u[element.index] = np.clip(u[element.index], s.lower[i], s.upper[i])
    return u


def _without(ocp: OCP, unknowns: Sequence[Unknown], implied: Sequence[int], solved: Solved) -> Resolved:
    """Return the OCP with the unknowns replaced by expressions."""
    twin = object.__new__(type(ocp))
    twin.__dict__ |= ocp.__dict__
    twin.__dict__ |= {"_elements": dict(ocp._elements), "remembered": dict(ocp.remembered)}
    v = ca.vertcat(*(each.symbol for each in unknowns))
    own = [unknowns[i].symbol for i in solved.newton]
    z = ca.vertcat(ca.SX(0, 1), *own)
    sizes = np.array(_sizes(ocp, len(implied), solved))[list(solved.newton)]
    at = np.where(np.isfinite(solved.at), solved.at, [each.initial for each in unknowns])[list(solved.newton)]
    rest = solved.rest * ca.DM(_factors(solved.rest, (z, at), _known_values(ocp), sizes)) if own else solved.rest
    W = ca.SX.sym("W", len(own), len(own))
    point = newton.chord_steps(lambda at: ca.substitute(rest, z, at), z, W, solved.inverse)[-1] if own else z
    path = ca.substitute(ca.vertcat(*solved.values), z, point)
    end = _at_the_end(twin, path)
    _refuse_maps(ocp, ca.substitute(ca.vertcat(ca.SX(0, 1), *ocp.maps.values()), v, path), z)

    def with_path(e: Any) -> Any:
        return ca.substitute(e, v, path)

    def with_end(e: Any) -> Any:
        return ca.substitute(e, v, end)

    of_stage = {"path": with_path, "terminal": with_end, "start": with_path}
    slopes = dict(zip(implied, ca.vertsplit(path)[: len(implied)], strict=True))
    twin.__dict__ |= {
        "derivatives": {i: with_path(e) for i, e in ocp.derivatives.items()} | slopes,
        "maps": {i: with_path(e) for i, e in ocp.maps.items()},
        "residuals": [replace(r, y=of_stage[r.stage](r.y)) for r in ocp.residuals],
        "costs": [replace(c, expression=of_stage[c.stage](c.expression)) for c in ocp.costs],
        "statements": [_statement(ocp, s, with_path, with_end) for s in ocp.statements],
        "node_data": ca.vertcat(z, ca.vec(W.T)),
    }
    return Resolved(
        ocp=twin,
        values=ca.vertcat(ca.SX(0, 1), *solved.values[len(implied) :]),
        newton=z,
        rest=rest,
        names=tuple(unknowns[i].name for i in solved.newton),
        start=tuple(unknowns[i].initial for i in solved.newton),
        scale=tuple(map(float, sizes)),
        found=solved.at[list(solved.newton)],
        inverse=solved.inverse,
    )


def _refuse_maps(ocp: OCP, values: Any, z: Any) -> None:
    """Raise ProblemError if the next value of a discrete state depends on variables of Newton's method."""
    names = [name for d in ocp.states for name in d.signal.elements]
    for i, value in zip(ocp.maps, ca.vertsplit(values), strict=True):
        if z.numel() and ca.depends_on(value, z):
            found = list_some([str(each) for each in ca.symvar(value) if ca.depends_on(each, z)])
            raise ProblemError(
                f"dynamics: the next value of '{names[i]}' depends on {found}, for which no expression is known "
                "(the equations are not linear in it); expected states, controls and parameters"
            )


def _at_the_end(twin: OCP, values: Any) -> Any:
    """Return the expressions for node N, in which the controls of node N - 1 replace u."""
    places = [e.index for e in map(twin.element, ca.symvar(values)) if e is not None and e.kind == "control"]
    if not places:
        return values
    return ca.substitute(values, twin.u[places], twin.previous(twin.u[places]))


def _statement(ocp: OCP, s: Statement, with_path: Any, with_end: Any) -> Statement:
    """Return a row in which variables are replaced; at node N it contains no control."""
    if s.at is None:
        return s
    if s.at == "end":
        return replace(s, expression=with_end(s.expression))
    last = isinstance(s.at, tuple) and ocp.N in s.at
    return replace(s, expression=with_path(s.expression), end=with_end(s.expression) if last else None)


def _sizes(ocp: OCP, implied: int, solved: Solved) -> list[float]:
    """Return the sizes of the unknowns: declared, else their magnitude at the first plan, else their start, else 1.

    A magnitude that is a rounding error does not count.
    """
    declared = [v for d in ocp.algebraics for v in d.signal.scale or (0.0,) * d.signal.size]
    initial = [v for d in ocp.algebraics for v in d.signal.value]
    return [
        stated or (abs(at) if abs(at) > newton.ROUNDING * (abs(start) or 1) and abs(at) < np.inf else abs(start)) or 1.0
        for stated, at, start in zip([0.0] * implied + declared, solved.at, [0.0] * implied + initial, strict=True)
    ]


def _factors(rest: Any, z: tuple[Any, Array], given: Sequence[tuple[Any, Array]], sizes: Array) -> Array:
    """Return powers of 2 that scale the equations so that their terms at the first plan have the sizes of z."""
    symbols, values = zip(z, *given, strict=True)
    at = ca.Function("slopes", list(symbols), [ca.densify(ca.jacobian(rest, z[0]))])
    with np.errstate(all="ignore"):
        terms = np.max(np.abs(np.asarray(at(*values), dtype=float)) * sizes, axis=1)
        found = np.exp2(np.round(np.log2(sizes / terms)))
    return np.where(np.isfinite(found) & (found > 0.0), found, 1.0)
