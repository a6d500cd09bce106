"""The results of flights are arrays whose first axis is the number of the flight."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.records import frames
from nmpc_codegen.runtime.records.frames import Column

Array = NDArray[Any]


@dataclass(frozen=True)
class Labels:
    """The columns are named: states, rows that are judged, variables that are drawn."""

    states: tuple[str, ...]
    rows: tuple[str, ...]
    drawn: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Flown:
    """The arrays hold the results of F flights.

    Attributes:
        labels: names of the columns.
        number: (F,), numbers of the flights.
        start: (F, nx), initial states.
        drawn: (F, variables), other random variables of the flights.
        samples: (F, statuses), number of samples with each status.
        ended: (F,), status of the last sample.
        failed: (F,), the first sample with a failure, or -1.
        broken: (F,), the sample after which the state was not finite, or -1.
        cost: (F,), cost of the closed loop: sum over the samples of the stage cost at the plant's state and control,
            with the references and weights of the sample. Terms that are integrated or scaled with dt are multiplied by
            the length of a sample.
        violation: (F, rows), largest violation of each row in its unit, 0 if it is satisfied, NaN if it is unknown.
            Rows with controls are evaluated at every sample, others at every state except the first.
        last: (F, nx), the last state.
        seconds: (F, 2), mean and longest time of a sample, NaN on a device.
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
        """Return zeroed arrays for this number of flights (internal)."""
        return Flown(labels, *(np.zeros((flights, *shape), kind) for kind, shape in layout(labels).values()))

    @property
    def columns(self) -> dict[str, Array]:
        """Return {name: array} (internal)."""
        return {name: getattr(self, name) for name in layout(self.labels)}

    @property
    def table(self) -> list[Column]:
        """Return one column for each element of the arrays, with a row for each flight (internal)."""
        named, found = heads(self.labels), list[Column]()
        for name, column in self.columns.items():
            every = zip(named[name], column.T, strict=True) if name in named else [(name, column)]
            found += [Column(head.partition(".")[0], head.partition(".")[2], "", values) for head, values in every]
        return found

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row for each flight; it needs the extra ``notebook``.

        Its columns have two levels: ("start", "h"), ("samples", "OK"), ("cost", ""), ...

        Raises:
            ExtraError: pandas is not installed.
        """
        return frames.to_dataframe(self.table[1:], self.number, "flight", f"{type(self).__name__}.to_dataframe()")

    def to_parquet(self, file: str | os.PathLike[str]) -> None:
        """Write the table of to_dataframe() as a Parquet file, with the columns number, start.h, samples.OK, cost, ...

        Args:
            file: path of the file.

        Raises:
            ExtraError: pyarrow is not installed.
        """
        frames.to_parquet(self.table, file, f"{type(self).__name__}.to_parquet()")

    def put(self, other: Flown, at: Array | slice) -> None:
        """Copy the flights of ``other`` to the places ``at`` (internal)."""
        for name, column in self.columns.items():
            column[at] = getattr(other, name)

    def of_some(self, some: Any) -> Flown:
        """Return the flights that a slice, a mask or places select (internal)."""
        return Flown(self.labels, *(column[some] for column in self.columns.values()))

    def final(self, state: str) -> Array:
        """Return the last values (F,) of a state."""
        return np.asarray(self.last[:, self._place(state, self.labels.states, "state")])

    def violations(self, row: str) -> Array:
        """Return the largest violations (F,) of a row."""
        return np.asarray(self.violation[:, self._place(row, self.labels.rows, "row")])

    def _place(self, name: str, known: Sequence[str], what: str) -> int:
        if name not in known:
            raise ControllerError(f"there is no {what} {name!r} here; there is {', '.join(known) or 'none'}")
        return known.index(name)


def layout(labels: Labels) -> dict[str, tuple[type, tuple[int, ...]]]:
    """Return {column: (type, shape after the axis of flights)}."""
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
    """Return {column: names of its elements in a flat table}."""
    return {
        "start": tuple(f"start.{name}" for name in labels.states),
        "drawn": labels.drawn,
        "samples": tuple(f"samples.{status.name}" for status in Status),
        "violation": tuple(f"violation.{name}" for name in labels.rows),
        "last": tuple(f"last.{name}" for name in labels.states),
        "seconds": ("seconds.mean", "seconds.longest"),
    }
