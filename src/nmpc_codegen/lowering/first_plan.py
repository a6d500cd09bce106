"""What is to be expected at the first plan, where all states are at their initial values, controls at their references.

Growth of the open loop over the intervals that condensing eliminates costs digits:

    dx_k = sum_j Phi(k, j + 1) B_j du_j + ...,   Phi(k, j) = A_{k-1} ... A_j

If the open loop grows by a factor c over these intervals, the entries of the condensed Hessian grow by c^2, and that
part of them that decides on the controls falls below their rounding errors: the relative error of the controls is about
4 c^2 eps. A recursion over the stages has no such products.

The factor must not depend on the units of the states. Let M_l hold the largest magnitude of every entry of Phi(k, j)
over all k - j <= l. In the best diagonal units T the largest sum of a row of T^-1 M_l T is the spectral radius of M_l;
the factor is this radius, for the states that the controls reach.

A derivative that is not finite there fails the first sample. What has no gradient there moves no iterate: a control
without influence (u^3 at 0), a row whose gradient vanishes although it is not satisfied with room to spare (w^2 <= v^2
at rest), an end time of 0 that scales all derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.components.base import Condensing, Integrator, Transition, spell
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.controls import Saddles
from nmpc_codegen.frontend.problem import Array, Problem, Row, Stage
from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.lowering.tolerances import EPS
from nmpc_codegen.package.memory import Precision
from nmpc_codegen.package.program import NOT_FINITE, Program, in_words, locate

#: Relative error of the controls above which the compiler does not choose the condensing that causes it, and warns of
#: one that is given. In double precision the check before OK takes errors above it for failures now and then.
AVOIDED: Mapping[Precision, float] = {"double": 1e-7, "single": 1e-4}
#: Relative error above which condensing that is given is refused.
REFUSED = 1e-3
#: Growth over the horizon above which single shooting loses plans.
SIMULATED = 200.0
Marks = NDArray[np.bool_]

#: Entries of products do not exceed this number.
LARGEST = 1e100


@dataclass(frozen=True)
class Growth:
    """``factors[l - 1]``: growth over l intervals; empty if no point that the problem states has finite derivatives."""

    factors: tuple[float, ...]
    precision: Precision

    def factor(self, intervals: int) -> float:
        """Growth if the states of so many intervals in a row are functions of the first one and of the controls."""
        return self.factors[min(intervals, len(self.factors)) - 1] if self.factors else 1.0

    def error(self, intervals: int, precision: Precision | None = None) -> float:
        """Estimated relative error of the controls, at most 1."""
        return min(1.0, 4.0 * self.factor(intervals) ** 2 * EPS[precision or self.precision])

    def describe(self, intervals: int) -> str:
        """The factor and the digits that remain."""
        left, given = (abs(math.log10(e)) for e in (self.error(intervals), EPS[self.precision]))
        return (
            f"the open loop grows by a factor of {self.factor(intervals):.2g} over {intervals} intervals, whose square "
            f"in the Hessian leaves the controls about {left:.0f} of {given:.0f} digits in {self.precision} precision"
        )

    def spares(self, problem: Problem, condensing: Condensing) -> bool:
        """True if a condensing component costs few digits."""
        return self.error(_intervals(problem, condensing)) <= AVOIDED[self.precision]

    def warning(self, problem: Problem, condensing: Condensing) -> tuple[str, ...]:
        """A warning of a condensing component that costs many digits.

        Raises:
            OptionError: it costs too many.
        """
        intervals = _intervals(problem, condensing)
        if self.error(intervals) > REFUSED:
            offers = ["condensing NoCondensing() (--set condensing=none) with a QP solver on stages"]
            if self.error(intervals, "double") <= REFUSED:
                offers.append('precision "double" (--set precision=double)')
            raise OptionError(
                f"condensing {spell(condensing)} cannot work: {self.describe(intervals)}; use {' or '.join(offers)}"
            )
        if self.spares(problem, condensing):
            return ()
        advice = "try Options(condensing=NoCondensing())" if intervals > 1 else "shorten the intervals"
        return (f"condensing {condensing.label}: {self.describe(intervals)}; {advice}",)

    def of_simulation(self, algorithm: str, intervals: int) -> tuple[str, ...]:
        """A warning of an algorithm that simulates its plans, if they run away from small errors of their controls."""
        factor = self.factor(intervals)
        if factor <= SIMULATED:
            return ()
        return (
            f"{algorithm} simulates its plans, and the open loop grows by a factor of {factor:.2g} over {intervals} "
            "intervals: try RealTimeIteration(), or a shorter horizon",
        )

    def left_out(self, problem: Problem, candidates: Iterable[Condensing]) -> tuple[str, ...]:
        """The reason for not choosing those candidates that cost many digits; none if there are none."""
        lossy = {c.label: _intervals(problem, c) for c in candidates if not self.spares(problem, c)}
        if not lossy:
            return ()
        return (f"condensing: {', '.join(lossy)} not considered; {self.describe(min(lossy.values()))}",)


def _intervals(problem: Problem, condensing: Condensing) -> int:
    """Number of intervals in a row whose states are eliminated: those of a stage of the QP."""
    return condensing.qp_shape(problem).controls // problem.nu


def growth(problem: Problem, integrator: Integrator, precision: Precision) -> Growth:
    """The largest growth at the points that the problem states: the first plan, and the references of the states.

    Points without finite derivatives do not count.
    """
    transition = integrator.transition(problem) or _by_steps(problem, integrator)
    found = []
    with np.errstate(all="ignore"):
        for at, x, u in ((corner, *point) for _, corner in problem.corners for point in points(corner)):
            lengths = {dt: transition(x, u, at.p_value, dt) for dt in set(problem.dt)}
            if all(np.all(np.isfinite(S)) for S in lengths.values()):
                found.append(_factors(np.array([lengths[dt] for dt in problem.dt]), problem.uniform))
    return Growth(tuple(float(c) for c in np.max(found, axis=0)) if found else (), precision)


def _by_steps(problem: Problem, integrator: Integrator) -> Transition:
    """[A B] of an interval by steps of RK4, or by the discrete map."""
    step = _step(problem)
    longest = math.inf if problem.discrete else integrator.longest_step(problem)
    return lambda x, u, p, dt: _interval(step, problem, x, u, p, dt, max(1, round(dt / longest)))


def _step(problem: Problem) -> Function:
    """((x, S), (u, p, h)) -> (x_next, S_next): one integration step, or the discrete map, with sensitivities."""
    x, u, p, h = problem.path.x, problem.path.u, problem.path.p, ca.SX.sym("h")
    if problem.discrete:
        x_next = ca.densify(problem.dynamics(x, u, p))
    else:
        slope = ca.Function("slope", [x, ca.vertcat(u, p)], [problem.dynamics(x, u, p)])
        x_next = ca.simpleRK(slope, 1, 4).expand()(x, ca.vertcat(u, p), h)
    S = ca.SX.sym("S", problem.nx, problem.nx + problem.nu)
    A, B = ca.jacobian(x_next, x), ca.jacobian(x_next, u)
    S_next = ca.densify(A @ S + ca.horzcat(ca.SX(problem.nx, problem.nx), B))
    state, data = ca.vertcat(x, ca.vec(S)), ca.vertcat(u, p, h)
    return ca.Function("step", [state, data], [ca.vertcat(x_next, ca.vec(S_next))])


def _interval(step: Function, problem: Problem, x: Array, u: Array, p: Array, dt: float, steps: int) -> Array:
    """[A B] of an interval of length dt from x."""
    start = np.concatenate([x, np.eye(problem.nx, problem.nx + problem.nu).ravel(order="F")])
    end = step.fold(steps)(start, np.concatenate([u, p, [dt / steps]]))
    S: Array = np.array(end, dtype=np.float64)[problem.nx :, 0].reshape(problem.nx, -1, order="F")
    if problem.jump is not None:
        S[list(problem.maps)] = problem.jump_slopes(x, u, p, dt)[1].full()
    for i, j in problem.noise:
        S[i, problem.nx + j] = 1.0
    return S


def first_plan(problem: Problem) -> tuple[Array, Array]:
    """(x, u) at all nodes of the first plan: initial states, and controls at their references inside their bounds."""
    u = problem.reference_controls
    for row in problem.rows:
        if row.kind == "control":
            u[row.index] = np.clip(u[row.index], row.lower, row.upper)
    return problem.x_initial, u


def points(problem: Problem) -> list[tuple[Array, Array]]:
    """Return points (x, u): those of the first plan, and the same with the states at the references of the cost."""
    start, u = first_plan(problem)
    states = [start, *(_at_reference(problem, stage, start) for stage in (problem.path, problem.terminal))]
    return [(x, u) for x in np.unique(states, axis=0)]


def _at_reference(problem: Problem, stage: Stage, start: Array) -> Array:
    """``start`` with those states for which a residual tells a value."""
    x = start.copy()
    for place, value in stage.targets(problem.data):
        if place < problem.nx:
            x[place] = value
    return x


def _factors(S: Array, uniform: bool) -> Array:
    """The growth over 1, 2, ..., N intervals, from [A_k B_k] of every interval, (N, nx, nx + nu)."""
    N, nx = len(S), S.shape[1]
    reached = _reachable_states(S)
    A = np.clip(S[:, reached][:, :, :nx][:, :, reached], -LARGEST, LARGEST)
    products = np.broadcast_to(np.eye(len(A[0])), A.shape)[: 1 if uniform else N]
    largest, found = np.abs(products[0]), []
    for lag in range(N):
        found.append(max(1.0, float(np.max(np.abs(np.linalg.eigvals(largest)), initial=0.0))))
        count = 1 if uniform else N - lag
        # Phi(j + lag + 1, j) = A_{j + lag} Phi(j + lag, j)
        products = np.clip(A[lag : lag + count] @ products[:count], -LARGEST, LARGEST)
        largest = np.maximum(largest, np.max(np.abs(products), axis=0, initial=0.0))
    return np.array(found)


def _reachable_states(S: Array) -> Marks:
    """Marks of the states that a control reaches, directly or through others."""
    nx = S.shape[1]
    depends = np.any(S != 0.0, axis=0)
    reached: Marks = np.any(depends[:, nx:], axis=1)
    for _ in range(nx):
        reached = reached | np.any(depends[:, :nx] & reached, axis=1)
    return reached


# -- warnings ---------------------------------------------------------------------------------------------------------

#: Points at which a property that is to hold for all states is tested.
DRAWN = 4
#: Distance from a bound, relative to it, up to which a row counts as active.
ACTIVE = 1e-9


def first_plan_warnings(problem: Problem, program: Program, second: bool, saddles: Saddles) -> tuple[str, ...]:
    """One text for everything that cannot work at the first plan, or at the first corner of the ranges of parameters
    and initial states where more does not work; ``second``: second derivatives are evaluated; ``saddles``: controls
    that samples move where their slopes vanish."""
    (_, declared), *corners = problem.corners
    found = tuple(_warnings(declared, program, second, saddles))
    for where, corner in corners:
        texts = _warnings(corner, program, second, saddles, given=True)
        more = [f"{text} (with {where})" for text in texts if text not in found]
        if more:
            return (*found, *more)
    return found


def _warnings(
    problem: Problem, program: Program, second: bool, saddles: Saddles, given: bool = False
) -> tuple[str, ...]:
    x, u = first_plan(problem)
    still = tuple(_end_time(problem, x, u)) or tuple(_without_influence(problem, x, u, saddles))
    return (*_not_finite(problem, program, second, x, u, given), *still, *_without_gradient(problem, x, u))


def _not_finite(problem: Problem, program: Program, second: bool, x: Array, u: Array, given: bool) -> Iterator[str]:
    """``given``: operations count of which parameters alone decide whether they are inside their domain."""
    nodes = problem.N + 1
    plan = (np.tile(x, (nodes, 1)), np.tile(u, (problem.N, 1)), np.tile(problem.node_values(x, u), (nodes, 1)))
    found = [finding for finding in locate(program, *plan, second) if given or not finding.given]
    for text in in_words(found):
        yield f"{NOT_FINITE}: {text}"


def _end_time(problem: Problem, x: Array, u: Array) -> Iterator[str]:
    """Constant states at 0 without which no control moves anything, and parameters at 0 that scale all derivatives."""
    path = problem.path
    f = problem.dynamics(path.x, path.u, path.p)
    slopes = _function(path, [ca.densify(f), ca.densify(ca.jacobian(f, path.u))])
    draws = [
        (d, u + 1 + _noise(problem.nu, k), problem.p_value + _noise(problem.np, k)) for k, d in enumerate(_draw(x))
    ]

    def at(kind: str, i: int, value: float) -> tuple[Array, Array]:
        """Return the derivatives, or the steps of a map, at all draws with element i set to a value, and the influence
        of the controls there."""
        found = []
        for states, controls, parameters in draws:
            z, p = states.copy(), parameters.copy()
            (z if kind == "state" else p)[i] = value
            values = problem.node_values(z, controls, p)
            rate, influence = (np.asarray(v, dtype=float) for v in slopes(z, controls, values, problem.dt[0]))
            found.append((rate.ravel() - (z if problem.discrete else 0), influence))
        return np.array([rate for rate, _ in found]), np.array([influence for _, influence in found])

    for kind, values, names, option in (
        ("state", x, problem.state_names, "initial"),
        ("parameter", problem.p_value, problem.parameter_names, "value"),
    ):
        for i in map(int, np.flatnonzero(values == 0)):
            (still, without), (moving, influence) = at(kind, i, 0.0), at(kind, i, 1.0)
            if kind == "state":
                scales = not np.any(moving[:, i]) and not np.any(without) and np.any(influence)
            else:
                scales = not np.any(still) and np.any(moving)
            if scales:
                yield (
                    f"{kind} '{names[i]}' is 0 at the first plan and scales the derivatives, so that no control moves "
                    f"anything: give it another value, e.g. ocp.{kind}({names[i].partition('[')[0]!r}, {option}=1.0)"
                )


def _without_influence(problem: Problem, x: Array, u: Array, saddles: Saddles) -> Iterator[str]:
    """Controls whose first derivatives vanish in dynamics, cost and rows at the first plan, and to which states and
    controls that move do not give any; and those without a weight that wait for others."""
    if problem.inner.idle:
        return
    at_plan, moves = _movable(problem, x, u)
    still = np.flatnonzero(~moves)
    probed = still.size > 0 and any(_is_probed(problem, x, u, j, saddles) for j in saddles.controls)
    for j in (j for j in still if not (probed and j in saddles.controls)):
        yield (
            f"control '{problem.control_names[j]}' is {u[j]:g} at the first plan, where its first derivatives in "
            "dynamics, cost and rows vanish: no iteration moves it. Start where a state or parameter that scales it is "
            f"not 0, by initial= or value=, or write another value, e.g. ctrl.u[:, {j}] = 0.1, after build() and after "
            "every reset()"
        )
    curvature = sum(
        (ca.hessian(part, problem.path.u)[0] for part in _costs(problem.path)), ca.SX(problem.nu, problem.nu)
    )
    H = np.asarray(
        _function(problem.path, [ca.densify(curvature)])(x, u, problem.node_values(x, u), problem.dt[0]), dtype=float
    )
    for j in np.flatnonzero(moves & ~at_plan & ~np.any(H, axis=1)):
        name = problem.control_names[j]
        yield (
            f"control '{name}' has neither a weight nor an influence at the first plan, so that the first QP does not "
            f"determine it: give it a weight, e.g. least_squares({name}, weight=1e-2)"
        )


def _is_probed(problem: Problem, x: Array, u: Array, j: int, saddles: Saddles) -> bool:
    """True if a finite move of an idle control, alone or with its partner, changes a state for which the cost or rows
    ask, as far as they see it at this point: then a probe of the sample moves it."""
    path = problem.path
    f = problem.dynamics(path.x, path.u, path.p)
    at = _function(path, [ca.densify(f), ca.densify(ca.jacobian(f, path.x))])
    values = problem.node_values(x, u)
    rate, A = (np.asarray(v, dtype=float) for v in at(x, u, values, problem.dt[0]))
    changed = np.zeros(problem.nx, dtype=bool)
    partner = saddles.partners[j]
    for side, other in ((1, 0), (-1, 0), (1, 1), (1, -1)):
        moved = u.copy()
        moved[j] += side * (1 + abs(u[j]))
        if partner >= 0:
            moved[partner] += other * (1 + abs(u[partner]))
        changed |= (np.asarray(at(x, moved, values, problem.dt[0])[0], dtype=float) != rate).ravel()
    seen = _asked_for(problem, x, u)
    for _ in range(problem.nx):
        seen = seen | np.any(A[seen] != 0, axis=0)
    return bool(np.any(changed & seen))


def _asked_for(problem: Problem, x: Array, u: Array) -> Marks:
    """States along which the cost changes; where it changes along none, all on which residuals, costs and rows
    depend."""
    slopes, depends = np.zeros(problem.nx, dtype=bool), np.zeros(problem.nx, dtype=bool)
    for stage, control in ((problem.path, u), (problem.terminal, np.zeros(0))):
        cost = sum(_costs(stage), ca.SX(0))
        terms = ca.vertcat(cost, stage.h)
        slope = _function(stage, [ca.densify(ca.gradient(cost, stage.x))])
        values = problem.node_values(x, control)
        slopes |= np.asarray(slope(x, control, values, problem.dt[0]), dtype=float).ravel() != 0
        depends |= np.array(ca.which_depends(terms, stage.x, 1, False), dtype=bool)
    bounded = [row.index for row in problem.rows if row.kind == "state"]
    depends[bounded] = True
    return slopes if np.any(slopes) else depends


def _movable(problem: Problem, x: Array, u: Array) -> tuple[Marks, Marks]:
    """Controls with an influence at the first plan, and those that get one by states and controls that move; parameters
    are drawn. Controls that are not in the dynamics count as both."""
    path = problem.path
    f = problem.dynamics(path.x, path.u, path.p)
    jacobians = [ca.jacobian(f, path.u), ca.jacobian(path.h, path.u)]
    slopes = ca.vertcat(ca.SX(0, problem.nu), *(ca.jacobian(part, path.u) for part in _costs(path)))
    evaluate = _function(path, [ca.densify(part) for part in (f, *jacobians, slopes)])
    moves = ~np.any(np.asarray(ca.DM(jacobians[0].sparsity(), 1)), axis=0)
    moved, at_plan = np.zeros(problem.nx, dtype=bool), np.zeros(0, dtype=bool)
    for _ in range(problem.nx + problem.nu + 1):
        seen, going = moves, moved
        for k in range(DRAWN):
            state = np.where(moved, _draw(x)[k], x)
            control = np.where(moves, u + _noise(problem.nu, k), u)
            values = problem.node_values(state, control, problem.p_value + _noise(problem.np, k))
            rate, *parts = evaluate(state, control, values, problem.dt[0])
            going = going | (np.asarray(rate, dtype=float).ravel() - (state if problem.discrete else 0) != 0)
            sizes = [np.abs(np.asarray(part, dtype=float)).reshape(-1, problem.nu) for part in parts]
            seen = seen | np.any([np.any((size > 0) | ~np.isfinite(size), axis=0) for size in sizes], axis=0)
        at_plan = at_plan if at_plan.size else seen
        if np.array_equal(seen, moves) and np.array_equal(going, moved):
            break
        moves, moved = seen, going
    return at_plan, moves


def _costs(stage: Stage) -> list[Expression]:
    """The scalar terms of the cost of a stage, with the declared weights and references."""
    y = stage.y - ca.DM(stage.reference)
    squares = [ca.bilin(ca.SX(ca.DM(stage.weight)), y, y) / 2] if stage.ny else []
    return [*squares, *(c for c in (stage.cost, stage.cost_rate) if c is not None)]


def _without_gradient(problem: Problem, x: Array, u: Array) -> Iterator[str]:
    """General rows that are violated, or active and may become so, but whose gradient is 0; once per row."""
    said: set[str] = set()
    for stage, control in ((problem.path, u), (problem.terminal, np.zeros(0))):
        if not stage.nh:
            continue
        z = ca.vertcat(stage.x, stage.u)
        evaluate = _function(stage, [ca.densify(stage.h), ca.densify(ca.jacobian(stage.h, z))])
        parameters = problem.p_value, problem.p_value + _noise(problem.np, 0)
        values, others = (problem.node_values(x, control, p) for p in parameters)
        h, J = (np.asarray(v, dtype=float) for v in evaluate(x, control, values, problem.dt[0]))
        other = np.asarray(evaluate(x, control, others, problem.dt[0])[1], dtype=float)
        for row in problem.rows:
            at = row.index if stage is problem.path else row.index_terminal
            if not row.is_general or at < 0 or row.name in said or np.any(J[at]) or np.any(other[at]):
                continue
            H = _function(stage, [ca.densify(ca.hessian(stage.h[at], z)[0])])
            curvature = np.nan_to_num(np.asarray(H(x, control, values, problem.dt[0]), dtype=float))
            if _is_lost(h[at, 0], row, curvature):
                said.add(row.name)
                cone = "; a cone w**2 <= g**2 v**2 is better stated as -g v <= w and w <= g v"
                yield (
                    f"row '{row.name}': its gradient vanishes at the first plan, where it is {h[at, 0]:g} and its "
                    f"bounds are {row.lower:g} and {row.upper:g}, so that QPs do not see it: start where it has one, "
                    "by initial=, references of controls, or ctrl.x and ctrl.u after build()"
                    f"{cone if row.lower != row.upper else ''}"
                )


def _is_lost(value: float, row: Row, curvature: Array) -> bool:
    """Whether a row without a gradient is violated, or active with a curvature that leads out of its bounds."""
    below, above = _room(value - row.lower, row.lower), _room(row.upper - value, row.upper)
    if min(below, above) < -ACTIVE:
        return True
    eigenvalues = np.linalg.eigvalsh(curvature)
    return bool((below <= ACTIVE and eigenvalues.min() < 0) or (above <= ACTIVE and eigenvalues.max() > 0))


def _room(distance: float, bound: float) -> float:
    """Distance from a bound, relative to it."""
    return distance / (1 + abs(bound)) if np.isfinite(bound) else np.inf


def _function(stage: Stage, outputs: list[Expression]) -> Function:
    return ca.Function("at_first_plan", [stage.x, stage.u, stage.p, stage.dt], outputs)


def _draw(x: Array) -> list[Array]:
    """States around x, the same at every call."""
    return [x + (1 + np.abs(x)) * _noise(len(x), k) for k in range(DRAWN)]


def _noise(size: int, seed: int) -> Array:
    return np.random.default_rng([7, seed]).uniform(-1, 1, size)
