"""Distributions state what varies from flight to flight; they are evaluated at points of the unit cube."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.batch.random import START, DrawnSignal, Normal, draw

Array = NDArray[np.float64]

#: A random variable belongs to the initial state, to the plant only, to plant and controller, or to references.
Kind = Literal["start", "plant", "known", "reference"]


@dataclass(frozen=True, eq=False)
class Box:
    """A number that is uniform between two limits, or a vector of independent numbers.

    Args:
        lower: finite; a number, or one for each element of the vector.
        upper: as ``lower``, and not below it.
    """

    lower: ArrayLike
    upper: ArrayLike


Distribution = Box | Normal


@dataclass(frozen=True)
class DrawnVariable:
    """A random variable has one value for every flight.

    It is uniform from ``begin`` to begin + size, or normal with mean ``begin`` and standard deviation ``size``,
    truncated to ``low`` and ``high``.
    """

    kind: Kind
    name: str
    begin: float
    size: float
    normal: bool
    low: float = -math.inf
    high: float = math.inf

    @property
    def label(self) -> str:
        """Return the name of the variable in tables and pictures."""
        return f"{self.kind}.{self.name}"

    def quantile(self, p: Array) -> Array:
        """Return the quantile of the variable's distribution at p, 0 < p < 1."""
        if not self.normal:
            return np.asarray(np.clip(self.begin + self.size * p, self.begin, self.begin + self.size))
        if self.size == 0:
            return np.full_like(p, self.begin)
        ends = [float(ndtr((end - self.begin) / self.size)) for end in (self.low, self.high)]
        return np.asarray(
            np.clip(self.begin + self.size * ndtri(ends[0] + (ends[1] - ends[0]) * p), self.low, self.high)
        )


def variables(kind: Kind, names: list[str], found: Distribution, middle: ArrayLike, what: str) -> list[DrawnVariable]:
    """Return independent variables for these elements; a normal one has its mean at ``middle``.

    Raises:
        ControllerError: limits or sizes are wrong.
    """
    count = len(names)
    real = np.dtype(np.float64)
    if isinstance(found, Normal):
        if isinstance(found.std, Mapping):
            sizes = np.zeros(count)
            given.fill_by_name(sizes, found.std, names, what)
        else:
            sizes = given.rows(found.std, what, real, count)[0]
        if (sizes < 0).any():
            raise ControllerError(f"{what} is {sizes.tolist()}; expected standard deviations >= 0")
        begin = np.broadcast_to(np.asarray(middle, float), (count,))
    else:
        begin, end = (given.rows(side, what, real, count)[0] for side in (found.lower, found.upper))
        if (begin > end).any():
            i = int((begin > end).argmax())
            raise ControllerError(f"{what}: Box({begin[i]:g}, {end[i]:g}) of {names[i]!r}; expected lower <= upper")
        sizes = end - begin
    return [
        DrawnVariable(kind, name, float(b), float(s), isinstance(found, Normal))
        for name, b, s in zip(names, begin, sizes, strict=True)
    ]


@dataclass(frozen=True)
class Points:
    """Points lie in the open unit cube, one for each flight: independent ones, or ``sets`` scrambled Sobol sequences.

    A point depends only on (seed, number of the flight); a point of a Sobol sequence also on the length of a set.
    """

    seed: int
    dimensions: int
    sets: int = 0
    length: int = 0  # number of flights of a set

    def at(self, first: int, count: int) -> Array:
        """Return the points (count, dimensions) of the flights from ``first`` on."""
        out = np.zeros((count, self.dimensions))
        if not self.dimensions or not count:
            return out
        if not self.sets:
            draw(DrawnSignal(np.full(self.dimensions, 0.5), True, START), self.seed, 0, out, first)
            return np.asarray(out + 0.5)
        done = 0
        while done < count:
            number, begin = divmod(first + done, self.length)
            some = min(count - done, self.length - begin)
            out[done : done + some] = self._of_set(number, begin, some)
            done += some
        return np.asarray(np.clip(out, 2.0**-53, 1 - 2.0**-53))

    def _of_set(self, number: int, begin: int, count: int) -> Array:
        sequence = qmc.Sobol(self.dimensions, scramble=True, rng=np.random.default_rng([self.seed, number]))
        if begin:
            sequence.fast_forward(begin)
        with warnings.catch_warnings():  # the length of the set is no power of 2
            warnings.simplefilter("ignore", UserWarning)
            return np.asarray(sequence.random(count))
