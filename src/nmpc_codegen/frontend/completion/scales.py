"""Scales are values of the quantities of a problem that are neither small nor large.

The scale of a state or control is ``scale=`` if declared. Otherwise the scale is the largest of half the width of the
finite bounds (the magnitude of a single bound; bounds beyond NO_BOUND do not count), the initial value, and references
of residuals that equal the state or control. If a state has none of these, its scale is the change that a control of
its own scale causes in one interval, but at least a small fraction of the change over the horizon without exponential
growth. If a control has none, its scale is the change that changes a state by the state's scale over the horizon; else
1. Scales are rather too small than too large. Terms of rows, residuals and costs get the sizes that follow from their
variables. No scale depends on data of a sample, so that rounding errors never become scales.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from nmpc_codegen.frontend.problem import Array, Problem, Stage, symbols
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.kernel import Instruction, Kernel, Port, lift, opcode_name
from nmpc_codegen.ir.lookup_calls import known_lookup
from nmpc_codegen.package.program import VALUES

#: Least scale of a state without declared data, relative to the change that a control causes over the horizon.
LITTLE = 1e-3
#: Declared values up to this one, relative to that change, are rounding errors, as in a computed initial state.
ROUNDING = 1e-9
#: Bounds of at least this magnitude stand for no bound and do not count.
NO_BOUND = 1e10


@dataclass(frozen=True, eq=False)
class Scales:
    """The scales are the sizes of a problem.

    z: (nx + nu,), scales of states and controls. rows: (rows,), sizes of the terms of a row without its constant part,
    which is in offsets (rows,) and belongs to its bounds. cost: C, the largest cost of a residual or general cost of
    its own size. forces: (nx + nu,), sizes of the gradient of the cost, sqrt(C H), where H is the curvature of the
    variable itself, at least that of the least cost in its scale: a change by the fraction t changes the cost by t^2 C.
    reach: (nx, nu), the largest change of a state over the horizon if a control changes by 1, in a linear model.
    """

    z: Array
    rows: Array
    offsets: Array
    cost: float
    forces: Array
    reach: Array


class _Start:
    """The point at which expressions are evaluated: initial state, references of the controls, longest interval."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.x, self.dt = problem, problem.x_initial, max(problem.dt)
        self._u = problem.reference_controls, np.zeros(0)
        self._p = tuple(problem.node_values(self.x, u) for u in self._u)

    def of(self, stage: Stage) -> tuple[Array, Array, Array, float]:
        """Return the values of x, u, p and dt for expressions of a stage."""
        end = not stage.nu
        return self.x, self._u[end], self._p[end], self.dt


def scales(problem: Problem) -> Scales:
    """Compute the sizes of a problem from its declarations."""
    start = _Start(problem)
    soon, reach = _responses(start)
    z = _complete_scales(problem, soon, reach)
    rows, offsets = _row_sizes(start, z)
    costs, own = _costs(start, z)
    positive = costs[np.isfinite(costs) & (costs > 0.0)]
    cost = (float(positive.max()), float(positive.min())) if positive.size else (1.0, 1.0)
    with np.errstate(over="ignore"):
        forces = np.sqrt(cost[0] * np.maximum(own, cost[1])) / z
    return Scales(z, rows, offsets, cost[0], forces, reach)


def round_scales(values: ArrayLike) -> list[float]:
    """Return scales rounded to three significant digits."""
    return [float(f"{v:.3g}") for v in np.ravel(values)]


def stated_scales(problem: Problem) -> Array:
    """Return the declared scales of (x, u), 0 where none is declared."""
    return np.array([v for s in (*problem.states, *problem.controls) for v in s.scale or (0.0,) * s.size])


def _declared_scales(problem: Problem) -> Array:
    """Return scales of (x, u) that bounds and references define, 0 where they do not."""
    nx = problem.nx
    found = np.zeros(nx + problem.nu)
    for row in problem.rows:
        if (i := row.variable(nx)) is not None:
            found[i] = max(found[i], _width(row.lower, row.upper))
    for stage in (problem.path, problem.terminal):
        for place, value in stage.targets(problem.data):
            found[place] = max(found[place], abs(value))
    return found


