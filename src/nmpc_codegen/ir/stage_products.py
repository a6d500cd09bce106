"""Products with the stage matrices: written out over structural nonzeros for small models, dense loops else.

The patterns come from the stores of the lifted kernels, so they are structural and exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import accumulate

from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine, nonzeros

# Columns of a dense matrix that are processed together; leading dimensions are rounded up to it.
PANEL = 4

# Largest number of nonzeros of S and Q together that is written out.
WRITTEN_OUT = 256

Pattern = frozenset[tuple[int, int]]


@dataclass(frozen=True)
class Products:
    """Structural nonzeros (row, column) of S = [A B], and of the lower triangles Q and Q_N."""

    nx: int
    nu: int
    S: Pattern
    Q: Pattern
    Q_N: Pattern

    @property
    def written_out(self) -> bool:
        """True: over the structural nonzeros; False: dense loops."""
        return len(self.S) + len(self.Q) + len(self.Q_N) <= WRITTEN_OUT

    @property
    def spelling(self) -> str:
        """Stem of the templates that print them."""
        return "nonzeros" if self.written_out else "loops"

    @property
    def counts(self) -> Mapping[str, OpCount]:
        """Operations of one run of every product with a vector, by C function."""
        return {
            "state_step": self.state_step,
            "adjoint_step": self.adjoint_step,
            "terminal_adjoint": self.terminal_adjoint,
        }

    @property
    def column_counts(self) -> Mapping[str, OpCount]:
        """Operations on one panel of columns, by C function; without a Hessian of the last node none are with it."""
        terminal = {"condense_terminal_panel": self.terminal_panel} if self.Q_N else {}
        return {
            "condense_forward_panel": self.forward_panel,
            **terminal,
            "condense_backward_panel": self.backward_panel,
        }

    @property
    def state_step(self) -> OpCount:
        """A dx + B du."""
        return _accumulated(len(self.S) if self.written_out else self.nx * (self.nx + self.nu))

    @property
    def adjoint_step(self) -> OpCount:
        """S' w + Q z."""
        entries = sum(len(e) for _, _, e in self.adjoint)
        rows = sum(len(r) for _, r, _ in self.adjoint) if self.written_out else self.nx * (self.nx + self.nu)
        return _accumulated(rows + entries)

    @property
    def terminal_adjoint(self) -> OpCount:
        """Q_N dx."""
        return _accumulated(sum(len(entries) for _, entries in self.terminal))

    @property
    def forward_panel(self) -> OpCount:
        """A G, one panel of columns."""
        if self.written_out:
            return _summed(len(columns) for _, columns in self.A_rows) * PANEL
        return _accumulated(self.nx * self.nx) * PANEL

    @property
    def terminal_panel(self) -> OpCount:
        """Q_N G, one panel of columns."""
        entries = [len(e) for _, e in self.terminal]
        return (_summed(entries) if self.written_out else _accumulated(sum(entries))) * PANEL

    @property
    def backward_panel(self) -> OpCount:
        """S' W + Q (G, 0), one panel of columns."""
        if self.written_out:
            return _summed(len(rows) + len(e) for _, rows, e in self.condensed) * PANEL
        return _accumulated(self.nx * (self.nx + self.nu) + sum(len(e) for _, _, e in self.condensed)) * PANEL

    def element(self, j: int) -> str:
        """Element j of z = (dx, du) in C."""
        return f"dx[{j}]" if j < self.nx else f"du[{j - self.nx}]"

    def target(self, i: int) -> str:
        """Row of W, or of T, that row i of the backward sweep belongs to."""
        return f"p->W[{i}]" if i < self.nx else f"p->T[{i - self.nx}]"

    @property
    def S_rows(self) -> list[tuple[int, list[int]]]:
        """(i, columns of row i of S)."""
        return [(i, sorted(c for r, c in self.S if r == i)) for i in range(self.nx)]

    @property
    def A_rows(self) -> list[tuple[int, list[int]]]:
        """(i, columns of row i of A)."""
        return [(i, [c for c in columns if c < self.nx]) for i, columns in self.S_rows]

    @property
    def adjoint(self) -> list[tuple[int, list[int], list[tuple[int, int, int]]]]:
        """(i, rows j with S[j][i], entries of Q z in row i) for every component of z."""
        return [(i, self._column(i), _entries(self.Q, i)) for i in range(self.nx + self.nu)]

    @property
    def condensed(self) -> list[tuple[int, list[int], list[tuple[int, int, int]]]]:
        """The same for Q (G, 0): entries with the states only."""
        return [(i, rows, [e for e in entries if e[2] < self.nx]) for i, rows, entries in self.adjoint]

    @property
    def terminal(self) -> list[tuple[int, list[tuple[int, int, int]]]]:
        """(i, entries of Q_N dx in row i)."""
        return [(i, _entries(self.Q_N, i)) for i in range(self.nx)]

    @property
    def Q_read(self) -> list[tuple[int, int]]:
        """Stored entries that the backward sweep reads."""
        return sorted({(r, c) for _, _, entries in self.condensed for r, c, _ in entries})

    @property
    def read_A(self) -> list[int]:
        """Columns of A with nonzeros."""
        return sorted({c for _, c in self.S if c < self.nx})

    @property
    def read_w(self) -> list[int]:
        """Rows of S with nonzeros."""
        return sorted({r for r, _ in self.S})

    @property
    def read_g(self) -> list[int]:
        """States that the cost sees."""
        return sorted({j for _, _, entries in self.condensed for _, _, j in entries})

    @property
    def Q_sorted(self) -> list[tuple[int, int]]:
        """Nonzeros of Q in the order of the tables."""
        return sorted(self.Q)

    @property
    def Q_N_sorted(self) -> list[tuple[int, int]]:
        """Nonzeros of Q_N in the order of the tables."""
        return sorted(self.Q_N)

    @property
    def Q_blocks(self) -> list[list[int]]:
        """Rows of the irreducible diagonal blocks of Q."""
        return irreducible_blocks(self.Q, self.nx + self.nu)

    @property
    def Q_N_blocks(self) -> list[list[int]]:
        """Rows of the irreducible diagonal blocks of Q_N."""
        return irreducible_blocks(self.Q_N, self.nx)

    @property
    def Q_block_ends(self) -> list[int]:
        """Rows up to the end of every block of Q."""
        return list(accumulate(len(block) for block in self.Q_blocks))

    @property
    def Q_N_block_ends(self) -> list[int]:
        """Rows up to the end of every block of Q_N."""
        return list(accumulate(len(block) for block in self.Q_N_blocks))

    def _column(self, i: int) -> list[int]:
        return sorted(r for r, c in self.S if c == i)


