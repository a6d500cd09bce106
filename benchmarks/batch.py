"""Many controllers at once: python -m benchmarks.batch [--scale S] [--json FILE]

Equal bits for every number of threads, samples per second over the size of a batch, what a call costs beside the
samples themselves, closed loops in compiled code beside calls from NumPy, and where NVRTC is installed the time that
the kernels of two packages take to compile for a GPU. It ends with an exit status of 1 if a figure is beyond its limit.
"""

from __future__ import annotations

from benchmarks.lib.alone import main

if __name__ == "__main__":
    raise SystemExit(main("batch", __doc__, "batch"))