def _width(lower: float, upper: float) -> float:
    """Return half the distance of two bounds.

    A single bound, or two equal ones, give their magnitude; bounds that stand for no bound give 0.
    """
    known = [abs(b) for b in (lower, upper) if abs(b) < NO_BOUND]
    half = (upper - lower) / 2
    return half if len(known) == 2 and half > 0.0 else max(known, default=0.0)


def _complete_scales(problem: Problem, soon: Array, reach: Array) -> Array:
    """Return the scales of (x, u): declared ones, those of bounds, references and initial values, and derived ones.

    Derived scales follow from the effect of a control on a state.
    """
    nx, stated, z = problem.nx, stated_scales(problem), _declared_scales(problem)
    initial = np.abs(problem.x_initial)
    z = np.where(stated > 0.0, stated, z)
    known = np.where(stated[:nx] > 0.0, stated[:nx], np.maximum(z[:nx], initial))
    for j in np.flatnonzero(z[nx:] == 0.0):
        needed = [known[i] / reach[i, j] for i in range(problem.measured) if known[i] > 0.0 and reach[i, j] > 0.0]
        z[nx + j] = min(needed, default=0.0)
    z[nx:][~(np.isfinite(z[nx:]) & (z[nx:] > 0.0))] = 1.0
    moved = np.max(np.maximum(soon, LITTLE * reach) * z[nx:], axis=1, initial=0.0)
    computed = initial <= ROUNDING * moved  # an initial value that is a rounding error
    found = np.where(computed & (z[:nx] == 0.0), moved, known)
    z[:nx] = np.where(np.isfinite(found) & (found > 0.0), found, 1.0)
    for control, place in problem.augmentation.places.items():
        z[problem.measured + place] = z[nx + control]
    return z


def _responses(start: _Start) -> tuple[Array, Array]:
    """Return (nx, nu) twice: the change of a state at the first node, and the largest one over the horizon.

    A control changes by 1 at the beginning, in the linear model at the initial state without its exponential growth.
    """
    problem, at_start = start.problem, start.of(start.problem.path)[:3]
    nx, nu = problem.nx, problem.nu
    x, u, p, _ = symbols(nx, nu, problem.np + problem.solved)
    slopes = ca.densify(ca.jacobian(problem.dynamics(x, u, p), ca.vertcat(x, u)))
    S = np.array(ca.Function("slopes", [x, u, p], [slopes])(*at_start)).reshape(nx, nx + nu)
    first, most, dx = np.zeros((nx, nu)), np.zeros((nx, nu)), np.zeros((nx, nu))
    jumps = np.zeros((0, nx + nu))
    if problem.jump is not None:
        jumps = problem.jump_slopes(*at_start, problem.dt[0])[1].full()
    if not (np.all(np.isfinite(S)) and np.all(np.isfinite(jumps))):
        return first, most
    eigenvalues = np.linalg.eigvals(S[:, :nx])
    if problem.discrete:
        S[:, :nx] /= max(1.0, float(np.max(np.abs(eigenvalues))))
    else:
        S[:, :nx] -= max(0.0, float(np.max(eigenvalues.real))) * np.eye(nx)
    step: dict[float, Array] = {}
    with np.errstate(all="ignore"):
        for k, dt in enumerate(problem.dt):
            if dt not in step:
                rates = np.vstack([S, np.zeros((nu, nx + nu))])
                step[dt] = S if problem.discrete else _exponential(rates * dt)[:nx]
            held = jumps[:, :nx] @ dx + jumps[:, nx:]
            dx = step[dt][:, :nx] @ dx + step[dt][:, nx:]
            dx[list(problem.maps)] = held
            size = np.where(np.isfinite(dx), np.abs(dx), 0.0)
            most = np.fmax(most, size)
            first = most if k == 0 else first
    return first, most


def _exponential(A: Array) -> Array:
    """Compute exp(A) to a few digits: a polynomial of degree 8 of A / 2^n, squared n times."""
    halvings = max(0, math.ceil(math.log2(max(1e-300, float(np.max(np.sum(np.abs(A), axis=1)))))) + 2)
    E = term = np.eye(len(A))
    for n in range(1, 9):
        term = term @ A / (n * 2.0**halvings)
        E = E + term
    return np.asarray(np.linalg.matrix_power(E, 2**halvings))


# Terms ---------------------------------------------------------------------------------------------------------------


