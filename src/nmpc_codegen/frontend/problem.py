"""A Problem, the first intermediate representation, is the optimal control problem, frozen, validated and classified.

    min   l_0(x_0)  +  sum_{k<N} 1/2 |y_k - yref_k|^2_W  +  1/2 |y_N - yref_N|^2_{W_N}
    s.t.  x_0 = xhat,   x_{k+1} = Phi_k(x_k, u_k, p_k),
          lower <= h_k(x_k, u_k, p_k) <= upper   at the nodes of each row

It contains no algorithm and no C. The start and terminal stages are Stages with nu = 0, so that start, path and
terminal share one type. The start stage has only a cost, with fixed weights and references; the rows at node 0 belong
to the path.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import ClassVar, Self, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.algebra import newton
from nmpc_codegen.ir.casadi_types import Expression, Function, curved_rows, elements, part
from nmpc_codegen.package.estimation import Estimation, kind_of
from nmpc_codegen.package.kinds import Kind
from nmpc_codegen.package.signals import NOT_AUGMENTED, ImposedRow, imposed_rows
from nmpc_codegen.package.signals import Augmentation as Augmentation
from nmpc_codegen.package.signals import Row as Row
from nmpc_codegen.package.signals import RowKind as RowKind
from nmpc_codegen.package.signals import Signal as Signal
from nmpc_codegen.package.signals import c_identifier as c_identifier

Array = NDArray[np.float64]

#: Largest number of elements with a range for which all corners are examined.
MOST_RANGES = 4
#: (expression, order) -> expression with derivatives up to this order.
Reduce = Callable[[Expression, int], Expression]
T = TypeVar("T")
#: Elements, (signal, index, ends of the range), with a value each.
Corner = Sequence[tuple[tuple[Signal, int, tuple[float, float]], float]]


def no_data() -> Array:
    """Return the node data of a problem without added parameters."""
    return np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage has the functions of a node: least-squares residual, general cost, general rows.

    ``x`` (nx,), ``u`` (nu,), which is empty at the start and terminal stages, ``p`` (np,) and the interval's length
    ``dt`` are SX symbols; all expressions are written in them. ``scale_with_dt`` marks the residuals whose weight is
    multiplied by dt_k; ``cost`` includes its factor dt; ``cost_rate`` is integrated over the interval and never scaled.
    """

    x: Expression
    u: Expression
    p: Expression
    dt: Expression
    y: Expression  # SX (ny,): residual of the least-squares term
    y_names: tuple[str, ...]
    reference: Array  # (ny,)
    weight: Array  # (ny, ny), symmetric positive semidefinite
    scale_with_dt: tuple[bool, ...]  # (ny,): the rows of y whose weight is multiplied by dt_k
    cost: Expression | None  # SX scalar: general cost at the node (already scaled)
    h: Expression  # SX (nh,): general rows
    h_names: tuple[str, ...]
    cost_rate: Expression | None = None  # SX scalar: general cost per unit of time, integrated with the dynamics
    y_scale: tuple[float, ...] = ()  # declared scales of residuals; 0, or a missing entry: none
    ties: Expression | None = None  # SX: further residuals of weight 1, which vanish at every solution
    bare: tuple[int, ...] | None = None  # y_elements of the residuals as they were stated
    dense_weight: bool = False  # the weight is stored as a matrix even if it has no entry off its diagonal

    @property
    def y_elements(self) -> tuple[int, ...]:
        """Return for every residual the index in (x, u) of its state or control, -1 for other expressions."""
        if self.bare is not None:
            return self.bare
        symbols = (*elements(self.x), *elements(self.u))
        known = {symbol.element_hash(): i for i, symbol in enumerate(symbols)}
        return tuple(known.get(y.element_hash(), -1) if y.is_symbolic() else -1 for y in elements(self.y))

    @cached_property
    def _targets(self) -> tuple[tuple[int, ...], Expression, Expression]:
        """Return places, values in (p, yref), and yref; see targets()."""
        places, yref = list(self.y_elements), ca.SX.sym("yref", self.ny)
        values = [yref[i] if place >= 0 else ca.SX(0) for i, place in enumerate(places)]
        z = ca.vertcat(self.x, self.u)
        J, bent = ca.jacobian(self.y, z), curved_rows(self.y, z)
        timed = ca.which_depends(self.y, self.dt, 1, True) if self.ny else ()
        for i in (i for i, place in enumerate(places) if place < 0 and self.bare is None):
            row = J[i, :].sparsity().get_triplet()[1]
            if len(row) == 1 and i not in bent and not timed[i]:
                places[i] = int(row[0])
                values[i] = (yref[i] - ca.substitute(self.y[i], z[row[0]], 0)) / J[i, row[0]]
        return tuple(places), ca.vertcat(ca.SX(0, 1), *values), yref

    def target_of(self, place: int) -> tuple[Expression, Expression] | None:
        """Return (value in (p, yref), yref) of the residual that defines a target for element ``place`` of (x, u).

        The first residual that is this element defines the target, else the first one that is an affine function of
        this element only. The value makes the residual equal to yref. Return None if there is no such residual.
        """
        places, values, yref = self._targets
        for known in (self.y_elements, places):
            if place in known:
                return values[known.index(place)], yref
        return None

    def targets(self, p: Array) -> Iterator[tuple[int, float]]:
        """Yield (index in (x, u), target) for every residual that is an affine function of one element only.

        The target is the value at which the residual has its reference, with the parameters p.
        """
        places, values, yref = self._targets
        found = np.asarray(ca.Function("targets", [self.p, yref], [ca.densify(values)])(p, self.reference)).ravel()
        return ((i, float(v)) for i, v in zip(places, found, strict=True) if i >= 0 and np.isfinite(v))

    @property
    def nx(self) -> int:
        return int(self.x.numel())

    @property
    def nu(self) -> int:
        return int(self.u.numel())

    @property
    def ny(self) -> int:
        return int(self.y.numel())

    @property
    def nh(self) -> int:
        return int(self.h.numel())

    @property
    def diagonal_weight(self) -> bool:
        """Return True if only the diagonal of the weight is stored: all other entries are zero and cannot be set."""
        return not self.dense_weight and bool(np.count_nonzero(self.weight - np.diag(np.diag(self.weight))) == 0)


