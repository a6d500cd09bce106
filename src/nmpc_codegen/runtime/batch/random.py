"""Random numbers of closed loops, whose bits are a function of seed, flight, sample, signal and element alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.batch.driver import load_driver

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
class DrawnSignal:
    """Random numbers of the states: sizes (nx,), kind, number in the generator."""

    size: Array
    uniform: bool
    stream: int


def signal(
    random: Random | ArrayLike | Mapping[str, Any] | None, what: str, names: Sequence[str], stream: int
) -> DrawnSignal | None:
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
    return DrawnSignal(found, uniform, stream)


@dataclass(frozen=True, eq=False)
class Draws:
    """The generator of the flights, which draws the numbers of any of them again."""

    seed: int
    first: int
    nx: int
    disturbance: DrawnSignal | None
    noise: DrawnSignal | None

    def of(self, signal: DrawnSignal | None, i: int, steps: int) -> Array:
        """Numbers (steps, nx) of a signal in flight i."""
        out = np.zeros((steps, self.nx))
        if signal is not None:
            draw(signal, self.seed, self.first + i, out)
        return out


def draw(signal: DrawnSignal, seed: int, flight: int, out: Array, begin: int = 0) -> None:
    """Fill out (samples, nx) with the random numbers of a signal in a flight, from sample ``begin``."""
    ffi, lib = load_driver("double")
    random = ffi.new("batch_random_t *")
    random.size = ffi.cast("double *", signal.size.ctypes.data)
    random.uniform, random.stream = signal.uniform, signal.stream
    lib.batch_draw(random, seed, flight, begin, len(out), out.shape[1], ffi.cast("double *", out.ctypes.data))
