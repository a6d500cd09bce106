"""The functions that a package evaluates are lifted from CasADi and grouped by purpose; they have operation counts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.ir.stage_products import Pattern, Products, bandwidth, pattern
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.package.opcount import OpCount


@dataclass(frozen=True, eq=False)
class Interval:
    """An interval has the dynamics between two nodes as functions.

    linearize: (x, u, p, dt) -> x_next, S = d x_next / d(x, u); step: (x, u, p, h) -> x_next, one integration step;
    curved: (x, u, p, dt, yref, W, mu, lam) -> x_next, S, g, Q, for Hessians with second derivatives of the dynamics.
    jump: (x, u, p, dt) -> x_next of discrete states at the end of an interval; jump_rows: also their rows of S.
    one_step: linearize for the first of its steps as straight-line code, where linearize has loops that expand. value:
    (x, u, p, dt) -> x_next, left, without jump, if repeated steps do not give it; failure: (x, u, p, dt) -> reason,
    step and stage of a failure. forward: (x, u, p, dt, dx, du) -> dx_next = A dx + B du; adjoint: (x, u, p, dt, adj) ->
    g = [A B]' adj; both for algorithms that multiply with S = [A B] without storing it.
    """

    linearize: Routine
    step: Routine
    curved: Routine | None = None
    one_step: Kernel | None = None
    forward: Routine | None = None
    adjoint: Routine | None = None
    jump: Kernel | None = None
    jump_rows: Kernel | None = None
    value: Routine | None = None
    failure: Routine | None = None


@dataclass(frozen=True, eq=False)
class IntervalProducts:
    """The products are those of vectors with the Jacobians A = d Phi / dx and B = d Phi / du of an interval.

    value: (x, u, p, dt) -> x_next; adjoint: (x, u, p, dt, lam) -> lam_x = A' lam, lam_u = B' lam;
    forced: (x, u, p, dt) -> x_next, S_next = B; free: (x, u, p, dt, S) -> x_next, S_next = A S. S and S_next are
    [nx][nu], stored row by row; every entry is written.
    """

    value: Routine
    adjoint: Routine
    forced: Routine
    free: Routine


@dataclass(frozen=True, eq=False)
class Block:
    """The Hessian block Q of a stage has its nonzeros (lower triangle), and the routine that fills it.

    ``hessian`` is None if Interval.curved computes the block; ``curvature`` is sum_i mu_i d2 h_i if it is added
    separately.
    """

    Q: Pattern = frozenset()
    hessian: Routine | None = None
    curvature: Routine | None = None


@dataclass(frozen=True, eq=False)
class StageModel:
    """A stage has cost and rows: l, g = dl / dz, h and dh / dz, and the Hessian block if there is a Hessian.

    ``integrated`` is True if the cost contains an integral over the interval. ``product`` computes w = H d, with the
    Hessian H of a general cost and the Gauss-Newton Hessian of least squares.
    """

    cost: Routine
    gradient: Routine
    rows: Routine | None = None
    block: Block = Block()
    integrated: bool = False
    product: Routine | None = None

    @property
    def Q(self) -> Pattern:
        """Return the nonzeros of the Hessian block."""
        return self.block.Q

    @property
    def hessian(self) -> Routine | None:
        """Return the routine of the Hessian block, if it is evaluated separately from the dynamics."""
        return self.block.hessian

    @property
    def curvature(self) -> Routine | None:
        """Return the routine of the curvature of the rows, if it is added separately."""
        return self.block.curvature


@dataclass(frozen=True, eq=False)
class HessianModel:
    """A Hessian model has the Hessian blocks of all stages.

    ``start``, the block of the start cost, and ``initial``, that of the coupled rows, are added to the first path
    block; ``curved``: see Interval.
    """

    start: Routine | None
    path: Block
    terminal: Block
    initial: Routine | None = None
    curved: Routine | None = None

    @property
    def Q(self) -> Pattern:
        """Return the nonzeros of the path block, with those of the start if it is added to a stored block."""
        if self.path.hessian is None or self.start is None:
            return self.path.Q
        return self.path.Q | pattern(self.start, "Q")


@dataclass(frozen=True, eq=False)
class ModelFunctions:
    """The functions of a package are lifted from CasADi.

    start: cost of node 0 in addition to that of the path; its Hessian block and ``initial``, the block of the coupled
    rows, are added to the first block of the path. coupled: r(x_0, x_N) and its Jacobians. exact: path_exact,
    terminal_exact, start_exact and initial_exact, the exact Hessian of solve() if samples have another one. algebraic:
    (x, u, p) -> algebraic variables, where x of a stage ends with those that Newton's method solves for. measurement:
    (x, p) -> y, H = dy / dx of an estimator. control_start: (p, yref) -> controls of the first plan. following:
    operations of two Newton steps at a node. products: products with the stage matrices.
    """

    interval: Interval
    products: Products
    start: StageModel
    path: StageModel
    terminal: StageModel
    initial: Routine | None
    coupled: Routine | None
    exact: tuple[Routine, ...] = ()
    algebraic: Kernel | None = None
    measurement: Kernel | None = None
    control_start: Kernel | None = None
    following: OpCount = field(default_factory=OpCount)

    @cached_property
    def printed(self) -> tuple[Routine, ...]:
        """Return the routines that have results: a problem without terminal cost has no terminal_cost()."""
        return tuple(routine for routine in self.routines if routine.writes)

    @property
    def routines(self) -> tuple[Routine, ...]:
        """Return all routines in the order of the C text.

        Kernels that parts call come first, functions of nodes precede those that integrate, and rows are last.
        """
        found = self._own_routines
        called = (k for r in found if isinstance(r, LoopedRoutine) for k in r.kernels_of_parts)
        return (*{kernel.name: kernel for kernel in called}.values(), *found)

    @property
    def _own_routines(self) -> tuple[Routine, ...]:
        path, terminal = self.path, self.terminal
        cost = (path.cost, path.gradient)
        at_nodes, along_intervals = ((), cost) if path.integrated else (cost, ())
        return tuple(
            _present(
                *(self.interval.linearize, self.interval.step, self.interval.value, self.interval.jump),
                self.interval.failure,
                *(self.interval.forward, self.interval.adjoint),
                *(*at_nodes, path.hessian, path.curvature, path.product),
                *(terminal.cost, terminal.gradient, terminal.hessian, terminal.curvature, terminal.product),
                *(self.start.cost, self.start.gradient, self.start.hessian, self.initial),
                *(*along_intervals, self.interval.curved, *self.exact),
                *(path.rows, terminal.rows, self.coupled, self.algebraic, self.measurement, self.control_start),
            )
        )


def products_of(interval: Interval, blocks: HessianModel, previous: int) -> Products:
    """Return the products with the stage matrices, whose patterns are the elements that the routines store.

    ``previous`` is the number of last states that store controls of the previous node.
    """
    S = next(port for port in interval.linearize.outputs if port.name == "S")
    patterns = pattern(interval.linearize, "S"), blocks.Q, blocks.terminal.Q
    return Products(S.rows, S.cols - S.rows, *patterns, bandwidth(previous, S.rows, *patterns))


def _present(*routines: Routine | None) -> Iterator[Routine]:
    return (routine for routine in routines if routine is not None)


def operations(*routines: Routine | None) -> OpCount:
    """Return the operations of one run of each routine; None is skipped."""
    return sum((routine.count for routine in _present(*routines)), OpCount())
