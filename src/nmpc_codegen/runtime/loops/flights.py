"""Flights holds the results of many closed loops: samples, if they were recorded, and a summary."""

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
    """Flights are the results of F closed loops with the same number of samples.

    The attributes of Flown hold the results of each flight: number, start, samples, ended, failed, broken, cost,
    violation, last, seconds.

    Attributes:
        name: name of the package.
        steps: number of samples of a flight.
        dt: time between samples.
        time_unit: its unit.
        controls: names of the elements of u.
        hard: (rows,), True for hard ones.
        units: name -> unit.
        rounding: (rows,), violations up to these values are rounding.
        x: (F, steps + 1, nx), NaN after the end of a flight; None without record=True.
        u: (F, steps, nu), NaN after the end; None without record=True.
        status: (F, steps), -1 after the end; None without record=True.
        draws: the generator of the random numbers.
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
        """Return the names of the elements of x."""
        return self.labels.states

    @property
    def rows(self) -> tuple[str, ...]:
        """Return the names of the rows that hold along the whole path."""
        return self.labels.rows

    @property
    def status_counts(self) -> Array:
        """Return the number of samples with each status, (F, number of statuses)."""
        return self.samples

    @property
    def lost(self) -> Array:
        """Return the sample after which the plant's state was not finite and the flight ended, (F,), or -1."""
        return self.broken

    def __repr__(self) -> str:
        return f"<Flights {self.name}: {len(self)} of {self.steps} samples, {self._outcome()}>"

    def __str__(self) -> str:
        return self.summary()

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Return True for each flight whose samples were all OK, (F,)."""
        return np.asarray(self.samples[:, Status.OK] == self.steps)

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Return True for each flight with a failure, a state that is not finite, or a violated or unknown hard row."""
        violated = np.any(~(self.violation <= self.rounding) & self.hard, axis=1)
        return np.asarray((self.failed >= 0) | (self.broken >= 0) | violated)

    def plot(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot the paths of all flights, wrong ones in red on top; write the figure to ``file`` if it is given.

        Raises:
            ControllerError: the samples were not recorded, or there is no flight.
            ExtraError: matplotlib is not installed.
        """
        from nmpc_codegen.pictures import paths

        return paths.draw([self], self.wrong, f"{len(self)} flights, {int(self.wrong.sum())} of them wrong", file)

    def summary(self) -> str:
        """Return a few lines: flights, samples by status, failed and lost flights, cost, violated rows."""
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
        """Return the random numbers added to the state after every sample of flight i, (steps, nx)."""
        return self.draws.of(self.draws.disturbance, self._number(i), self.steps)

    def noise(self, i: int) -> Array:
        """Return the random numbers added to the measured states of flight i, (steps, nx)."""
        return self.draws.of(self.draws.noise, self._number(i), self.steps)

    def _number(self, i: int) -> int:
        if not is_integer(i) or not 0 <= i < len(self):
            raise ControllerError(f"flight {i!r}; expected an integer between 0 and {len(self) - 1}")
        return int(i)
