"""The quantities of a log: their names, units and bounds."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_unit(name: str, unit: str) -> str:
    """Name and unit for an axis, with powers as superscripts: ``a [m/s²]``."""
    text = re.sub(r"\^(-?\d+)", lambda power: power[1].translate(SUPERSCRIPTS), unit)
    return f"{name} [{text}]" if text else name


#: Array of a log -> its field with the traces of the columns.
COLUMNS = {"x": "states", "u": "controls", "h": "rows", "p": "parameters", "y": "references"}


@dataclass(frozen=True)
class Bound:
    """Bounds of a row at the end of the loop (+-inf: none); ``soft``: they may be violated at a cost."""

    lower: float = -math.inf
    upper: float = math.inf
    soft: bool = False


@dataclass(frozen=True)
class Trace:
    """One quantity of a log; ``signal``: the state or control that a residual is, "" for another expression."""

    name: str
    unit: str = ""
    bounds: tuple[Bound, ...] = ()
    signal: str = ""

    @property
    def lower(self) -> float:
        """The largest lower bound, -inf if there is none."""
        return max((bound.lower for bound in self.bounds), default=-math.inf)

    @property
    def upper(self) -> float:
        """The smallest upper bound, inf if there is none."""
        return min((bound.upper for bound in self.bounds), default=math.inf)

    @property
    def label(self) -> str:
        """Label of its axis."""
        return with_unit(self.name, self.unit)
