"""Controllers receive bad data: examples and small problems, over solvers, Hessians, shifts and precisions."""

from __future__ import annotations

import itertools
import multiprocessing
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from examples import bioreactor, cart_pole, chain, crane, cstr, quadrotor
from nmpc_codegen import (
    OCP,
    RK4,
    AdjointShooting,
    AugmentedLagrangian,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    GaussNewton,
    Mirror,
    Options,
    RealTimeIteration,
)
from nmpc_codegen.components.algorithms.shifts import SHIFTS
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.options import PRECISIONS
from verification.built import build_all
from verification.qp.stage_package import SOLVERS

Array = np.ndarray
Outcome = TypeVar("Outcome")

#: A controller, the home of its loop, the spread of good states, a seed, a count.
Job = tuple[Controller, Array, Array, int, int]


@dataclass(frozen=True, eq=False)
class Subject:
    """A subject is a problem, a state at which its loop is at home, and the distance of good measurements from it.

    ``general``: the cost is no least squares, so that Gauss-Newton does not apply.
    """

    name: str
    make: Callable[[], OCP]
    rest: Array
    spread: Array
    general: bool = False
    integrator: ExplicitRungeKutta | None = None


def _oscillator(name: str, **grid: Any) -> tuple[OCP, Any, Any, Any]:
    """Create x'' = -x + 0.3 x^3 + u and return (ocp, x, v, u); its spring diverges beyond |x| = 1.8."""
    ocp = OCP(name, **(grid or {"T": 2.0, "N": 10}))
    x, v, u = ocp.state("x"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({x: v, v: -x + 0.3 * x**3 + u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=[10, 1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x, v), weight=[10, 10])
    return ocp, x, v, u


def unbounded() -> OCP:
    """Return an OCP without constraints."""
    return _oscillator("unbounded")[0]


def soft_rows() -> OCP:
    """Return an OCP with a soft state bound and a soft general row with a control, which has no bounds of its own."""
    ocp, x, v, u = _oscillator("soft_rows")
    ocp.subject_to(-0.3, v, 0.3, name="slow", soft=(5, 0))
    ocp.subject_to(-np.inf, x + u, 0.4, name="gentle", soft=(1, 10))
    return ocp


def general_rows() -> OCP:
    """Return an OCP with hard general rows on the path and at the end."""
    ocp, x, v, u = _oscillator("general_rows")
    ocp.subject_to(-3, u, 3)
    ocp.subject_to(-2, u + x * v, 2, name="effort")
    ocp.subject_to(-0.5, x + 0.2 * v * v, 0.5, at="end", name="gate")
    return ocp


def free_component() -> OCP:
    """Return an OCP whose velocity at the start is free."""
    ocp, _x, v, u = _oscillator("free_component")
    ocp.free_initial(v)
    ocp.subject_to(-1, u, 1)
    return ocp


def coupled_rows() -> OCP:
    """Return an OCP with a soft row that keeps the end near the start."""
    ocp, x, _v, u = _oscillator("coupled_rows")
    ocp.subject_to(-1, u, 1)
    ocp.boundary(0, ocp.at_start(x) - ocp.at_end(x), 0, soft=(1, 0), name="loop")
    return ocp


def one_interval() -> OCP:
    """Return an OCP with N = nu = nx = 1."""
    ocp = OCP("one_interval", T=0.5, N=1)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -(x**3) + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    ocp.terminal_least_squares(x, weight=[1.0])
    ocp.subject_to(-1, u, 1)
    return ocp


def parameters() -> OCP:
    """Return the OCP of a cart whose mass is a parameter."""
    ocp = OCP("parameters", T=2.0, N=20)
    p, v, F = ocp.state("p", initial=1.0), ocp.state("v"), ocp.control("F")
    m = ocp.parameter("m", value=0.5)
    ocp.dynamics({p: v, v: F / m})
    ocp.least_squares(ca.vertcat(p, v, F), weight=[10, 1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(p, v), weight=[50, 5])
    ocp.subject_to(-1, F, 1)
    ocp.subject_to(-0.4, v, 0.4, name="speed")
    return ocp


def _at_rest_chain() -> Array:
    return np.asarray(classify(chain.build_ocp(3)).x_initial, dtype=float)


def subjects() -> tuple[Subject, ...]:
    """Return six examples and seven small problems."""
    two = np.zeros(2)
    small = ((unbounded, 0.4), (soft_rows, 0.4), (general_rows, 0.2), (free_component, 0.3), (coupled_rows, 0.3))
    hover = lambda: quadrotor.build_ocp((0.0, 0.0, 0.0))  # noqa: E731
    steady = cstr.SET_POINTS[0][:4]
    tip = _at_rest_chain()
    fermenter = lambda: bioreactor.build_ocp(soft=True)  # noqa: E731
    return (
        Subject("crane", crane.build_ocp, np.zeros(4), np.array([0.4, 0.2, 0.1, 0.1])),
        Subject("cstr", cstr.build_ocp, steady, np.array([0.02, 0.02, 0.5, 0.5]), integrator=ExplicitRungeKutta()),
        Subject("cart_pole", cart_pole.build_ocp, np.zeros(4), np.array([0.2, 0.1, 0.1, 0.1])),
        Subject("quadrotor", hover, np.zeros(12), np.full(12, 0.1), integrator=ExplicitRungeKutta(RK4, steps=1)),
        Subject("chain3", lambda: chain.build_ocp(3), tip, np.full(tip.size, 0.02), integrator=ExplicitRungeKutta()),
        Subject("bioreactor", fermenter, bioreactor.START, 0.02 * bioreactor.START, general=True),
        *(Subject(make.__name__, make, two, np.full(2, spread)) for make, spread in small),
        Subject("one_interval", one_interval, np.zeros(1), np.full(1, 0.5)),
        Subject("parameters", parameters, two, np.array([0.5, 0.1])),
    )


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate is a subject with options; its controller is fresh."""

    subject: Subject
    label: str
    options: Options = field(repr=False)

    def __str__(self) -> str:
        return f"{self.subject.name}, {self.label}"


def _shifted(moves: str | None, ocp: OCP) -> RealTimeIteration:
    interval = float(classify(ocp).dt[0])
    return RealTimeIteration(shift=moves, sampling_time=0.6 * interval if moves == "resample" else None)


def candidates() -> tuple[Candidate, ...]:
    """Return for every subject its default options, and three of all combinations in turn.

    The combinations of solver, precision and Hessian are dealt out with a stride that has no divisor in common with
    their number, so that neighbours differ in all three; the shift moves on by itself.
    """
    dealt = list(itertools.product(PRECISIONS, ("gauss_newton", "exact"), SOLVERS))
    found = []
    for i, subject in enumerate(subjects()):
        ocp = subject.make()
        best = ExactHessian(regularization=Mirror()) if subject.general else GaussNewton()
        usual = Options(subject.integrator, best, algorithm=_shifted(SHIFTS[i % 2], ocp))
        found.append(Candidate(subject, f"chosen, shift {SHIFTS[i % 2]}", usual))
        for j in range(3):
            precision, word, solver = dealt[5 * (3 * i + j) % len(dealt)]
            moves = SHIFTS[(i + j + i // 4) % len(SHIFTS)]
            exact = word == "exact" or subject.general
            hessian = ExactHessian(regularization=Mirror()) if exact else GaussNewton()
            condensing, qp = SOLVERS[solver]
            options = Options(subject.integrator, hessian, condensing, qp, _shifted(moves, ocp), precision=precision)
            label = f"{solver}, {precision}, {'exact' if exact else 'Gauss-Newton'}, shift {moves}"
            found.append(Candidate(subject, label, options))
    return tuple(found)


def augmented() -> tuple[Candidate, ...]:
    """Return the augmented Lagrangian for every subject, with shifts and precisions in turn."""
    found = []
    for i, subject in enumerate(subjects()):
        moves, precision = SHIFTS[i % len(SHIFTS)], PRECISIONS[i % 2]
        sampled = _shifted(moves, subject.make())
        algorithm = AugmentedLagrangian(shift=moves, sampling_time=sampled.sampling_time)
        options = Options(subject.integrator, algorithm=algorithm, precision=precision)
        found.append(Candidate(subject, f"augmented Lagrangian, {precision}, shift {moves}", options))
    return tuple(found)


#: Terms of rows of single shooting, with weights.
TERMS: tuple[dict[str, Any], ...] = (
    {"rows": "barrier"},
    {"rows": "smooth_l1", "penalty": 100.0},
    {"rows": "lumped", "penalty": 100.0},
)


def shooting() -> tuple[Candidate, ...]:
    """Return two single-shooting candidates for every subject that the method supports.

    One has the default treatment of rows, the other the next treatment that the subject allows. Methods, shifts and
    precisions alternate.
    """
    found = []
    for i, subject in enumerate(subjects()):
        problem = classify(subject.make())
        if problem.uses - AdjointShooting.supports:
            continue
        moves, precision = SHIFTS[i % len(SHIFTS)], PRECISIONS[i % 2]
        sampling_time, turn = _shifted(moves, subject.make()).sampling_time, i % len(TERMS)
        for terms in ({}, next(t for t in (*TERMS[turn:], *TERMS) if _allowed(t, problem))):
            method = "quasi_newton" if (i // 2 + bool(terms)) % 2 else "gauss_newton"
            algorithm = AdjointShooting(method=method, shift=moves, sampling_time=sampling_time, **terms)
            label = f"single shooting, {method}, {algorithm.rows}, {precision}, shift {moves}"
            options = Options(subject.integrator, algorithm=algorithm, precision=precision)
            found.append(Candidate(subject, label, options))
    return tuple(found)


def _allowed(terms: dict[str, Any], problem: Problem) -> bool:
    try:
        AdjointShooting(method="quasi_newton", **terms).check(problem)
    except OptionError:
        return False
    return True


def built(chosen: Iterable[Candidate], profile: str = "fast") -> list[Controller]:
    """Return the controllers of candidates, compiled side by side."""
    return build_all(((c.subject.make(), c.options) for c in chosen), profile)


def in_processes(run: Callable[[Job], Outcome], chosen: Sequence[tuple[int, Candidate]], count: int) -> list[Outcome]:
    """Return outcomes of ``run`` for every numbered candidate, in two processes.

    Processes start afresh: threads of CasADi and NumPy would be missing in a forked one.
    """
    pairs = zip(built(c for _, c in chosen), chosen, strict=True)
    jobs = [(ctrl, c.subject.rest, c.subject.spread, number, count) for ctrl, (number, c) in pairs]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(run, jobs))
