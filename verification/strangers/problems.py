"""The strangers, and beside them cases that one QP per sample easily loses."""

from __future__ import annotations

from verification.strangers.arms import ARM, MAGLEV, PENDULUM
from verification.strangers.cases import CAR, DRONE, QUATERNION
from verification.strangers.ground import HOVERCRAFT, SHIP, TRAILER, UNICYCLE
from verification.strangers.plants import FISHING, REACTOR, SEIR, TANKS
from verification.strangers.power import BOOST, HEAT_PUMP, RESERVOIR, STORAGE
from verification.strangers.statement import Stranger

CASES: tuple[Stranger, ...] = (DRONE, CAR, QUATERNION)

STRANGERS: tuple[Stranger, ...] = (
    *(UNICYCLE, HOVERCRAFT, SHIP, TRAILER, PENDULUM, ARM, MAGLEV, REACTOR, TANKS, SEIR, FISHING),
    *(STORAGE, HEAT_PUMP, BOOST, RESERVOIR),
    *CASES,
)


def known(name: str) -> Stranger:
    """The stranger of that name."""
    return next(stranger for stranger in STRANGERS if stranger.name == name)
