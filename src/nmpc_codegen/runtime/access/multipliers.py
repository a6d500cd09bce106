"""Multipliers of rows are read and written by name; the C code keeps all of them in one vector, sorted by node.

mu_x (N+1, nx) belongs to bounds of states, mu (N, nh) to general path rows, mu_N (nh_N,) to general terminal rows, eta
to coupled rows. Multipliers are 0 where no row is imposed. Reading returns a read-only copy: assign to the name to
write.
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
    """The map leads from the name of a multiplier to its indices in the vector of a package."""

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
        """Return a read-only copy of the multipliers called ``name``."""
        rows, places = self._places[name]
        values = np.zeros((*mult.shape[:-1], *self.shapes[name]), dtype=mult.dtype)
        values[places] = mult[..., rows]
        values.flags.writeable = False
        return values

    def write(self, name: str, values: Array, mult: Array) -> None:
        """Store the multipliers called ``name`` in the vector.

        Raises:
            ControllerError: a multiplier is not 0 although no row is imposed there.
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
    """Return the positions in the vector and the indices of the array, one list for each of its last dimensions."""
    return [e[0] for e in entries], (..., *([e[i + 1] for e in entries] for i in range(dimensions)))
