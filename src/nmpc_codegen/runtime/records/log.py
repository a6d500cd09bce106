"""A Log is the record of a closed loop, which can be summarised, plotted, tabulated and saved."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import list_some
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.diagnosis.diagnose import WARNED
from nmpc_codegen.runtime.records import frames, log_file, timing
from nmpc_codegen.runtime.records.frames import Column
from nmpc_codegen.runtime.records.trace import File, Record

Array = NDArray[np.float64]

MOST_RANGES = 4  # largest number of ranges of samples that the summary lists for a status


@dataclass(frozen=True, eq=False, repr=False)
class Log(Record):
    """A log is the record of a closed loop, which can be summarised, plotted, tabulated and saved.

    simulate() and open_recording() return a Log; print(log) prints its summary.

    Examples:
        >>> from nmpc_codegen import OCP, build, simulate
        >>> ocp = OCP("tank", T=10.0, N=10)
        >>> h, q = ocp.state("h", unit="m"), ocp.control("q", unit="m/s")
        >>> ocp.dynamics({h: q - 0.1 * h})
        >>> ocp.least_squares(h, weight=1, reference=0.5)
        >>> ocp.subject_to(0, q, 0.2)
        >>> references = {"h": [0.5] * 10 + [0.8] * 10}
        >>> log = simulate(build(ocp), [0.3], 20, references=references, disturbance=lambda k, x: [0.02 * (k == 15)])
        >>> log.ok, log.x.shape, log.u.shape
        (True, (21, 1), (20, 1))
    """

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Log {self.name}: {self._length()}, {self._outcome()}; x {self.x.shape}, u {self.u.shape}>"

    def _repr_html_(self) -> str:
        from nmpc_codegen.pictures.notebook import of_log

        return of_log(self, self.summary().partition(": ")[2])

    @property
    def ok(self) -> bool:
        """Return True if every sample was solved."""
        return bool(np.all(self.status == Status.OK))

    @property
    def failure(self) -> str:
        """Return the text of diagnose() at the first sample that was not OK; "" if all samples were."""
        bad = [Status(s) for s in self.status if s != Status.OK]
        return self.reasons[bad[0]] if bad else ""

    @property
    def failures(self) -> int:
        """Return the number of samples that failed: their status is neither OK nor NOT_CONVERGED."""
        return sum(Status(s).is_failure for s in self.status)

    @property
    def first_failure(self) -> str:
        """Return when, where and why a sample failed first; "" if none did."""
        return next((self._first(status) for status in self._in_order() if status.is_failure), "")

    def _in_order(self) -> list[Status]:
        """Return the statuses that occur, in the order of their first samples."""
        return sorted(map(Status, self.reasons), key=lambda s: int(np.argmax(self.status == s)))

    def _first(self, status: Status) -> str:
        """Return the number, the time and the diagnosis of the first sample with a status."""
        first = int(np.argmax(self.status == status))
        why = self.reasons[status].removeprefix(f"{status.name}: ")
        when = f"sample {self.number(first)}, t = {self.t[first]:g} {self.time_unit}"
        return f"first {status.name}: {when}: " + "\n    ".join(why.splitlines())

    def _length(self) -> str:
        time = "" if self.time_unit == "samples" else f" over {self.t[-1]:g} {self.time_unit}"
        return f"{len(self.u)} samples{time}"

    def _outcome(self) -> str:
        found = []
        for status in np.unique(self.status):
            samples = [self.number(int(k)) for k in np.flatnonzero(self.status == status)]
            where = f" (samples {_ranges(samples)})" if status != Status.OK else ""
            found.append(f"{Status(status).name} {len(samples)}{where if len(samples) > 1 else ''}")
        return ", ".join(found) or "none"

    def summary(self) -> str:
        """Return a summary in a few lines: length, statuses, computing times, last state.

        For each status other than OK it says when and why it occurred first.
        """
        lines = [f"{self.name}: {self._length()}", f"status: {self._outcome()}"]
        reasons = "\n".join(self._first(status) for status in self._in_order() if status != Status.OK).splitlines()
        lines += [line for i, line in enumerate(reasons) if WARNED not in line or line not in reasons[:i]]
        if len(self.time_ns):
            lines.append(f"time per sample: {timing.in_words(self)[0]}")
        if (found := self.estimates) is not None and len(found.status):
            bad = int(np.sum(found.status != Status.OK))
            median, worst = timing.short_time(np.median(found.time_ns)), timing.short_time(np.max(found.time_ns))
            lines.append(f"estimator: {bad} samples not OK; median {median}, worst {worst}")
        if len(self.began_ns):
            lines += timing.in_words(self)[1:]
            left_out = round((self.t[-1] - self.t[0]) / self.dt) - len(self.u)
            lines += [f"{left_out} samples are missing in the recording"] if left_out else []
            lines += self.remarks
        last = zip(self.states, self.x[-2 if len(self.began_ns) else -1], strict=True)
        lines.append("last state: " + list_some([f"{trace.name} = {value:.6g}" for trace, value in last]))
        return "\n".join(lines)

    def bounds(self, name: str) -> tuple[Array, Array]:
        """Return the lower and upper bounds of a state, control or row at every sample, (steps,) each.

        For a signal these are the tightest bounds of the rows in ``limits`` on it; inf without such a row. These rows
        hold at several nodes or at the first one.

        Args:
            name: name of the signal or row.

        Raises:
            ControllerError: no quantity, or more than one, has this name.
        """
        groups = {"x": self.states, "u": self.controls, "h": self.rows}
        places = [(array, i) for array, traces in groups.items() for i, t in enumerate(traces) if t.name == name]
        if len(places) > 1:
            raise ControllerError(f"bounds: {name!r} is a signal and a row; expected a row with a name of its own")
        of_rows = [] if places else [i for i, limit in enumerate(self.limits) if limit.name == name]
        if not places and not of_rows:
            known = list_some([trace.name for traces in groups.values() for trace in traces])
            raise ControllerError(f"bounds: there is no {name!r}; expected one of {known}")
        rows = of_rows or [i for i, limit in enumerate(self.limits) if (limit.array, limit.column) == places[0]]
        lower, upper = self.lower[:, rows], self.upper[:, rows]
        return lower.max(axis=1, initial=-np.inf), upper.min(axis=1, initial=np.inf)

    def plot(self, file: File = None) -> Any:
        """Plot states, controls, rows, changing parameters and computing times over time; it needs the extra ``plot``.

        Hard bounds are dashed and soft ones dotted; they are shown where a curve comes near or violates them.
        References of single states and controls are thin lines. With an estimator, the plot also shows estimates with
        two standard deviations, measurements, and estimated parameters. Marks at the lower edge show samples that are
        RELAXED or NOT_CONVERGED (orange) or have another status than OK (red).

        Args:
            file: file for the picture (.png, .pdf, .svg); None: only return the figure, for plt.show().

        Returns:
            The matplotlib figure. The other plots have the same argument, result and error.

        Raises:
            ExtraError: matplotlib is not installed.
        """
        from nmpc_codegen.pictures import over_time

        return over_time.draw(self, file)

    def plot_plans(self, every: int = 5, file: File = None) -> Any:
        """Plot states and controls together with the plans of some samples, to compare prediction and outcome.

        Args:
            every: number of samples from one plotted plan to the next.
            file: as in plot().

        Raises:
            ControllerError: the log has no plans.
        """
        from nmpc_codegen.pictures import plans

        return plans.draw(self, every, file)

    def plot_rows(self, rows: Sequence[str] | str | None = None, file: File = None) -> Any:
        """Plot for each row the least distance of the plans from its bounds, and its largest multiplier.

        Minimum and maximum are taken over the horizon; marks show samples in which the row is active.

        Args:
            rows: name of a row, or names; None: the rows nearest to their bounds, at most twelve.
            file: as in plot().

        Raises:
            ControllerError: the log has no plans, or there is no such row.
        """
        from nmpc_codegen.pictures import row_distances

        return row_distances.draw(self, rows, file)

    def plot_times(self, dt: float | None = None, file: File = None) -> Any:
        """Plot the distribution of computing times with median, worst case and deadline.

        For a recording also the periods.

        Args:
            dt: deadline, in the unit of time of the problem; None: the sampling time.
            file: as in plot().
        """
        from nmpc_codegen.pictures import times

        return times.draw(self, dt, file)

    def plot_xy(self, x: str, y: str, rows: bool = True, every: int = 0, file: File = None) -> Any:
        """Plot one state over another, with the region that the rows forbid.

        Args:
            x: name of a state.
            y: name of another one.
            rows: shade the region where a row is violated, if it depends only on these two states and on parameters, as
                an obstacle does; if parameters change, at their first, middle and last values.
            every: number of samples from one drawn plan to the next; 0: draw no plan.
            file: as in plot().

        Raises:
            ControllerError: there is no such state, or the log has no plans.
        """
        from nmpc_codegen.pictures import plane

        return plane.draw(self, x, y, rows, every, file)

    def compare(self, other: Record, names: tuple[str, str] = ("this", "other"), file: File = None) -> Any:
        """Plot this log and, over it, what another one has of the same names.

        Args:
            other: the other log.
            names: of the two, for the legend.
            file: as in plot().

        Raises:
            ControllerError: the logs have other units of time.
        """
        from nmpc_codegen.pictures import compare

        return compare.draw(self, other, names, file)

    def animate(
        self, file: File = None, xy: tuple[str, str] | None = None, every: int = 1, fps: float | None = None
    ) -> Any:
        """Animate the loop with the plan of every sample, over time or as one state over another.

        Args:
            file: .gif, or .mp4 if ffmpeg is installed; None: only return the animation, which a
                notebook plays.
            xy: names of two states, as in plot_xy(); None: all states and controls over time.
            every: number of samples from one picture to the next.
            fps: pictures per second, > 0; None: real time, but at least 5 and at most 30.

        Returns:
            The animation of matplotlib.

        Raises:
            ControllerError: the log has no plans, a name or number is wrong, or the file cannot be written.
        """
        from nmpc_codegen.pictures import film

        return film.draw(self, file, xy, every, fps)

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame over time; it needs the extra ``notebook``.

        Its columns have two levels: ("x", "p"), ("u", "a"), ("status", ""), ... The last row is the end of the loop,
        where only x is known; ``attrs["units"]`` has the units.

        Raises:
            ExtraError: pandas is not installed.
        """
        return frames.to_dataframe(frames.of_log(self), self.t, f"time [{self.time_unit}]", "Log.to_dataframe()")

    def to_xarray(self) -> Any:
        """Return an xarray Dataset over time, with units; it needs the extra ``notebook``.

        It contains x (time, state), u (time, control), z, h, p, y, unless they have no columns, status, cost and
        time_ns. At the end of the loop only x is known; all others are NaN there.

        Raises:
            ExtraError: xarray is not installed.
        """
        return frames.to_xarray(self)

    def to_parquet(self, file: str | os.PathLike[str]) -> None:
        """Write the table of to_dataframe() as a Parquet file, with the columns time, x.p, u.a, status, ...

        Args:
            file: path of the file.

        Raises:
            ExtraError: pyarrow is not installed.
        """
        frames.to_parquet(
            [Column("time", unit=self.time_unit, values=self.t), *frames.of_log(self)], file, "Log.to_parquet()"
        )

    def save(self, file: str | os.PathLike[str] | IO[bytes]) -> None:
        """Write everything, with names, units, bounds and reasons, to an .npz archive that numpy.load() reads, too.

        Args:
            file: path, or a file that is open for writing bytes.
        """
        log_file.write(self, file)

    @classmethod
    def load(cls, file: str | os.PathLike[str] | IO[bytes]) -> Self:
        """Return the log that save() has written.

        Raises:
            ControllerError: the file is no log.
        """
        return cls(**log_file.read(file))


def _ranges(samples: Sequence[int]) -> str:
    """Return ascending numbers as ranges, "3..7, 12"; of many ranges only the first ones."""
    ends = [i for i in range(len(samples)) if i + 1 == len(samples) or samples[i + 1] != samples[i] + 1]
    begins = [0, *(i + 1 for i in ends[:-1])]
    found = [f"{samples[i]}..{samples[j]}" if j > i else str(samples[i]) for i, j in zip(begins, ends, strict=True)]
    return ", ".join(found[:MOST_RANGES]) + (", ..." if len(found) > MOST_RANGES else "")
