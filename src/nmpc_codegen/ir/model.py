"""The functions that a package evaluates, lifted from CasADi, by what they are for; operation counts hang on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.stage_products import Pattern, Products, pattern
from nmpc_codegen.ir.sweep import Routine


@dataclass(frozen=True, eq=False)
class Interval:
    """The dynamics between two nodes.

    linearize: (x, u, p, dt) -> x_next, S = d x_next / d(x, u); step: (x, u, p, h) -> x_next, one integration step;
    curved: (x, u, p, dt, yref, W, mu, lam) -> x_next, S, g, Q, for Hessians that need second derivatives of them.
    """

    linearize: Routine
    step: Routine
    curved: Routine | None = None


@dataclass(frozen=True, eq=False)
class StageModel:
    """Cost and rows of a stage: l, g = dl / dz, the Hessian block Q with its nonzeros (lower triangle), h and dh / dz.

    ``hessian`` is None if the block comes with the interval; ``curvature``: sum_i mu_i d2 h_i where it is added apart;
    ``integrated``: the cost has an integral along the interval.
    """

    cost: Routine
    gradient: Routine
    Q: Pattern
    hessian: Routine | None = None
    curvature: Routine | None = None
    rows: Routine | None = None
    integrated: bool = False


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """What a Hessian contributes: the stages without their rows.

    ``initial``: what coupled rows add to the first block; ``curved``: see Interval.
    """

    path: StageModel
    terminal: StageModel
    initial: Routine | None = None
    curved: Routine | None = None


@dataclass(frozen=True, eq=False)
class ModelFunctions:
    """All functions of a package that are lifted from CasADi.

    ``initial``: what coupled rows add to the first Hessian block; ``coupled``: r(x_0, x_N) and its Jacobians.
    """

    interval: Interval
    path: StageModel
    terminal: StageModel
    initial: Routine | None
    coupled: Routine | None

    @property
    def routines(self) -> tuple[Routine, ...]:
        """In the order in which C has them: of nodes before those that integrate, rows last."""
        path, terminal = self.path, self.terminal
        cost = (path.cost, path.gradient)
        at_nodes, along_intervals = ((), cost) if path.integrated else (cost, ())
        return tuple(
            _present(
                *(self.interval.linearize, self.interval.step),
                *(*at_nodes, path.hessian, path.curvature),
                *(terminal.cost, terminal.gradient, terminal.hessian, terminal.curvature, self.initial),
                *(*along_intervals, self.interval.curved),
                *(path.rows, terminal.rows, self.coupled),
            )
        )

    @cached_property
    def products(self) -> Products:
        """Products with the stage matrices; their patterns are what the routines store."""
        S = self.interval.linearize.outputs[-1]
        return Products(S.rows, S.cols - S.rows, pattern(self.interval.linearize, "S"), self.path.Q, self.terminal.Q)


def _present(*routines: Routine | None) -> Iterator[Routine]:
    return (routine for routine in routines if routine is not None)


def operations(*routines: Routine | None) -> OpCount:
    """Operations of one run of each of the routines that there are."""
    return sum((routine.count for routine in _present(*routines)), OpCount())
