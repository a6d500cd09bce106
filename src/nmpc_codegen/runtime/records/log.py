"""The record of a closed loop: as a summary, tables, a picture and a file."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.signals import list_some
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.diagnosis.diagnose import WARNED
from nmpc_codegen.runtime.records import archive, tables
from nmpc_codegen.runtime.records.html import page, shorten, table
from nmpc_codegen.runtime.records.plot import (
    ALGEBRAIC_COLOR,
    CONTROL_COLOR,
    PARAMETER_COLOR,
    ROW_COLOR,
    SENSOR_COLOR,
    STATE_COLOR,
    TIME_COLOR,
    Curve,
    draw,
)
from nmpc_codegen.runtime.records.trace import Record, Trace

Array = NDArray[np.float64]

#: Statuses whose control is that of a QP, while its rows or its plan are doubtful.
DOUBTFUL = (Status.RELAXED, Status.NOT_CONVERGED)

#: Times per sample are drawn on a logarithmic axis if the longest one is so many times the median.
UNEVEN = 20


@dataclass(frozen=True, eq=False, repr=False)
class Log(Record):
    """The record of a closed loop, which says, draws and saves what happened."""

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Log {self.name}: {self._length()}, {self._outcome()}; x {self.x.shape}, u {self.u.shape}>"

    def _repr_html_(self) -> str:
        found: list[tuple[object, ...]] = []
        groups = (
            *(("state", self.states, self.x), ("control", self.controls, self.u)),
            *(("algebraic", self.algebraic, self.z), ("row", self.rows, self.h)),
        )
        for kind, traces, values in groups:
            lines: list[tuple[object, ...]] = []
            for trace, column in zip(traces, values.T, strict=True):
                ends = (column[0], column[-1], column.min(), column.max()) if len(column) else ("",) * 4
                lines.append((kind, trace.name, trace.unit, *ends))
            found += shorten(lines)
        return page(
            f"Log {self.name}",
            self.summary().partition(": ")[2],
            [table(("", "name", "unit", "first", "last", "least", "most"), found)],
        )

    @property
    def ok(self) -> bool:
        """True if every sample was solved."""
        return bool(np.all(self.status == Status.OK))

    @property
    def failure(self) -> str:
        """What diagnose() said at the first sample that was not OK; "" if all were."""
        bad = [Status(s) for s in self.status if s != Status.OK]
        return self.reasons[bad[0]] if bad else ""

    @property
    def failures(self) -> int:
        """Number of samples whose status is a failure: neither OK nor NOT_CONVERGED."""
        return sum(Status(s).is_failure for s in self.status)

    @property
    def first_failure(self) -> str:
        """When, where and why a sample failed first; "" if none did."""
        return next((self._first(status) for status in self._in_order() if status.is_failure), "")

    def _in_order(self) -> list[Status]:
        """The statuses that occur, in the order of their first samples."""
        return sorted(map(Status, self.reasons), key=lambda s: int(np.argmax(self.status == s)))

    def _first(self, status: Status) -> str:
        """The first sample with a status: its number, its time and what diagnose() said."""
        first = int(np.argmax(self.status == status))
        why = self.reasons[status].removeprefix(f"{status.name}: ")
        when = f"sample {first}, t = {self.t[first]:g} {self.time_unit}"
        return f"first {status.name}: {when}: " + "\n    ".join(why.splitlines())

    def _length(self) -> str:
        time = "" if self.time_unit == "samples" else f" over {self.t[-1]:g} {self.time_unit}"
        return f"{len(self.u)} samples{time}"

    def _outcome(self) -> str:
        return ", ".join(f"{Status(s).name} {np.sum(self.status == s)}" for s in np.unique(self.status)) or "none"

    def summary(self) -> str:
        """A summary in a few lines: length, statuses, when and why the first sample with each of them other than OK was
        not OK, times, last state."""
        lines = [f"{self.name}: {self._length()}", f"status: {self._outcome()}"]
        reasons = "\n".join(self._first(status) for status in self._in_order() if status != Status.OK).splitlines()
        lines += [line for i, line in enumerate(reasons) if WARNED not in line or line not in reasons[:i]]
        if len(self.time_ns):
            median, worst = np.median(self.time_ns) / 1e3, np.max(self.time_ns) / 1e3
            lines.append(f"time per sample: median {median:.1f} us, worst {worst:.1f} us")
        if (found := self.estimates) is not None and len(found.status):
            bad = int(np.sum(found.status != Status.OK))
            median, worst = np.median(found.time_ns) / 1e3, np.max(found.time_ns) / 1e3
            lines.append(f"estimator: {bad} samples not OK; median {median:.1f} us, worst {worst:.1f} us")
        last = zip(self.states, self.x[-1], strict=True)
        lines.append("last state: " + list_some([f"{trace.name} = {value:.6g}" for trace, value in last]))
        return "\n".join(lines)

    def plot(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot states, controls, general path rows and the time per sample over time. It needs the extra ``plot``.

        Hard bounds are dashed and soft ones dotted where a curve comes near or violates them; they are those at the end
        of the loop. References of bare states and controls are thin lines. With an estimator there are also estimates
        with two standard deviations, measurements, and axes of what is estimated besides states. Marks at the lower
        edge: samples that failed, red, and those that are RELAXED or NOT_CONVERGED, orange.

        Args:
            file: file for the picture (.png, .pdf, .svg); None: only return the figure, for plt.show().

        Returns:
            The matplotlib figure.

        Raises:
            ExtraError: matplotlib is not installed.
        """
        return draw(self._curves(), self._title(), self._time_label(), self._marks(), file)

    def _curves(self) -> list[Curve]:
        followed = {trace.signal: self.y[:, i] for i, trace in reversed([*enumerate(self.references)])}
        start = self.t[:-1]
        held = np.append(self.u, self.u[-1:], axis=0)
        curves = [
            self._with_estimate(Curve(trace, self.t, self.x[:, i], STATE_COLOR, followed.get(trace.name)), i)
            for i, trace in enumerate(self.states)
        ]
        curves += self._unknown_curves()
        curves += [
            Curve(trace, self.t[: len(held)], held[:, j], CONTROL_COLOR, followed.get(trace.name), held=True)
            for j, trace in enumerate(self.controls)
        ]
        curves += [Curve(trace, start, self.z[:, i], ALGEBRAIC_COLOR) for i, trace in enumerate(self.algebraic)]
        curves += [Curve(trace, start, self.h[:, i], ROW_COLOR, dots=True) for i, trace in enumerate(self.rows)]
        times = self.time_ns / 1e3
        uneven = bool(times.size and times.max() > UNEVEN * np.median(times) > 0)
        return [*curves, Curve(Trace("time", "µs"), start, times, TIME_COLOR, dots=True, logarithmic=uneven)]

    def _with_estimate(self, curve: Curve, i: int) -> Curve:
        """The curve of state i with what is measured of it and what the estimator makes of it."""
        if (found := self.estimates) is None:
            return curve
        shown = [found.y[:, m] for m, sensor in enumerate(found.sensors) if sensor.signal == curve.trace.name]
        estimate = found.x[:, i], 2 * found.std[:, i]
        return replace(curve, estimate=estimate, measured=shown[0] if shown else None)

    def _unknown_curves(self) -> list[Curve]:
        """The unknown parameters, and measurements that are no states."""
        if (found := self.estimates) is None:
            return []
        start, nx = self.t[:-1], len(self.states)
        unknown = [
            self._with_estimate(Curve(trace, start, found.p[:, i], PARAMETER_COLOR), nx + i)
            for i, trace in enumerate(found.states[nx:])
        ]
        sensors = [
            Curve(trace, start, found.y[:, m], SENSOR_COLOR, dots=True)
            for m, trace in enumerate(found.sensors)
            if not trace.signal
        ]
        return [*unknown, *sensors]

    def _title(self) -> str:
        bad = int(np.sum(self.status != Status.OK))
        return f"{self.name}  ({len(self.u)} samples{f', {bad} not OK' if bad else ''})"

    def _time_label(self) -> str:
        return "sample" if self.time_unit == "samples" else f"time [{self.time_unit}]"

    def _marks(self) -> tuple[Array, Array]:
        """Times of doubtful and of failed samples."""
        doubtful = np.isin(self.status, DOUBTFUL)
        return self.t[:-1][doubtful], self.t[:-1][(self.status != Status.OK) & ~doubtful]

    def to_dataframe(self) -> Any:
        """A pandas DataFrame over time with two levels of columns: ("x", "p"), ("u", "a"), ("status", ""), ...

        The last row is the end of the loop, where only x is known; ``attrs["units"]`` has the units. It needs the extra
        ``notebook``.

        Raises:
            ExtraError: pandas is not installed.
        """
        return tables.to_dataframe(self)

    def to_xarray(self) -> Any:
        """An xarray Dataset over time with x (time, state), u (time, control), z, h, p, y, as far as they have columns,
        status, cost, time_ns, and with units.

        At the end of the loop only x is known; the others are NaN there. It needs the extra ``notebook``.

        Raises:
            ExtraError: xarray is not installed.
        """
        return tables.to_xarray(self)

    def save(self, file: str | os.PathLike[str] | IO[bytes]) -> None:
        """Write everything, with names, units, bounds and reasons, to an .npz archive that numpy.load() reads, too."""
        archive.write(self, file)

    @classmethod
    def load(cls, file: str | os.PathLike[str] | IO[bytes]) -> Self:
        """The log that save() has written.

        Raises:
            ControllerError: the file is no log.
        """
        return cls(**archive.read(file))
