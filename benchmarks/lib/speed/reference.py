"""The time of the reference kernel converts limits and peers' figures from one machine to another."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

from verification.closed_loop import pinned_core

SOURCE = Path(__file__).with_name("reference.c")

#: Time (us) on the machine of the limits. Another kernel was timed there: 40 RK4 steps of the chain of five balls with
#: their Jacobians, as straight-line C, took 24 us. In 25 runs in turn on one core it took 0.878 times as long as this.
REFERENCE = 24.0 / 0.878


def reference_kernel_us() -> float:
    """Return the least time (us) of reference.c, gcc -O2, on one core."""
    core = pinned_core()
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "kernel")
        subprocess.run(["gcc", "-O2", str(SOURCE), "-o", str(program), "-lm"], check=True)
        run = subprocess.run(
            [str(program)],
            check=True,
            capture_output=True,
            text=True,
            preexec_fn=lambda: os.sched_setaffinity(0, core),
        )
    return float(run.stdout.split()[0])
