"""The reference kernel, whose time carries limits from one machine to another."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

from benchmarks.lib.closed_loop import pinned_core
from nmpc_codegen.runtime.build import MARCH

SOURCE = Path(__file__).parents[2] / "reference_kernel.c"


def reference_kernel_us() -> float:
    """Least time (us) of 40 evaluations of benchmarks/reference_kernel.c, gcc -O2 -march=native, on one core."""
    core = pinned_core()
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "kernel")
        subprocess.run(["gcc", "-O2", MARCH, str(SOURCE), "-o", str(program), "-lm"], check=True)
        run = subprocess.run(
            [str(program)],
            check=True,
            capture_output=True,
            text=True,
            preexec_fn=lambda: os.sched_setaffinity(0, core),
        )
    return float(run.stdout.split()[0])
