"""Hostile numbers are put into the data of a controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from nmpc_codegen import Controller, Status
from nmpc_codegen.runtime.diagnosis.plan_rows import path_bounds

Array = np.ndarray

#: Sizes of finite numbers; those beyond single precision become infinite there.
SIZES = (0.0, 5e-324, 1e-300, 1e-40, 1e-8, 1.0, 30.0, 1e3, 1e6, 1e8, 1e12, 1e20, 1e38, 1e150, 1e300)


def number(rng: np.random.Generator) -> float:
    """Return NaN or an infinite number sometimes, else a number of any size."""
    if rng.random() < 0.2:
        return float(rng.choice([np.nan, np.inf, -np.inf]))
    return float(rng.choice([-1.0, 1.0]) * rng.choice(SIZES) * rng.uniform(0.5, 2.0))


def spoiled(rng: np.random.Generator, values: Array) -> Array:
    """Return a copy with one entry, some or all of them replaced."""
    spoilt = values.copy()
    share = rng.choice([0.0, 0.3, 1.0])
    chosen = rng.random(values.shape) < share
    if not chosen.any() and values.size:
        chosen.flat[rng.integers(values.size)] = True
    with np.errstate(over="ignore"):
        spoilt[chosen] = [number(rng) for _ in range(int(chosen.sum()))]
    return spoilt


class Data:
    """C functions set the run-time data of a controller, and may refuse them."""

    def __init__(self, controller: Controller) -> None:
        self.c = controller
        when: Mapping[Any, str] = controller.description.online

        def told(kind: str) -> bool:
            return when[kind] != "fixed"

        views = {"reference": "yref", "terminal_reference": "yref_N", "weight": "W", "terminal_weight": "W_N"}
        self.good: dict[str, Array] = {}
        for kind, view in views.items():
            values = controller.view(view) if self._size(kind) and told(kind.split("_")[-1]) else np.zeros(0)
            per_node = kind in ("reference", "weight")
            self.good[kind] = np.array(values[0] if per_node and values.size else values, copy=True)
        parameters = range(len(controller.description.parameters) if told("parameter") else 0)
        self.parameters = [np.array(self._parameter(i)) for i in parameters]
        rows = range(len(controller.names.rows) if told("bounds") else 0)
        self.bounds = [path_bounds(controller, i) for i in rows]

    def _size(self, kind: str) -> int:
        terminal = kind.startswith("terminal")
        return int(self.c.dims.ny_N if terminal else self.c.dims.ny)

    def _parameter(self, index: int) -> Array:
        sizes = [p.size for p in self.c.description.parameters]
        start = sum(sizes[:index])
        found: Array = self.c.view("p")[0, start : start + sizes[index]]
        return found

    def kinds(self) -> list[str]:
        """Return the kinds of data that this controller has."""
        found = [kind for kind, values in self.good.items() if values.size]
        found += ["parameter"] if self.parameters else []
        return found + (["bounds"] if self.bounds else [])

    def _call(self, name: str, *arguments: Any) -> Status:
        return Status(self.c._call(name, self.c._s, *arguments))

    def _send(self, kind: str, value: Array) -> Status:
        pointer = self.c._pointer(value)
        if kind.startswith("terminal"):
            return self._call(f"set_{kind}", pointer)
        return self._call(f"set_{kind}", -1, pointer)

    def spoil(self, rng: np.random.Generator, kind: str) -> Status:
        """Replace one datum by hostile numbers."""
        if kind == "parameter":
            i = int(rng.integers(len(self.parameters)))
            return self._call("set_parameter", i, -1, self.c._pointer(spoiled(rng, self.parameters[i])))
        if kind != "bounds":
            return self._send(kind, spoiled(rng, self.good[kind]))
        row = int(rng.integers(len(self.bounds)))
        low, high = number(rng), number(rng)
        choice = rng.integers(3)
        low, high = ((low, high), (low, low), (min(low, high), max(low, high)))[choice]
        return self._call("set_bounds", row, -1, low, high)

    def restore(self) -> None:
        """Restore all good data."""
        for kind, values in self.good.items():
            if values.size:
                assert self._send(kind, values) == Status.OK
        for i, value in enumerate(self.parameters):
            assert self._call("set_parameter", i, -1, self.c._pointer(value)) == Status.OK
        for row, (low, high) in enumerate(self.bounds):
            assert self._call("set_bounds", row, -1, low, high) == Status.OK

    def spoil_plan(self, rng: np.random.Generator) -> None:
        """Write hostile numbers over states, controls or multipliers of the plan."""
        names = [n for n in ("x", "u", "lam", "mu_u", "mult") if self.c.member(n).size]
        for name in rng.permutation(names)[: rng.integers(1, 3)]:
            view = self.c.view(str(name))
            view[...] = spoiled(rng, view)