def _row_sizes(start: _Start, z: Array) -> tuple[Array, Array]:
    """Return, for every row, the size of its terms and its constant part.

    A row that holds on the path and at the end has the larger of its two sizes.
    """
    problem = start.problem
    size, offset = np.zeros(len(problem.rows)), np.zeros(len(problem.rows))
    of_stage = [_terms(stage.h, stage, start, z) for stage in (problem.path, problem.terminal)]
    ends = _coupled_terms(problem, z)
    for r, row in enumerate(problem.rows):
        if (i := row.variable(problem.nx)) is not None:
            size[r] = z[i]
        for at_end, index in enumerate((row.index, row.index_terminal)):
            terms = ends if row.is_coupled and not at_end else of_stage[at_end] if row.is_general else []
            if 0 <= index < len(terms):
                offset[r], more = terms[index]
                size[r] = max(size[r], more)
    return np.where(size > 0.0, size, 1.0), offset


def _coupled_terms(problem: Problem, z: Array) -> list[tuple[float, float]]:
    if problem.coupled is None:
        return []
    x_0, x_N = ca.SX.sym("x_0", problem.nx), ca.SX.sym("x_N", problem.nx)
    sizes = [z[: problem.nx], z[: problem.nx]]
    return _magnitudes(problem.coupled(x_0, x_N), [x_0, x_N], sizes, [problem.x_initial, problem.x_initial])


def _terms(expression: Expression, stage: Stage, start: _Start, z: Array) -> list[tuple[float, float]]:
    """Return (constant part, size of the other terms) of every element of an expression of a stage."""
    sizes = [z[: stage.nx], z[stage.nx : stage.nx + stage.nu]]
    x, u, p, dt = start.of(stage)
    return _magnitudes(expression, [stage.x, stage.u, stage.p, stage.dt], sizes, [x, u, p, np.array([dt])])


def _costs(start: _Start, z: Array) -> tuple[Array, Array]:
    """Return the cost of every residual and general cost of its own size, and the curvature cost of every variable."""
    found: list[float] = []
    own, problem = np.zeros(z.size), start.problem
    for stage in (problem.start, problem.path, problem.terminal):
        dt = np.array([start.dt if scaled else 1.0 for scaled in stage.scale_with_dt])
        size = np.array([terms for _, terms in _terms(stage.y, stage, start, z)])
        stated = np.array([*stage.y_scale, *[0.0] * (stage.ny - len(stage.y_scale))])
        size = np.where(stated > 0.0, stated, size)
        found += list(np.diag(stage.weight) * dt * size**2)
        slopes = _slopes(stage, start)
        curvature = np.einsum("ij,i,ij->j", slopes, np.diag(stage.weight) * dt, slopes)
        for cost, part in ((stage.cost, 1.0), (stage.cost_rate, start.dt)):
            if cost is not None:
                found.append(part * _terms(cost, stage, start, z)[0][1])
                curvature = curvature + part * _curvature(cost, stage, start)
        with np.errstate(all="ignore"):
            squares = curvature * z[: curvature.size] ** 2
        own[: squares.size] = np.fmax(own[: squares.size], np.where(np.isfinite(squares), squares, 0.0))
    return np.array([*found, 0.0]), own


def _curvature(cost: Expression, stage: Stage, start: _Start) -> Array:
    """Return the magnitudes of the second derivatives of a general cost at the initial state, one for each variable."""
    z = ca.vertcat(stage.x, stage.u)
    at = ca.Function("bend", [stage.x, stage.u, stage.p, stage.dt], [ca.densify(ca.diag(ca.hessian(cost, z)[0]))])
    found = np.abs(np.asarray(at(*start.of(stage))).ravel())
    return np.where(np.isfinite(found), found, 0.0)


def _slopes(stage: Stage, start: _Start) -> Array:
    """Return dy/dz of the residuals of a stage at the initial state."""
    z = ca.vertcat(stage.x, stage.u)
    at = ca.Function("slopes", [stage.x, stage.u, stage.p], [ca.densify(ca.jacobian(stage.y, z))])
    found = np.asarray(at(*start.of(stage)[:3])).reshape(stage.ny, z.numel())
    return np.where(np.isfinite(found), found, 0.0)


# Sizes of expressions ------------------------------------------------------------------------------------------------

