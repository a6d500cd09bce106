"""Estimators are compared with two references on plants whose states are not measured.

The references are a Kalman filter in covariance form, and IPOPT's estimate from all measurements since the beginning.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from nmpc_codegen import OCP, Controller, Estimator, Log, simulate
from nmpc_codegen.frontend.estimator.window import estimation_problem
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import node_data
from nmpc_codegen.runtime.estimation.observer import Observer

Array = NDArray[np.float64]

#: Steps of RK4 in an interval of a plant.
FINE = 20


@dataclass(frozen=True)
class Plant:
    """A plant is a model with its measurements, its motion, and the initial guess of an estimator.

    ``make``: the OCP and the statement of its estimator; ``truth``, ``guess`` (nx,): true initial state and initial
    guess, ``spread`` (nx,): standard deviations of the true one; ``doubt`` (nx,): declared standard deviations of the
    guess; ``controls``: k -> (nu,); ``scale`` (nx,): errors that count as 1; ``low``, ``high`` (nx,): limits of the
    states of the plant; ``silent``: samples without measurements.
    """

    make: Callable[[], tuple[OCP, Mapping[str, Any]]]
    truth: tuple[float, ...]
    spread: tuple[float, ...]
    guess: tuple[float, ...]
    doubt: tuple[float, ...]
    scale: tuple[float, ...]
    samples: int
    N: int
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    controls: Callable[[int], tuple[float, ...]] = lambda k: ()
    silent: Callable[[int], bool] = lambda k: False

    def estimator(self, **changes: Any) -> Estimator:
        """Return an estimator of the plant."""
        ocp, statement = self.make()
        return Estimator(ocp, **{"N": self.N, **statement, **changes})

    def begin(self, observer: Observer) -> None:
        """Reset an estimator to the guess."""
        observer.reset(self.guess, np.diag(np.square(self.doubt)))


def reactor() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of A <-> B + C, 2 B <-> C in a batch whose pressure is measured.

    An extended Kalman filter finds negative concentrations (Haseltine and Rawlings, Industrial and Engineering
    Chemistry Research 44, 2005).
    """
    ocp = OCP("reactor", T=5.0, N=20, time_unit="min")
    a, b, c = (ocp.state(name, unit="mol/l", scale=1.0) for name in ("c_A", "c_B", "c_C"))
    first, second = 0.5 * a - 0.05 * b * c, 0.2 * b * b - 0.01 * c
    ocp.dynamics({a: -first, b: first - 2 * second, c: first + second})
    for state in (a, b, c):
        ocp.subject_to(0, state, ca.inf)
    noise = {a: 1e-3, b: 1e-3, c: 1e-3}
    return ocp, {"measure": {"P": 32.84 * (a + b + c)}, "noise_std": {"P": 0.25}, "process_std": noise}


def vehicle() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of position, heading, gyroscope bias and wheel slip of a vehicle.

    A receiver gives the position at every other sample, and not between samples 60 and 85.
    """
    ocp = OCP("vehicle", T=2.0, N=20)
    x, y = ocp.state("x", unit="m", scale=10.0), ocp.state("y", unit="m", scale=10.0)
    heading, bias = ocp.state("heading", unit="rad", scale=1.0), ocp.state("bias", unit="rad/s", scale=0.1)
    slip, v, w = ocp.state("slip", scale=0.1), ocp.control("v", unit="m/s"), ocp.control("w", unit="rad/s")
    speed = v * (1 + slip)
    ocp.dynamics({x: speed * ca.cos(heading), y: speed * ca.sin(heading), heading: w + bias, bias: 0, slip: 0})
    statement = {
        "measure": {"position": ca.vertcat(x, y)},
        "noise_std": {"position": 0.5},
        "process_std": {heading: 0.002, bias: 0.001, slip: 0.001},
        "input_std": {v: 0.1, w: 0.02},
    }
    return ocp, statement


def battery() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of a cell with a flat open-circuit voltage and a current sensor with an offset."""
    ocp = OCP("battery", T=200.0, N=20)
    soc, v = ocp.state("soc", scale=0.5), ocp.state("v", unit="V", scale=0.05)
    offset, i = ocp.state("offset", unit="A", scale=0.5), ocp.control("i", unit="A")
    current, ocv = i + offset, 3.3 - 0.3 * ca.exp(-25 * soc) + 0.06 * soc + 0.25 * ca.exp(-20 * (1 - soc))
    ocp.dynamics({soc: -current / 8280, v: current / 2000 - v / 40, offset: 0})
    ocp.subject_to(0, soc, 1)
    noise = {soc: 1e-4, v: 5e-4, offset: 1e-3}
    return ocp, {"measure": {"V": ocv - v - 0.03 * current}, "noise_std": {"V": 0.004}, "process_std": noise}


