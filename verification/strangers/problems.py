"""All strangers are listed here, with cases that one QP per sample easily loses."""

from __future__ import annotations

from verification.strangers.arms import ARM, MAGLEV, PENDULUM
from verification.strangers.cases import CAR, DRONE, QUATERNION
from verification.strangers.ground import HOVERCRAFT, PUCK, SHIP, TRAILER, UNICYCLE
from verification.strangers.once import (
    ACROBOT,
    ARBITRAGE,
    CART_POLE,
    DOUBLE_PENDULUM,
    FREE_TIME,
    GATE,
    ROBOT_ARM,
    STEERING,
    VAN_DER_POL,
    ZERMELO,
)
from verification.strangers.plants import FISHING, REACTOR, SEIR, TANKS
from verification.strangers.power import BOOST, CHARGE, HEAT_PUMP, RESERVOIR, STORAGE
from verification.strangers.statement import Stranger

CASES: tuple[Stranger, ...] = (DRONE, CAR, QUATERNION)

STRANGERS: tuple[Stranger, ...] = (
    *(UNICYCLE, HOVERCRAFT, SHIP, TRAILER, PENDULUM, ARM, MAGLEV, REACTOR, TANKS, SEIR, FISHING),
    *(STORAGE, HEAT_PUMP, BOOST, RESERVOIR, CHARGE, PUCK),
    *CASES,
)

#: Problems that are solved once, each from starts in its box.
ONCE: tuple[Stranger, ...] = (
    *STRANGERS,
    *(CART_POLE, ACROBOT, DOUBLE_PENDULUM, GATE),
    *(STEERING, ROBOT_ARM, VAN_DER_POL, FREE_TIME, ZERMELO, ARBITRAGE),
)

#: Problems of ONCE that users found unsolved.
OPEN: tuple[str, ...] = (*("steering", "robot_arm", "acrobot", "gate", "double_pendulum", "van_der_pol", "arbitrage"),)


def known(name: str) -> Stranger:
    """Return the stranger of that name."""
    return next(stranger for stranger in ONCE if stranger.name == name)
