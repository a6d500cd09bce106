"""Do gcc and clang, from -O0 to -O3, and for AVX-512 where this machine has it, produce the same controller? All builds
receive the recorded samples of one run.

The other flags are those of the profile "fast": products and sums may be contracted, so that rounding differs between
the builds. The figure shows differences beyond rounding.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import numpy as np

from nmpc_codegen import Controller
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.build import PROFILES
from verification.closed_loop import Scenario, disturbed
from verification.quality import package_name, written

DRIVER = Path(__file__).with_name("replay.c")
COMPILERS = ("gcc", "clang")
FLAGS = ("-std=c99", *(flag for flag in PROFILES["fast"].flags if not flag.startswith("-O")))
LEVELS = ("-O0", "-O1", "-O2", "-O3")
#: Vector extensions of x86-64-v4, as macros of a compiler for this machine.
OF_V4 = {f"__AVX512{part}__" for part in ("F", "BW", "CD", "DQ", "VL")}
LIMIT = 1e-9  # of the largest value of each control
JOBS = 2


def builds() -> list[tuple[str, ...]]:
    """(compiler, flags) of all builds that run here, gcc -O0 first."""
    found: list[tuple[str, ...]] = list(product(COMPILERS, LEVELS))
    for compiler in COMPILERS:
        command = [compiler, "-march=native", "-dM", "-E", "-x", "c", "/dev/null"]
        known = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()
        widths = ("x86-64-v4", "native") if set(known) >= OF_V4 else ("native",) if known else ()
        found += [(compiler, level, f"-march={width}") for level in ("-O2", "-O3") for width in widths]
    return found


def disagreement(u: Array) -> float:
    """max |u - u_0| / max |u_0| per control over (builds, samples, nu); NaN if a control is not finite."""
    scale = np.maximum(np.max(np.abs(u[0]), axis=0), np.finfo(float).tiny)
    return float(np.max(np.abs(u - u[0]) / scale))


def record(controller: Controller, scenario: Scenario, n: int) -> Array:
    """(n, nx): measured states of a closed loop under the declared reference, with the events of the scenario."""
    random = np.random.default_rng(1)
    x, found = np.array(scenario.x0, dtype=float), []
    for k in range(n):
        if k % scenario.period == 0:
            x = disturbed(scenario, x, random, controller.integrate)
        found.append(x)
        x = np.asarray(controller.integrate(x, controller.step(x), scenario.dt))
    return np.array(found)


def replays(sources: Sources, x: Array, of: Sequence[tuple[str, ...]]) -> tuple[Array, Array]:
    """Controls (builds, samples, nu) and status (builds, samples) of these builds (compiler, flags)."""
    name = package_name(sources)
    text = "\n".join(" ".join(repr(float(v)) for v in row) for row in x)
    with written(sources) as folder, ThreadPoolExecutor(JOBS) as pool:

        def replay(which: tuple[str, ...]) -> Array:
            with tempfile.TemporaryDirectory() as program:
                command = [*which, *FLAGS, f"-DNAME={name}", f"-DMACRO={name.upper()}", f'-DPACKAGE="{name}.c"']
                command += [f"-I{folder}", str(DRIVER), "-o", f"{program}/replay", "-lm"]
                subprocess.run(command, check=True)
                done = subprocess.run([f"{program}/replay"], input=text, capture_output=True, text=True, check=True)
            return np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])

        found = np.array(list(pool.map(replay, of)))
    return found[:, :, 1:], found[:, :, 0]
