"""The compiled driver calls a package for many of its structs, on several threads.

Functions of the package are called by their addresses, so that a batch runs the same machine code as one controller.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.build import BEGIN, END, Profile, declarations, load_library
from nmpc_codegen.runtime.compiled import CompiledPackage
from nmpc_codegen.runtime.given import is_integer

Array = NDArray[Any]

PARTS = Path(__file__).parent

#: Floating-point operations are not contracted, so that random numbers and sums have the same bits on all machines.
EXACT = Profile("exact", ("-std=c99", "-O2", "-ffp-contract=off"), wrapper=False)

#: Times (s): to wake a thread; of one controller in a call, as long as no such call has been timed.
WAKING, UNKNOWN = 5e-5, 1e-6

#: A call is divided into CLAIMS pieces for each thread, of at most MOST controllers each.
CLAIMS, MOST = 8, 64

#: The first lines of the driver for a processor.
_PROLOGUE = """\
#define _POSIX_C_SOURCE 199309L

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

typedef {real} real_t;
enum {{ ALL = -1 }};
#define NX (f->nx)
#define NU (f->nu)
#define NALG (f->algebraic_count)
#define TARGET
#define PRODUCT(a, b) ((a) * (b))

"""


#: Precision of a package -> name of the C type.
REAL = {"double": "double", "single": "float"}


def declarations_of(*names: str) -> str:
    """Return the declarations of header files of this folder, between the two marker comments that cffi needs."""
    return f"{BEGIN}\n" + "\n".join(declarations(part(name), name) for name in names) + f"{END}\n"


def part(name: str) -> str:
    """Return the text of a C file of this folder, with the files that it includes inserted."""
    text = (PARTS / name).read_text(encoding="utf-8")
    for other in ("random.c", "flight.c"):
        if f'#include "{other}"' in text:
            text = text.replace(f'#include "{other}"', part(other))
    return text


def driver_text(precision: str) -> str:
    """Return the C text of the driver for packages of this precision."""
    return _PROLOGUE.format(real=REAL[precision]) + declarations_of("driver.h", "device.h") + part("processor.c")


@cache
def load_driver(precision: str) -> tuple[Any, Any]:
    """Compile the driver for a precision and return cffi's ffi and lib."""
    files = {"batch.h": declarations_of("driver.h", "device.h"), "batch.c": driver_text(precision)}
    return load_library(files, "batch", EXACT)


class Driver:
    """A driver calls the functions of one package with ``threads`` threads; None: with one for every available core."""

    def __init__(self, package: CompiledPackage, threads: int | None = None) -> None:
        check_threads(threads)
        self.package = package
        self.threads = _cores() if threads is None else int(threads)
        self.ffi, self.lib = load_driver(package.description.precision)
        self._took: dict[str | None, float] = {}  # function -> seconds for one controller in the last call
        self.stop = np.zeros(1, np.int32)  # 1: stop all flights before their next sample
        self._pool: tuple[int, ThreadPoolExecutor] | None = None

    def address(self, name: str, package: CompiledPackage | None = None) -> Any:
        """Return the address of a function of this package, or of another one.

        Raise ControllerError if it is missing.
        """
        found = self.package if package is None else package
        return self.ffi.cast("batch_function_t", int(found.ffi.cast("uintptr_t", found.function(name))))

    def pointer(self, array: Array | None) -> Any:
        """Return the address of a contiguous array, NULL for None."""
        return self.ffi.NULL if array is None else self.ffi.cast("void *", array.ctypes.data)

    def call(
        self,
        operation: str,
        function: str | None,
        memory: Array,
        stride: int,
        *,
        index: Array | None = None,
        first: Array | None = None,
        second: Array | None = None,
        out: Array | None = None,
        places: Sequence[int] = (),
        number: float = 0.0,
    ) -> NDArray[np.int32]:
        """Call a function for structs in memory, on several threads, and return the statuses.

        ``index`` holds the numbers of the structs; None: all. The first axis of an array has the length of the call, or
        1 if all structs share its values.
        """
        count = len(memory) // stride if index is None else len(index)
        status = np.zeros(count, np.int32)
        threads = self._threads_for(function, count)
        taken = np.zeros((threads, 8), np.int64)
        taken[:, 0] = [count * t // threads for t in range(threads)]
        call = self.ffi.new("batch_call_t *")
        call.work = {
            "count": count,
            "chunk": max(1, min(MOST, count // (CLAIMS * threads))),
            "threads": threads,
            "next": self.ffi.cast("int64_t *", taken.ctypes.data),
        }
        call.operation = getattr(self.lib, f"BATCH_{operation}")
        call.function = self.ffi.NULL if function is None else self.address(function)
        call.memory, call.stride = self.ffi.cast("char *", memory.ctypes.data), stride
        call.index = self.ffi.cast("int64_t *", self.pointer(index))
        call.first, call.first_step = self.pointer(first), _step(first)
        call.second, call.second_step = self.pointer(second), _step(second)
        call.out, call.out_step = self.pointer(out), _step(out)
        call.status = self.ffi.cast("int32_t *", status.ctypes.data)
        call.place = list(places)
        call.number = number
        begin = time.perf_counter()
        self.share(partial(self.lib.batch_run, call), range(threads))
        self._took[function] = (time.perf_counter() - begin) * threads / max(1, count)
        return status

    def _threads_for(self, function: str | None, count: int) -> int:
        """Return the number of threads for a call: each must work longer than it takes to wake it, by the last call."""
        return max(1, min(self.threads, count, round(count * self._took.get(function, UNKNOWN) / WAKING)))

    def share(self, function: Callable[[Any], Any], work: Sequence[Any], interruptible: bool = False) -> None:
        """Call a function, which releases the interpreter lock, for each piece of work; free threads take the next one.

        If ``interruptible``, the calling thread only waits, so that an interrupt stops the flights; else it works, too.
        """
        pending = iter(work)

        def serve() -> None:
            try:
                for one in pending:
                    function(one)
            finally:
                deque(pending, maxlen=0)  # after an error, no thread begins another piece

        helpers: list[Future[None]] = []
        try:
            for _ in range(min(len(work), self.threads) - (not interruptible)):
                helpers.append(self._threads().submit(serve))
            if not interruptible:
                serve()
            wait(helpers)
        finally:
            self.stop[0] = 1
            while not all(helper.done() for helper in helpers):  # the arrays that they write to must outlive them
                with suppress(KeyboardInterrupt):
                    wait(helpers)
            self.stop[0] = 0
        for helper in helpers:
            helper.result()

    def _threads(self) -> ThreadPoolExecutor:
        """Return the thread pool of this process; a forked process makes its own."""
        if self._pool is None or self._pool[0] != os.getpid():
            self._pool = os.getpid(), ThreadPoolExecutor(self.threads, "nmpc_codegen")
        return self._pool[1]


def check_threads(threads: int | None) -> None:
    """Raise ControllerError unless ``threads`` is an integer >= 1 or None."""
    if threads is not None and (not is_integer(threads) or threads < 1):
        raise ControllerError(f"threads is {threads!r}; expected an integer >= 1, or None for all cores")


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _step(array: Array | None) -> int:
    """Return the distance in bytes between the data of two controllers; 0 if all share the data."""
    return 0 if array is None or len(array) == 1 else array.strides[0]
