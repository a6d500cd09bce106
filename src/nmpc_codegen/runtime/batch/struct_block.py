"""Structs of one package in one block of memory, and calls of the package for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.access.addressing import Addressing
from nmpc_codegen.runtime.batch.driver import Driver
from nmpc_codegen.runtime.compiled import ALIGNMENT
from nmpc_codegen.runtime.controller import Controller

#: Blocks of flights for every thread; flights of a block, and bytes of their samples, at most.
BLOCKS, LARGEST, BYTES = 8, 256, 2**25

Array = NDArray[Any]
Statuses = NDArray[np.int32]


class Structs(Addressing):
    """M structs, ``stride`` bytes apart, in ``memory``."""

    def __init__(self, driver: Driver, memory: NDArray[np.uint8], count: int, stride: int) -> None:
        self.driver, self.memory, self.stride = driver, memory, stride
        self._count = count
        struct: NDArray[np.void] = np.ndarray((count,), driver.package.dtype, memory, 0, (stride,))
        super().__init__(driver.package, struct)

    def __len__(self) -> int:
        return self._count

    def shares(self, other: Structs) -> bool:
        """Internal: true if they have memory in common."""
        return bool(np.shares_memory(self.memory, other.memory))

    def twin(self) -> Structs:
        """Internal: the same structs in memory of their own."""
        memory = reserve(self.memory.nbytes)
        memory[:] = self.memory
        return Structs(self.driver, memory, self._count, self.stride)

    def call(self, operation: str, function: str | None, **arguments: Any) -> Statuses:
        """Internal: statuses (M,) of one call of a function of the package for every struct; see Driver.call()."""
        return self.driver.call(operation, function, self.memory, self.stride, **arguments)

    # -- closed loops -------------------------------------------------------------------------------------------------

    def fetch(self, member: str) -> Array:
        """A member of the structs for NumPy; empty if it does not exist."""
        return self.member(member)

    def address_of(self, structs: Structs, keep: list[Any]) -> Any:
        """Internal: where the code that flies finds structs; ``keep`` holds what has to live as long."""
        return self.driver.pointer(structs.memory)

    @property
    def stop(self) -> Any:
        """Internal: where the code that flies looks whether to stop."""
        return self.driver.ffi.cast("int32_t *", self.driver.pointer(self.driver.stop))

    def place_of_known(self) -> tuple[int, int]:
        """Internal: bytes from the begin of a struct to the states behind those of the user; their size."""
        fields: Any = self._package.dtype.fields
        member = fields["xhat" if "xhat" in fields else "x"]
        return member[1] + self.dims.nx * self._real.itemsize, self.description.augmentation.count * self._real.itemsize

    def reach(self, array: Array, keep: list[Any]) -> Any:
        """Internal: the address of an array for that code."""
        keep.append(array)
        return self.driver.pointer(array)

    def reach_structs(self, structs: Any, keep: list[Any]) -> Any:
        """Internal: the address of an array of C structs for that code."""
        keep.append(structs)
        return structs

    def block_size(self, flights: int, bytes_of: int) -> int:
        """Internal: flights that are flown at once, a few blocks for every thread; ``bytes_of``: of one."""
        threads = max(1, min(self.driver.threads, flights))
        return max(1, min(LARGEST, BYTES // bytes_of, -(-flights // (BLOCKS * threads))))

    def fly(self, shared: Any, block: slice, into: Into, rows: int) -> int:
        """Internal: fly the flights of a block; return 0, or the status of a setter that has refused data.

        ``shared``: batch_flights_t without what is written to; ``rows``: numbers that a setter is given at most.
        """
        c, _keep = self.aim(shared, into, rows)
        return int(self.driver.lib.batch_fly(c, block.start, block.stop))

    def aim(self, shared: Any, into: Into, rows: int) -> tuple[Any, list[Array]]:
        """Internal: batch_flights_t with what is written to, and scratch memory, which has to live as long."""
        cast = self.driver.ffi.cast
        c = self.driver.ffi.new("batch_flights_t *", shared[0])
        for name, array in vars(into).items():
            setattr(c, name, cast(self.driver.ffi.typeof(getattr(c, name)), self.driver.pointer(array)))
        copies = reserve(2 * stride_of(max(int(c.controller.size), int(c.plant.size))))
        scratch = np.zeros(max(1, rows), self._real)
        c.copies, c.rows = cast("char *", self.driver.pointer(copies)), self.driver.pointer(scratch)
        return c, [copies, scratch]


@dataclass(frozen=True, eq=False)
class Into:
    """What a block of flights writes, under the names of batch_flights_t."""

    x: Array
    u: Array
    z: Array
    status: Array
    failed: Array
    lost: Array
    seconds: Array


def single(controller: Controller) -> Structs:
    """The one struct of a controller."""
    package = controller._package
    return Structs(Driver(package, 1), controller._memory, 1, package.dtype.itemsize)


def stride_of(size: int) -> int:
    """Bytes from one struct to the next one: each begins a cache line."""
    return -(-size // ALIGNMENT) * ALIGNMENT


def reserve(size: int) -> NDArray[np.uint8]:
    """Aligned bytes that nobody has touched: each thread touches those of its share first."""
    try:
        raw = np.empty(size + ALIGNMENT, dtype=np.uint8)
    except (MemoryError, ValueError) as error:
        raise ControllerError(
            f"a batch of {size:,} bytes does not fit into memory; expected a smaller number"
        ) from error
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size]
