"""Closed loops of many controllers in compiled code.

u_k = step(x_k + noise_k),   x_{k+1} = plant(x_k, u_k, dt) + disturbance_k
"""

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

Array = NDArray[Any]


@dataclass(frozen=True, eq=False, repr=False)
class Flights:
    """What has become of F flights, closed loops of the same number of samples.

    Attributes:
        name: of the package.
        steps: samples of a flight.
        dt: time between them.
        time_unit: its unit.
        states: names of the elements of x.
        controls: names of the elements of u.
        rows: names of the rows of the whole path.
        hard: (rows,), True for hard ones.
        units: name -> unit.
        status_counts: (F, number of statuses), samples with each status.
        failed: (F,), the first sample whose status is a failure, or -1.
        lost: (F,), the sample after which the state of the plant was not finite, where the flight has ended, or -1.
        ended: (F,), status of the last sample.
        cost: (F,), sum over the samples of the cost of a node at the state of the plant and its control, with the
            references and weights of the sample; what is integrated or scaled with dt counts the length of a sample.
        violation: (F, rows), largest violation of each row in its unit, 0 where it is kept, NaN where it is not known:
            of a row with controls at every sample, of another one at every state but the first.
        rounding: (rows,), up to which violations are rounding.
        last: (F, nx), last states.
        seconds: (F, 2), mean and longest time of a sample, NaN on a device.
        x: (F, steps + 1, nx), NaN after the end of a flight; None without record=True.
        u: (F, steps, nu); the same.
        status: (F, steps), -1 after the end; the same.
        draws: the random numbers, as far as they can be drawn again.
    """

    name: str
    steps: int
    dt: float
    time_unit: str
    states: tuple[str, ...]
    controls: tuple[str, ...]
    rows: tuple[str, ...]
    hard: NDArray[np.bool_]
    units: Mapping[str, str]
    status_counts: NDArray[np.int64]
    failed: NDArray[np.int64]
    lost: NDArray[np.int64]
    ended: NDArray[np.int8]
    cost: Array
    violation: Array
    rounding: Array
    last: Array
    seconds: Array
    x: Array | None
    u: Array | None
    status: NDArray[np.int8] | None
    draws: Draws

    def __len__(self) -> int:
        return len(self.failed)

    def __repr__(self) -> str:
        return f"<Flights {self.name}: {len(self)} of {self.steps} samples, {self._outcome()}>"

    def __str__(self) -> str:
        return self.summary()

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(F,): True for flights of which every sample was OK."""
        return np.asarray(self.status_counts[:, Status.OK] == self.steps)

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """(F,): True for flights with a failure, a state that was not finite, or a hard row that is violated, or not
        known."""
        violated = np.any(~(self.violation <= self.rounding) & self.hard, axis=1)
        return np.asarray((self.failed >= 0) | (self.lost >= 0) | violated)

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
            f"{int(np.sum(self.lost >= 0))} whose state was not finite"
        )
        if len(self):
            cost = np.where((self.lost < 0) & np.isfinite(self.cost), self.cost, -np.inf)
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
        total = self.status_counts.sum(axis=0)
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