#: Constant part c, size m of the other terms, value v at the initial state.
_Part = tuple[float, float, float]


def _magnitudes(
    expression: Expression, variables: Sequence[Expression], sizes: Sequence[Array], values: Sequence[Array]
) -> list[tuple[float, float]]:
    """Return (constant part, size of the other terms) of every element.

    ``sizes`` belong to the first variables; the others are constants with their values. Terms do not cancel: p (p - a)
    has a size at p = a.
    """
    n = int(expression.numel())
    if n == 0:
        return []
    names = [f"v{i}" for i in range(len(variables))]
    function = ca.Function("terms", list(variables), [ca.densify(expression)], names, ["value"])
    kernel = lift(
        function,
        "terms",
        "",
        [Port(m, int(v.numel())) for m, v in zip(names, variables, strict=True)],
        [Port("value", n)],
    )
    parts = _parts(kernel, sizes, values)
    found = [(0.0, 0.0)] * n
    for _, element, value in kernel.stores:
        constant, size, _ = parts[value]
        found[element] = (constant, size) if math.isfinite(constant + size) else (0.0, 1.0)
    return found


def _parts(kernel: Kernel, sizes: Sequence[Array], values: Sequence[Array]) -> list[_Part]:
    """Return the parts of all values of a kernel."""
    parts: list[_Part] = []
    with np.errstate(all="ignore"):
        for ins in kernel.instructions:
            if ins.opcode == ca.OP_CONST:
                parts.append((ins.constant, 0.0, ins.constant))
            elif ins.opcode == ca.OP_INPUT:
                port, element = ins.args
                value = float(values[port][element])
                parts.append(
                    (0.0, float(sizes[port][element]), value) if port < len(sizes) else (0.0, abs(value), value)
                )
            else:
                parts.append(_operation(ins, [parts[a] for a in ins.args]))
    return parts


def _operation(ins: Instruction, operands: list[_Part]) -> _Part:
    if ins.opcode == ca.OP_CALL:
        lookup = known_lookup(ins.constant)
        largest = max(map(abs, lookup.values)) if lookup.part == "entry" else float(len(lookup.values))
        return 0.0, largest, float(lookup(np.array(operands[0][2])))
    name = opcode_name(ins.opcode).removeprefix("OP_").lower()
    (c, m, v), (d, n, w) = operands[0], operands[-1]
    value = float(VALUES[name](np.array(v), np.array(w)))
    if name in _LINEAR:
        return (*_LINEAR[name]((c, m), (d, n)), value)
    if m == 0.0 and n == 0.0:
        return value, 0.0, value
    if name in ("mul", "div") and n == 0.0:
        factor = d if name == "mul" else (1.0 / d if d else math.inf)
        return c * factor, abs(m * factor), value
    if name == "mul" and m == 0.0:
        return d * c, abs(n * c), value
    if name in ("pow", "constpow") and n == 0.0 and abs(c) + m > 0.0:
        return 0.0, float(np.float64(abs(c) + m) ** d), value
    return 0.0, _size(name, abs(c) + m, abs(d) + n, value), value


def _size(name: str, a: float, b: float, value: float) -> float:
    """Return the size of an operation on operands of sizes a and b, with this value at the initial state."""
    if name in _GROWING:
        return float(_GROWING[name](a, b))
    return abs(value) if value and math.isfinite(value) else min(a, 1.0)


_Two = tuple[float, float]
_LINEAR: dict[str, Callable[[_Two, _Two], _Two]] = {
    "add": lambda a, b: (a[0] + b[0], a[1] + b[1]),
    "sub": lambda a, b: (a[0] - b[0], a[1] + b[1]),
    "neg": lambda a, b: (-a[0], a[1]),
    "twice": lambda a, b: (2.0 * a[0], 2.0 * a[1]),
}
_GROWING: dict[str, Callable[[float, float], float]] = {
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b if b else math.inf,
    "inv": lambda a, b: 1.0 / a if a else math.inf,
    "sq": lambda a, b: a * a,
    "sqrt": lambda a, b: math.sqrt(a),
    "fabs": lambda a, b: a,
    "hypot": math.hypot,
    "if_else_zero": lambda a, b: b,
    "fmin": max,
    "fmax": max,
}
