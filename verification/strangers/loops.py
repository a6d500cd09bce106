"""The product flies the strangers in closed loop, and the twin judges the loops."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from nmpc_codegen import Controller, Options, Status
from nmpc_codegen.campaigns import Campaign, campaign
from verification.strangers.statement import Array, Limit, Stranger
from verification.strangers.twin import Loop, Outcome, Twin, by_ipopt

TOLERANCE = 0.1
VIOLATED, DEARER, RANGE, LITTLE = 1e-2, 0.2, 0.02, 0.25


@dataclass(frozen=True)
class Verdict:
    """A verdict has the outcome of a loop of the product, its statuses, and its faults.

    ``far``: samples that are OK although their plan is far from the model or their control breaks a row;
    ``iterations``: QPs of all samples; ``lost``: the reason why the loop is lost, or ""; ``relaxed``: most consecutive
    RELAXED samples.
    """

    outcome: Outcome
    statuses: Counter[str]
    far: int
    iterations: int
    lost: str
    samples: int
    relaxed: int = 0

    @property
    def bad(self) -> int:
        """Return the number of samples that are neither OK nor RELAXED."""
        return self.samples - self.statuses["OK"] - self.statuses["RELAXED"]


class Judge:
    """A judge computes the residual of a plan from the twin's model and rows.

    A gap is measured in the size of its state in the plan, at least in a fraction of its size at the start.
    """

    def __init__(self, twin: Twin) -> None:
        s = twin.stranger
        x, u = ca.SX.sym("x", len(s.states)), ca.SX.sym("u", len(s.controls))
        self._step, self._N = twin.step.map(s.N), s.N
        self._least = LITTLE * np.max(np.abs(s.start), axis=0)
        for row in s.limits:
            self._widen(row, x, u)
        curved = [row for row in s.limits if row.soft is None and _is_curved(row, x, u)]
        self._path = [row for row in curved if row.at == "path"]
        self._end = [row for row in curved if row.at == "end"]
        self._rows = ca.Function("rows", [x, u], [ca.vertcat(*(row.value(x, u) for row in self._path))]).map(s.N)
        self._end_rows = ca.Function("rows", [x], [ca.vertcat(*(row.value(x, u) for row in self._end))])
        hard = [row for row in s.limits if row.soft is None and row.at == "path"]
        self._on_controls = [row for row in hard if not ca.depends_on(ca.SX(row.value(x, u)), x)]
        on_controls = ca.vertcat(*(row.value(x, u) for row in self._on_controls))
        self._of_controls = ca.Function("rows", [u], [on_controls])

    def _widen(self, row: Limit, x: ca.SX, u: ca.SX) -> None:
        """Record half the width of the bounds of a state."""
        value, half = row.value(x, u), (row.upper - row.lower) / 2
        for i in range(x.numel()):
            if row.soft is None and np.isfinite(half) and ca.is_equal(value, x[i]):
                self._least[i] = max(self._least[i], half)

    def residual(self, X: Array, U: Array, xhat: Array, shifted: bool) -> float:
        """Return the largest gap or violation of a hard row in the plan (N+1, nx), (N, nu), without the shifted end."""
        size = np.maximum(np.maximum(np.max(np.abs(X), axis=0), np.abs(xhat)), self._least)
        size[size == 0] = 1.0
        gaps = np.abs(np.asarray(self._step(X[:-1].T, U.T)).T - X[1:]) / size
        worst = float(np.max(gaps[: self._N - 1] if shifted else gaps))
        if self._path:
            values = np.asarray(self._rows(X[:-1].T, U.T)).T[1:]
            worst = max(worst, _violation(self._path, values[:-1] if shifted else values))
        if self._end and not shifted:
            worst = max(worst, _violation(self._end, np.asarray(self._end_rows(X[-1])).T))
        return worst

    def broken(self, u: Array) -> float:
        """Return the largest violation of a hard row on controls only by the applied controls (nu,)."""
        if not self._on_controls:
            return 0.0
        return _violation(self._on_controls, np.asarray(self._of_controls(u)).T)


def _is_curved(row: Limit, x: ca.SX, u: ca.SX) -> bool:
    return bool(ca.which_depends(row.value(x, u), ca.vertcat(x, u), 2, True)[0])


def _violation(rows: list[Limit], values: Array) -> float:
    lower, upper = (np.array([getattr(row, side) for row in rows]) for side in ("lower", "upper"))
    scale = np.array([row.scale for row in rows])
    return float(np.max(np.maximum(lower - values, values - upper) / scale, initial=0.0))


def run(
    stranger: Stranger, numbers: Sequence[int], options: Options | None = None, nominal: bool = False
) -> list[Verdict]:
    """Judge the loops with these numbers from fresh plans, without their kicks if ``nominal``.

    The default options state only the integration steps.
    """
    twin = Twin(stranger)
    flown = campaign(
        stranger.ocp(), options=options or stranger.options(), progress=False, **stranger.flights(numbers, nominal)
    )
    return [_judge_loop(twin, Judge(twin), flown, i, number, nominal) for i, number in enumerate(numbers)]


def _judge_loop(twin: Twin, judge: Judge, flown: Campaign, i: int, number: int, nominal: bool) -> Verdict:
    """Return the verdict on flight i, which is replayed together with its plans."""
    s, watcher = twin.stranger, _Watcher()
    log = flown.replay(i, watcher.look)
    watcher.keep()
    far, on_end = 0, [0]
    for k, sample in enumerate(watcher.samples[: len(log.u)]):
        residuals = judge.residual(*sample.plan, log.x[k], False), judge.broken(log.u[k])
        far += sample.status == "OK" and max(residuals) > TOLERANCE
        on_end.append(on_end[-1] + 1 if sample.status == "RELAXED" else 0)
    loop = Loop(twin, number, nominal)
    loop.follow(log.x, log.u)
    outcome = replace(loop.outcome(0), finite=bool(flown.flown.broken[i] < 0))
    counts = flown.flown.samples[i]
    statuses = Counter({status.name: int(n) for status, n in zip(Status, counts, strict=True) if n})
    statuses.update({"lost": s.samples - int(counts.sum())} if counts.sum() < s.samples else {})
    lost = _why_lost(s, number, outcome, by_ipopt()[f"{s.name} nominal" if nominal else s.name])
    return Verdict(outcome, statuses, far, sum(one.iterations for one in watcher.samples), lost, s.samples, max(on_end))


@dataclass(frozen=True, eq=False)
class _Sample:
    """A sample has its plan (N+1, nx) and (N, nu), its status, and its number of QPs."""

    plan: tuple[Array, Array]
    status: str
    iterations: int


class _Watcher:
    """A watcher records the plans of a flight."""

    def __init__(self) -> None:
        self.samples: list[_Sample] = []
        self._controller: Controller | None = None

    def look(self, k: int, controller: Controller) -> None:
        """Record, before sample k, the plan of the previous sample."""
        self.keep()
        self._controller = controller

    def keep(self) -> None:
        """Record the plan after a sample."""
        c = self._controller
        if c is not None:
            self.samples.append(_Sample((c.x.copy(), c.u.copy()), c.status.name, c.stats.iterations))


def _why_lost(s: Stranger, number: int, mine: Outcome, theirs: list[Outcome]) -> str:
    """Return the reason why a loop is lost that IPOPT does not lose, or ""."""
    other = theirs[number]
    spread = max(o.cost for o in theirs) - min(o.cost for o in theirs)
    if not mine.finite:
        return "not finite"
    if mine.violation > VIOLATED >= other.violation:
        return f"a row is violated by {mine.violation:.2g}"
    if s.distance is not None and mine.distance > s.reach >= other.distance:
        return f"{mine.distance:.2g} from the goal"
    if mine.cost - other.cost > DEARER * abs(other.cost) + RANGE * spread:
        return f"cost {mine.cost:.4g} instead of {other.cost:.4g}"
    return ""
