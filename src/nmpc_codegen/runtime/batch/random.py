"""Random disturbances and measurement noise, whose bits are a function of seed, flight, sample and state alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime import given

Array = NDArray[np.float64]

#: Numbers of the signals in the generator; START: what a campaign draws for a flight as a whole.
DISTURBANCE, NOISE, START = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Normal:
    """Independent normal numbers of mean 0 in every sample.

    Args:
        std: standard deviations of the states, (nx,), a number for all, or {name of a state: number}; others have none.
    """

    std: ArrayLike | Mapping[str, ArrayLike]


@dataclass(frozen=True, eq=False)
class Uniform:
    """Independent uniform numbers between -half_width and half_width in every sample.

    Args:
        half_width: of the states, (nx,), a number for all, or {name of a state: number}; others have none.
    """

    half_width: ArrayLike | Mapping[str, ArrayLike]


Random = Normal | Uniform


@dataclass(frozen=True, eq=False)
class Signal:
    """Random numbers of the states: sizes (nx,), kind, number in the generator."""

    size: Array
    uniform: bool
    stream: int


def signal(
    random: Random | ArrayLike | Mapping[str, Any] | None, what: str, names: Sequence[str], stream: int
) -> Signal | None:
    """What is drawn, if anything; sizes alone are standard deviations.

    Raises:
        ControllerError: a size is negative or not finite, or there is no such state.
    """
    if random is None:
        return None
    uniform = isinstance(random, Uniform)
    size: Any = random.half_width if isinstance(random, Uniform) else random
    size = size.std if isinstance(size, Normal) else size
    found = np.zeros(len(names))
    if isinstance(size, Mapping):
        given.fill_by_name(found, size, names, what)
    else:
        found[:] = given.rows(size, what, found.dtype, len(names))[0]
    if (found < 0).any():
        raise ControllerError(f"{what} is {found.tolist()}; expected sizes >= 0")
    return Signal(found, uniform, stream)
