"""A Campaign has a verdict on every flight, the share lost with its confidence interval, replays and pictures."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.campaigns.flying.fly import Flyer, Job
from nmpc_codegen.campaigns.judging.verdict import LEVEL, Reason, Rules, interval_of_share
from nmpc_codegen.errors import ControllerError, warn
from nmpc_codegen.package.signals import units
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.loops.flights import Flights
from nmpc_codegen.runtime.loops.flown import Flown
from nmpc_codegen.runtime.loops.one_loop import Before, Conduct
from nmpc_codegen.runtime.records import frames
from nmpc_codegen.runtime.records.frames import Column
from nmpc_codegen.runtime.records.log import Log

Array = NDArray[Any]

#: Largest numbers of flights, and of lost flights, in plot().
DRAWN, DRAWN_LOST = 300, 100


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign has flights and their verdicts; print(result) prints a summary.

    Attributes:
        job: controller, plant and statement of the flights.
        rules: rules by which a flight is lost.
        flown: results of every flight.
        reasons: (F,), reason for the loss of each flight, numbers of Reason.
        complete: False after an interrupt.
        best: (F,), costs of reference loops (see campaign(against=)), NaN where no loop was run; None: there are none.
        against: kind of the reference loops.
    """

    job: Job
    rules: Rules
    flown: Flown
    reasons: NDArray[np.int8]
    complete: bool
    best: Array | None = None
    against: str = ""

    def __len__(self) -> int:
        return len(self.flown)

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Return True for each flight that is lost, (F,)."""
        return np.asarray(self.reasons != Reason.NONE)

    @property
    def lost_by_reason(self) -> dict[Reason, int]:
        """Return the number of lost flights for each reason that occurs."""
        return {r: int(np.sum(self.reasons == r)) for r in Reason if r and np.any(self.reasons == r)}

    @property
    def share(self) -> float:
        """Return the share of the flights that are lost."""
        return float(np.mean(self.lost)) if len(self) else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % confidence interval of the share lost of all possible flights.

        The interval is that of Clopper and Pearson; for quasi-random points it is Student's.
        """
        return self.interval_at(LEVEL)

    def interval_at(self, level: float) -> tuple[float, float]:
        """Return the interval of the share lost with another confidence, 0 < level < 1."""
        points = self.job.statement.points
        return interval_of_share(self.lost, self.flown.number // points.length if points.sets else None, level)

    @cached_property
    def losses(self) -> Array:
        """Return the relative excess cost of each flight over its reference loop, (F,); NaN without such a loop."""
        if self.best is None:
            return np.full(len(self), np.nan)
        return np.asarray((self.flown.cost - self.best) / np.abs(self.best))

    # -- flights ------------------------------------------------------------------------------------------------------

    def worst(self, count: int = 5) -> list[int]:
        """Return the numbers of the worst flights.

        First come flights whose state was not finite, then those with the largest violations, then those that did not
        arrive or ended with a failure, then those with the highest cost.

        Raises:
            ControllerError: ``count`` is no integer >= 0.
        """
        if not given.is_integer(count) or count < 0:
            raise ControllerError(f"worst: {count!r}; expected a number of flights >= 0")
        f = self.flown
        size = np.where(self.reasons == Reason.NOT_FINITE, -f.broken.astype(float), 0.0)
        size = np.where(self.reasons == Reason.ROW, self.excess, size)
        rank = np.where(self.reasons == Reason.NONE, 9, self.reasons)
        cost = np.where(np.isfinite(f.cost), f.cost, np.inf)
        order = np.lexsort((f.number, -cost, -size, rank))
        return [int(f.number[i]) for i in order[:count]]

    @property
    def excess(self) -> Array:
        """Return the largest violation of a judged row relative to the allowed one, (F,), inf if it is unknown."""
        return np.asarray(self._excess.max(axis=1, initial=0.0))

    @property
    def _excess(self) -> Array:
        """Return the violations (F, judged rows) relative to the allowed ones, inf if unknown."""
        judged = np.isfinite(self.rules.allowed)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = self.flown.violation[:, judged] / self.rules.allowed[judged]
        return np.asarray(
            np.where(np.isnan(self.flown.violation[:, judged]), np.inf, np.nan_to_num(found, posinf=np.inf))
        )

    def verdict(self, number: int) -> str:
        """Describe a flight in one line: why it is lost, its cost, its start, its random variables.

        Args:
            number: of the flight.
        """
        i, f = self._place(number), self.flown
        reason = Reason(self.reasons[i])
        why = reason.words
        if reason is Reason.NOT_ARRIVED and self.rules.targets:
            goals = self.rules.goals(self.job, number, 1)[0]
            why = self.rules.distance(f.last[i], goals, f.labels.states) or why
        elif reason is Reason.ROW:
            j = np.flatnonzero(np.isfinite(self.rules.allowed))[int(self._excess[i].argmax())]
            why = f"row {f.labels.rows[j]!r} is violated by {f.violation[i, j]:.3g}"
        elif reason is Reason.NOT_FINITE:
            why += f" after sample {f.broken[i]}"
        elif reason is Reason.ENDS_FAILING:
            why += f": {Status(int(f.ended[i])).name}"
        drawn = zip((*f.labels.states, *f.labels.drawn), (*f.start[i], *f.drawn[i]), self._varies, strict=True)
        words = [f"{name} = {value:.4g}" for name, value, varies in drawn if varies]
        return "; ".join([f"flight {number}: {why}", f"cost {f.cost[i]:.6g}", *([", ".join(words)] if words else [])])

    @cached_property
    def _varies(self) -> list[bool]:
        """Return which initial states and other random variables differ between flights."""
        every = np.hstack([self.flown.start, self.flown.drawn])
        return [bool(np.ptp(column) > 0) for column in every.T]

    def replay(self, number: int, before: Before | None = None) -> Log:
        """Fly a flight again sample by sample, as simulate() does; the states in the log have the same bits.

        The log of a flight whose state was not finite ends before that sample.

        Args:
            number: of the flight.
            before: before(k, ctrl), called before sample k, to look at plans.

        Raises:
            ControllerError: there is no such flight.
        """
        i = self._place(number)
        broken = int(self.flown.broken[i])
        steps = None if broken < 0 else broken
        log = self.job.fly_again(self.job.controller.copy(), number, Conduct(before=before), steps)
        if broken < 0 and not np.array_equal(log.x[-1], self.flown.last[i]):
            warn(
                f"flight {number} does not end where it ended in the campaign: it was flown by other machine code; "
                "build() for a processor has its instructions, the profile 'verify' has the same bits everywhere"
            )
        return log

    def _with_samples(self, number: int) -> Flights:
        """Return the flight with its samples, as Flights of one."""
        self._place(number)
        return self._flyer.simulate(self.job.statement.whole_data(number), number, record=True)

    @cached_property
    def _flyer(self) -> Flyer:
        return Flyer(self.job, None)

    def _place(self, number: int) -> int:
        if not given.is_integer(number):
            raise ControllerError(f"flight {number!r}; expected the number of a flight")
        i = int(np.searchsorted(self.flown.number, number))
        if i == len(self) or self.flown.number[i] != number:
            raise ControllerError(f"flight {number!r}; expected the number of a flight that was flown")
        return i

    # -- tables -------------------------------------------------------------------------------------------------------

    @property
    def _table(self) -> list[Column]:
        """Return the results and the verdicts of all flights as columns."""
        reasons = np.array([Reason(r).name for r in self.reasons], dtype=object)
        return [*self.flown.table, Column("reason", values=reasons)]

    def to_dataframe(self) -> Any:
        """Return the DataFrame of Flown.to_dataframe() with the column ("reason", ""), why a flight is lost.

        Raises:
            ExtraError: pandas is not installed.
        """
        return frames.to_dataframe(self._table[1:], self.flown.number, "flight", "Campaign.to_dataframe()")

    def to_parquet(self, file: str | os.PathLike[str]) -> None:
        """Write the table of to_dataframe() as a Parquet file.

        Args:
            file: path of the file.

        Raises:
            ExtraError: pyarrow is not installed.
        """
        frames.to_parquet(self._table, file, "Campaign.to_parquet()")

    # -- pictures -----------------------------------------------------------------------------------------------------

    def plot(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot the paths of at most 300 flights, lost ones in red on top, including the worst ones.

        Args:
            file: where it is written; None: nowhere.

        Raises:
            ControllerError: nothing was flown.
            ExtraError: matplotlib is not installed.
        """
        from nmpc_codegen.pictures import paths

        self._check_some()
        lost = self.worst(min(DRAWN_LOST, int(self.lost.sum())))
        others = [int(n) for n in self.flown.number[~self.lost][: DRAWN - len(lost)]]
        again = [self._with_samples(n) for n in (*others, *lost)]
        title = f"{self._outcome}; drawn are {len(lost)} of them and {len(others)} others"
        return paths.draw(again, np.arange(len(again)) >= len(others), title, file, "lost")

    def plot_distributions(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot the distributions of costs, violations of rows, and times of samples.

        Args:
            file: where it is written; None: nowhere.

        Raises:
            ControllerError: nothing was flown.
            ExtraError: matplotlib is not installed.
        """
        from nmpc_codegen.pictures import of_campaigns

        self._check_some()
        return of_campaigns.draw_distributions(self.flown, self.rules.allowed, self.lost, self._title, self._unit, file)

    def plot_lost(self, file: str | os.PathLike[str] | None = None) -> Any:
        """Plot lost flights over the pairs of random variables in which lost and other flights differ most.

        Args:
            file: where it is written; None: nowhere.

        Raises:
            ControllerError: nothing was flown.
            ExtraError: matplotlib is not installed.
        """
        from nmpc_codegen.pictures import of_campaigns

        self._check_some()
        return of_campaigns.draw_pairs(self.flown, self.lost, self._title, self._unit, file)

    def _check_some(self) -> None:
        if not len(self):
            raise ControllerError("nothing was flown, so there is nothing to draw")

    @property
    def _title(self) -> str:
        return f"{self.job.controller.description.name}: {self._outcome}"

    @property
    def _outcome(self) -> str:
        low, high = self.interval
        share = f"({100 * low:.3g} to {100 * high:.3g} %)"
        return f"{int(self.lost.sum()):,} of {len(self):,} flights lost {share}"

    @property
    def _unit(self) -> Mapping[str, str]:
        """Return {name of a state, control or random variable: unit}; "" stands for time."""
        described = self.job.controller.description
        found = units(described.states, described.controls, described.parameters)
        drawn = {v.label: found.get(v.name, "") for v in self.job.statement.variables}
        return {**found, **drawn, "": described.time_unit}

    # -- words --------------------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<Campaign {self._title}>"

    def __str__(self) -> str:
        return self.summary()

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a JSON object."""
        s, low_high = self.job.statement, self.interval
        total = self.flown.samples.sum(axis=0)
        return {
            "flights": len(self),
            "asked_for": s.flights,
            "samples": s.steps,
            "dt": s.dt,
            "seed": s.seed,
            "lost": int(self.lost.sum()),
            "interval": [round(v, 9) for v in low_high],
            "confidence": LEVEL,
            "reasons": {r.name: self.lost_by_reason.get(r, 0) for r in Reason if r},
            "statuses": {status.name: int(total[status]) for status in Status if total[status]},
            "arrival": self.rules.asked if self.rules.judges_arrival else None,
            "allowed": {
                name: float(allowed) if np.isfinite(allowed) else None
                for name, allowed in zip(self.flown.labels.rows, self.rules.allowed, strict=True)
            },
            "drawn": [v.label for v in s.variables],
            "violation": {
                name: float(np.max(amounts)) if len(self) and np.isfinite(amounts).all() else None
                for name, amounts in zip(self.flown.labels.rows, self.flown.violation.T, strict=True)
            },
        }

    def summary(self) -> str:
        """Return some lines: flights, losses by reason with the interval, statuses, costs, rows, times, worst ones."""
        f, s, described = self.flown, self.job.statement, self.job.controller.description
        lines = [f"{described.name}: {len(self):,} flights of {s.steps} samples, {s.dt:g} {described.time_unit} each"]
        if not self.complete:
            lines.append(f"interrupted: {s.flights:,} flights were asked for")
        if not len(self):
            return "\n".join(lines)
        low, high = self.interval
        lines.append(
            f"lost: {int(self.lost.sum()):,}, {100 * self.share:.3g} %; of all such flights {100 * low:.3g} to "
            f"{100 * high:.3g} % (95 % confidence)"
        )
        lines += [f"  {count:,}: {reason.words}" for reason, count in self.lost_by_reason.items()]
        if not self.rules.judges_arrival:
            lines.append("where flights arrive is not judged: success= says where they have to")
        drawn = [v.label for v in s.variables]
        drawn += [what for what in ("disturbance", "noise") if getattr(s, what) is not None]
        lines.append(f"drawn: {', '.join(drawn) or 'nothing'}; seed {s.seed}")
        total = f.samples.sum(axis=0, dtype=np.int64)
        share = 100.0 / max(1, int(total.sum()))
        lines.append("samples: " + ", ".join(f"{st.name} {share * total[st]:.3g} %" for st in Status if total[st]))
        known = f.cost[np.isfinite(f.cost) & ~self.lost]
        if known.size:
            lines.append(f"cost of flights that are not lost: median {np.median(known):.6g}, largest {known.max():.6g}")
        lines += self._lines_of_references()
        lines += self._lines_of_rows()
        if np.isfinite(f.seconds).all():
            mean, longest = np.mean(f.seconds[:, 0]), np.max(f.seconds[:, 1])
            lines.append(f"time of a sample: mean {1e6 * mean:.3g} us, longest {1e6 * longest:.3g} us")
        if self.lost.any():
            lines += ["worst:", *(f"  {self.verdict(n)}" for n in self.worst(min(5, int(self.lost.sum()))))]
        return "\n".join(lines)

    def _lines_of_references(self) -> list[str]:
        known = self.losses[np.isfinite(self.losses)]
        if not known.size:
            return []
        text = f"cost of {known.size} flights beside loops with {self.against} in every sample"
        return [f"{text}: {100 * np.median(known):+.3g} % (median), {100 * known.max():+.3g} % at most"]

    def _lines_of_rows(self) -> list[str]:
        """Return lines on the rows that were violated by more than rounding."""
        lines = []
        rules = zip(self.flown.labels.rows, self.rules.allowed, self.rules.rounding, strict=True)
        for (name, allowed, rounding), amounts in zip(rules, self.flown.violation.T, strict=True):
            unknown, known = int(np.sum(np.isnan(amounts))), amounts[np.isfinite(amounts)]
            worst = float(known.max(initial=0.0))
            if worst > rounding or unknown:
                limit = f", by more than {allowed:.3g} in {int(np.sum(amounts > allowed)):,} flights"
                missing = f"; not known in {unknown:,}" if unknown else ""
                text = limit if np.isfinite(allowed) else " (not judged)"
                lines.append(f"row {name!r}: largest violation {worst:.3g}{text}{missing}")
        return lines
