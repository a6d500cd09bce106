"""Printed routines are timed one by one in C, over several points."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.compilers import find_compiler
from verification.closed_loop import pinned_core

MAIN = """
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}
"""


def times(
    routines: Mapping[str, Routine], points: Mapping[str, np.ndarray], repetitions: int = 400, runs: int = 25
) -> dict[str, float]:
    """Return ns per call and routine: minimum over runs of the mean over repetitions and points.

    ``points``: port -> (n, size); routines of any port names may be mixed.
    """
    n = len(next(iter(points.values())))
    lines = ["#define _POSIX_C_SOURCE 199309L", "#include <math.h>", "#include <stddef.h>"]
    lines += ["#include <stdio.h>", "#include <time.h>"]
    lines += ["typedef double real;", MAIN]
    for name, values in points.items():
        table = values.reshape(n, -1) if values.size else np.zeros((n, 1))
        rows = ", ".join("{" + ", ".join(map(repr, map(float, row))) + "}" for row in table)
        lines.append(f"static const real in_{name}[{n}][{table.shape[1]}] = {{{rows}}};")
    body = []
    for key, routine in routines.items():
        lines.append(print_routine(routine, CStyle("real", False)).replace(routine.name, f"{key}_"))
        lines += [f"static real {key}_{p.name}[{n}][{max(1, p.size)}];" for p in routine.outputs]
        arguments = [f"in_{p.name}[k]" for p in routine.reads] + [f"{key}_{p.name}[k]" for p in routine.writes]
        body += [
            "best = 1e30;",
            f"for (q = 0; q < {runs}; q++) {{ t = now(); for (r = 0; r < {repetitions}; r++) for (k = 0; k < {n}; k++)",
            f"    {key}_({', '.join(arguments)});",
            f'    t = (now() - t) / {repetitions * n}.0; best = (t < best) ? t : best; }} printf("{key} %g\\n", best);',
        ]
    lines += ["int main(void)", "{", "double best, t; int k, r, q;", *body, "return 0;", "}"]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "kernels.c").write_text("\n".join(lines) + "\n", encoding="utf-8")
        command = [*find_compiler(), *PROFILES["fast"].flags, "kernels.c", "-o", "kernels", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        core = pinned_core()
        text = subprocess.run(
            [f"{folder}/kernels"],
            check=True,
            capture_output=True,
            text=True,
            preexec_fn=lambda: os.sched_setaffinity(0, core),
        ).stdout
    return {line.split()[0]: float(line.split()[1]) for line in text.splitlines()}
