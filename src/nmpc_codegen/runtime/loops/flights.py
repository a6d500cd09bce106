"""What has become of many closed loops, with their samples if they were recorded, and their summary."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.batch.random import Draws
from nmpc_codegen.runtime.given import is_integer
from nmpc_codegen.runtime.loops.flown import Flown

Array = NDArray[Any]


@dataclass(frozen=True, eq=False, repr=False)
class Flights(Flown):
    """What has become of F flights, closed loops of the same number of samples.

    It has what is kept of each, the attributes of Flown: number, start, samples, ended, failed, broken, cost,
    violation, last, seconds.

    Attributes:
        name: of the package.
        steps: samples of a flight.
        dt: time between them.
        time_unit: its unit.
        controls: names of the elements of u.
        hard: (rows,), True for hard ones.
        units: name -> unit.
        rounding: (rows,), up to which violations are rounding.
        x: (F, steps + 1, nx), NaN after the end of a flight; None without record=True.
        u: (F, steps, nu); the same.
        status: (F, steps), -1 after the end; the same.
        draws: the random numbers, as far as they can be drawn again.
    """

    name: str
    steps: int
    dt: float
    time_unit: str
    controls: tuple[str, ...]
    hard: NDArray[np.bool_]
    units: Mapping[str, str]
    rounding: Array
    x: Array | None
    u: Array | None
    status: NDArray[np.int8] | None
    draws: Draws

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the elements of x."""
        return self.labels.states

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows of the whole path."""
        return self.labels.rows

    @property
    def status_counts(self) -> Array:
        """(F, number of statuses), samples with each status."""
        return self.samples

    @property
    def lost(self) -> Array:
        """(F,), the sample after which the state of the plant was not finite, where the flight has ended, or -1."""
        return self.broken

    def __repr__(self) -> str:
        return f"<Flights {self.name}: {len(self)} of {self.steps} samples, {self._outcome()}>"

    def __str__(self) -> str:
        return self.summary()

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(F,): True for flights of which every sample was OK."""
        return np.asarray(self.samples[:, Status.OK] == self.steps)

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """(F,): True for flights with a failure, a state that was not finite, or a hard row that is violated, or not
        known."""
        violated = np.any(~(self.violation <= self.rounding) & self.hard, axis=1)
        return np.asarray((self.failed >= 0) | (self.broken >= 0) | violated)

    def plot(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Figure of the paths of all flights, wrong ones in red on top; written to ``file`` if one is given.

        Raises:
            ControllerError: the samples were not recorded, or there is none.
            ExtraError: matplotlib is not installed.
        """
        from nmpc_codegen.pictures import paths

        return paths.draw([self], self.wrong, f"{len(self)} flights, {int(self.wrong.sum())} of them wrong", file)

    def summary(self) -> str:
        """A few lines: flights, samples by status, failed and lost flights, cost, rows that were violated."""
        lines = [f"{self.name}: {len(self)} flights of {self.steps} samples, {self.dt:g} {self.time_unit} each"]
        lines.append(f"status of samples: {self._outcome()}")
        lines.append(
            f"flights: {int(np.sum(self.ok))} OK throughout, {int(np.sum(self.failed >= 0))} with a failure, "
            f"{int(np.sum(self.broken >= 0))} whose state was not finite"
        )
        if len(self):
            cost = np.where((self.broken < 0) & np.isfinite(self.cost), self.cost, -np.inf)
            known = cost[cost > -np.inf]
            if known.size:
                most = f"largest {known.max():.6g} (flight {int(cost.argmax())})"
                lines.append(f"cost of flights that were not lost: median {np.median(known):.6g}, {most}")
        for name, amounts, rounding in zip(self.rows, self.violation.T, self.rounding, strict=True):
            count = int(np.sum(amounts > rounding))
            if count:
                worst = int(np.nanargmax(amounts))
                text = f"violated in {count} flight{'s' if count > 1 else ''}, by {amounts[worst]:.3g} at most"
                lines.append(f"row {name!r}: {text} (flight {worst})")
        return "\n".join(lines)

    def _outcome(self) -> str:
        total = self.samples.sum(axis=0)
        return ", ".join(f"{Status(i).name} {n}" for i, n in enumerate(total) if n) or "none"

    def disturbance(self, i: int) -> Array:
        """What was drawn and added to the state after every sample of flight i, (steps, nx)."""
        return self.draws.of(self.draws.disturbance, self._number(i), self.steps)

    def noise(self, i: int) -> Array:
        """What was drawn and added to the measured states of flight i, (steps, nx)."""
        return self.draws.of(self.draws.noise, self._number(i), self.steps)

    def _number(self, i: int) -> int:
        if not is_integer(i) or not 0 <= i < len(self):
            raise ControllerError(f"flight {i!r}; expected an integer between 0 and {len(self) - 1}")
        return int(i)
