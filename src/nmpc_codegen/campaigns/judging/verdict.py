"""The verdict on a flight says whether it is lost, and why; an interval says how certain the share lost is."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import beta, t

from nmpc_codegen.campaigns.flying.fly import Job
from nmpc_codegen.campaigns.stated.distributions import Box
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.signals import members
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.loops.flown import Flown
from nmpc_codegen.runtime.loops.judge import judge_of

Array = NDArray[Any]
Success = Callable[[Flown], ArrayLike]
Asked = Literal["set point"] | Mapping[str, Any] | Success

#: Allowed violation of a hard row, and allowed distance from a set point, relative to the scale of the row or state.
ALLOWED, NEAR = 1e-2, 0.1
#: Confidence level of an interval.
LEVEL = 0.95


class Reason(IntEnum):
    """The reason why a flight is lost; the first one that applies counts."""

    NONE = 0
    NOT_FINITE = 1
    ROW = 2
    NOT_ARRIVED = 3
    ENDS_FAILING = 4

    @property
    def words(self) -> str:
        """Return the reason as text for a table."""
        return {
            Reason.NONE: "not lost",
            Reason.NOT_FINITE: "the state was not finite",
            Reason.ROW: "a row was violated",
            Reason.NOT_ARRIVED: "did not arrive",
            Reason.ENDS_FAILING: "the last sample failed",
        }[self]


@dataclass(frozen=True, eq=False)
class Goal:
    """The goal of a state is a set point, which its last value must approach to within ``near``, or two limits."""

    state: int
    residual: int  # its reference is the set point; -1: limits
    near: float
    lower: float = -math.inf
    upper: float = math.inf


@dataclass(frozen=True, eq=False)
class Rules:
    """Rules decide whether a flight is lost.

    allowed: (rows,), largest allowed violation of each row, inf if it is not judged; rounding: (rows,), violations up
    to this value are rounding; targets, success: where a flight must end; asked: the same in the user's words.
    """

    allowed: Array
    rounding: Array
    targets: tuple[Goal, ...]
    success: Success | None
    asked: str = ""

    @property
    def judges_arrival(self) -> bool:
        """Return True if flights must end at a given place."""
        return bool(self.targets) or self.success is not None

    def judge(self, flown: Flown, goals: Array) -> NDArray[np.int8]:
        """Return the reasons (F,); ``goals`` (F, targets) are the set points."""
        failures = np.array([status.is_failure for status in Status])
        found = np.zeros(len(flown), np.int8)
        found[failures[np.maximum(flown.ended, 0)] & (flown.ended >= 0)] = Reason.ENDS_FAILING
        found[~self._has_arrived(flown, goals)] = Reason.NOT_ARRIVED
        found[np.any(~(flown.violation <= self.allowed) & np.isfinite(self.allowed), axis=1)] = Reason.ROW
        found[flown.broken >= 0] = Reason.NOT_FINITE
        return found

    def _has_arrived(self, flown: Flown, goals: Array) -> NDArray[np.bool_]:
        arrived = np.ones(len(flown), np.bool_)
        for target, goal in zip(self.targets, goals.T, strict=True):
            last = flown.last[:, target.state]
            if target.residual >= 0:
                arrived &= np.abs(last - goal) <= target.near
            else:
                arrived &= (target.lower <= last) & (last <= target.upper)
        if self.success is not None:
            said = np.asarray(self.success(flown))
            if said.shape != (len(flown),) or said.dtype.kind not in "b":
                raise ControllerError(
                    f"success returns {said.dtype} of shape {said.shape}; expected True or False for each of "
                    f"{len(flown)} flights, as in success=lambda flown: flown.cost < 10"
                )
            arrived &= said
        return arrived

    def distance(self, last: Array, goals: Array, states: Sequence[str]) -> str:
        """Return which state of a flight (nx,) is farthest from its goal, relative to the allowed distance."""
        found = []
        for target, goal in zip(self.targets, goals, strict=True):
            x = last[target.state]
            if target.residual >= 0:
                found.append(
                    (abs(x - goal) / max(target.near, 1e-300), f"{abs(x - goal):.3g} from {goal:.4g}", target.state)
                )
            elif not target.lower <= x <= target.upper:
                found.append((math.inf, f"{x:.4g}, not within {target.lower:.4g} .. {target.upper:.4g}", target.state))
        return "" if not found else f"{states[max(found)[2]]} is {max(found)[1]}"

    def goals(self, job: Job, first: int, count: int) -> Array:
        """Return the set points (F, targets) at the last samples of the flights from ``first`` on."""
        out = np.zeros((count, len(self.targets)))
        followed = [(j, target.residual) for j, target in enumerate(self.targets) if target.residual >= 0]
        references = job.last_references(first, count) if followed else out
        for j, residual in followed:
            out[:, j] = references[:, residual]
        return out


def rules_of(
    described: PackageDescription, dt: float, success: Asked | None, tolerance: Mapping[str, float] | None
) -> Rules:
    """Return the rules by which flights of a package are judged.

    Raises:
        ControllerError: there is no such row or state, or a number is wrong.
    """
    judge = judge_of(described, dt)
    allowed = np.array([ALLOWED * _size_of(described, i) if described.rows[i].hard else np.inf for i in judge.rows])
    if tolerance is not None and not isinstance(tolerance, Mapping):
        raise ControllerError(f"tolerance is {tolerance!r:.60}; expected {{row: violation that is allowed}}")
    for name, value in (tolerance or {}).items():
        places = [
            j for j, i in enumerate(judge.rows) if name in (described.rows[i].name, described.rows[i].user_name)
        ] or members(name, judge.names)
        if not places:
            raise ControllerError(f"tolerance: no row {name!r} along the path; there is {', '.join(judge.names)}")
        most = float(given.checked_array(value, f"tolerance: {name!r}", np.dtype(np.float64), (), finite=False))
        if not most >= 0:
            raise ControllerError(
                f"tolerance: {name!r}: {value!r}; expected a violation >= 0, inf: the row is not judged"
            )
        allowed[places] = most
    if success is None or callable(success):
        said = "" if success is None else "by a function of the user"
        return Rules(allowed, judge.rounding, (), success, said)
    return Rules(allowed, judge.rounding, tuple(_targets(described, success)), None, _spell(success))


def _spell(success: Any) -> str:
    """Return the goal in words."""
    if not isinstance(success, Mapping):
        return str(success)
    goals = ((f"`{name}`", goal) for name, goal in success.items())
    return ", ".join(
        f"{n} in {g.lower!r} .. {g.upper!r}" if isinstance(g, Box) else f"{n} within {g!r}" for n, g in goals
    )


def _size_of(described: PackageDescription, i: int) -> float:
    """Return the size of a row: its scale, or its largest finite nonzero bound if that is smaller."""
    bounds = [abs(side) for side in (described.rows[i].lower, described.rows[i].upper) if 0 < abs(side) < math.inf]
    return min(described.row_scales[i], max(bounds, default=math.inf))


def _targets(described: PackageDescription, success: Any) -> list[Goal]:
    """Return the goals of the states at the end."""
    states, scales = described.names.states, described.scales
    followed = {r.signal: i for i, r in reversed(list(enumerate(described.residuals))) if r.signal in states}
    if success == "set point":
        if not followed:
            raise ControllerError("success: no residual of the path is a state; name states: success={'p': Box(-1, 1)}")
        return [Goal(states.index(s), i, NEAR * scales[states.index(s)]) for s, i in followed.items()]
    if not isinstance(success, Mapping):
        raise ControllerError(
            f"success is {success!r:.60}; expected 'set point', {{state: distance from its set point, or Box}}, or a "
            "function of what was flown that says who has arrived"
        )
    found = []
    for name, value in success.items():
        places = members(name, states)
        if not places:
            raise ControllerError(f"success: there is no state {name!r}; there is {', '.join(states)}")
        for j, place in enumerate(places):
            found.append(_target(place, states, followed, _element(value, j, len(places)), name))
    return found


def _element(value: Any, j: int, size: int) -> Any:
    """Return element j of a vector; a number holds for all elements."""
    if isinstance(value, Box):
        return Box(_element(value.lower, j, size), _element(value.upper, j, size))
    return np.asarray(value)[j] if size > 1 and np.shape(value) == (size,) else value


def _target(place: int, states: Sequence[str], followed: Mapping[str, int], value: Any, name: str) -> Goal:
    """Return the goal of one state."""
    real = np.dtype(np.float64)
    if isinstance(value, Box):
        low, high = (
            float(given.checked_array(side, f"success: {name!r}", real, (), finite=False))
            for side in (value.lower, value.upper)
        )
        return Goal(place, -1, 0.0, low, high)
    near = float(given.checked_array(value, f"success: {name!r}", real, ()))
    if near < 0 or states[place] not in followed:
        raise ControllerError(
            f"success: {states[place]!r}: {value!r}; expected a distance >= 0 from the reference of a residual that is "
            "this state, or Box(lower, upper)"
        )
    return Goal(place, followed[states[place]], near)


def interval_of_share(
    lost: NDArray[np.bool_], set_of: Array | None = None, level: float = LEVEL
) -> tuple[float, float]:
    """Return the confidence interval of the share lost of all possible flights.

    For independent flights the interval is that of Clopper and Pearson, Biometrika 26 (1934). ``set_of`` (F,) holds the
    numbers of independent sets of quasi-random points; then the interval is Student's, from the shares of the sets.
    """
    if not 0 < level < 1:
        raise ControllerError(f"level is {level!r}; expected a confidence between 0 and 1")
    n, k = len(lost), int(np.sum(lost))
    if not n:
        return 0.0, 1.0
    tail = (1.0 - level) / 2.0
    if set_of is not None:
        shares = np.array([np.mean(lost[set_of == s]) for s in np.unique(set_of)])
        if len(shares) > 1 and np.ptp(shares) > 0:
            half = float(t.ppf(1.0 - tail, len(shares) - 1) * np.std(shares, ddof=1) / math.sqrt(len(shares)))
            return max(0.0, float(shares.mean()) - half), min(1.0, float(shares.mean()) + half)
    low = 0.0 if k == 0 else float(beta.ppf(tail, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(1.0 - tail, k + 1, n - k))
    return low, high
