"""The plan of one controller, or of many, is viewed as NumPy arrays on the members of the C structs.

The axes of the structs come first in every array: no axis for one controller, one axis for a batch.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.package.description import Dimensions
from nmpc_codegen.package.signals import Names
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.access.multipliers import RowMultipliers
from nmpc_codegen.runtime.compiled import CompiledPackage

Array = NDArray[Any]


class Iterate:
    """An iterate is an object that holds structs of a package and views their plan; shapes are those of one struct."""

    def __init__(self, package: CompiledPackage, struct: NDArray[np.void]) -> None:
        self._package = package
        self.description = package.description
        self.dims: Dimensions = self.description.dims
        self.names: Names = self.description.names
        self._real = self.description.real
        self._struct = struct

    @property
    def x(self) -> Array:
        """Return a view on the states of the plan, (N+1, nx)."""
        return self._view("x")[..., : self.dims.nx]

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._assign(self.x, "x", value)

    @property
    def u(self) -> Array:
        """Return a view on the controls of the plan, (N, nu)."""
        return self._view("u")[..., : self.dims.nu]

    @u.setter
    def u(self, value: ArrayLike) -> None:
        self._assign(self.u, "u", value)

    @property
    def lam(self) -> Array:
        """Return a view on the multipliers of initial condition and dynamics, (N+1, nx)."""
        return self._view("lam")[..., : self.dims.nx]

    @lam.setter
    def lam(self, value: ArrayLike) -> None:
        self._assign(self.lam, "lam", value)

    @property
    def mu_x(self) -> Array:
        """Return a copy of the multipliers of state bounds, (N+1, nx); ``ctrl.mu_x = values`` sets them."""
        return self._multipliers("mu_x")

    @mu_x.setter
    def mu_x(self, value: ArrayLike) -> None:
        self._set_multipliers("mu_x", value)

    @property
    def mu_u(self) -> Array:
        """Return a view on the multipliers of control bounds, (N, nu)."""
        return self._view("mu_u")[..., : self.dims.nu]

    @mu_u.setter
    def mu_u(self, value: ArrayLike) -> None:
        self._assign(self.mu_u, "mu_u", value)

    @property
    def mu(self) -> Array:
        """Return a copy of the multipliers of general path rows, (N, nh); ``ctrl.mu = values`` sets them."""
        return self._multipliers("mu")

    @mu.setter
    def mu(self, value: ArrayLike) -> None:
        self._set_multipliers("mu", value)

    @property
    def mu_N(self) -> Array:
        """Return a copy of the multipliers of general terminal rows, (nh_N,); ``ctrl.mu_N = values`` sets them."""
        return self._multipliers("mu_N")

    @mu_N.setter
    def mu_N(self, value: ArrayLike) -> None:
        self._set_multipliers("mu_N", value)

    @property
    def eta(self) -> Array:
        """Return a copy of the multipliers of coupled rows, which may be empty; ``ctrl.eta = values`` sets them."""
        return self._multipliers("eta")

    @eta.setter
    def eta(self, value: ArrayLike) -> None:
        self._set_multipliers("eta", value)

    @property
    def whole_x(self) -> Array:
        """Return a view on all states of the plan, the user's and then the added ones, (N+1, nx + added) (internal)."""
        return self._view("x")

    @property
    def known(self) -> Array:
        """Return a view on the added states of x_0 in the last sample, from which integrate() starts (internal)."""
        last = self._view("xhat") if "xhat" in self.description.members("solver") else self._view("x")[..., 0, :]
        return last[..., self.dims.nx :]

    def view(self, path: str) -> Array:
        """Return a view on any member of the solver struct, in its true shape.

        Args:
            path: its name in the header; dots access inner structs: "qp.g".

        Raises:
            AttributeError: there is no such member.
        """
        return self._view(path)

    def _array(self, what: str, value: ArrayLike, shape: tuple[int, ...], finite: bool = True) -> Array:
        """Return ``value`` as an array of the given shape in the working precision."""
        return given.checked_array(value, what, self._real, shape, finite)

    def _view(self, path: str) -> Array:
        struct, here = "solver", self._struct
        for part in path.split("."):
            member = self.description.members(struct).get(part)
            if member is None and path in self._package.empty:
                return np.zeros((*self._struct.shape, *self._package.empty[path]), dtype=self._real)
            if member is None:
                raise AttributeError(f"the algorithm of {self._package.name} has no {path!r}")
            here, struct = here[part], member.ctype
            true_shape: Any = (..., *(slice(n) for n in member.values))
            here = here[true_shape] if member.shape else here
        return here

    def _multipliers(self, name: str) -> Array:
        return self._row_multipliers.read(name, self._every_multiplier(name))

    def _set_multipliers(self, name: str, value: ArrayLike) -> None:
        every = self._every_multiplier(name)
        self._row_multipliers.write(
            name, self._array(name, value, (*self._struct.shape, *self._row_multipliers.shapes[name])), every
        )

    def _every_multiplier(self, name: str) -> Array:
        """Return the multipliers of all rows in one vector.

        Raises:
            AttributeError: the algorithm keeps none.
        """
        if "mu_u" not in self.description.members("solver"):
            raise AttributeError(f"the algorithm of {self._package.name} has no {name!r}")
        return self.member("mult")

    @cached_property
    def _row_multipliers(self) -> RowMultipliers:
        return RowMultipliers(self.description)

    def member(self, name: str) -> Array:
        """Return a member of the struct, or an empty array if this package has no such member (internal)."""
        try:
            return self._view(name)
        except AttributeError:
            return np.zeros((*self._struct.shape, 0), dtype=self._real)

    def _assign(self, view: Array, name: str, value: ArrayLike) -> None:
        view[...] = self._array(name, value, view.shape)
