"""Closed loops under adverse conditions: jumps, NaN, infeasible QPs, bounds moved and crossed at run time.

    python -m benchmarks.lib.qp.torture [--steps N]

Required after every sample: the control is finite and inside its bounds; the status is correct; a sample without a
solution returns the control of the plan that prepare() left, shifted according to the options, and keeps its controls.
HiGHS decides on the condensed rows of the same QP whether it has a feasible point.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import linprog

from benchmarks.lib.qp.recorded import read_qp
from benchmarks.lib.scenarios import QUADROTOR, wrapped
from examples import crane, cstr, quadrotor
from nmpc_codegen import OCP, RK4, Controller, ExplicitRungeKutta, Options, RealTimeIteration, Status, build
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.frontend.classify import classify
from tests.oracles.stage_qp import Array, StageQP
from tests.oracles.stage_qp_random import condensed_rows

# Violation of the rows, in their units, above which a QP is infeasible and below which it is feasible; else undecided.
CONTRADICTION, ROUNDING = 1e-6, 1e-9
PATIENCE = 25  # failures in a row after which the plant is reset
GIVE_UP = 10  # successes after a restart within which a failure gives the plan up
EVENTS = {"spell": 0.02, "kick": 0.004, "nan": 0.01, "bounds": 0.02, "crossed": 0.01, "reference": 0.01, "reset": 0.002}


@dataclass(frozen=True, eq=False)
class Trial:
    """A controller and the disturbances applied to it.

    ``rest``: state at which the plant starts and is reset; ``noise`` (nx,): standard deviation at every sample;
    ``jump`` (nx,): amplitude of bad measurements and of kicks. ``moved``: rows whose bounds change,
    (name, lower, upper): drawn between the declared pair and this one. ``lag``: number of controls by which
    prepare() shifts.
    """

    name: str
    make: Callable[[], OCP]
    options: Options
    dt: float
    rest: Array
    noise: Array
    jump: Array
    moved: tuple[tuple[str, float, float], ...]
    lag: int | None
    share: float = 1.0


def trials() -> tuple[Trial, ...]:
    """Crane with x_N = 0, reactor with state bounds, quadrotor with limits on tilt and speed."""
    one_step = ExplicitRungeKutta(RK4, steps=1)
    hovering = wrapped(lambda: quadrotor.build_ocp((0.0, 0.0, 0.0)), QUADROTOR.row)
    reactor = {
        "make": cstr.build_ocp, "dt": cstr.SAMPLING, "rest": cstr.SET_POINTS[0][:4],
        "noise": np.array([2e-3, 2e-3, 0.02, 0.02]), "jump": np.array([0.3, 0.3, 12.0, 12.0]),
        "moved": (("u1", 8.0, 20.0), ("u2", -3000.0, -500.0), ("th", 110.0, np.inf), ("thK", 108.0, 125.0)),
    }  # fmt: skip
    crane_data = {
        "make": crane.build_ocp, "dt": 0.3, "rest": np.zeros(4), "noise": np.full(4, 2e-3),
        "jump": np.array([1.0, 0.5, 0.3, 0.3]), "moved": (("a", -0.3, 0.5),),
    }  # fmt: skip
    drone = {
        "make": hovering, "dt": 0.05, "rest": np.zeros(12), "noise": np.full(12, 2e-3),
        "jump": np.array([0.3, 0.3, 0.3, 0.6, 0.6, 0.6, 0.2, 0.2, 0.1, 0.5, 0.5, 0.2]),
        "moved": (("u[0]", 0.5, 2.0), ("speed", -np.inf, 0.3), ("tilt", 0.98, np.inf)),
    }  # fmt: skip
    repeat, plain = RealTimeIteration("repeat"), RealTimeIteration()
    resample = RealTimeIteration("resample", sampling_time=cstr.SAMPLING)
    return (
        Trial("crane", **crane_data, options=Options(algorithm=repeat), lag=1),
        Trial("crane unshifted", **crane_data, options=Options(), lag=0, share=0.5),
        Trial("cstr", **reactor, options=Options(algorithm=plain), lag=0),
        Trial("cstr resampled", **reactor, options=Options(algorithm=resample), lag=None, share=0.5),
        Trial("quadrotor", **drone, options=Options(one_step, algorithm=repeat), lag=1),
    )


@dataclass
class Outcome:
    """Counts of a trial; ``violations`` has one line per kind of violation, with its first occurrence."""

    samples: int = 0
    status: Counter[str] = field(default_factory=Counter)
    certified: Counter[str] = field(default_factory=Counter)
    violations: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)
    recovery: int = 0  # largest number of failures in a row at states that are feasible for a controller without a plan
    longest: int = 0  # failures in a row
    rescues: int = 0

    def violate(self, what: str, detail: str) -> None:
        """Count a violation."""
        self.violations[what] += 1
        self.first.setdefault(what, f"sample {self.samples}: {detail}")


def least_violation(qp: StageQP, A: Array, value: Array) -> float:
    """min t >= 0 such that all hard rows hold up to t and all control bounds hold, by HiGHS; inf if that is infeasible.

    A, value: the condensed rows of the QP.
    """
    hard = np.isinf(qp.rows.l1)
    above, below = hard & np.isfinite(qp.upper), hard & np.isfinite(qp.lower)
    rows = np.vstack([A[above], -A[below]])
    right = np.append((qp.upper - value)[above], (value - qp.lower)[below])
    if not len(rows):
        return 0.0
    bounds = np.column_stack([(qp.lower_u - qp.u).ravel(), (qp.upper_u - qp.u).ravel()])
    if np.any(bounds[:, 0] > bounds[:, 1]):
        return np.inf
    size = np.maximum(np.max(np.abs(rows), axis=1), 1.0)  # the LP in units in which its tolerance is meaningful
    cost = np.append(np.zeros(A.shape[1]), 1.0)
    answer = linprog(
        cost, np.column_stack([rows / size[:, None], -1 / size]), right / size, bounds=[*bounds, (0.0, None)],
        method="highs", options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )  # fmt: skip
    return float(answer.x[-1]) if answer.status == 0 else np.nan


def rounding(qp: StageQP, A: Array, value: Array) -> float:
    """Accuracy of the hard rows in double precision: eps times the largest sum of the terms of their values."""
    hard = np.isinf(qp.rows.l1)
    range_u = np.maximum(np.abs(qp.lower_u - qp.u), np.abs(qp.upper_u - qp.u)).ravel()
    terms = np.abs(A) @ np.where(np.isfinite(range_u), range_u, 1.0) + np.abs(value)
    return float(np.finfo(float).eps * np.max(terms[hard], initial=0.0))


def certificate(qp: StageQP) -> str:
    """ "feasible", "infeasible", "undecided", or "not finite": the plan cannot be linearised."""
    if not all(np.all(np.isfinite(a)) for a in (qp.S, qp.b, qp.Q, qp.g, qp.C, qp.c)):
        return "not finite"
    A, value = condensed_rows(qp)
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(value))):
        return "not finite"  # the plan overflows over the horizon
    if rounding(qp, A, value) > CONTRADICTION:
        return "undecided"  # undecidable in double precision
    t = least_violation(qp, A, value)
    if t > CONTRADICTION:
        return "infeasible"
    return "feasible" if t < ROUNDING else "undecided"


class Torture:
    """One trial."""

    def __init__(self, trial: Trial, seed: int = 0) -> None:
        self.trial = trial
        ocp = trial.make()
        self.problem = classify(ocp)
        self.c: Controller = build(ocp, trial.options, profile="fast")
        self.struct: Any = self.c._struct  # the oracle reads private members
        self.rng = np.random.default_rng(seed)
        self.out = Outcome()
        self.x = trial.rest.copy()
        self.spell, self.offset = 0, np.zeros_like(self.x)
        self.declared = {row.name: (row.lower, row.upper) for row in self.problem.rows}
        self.control_rows = [next((r.name for r in self.problem.rows if r.kind == "control" and r.index == j), None)
                             for j in range(self.problem.nu)]  # fmt: skip
        self.bounds = dict(self.declared)
        self.failures = 0
        self.since_restart = GIVE_UP + 1  # successes since a failure restarted the plan
        self.waited: int | None = None  # samples since the first feasible one after a failure
        self.planned = False  # the plan is that of a solution

    # -- what is done to the loop -----------------------------------------------------------------------------------

    def happens(self, event: str) -> bool:
        return bool(self.rng.random() < EVENTS[event])

    def disturb(self) -> Array:
        """The measured state of this sample."""
        t, rng = self.trial, self.rng
        self.x = self.x + t.noise * rng.normal(size=self.x.size)
        if self.happens("kick"):
            self.x = self.x + 0.5 * t.jump * rng.normal(size=self.x.size)
        if self.spell == 0 and self.happens("spell"):
            self.spell = int(rng.integers(1, 4))
            self.offset = t.jump * rng.normal(size=self.x.size) * rng.choice([0.5, 1.0, 2.0])
        measured = self.x + (self.offset if self.spell else 0.0)
        self.spell = max(0, self.spell - 1)
        if self.happens("nan"):
            measured = measured.copy()
            measured[rng.integers(measured.size)] = rng.choice([np.nan, np.inf, -np.inf])
        return measured

    def move_bounds(self) -> None:
        """Set the bounds of one row to a pair between the declared and the other one, or to the declared pair again."""
        name, low, high = self.trial.moved[self.rng.integers(len(self.trial.moved))]
        lower, upper = self.declared[name]
        share = self.rng.choice([0.0, self.rng.random()])
        pair = tuple(_between(a, b, share) for a, b in ((lower, low), (upper, high)))
        self.c.set_bounds(name, *pair)
        self.bounds[name] = pair

    def refuse(self) -> None:
        """Crossed and undefined bounds and NaN references must be refused without any change."""
        before = bytes(self.c._memory)
        row = int(self.rng.integers(len(self.problem.rows)))
        pair = [(1.0, 0.5), (np.nan, 1.0), (0.0, np.nan), (np.inf, np.inf), (-np.inf, -np.inf)][self.rng.integers(5)]
        status = self.c._call("set_bounds", self.c._s, row, -1, *pair)
        if Status(status) != Status.BAD_BOUNDS:
            self.out.violate("bad bounds accepted", f"{pair}: {Status(status).name}")
        bad = self.problem.path.reference.copy()
        bad[self.rng.integers(bad.size)] = self.rng.choice([np.nan, np.inf])
        for what, call in (
            ("crossed bounds", lambda: self.c.set_bounds(self.problem.rows[row].name, 1.0, 0.5)),
            ("reference", lambda: self.c.set_reference(bad)),
            ("weight", lambda: self.c.set_weight(np.full(bad.size, np.nan))),
        ):
            try:
                call()
            except ControllerError:
                continue
            self.out.violate("bad value accepted", what)
        if bytes(self.c._memory) != before:
            self.out.violate("refused values written", str(pair))

    def move_reference(self) -> None:
        y = self.problem.path.reference.copy()
        y[: self.x.size] += 0.3 * self.trial.jump * self.rng.normal(size=self.x.size)
        self.c.set_reference(y)

    # -- one sample -------------------------------------------------------------------------------------------------

    def sample(self) -> None:
        c, rng = self.c, self.rng
        if self.happens("reset"):
            c.reset()
            self.planned = False
            self.since_restart = GIVE_UP + 1
        if self.happens("reference"):
            self.move_reference()
            if not self.planned:
                c.reset()
        if self.happens("crossed"):
            self.refuse()
        if self.happens("bounds"):
            self.move_bounds()
        measured = self.disturb()
        before = c.u.copy()
        shifted = self.planned or self.failures > 0
        c.prepare()
        self.check_shift(before, shifted)
        if rng.random() < 0.3 * EVENTS["bounds"]:
            self.move_bounds()  # takes effect in this feedback
        kept = c.x.copy(), c.u.copy()
        chosen = read_qp(self.problem, self.struct, measured) if rng.random() < 0.02 else None
        u = c.feedback(measured)
        self.out.samples += 1
        self.judge(u, measured, kept, chosen)
        self.x = np.asarray(c.integrate(self.x, u, self.trial.dt))
        if self.failures and self.failures % PATIENCE == 0:
            self.x = self.trial.rest.copy()
            self.out.rescues += 1

    def check_shift(self, before: Array, shifted: bool) -> None:
        """Controls that prepare() left: the previous ones, shifted by ``lag`` from the second sample on."""
        lag = self.trial.lag if shifted else 0
        if lag is None:
            return
        expected = before if lag == 0 else np.clip(np.vstack([before[lag:], before[-lag:]]), *self.limits())
        if not np.array_equal(self.c.u, expected, equal_nan=True):
            self.out.violate("plan not shifted as stated", f"lag {lag}")

    def limits(self) -> tuple[Array, Array]:
        pairs = [self.bounds[name] if name else (-np.inf, np.inf) for name in self.control_rows]
        return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])

    def judge(self, u: Array, measured: Array, kept: tuple[Array, Array], chosen: StageQP | None) -> None:
        out, status = self.out, self.c.status
        out.status[status.name] += 1
        lower, upper = self.limits()
        if not np.all(np.isfinite(u)) or np.any(u < lower) or np.any(u > upper):
            out.violate("control not finite or outside its bounds", f"{u} not in {lower}, {upper}: {status.name}")
        finite = bool(np.all(np.isfinite(measured)))
        if finite == (status == Status.NOT_FINITE):
            out.violate("wrong status for a measurement", f"{measured}: {status.name}")
        if status == Status.OK:
            self.solved(chosen)
        elif finite:
            self.failed_qp(measured, kept)
        if status != Status.OK:
            self.fallback(u, kept, lower, upper)

    def solved(self, chosen: StageQP | None) -> None:
        out = self.out
        self.failures, self.waited, self.planned = 0, None, True
        self.since_restart += 1
        if not all(np.all(np.isfinite(a)) for a in (self.c.x, self.c.u, self.c.lam)):
            out.violate("plan not finite", "")
        if chosen is not None:
            verdict = certificate(chosen)
            out.certified[f"{verdict}, OK"] += 1
            if verdict == "infeasible":
                out.violate("infeasible QP called OK", "")

    def failed_qp(self, measured: Array, plan: tuple[Array, Array]) -> None:
        """For a measured state without a solution, the QP of the prepared plan must be infeasible."""
        out, status = self.out, self.c.status
        self.failures += 1
        out.longest = max(out.longest, self.failures)
        verdict = certificate(read_qp(self.problem, self.struct, measured, plan))
        out.certified[f"{verdict}, {status.name}"] += 1
        if verdict == "feasible":
            out.violate(f"feasible QP called {status.name}", "")
        if verdict == "feasible" or self.feasible_afresh(measured):
            self.waited = 1 if self.waited is None else self.waited + 1
            out.recovery = max(out.recovery, self.waited)
        else:
            self.waited = None

    def feasible_afresh(self, measured: Array) -> bool:
        """True if the QP of a new controller with only this measurement has a feasible point."""
        twin = self.c.copy()
        twin.reset()
        twin.x[:] = measured
        twin.prepare()
        return certificate(read_qp(self.problem, twin._struct, measured)) == "feasible"

    def fallback(self, u: Array, plan: tuple[Array, Array], lower: Array, upper: Array) -> None:
        out, status, kept = self.out, self.c.status, plan[1]
        same = np.array_equal(self.c.u, kept) or np.array_equal(self.c.u, np.clip(kept, lower, upper))
        useless = not all(np.all(np.isfinite(part)) for part in plan)
        if not same and not self.given_up(lower, upper, useless):
            out.violate("failure changes the controls of the plan", status.name)
        if self.failures > 1 or not same:
            self.since_restart = 0
        expected = np.clip(kept[0], lower, upper)
        if not np.array_equal(u, expected):
            out.violate("failure does not return the plan's control", f"{u}, expected {expected}: {status.name}")
        if not self.planned and not self.failures:
            reference = self.reference(lower, upper)
            if not np.allclose(u, reference, rtol=1e-12, atol=0):
                out.violate("no plan: not the clipped reference control", f"{u}, reference {reference}")

    def reference(self, lower: Array, upper: Array) -> Array:
        """Controls of a plan that is given up."""
        y = [self.c.view("yref")[0][y] if y >= 0 else 0.0 for y in self.problem.control_reference]
        return np.clip(y, lower, upper)

    def given_up(self, lower: Array, upper: Array, useless: bool) -> bool:
        """True if the plan may be given up, and is.

        That is after the third failure in a row, the second one without a finite linearisation, one soon after a
        restart, or the first one of a plan that is not finite (useless).
        """
        broken = self.failures > 1 and self.c.status == Status.NUMERICAL_FAILURE
        allowed = useless or broken or self.failures > 2 or self.since_restart <= GIVE_UP
        return allowed and np.allclose(self.c.u, self.reference(lower, upper), rtol=1e-12, atol=0)

    def run(self, steps: int) -> Outcome:
        """The trial."""
        for _ in range(steps):
            self.sample()
        return self.out


def _between(a: float, b: float, share: float) -> float:
    if share == 0.0 or a == b:
        return a
    if not (np.isfinite(a) and np.isfinite(b)):
        return b
    return a + share * (b - a)


def main() -> None:
    """All trials."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000, help="samples of a trial")
    steps = parser.parse_args().steps
    for trial in trials():
        start = time.perf_counter()
        out = Torture(trial).run(int(trial.share * steps))
        print(f"{trial.name}: {out.samples} samples, {time.perf_counter() - start:.1f} s, recovery {out.recovery}, "
              f"longest {out.longest}, rescues {out.rescues}")  # fmt: skip
        print(f"  {dict(out.status)}\n  {dict(out.certified)}")
        for what, count in out.violations.items():
            print(f"  {count} x {what}; {out.first[what]}")


if __name__ == "__main__":
    main()
