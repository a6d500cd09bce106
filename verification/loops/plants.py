"""The draws have these plants: five with actuators whose slope vanishes, unstable plants and products of controls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from verification.loops.draw import Drawn, Plant

Law = Callable[[ca.SX], ca.SX]
#: Name -> (force, lower bound): the force of a control in [0, 1] or [-1, 1] reaches 1, and its slope vanishes
#: somewhere.
LAWS: dict[str, tuple[Law, float]] = {
    "square": (lambda u: u**2, 0.0),
    "signed_square": (lambda u: u * ca.fabs(u), -1.0),
    "cube": (lambda u: u**3, -1.0),
    "tanh": (lambda u: ca.tanh(3 * u), -1.0),
    "one_sided": (lambda u: ca.log(1 + ca.exp(20 * (u - 0.3))) / 14, 0.0),
    "smooth_step": (lambda u: u**2 * (3 - 2 * u), 0.0),
}
#: Fraction of its range at which a control is in the first plan.
FIRST = 0.1
PROBLEMS, LOOPS = 30, 5


@dataclass(frozen=True)
class _Actuator:
    """An actuator has a force law, bounds, a size of the state, a time constant, and the least set point in sizes."""

    law: str
    force: Law
    bounds: tuple[float, float]
    size: float
    tau: float
    low: float


def _actuator(law: str, random: np.random.Generator) -> _Actuator:
    """Draw an actuator with random units and time constants."""
    force, lower = LAWS[law]
    size, tau, top = (10.0 ** random.uniform(*powers) for powers in ((-2, 3), (-1, 2), (-1, 4)))
    return _Actuator(law, lambda u: force(u / top), (lower * top, top), size, tau, -0.4 if lower < 0 else 0.15)


def _speed(a: _Actuator) -> Plant:
    """Return a mass with friction."""
    size, tau = a.size, a.tau
    return Plant(
        f"speed_{a.law}",
        ("v",),
        {"u": a.bounds},
        lambda x, u: [(1.5 * size * a.force(u) - x) / tau],
        2 * tau,
        ((0.1 * size, 0.4 * size),),
        ((a.low * size, 0.8 * size),),
        (0,),
        (size,),
    )


def _heater(a: _Actuator) -> Plant:
    """Return a heater behind a wall."""
    size, tau = a.size, a.tau
    return Plant(
        f"heater_{a.law}",
        ("T", "wall"),
        {"u": a.bounds},
        lambda x, u: [
            (2 * size * a.force(u) - (x[0] - x[1]) - 0.5 * x[0]) / tau,
            (x[0] - 2 * x[1]) / (3 * tau),
        ],
        6 * tau,
        ((0.1 * size, 0.3 * size), (0.05 * size, 0.15 * size)),
        ((a.low * size, 0.8 * size),),
        (0,),
        (size, size),
        {"T": (-1.2 * size, 1.2 * size)},
    )


def _tanks(a: _Actuator) -> Plant:
    """Return two tanks in a row."""
    size, tau = a.size, a.tau
    return Plant(
        f"tanks_{a.law}",
        ("h", "l"),
        {"u": a.bounds},
        lambda x, u: [
            (1.2 * size * a.force(u) - x[0] * ca.sqrt(1 + (x[0] / size) ** 2)) / tau,
            (x[0] - x[1]) / tau,
        ],
        6 * tau,
        ((0.1 * size, 0.3 * size), (0.1 * size, 0.3 * size)),
        ((max(a.low, -0.3) * size, 0.5 * size),),
        (1,),
        (size, size),
    )


def _boat(a: _Actuator) -> Plant:
    """Return a boat that two actuators turn and drive."""
    size, tau = a.size, a.tau
    return Plant(
        f"boat_{a.law}",
        ("psi", "r", "v"),
        {"a": a.bounds, "b": a.bounds},
        lambda x, u: [
            x[1] / tau,
            (2 * (a.force(u[0]) - a.force(u[1])) - x[1]) / tau,
            (size * (a.force(u[0]) + a.force(u[1])) - x[2]) / tau,
        ],
        4 * tau,
        ((-0.3, 0.3), (0.0, 0.0), (0.3 * size, 0.6 * size)),
        ((-0.6, 0.6), (0.4 * size, 0.9 * size)),
        (0, 2),
        (1.0, 1.0, size),
    )


def _lifted(a: _Actuator) -> Plant:
    """Return a pendulum that a fan lifts."""
    tau = a.tau
    return Plant(
        f"lifted_{a.law}",
        ("angle", "rate"),
        {"u": a.bounds},
        lambda x, u: [x[1] / tau, (3 * a.force(u) - 2 * ca.sin(x[0]) - 0.6 * x[1]) / tau],
        5 * tau,
        ((0.1, 0.4), (0.0, 0.0)),
        ((0.5 * a.low, 0.7),),
        (0,),
        (1.0, 1.0),
        {"angle": (-1.5, 1.5)},
    )


def lost_slope() -> list[Drawn]:
    """Draw five plants with six actuators; weights over four decades."""
    found, kinds = [], (_speed, _heater, _tanks, _boat, _lifted)
    for number, law in enumerate([law for law in LAWS for _ in range(5)]):
        random = np.random.default_rng([7, number])
        plant = kinds[number % len(kinds)](_actuator(law, random))
        found.append(Drawn(plant, 10.0 ** random.uniform(-4, 0), FIRST, number))
    return found


def dead_points() -> list[Drawn]:
    """Draw the same plants with controls at 0 in the first plan, where most slopes vanish."""
    found = []
    for drawn in lost_slope():
        lower, upper = next(iter(drawn.plant.controls.values()))
        found.append(replace(drawn, first=-lower / (upper - lower)))
    return found


def _reactor(random: np.random.Generator) -> Plant:
    """Return the exothermic stirred tank at its unstable steady state, controlled by the coolant."""
    k0, heat = 7.2e10 * 10 ** random.uniform(-0.02, 0.02), random.uniform(205, 212)

    def k(T: ca.SX) -> ca.SX:
        return k0 * ca.exp(-8750 / T)

    return Plant(
        "reactor",
        ("c", "T"),
        {"Tc": (280.0, 370.0)},
        lambda x, u: [1 - x[0] - k(x[1]) * x[0], 350 - x[1] + heat * k(x[1]) * x[0] + 2.092 * (u - x[1])],
        3.0,
        ((0.45, 0.7), (330.0, 352.0)),
        ((0.4, 0.6),),
        (0,),
        (0.2, 20.0),
        {"T": (300.0, 390.0)},
    )


def _chemostat(random: np.random.Generator, economic: bool) -> Plant:
    """Return biomass and substrate with inhibition, controlled by dilution; the biomass may wash out."""
    top, inhibition = random.uniform(0.45, 0.55), random.uniform(15, 30)

    def mu(S: ca.SX) -> ca.SX:
        return top * S / (1.2 + S + S**2 / inhibition)

    feed, whole = random.uniform(15, 25), random.uniform(0.35, 0.45)
    return Plant(
        "chemostat_economic" if economic else "chemostat",
        ("X", "S"),
        {"D": (0.0, 0.6)},
        lambda x, u: [(mu(x[1]) - u) * x[0], u * (feed - x[1]) - mu(x[1]) * x[0] / whole],
        20.0,
        ((3.0, 6.0), (2.0, 8.0)),
        ((4.0, 6.5),),
        (0,),
        (5.0, 10.0),
        {"X": (0.5, 30.0)},
        (lambda x, u: -u[0] * x[0] + 0.05 * (u[0] - 0.2) ** 2) if economic else None,
    )


def _levitation(random: np.random.Generator) -> Plant:
    """Return a ball below a magnet, whose force falls with the gap squared and grows with the current squared."""
    g, c = 9.81, random.uniform(0.8, 1.3) * 9.81e-4
    return Plant(
        "levitation",
        ("z", "v"),
        {"i": (0.0, 3.0)},
        lambda x, u: [x[1], g - c * u**2 / (x[0] + 0.002) ** 2],
        0.3,
        ((0.008, 0.014), (0.0, 0.0)),
        ((0.006, 0.014),),
        (0,),
        (0.01, 0.3),
        {"z": (0.002, 0.025)},
    )


def _pendulum(random: np.random.Generator) -> Plant:
    """Return an upright pendulum with a torque that is too weak to hold it everywhere."""
    length, friction = random.uniform(0.5, 2), random.uniform(0.05, 0.4)
    return Plant(
        "pendulum",
        ("angle", "rate"),
        {"M": (-4.0, 4.0)},
        lambda x, u: [x[1], 9.81 / length * ca.sin(x[0]) + u / length - friction * x[1]],
        1.0,
        ((-0.25, 0.25), (-0.3, 0.3)),
        ((-0.2, 0.2),),
        (0,),
        (0.5, 2.0),
    )


def _blending(random: np.random.Generator) -> Plant:
    """Return a tank with two feeds, controlled in level and concentration."""
    a, b, area = random.uniform(0.7, 0.95), random.uniform(0.02, 0.2), random.uniform(0.5, 3)
    return Plant(
        "blending",
        ("h", "c"),
        {"strong": (0.0, 2.0), "weak": (0.0, 2.0)},
        lambda x, u: [
            (u[0] + u[1] - ca.sqrt(x[0] + 0.01)) / area,
            (u[0] * (a - x[1]) + u[1] * (b - x[1])) / (area * x[0] + 0.05),
        ],
        6.0 * area,
        ((0.5, 1.5), (0.3, 0.6)),
        ((0.4, 1.8), (0.25, 0.65)),
        (0, 1),
        (1.0, 0.3),
        {"h": (0.1, 3.0)},
    )


def _heating(random: np.random.Generator) -> Plant:
    """Return a room that is heated by flow times supply temperature."""
    loss, mass = random.uniform(0.05, 0.2), random.uniform(10, 40)
    return Plant(
        "heating",
        ("T", "wall"),
        {"flow": (0.1, 2.0), "supply": (12.0, 45.0)},
        lambda x, u: [
            (u[0] * (u[1] - x[0]) + loss * (5 - x[0])) / mass,
            (0.3 * (x[0] - x[1]) + 0.05 * (5 - x[1])) / 60,
        ],
        120.0,
        ((14.0, 18.0), (12.0, 16.0)),
        ((16.0, 24.0),),
        (0,),
        (5.0, 5.0),
    )


def _mixing_power(random: np.random.Generator) -> Plant:
    """Return a motor whose torque is a product of field and armature currents."""
    load, tau = random.uniform(0.1, 0.5), 10 ** random.uniform(-1, 1)
    return Plant(
        "motor",
        ("w", "angle"),
        {"field": (0.1, 1.0), "armature": (-1.0, 1.0)},
        lambda x, u: [(4 * u[0] * u[1] - load * x[0]) / tau, x[0] / tau],
        4.0 * tau,
        ((-0.2, 0.2), (-0.2, 0.2)),
        ((-1.0, 1.0),),
        (1,),
        (1.0, 1.0),
        {"w": (-2.0, 2.0)},
    )


def unstable() -> list[Drawn]:
    """Draw unstable plants and products of controls, tracking and economic; weights over three decades."""
    makers: list[Callable[[np.random.Generator], Plant]] = [
        _reactor,
        _levitation,
        _pendulum,
        _blending,
        _heating,
        _mixing_power,
        lambda random: _chemostat(random, False),
        lambda random: _chemostat(random, True),
    ]
    found = []
    for number in range(PROBLEMS):
        random = np.random.default_rng([11, number])
        plant = makers[number % len(makers)](random)
        found.append(Drawn(plant, 10.0 ** random.uniform(-3, 0), random.uniform(0.1, 0.5), 100 + number))
    return found


#: The draws by name: each returns problems, of which LOOPS are simulated.
DRAWS: dict[str, Callable[[], list[Drawn]]] = {
    "lost slope": lost_slope,
    "dead points": dead_points,
    "unstable": unstable,
}
