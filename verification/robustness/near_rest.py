"""Displacements along single axes, and loops that settle: how many samples a solver gives up.

The QP of a problem at rest falls into parts of which some have nothing to do: all their terms are rounding errors of
the other ones, and checks that compare them with each other refuse what is solved. Random data never look like this.

From every subject's rest one component of the state at a time is displaced, by the spread of good states and by far
less, and a fresh controller gets two samples; then a loop is closed until it has settled. A sample that ends with
ITERATION_LIMIT, NUMERICAL_FAILURE or STALLED counts; INFEASIBLE and RELAXED are true of some of these starts.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from nmpc_codegen import Controller, ExactHessian, GaussNewton, Mirror, OptionError, Options, Status, generate
from nmpc_codegen.options import PRECISIONS
from verification.qp.stage_package import SOLVERS
from verification.robustness.subjects import Candidate, Subject

Array = np.ndarray
GIVEN_UP = (Status.ITERATION_LIMIT, Status.NUMERICAL_FAILURE, Status.STALLED)
SHARES = (1e-9, 1e-5, 1e-2, 1.0)  # of the spread of good states
SETTLING = 120  # samples of the loop


@dataclass
class Outcome:
    """Samples of a controller, and those that it gave up: by status, with one example."""

    samples: int = 0
    given_up: Counter[str] = field(default_factory=Counter)
    example: str = ""

    def add(self, status: Status, where: str) -> None:
        """One sample."""
        self.samples += 1
        if status in GIVEN_UP:
            self.given_up[status.name] += 1
            self.example = self.example or where


def candidates_of(subject: Subject) -> list[Candidate]:
    """The automatic choice and every solver by name, in both precisions, those that the export takes."""
    hessian = ExactHessian(regularization=Mirror()) if subject.general else GaussNewton()
    found = []
    for precision in PRECISIONS:
        usual = Options(subject.integrator, hessian, precision=precision)
        found.append(Candidate(subject, f"chosen, {precision}", usual))
        for name, (condensing, qp) in SOLVERS.items():
            options = Options(subject.integrator, hessian, condensing, qp, precision=precision)
            try:
                generate(subject.make(), options)
            except OptionError:  # a condensed map that grows beyond the precision
                continue
            found.append(Candidate(subject, f"{name}, {precision}", options))
    return found


def run(job: tuple[Controller, Array, Array, int, int]) -> Outcome:
    """Starts along the axes, then the loop: (controller, home of its loop, spread of good states, number, samples)."""
    c, rest, spread, _, settling = job
    out = Outcome()
    for component, share, sign in itertools.product(range(rest.size), SHARES, (1, -1)):
        away = np.zeros_like(rest)
        away[component] = sign * share * spread[component]
        c.reset()
        for sample in range(2):
            c.step(rest + away)
            out.add(c.status, f"{c.names.states[component]} {away[component]:+.3g}, sample {sample}")
    _settle(c, rest + 0.3 * spread, settling, out)
    return out


def _settle(c: Controller, x: Array, samples: int, out: Outcome) -> None:
    c.reset()
    interval = float(c.description.dt[0])
    for sample in range(samples):
        u = c.step(x)
        out.add(c.status, f"loop, sample {sample}")
        x = np.asarray(c.integrate(x, u, interval), dtype=float)
