"""A value that was chosen, with the reasons for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True)
class Decision(Generic[T_co]):
    """``value``: what has been chosen; ``reasons``: sentences of the report; ``stated``: the options gave the value."""

    value: T_co
    reasons: tuple[str, ...] = ()
    stated: bool = False
