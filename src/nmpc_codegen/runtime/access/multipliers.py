"""Multipliers of rows under the names of what they belong to; the C code keeps them in one vector, sorted by node.

mu_x (N+1, nx): bounds of states; mu (N, nh): general path rows; mu_N (nh_N,): general terminal rows; eta: coupled rows.
They are 0 where no row is imposed. Arrays are read-only, as they are copies: assign to the name to write multipliers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.signals import imposed_rows

Array = NDArray[Any]
Places = tuple[list[int], Any]


class RowMultipliers:
    """Where the vector of a package keeps the multipliers of every name."""

    def __init__(self, description: PackageDescription) -> None:
        d, rows = description.dims, description.rows
        coupled = sum(row.is_coupled for row in rows)
        self.shapes = {"mu_x": (d.N + 1, d.nx), "mu": (d.N, d.nh), "mu_N": (d.nh_N,), "eta": (coupled,)}
        found: dict[str, list[tuple[int, ...]]] = {name: [] for name in self.shapes}
        for m, (k, kind, index, _) in enumerate(imposed_rows(rows, d.N)):
            name = ("mu_x", "mu" if k < d.N else "mu_N", "eta")[kind]
            found[name].append((m, k, index) if len(self.shapes[name]) == 2 else (m, index))
        self._places: dict[str, Places] = {name: _columns(of, len(self.shapes[name])) for name, of in found.items()}

    def read(self, name: str, mult: Array) -> Array:
        """The multipliers of this name, a read-only copy."""
        rows, places = self._places[name]
        values = np.zeros((*mult.shape[:-1], *self.shapes[name]), dtype=mult.dtype)
        values[places] = mult[..., rows]
        values.flags.writeable = False
        return values

    def write(self, name: str, values: Array, mult: Array) -> None:
        """Store multipliers of this name.

        Raises:
            ControllerError: one is not 0 where no row is imposed.
        """
        rows, places = self._places[name]
        rest = values.copy()
        rest[places] = 0.0
        if np.any(rest):
            place = tuple(int(i) for i in np.argwhere(rest)[0])
            at = ", ".join(map(str, place))
            raise ControllerError(f"{name}[{at}] is {rest[place]:g}; expected 0, as no row is imposed there")
        mult[..., rows] = values[places]


def _columns(entries: list[tuple[int, ...]], dimensions: int) -> Places:
    """Positions in the vector, and indices of the array behind the axes of the structs, dimension by dimension."""
    return [e[0] for e in entries], (..., *([e[i + 1] for e in entries] for i in range(dimensions)))