def irreducible_blocks(lower: Pattern, n: int) -> list[list[int]]:
    """Rows of the irreducible diagonal blocks of a symmetric matrix, each sorted."""
    found: list[set[int]] = [{i} for i in range(n)]
    for r, c in lower:
        first, second = (next(s for s in found if i in s) for i in (r, c))
        if first is not second:
            first |= second
            found.remove(second)
    return sorted(sorted(s) for s in found)


def _accumulated(n: int) -> OpCount:
    """n products, each added to something."""
    return OpCount(add=n, mul=n)


def _summed(terms: Iterable[int]) -> OpCount:
    """One sum of products per number of terms."""
    return sum((OpCount(add=max(0, n - 1), mul=n) for n in terms), OpCount())


def _entries(lower: Pattern, i: int) -> list[tuple[int, int, int]]:
    """(stored row, stored column, j) of the nonzeros (i, j) of a symmetric matrix kept as its lower triangle."""
    found = [(r, c, c) for r, c in lower if r == i] + [(r, c, r) for r, c in lower if c == i and r != i]
    return sorted(found, key=lambda e: e[2])


def pattern(routine: Routine, port: str) -> Pattern:
    """Structural nonzeros of an output matrix; all of it if a looped routine has many."""
    index = next(i for i, p in enumerate(routine.outputs) if p.name == port)
    rows, cols = routine.outputs[index].rows, routine.outputs[index].cols
    if isinstance(routine, LoopedRoutine):
        if rows * cols > 2 * WRITTEN_OUT:
            return frozenset((r, c) for r in range(rows) for c in range(cols))
        return frozenset(divmod(e, cols) for e in nonzeros(routine)[port])
    return frozenset(divmod(element, cols) for o, element, _ in routine.stores if o == index)
