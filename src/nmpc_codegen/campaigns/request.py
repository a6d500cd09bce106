"""The terms of a campaign state how flights are run, judged and stored; fly_campaign() runs the campaign."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmpc_codegen.campaigns.flying.archive import Archive
from nmpc_codegen.campaigns.flying.fly import Device, Job
from nmpc_codegen.campaigns.flying.identity import identity
from nmpc_codegen.campaigns.flying.work import fly_all
from nmpc_codegen.campaigns.judging.against import Against, check_against, reference_costs
from nmpc_codegen.campaigns.judging.result import Campaign
from nmpc_codegen.campaigns.judging.verdict import Asked, Reason, Rules, rules_of
from nmpc_codegen.campaigns.stated.defaults import facts_of
from nmpc_codegen.campaigns.stated.flight_statement import Wish, plant_of, state_flights
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.options import Options
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.given import is_integer
from nmpc_codegen.runtime.loops.flown import Flown
from nmpc_codegen.runtime.loops.progress import Progress

#: Default number of flights that are compared with reference loops.
COMPARED = 20


@dataclass(frozen=True, eq=False)
class Terms:
    """The arguments of campaign() that say how flights are judged, flown and stored."""

    success: Asked | None = None
    tolerance: Mapping[str, float] | None = None
    against: Against | None = None
    compared: int | None = None
    executor: Any = None
    folder: str | os.PathLike[str] | None = None
    device: Device = "cpu"
    progress: bool | None = None

    def check(self) -> None:
        """Raise ControllerError if an argument is wrong."""
        if self.device not in ("cpu", "cuda"):
            raise ControllerError(f"device is {self.device!r}; allowed: 'cpu', 'cuda'")
        if self.compared is not None and (not is_integer(self.compared) or self.compared < 1 or self.against is None):
            raise ControllerError(f"compared is {self.compared!r}; expected a number of flights >= 1, with against=")
        named = isinstance(self.folder, str | os.PathLike)
        if self.folder is not None and (not named or Path(self.folder).is_file()):
            raise ControllerError(f"folder is {self.folder!r:.80}; expected a folder, which need not exist yet")
        if self.against not in (None, "solve", "ipopt"):
            raise ControllerError(f"against is {self.against!r}; allowed: None, 'solve', 'ipopt'")


def fly_campaign(controller: Controller, ocp: OCP, options: Options, wish: Wish, conduct: Terms) -> Campaign:
    """Fly and judge a campaign with ``controller``, which was built from the problem and the options."""
    conduct.check()
    check_against(controller, conduct.against, options)
    statement = state_flights(controller, facts_of(ocp), wish)
    job = Job(controller, plant_of(wish), statement, conduct.device)
    rules = rules_of(controller.description, statement.dt, conduct.success, conduct.tolerance)
    flown, reasons, complete = _fly(job, rules, conduct)
    best = None
    if conduct.against is not None and complete:
        count = COMPARED if conduct.compared is None else conduct.compared
        best = reference_costs(job, flown, conduct.against, count, ocp, options)
    return Campaign(
        job,
        rules,
        flown,
        reasons,
        complete,
        best,
        {"solve": "solve()", "ipopt": "IPOPT"}.get(conduct.against or "", ""),
    )


def _fly(job: Job, rules: Rules, conduct: Terms) -> tuple[Flown, np.ndarray[Any, np.dtype[np.int8]], bool]:
    """Return the results and reasons of all flights, and False after an interrupt."""
    s, name = job.statement, job.controller.description.name
    flown, done = Flown.empty(job.labels, s.flights), np.zeros(s.flights, np.bool_)
    archive = nullcontext() if conduct.folder is None else Archive(conduct.folder, job.labels, identity(job))
    complete = True
    with archive as kept:
        if kept is not None:
            kept.read(flown, done)
        lost = 0
        with Progress(name, s.flights, "flights", int(done.sum()), conduct.progress) as progress:
            try:
                for part in fly_all(job, done.copy(), conduct.executor):
                    if kept is not None:
                        kept.add(part)
                    flown.put(part, part.number)
                    done[part.number] = True
                    lost += int(np.sum(_judge(job, rules, part) != Reason.NONE))
                    progress.add(len(part), f"{lost} lost")
            except KeyboardInterrupt:
                complete = False
    flown = flown if done.all() else flown.of_some(done)
    return flown, _judge(job, rules, flown), complete or bool(done.all())


def _judge(job: Job, rules: Rules, part: Flown) -> np.ndarray[Any, np.dtype[np.int8]]:
    """Return the reasons of a part; set points follow from the numbers of the flights."""
    if not len(part):
        return np.zeros(0, np.int8)
    begin, end = int(part.number[0]), int(part.number[-1]) + 1
    return rules.judge(part, rules.goals(job, begin, end - begin)[part.number - begin])
