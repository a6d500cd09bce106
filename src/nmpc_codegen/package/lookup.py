"""Look-up tables: what C reads of them, and the same in NumPy."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

#: Hexadecimal digits of a key: a whole number that a double holds.
_DIGITS = 12

#: What a function of a table returns: the number of the interval of a grid, or an entry.
Part = Literal["interval", "entry"]


@dataclass(frozen=True)
class Lookup:
    """A function of one number that is constant between jumps, so that its derivative counts as 0.

    "interval": the number i of the interval of a sorted grid ``values`` with values[i] <= x < values[i + 1]; the first
    one for smaller x and for NaN, the last one for larger x. "entry": values[i] for a whole number i.

    ``name``: C identifier of the table. ``kinks``: the slope of what is made of it jumps at its points.
    """

    name: str
    part: Part
    values: tuple[float, ...]
    kinks: bool = False

    @cached_property
    def key(self) -> float:
        """A whole number that stands for its content."""
        text = repr((self.name, self.part, self.values, self.kinks))
        return float(int(hashlib.sha256(text.encode()).hexdigest()[:_DIGITS], 16))

    @property
    def table(self) -> str:
        """C name of the array."""
        return f"lookup_{self.name}"

    @property
    def function(self) -> str:
        """C name of the function."""
        return f"{self.table}_{self.part}"

    @property
    def passes(self) -> int:
        """Comparisons of the search: it halves the intervals until one is left."""
        return max(1, (len(self.values) - 2).bit_length()) if self.part == "interval" else 0

    def __call__(self, x: NDArray[Any]) -> NDArray[Any]:
        """Its values in NumPy."""
        values = np.array(self.values)
        if self.part == "interval":
            found = np.searchsorted(values, np.nan_to_num(x, nan=-np.inf), side="right") - 1
            return np.asarray(np.clip(found, 0, len(values) - 2), dtype=np.float64)
        return np.asarray(values[np.clip(np.nan_to_num(x), 0, len(values) - 1).astype(np.int64)])