def _is_curved(stage: Stage) -> bool:
    """Return True if a residual, or the gradient of a general cost, is no affine function of (x, u)."""
    z = ca.vertcat(stage.x, stage.u)
    slopes = [ca.gradient(cost, z) for cost in (stage.cost, stage.cost_rate) if cost is not None]
    return bool(curved_rows(ca.vertcat(stage.y, *slopes), z))


@dataclass(frozen=True, eq=False)
class Algebra:
    """Equations r(x, z, u, p) = 0 determine algebraic variables at every node and stage.

    signals: the user's variables; values: Function (x, u, p, z) -> all of them; names, start, scale: of z, the
    variables that Newton's method solves for, which may include derivatives of states; equations: Function (x, u, p, z)
    -> r. Without z, all variables are expressions. found: z at the first plan, NaN if Newton's method finds none;
    inverse: 1 where W may be nonzero.
    """

    signals: tuple[Signal, ...]
    values: Function
    equations: Function
    names: tuple[str, ...]
    start: tuple[float, ...]
    scale: tuple[float, ...]
    found: Array
    inverse: Array

    @property
    def size(self) -> int:
        """Return the number of variables that Newton's method solves for."""
        return len(self.names)

    @property
    def first(self) -> Array:
        """Return z at the first plan, or the start of Newton's method if it finds no z."""
        return np.where(np.isfinite(self.found), self.found, self.start)

    @property
    def data(self) -> int:
        """Return the number of values that a node stores after its parameters: z, and W = -(dr/dz)^-1 row by row."""
        return self.size * (1 + self.size)


