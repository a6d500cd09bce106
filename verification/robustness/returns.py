"""Returns under hostile data keep their contract: u0 is finite and inside its bounds, and the status exists.

The entry points of the compiled packages are called one after the other with measured states, references, weights,
parameters, bounds and plans that hold NaN, infinities and numbers of every size; u0 is NaN before every call. Data that
the setters refuse stay as they were. Bounds are compared as the controller stores them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from nmpc_codegen import Controller, Status
from nmpc_codegen.runtime.diagnosis.plan_rows import path_bounds
from verification.robustness.hostile import Data, spoiled

Array = np.ndarray
RETURNS = 1_000_000
SEGMENT = 16  # samples between changes of the data
KNOWN = np.array([int(status) for status in Status])


@dataclass
class Outcome:
    """An outcome counts the returns of a controller and their faults."""

    returns: int = 0
    status: Counter[int] = field(default_factory=Counter)
    violations: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def judge(self, u: Array, status: Array, lower: Array, upper: Array) -> None:
        """Judge controls (samples, nu) and statuses (samples,) of a segment with its bounds (nu,)."""
        self.returns += len(status)
        self.status.update(status.tolist())
        finite = np.isfinite(u).all(axis=1)
        inside = ((u >= lower) & (u <= upper)).all(axis=1)
        for what, bad in (
            ("control not finite", ~finite),
            ("control outside its bounds", finite & ~inside),
            ("unknown status", ~np.isin(status, KNOWN)),
        ):
            if bad.any():
                self.violations[what] += int(bad.sum())
                i = int(np.argmax(bad))
                self.first.setdefault(what, f"{u[i]} in {lower}, {upper}: status {status[i]}")


class Assault:
    """An assault calls one controller with hostile data."""

    def __init__(self, controller: Controller, rest: Array, spread: Array, seed: int) -> None:
        self.c, self.rest, self.spread = controller, rest, spread
        self.rng = np.random.default_rng([43, seed])
        self.data = Data(controller)
        self.phases = controller.description.has_phases
        names = ("step", "shift", *(("prepare", "feedback") if self.phases else ()))
        self.call = {name: controller._package.function(name) for name in names}
        rows = controller.names.rows
        self.rows = [rows.index(name) if name in rows else None for name in controller.names.controls]

    def change_data(self) -> None:
        """Change some of the data of the next samples."""
        rng, kinds = self.rng, self.data.kinds()
        if rng.random() < 0.5:
            self.data.restore()
        if kinds and rng.random() < 0.6:
            self.data.spoil(rng, str(rng.choice(kinds)))
        if rng.random() < 0.2:
            self.data.spoil_plan(rng)
        if rng.random() < 0.1:
            self.c.reset()

    def bounds(self) -> tuple[Array, Array]:
        """Return the bounds of the controls, as they are stored now."""
        pairs = [(-np.inf, np.inf) if row is None else path_bounds(self.c, row) for row in self.rows]
        return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])

    def states(self, count: int) -> Array:
        """Return measured states, half of them good."""
        x = self.rest + self.spread * self.rng.uniform(-1, 1, (count, self.rest.size))
        for i in np.flatnonzero(self.rng.random(count) < 0.5):
            x[i] = spoiled(self.rng, x[i])
        return x

    def sample(self, way: float) -> int:
        """Run one return; one in ten by the phases, one in fifty without preparation or after a manual shift."""
        c, call = self.c, self.call
        if way > 0.98:
            call["shift"](c._s)
        elif not self.phases:
            return int(call["step"](c._s, c._xhat_c, c._u0_c))
        elif way > 0.96:
            return int(call["feedback"](c._s, c._xhat_c, c._u0_c))
        elif way < 0.1:
            call["prepare"](c._s)
            return int(call["feedback"](c._s, c._xhat_c, c._u0_c))
        return int(call["step"](c._s, c._xhat_c, c._u0_c))

    def segment(self, out: Outcome) -> None:
        """Run some samples with the same data."""
        self.change_data()
        lower, upper = self.bounds()
        x, ways = self.states(SEGMENT), self.rng.random(SEGMENT)
        u, status = np.empty((SEGMENT, self.c.dims.nu)), np.empty(SEGMENT, int)
        for i in range(SEGMENT):
            self.c._xhat[:], self.c._u0[:] = x[i], np.nan
            status[i] = self.sample(ways[i])
            u[i] = self.c._u0
        out.judge(u, status, lower, upper)


def run(job: tuple[Controller, Array, Array, int, int]) -> Outcome:
    """Run returns of a controller: job = (controller, home of its loop, spread of good states, seed, count)."""
    controller, rest, spread, seed, count = job
    out = Outcome()
    with np.errstate(all="ignore"):
        assault = Assault(controller, rest, spread, seed)
        while out.returns < count:
            assault.segment(out)
    return out