def _load(k: int) -> tuple[float, ...]:
    """Return a current (A) that charges and discharges in turn, and discharges more."""
    return (2.3 * float(np.sign(np.sin(0.07 * k))) * (1 + 0.5 * np.sin(0.31 * k)) + 0.8,)


PLANTS: dict[str, Plant] = {
    "reactor": Plant(
        make=reactor,
        truth=(0.5, 0.05, 0.0),
        spread=(0.02, 0.02, 0.02),
        guess=(0.0, 0.0, 4.0),
        doubt=(1.0, 1.0, 1.0),
        scale=(0.5, 0.5, 0.5),
        samples=120,
        N=20,
        low=(0.0, 0.0, 0.0),
    ),
    "vehicle": Plant(
        make=vehicle,
        truth=(0.0, 0.0, 2.5, 0.08, -0.08),
        spread=(0.2, 0.2, 0.4, 0.02, 0.02),
        guess=(0.0, 0.0, 0.7, 0.0, 0.0),
        doubt=(1.0, 1.0, 2.0, 0.1, 0.1),
        scale=(1.0, 1.0, 0.2, 0.05, 0.05),
        samples=150,
        N=20,
        controls=lambda k: (5 + 2 * float(np.sin(0.05 * k)), 0.5 * float(np.sin(0.1 * k))),
        silent=lambda k: k % 2 == 1 or 60 <= k < 85,
    ),
    "battery": Plant(
        make=battery,
        truth=(0.95, 0.0, 0.1),
        spread=(0.01, 0.002, 0.03),
        guess=(0.5, 0.0, 0.0),
        doubt=(0.4, 0.02, 0.15),
        scale=(0.1, 0.02, 0.1),
        samples=240,
        N=20,
        low=(0.0, -np.inf, -np.inf),
        high=(1.0, np.inf, np.inf),
        controls=_load,
    ),
}


@dataclass(frozen=True)
class Run:
    """A run has states (n, nx), measurements (n, ny), where NaN is missing, and controls (n, nu) after every sample."""

    x: Array
    y: Array
    u: Array


def _inside(plant: Plant, x: Array) -> Array:
    return np.clip(x, plant.low or -np.inf, plant.high or np.inf)


def run(plant: Plant, rng: np.random.Generator, missing: float = 0.0, outliers: float = 0.0) -> Run:
    """Draw a run of the plant with the noise that its estimator expects.

    ``missing``, ``outliers``: probabilities of missing measurements and of outliers by 20 to 60 standard deviations.
    """
    model = Model(plant)
    std, nx = model.noise, len(plant.truth)
    x = _inside(plant, np.array(plant.truth) + plant.spread * rng.standard_normal(nx))
    before = np.array(plant.controls(0))
    states, measured, controls = [], [], []
    for k in range(plant.samples):
        y = model.measure(x, before) + std * rng.standard_normal(std.size)
        far = rng.choice([-1, 1], std.size) * rng.uniform(20, 60, std.size) * std
        y = np.where(rng.uniform(size=std.size) < outliers, y + far, y)
        y = np.where((rng.uniform(size=std.size) < missing) | plant.silent(k), np.nan, y)
        u = np.array(plant.controls(k))
        states.append(x)
        measured.append(y)
        controls.append(u)
        x = _inside(plant, model.move(x, u, rng))
        before = u
    return Run(np.array(states), np.array(measured), np.array(controls))


class Model:
    """The model has the measurements and the noise of a plant in CasADi."""

    def __init__(self, plant: Plant) -> None:
        ocp, statement = plant.make()
        unknown = [d for d in ocp.parameters if d.signal.name in statement.get("process_std", {})]
        x = ca.vertcat(ocp.x, *(d.symbol for d in unknown))
        inputs = [x, ocp.u]
        f = ca.vertcat(*(ocp.derivatives.get(i, 0) for i in range(x.numel())))
        self._f = ca.Function("f", inputs, [ca.densify(f)])
        self._h = ca.Function("h", inputs, [ca.vertcat(*statement["measure"].values())])
        self.noise = np.concatenate([np.atleast_1d(std) for std in statement["noise_std"].values()])
        if self.noise.size < self._h.size1_out(0):
            self.noise = np.full(self._h.size1_out(0), self.noise[0])
        self.of_state, self.of_input = np.zeros(x.numel()), np.zeros(ocp.u.numel())
        moved = [e for d in (*ocp.states, *unknown) for e in d.signal.elements]
        acting = [e for d in ocp.controls for e in d.signal.elements]
        for of, word in ((self.of_state, "process_std"), (self.of_input, "input_std")):
            for key, std in statement.get(word, {}).items():
                of[(acting if word == "input_std" else moved).index(str(key))] = std
        self.dt = 1.0 if ocp.dt is None else ocp.dt[0]

    def measure(self, x: Array, before: Array) -> Array:
        """Return measurements of sensors without noise."""
        return np.array(self._h(x, before)).ravel()

    def move(self, x: Array, u: Array, rng: np.random.Generator) -> Array:
        """Return the state at the next sample, with noise."""
        u, h = u + self.of_input * rng.standard_normal(u.size), self.dt / FINE
        for _ in range(FINE):
            a = np.array(self._f(x, u)).ravel()
            b = np.array(self._f(x + h / 2 * a, u)).ravel()
            c = np.array(self._f(x + h / 2 * b, u)).ravel()
            d = np.array(self._f(x + h * c, u)).ravel()
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
        return x + self.of_state * rng.standard_normal(x.size)


