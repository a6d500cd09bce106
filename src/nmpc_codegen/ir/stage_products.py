"""Products with the stage matrices are straight-line code over structural nonzeros for small models, else loops.

The patterns come from the stores of the lifted kernels, so they are structural and exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from nmpc_codegen.ir.product_sweeps import Loops, StageSweeps, WrittenOut
from nmpc_codegen.ir.product_sweeps import Pattern as Pattern
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine, nonzeros
from nmpc_codegen.ir.tuning import SPARSE, WRITTEN_OUT
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.opcount import OpCount


@dataclass(frozen=True)
class Products:
    """The products belong to structural nonzeros (row, column) of S = [A B] and of the lower triangles Q and Q_N.

    ``banded`` is the number of last states that store controls of the previous node; panels leave out their products.
    """

    nx: int
    nu: int
    S: Pattern
    Q: Pattern
    Q_N: Pattern
    banded: int = 0

    @property
    def written_out(self) -> bool:
        """Return True for straight-line code over the structural nonzeros, False for loops."""
        return len(self.S) + len(self.Q) + len(self.Q_N) <= WRITTEN_OUT

    @property
    def spelling(self) -> str:
        """Return the word for how the products are written: "nonzeros" or "loops"."""
        return "nonzeros" if self.written_out else "loops"

    @cached_property
    def vectors(self) -> Mapping[str, LoopedRoutine]:
        """Return the products with a vector, by C function."""
        s = self._sweeps
        return _by_name(s.state_step(), s.adjoint_step(), s.cost_gradient(), s.terminal_adjoint())

    @cached_property
    def panels(self) -> Mapping[str, LoopedRoutine]:
        """Return the products with a panel of columns; there is none with Q_N if node N has no Hessian."""
        s = self._sweeps
        return _by_name(s.forward_panel(), *((s.terminal_panel(),) if self.Q_N else ()), s.backward_panel())

    def called_vectors(self, features: Features) -> Mapping[str, LoopedRoutine]:
        """Return the products with a vector that a package contains."""
        return {name: routine for name, routine in self.vectors.items() if name in features.kernels}

    @cached_property
    def counts(self) -> Mapping[str, OpCount]:
        """Return the operations of one run of every product with a vector, by C function."""
        return {name: routine.count for name, routine in self.vectors.items()}

    @cached_property
    def column_counts(self) -> Mapping[str, OpCount]:
        """Return the operations on one panel of columns, by C function."""
        return {name: routine.count for name, routine in self.panels.items()}

    @property
    def state_step(self) -> OpCount:
        """Count A dx + B du."""
        return self.counts["state_step"]

    @property
    def adjoint_step(self) -> OpCount:
        """Count S' w + Q z."""
        return self.counts["adjoint_step"]

    @property
    def terminal_adjoint(self) -> OpCount:
        """Count Q_N dx."""
        return self.counts["terminal_adjoint"]

    @property
    def forward_panel(self) -> OpCount:
        """Count A G for one panel of columns."""
        return self.column_counts["condense_forward_panel"]

    @property
    def terminal_panel(self) -> OpCount:
        """Count Q_N G for one panel of columns."""
        return self.column_counts.get("condense_terminal_panel", OpCount())

    @property
    def backward_panel(self) -> OpCount:
        """Count S' W + Q (G, 0) for one panel of columns."""
        return self.column_counts["condense_backward_panel"]

    @property
    def sparse(self) -> tuple[bool, bool]:
        """Return whether Q and Q_N have so few nonzeros that a product over them is faster than dense blocks."""

        def few(nonzeros: Pattern, n: int) -> bool:
            return SPARSE * len(nonzeros) <= n * (n + 1) // 2

        return few(self.Q, self.nx + self.nu), few(self.Q_N, self.nx)

    @property
    def tables(self) -> Mapping[str, Sequence[int]]:
        """Return the tables that the loops read: {C name: values}."""
        return {} if self.written_out else Loops(self.nx, self.nu, self.Q, self.Q_N).tables

    @property
    def _sweeps(self) -> StageSweeps:
        if self.written_out:
            return WrittenOut(self.nx, self.nu, self.S, self.Q, self.Q_N, self.banded)
        return Loops(self.nx, self.nu, self.Q, self.Q_N, self.banded)

    @property
    def Q_blocks(self) -> list[list[int]]:
        """Return the rows of the irreducible diagonal blocks of Q."""
        return irreducible_blocks(self.Q, self.nx + self.nu)

    @property
    def Q_N_blocks(self) -> list[list[int]]:
        """Return the rows of the irreducible diagonal blocks of Q_N."""
        return irreducible_blocks(self.Q_N, self.nx)


def bandwidth(previous: int, nx: int, S: Pattern, Q: Pattern, Q_N: Pattern) -> int:
    """Return ``previous``, the number of last states that store controls of the previous node, if they act on no state.

    They must act on none by the dynamics or by products in the cost; their part of a condensed Hessian is then a band
    beside the diagonal. Otherwise return 0.
    """
    first = nx - previous
    acts = any(first <= j < nx for _, j in S)
    mixes = any(first <= r < nx and c < first for r, c in (*Q, *Q_N))
    return 0 if acts or mixes else previous


def irreducible_blocks(lower: Pattern, n: int) -> list[list[int]]:
    """Return the rows of the irreducible diagonal blocks of a symmetric matrix, each sorted."""
    found: list[set[int]] = [{i} for i in range(n)]
    for r, c in lower:
        first, second = (next(s for s in found if i in s) for i in (r, c))
        if first is not second:
            first |= second
            found.remove(second)
    return sorted(sorted(s) for s in found)


def _by_name(*routines: LoopedRoutine) -> Mapping[str, LoopedRoutine]:
    return {routine.name: routine for routine in routines}


def pattern(routine: Routine, port: str) -> Pattern:
    """Return the structural nonzeros of an output matrix; all entries if the matrix of a looped routine is large."""
    index = next(i for i, p in enumerate(routine.outputs) if p.name == port)
    rows, cols = routine.outputs[index].rows, routine.outputs[index].cols
    if isinstance(routine, LoopedRoutine):
        if rows * cols > 2 * WRITTEN_OUT:
            return frozenset((r, c) for r in range(rows) for c in range(cols))
        return frozenset(divmod(e, cols) for e in nonzeros(routine)[port])
    return frozenset(divmod(element, cols) for o, element, _ in routine.stores if o == index)
