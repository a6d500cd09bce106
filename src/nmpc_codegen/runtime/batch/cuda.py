"""CuPy gives access to a GPU: its arrays, and the kernel that NVRTC has compiled for it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import BuildError
from nmpc_codegen.runtime.batch.nvrtc import compile_kernel
from nmpc_codegen.runtime.extras import extra

#: The first lines of a kernel; NVRTC lacks <stdint.h>, so that its types are declared here.
BEGIN = """\
typedef signed char int8_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
#define NAN __builtin_bit_cast(double, 0x7FF8000000000000ULL)
#define INFINITY __builtin_bit_cast(double, 0x7FF0000000000000ULL)
#define TARGET __noinline__
#define PRODUCT(a, b) __dmul_rn(a, b)
#define KERNEL extern "C" __global__ void
#define THREAD ((int64_t)blockIdx.x * blockDim.x + threadIdx.x)
"""

#: Number of threads of a block.
BLOCK = 128


class Cuda:
    """An Engine that uses the current GPU of CuPy.

    Raises:
        ExtraError: CuPy is not installed.
        BuildError: there is no GPU.
    """

    begin = BEGIN

    def __init__(self) -> None:
        self.xp: Any = extra("cupy", 'batch(device="cuda")')
        try:
            self.xp.cuda.runtime.getDeviceCount()
            self._architecture = f"sm_{self.xp.cuda.Device().compute_capability}"
        except self.xp.cuda.runtime.CUDARuntimeError as error:
            raise BuildError(f'batch(device="cuda"): CuPy finds no GPU: {error}') from error

    def load(self, text: str, exact: bool) -> None:
        module = self.xp.RawModule(path=str(compile_kernel(text, self._architecture, exact)))
        self._kernel = module.get_function("batch_all")

    def launch(self, argument: Any, threads: int) -> None:
        if threads:
            self._kernel((-(-threads // BLOCK),), (BLOCK,), (argument,))

    def address(self, array: Any) -> int:
        return int(array.data.ptr)

    def fetch(self, array: Any) -> NDArray[Any]:
        return np.asarray(self.xp.asnumpy(array))

    def largest(self, bytes_of_flight: int) -> int:
        free, _ = self.xp.cuda.runtime.memGetInfo()
        return int(free // 2 // bytes_of_flight)
