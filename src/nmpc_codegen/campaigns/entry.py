"""campaign() reads its arguments, and flies one controller or chooses among several."""

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
    """Split the arguments of campaign() into the statement of the flights and the terms of the campaign.

    Raises:
        ControllerError: campaign() has no such argument.
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

    A flight is one closed loop. Flight i depends only on (seed, i) and on the problem, not on the worker or the parts
    into which the campaign is divided.

    Args:
        ocp: the problem.
        flights: number of flights, by default 1000, or the length of an array of starts.
        options: options of the controller; or a list of options, or "candidates", which the compiler proposes. Several
            ones fly on the same seeds, and the best is chosen.
        success: where flights must end. "set point": states that are residuals end within a tenth of their scale of
            their references; {state: largest distance from its reference, or Box}; or a function of the results (Flown)
            that returns True or False for each flight. None: anywhere.
        tolerance: {row along the path: allowed violation, in its unit}. By default a hundredth of the scale of hard
            rows; soft rows that are not named are not judged.
        against: "solve" or "ipopt": compare costs with loops that have a converged plan in every sample.
        compared: number of flights that are compared, from the first on, by default 20.
        executor: an object with submit(), as the executors of concurrent.futures and Dask's Client; parts whose worker
            is lost are flown again. None: all cores of this process.
        folder: folder to which results are written during the campaign, in Parquet files (extra [campaign]). A stopped
            campaign continues from there; one with more flights reuses the existing ones.
        device: "cuda": on the GPU of each worker.
        progress: None: show progress on a terminal or in a notebook, and by lines now and then in a long campaign;
            False: none.
        stated: statement of the flights: starts=, parameters=, known=, references=, disturbance=, noise=, added=,
            steps=, dt=, plant=, sets=, seed=; see help(Stated).

    Returns:
        Campaign, or Choice for several options. After an interrupt, the Campaign holds the flights so far.

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
    """Fly one set of options, or choose the best of several."""
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
