"""A device on the processor: arrays of NumPy, and a kernel whose threads are the turns of a loop."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.runtime.build import Profile, load_library

BEGIN = """\
#define TARGET
#define __noinline__
#define PRODUCT(a, b) ((a) * (b))
#define KERNEL void
#define THREAD thread_number
static int64_t thread_number;
"""
INCLUDES = "".join(f"#include <{name}.h>\n" for name in ("math", "stddef", "stdint", "string"))
DECLARED = """
/* begin declarations */
void launch(const void *l, int64_t threads);
/* end declarations */
"""
LOOP = """
void launch(const void *l, int64_t threads)
{
    for (thread_number = 0; thread_number < threads + 3; thread_number++) {
        batch_all((const batch_launch_t *)l);
    }
}
"""
EXACT = Profile("emulated", ("-std=gnu11", "-O1", "-ffp-contract=off"), wrapper=False)


class Emulated:
    """An Engine; the last block of a launch has threads without a controller, as on a GPU."""

    xp: Any = np
    begin = BEGIN

    def __init__(self, largest: int = 1000) -> None:
        self._largest = largest

    def load(self, text: str, exact: bool) -> None:
        assert exact
        files = {"kernel.h": DECLARED, "kernel.c": INCLUDES + text + DECLARED + LOOP}
        self._ffi, self._lib = load_library(files, "kernel", EXACT)

    def launch(self, argument: Any, threads: int) -> None:
        self._lib.launch(self._ffi.cast("void *", self.address(argument)), threads)

    def address(self, array: Any) -> int:
        return int(array.ctypes.data)

    def fetch(self, array: Any) -> NDArray[Any]:
        return np.array(array)

    def largest(self, bytes_of_flight: int) -> int:
        return self._largest
