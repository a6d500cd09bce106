"""Random numbers of closed loops depend only on seed, flight, sample, signal and element, to the last bit."""

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

#: Numbers of the signals in the generator; a campaign draws the constants of a flight from START.
DISTURBANCE, NOISE, START = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Normal:
    """The signal consists of independent normal numbers with mean 0, drawn in every sample.

    Args:
        std: standard deviations of the states, (nx,), one number for all, or {name of a state: number}; 0 for states
            not named.
    """

    std: ArrayLike | Mapping[str, ArrayLike]


@dataclass(frozen=True, eq=False)
class Uniform:
    """The signal consists of independent uniform numbers between -half_width and half_width, drawn in every sample.

    Args:
        half_width: half widths of the states, (nx,), one number for all, or {name of a state: number}; 0 for states not
            named.
    """

    half_width: ArrayLike | Mapping[str, ArrayLike]


Random = Normal | Uniform


@dataclass(frozen=True, eq=False)
class DrawnSignal:
    """A random signal has the sizes of the states (nx,), a distribution, and a number in the generator."""

    size: Array
    uniform: bool
    stream: int


def signal(
    random: Random | ArrayLike | Mapping[str, Any] | None, what: str, names: Sequence[str], stream: int
) -> DrawnSignal | None:
    """Return the random signal that ``random`` states, None for none; bare sizes are standard deviations.

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
    """The generator of all flights can draw the numbers of any flight again."""

    seed: int
    first: int
    nx: int
    disturbance: DrawnSignal | None
    noise: DrawnSignal | None

    def of(self, signal: DrawnSignal | None, i: int, steps: int) -> Array:
        """Return the numbers (steps, nx) of a signal in flight ``i``."""
        out = np.zeros((steps, self.nx))
        if signal is not None:
            draw(signal, self.seed, self.first + i, out)
        return out


def draw(signal: DrawnSignal, seed: int, flight: int, out: Array, begin: int = 0) -> None:
    """Fill ``out`` (samples, nx) with the random numbers of a signal in a flight, from sample ``begin`` on."""
    ffi, lib = load_driver("double")
    random = ffi.new("batch_random_t *")
    random.size = ffi.cast("double *", signal.size.ctypes.data)
    random.uniform, random.stream = signal.uniform, signal.stream
    lib.batch_draw(random, seed, flight, begin, len(out), out.shape[1], ffi.cast("double *", out.ctypes.data))
