"""campaign(): reads its arguments, and flies one controller or chooses among several."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, Literal, Unpack

from nmpc_codegen.campaigns.coach.choice import Choice, choose
from nmpc_codegen.campaigns.flying.fly import Device
from nmpc_codegen.campaigns.judging.against import Against
from nmpc_codegen.campaigns.judging.result import Campaign
from nmpc_codegen.campaigns.judging.verdict import Asked
from nmpc_codegen.campaigns.request import Terms, fly_campaign
from nmpc_codegen.campaigns.stated.flight_statement import SILENT, Stated, Wish
from nmpc_codegen.compiler import build
from nmpc_codegen.errors import ControllerError, OptionError
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.options import Options


def split_words(words: Mapping[str, Any]) -> tuple[Wish, Terms]:
    """What is flown and how, from arguments of campaign().

    Raises:
        ControllerError: there is no such argument.
    """
    of_wish, of_conduct = set(Wish.__annotations__), {field.name for field in fields(Terms)}
    unknown = sorted(set(words) - of_wish - of_conduct)
    if unknown:
        known = ", ".join(sorted(of_wish | of_conduct))
        raise ControllerError(f"campaign: no argument {unknown[0]!r}; those that exist: {known}")
    wish: Any = {**SILENT, **{name: value for name, value in words.items() if name in of_wish}}
    return wish, Terms(**{name: value for name, value in words.items() if name in of_conduct})


def campaign(
    ocp: OCP,
    flights: int | None = None,
    options: Options | Literal["candidates"] | Sequence[Options] | None = None,
    *,
    success: Asked | None = None,
    tolerance: Mapping[str, float] | None = None,
    against: Against | None = None,
    compared: int | None = None,
    executor: Any = None,
    folder: str | os.PathLike[str] | None = None,
    device: Device = "cpu",
    progress: bool | None = None,
    **stated: Unpack[Stated],
) -> Any:
    """Fly a controller in many closed loops, from many starts, against plants that differ from its model.

    Flight i is a function of (seed, i) and of the problem alone, whoever flies it, and in whatever parts.

    Args:
        ocp: the problem.
        flights: how many, by default 1000, or those of an array of starts.
        options: of the controller; a list of several, or "candidates", which the compiler proposes: they fly on the
            same seeds, and the best ones are chosen.
        success: where flights have to arrive: "set point", states that are residuals within a tenth of their size of
            their references; {state: largest distance from its reference, or Box}; or a function of what was flown
            (Flown) that returns True or False for each flight. None: anywhere.
        tolerance: {row along the path: violation that is allowed, in its unit}. By default a hundredth of the size of
            hard rows; soft ones that are not named are not judged.
        against: "solve" or "ipopt": compare costs with loops that have a converged plan in every sample.
        compared: how many flights, the first ones, are flown so, by default 20.
        executor: what has submit(), as the executors of concurrent.futures and Dask's Client; parts whose worker is
            lost are flown again. None: all cores of this process.
        folder: where flights are kept as they come, in Parquet files (extra [campaign]); a campaign that was stopped
            goes on there, and one with more flights begins with those.
        device: "cuda": on the GPU of each worker.
        progress: None: on a terminal, in a notebook, now and then in the log of a long campaign; False: none.
        stated: what is flown: starts=, parameters=, known=, references=, disturbance=, noise=, added=, steps=, dt=,
            plant=, sets=, seed=; see help(Stated).

    Returns:
        Campaign, or with several options Choice. An interrupt ends a campaign, which has the flights so far.

    Raises:
        ControllerError: a shape, a name or a number is wrong. Further errors are those of build().
        ExtraError: a package is missing.

    Examples:
        >>> from nmpc_codegen.campaigns import Box, Uniform, campaign
        >>> result = campaign(ocp, 100, starts=Box(0.1, 0.9), noise=Uniform(0.005), success={"h": 0.05}, progress=False)
        >>> len(result), result.complete
        (100, True)
    """
    judged = {"success": success, "tolerance": tolerance, "against": against, "compared": compared}
    flown = {"executor": executor, "folder": folder, "device": device, "progress": progress}
    return _fly(ocp, options, *split_words({**stated, **judged, **flown, "flights": flights}))


def _fly(ocp: OCP, options: Any, wish: Wish, conduct: Terms) -> Campaign | Choice:
    """With one set of options, or the best of several."""
    if not isinstance(ocp, OCP):
        raise ControllerError(f"campaign: {ocp!r:.60} is no OCP; expected the problem, as build() takes it")
    if options is None or isinstance(options, Options):
        chosen = options or Options()
        return fly_campaign(build(ocp, chosen), ocp, chosen, wish, conduct)
    if isinstance(options, str) and options == "candidates":
        return choose(ocp, None, Options(), wish, conduct)
    several = list(options) if isinstance(options, list | tuple) else []
    if not several or not all(isinstance(o, Options) for o in several):
        raise OptionError(f"options is {options!r:.80}; expected Options, a list of them, or 'candidates'")
    return choose(ocp, several, several[0], wish, conduct)
