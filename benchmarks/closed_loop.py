"""Closed loops timed in C: a Python call costs as much as the crane's feedback phase."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nmpc_codegen.build import PROFILES, find_compiler
from nmpc_codegen.render import Sources

DRIVER = Path(__file__).with_name("closed_loop.c")


@dataclass(frozen=True)
class Timing:
    """Over runs of the median over steps, us: minimum and median; failures and QP iterations per step."""

    total: float
    feedback: float
    total_median: float
    feedback_median: float
    slowest: float
    failed: int
    qp_iterations: float
    samples: int


def compile_driver(sources: Sources, name: str, folder: Path, flags: Sequence[str] = PROFILES["fast"].flags) -> Path:
    """The driver with the package compiled into it."""
    for path in (f"{name}.h", f"{name}.c"):
        (folder / path).write_text(sources[path], encoding="utf-8")
    program = folder / "closed_loop"
    command = [*find_compiler(), *flags, "-std=c99", f"-DNAME={name}", f"-DMACRO={name.upper()}"]
    command += [f'-DPACKAGE="{name}.c"', f"-I{folder}", str(DRIVER), "-o", str(program), "-lm"]
    subprocess.run(command, check=True)
    return program


def closed_loop(
    sources: Sources,
    name: str,
    x0: Sequence[float],
    *,
    amplitude: float,
    period: int,
    runs: int = 15,
    steps: int = 1000,
) -> Timing:
    """Time a package; the process is pinned to one core."""
    with tempfile.TemporaryDirectory() as folder:
        program = compile_driver(sources, name, Path(folder))
        command = [str(program), str(runs), str(steps), str(period), repr(amplitude), *(repr(float(v)) for v in x0)]
        core = {max(os.sched_getaffinity(0))}
        text = subprocess.run(
            command, check=True, capture_output=True, text=True, preexec_fn=lambda: os.sched_setaffinity(0, core)
        ).stdout
    table = np.array([[float(v) for v in line.split()] for line in text.splitlines()])
    return Timing(
        total=float(table[:, 0].min()),
        feedback=float(table[:, 1].min()),
        total_median=float(np.median(table[:, 0])),
        feedback_median=float(np.median(table[:, 1])),
        slowest=float(table[:, 2].min()),
        failed=int(table[:, 3].max()),
        qp_iterations=float(table[:, 4].mean()),
        samples=runs * steps,
    )