@dataclass(frozen=True, eq=False)
class LqrRequest:
    """A terminal cost is requested that needs the integrator: the cost-to-go of the regulator at (x, u).

    ``rule`` names the function (problem, options) -> problem that computes it. Its module belongs to a later stage and
    loads SciPy, so it is imported only if a problem needs it.
    """

    rule: ClassVar[str] = "nmpc_codegen.economic.terminal:with_terminal_cost"

    economic: bool
    x: Array | None  # (nx,)
    u: Array | None  # (nu,)


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem is the whole optimal control problem, validated.

    ``dynamics`` is the CasADi SX Function f(x, u, p) -> xdot, or -> x_next if ``discrete``. ``dt`` holds the N interval
    lengths. ``uses`` names the features beyond the core ("soft rows", "coupled rows", "free initial state", "general
    cost", "integrated cost", "accumulators", "previous controls", "blocks of controls", "time", "discrete states"); a
    component that does not support one of them refuses the problem.

    ``augmentation`` describes the last states, which the compiler adds. ``jump`` is the SX Function (x, u, p, dt) ->
    values at the next node of the states ``maps``, which are constant along an interval and have the derivative 0 in
    ``dynamics``. A CompleteProblem holds what follows from a problem, such as its scales.
    """

    name: str
    N: int
    dt: tuple[float, ...]
    states: tuple[Signal, ...]
    controls: tuple[Signal, ...]
    parameters: tuple[Signal, ...]
    dynamics: Function
    discrete: bool
    start: Stage
    path: Stage
    terminal: Stage
    coupled: Function | None  # SX Function r(x_0, x_N)
    rows: tuple[Row, ...]
    free_initial: tuple[int, ...]
    uses: frozenset[str]
    accumulators: tuple[int, ...] = ()  # indices in x of states that are reset to 0 at every sample
    cyclic: tuple[int, ...] = ()  # indices in x of states that grow without bound
    terminal_lqr: LqrRequest | None = None  # a terminal cost that complete() computes
    time_unit: str = "s"  # unit of dt and of every other time
    proximal: tuple[float, ...] = ()  # curvature that samples add to (x, u); (): none
    augmentation: Augmentation = NOT_AUGMENTED
    maps: tuple[int, ...] = ()  # positions in x
    jump: Function | None = None
    node_data: Array = field(default_factory=no_data)  # (N + 1, augmentation.data): values of the added parameters
    algebra: Algebra | None = None
    noise: tuple[tuple[int, int], ...] = ()  # (i, j): u_j is added to x_i at the end of an interval
    estimation: Estimation | None = None  # for an estimator
    observed: Function | None = None  # (x, p) -> measurements of an estimator

    @property
    def kind(self) -> Kind:
        """Return the kind of a package of this problem."""
        return kind_of(self.estimation)

    @property
    def own_parameters(self) -> tuple[Signal, ...]:
        """Return the parameters of the user."""
        more = 0 if self.estimation is None else self.estimation.signals
        return self.parameters[: len(self.parameters) - self.augmentation.data - more]

    @property
    def data_behind(self) -> int:
        """Return the number of values after the user's parameters: data of blocks and intervals, measurements."""
        return self.augmentation.data + (0 if self.estimation is None else self.estimation.data)

    @property
    def measured(self) -> int:
        """Return the number of states of the user."""
        return self.nx - self.augmentation.count

    @property
    def own_states(self) -> tuple[Signal, ...]:
        """Return the states of the user."""
        return self.states[: len(self.states) - self.augmentation.count]

    def refuse_augmented(self, what: str) -> None:
        """Raise ProblemError if ``what`` does not support the added states of this problem."""
        unknown = {"previous controls", "time", "discrete states", "nonlinear algebraic equations"}
        found = sorted(unknown & self.uses)
        if found:
            raise ProblemError(
                f"{what}: '{self.name}' has {', '.join(found)}, for which it is not made; expected a problem of states "
                "and controls alone, as with terminal_least_squares() in the place of lqr_terminal_cost()"
            )

    @property
    def algebraic_names(self) -> tuple[str, ...]:
        """Return the names of the user's algebraic variables."""
        return tuple(e for s in self.algebra.signals for e in s.elements) if self.algebra else ()

    @cached_property
    def _solution(self) -> Function:
        """Return the function (x, u, p, z) -> r, dr/dz of the algebraic equations."""
        assert self.algebra is not None
        x, u, p, _ = symbols(self.nx, self.nu, self.np)
        z = ca.SX.sym("z", self.algebra.size)
        r = self.algebra.equations(x, u, p, z)
        return ca.Function("solution", [x, u, p, z], [r, ca.densify(ca.jacobian(r, z))])

    def reduction(self, stage: Stage) -> Reduce:
        """Return a function (expression, order) -> the expression of a stage without algebraic variables.

        Its derivatives with respect to (x, u) are exact up to this order, by as many steps with W from z, see
        resolution.py.
        """
        algebra = self.algebra
        if algebra is None or not self.solved:
            return lambda expression, order: expression
        size = algebra.size
        p, z = part(stage.p, 0, self.np), part(stage.p, self.np, self.np + size)
        tail = part(stage.p, self.np + size)
        u = stage.u if stage.nu else ca.vertcat(*self.controls_before(elements(stage.x)))
        W = ca.reshape(tail, size, size).T
        points = newton.chord_steps(lambda at: algebra.equations(stage.x, u, p, at), z, W, algebra.inverse)

        def reduce(expression: Expression, order: int) -> Expression:
            stated = ca.substitute(expression, tail, ca.DM.zeros(tail.numel()))
            return ca.substitute(stated, z, points[order])

        return reduce

    def controls_before(self, x: Sequence[T]) -> list[T | float]:
        """Return the controls of the previous node that x contains, 0 for the others."""
        places = self.augmentation.places
        return [x[self.measured + places[j]] if j in places else 0.0 for j in range(self.nu)]

    def node_values(self, x: Array, u: Array, p: Array | None = None) -> Array:
        """Return the values that expressions of a node use for p: parameters, and then z and W at (x, u).

        Parameters are by default the declared ones. Newton's method starts from z at the first plan; NaN if it fails.
        At node N, which has no controls, those of node N - 1 are used.
        """
        p = self.p_value if p is None else p
        if self.algebra is None or not self.solved:
            return p
        algebra, evaluate = self.algebra, self._solution

        def at(z: Array) -> tuple[Array, Array]:
            r, J = evaluate(x, u, p, z)
            return np.asarray(r, dtype=float).ravel(), np.asarray(J, dtype=float)

        u = u if len(u) else np.array(self.controls_before(list(x)))
        z = newton.solve(at, algebra.first, np.array(algebra.scale))
        J = at(z)[1]
        W = -np.linalg.inv(J) if np.all(np.isfinite(J)) and np.linalg.det(J) else np.full_like(J, np.nan)
        return np.concatenate([p, z, W.ravel()])

    @property
    def newton_names(self) -> tuple[str, ...]:
        """Return the names of the variables that Newton's method solves for."""
        return self.algebra.names if self.algebra else ()

    @cached_property
    def jump_slopes(self) -> Function:
        """Return the function (x, u, p, dt) -> values of ``jump`` and their derivatives with respect to (x, u)."""
        assert self.jump is not None
        x, u, p, dt = symbols(self.nx, self.nu, self.np + self.solved)
        value = ca.densify(self.jump(x, u, p, dt))
        return ca.Function("jump_slopes", [x, u, p, dt], [value, ca.jacobian(value, ca.vertcat(x, u))])

    @cached_property
    def nonlinear_rows(self) -> bool:
        """Return True if a hard general or coupled row is no affine function of states and controls."""
        path, terminal = (curved_rows(s.h, ca.vertcat(s.x, s.u)) for s in (self.path, self.terminal))
        coupled: set[int] = set()
        if self.coupled is not None:
            ends = ca.SX.sym("x_0", self.nx), ca.SX.sym("x_N", self.nx)
            coupled = curved_rows(self.coupled(*ends), ca.vertcat(*ends))
        return any(
            row.index in coupled if row.is_coupled else row.index in path or row.index_terminal in terminal
            for row in self.rows
            if row.hard and (row.is_general or row.is_coupled)
        )

    @property
    def rows_on_states(self) -> tuple[int, ...]:
        """Return 1 for every row that depends on states, and on no control, else 0."""
        path = self.path
        mixed = ca.which_depends(path.h, path.u, 1, True) if path.nh else ()
        return tuple(
            int(row.kind != "control" and not (row.is_general and row.index >= 0 and mixed[row.index]))
            for row in self.rows
        )

    @property
    def idle_end(self) -> bool:
        """Return True if no cost and no equation depends on x_N.

        The last control then affects only its own node, and bounds of x_N if there are any.
        """
        end = self.terminal
        priced = bool(end.ny) or end.cost is not None or self.terminal_lqr is not None or self.coupled_rows
        limited = any(k == self.N and self.rows[row].is_equation for k, _, _, row in self.qp_rows)
        return not (priced or limited or self.path.cost_rate is not None)

    @property
    def pulled_rows(self) -> tuple[int, ...]:
        """Return the hard general rows at node 0 that depend only on controls, previous controls and data."""
        path = self.path
        if not path.nh:
            return ()
        known = {self.measured + place for place in self.augmentation.places.values()}
        states = ca.vertcat(*(x for i, x in enumerate(elements(path.x)) if i not in known))
        of_states, of_controls = (ca.which_depends(path.h, z, 1, True) for z in (states, path.u))
        return tuple(
            i
            for i, row in enumerate(self.rows)
            if row.is_general and row.soft is None and 0 in row.nodes and row.index >= 0
            if of_controls[row.index] and not of_states[row.index]
        )

    @cached_property
    def nonlinear_model(self) -> bool:
        """Return True if the dynamics are no affine function of states and controls."""
        x, u, p = (self.path.x, self.path.u, self.path.p)
        f = self.dynamics(x, u, p) if self.jump is None else ca.vertcat(self.dynamics(x, u, p), self.jump(x, u, p, 1))
        return bool(curved_rows(f, ca.vertcat(x, u)))

    @property
    def nonlinear_cost(self) -> bool:
        """Return True if the cost is no quadratic function of states and controls."""
        return any(_is_curved(stage) for stage in (self.path, self.terminal))

    @property
    def model_parameters(self) -> frozenset[str]:
        """Return the elements of parameters on which the model depends: dynamics, jumps, algebraic equations."""
        x, u, p = self.path.x, self.path.u, self.path.p
        parts = [self.dynamics(x, u, p), *([] if self.jump is None else [self.jump(x, u, p, 1)])]
        if self.algebra is not None:
            parts += [self.algebra.values(x, u, part(p, 0, self.np), ca.SX.sym("z", self.algebra.size))]
            parts += [self.algebra.equations(x, u, part(p, 0, self.np), ca.SX.sym("z", self.algebra.size))]
        names = [element for signal in self.own_parameters for element in signal.elements]
        moved = ca.which_depends(ca.vertcat(*parts), p, 1, False) if names else ()
        return frozenset(name for name, moves in zip(names, moved, strict=False) if moves)

    @property
    def couples_free_start(self) -> bool:
        """Return True if rows couple x_N with components of x_0 that the solver chooses.

        A recursion over the stages cannot satisfy such equations; solve() then leaves an indefinite Hessian to the QP
        solver.
        """
        return bool(self.coupled_rows and self.free_initial)

    @property
    def nx(self) -> int:
        return self.path.nx

    @property
    def nu(self) -> int:
        return self.path.nu

    @property
    def np(self) -> int:
        """Return the number of parameters, including those that the compiler adds."""
        return int(self.path.p.numel()) - self.solved

    @property
    def solved(self) -> int:
        """Return the number of values of a node that Newton's method finds.

        In expressions they follow the parameters.
        """
        return self.algebra.data if self.algebra else 0

    @property
    def control_reference(self) -> tuple[int, ...]:
        """Return for every control the index in y of the first path residual that is this control, or -1."""
        places = self.path.y_elements
        return tuple(places.index(self.nx + j) if self.nx + j in places else -1 for j in range(self.nu))

    @cached_property
    def control_start(self) -> Function:
        """Return the function (p, yref) -> u (nu,), controls at which residuals equal their references, else 0."""
        yref, values = ca.SX.sym("yref", self.path.ny), []
        for j in range(self.nu):
            found = self.path.target_of(self.nx + j)
            values.append(ca.SX(0) if found is None else ca.substitute(found[0], found[1], yref))
        return ca.Function("control_start", [self.path.p, yref], [ca.densify(ca.vertcat(*values))])

    @property
    def data(self) -> Array:
        """Return the declared values that expressions use for p; results of Newton's method are NaN."""
        return np.concatenate([self.p_value, np.full(self.solved, np.nan)])

    @property
    def reference_controls(self) -> Array:
        """Return the controls of the first plan with the declared data, before clipping to their bounds, (nu,)."""
        found = np.asarray(self.control_start(self.data, self.path.reference)).ravel()
        return np.where(np.isfinite(found), found, 0.0)

    @property
    def uniform(self) -> bool:
        """Return True if all intervals have the same length."""
        return len(set(self.dt)) == 1

    @property
    def x_initial(self) -> Array:
        """Return x_0 for --check, --simulate, main.c and test vectors, (nx,)."""
        return np.array([v for s in self.states for v in s.value])

    @property
    def p_value(self) -> Array:
        """Return the declared parameter values, (np,)."""
        return np.array([v for s in self.parameters for v in s.value])

    @cached_property
    def corners(self) -> tuple[tuple[str, Self], ...]:
        """Return the problem with parameters and initial states at corners of their ranges, named "m = 0.1, k = 3".

        The declared problem comes first, with the name "". All corners are returned if at most MOST_RANGES elements
        have a range, else one problem for each end of the range of each element.
        """
        signals = (*self.parameters, *self.states)
        ends = [(s, i, low, high) for s in signals for i, (low, high) in enumerate(zip(s.low, s.high, strict=True))]
        wide = [(s, i, (low, high)) for s, i, low, high in ends if low < high and math.isfinite(high - low)]
        if len(wide) <= MOST_RANGES:
            moved = [list(zip(wide, values, strict=True)) for values in product(*(w[2] for w in wide))] if wide else []
        else:
            moved = [[(w, value)] for w in wide for value in w[2]]
        return (("", self), *((_in_words(corner), self._at(corner)) for corner in moved))

    def _at(self, corner: Corner) -> Self:
        """Return the problem with other values of some elements."""
        values = {s.name: list(s.value) for s in (*self.parameters, *self.states)}
        for (signal, i, _), value in corner:
            values[signal.name][i] = value
        states, parameters = (
            tuple(replace(s, value=tuple(values[s.name])) for s in signals)
            for signals in (self.states, self.parameters)
        )
        return replace(self, states=states, parameters=parameters)

    @cached_property
    def qp_rows(self) -> tuple[ImposedRow, ...]:
        """Return every row of the QP besides the control bounds, sorted by node."""
        return imposed_rows(self.rows, self.N)

    @property
    def end_rows(self) -> tuple[int, ...]:
        """Return the indices in qp_rows of hard rows that are imposed only at node N, including coupled rows."""
        found = []
        for m, (k, _, _, row) in enumerate(self.qp_rows):
            stated = self.rows[row]
            if k == self.N and stated.soft is None and (stated.is_coupled or tuple(stated.nodes) == (self.N,)):
                found.append(m)
        return tuple(found)

    @property
    def coupled_rows(self) -> int:
        """Return the number of scalar rows r(x_0, x_N)."""
        return sum(row.is_coupled for row in self.rows)

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(e for s in self.states for e in s.elements)

    @property
    def control_names(self) -> tuple[str, ...]:
        return tuple(e for s in self.controls for e in s.elements)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        return tuple(e for s in self.parameters for e in s.elements)


def _in_words(corner: Corner) -> str:
    return ", ".join(f"{signal.elements[i]} = {value:g}" for (signal, i, _), value in corner)


def symbols(nx: int, nu: int, np_: int) -> tuple[Expression, Expression, Expression, Expression]:
    """Return new SX symbols x, u, p, dt of the given sizes."""
    return ca.SX.sym("x", nx), ca.SX.sym("u", nu), ca.SX.sym("p", np_), ca.SX.sym("dt")


def model_function(name: str, inputs: Sequence[Expression], values: Sequence[Expression]) -> Function:
    """Return a function of x, u, p, dt, or of the first of them, whose only result is the column of these values."""
    return ca.Function(
        name, list(inputs), [ca.densify(ca.vertcat(*values))], ["x", "u", "p", "dt"][: len(inputs)], [name]
    )
