"""Several algorithms share the shift of the plan before a sample, and its initial values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.package.features import Features
from nmpc_codegen.runtime.given import is_same_time

SHIFTS = (None, "repeat", "periodic", "resample")


def check_sampling_time(algorithm: str, shift: str | None, sampling_time: float | None) -> None:
    """Raise OptionError for shift="resample" without a sampling time."""
    if sampling_time is None and shift == "resample":
        raise OptionError(
            f'{algorithm}.sampling_time: None with shift="resample", which requires it '
            "(--set algorithm.sampling_time=...)"
        )


def decide_shift(shift: str | None, sampling_time: float | None, problem: Problem) -> tuple[str | None, list[str]]:
    """Return the shift for "auto" with the reason, and any other shift unchanged."""
    if shift != "auto":
        return shift, []
    found, why = _auto_shift(sampling_time, problem)
    return found, [f"shift: {found}; {why}"]


def resample_time(shift: str | None, sampling_time: float | None, problem: Problem) -> float | None:
    """Return the sampling time; if a plan is resampled without one, it is the first interval."""
    return problem.dt[0] if shift == "resample" and sampling_time is None else sampling_time


def _auto_shift(sampling_time: float | None, problem: Problem) -> tuple[str | None, str]:
    """Return the shift for "auto" in a problem, and the reason.

    The plan of a periodic problem must be shifted. Otherwise the period starts again at every sample, and with a limit
    on the mean over a period the loop drifts off the orbit, in a direction that rounding errors decide.
    """
    other_time = sampling_time is not None and not is_same_time(sampling_time, problem.dt[0])
    if problem.uniform and not problem.free_initial and not other_time and _is_periodic(problem):
        return "periodic", "rows compare x_N with x_0; a sample is one interval"
    if problem.augmentation.held:
        timed = not problem.discrete and (problem.uniform or sampling_time is not None)
        return "resample" if timed else None, "blocks of controls do not fit a shift by one interval"
    reasons = {
        "a non-uniform grid": not problem.uniform,
        "free components of x_0": bool(problem.free_initial),
        "accumulators": bool(problem.accumulators),
        "rows that couple x_0 and x_N": bool(problem.coupled_rows),
    }
    for reason, holds in reasons.items():
        if holds:
            other = "repeat" if problem.uniform else "resample"
            other = "periodic" if problem.coupled_rows and problem.uniform else other
            return None, f'the problem has {reason}; shift="{other}" moves the plan all the same'
    if other_time:
        return "resample", f"the sampling time {sampling_time:g} differs from the interval {problem.dt[0]:g}"
    return "repeat", "a sample is one interval"


def _is_periodic(problem: Problem) -> bool:
    """Return True if there are coupled rows that depend only on x_N - x_0, so that a common shift changes nothing."""
    if problem.coupled is None:
        return False
    random = np.random.default_rng(0)
    x_0, x_N, move = np.maximum(1.0, np.abs(problem.x_initial)) * random.standard_normal((3, problem.nx))
    r, moved = (np.asarray(problem.coupled(*ends)) for ends in ((x_0, x_N), (x_0 + move, x_N + move)))
    return bool(np.allclose(moved, r, rtol=1e-9, atol=1e-9 * float(np.max(np.abs([x_0, x_N, move])))))


def sampling_period(shift: str | None, sampling_time: float | None, problem: Problem) -> float | None:
    """Return the time between samples for which a package is made; None: any."""
    return sampling_time if sampling_time is not None or shift is None else problem.dt[0]


def check_shift(algorithm: str, shift: str | None, sampling_time: float | None, problem: Problem) -> None:
    """Raise OptionError for a shift that does not fit the problem.

    A shift by one interval needs a uniform grid and a sampling time of one interval; a discrete map cannot be
    resampled.
    """
    if shift in ("repeat", "periodic") and sampling_time is not None and not is_same_time(sampling_time, problem.dt[0]):
        raise OptionError(
            f'{algorithm}(shift="{shift}") moves the plan by one interval, {problem.dt[0]:g} {problem.time_unit}, '
            f'and clashes with sampling_time={sampling_time:g}; expected shift="resample" '
            "(--set algorithm.shift=resample)"
        )
    if shift in ("repeat", "periodic") and problem.augmentation.held:
        raise OptionError(
            f'{algorithm}(shift="{shift}") moves the plan by one interval and clashes with control(hold=...); '
            'expected shift="resample", sampling_time=... '
            "(--set algorithm.shift=resample --set algorithm.sampling_time=...), or None"
        )
    if shift in ("repeat", "periodic") and not problem.uniform:
        raise OptionError(
            f'{algorithm}(shift="{shift}") moves the plan by one interval and clashes with a '
            'non-uniform grid; expected shift="resample", sampling_time=... '
            "(--set algorithm.shift=resample --set algorithm.sampling_time=...)"
        )
    if shift == "resample" and problem.discrete:
        raise OptionError(
            f'{algorithm}(shift="resample") (--set algorithm.shift=resample) reads the plan between nodes '
            "and clashes with a discrete map"
        )


def with_shift(features: Features, shift: str | None) -> Features:
    """Return the features with the kind of shift(); without a mark, shift() moves the plan by one interval."""
    return replace(features, shift_resample=shift == "resample", shift_periodic=shift == "periodic")


def initial_tables(problem: Problem) -> tuple[Table, ...]:
    """Return the tables of components of x_0 that are accumulators, and that the measured state determines."""
    accumulators = tuple(int(i in problem.accumulators) for i in range(problem.nx))
    measured = tuple(int(i not in (*problem.accumulators, *problem.free_initial)) for i in range(problem.nx))
    return (
        Table("is_accumulator", "int", accumulators, "1: the state starts at 0 at every sample"),
        Table("is_measured", "int", measured, "1: x_0 is the measured state"),
    )


def resample_tables(shift: str | None, sampling_time: float | None, problem: Problem) -> tuple[Table, ...]:
    """Return node times and the sampling time for shift="resample"."""
    if shift != "resample":
        return ()
    return (
        Table("node_time", "real", _node_times(problem), "time t_k of node k"),
        Table("sampling_time", "real", (float(sampling_time or 0.0),), "time by which a sample shifts the plan"),
    )


def resample_reach(shift: str | None, sampling_time: float | None, problem: Problem) -> float:
    """Return for shift="resample" the longest time from a node of the old plan to a new node.

    Rounding may place a new node after the next old node.
    """
    if shift != "resample" or sampling_time is None:
        return 0.0
    times, rounding = _node_times(problem), 1e-6 * (sampling_time + math.fsum(problem.dt))
    moved = (time + sampling_time for time in times)
    return max(new - max((t for t in times[:-1] if t < new - rounding), default=0.0) for new in moved)


def _node_times(problem: Problem) -> tuple[float, ...]:
    return tuple(math.fsum(problem.dt[:k]) for k in range(problem.N + 1))