def estimate(observer: Observer, found: Run) -> tuple[Array, list[int], list[int]]:
    """Return estimates (n, nx), statuses and times in ns of a run."""
    estimates, statuses, times = [], [], []
    for k, y in enumerate(found.y):
        u = found.u[max(k - 1, 0)]
        estimates.append(observer.step(y, u if u.size else None))
        statuses.append(int(observer.status))
        times.append(observer.time_ns)
    return np.array(estimates), statuses, times


def full_information(plant: Plant, found: Run, k: int) -> Array:
    """Return IPOPT's estimate (nx,) at sample k >= 1 from all measurements up to sample k."""
    problem = believing(estimation_problem(plant.estimator(N=k)), plant)
    data = node_data(problem, x0=np.array(plant.guess), p=window_data(problem, found, 0, k))
    return np.array(Reference(problem, tol=1e-9).solve(data, x=found.x[: k + 1], u=np.zeros((k, problem.nu))).x[-1])


def believing(problem: Problem, plant: Plant) -> Problem:
    """Return the problem with the guess of the plant as arrival cost of x_0."""
    start = replace(problem.start, reference=np.array(plant.guess), weight=np.diag(np.square(plant.doubt) ** -1.0))
    return replace(problem, start=start)


def window_data(problem: Problem, found: Run, first: int, last: int) -> Array:
    """Return parameters (N + 1, np) of the nodes of a window: controls, controls before, measurements, accuracy."""
    e = problem.estimation
    assert e is not None
    rows = np.tile(problem.p_value, (last - first + 1, 1))
    at_u, at_before, at_y, at_accuracy = e.places
    for row, k in zip(rows, range(first, last + 1), strict=True):
        y = found.y[k]
        row[at_u : at_u + e.nu] = found.u[k]
        if e.before:
            row[at_before : at_before + e.nu] = found.u[max(k - 1, 0)]
        row[at_y : at_y + e.ny] = np.nan_to_num(y)
        row[at_accuracy : at_accuracy + e.ny] = np.where(np.isnan(y), 0.0, 1 / np.array(e.noise_std))
    return rows


@dataclass(frozen=True)
class Linear:
    """x_{k+1} = A x_k + B u_k + w_k, y_k = H x_k + v_k with covariances Q of w and R of v."""

    A: Array
    B: Array
    H: Array
    Q: Array
    R: Array

    def filter(self, x: Array, P: Array, y: Array, u: Array) -> list[tuple[Array, Array]]:
        """Return estimates and covariances of the Kalman filter, where NaN is a missing measurement."""
        found = []
        for k, values in enumerate(y):
            if k:
                x, P = self.A @ x + self.B @ u[k - 1], self.A @ P @ self.A.T + self.Q
            there = np.isfinite(values)
            H, R = self.H[there], self.R[np.ix_(there, there)]
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x, P = x + gain @ (values[there] - H @ x), (np.eye(len(x)) - gain @ H) @ P
            found.append((x, P))
        return found

    def run(self, x: Array, u: Array, rng: np.random.Generator) -> Array:
        """Return measurements (n, ny) of a run that begins at x, with the noise of the model."""
        found = []
        for control in u:
            found.append(self.H @ x + rng.multivariate_normal(np.zeros(len(self.R)), self.R))
            x = self.A @ x + self.B @ control + rng.multivariate_normal(np.zeros(len(self.Q)), self.Q)
        return np.array(found)


