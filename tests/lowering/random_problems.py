"""Small optimal control problems with random features, random options and random names.

A problem is known by its number. Features that a hand-written problem has by habit are drawn here: constant dynamics,
unused states and controls, cost terms without curvature, a single row, a single state, a single interval.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen import (
    OCP,
    RK4,
    SSPRK3,
    AdjointShooting,
    AugmentedLagrangian,
    DenseActiveSet,
    Euler,
    ExactHessian,
    ExplicitRungeKutta,
    ForwardOverAdjoint,
    FullCondensing,
    GaussNewton,
    Heun,
    Midpoint,
    Mirror,
    NoCondensing,
    Online,
    OptionError,
    Options,
    ProblemError,
    ProblemWarning,
    Project,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    generate,
)

Rng = np.random.Generator
LAYOUTS = ("fixed", "shared", "node")

#: Names of signals: letters of the mathematics, names of the parts' own variables, and pairs that differ by case.
SIGNALS = (
    *("x", "u", "q", "w", "v", "h", "k", "s", "i", "dt", "lam", "mu", "S", "Q", "N", "W", "M", "m", "P", "p", "A", "a"),
    *("phi", "Phi", "theta", "NX", "R", "INF", "real_t", "node", "row", "cost", "ALL", "OK", "t2", "x_0", "y", "tape"),
)
#: Prefixes of packages: words of C and of the mathematics, and the first words of names inside a package.
PACKAGES = (
    *("long", "goto", "int", "while", "class", "operator", "double", "static", "y", "q", "s", "k", "m", "n", "nx", "u"),
    *("ny", "nh", "nw", "weight", "yref", "param", "first", "bend", "longest", "project", "qp", "path", "riccati"),
    *("terminal", "integrator", "algorithm", "take", "state", "start", "tol", "max", "row", "real", "solver", "crane"),
)


class RefusedError(Exception):
    """The draw is no problem that the compiler accepts."""


@dataclass(frozen=True)
class Draw:
    """One problem with its options, and the files of its package."""

    number: int
    name: str
    options: Options
    sources: Mapping[str, str]

    def __str__(self) -> str:
        return f"draw {self.number}: package {self.name}, {self.options}"


def draw(number: int, attempts: int = 40) -> Draw:
    """The package of this number: the first of its problems and options that the compiler accepts.

    Raises:
        RefusedError: there is none.
    """
    reasons = []
    for attempt in range(attempts):
        rng = np.random.default_rng([number, attempt])
        name = pick(rng, PACKAGES)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ProblemWarning)
                options = random_options(rng)
                return Draw(number, name, options, generate(random_ocp(rng), options, name))
        except (OptionError, ProblemError) as error:
            reasons.append(str(error))
    raise RefusedError(f"draw {number}: {reasons}")


def pick(rng: Rng, values: Sequence[Any]) -> Any:
    """One of the values."""
    return values[int(rng.integers(len(values)))]


def chance(rng: Rng, share: float) -> bool:
    """True with this probability."""
    return bool(rng.random() < share)


# The problem ----------------------------------------------------------------------------------------------------------


def random_ocp(rng: Rng) -> OCP:
    """A problem with 1 to 4 states, 1 to 3 controls and 1 to 20 intervals."""
    return _Problem(rng).ocp


class _Problem:
    """The problem while it grows."""

    def __init__(self, rng: Rng) -> None:
        self.rng = rng
        self.discrete = chance(rng, 0.2)
        N = int(pick(rng, (1, 1, 2, 3, 5, 10, 20)))
        grid: dict[str, Any] = {"N": N}
        if not self.discrete and chance(rng, 0.3):
            grid = {"intervals": list(0.1 + 0.1 * rng.random(N))}
        elif not self.discrete or chance(rng, 0.3):
            grid["T"] = 0.2 * N
        self.ocp = OCP("drawn", **grid)
        self.names = list(rng.permutation(SIGNALS))
        self.x = self._signals(self.ocp.state, pick(rng, (1, 1, 2, 2, 3, 4)))
        self.u = self._signals(self.ocp.control, pick(rng, (1, 1, 1, 2, 3)))
        self.p = self._signals(self.ocp.parameter, pick(rng, (0, 0, 1, 2)))
        self._dynamics()
        self._cost()
        self._rows()

    def _signals(self, declare: Callable[..., Any], n: int) -> list[Any]:
        """``n`` elements, some of them of vectors."""
        elements: list[Any] = []
        while len(elements) < n:
            name, size = str(self.names.pop()), int(min(n - len(elements), pick(self.rng, (1, 1, 2))))
            try:
                symbol = declare(name, size=size if size > 1 else None)
            except ProblemError:  # a name that clashes with an earlier one
                continue
            elements += [symbol[i] for i in range(size)]
        return elements

    def _factor(self) -> float:
        return float(np.round(self.rng.normal(), 2))

    def _term(self, signals: Sequence[Any]) -> Any:
        """A term of some of the signals: constant, linear or curved."""
        if not signals:
            return self._factor()
        a, b = pick(self.rng, signals), pick(self.rng, signals)
        c = self._factor()
        return pick(self.rng, (c, a, a, c * a, a + b, a * b, ca.sin(a), a**2, ca.exp(-(b**2))))

    def _sum(self, signals: Sequence[Any], most: int = 3) -> Any:
        return sum((self._term(signals) for _ in range(self.rng.integers(1, most + 1))), ca.SX(0))

    def _dynamics(self) -> None:
        """Right-hand sides that may leave out states and controls, or be constant."""
        signals = [*self.x, *self.u, *self.p]
        rhs = [self._sum(signals) for _ in self.x]
        if chance(self.rng, 0.3):
            linear = [*self.x, *self.u]
            rhs = [sum((self._factor() * s for s in linear if chance(self.rng, 0.6)), ca.SX(0)) for _ in self.x]
        self.ocp.dynamics(ca.vertcat(*(0.3 * f for f in rhs)), discrete=self.discrete)

    def _weight(self, n: int) -> Any:
        rng = self.rng
        F = rng.normal(size=(n, n))
        return pick(rng, (1.0, np.ones(n), 0.1 + rng.random(n), np.zeros(n), F @ F.T + 0.1 * np.eye(n)))

    def _cost(self) -> None:
        """Least squares, general costs, both or none, of the path, the end and the start."""
        rng, ocp = self.rng, self.ocp
        every = [*self.x, *self.u]
        if chance(rng, 0.8):
            y = every if chance(rng, 0.6) else [self._sum([*every, *self.p]) for _ in range(rng.integers(1, 4))]
            reference = None if chance(rng, 0.7) else rng.normal(size=len(y))
            ocp.least_squares(ca.vertcat(*y), self._weight(len(y)), reference=reference, scale_with_dt=chance(rng, 0.3))
        if chance(rng, 0.25):
            ocp.stage_cost(self._sum([*every, *self.p]), integrate=not self.discrete and chance(rng, 0.3))
        if chance(rng, 0.4):
            y = self.x if chance(rng, 0.6) else [self._sum([*self.x, *self.p]) for _ in range(rng.integers(1, 3))]
            ocp.terminal_least_squares(ca.vertcat(*y), self._weight(len(y)))
        if chance(rng, 0.15):
            ocp.terminal_cost(pick(rng, (ca.SX(3), self.x[0], 2 * self.x[-1], self._sum(self.x))))
        if chance(rng, 0.1):
            ocp.free_initial(self._state())
            ocp.start_least_squares(self.x[0], 1.0)

    def _state(self) -> Any:
        """The symbol of a state."""
        return pick(self.rng, list(self.ocp.states)).symbol

    def _bounds(self, n: int) -> tuple[Any, Any]:
        low, high = -1 - self.rng.random(n), 1 + self.rng.random(n)
        kind = pick(self.rng, ("both", "both", "both", "lower", "upper", "equal"))
        return {
            "both": (low, high),
            "lower": (low, np.inf),
            "upper": (-np.inf, high),
            "equal": (0.2, 0.2) if chance(self.rng, 0.3) else (low, high),
        }[kind]

    def _soft(self, share: float) -> tuple[float, float] | None:
        return (float(self.rng.random() + 0.5), pick(self.rng, (0.0, 1.0))) if chance(self.rng, share) else None

    def _rows(self) -> None:
        """Rows of every kind, each of them present or not."""
        rng, ocp, N = self.rng, self.ocp, self.ocp.N
        if chance(rng, 0.6):
            u = self.u if chance(rng, 0.6) else self.u[:1]
            low, high = self._bounds(len(u))
            ocp.subject_to(low, ca.vertcat(*u), high)
        for at, share in (("path", 0.3), ("end", 0.25), ("start", 0.05), (sorted({N, max(1, N // 2)}), 0.1)):
            if chance(rng, share):
                low, high = self._bounds(1)
                ocp.subject_to(
                    low, pick(rng, self.x), high, at=at, soft=self._soft(0.3), name=f"bound_{len(ocp.statements)}"
                )
        for at, share in (("path", 0.3), ("end", 0.2), (sorted({0, N - 1}), 0.1)):
            signals = self.x if at == "end" else [*self.x, *self.u]
            if chance(rng, share):
                n = int(rng.integers(1, 3))
                low, high = self._bounds(n)
                h = [self._sum([*signals, *self.p]) + pick(rng, signals) for _ in range(n)]
                ocp.subject_to(
                    low, ca.vertcat(*h), high, at=at, soft=self._soft(0.3), name=f"row_of_{len(ocp.statements)}"
                )
        if chance(rng, 0.1):
            s = pick(rng, self.x)
            ocp.boundary(-1, ocp.at_end(s) - (ocp.at_start(s) if chance(rng, 0.7) else 0), 1, soft=self._soft(0.3))
        if chance(rng, 0.06):
            ocp.accumulator(self._state())
        if chance(rng, 0.06):
            ocp.cyclic(self._state())


# The options ----------------------------------------------------------------------------------------------------------


def random_options(rng: Rng) -> Options:
    """Options of every seam, each of them given or chosen by the compiler."""
    algorithm = _algorithm(rng)
    given: dict[str, Any] = {"algorithm": algorithm}
    if chance(rng, 0.6):
        given["integrator"] = ExplicitRungeKutta(
            pick(rng, (Euler, Midpoint, Heun, SSPRK3, RK4)),
            steps=int(rng.integers(1, 4)),
            unroll=pick(rng, ("auto", "all", "step", "none")),
        )
    if "hessian" in algorithm.needs and chance(rng, 0.6):
        given["hessian"] = _hessian(rng)
    if "qp" in algorithm.needs and chance(rng, 0.6):
        given["condensing"], given["qp"] = _route(rng)
    return Options(
        **given,
        online=_online(rng) if chance(rng, 0.4) else Online(),
        precision=pick(rng, ("double", "double", "single")),
        solve=chance(rng, 0.7),
        math=pick(rng, ("libm", "libm", "own")),
        goal=pick(rng, ("speed", "speed", "size")),
        target=pick(rng, ("portable", "portable", "cortex-m4f")),
    )


def _online(rng: Rng) -> Online:
    reference, weight, bounds, parameter = (pick(rng, LAYOUTS) for _ in range(4))
    return Online(reference, weight, bounds, parameter, dense_weight=chance(rng, 0.1))


def _algorithm(rng: Rng) -> Any:
    shift = pick(rng, (None, None, "repeat", "periodic", "resample"))
    time = 0.1 if shift == "resample" else None
    kind = pick(rng, ("rti", "rti", "rti", "rti", "al", "as"))
    if kind == "al":
        repair = pick(rng, (0, 1, 3))
        return AugmentedLagrangian(shift=shift, sampling_time=time, repair=repair)
    if kind == "as":
        method = pick(rng, ("gauss_newton", "quasi_newton"))
        return AdjointShooting(method=method, shift=shift, sampling_time=time)
    return RealTimeIteration(
        shift=shift,
        sampling_time=time,
        relaxation=pick(rng, (None, "auto")),
    )


def _hessian(rng: Rng) -> Any:
    regularization = pick(rng, (Mirror(), Project(), Mirror(level="stage"), Project(level="stage"), None))
    sweep = ForwardOverAdjoint() if chance(rng, 0.3) else ExactHessian().sweep
    return pick(rng, (ExactHessian(regularization, sweep), GaussNewton()))


def _route(rng: Rng) -> Any:
    active, interior = RiccatiActiveSet, RiccatiInteriorPoint
    solvers = (active(), active(fallback=None), interior())
    condensing = pick(rng, (FullCondensing(), NoCondensing()))
    dense = condensing == FullCondensing() and chance(rng, 0.7)
    return condensing, DenseActiveSet() if dense else pick(rng, solvers)
