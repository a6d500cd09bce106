"""What is kept of flights: arrays whose first axis is the flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.loops.flights import Flights

Array = NDArray[Any]


@dataclass(frozen=True)
class Labels:
    """Names of the columns: states, rows that are judged, variables that are drawn."""

    states: tuple[str, ...]
    rows: tuple[str, ...]
    drawn: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Flown:
    """What is kept of F flights.

    Attributes:
        labels: names of the columns.
        number: (F,), numbers of the flights.
        start: (F, nx), initial states.
        drawn: (F, variables), what else was drawn for them.
        samples: (F, statuses), samples by status.
        ended: (F,), the status of the last one.
        failed: (F,), the first failure, or -1.
        broken: (F,), the sample after which the state was not finite, or -1.
        cost: (F,), as in Flights.
        violation: (F, rows), the largest, in the unit of the row, NaN where it is not known.
        last: (F, nx), the last state.
        seconds: (F, 2), mean and longest time of a sample.
    """

    labels: Labels
    number: Array
    start: Array
    drawn: Array
    samples: Array
    ended: Array
    failed: Array
    broken: Array
    cost: Array
    violation: Array
    last: Array
    seconds: Array

    def __len__(self) -> int:
        return len(self.number)

    @staticmethod
    def empty(labels: Labels, flights: int) -> Flown:
        """Internal: room for so many flights."""
        return Flown(labels, *(np.zeros((flights, *shape), kind) for kind, shape in layout(labels).values()))

    @staticmethod
    def of(flights: Flights, first: int, drawn: Array, start: Array, labels: Labels) -> Flown:
        """Internal: a part of a campaign, from its summaries."""
        f = flights
        columns = (
            *(first + np.arange(len(f)), start, drawn, f.status_counts, f.ended, f.failed, f.lost, f.cost),
            *(f.violation, f.last, f.seconds),
        )
        kinds = (kind for kind, _ in layout(labels).values())
        return Flown(labels, *(np.asarray(c, kind) for c, kind in zip(columns, kinds, strict=True)))

    @property
    def columns(self) -> dict[str, Array]:
        """Name -> array."""
        return {name: getattr(self, name) for name in layout(self.labels)}

    def put(self, other: Flown, at: Array | slice) -> None:
        """Internal: write the flights of another one to these places."""
        for name, column in self.columns.items():
            column[at] = getattr(other, name)

    def of_some(self, some: Any) -> Flown:
        """Internal: those that a slice, a mask or places name."""
        return Flown(self.labels, *(column[some] for column in self.columns.values()))

    def final(self, state: str) -> Array:
        """Last values (F,) of a state."""
        return np.asarray(self.last[:, self._place(state, self.labels.states, "state")])

    def violations(self, row: str) -> Array:
        """Largest violations (F,) of a row."""
        return np.asarray(self.violation[:, self._place(row, self.labels.rows, "row")])

    def _place(self, name: str, known: Sequence[str], what: str) -> int:
        if name not in known:
            raise ControllerError(f"there is no {what} {name!r} here; there is {', '.join(known) or 'none'}")
        return known.index(name)


def layout(labels: Labels) -> dict[str, tuple[type, tuple[int, ...]]]:
    """Column -> type, and shape behind the flights."""
    nx = (len(labels.states),)
    found: dict[str, tuple[type, tuple[int, ...]]] = {
        "number": (np.int64, ()),
        "start": (np.float64, nx),
        "drawn": (np.float64, (len(labels.drawn),)),
        "samples": (np.int32, (len(Status),)),
        "ended": (np.int8, ()),
        "failed": (np.int32, ()),
        "broken": (np.int32, ()),
        "cost": (np.float64, ()),
        "violation": (np.float64, (len(labels.rows),)),
        "last": (np.float64, nx),
        "seconds": (np.float64, (2,)),
    }
    assert tuple(found) == tuple(f.name for f in fields(Flown))[1:]
    return found


def heads(labels: Labels) -> dict[str, tuple[str, ...]]:
    """Column -> the names of its elements in a flat table."""
    return {
        "start": tuple(f"start.{name}" for name in labels.states),
        "drawn": labels.drawn,
        "samples": tuple(f"samples.{status.name}" for status in Status),
        "violation": tuple(f"violation.{name}" for name in labels.rows),
        "last": tuple(f"last.{name}" for name in labels.states),
        "seconds": ("seconds.mean", "seconds.longest"),
    }
