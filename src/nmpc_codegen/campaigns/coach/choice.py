"""Options are chosen by campaigns in rounds.

All candidates fly from the same starts, with the same parameters and disturbances. The better half continues with twice
as many flights. The verdict is based on fresh flights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from nmpc_codegen.campaigns.coach.candidates import Candidate, build_candidates, build_plant, propose
from nmpc_codegen.campaigns.flying.archive import HEAD
from nmpc_codegen.campaigns.judging.result import Campaign
from nmpc_codegen.campaigns.request import Terms, fly_campaign
from nmpc_codegen.campaigns.stated.defaults import facts_of
from nmpc_codegen.campaigns.stated.flight_statement import Wish, state_flights
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.frontend.horizon import with_horizon
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.options import Options

#: The first round has a SHAREth of the flights of the verdict, but at least LEAST.
SHARE, LEAST = 8, 20
#: A candidate is better if it loses fewer flights with the confidence CONFIDENCE; else if its median cost is lower by
#: the fraction CHEAPER; else, if nothing is worse, if its samples take less than the fraction FASTER of the time.
CONFIDENCE, CHEAPER, FASTER = 0.95, 0.01, 0.8
#: Costs are compared on the flights that neither candidate loses if these are at least this share.
FEW = 0.1


@dataclass(frozen=True)
class Entry:
    """An entry is a row of the table of candidates.

    change: difference from the base; flights: last flights of the candidate; lost: number of lost flights, with the
    confidence interval; violation: largest violation relative to the allowed one; cost: cost relative to the default,
    median of pairs; seconds: mean time of a sample; ram_bytes: size of the solver struct.
    """

    change: str
    flights: int
    lost: int
    interval: tuple[float, float]
    violation: float
    cost: float
    seconds: float
    ram_bytes: int
    verdict: bool  # True if the row is based on fresh flights


@dataclass(frozen=True, eq=False)
class Choice:
    """Options that were chosen by flights; print(choice) prints the table.

    Attributes:
        options: the chosen options.
        intervals: the chosen N.
        line: the options as a line of Python to paste.
        reason: reason of the choice.
        entries: rows of the table, one for each candidate.
        chosen: row of the chosen candidate.
        result: campaign of the chosen candidate, on fresh flights.
        default: campaign of the first candidate, with which the others are compared, on the same flights.
    """

    options: Options
    intervals: int
    line: str
    reason: str
    entries: tuple[Entry, ...]
    chosen: Entry
    result: Campaign
    default: Campaign

    @property
    def first(self) -> Entry:
        """Return the first row of the table."""
        return self.entries[0]

    def __repr__(self) -> str:
        return f"<Choice {self.line}: {self.reason}>"

    def __str__(self) -> str:
        return self.summary()

    def summary(self) -> str:
        """Return the table and the choice as text."""
        head = ("candidate", "flights", "lost", "95 % interval", "violation", "cost", "us", "bytes")
        rows = [
            (
                *(e.change + ("" if e.verdict else " *"), f"{e.flights:,}", f"{e.lost:,}"),
                f"{100 * e.interval[0]:.2g} to {100 * e.interval[1]:.2g} %",
                *(f"{e.violation:.2g}", f"{100 * e.cost:+.2g} %", f"{1e6 * e.seconds:.3g}", f"{e.ram_bytes:,}"),
            )
            for e in self.entries
        ]
        widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
        lines = [
            "  ".join(
                cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
            )
            for row in (head, *rows)
        ]
        lines.append(
            "violation: largest, 1 is allowed; cost: beside the first candidate; *: of the last round it flew in"
        )
        return "\n".join([*lines, f"chosen: {self.line}", f"reason: {self.reason}"])


def choose(ocp: OCP, given: Sequence[Options] | None, base: Options, wish: Wish, conduct: Terms) -> Choice:
    """Choose among the given options, or, if None, among candidates that the coach proposes beside ``base``.

    The first of the given options is the one with which the others are compared.
    """
    stated = propose(ocp, base) if given is None else iter([(f"options[{i}]", o, ocp.N) for i, o in enumerate(given)])
    _check_folder(conduct)
    candidates = build_candidates(ocp, stated, given is not None)
    whole = state_flights(candidates[0].controller, facts_of(ocp), wish)
    wish = {**wish, "steps": whole.steps, "flights": whole.flights}
    if wish["plant"] is None:
        wish = {**wish, "plant": build_plant(ocp, candidates)}
    fly = _Course(ocp, wish, conduct)
    entries: dict[str, Entry] = {}
    alive, flights = candidates, max(LEAST, whole.flights // SHARE)
    if wish["sets"] or whole.given.starts or whole.given.tables or whole.given.added is not None:
        flights = whole.flights  # their number cannot be reduced: every candidate flies all of them
    while len(alive) > 2 and flights < whole.flights:
        found = {c.change: fly.round(c, flights) for c in alive}
        first = found[candidates[0].change]
        entries |= {c.change: _entry(c, found[c.change], first, False) for c in alive}
        ranked = sorted(alive, key=lambda c: _rank(found[c.change], first))
        alive = [candidates[0], *(c for c in ranked if c is not candidates[0])][: 1 + math.ceil((len(alive) - 1) / 2)]
        flights *= 2
    final = {c.change: fly.verdict(c) for c in alive}
    first = final[candidates[0].change]
    entries |= {c.change: _entry(c, final[c.change], first, True) for c in alive}
    best, reason = candidates[0], "no candidate is better"
    for c in sorted(alive[1:], key=lambda c: _rank(final[c.change], first)):
        why = _better(final[c.change], final[best.change], first)
        if why:
            best, reason = c, f"beside {best.change}: {why}"
    line = best.line if best.intervals == ocp.N else f"{_grid(ocp, best.intervals)}, {best.line}"
    table = tuple(entries[c.change] for c in candidates)
    return Choice(best.options, best.intervals, line, reason, table, entries[best.change], final[best.change], first)


def _grid(ocp: OCP, intervals: int) -> str:
    """Return the horizon as the user states it."""
    return f"OCP(..., N={intervals})" if ocp.dt is None else f"OCP(..., T={intervals * ocp.dt[0]:.12g}, N={intervals})"


def _check_folder(conduct: Terms) -> None:
    """Raise ControllerError if the folder belongs to a single campaign."""
    if conduct.folder is not None and (Path(conduct.folder) / HEAD).exists():
        raise ControllerError(f"folder: {conduct.folder} holds a campaign; expected a folder for several of them")


class _Course:
    """A course flies the candidates: rounds use the seed of the user, the verdict the next seed."""

    def __init__(self, ocp: OCP, wish: Wish, conduct: Terms) -> None:
        self._ocp, self._wish, self._conduct = ocp, wish, conduct

    def round(self, candidate: Candidate, flights: int) -> Campaign:
        """Fly the first flights, which are the same for all candidates."""
        return self._fly(candidate, {**self._wish, "flights": flights}, "round")

    def verdict(self, candidate: Candidate) -> Campaign:
        """Fly fresh flights."""
        return self._fly(candidate, {**self._wish, "seed": (self._wish["seed"] + 1) % 2**64}, "verdict")

    def _fly(self, candidate: Candidate, wish: Wish, what: str) -> Campaign:
        ocp = self._ocp if candidate.intervals == self._ocp.N else with_horizon(self._ocp, candidate.intervals)
        folder, against = self._conduct.folder, self._conduct.against if what == "verdict" else None
        if folder is not None:
            folder = Path(folder) / f"{what} {candidate.change}".replace("/", " ")
        conduct = replace(self._conduct, folder=folder, against=against)
        found = fly_campaign(candidate.controller, ocp, candidate.options, wish, conduct)
        if not found.complete:
            raise KeyboardInterrupt
        return found


def _common_flights(mine: Campaign, other: Campaign) -> NDArray[np.bool_]:
    """Select flights with known costs that neither candidate loses; if there are few, also those that both lose."""
    known = np.isfinite(mine.flown.cost) & np.isfinite(other.flown.cost)
    good = ~mine.lost & ~other.lost & known
    return np.asarray(good if good.sum() >= FEW * len(good) else known & (mine.lost == other.lost))


def _excess(mine: Campaign) -> float:
    """Return the mean over the flights of the largest violation beyond the allowed one, relative to it."""
    return float(np.mean(np.maximum(mine.excess - 1.0, 0.0)))


def _relative_cost(mine: Campaign, other: Campaign) -> float:
    """Return the median over the flights of the relative difference in cost."""
    both = _common_flights(mine, other)
    if not both.any():
        return 0.0
    a, b = mine.flown.cost[both], other.flown.cost[both]
    return float(np.median((a - b) / np.maximum(np.abs(b), 1e-12 + 1e-6 * np.median(np.abs(b)))))


def _rank(mine: Campaign, first: Campaign) -> tuple[float, ...]:
    """Return a sort key: losses, then cost in steps of CHEAPER, then time."""
    seconds = float(np.nan_to_num(np.mean(mine.flown.seconds[:, 0])))
    return float(mine.lost.sum()), round(_relative_cost(mine, first) / CHEAPER), seconds


def _better(mine: Campaign, best: Campaign, first: Campaign) -> str:
    """Return why ``mine`` is better than the best so far; "" if it is not, or if it loses more than the first one."""
    if mine.lost.sum() > first.lost.sum():
        return ""
    saved, broken = int(np.sum(best.lost & ~mine.lost)), int(np.sum(mine.lost & ~best.lost))
    if saved != broken and binom.cdf(min(saved, broken), saved + broken, 0.5) < 1.0 - CONFIDENCE:
        return (
            f"it loses {int(mine.lost.sum()):,} instead of {int(best.lost.sum()):,} flights" if saved > broken else ""
        )
    if _excess(mine) > (1.0 + CHEAPER) * max(_excess(best), _excess(first)):
        return ""
    cost = _relative_cost(mine, best)
    if cost < -CHEAPER:
        return f"it costs {-100 * cost:.2g} % less in the median, at equal losses"
    times = float(np.mean(mine.flown.seconds[:, 0])), float(np.mean(best.flown.seconds[:, 0]))
    if cost < 0.1 * CHEAPER and times[0] < FASTER * times[1]:
        return f"a sample takes {times[0] / times[1]:.2g} of the time, at equal cost and losses"
    return ""


def _entry(c: Candidate, mine: Campaign, first: Campaign, verdict: bool) -> Entry:
    return Entry(
        *(c.change, len(mine), int(mine.lost.sum()), mine.interval),
        float(np.max(mine.excess, initial=0.0)),
        _relative_cost(mine, first),
        float(np.mean(mine.flown.seconds[:, 0])),
        int(c.controller.description.report.ram_bytes),
        verdict,
    )
