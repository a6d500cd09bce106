"""The structs of one package lie in one block of memory, and a call of the package serves all of them."""

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

#: Number of blocks of flights for each thread; largest number of flights, and of bytes of samples, of a block.
BLOCKS, LARGEST, BYTES = 8, 256, 2**25

Array = NDArray[Any]
Statuses = NDArray[np.int32]


class Structs(Addressing):
    """M structs lie in ``memory``, ``stride`` bytes apart."""

    def __init__(self, driver: Driver, memory: NDArray[np.uint8], count: int, stride: int) -> None:
        self.driver, self.memory, self.stride = driver, memory, stride
        self._count = count
        struct: NDArray[np.void] = np.ndarray((count,), driver.package.dtype, memory, 0, (stride,))
        super().__init__(driver.package, struct)

    def __len__(self) -> int:
        return self._count

    def shares(self, other: Structs) -> bool:
        """Return True if both blocks have memory in common (internal)."""
        return bool(np.shares_memory(self.memory, other.memory))

    def twin(self) -> Structs:
        """Copy the structs to memory of their own (internal)."""
        memory = reserve(self.memory.nbytes)
        memory[:] = self.memory
        return Structs(self.driver, memory, self._count, self.stride)

    def call(self, operation: str, function: str | None, **arguments: Any) -> Statuses:
        """Call a function of the package for every struct and return the statuses (M,) (internal)."""
        return self.driver.call(operation, function, self.memory, self.stride, **arguments)

    # -- closed loops -------------------------------------------------------------------------------------------------

    def fetch(self, member: str) -> Array:
        """Return a member of the structs as a NumPy array; empty if the package has no such member."""
        return self.member(member)

    def address_of(self, structs: Structs, keep: list[Any]) -> Any:
        """Return the address of structs for the compiled loop; ``keep`` receives what must stay alive (internal)."""
        return self.driver.pointer(structs.memory)

    @property
    def stop(self) -> Any:
        """Return the address of the flag that stops the compiled loop (internal)."""
        return self.driver.ffi.cast("int32_t *", self.driver.pointer(self.driver.stop))

    def place_of_known(self) -> tuple[int, int]:
        """Return the offset (bytes) in a struct of the states added to the user's, and their size (internal)."""
        fields: Any = self._package.dtype.fields
        member = fields["xhat" if "xhat" in fields else "x"]
        return member[1] + self.dims.nx * self._real.itemsize, self.description.augmentation.count * self._real.itemsize

    def reach(self, array: Array, keep: list[Any]) -> Any:
        """Return the address of an array for the compiled loop (internal)."""
        keep.append(array)
        return self.driver.pointer(array)

    def reach_structs(self, structs: Any, keep: list[Any]) -> Any:
        """Return the address of an array of C structs for the compiled loop (internal)."""
        keep.append(structs)
        return structs

    def block_size(self, flights: int, bytes_of: int) -> int:
        """Return the number of flights of a block of which each takes ``bytes_of`` bytes (internal).

        Threads get a few blocks.
        """
        threads = max(1, min(self.driver.threads, flights))
        return max(1, min(LARGEST, BYTES // bytes_of, -(-flights // (BLOCKS * threads))))

    def fly(self, shared: Any, block: slice, into: Into, rows: int) -> int:
        """Simulate the flights of a block; return 0, or the status of a setter that has refused data (internal).

        ``shared`` is a batch_flights_t without outputs; ``rows`` is the largest number of rows passed to a setter.
        """
        c, _keep = self.aim(shared, into, rows)
        return int(self.driver.lib.batch_fly(c, block.start, block.stop))

    def aim(self, shared: Any, into: Into, rows: int) -> tuple[Any, list[Array]]:
        """Return a batch_flights_t with outputs and scratch memory, and the arrays that must stay alive (internal)."""
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
    """The outputs of a block of flights have the names of the members of batch_flights_t."""

    x: Array
    u: Array
    z: Array
    status: Array
    failed: Array
    lost: Array
    seconds: Array


def single(controller: Controller) -> Structs:
    """Return the one struct of a controller."""
    package = controller._package
    return Structs(Driver(package, 1), controller._memory, 1, package.dtype.itemsize)


def stride_of(size: int) -> int:
    """Return the distance in bytes between two structs, each of which begins a cache line."""
    return -(-size // ALIGNMENT) * ALIGNMENT


def reserve(size: int) -> NDArray[np.uint8]:
    """Return aligned memory that is not yet touched, so that each thread touches the pages of its share first."""
    try:
        raw = np.empty(size + ALIGNMENT, dtype=np.uint8)
    except (MemoryError, ValueError) as error:
        raise ControllerError(
            f"a batch of {size:,} bytes does not fit into memory; expected a smaller number"
        ) from error
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size]
