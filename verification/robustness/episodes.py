"""One bad datum is followed by good ones; the controller must return to the control of one that never saw it.

A controller that has converged for a measured state gets one sample with a bad datum: a state, a reference, a weight, a
parameter, bounds, or numbers written over its plan. From then on everything is as before. It is locked up if it is not
OK within 20 samples, or if after 100 samples its control is not that of the controller that was left in peace. It is
watched until it has agreed with that one for some samples on end, at most 100.

Problems that are not convex have several solutions, and a plan that was optimal for the bad datum may lead to another
one. Such an episode goes on for as many samples as a controller is given to converge in peace. If the KKT residuals of
the plan then vanish, recomputed from the problem, or if IPOPT, started there, returns its control, the controller is at
a solution: the episode counts under other_solutions, with both costs, and not as a lock-up.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from nmpc_codegen import Controller, ExplicitRungeKutta, Status
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import CLASSICAL, Point, evaluate_cost, kkt_residuals, node_data
from verification.robustness.hostile import Data, spoiled
from verification.robustness.subjects import built, candidates

Array = np.ndarray
EPISODES = 10_000
STATES = 4  # good measured states of a controller
SETTLING = 150  # samples in which a controller that is left in peace converges
PATIENCE, LATER, AGREED = 20, 100, 6
#: Largest differences of the last samples of a converged controller, and of a recovered one from it; relative to the
#: range.
CONVERGED = {"double": 1e-8, "single": 1e-3}
EQUAL = {"double": 1e-6, "single": 1e-2}
#: The same for a control that IPOPT confirms; a plan that is shifted while the state is held is off by a little.
CONFIRMED = {"double": 1e-3, "single": 1e-2}
#: KKT residuals of a plan that is a solution, in double.
STATIONARY = 1e-9


@dataclass
class Peace:
    """A controller has run SETTLING samples at one measured state: its memory and control, and if it has settled."""

    xhat: Array
    memory: Array
    u: Array
    ok: bool
    converged: bool


@dataclass
class Outcome:
    """An outcome counts the episodes of a controller; recovery: samples until OK, by the datum that was spoilt."""

    episodes: int = 0
    compared: int = 0
    never_ok: Counter[str] = field(default_factory=Counter)
    elsewhere: Counter[str] = field(default_factory=Counter)
    other_solutions: list[str] = field(default_factory=list)
    recovery: dict[str, list[int]] = field(default_factory=dict)
    examples: list[str] = field(default_factory=list)

    @property
    def lockups(self) -> int:
        return sum(self.never_ok.values()) + sum(self.elsewhere.values())


@cache
def oracle_of(number: int) -> Reference:
    """Return the nonlinear program of a candidate."""
    subject = candidates()[number].subject
    steps = (subject.integrator or ExplicitRungeKutta()).steps
    return Reference(classify(subject.make()), replace(CLASSICAL, steps=steps))


class Loop:
    """A loop is a controller in operation."""

    def __init__(self, controller: Controller, rest: Array, spread: Array, seed: int) -> None:
        self.c = controller
        self.data = Data(controller)
        self.seed, self.rng = seed, np.random.default_rng([41, seed])
        self.precision = "double" if controller.view("x").dtype == np.float64 else "single"
        known = dict(zip(controller.names.rows, self.data.bounds, strict=True))
        bounds = np.array([known.get(name, (-np.inf, np.inf)) for name in controller.names.controls])
        self.range = bounds[:, 1] - bounds[:, 0]
        away = [np.zeros_like(rest), *self.rng.uniform(-1, 1, (STATES - 1, rest.size))]
        self.peaceful = [self._settle(rest + spread * where) for where in away]

    def unit(self, u: Array) -> Array:
        """Return the range of every control, or its size where it has none."""
        return np.asarray(np.where(np.isfinite(self.range), self.range, np.maximum(1.0, np.abs(u))))

    def _settle(self, xhat: Array) -> Peace:
        c = self.c
        c.reset()
        last = []
        for _ in range(SETTLING):
            last.append((c.step(xhat), c.status == Status.OK))
        tail = np.array([u for u, _ in last[-PATIENCE:]])
        u, ok = last[-1][0], all(good for _, good in last[-PATIENCE:])
        spread = np.max(np.ptp(tail, axis=0) / self.unit(u))
        return Peace(xhat, c._memory.copy(), u, ok, ok and bool(spread <= CONVERGED[self.precision]))

    def spoil(self, kind: str, xhat: Array) -> None:
        """Run the one bad sample."""
        c = self.c
        if kind == "state":
            c.step(spoiled(self.rng, xhat))
        elif kind == "plan":
            self.data.spoil_plan(self.rng)
            c.step(xhat)
        else:
            for _ in range(10):
                if self.data.spoil(self.rng, kind) == Status.OK:
                    break
            c.step(xhat)
            self.data.restore()

    def _other_solution(self, peace: Peace) -> str:
        """Return the costs at the controller's solution and at the peaceful one; empty if it is at none."""
        for _ in range(SETTLING):
            self.c.step(peace.xhat)
        oracle = oracle_of(self.seed)
        problem, scheme = oracle.problem, oracle.integrator
        data = node_data(problem, x0=peace.xhat)
        plan = point(self.c)
        found = oracle.solve(data, x=plan.x, u=plan.u)
        off = float(np.max(np.abs(found.u[0] - plan.u[0]) / self.unit(peace.u)))
        if kkt_residuals(problem, plan, data, scheme).worst > STATIONARY and off > CONFIRMED[self.precision]:
            return ""
        self.c._memory[:] = peace.memory
        other = point(self.c)
        costs = [evaluate_cost(problem, p.x, p.u, data, scheme) for p in (plan, other)]
        return f"cost {costs[0]:.6g}; {costs[1]:.6g} in peace"

    def episode(self, out: Outcome, number: int) -> None:
        """Run one episode with a bad datum."""
        peace = self.peaceful[number % STATES]
        kinds = ["state", "plan", *self.data.kinds()]
        kind = kinds[number // STATES % len(kinds)]
        self.c._memory[:] = peace.memory
        self.rng = np.random.default_rng([41, self.seed, number])
        self.spoil(kind, peace.xhat)
        if peace.ok:  # else no controller is OK there
            self._watch(out, kind, peace, number)

    def _watch(self, out: Outcome, kind: str, peace: Peace, number: int) -> None:
        out.episodes += 1
        out.compared += peace.converged
        first, agreed, statuses = 0, 0, []
        for k in range(1, LATER + 1):
            u = self.c.step(peace.xhat)
            good = self.c.status == Status.OK
            statuses.append(self.c.status.name)
            first = k if good and not first else first
            off = float(np.max(np.abs(u - peace.u) / self.unit(peace.u)))
            near = not peace.converged or off <= EQUAL[self.precision]
            agreed = agreed + 1 if good and near else 0
            if agreed == AGREED:
                break
        out.recovery.setdefault(kind, []).append(first or LATER)
        if not 0 < first <= PATIENCE:
            out.never_ok[kind] += 1
            out.examples.append(f"{number}, {kind}: {Counter(statuses).most_common(2)}")
        elif agreed == 0 and (found := self._other_solution(peace)):
            out.other_solutions.append(f"{number}, {kind}: {found}")
        elif agreed == 0:
            out.elsewhere[kind] += 1
            out.examples.append(f"{number}, {kind}: {u} for {peace.u}, {Counter(statuses).most_common(2)}")


def point(controller: Controller) -> Point:
    """Return the primal and dual variables of the controller's plan."""
    names = Point.__dataclass_fields__
    return Point(**{name: np.array(getattr(controller, name), dtype=float) for name in names})


def run(job: tuple[Controller, Array, Array, int, int]) -> Outcome:
    """Run episodes of a controller: job = (controller, home of its loop, spread of good states, seed, count)."""
    controller, rest, spread, seed, count = job
    out = Outcome()
    with np.errstate(all="ignore"):
        loop = Loop(controller, rest, spread, seed)
        for number in range(count):
            loop.episode(out, number)
    return out


def replay(name: str, profile: str = "fast") -> None:
    """Print an episode: the bad sample and those after it.

    Args:
        name: "controller/number", as the benchmark prints it.
        profile: of the controller that replays it.
    """
    label, _, number = name.rpartition("/")
    seed, candidate = next((i, c) for i, c in enumerate(candidates()) if str(c) == label)
    (controller,) = built([candidate], profile)
    with np.errstate(all="ignore"):
        loop = Loop(controller, candidate.subject.rest, candidate.subject.spread, seed)
        peace = loop.peaceful[int(number) % STATES]
        print(f"in peace at {peace.xhat}: {peace.u}, {'converged' if peace.converged else 'not converged'}")
        real = controller.step

        def told(x: Array) -> Array:
            u = real(x)
            print(f"{x} -> {u} {controller.status.name}; x_1 = {controller.x[1]}, u_0 = {controller.u[0]}")
            return u

        vars(controller)["step"] = told
        loop.episode(Outcome(), int(number))
