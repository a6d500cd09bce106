"""--campaign runs closed loops with the package before it is written, and reports on them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING

from nmpc_codegen.cli.printing import Printer
from nmpc_codegen.cli.problem_file import FoundProblem
from nmpc_codegen.firmware.delivery import CampaignWords
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.runtime.build import load
from nmpc_codegen.targets import TARGETS

if TYPE_CHECKING:
    from nmpc_codegen.campaigns.judging.result import Campaign


class CampaignRun:
    """A run of the command with --campaign has the flag and the campaign."""

    def __init__(self, arguments: argparse.Namespace, stated: FoundProblem, name: str, printer: Printer) -> None:
        self._printer = printer
        self._count, self._stated, self._name = arguments.campaign, stated, name
        self._allowed = arguments.allow_failures or 0
        self._plot = None if arguments.simulate is not None else arguments.plot
        self._result: Campaign | None = None

    def fly(self, sources: Mapping[str, str]) -> CampaignWords | None:
        """Run the campaign with the package; return None without the flag.

        Raises:
            ControllerError: an argument that the file defines is wrong.
        """
        if self._count is None:
            return None
        from nmpc_codegen.campaigns.entry import split_words
        from nmpc_codegen.campaigns.request import fly_campaign

        wish, conduct = split_words({**self._stated.campaign, "flights": self._count})
        target = TARGETS[PackageDescription.from_json(sources[f"{self._name}.json"]).target]
        controller = load(sources, self._name, "fast" if target.board is None else "verify")
        self._printer.stage(f"flying {self._count:,} closed loops")
        self._result = fly_campaign(controller, self._stated.ocp, self._stated.options, wish, conduct)
        if not self._result.complete:  # nothing is written after an incomplete campaign
            raise KeyboardInterrupt
        return CampaignWords(self._result.as_dict(), _sentences(self._result))

    def report(self, printer: Printer) -> bool:
        """Print the result; return False if more flights are lost than allowed."""
        result = self._result
        if result is None:
            return True
        printer.line(str(result))
        printer.note("campaign", result.as_dict())
        if self._plot is not None:
            result.plot(self._plot)
            printer.line(f"picture: {self._plot}")
        lost = int(result.lost.sum())
        if lost > self._allowed:
            limit = f", --allow-failures {self._allowed}" if self._allowed else ""
            printer.error(f"campaign FAILED: {lost:,} of {len(result):,} flights are lost{limit}")
        return lost <= self._allowed


def _sentences(result: Campaign) -> str:
    """Return sentences on the campaign for a page, in Markdown."""
    s, words, rules = result.job.statement, result.as_dict(), result.rules
    drawn = [", ".join(f"`{name}`" for name in words["drawn"]) or "nothing"]
    drawn += [f"{what} {getattr(s, what)}" for what in ("disturbance", "noise") if getattr(s, what) is not None]
    varied = ", ".join(drawn)
    reasons = [f"{reason.words}: {count:,}" for reason, count in result.lost_by_reason.items()]
    why = f" ({'; '.join(reasons)})" if reasons else ""
    limits = [f"`{name}` {allowed:.3g}" for name, allowed in words["allowed"].items() if allowed is not None]
    loops = f"{len(result):,} closed loops of {s.steps} samples, {s.dt:g} {result.job.controller.description.time_unit}"
    low, high = result.interval
    return "\n".join(
        (
            f"{loops} each, seed {s.seed}, on",
            f"the computer that wrote this: {words['lost']:,} lost{why}. With a confidence of 95 %,",
            f"{100 * low:.3g} to {100 * high:.3g} % of all such loops are lost. Drawn for each: {varied}.",
            f"Violations of rows that are allowed: {', '.join(limits) or 'none'}.",
            f"They had to arrive: {rules.asked}." if rules.judges_arrival else "Arrival is not judged.",
        )
    )
