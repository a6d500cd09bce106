"""Look-up tables have data for C, and the same function in NumPy."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

#: Number of hexadecimal digits of a key, which is an integer that a double represents exactly.
_DIGITS = 12

#: Result of a function of a table: the number of the interval of a grid, or an entry.
Part = Literal["interval", "entry"]


@dataclass(frozen=True)
class Lookup:
    """A look-up is a function of one number that is constant between jumps, so that its derivative counts as 0.

    "interval" returns the number i of the interval of a sorted grid ``values`` with values[i] <= x < values[i + 1]; the
    first one for smaller x and for NaN, the last one for larger x. "entry" returns values[i] for an integer i. ``name``
    is the C identifier of the table. With ``kinks``, the slope of the interpolation jumps at the points.
    """

    name: str
    part: Part
    values: tuple[float, ...]
    kinks: bool = False

    @cached_property
    def key(self) -> float:
        """Return an integer that identifies the content of the table."""
        text = repr((self.name, self.part, self.values, self.kinks))
        return float(int(hashlib.sha256(text.encode()).hexdigest()[:_DIGITS], 16))

    @property
    def table(self) -> str:
        """Return the C name of the array."""
        return f"lookup_{self.name}"

    @property
    def function(self) -> str:
        """Return the C name of the function."""
        return f"{self.table}_{self.part}"

    @property
    def passes(self) -> int:
        """Return the number of comparisons of the search, which halves the range until one interval remains."""
        return max(1, (len(self.values) - 2).bit_length()) if self.part == "interval" else 0

    def __call__(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the look-up in NumPy."""
        values = np.array(self.values)
        if self.part == "interval":
            found = np.searchsorted(values, np.nan_to_num(x, nan=-np.inf), side="right") - 1
            return np.asarray(np.clip(found, 0, len(values) - 2), dtype=np.float64)
        return np.asarray(values[np.clip(np.nan_to_num(x), 0, len(values) - 1).astype(np.int64)])
