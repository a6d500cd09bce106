"""Remedies advised after a failure are tried on the problems that fail; failures are counted before and after."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    ExactHessian,
    ExplicitRungeKutta,
    NoCondensing,
    Options,
    ProblemWarning,
    RealTimeIteration,
    RiccatiActiveSet,
    Status,
    build,
    simulate,
)
from nmpc_codegen.campaigns import campaign
from verification.strangers import house
from verification.strangers.loops import run
from verification.strangers.problems import known
from verification.strangers.statement import Array
from verification.strangers.twin import Twin

#: Numbers of loops of a stranger, and of cold starts of solve().
LOOPS, STARTS = 10, 10

#: Returns the failures of a kind, and the number of samples or solves.
Flight = Callable[[], tuple[int, int]]


@dataclass(frozen=True)
class Trial:
    """A trial has a failure, its problem, the remedy, and the flights without and with it."""

    failure: str
    where: str
    remedy: str
    before: Flight
    after: Flight


def _stranger(name: str, failure: str, solved: bool = False, **options: Any) -> Flight:
    """Count samples with this status in loops of a stranger, after solve() at their start if ``solved``."""

    def fly() -> tuple[int, int]:
        s = known(name)
        flown = campaign(s.ocp(), options=replace(s.options(), **options), progress=False, **s.flights(range(LOOPS)))
        if not solved:
            return int(flown.flown.samples[:, Status[failure]].sum()), LOOPS * s.samples
        found, words = 0, s.flights(range(LOOPS))
        gusts = words["added"]
        for start in words["starts"]:
            log = simulate(flown.job.controller.copy(), start, s.samples, added=gusts, warm_start=True)
            found += int(np.sum(log.status == Status[failure]))
        return found, LOOPS * s.samples

    return fly


def _lost(name: str, algorithm: RealTimeIteration | AugmentedLagrangian) -> Flight:
    """Count lost loops of a stranger."""

    def fly() -> tuple[int, int]:
        s = known(name)
        verdicts = run(s, range(LOOPS), replace(s.options(), algorithm=algorithm))
        return sum(bool(v.lost) for v in verdicts), LOOPS

    return fly


def _house(failure: str, **options: Any) -> Flight:
    """Count samples of the house with this status."""

    def fly() -> tuple[int, int]:
        statuses, _ = house.run(build(house.ocp(), house.options(**options), "fast"))
        return statuses[failure], house.SAMPLES

    return fly


def _solves(name: str, limit: int) -> Flight:
    """Count cold starts of solve() that end at this limit of iterations."""

    def fly() -> tuple[int, int]:
        s = known(name)
        controller, twin, found = build(s.ocp(), s.options(), "fast"), Twin(s), 0
        for number in range(STARTS):
            start = s.initial(number)
            controller.reset()
            controller.x[:], controller.u[:] = twin.guess(start)
            found += controller.solve(start, max_iterations=limit).status.name == "ITERATION_LIMIT"
        return found, STARTS

    return fly


def cart_in_a_box(N: int, soft: tuple[float, float] | None = None) -> tuple[OCP, Array, Array]:
    """Return the OCP of a linear pendulum on a cart whose states leave a box with a short horizon.

    Return it with A (4, 4), B (4, 1).
    """
    M, m, length, g, h = 0.6, 0.4, 0.35, 9.81, 0.02
    A, B = np.zeros((4, 4)), np.array([[0], [0], [1 / M], [1 / (M * length)]])
    A[0, 2] = A[1, 3] = 1
    A[2, 1], A[3, 1] = m * g / M, (M + m) * g / (M * length)
    E = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 5))]]) * h)
    A, B = E[:4, :4], E[:4, 4:]
    ocp, box = OCP("cart", N=N), np.array([1.5, 0.2, 0.35, 1.5])
    x, u = ocp.state("x", size=4), ocp.control("F")
    ocp.dynamics({x: ca.DM(A) @ x + ca.DM(B) @ u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[10, 1, 10, 1, 0.1])
    ocp.lqr_terminal_cost()
    ocp.subject_to(-12, u, 12)
    ocp.subject_to(-box, x, box, name="box", soft=soft)
    return ocp, A, B


def _pushed(N: int, soft: tuple[float, float] | None = None) -> Flight:
    """Count RELAXED samples of the cart, out of 500."""

    def fly() -> tuple[int, int]:
        ocp, A, B = cart_in_a_box(N, soft)
        log = simulate(build(ocp, profile="fast"), [1.0, 0, 0, 0], 500, plant=lambda x, u, _: A @ x + B @ u, plans=0)
        return int(np.sum(log.status == Status.RELAXED)), 500

    return fly


def _culture(steps: int) -> Flight:
    """Count failures of a cell culture with a fast pole at its optimum, in 40 samples of a finely simulated plant."""

    def fly() -> tuple[int, int]:
        ocp = OCP("culture", T=30.0, N=30)
        p, m, rate = ocp.state("p", initial=0.1), ocp.state("m", initial=0.02), ocp.control("rate")
        ocp.dynamics({p: 20 * m * (0.6 - p) - 0.4 * p, m: rate})
        ocp.least_squares(ca.vertcat(p - 0.6, rate), weight=[1, 0.01])
        ocp.subject_to(-0.1, rate, 0.1)
        ocp.subject_to(0.01, m, 1.2)
        ocp.subject_to(0, p, 2)

        def plant(x: Array, u: Array, _: float) -> Array:
            for _ in range(200):
                x = x + 0.005 * np.array([20 * x[1] * (0.6 - x[0]) - 0.4 * x[0], u[0]])
            return x

        controller = build(ocp, Options(ExplicitRungeKutta(RK4, steps=steps)), "fast")
        log = simulate(controller, [0.1, 0.02], 40, plant=plant, plans=0)
        bad = (Status.NOT_CONVERGED, Status.ITERATION_LIMIT, Status.NUMERICAL_FAILURE)
        return int(np.isin(log.status, bad).sum()), 40

    return fly


_NONE = RealTimeIteration(relaxation=None)
_ACTIVE: dict[str, Any] = {"condensing": NoCondensing(), "qp": RiccatiActiveSet()}
_ALONE: dict[str, Any] = {"condensing": NoCondensing(), "qp": RiccatiActiveSet(fallback=None)}
_EXACT: dict[str, Any] = {"hessian": ExactHessian()}

_LIMIT, _FAR = "ITERATION_LIMIT", "NOT_CONVERGED"

TRIALS: tuple[Trial, ...] = (
    Trial(_LIMIT, "house, `ExactHessian()`", "no Hessian given", _house(_LIMIT, **_EXACT), _house(_LIMIT)),
    Trial(
        *(_LIMIT, "house, `RiccatiActiveSet(fallback=None)`", "no `fallback` given"),
        *(_house(_LIMIT, **_ALONE), _house(_LIMIT, **_ACTIVE)),
    ),
    *(
        Trial(_FAR, name, "`solve()` before the loop", _stranger(name, _FAR), _stranger(name, _FAR, solved=True))
        for name in ("unicycle", "drone", "arm")
    ),
    *(
        Trial(
            *("loops lost", f"{name}, `iterations=1`", "`iterations=10`"),
            *(_lost(name, RealTimeIteration(iterations=1)), _lost(name, RealTimeIteration())),
        )
        for name in ("unicycle", "drone", "car")
    ),
    Trial("all but OK", "culture, RK4 with 4 steps", "12 steps", _culture(4), _culture(12)),
    Trial(
        *(_FAR, "trailer, `AugmentedLagrangian()`", "`RealTimeIteration()`"),
        *(_stranger("trailer", _FAR, algorithm=AugmentedLagrangian()), _stranger("trailer", _FAR)),
    ),
    Trial(
        *("loops lost", "hovercraft, `AugmentedLagrangian()`", "`RealTimeIteration()`"),
        *(_lost("hovercraft", AugmentedLagrangian()), _lost("hovercraft", RealTimeIteration())),
    ),
    Trial(
        *(_LIMIT, "reservoir, single, `NoCondensing()`", '`precision="double"`'),
        *(_stranger("reservoir", _LIMIT, precision="single", **_ACTIVE), _stranger("reservoir", _LIMIT, **_ACTIVE)),
    ),
    Trial(
        *(_LIMIT, "reservoir, single, `NoCondensing()`", "no condensing given"),
        _stranger("reservoir", _LIMIT, precision="single", **_ACTIVE),
        _stranger("reservoir", _LIMIT, precision="single"),
    ),
    *(
        Trial(
            *("INFEASIBLE", f"{name}, `relaxation=None`", '`relaxation="auto"`'),
            *(_stranger(name, "INFEASIBLE", algorithm=_NONE), _stranger(name, "INFEASIBLE")),
        )
        for name in ("seir", "reservoir")
    ),
    Trial("RELAXED", "cart in a box, N = 20", "N = 100", _pushed(20), _pushed(100)),
    Trial("RELAXED", "cart in a box, N = 20", "`soft=(100, 0)`", _pushed(20), _pushed(20, (100.0, 0.0))),
    *(
        Trial(_LIMIT, f"`solve()`, {name}, 20 iterations", "200 iterations", _solves(name, 20), _solves(name, 200))
        for name in ("van_der_pol", "acrobot")
    ),
)


def table() -> str:
    """Return the effects of the remedies in Markdown."""
    lines = ["| failure | where | remedy | before | after |", "|---|---|---|---:|---:|"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        for t in TRIALS:
            (before, n), (after, m) = t.before(), t.after()
            lines.append(f"| {t.failure} | {t.where} | {t.remedy} | {before} of {n:,} | {after} of {m:,} |")
            print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"