# -- with controllers -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Loop:
    """A loop has a controller and an estimator of one plant: their OCP and the statement of the estimator.

    It also states the start of the plant, its references over the samples, its true parameters, and the noise of its
    states. ``followed``: {state: error at the end that is too large}.
    """

    make: Callable[[], tuple[OCP, Mapping[str, Any]]]
    x0: tuple[float, ...]
    spread: tuple[float, ...]
    references: Mapping[str, Array]
    noise: tuple[float, ...]
    followed: Mapping[str, float]
    parameters: Mapping[str, Array] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        return len(next(iter(self.references.values())))

    def run(self, ctrl: Controller, observer: Observer, seed: int) -> tuple[Log, bool]:
        """Run a loop with noise.

        Return whether it was lost: an error at the end is too large, or a state is not finite.
        """
        ctrl.reset()
        observer.reset()
        rng = np.random.default_rng([7, seed])
        x0 = np.array(self.x0) + np.array(self.spread) * rng.standard_normal(len(self.x0))
        given: dict[str, Any] = {"references": self.references, "parameters": self.parameters or None}

        def disturb(k: int, x: Array) -> Array:
            return np.array(self.noise) * rng.standard_normal(x.size)

        log = simulate(ctrl, x0, self.samples, disturbance=disturb, estimator=observer, seed=seed, **given)
        places = {name: ctrl.names.states.index(name) for name in self.followed}
        errors = {n: np.abs(log.x[-10:, i] - self.references[n][-10:]) for n, i in places.items()}
        lost = any(np.max(errors[name]) > most for name, most in self.followed.items())
        return log, lost or not np.all(np.isfinite(log.x))


def vehicle_on_a_circle() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of the vehicle that follows positions along a circle."""
    ocp, statement = vehicle()
    ocp.least_squares(ca.vertcat(ocp.x[:2], ocp.u), weight=[1, 1, 0.1, 0.5], reference=[0, 0, 3, 0.3], names=_FOLLOWED)
    ocp.terminal_least_squares(ocp.x[:2], weight=5, names=_FOLLOWED[:2])
    ocp.subject_to([0, -1], ocp.u, [6, 1])
    return ocp, {**statement, "initial_std": {"x": 1, "y": 1, "heading": 0.5, "bias": 0.1, "slip": 0.1}}


_FOLLOWED = ["x", "y", "v", "w"]


def charging() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of the cell that is charged to 80 % with at most 6 A."""
    ocp, statement = battery()
    ocp.least_squares(ca.vertcat(ocp.x[0], ocp.u), weight=[100, 0.01], names=["soc", "i"])
    ocp.terminal_least_squares(ocp.x[0], weight=1e3, names=["soc"])
    ocp.subject_to(-6, ocp.u, 1)
    return ocp, {**statement, "initial_std": {"soc": 0.3, "v": 0.02, "offset": 0.15}}


def heating() -> tuple[OCP, Mapping[str, Any]]:
    """Return the OCP of an oven with unknown losses: the temperature of the air is measured, not that of the heater."""
    ocp = OCP("oven", T=600.0, N=20)
    T, h = ocp.state("T", unit="K", initial=300.0), ocp.state("h", unit="K", initial=300.0)
    P, loss = ocp.control("P", unit="kW"), ocp.parameter("loss", value=0.02, unit="kW/K")
    ocp.dynamics({h: (P - 0.1 * (h - T)) / 3, T: (0.1 * (h - T) - loss * (T - 290)) / 8})
    ocp.least_squares(ca.vertcat(T, ocp.rate(P)), weight=[1, 1e3], names=["T", "rate"])
    ocp.subject_to(0, P, 10)
    ocp.subject_to(0, h, 900)
    noise = {"noise_std": {"T": 0.5}, "process_std": {"h": 0.5, "loss": 2e-4}}
    return ocp, {"measure": {"T": T}, **noise, "initial_std": {"T": 2, "h": 5, "loss": 0.01}}


def _circle(samples: int) -> dict[str, Array]:
    angle = 0.03 * np.arange(samples)
    return {"x": 10 * np.sin(angle), "y": 10 - 10 * np.cos(angle)}


LOOPS: dict[str, Loop] = {
    "vehicle": Loop(
        make=vehicle_on_a_circle,
        x0=(0.0, 0.0, 0.2, 0.05, -0.05),
        spread=(0.5, 0.5, 0.2, 0.03, 0.03),
        references=_circle(250),
        noise=(0.005, 0.005, 0.002, 0.001, 0.001),
        followed={"x": 2.0, "y": 2.0},
    ),
    "battery": Loop(
        make=charging,
        x0=(0.3, 0.0, 0.1),
        spread=(0.1, 0.005, 0.05),
        references={"soc": np.full(360, 0.8)},
        noise=(1e-5, 5e-4, 1e-3),
        followed={"soc": 0.05},
    ),
    "oven": Loop(
        make=heating,
        x0=(300.0, 300.0),
        spread=(2.0, 2.0),
        references={"T": np.where(np.arange(150) < 75, 380.0, 350.0)},
        noise=(0.0, 0.5),
        followed={"T": 4.0},
        parameters={"loss": np.where(np.arange(150) < 50, 0.03, 0.025)},
    ),
}
