"""Values of the general path rows h(x, u, p) along a closed loop, computed by the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.runtime.controller import Controller

Array = NDArray[Any]


class PathRows:
    """The general path rows that apply in a closed loop, and their values h(x, u, p_0).

    A second controller linearises at x and u and stores the values of node 0. It is reset before, so that it does not
    shift its plan. The parameters are the only run-time data that h depends on.
    """

    def __init__(self, ctrl: Controller) -> None:
        self._ctrl, self._twin = ctrl, ctrl.copy()
        try:
            self._h = self._twin.view("node.h")
        except AttributeError:  # an algorithm that stores no linearisation
            self._h = np.zeros((ctrl.dims.N, 0))
        self.numbers = tuple(i for i in range(len(ctrl.description.rows)) if self._shown(i))

    def _shown(self, number: int) -> bool:
        """True for a row that applies to a sample: it holds at node 0, or at several nodes before the end."""
        row = self._ctrl.description.rows[number]
        path = [k for k in row.nodes if k < self._ctrl.dims.N]
        return row.kind == "general" and 0 <= row.index < self._h.shape[1] and (0 in path or len(path) > 1)

    def values(self, x: Array, u: Array) -> Array:
        """Values of the rows ``numbers`` at x (nx,), u (nu,) and the present parameters of node 0."""
        if not self.numbers:
            return np.zeros(0)
        self._twin.reset()
        self._twin.x[:], self._twin.u[:] = x, u
        if self._ctrl.dims.np and self._ctrl.description.online["parameter"] != "fixed":
            self._twin.view("p")[:] = self._ctrl.view("p")[0]
        self._twin.prepare()
        rows = self._ctrl.description.rows
        return self._h[0, [rows[i].index for i in self.numbers]].astype(np.float64)
