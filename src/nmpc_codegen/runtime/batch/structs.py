"""Structs of one package in one block of memory, and calls of the package for all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.runtime.access.iterate import Iterate
from nmpc_codegen.runtime.batch.driver import Driver
from nmpc_codegen.runtime.compiled import ALIGNMENT
from nmpc_codegen.runtime.controller import Controller

Array = NDArray[Any]
Statuses = NDArray[np.int32]


class Structs(Iterate):
    """M structs, ``stride`` bytes apart, in ``memory``."""

    def __init__(self, driver: Driver, memory: NDArray[np.uint8], count: int, stride: int) -> None:
        self.driver, self.memory, self.stride = driver, memory, stride
        self._count = count
        struct: NDArray[np.void] = np.ndarray((count,), driver.package.dtype, memory, 0, (stride,))
        super().__init__(driver.package, struct)

    def __len__(self) -> int:
        return self._count

    def copy(self) -> Structs:
        """The same structs in memory of their own."""
        memory = reserve(self.memory.nbytes)
        memory[:] = self.memory
        return Structs(self.driver, memory, self._count, self.stride)

    def call(self, operation: str, function: str | None, **arguments: Any) -> Statuses:
        """Statuses (M,) of one call of a function of the package for every struct; see Driver.call()."""
        return self.driver.call(operation, function, self.memory, self.stride, **arguments)


def single(controller: Controller) -> Structs:
    """The one struct of a controller."""
    package = controller._package
    return Structs(Driver(package, 1), controller._memory, 1, package.dtype.itemsize)


def stride_of(size: int) -> int:
    """Bytes from one struct to the next one: each begins a cache line."""
    return -(-size // ALIGNMENT) * ALIGNMENT


def reserve(size: int) -> NDArray[np.uint8]:
    """Aligned bytes that nobody has touched: each thread touches those of its share first."""
    raw = np.empty(size + ALIGNMENT, dtype=np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size]
