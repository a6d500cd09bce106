"""Working-set changes and operations of the stirred tank reactor are counted where its set point jumps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from examples import cstr
from nmpc_codegen import Options, build
from verification.robustness.work import Loop, Recorded, count
from verification.scenarios import FIGURE_6

#: LEAST: number of samples per set point above which a loop is counted with optimisation. AFTER: samples of the fit.
LEAST = AFTER = 20


@dataclass(frozen=True, eq=False)
class Jumps:
    """The loop of Fig. 6 has working-set changes and counted operations per sample; ``at``: samples of a set point."""

    changes: np.ndarray
    operations: np.ndarray
    at: int

    def most(self, jump: int) -> int:
        """Return the most working-set changes of a sample among three from a jump on."""
        return int(self.changes[jump * self.at : jump * self.at + 3].max())

    @property
    def per_change(self) -> float:
        """Return the slope of the operations over the changes, in a few samples after the jumps."""
        near = np.concatenate([np.arange(self.at, self.at + AFTER), np.arange(2 * self.at, 2 * self.at + AFTER)])
        return float(np.polyfit(self.changes[near], self.operations[near], 1)[0])


@cache
def jumps(options: Options, N: int, bounds: bool, hold: int) -> Jumps:
    """Run three set points for ``hold`` samples each; short loops are counted without optimisation."""
    make = lambda: cstr.build_ocp(N=N, state_bounds=bounds)  # noqa: E731
    c, x = build(make(), options, profile="fast"), np.array(cstr.START)
    samples, changes, u = [], [], []
    for n in range(3 * hold):
        point = None
        if n % hold == 0:
            y, y_N = FIGURE_6.set_points[n // hold]
            c.set_reference(y)
            c.set_terminal_reference(y_N)
            point = np.concatenate([y, y_N])
        samples.append((point, x))
        u.append(c.step(x))
        changes.append(c.stats.qp_iterations)
        x = np.asarray(c.integrate(x, u[-1], cstr.SAMPLING))
    recorded = Recorded([], samples, np.array(u), np.zeros(len(u), dtype=bool))
    (counted,) = count(Loop("cstr", make, options, FIGURE_6), recorded, optimise=hold > LEAST)
    return Jumps(np.array(changes), counted.operations, hold)
