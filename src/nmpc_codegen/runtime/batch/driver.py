"""The compiled code that calls a package for many of its structs, and the threads that share it.

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

#: Arithmetic as it is written: random numbers and sums have the same bits everywhere.
EXACT = Profile("exact", ("-std=c99", "-O2", "-ffp-contract=off"), wrapper=False)

#: Time (s) that it takes to wake a thread, and of a controller in a call before it is known.
WAKING, UNKNOWN = 5e-5, 1e-6

#: Controllers that a thread claims at once: of so many claims by every thread, at most so many controllers.
CLAIMS, MOST = 8, 64

#: What the parts of the driver begin with, for a processor.
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


#: Precision of a package -> its type in C.
REAL = {"double": "double", "single": "float"}


def declarations_of(*names: str) -> str:
    """The declarations of header files of this folder, between one pair of markers."""
    return f"{BEGIN}\n" + "\n".join(declarations(part(name), name) for name in names) + f"{END}\n"


def part(name: str) -> str:
    """The text of a C file of this folder, with those that it includes."""
    text = (PARTS / name).read_text(encoding="utf-8")
    for other in ("random.c", "flight.c"):
        if f'#include "{other}"' in text:
            text = text.replace(f'#include "{other}"', part(other))
    return text


def driver_text(precision: str) -> str:
    """The C that calls packages of a precision for many of their structs."""
    return _PROLOGUE.format(real=REAL[precision]) + declarations_of("driver.h", "device.h") + part("processor.c")


@cache
def load_driver(precision: str) -> tuple[Any, Any]:
    """ffi and lib of this C."""
    files = {"batch.h": declarations_of("driver.h", "device.h"), "batch.c": driver_text(precision)}
    return load_library(files, "batch", EXACT)


class Driver:
    """Calls of one package, by ``threads`` threads; None: as many as this process may use."""

    def __init__(self, package: CompiledPackage, threads: int | None = None) -> None:
        check_threads(threads)
        self.package = package
        self.threads = _cores() if threads is None else int(threads)
        self.ffi, self.lib = load_driver(package.description.precision)
        self._took: dict[str | None, float] = {}  # seconds of one controller in the last call of a function
        self.stop = np.zeros(1, np.int32)  # 1: flights end before their next sample
        self._pool: tuple[int, ThreadPoolExecutor] | None = None

    def address(self, name: str, package: CompiledPackage | None = None) -> Any:
        """The address of a function of the package, or of another one; ControllerError if it has none of that name."""
        found = self.package if package is None else package
        return self.ffi.cast("batch_function_t", int(found.ffi.cast("uintptr_t", found.function(name))))

    def pointer(self, array: Array | None) -> Any:
        """The address of an array of consecutive bytes."""
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
        """The statuses of one call of a function for structs in memory, which threads share.

        ``index``: their numbers; None: all. Arrays have a first axis of the length of the call, or 1: the same for all.
        """
        count = len(memory) // stride if index is None else len(index)
        status = np.zeros(count, np.int32)
        threads = self._worth(function, count)
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

    def _worth(self, function: str | None, count: int) -> int:
        """Threads for a call: so many that each has more to do than it takes to wake it, by the last such call."""
        return max(1, min(self.threads, count, round(count * self._took.get(function, UNKNOWN) / WAKING)))

    def share(self, function: Callable[[Any], Any], work: Sequence[Any], interruptible: bool = False) -> None:
        """Call a function that releases the interpreter for each piece of work: threads take one after the other.

        ``interruptible``: this thread waits, so that an interrupt stops the flights; else it takes its part.
        """
        pending = iter(work)

        def serve() -> None:
            try:
                for one in pending:
                    function(one)
            finally:
                deque(pending, maxlen=0)  # after an error, nobody begins another piece

        helpers: list[Future[None]] = []
        try:
            for _ in range(min(len(work), self.threads) - (not interruptible)):
                helpers.append(self._threads().submit(serve))
            if not interruptible:
                serve()
            wait(helpers)
        finally:
            self.stop[0] = 1
            while not all(helper.done() for helper in helpers):  # what they write to must live as long
                with suppress(KeyboardInterrupt):
                    wait(helpers)
            self.stop[0] = 0
        for helper in helpers:
            helper.result()

    def _threads(self) -> ThreadPoolExecutor:
        """The threads of this process: a fork does not have those of its parent."""
        if self._pool is None or self._pool[0] != os.getpid():
            self._pool = os.getpid(), ThreadPoolExecutor(self.threads, "nmpc_codegen")
        return self._pool[1]


def check_threads(threads: int | None) -> None:
    """ControllerError unless it is a number of threads, or None."""
    if threads is not None and (not is_integer(threads) or threads < 1):
        raise ControllerError(f"threads is {threads!r}; expected an integer >= 1, or None for all cores")


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _step(array: Array | None) -> int:
    """Bytes from what belongs to one controller to that of the next one."""
    return 0 if array is None or len(array) == 1 else array.strides[0]
