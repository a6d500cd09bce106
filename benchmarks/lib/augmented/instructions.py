"""Instructions of a sample of the bioreactor, by callgrind: a measure of the work that no other process disturbs."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from nmpc_codegen import OCP, Options, generate
from nmpc_codegen.runtime.build import PROFILES, find_compiler

DRIVER = Path(__file__).with_name("counted_loop.c")
SAMPLES = 160


def available() -> bool:
    """Whether there is a valgrind."""
    return shutil.which("valgrind") is not None


def per_sample(ocp: OCP, options: Options, jump: Sequence[float]) -> float:
    """Mean number of instructions of step() over the closed loop, compiled for AVX2, which valgrind understands."""
    sources = generate(ocp, options)
    flags = [flag for flag in PROFILES["fast"].flags if not flag.startswith("-march")]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in (f"{ocp.name}.h", f"{ocp.name}.c"):
            (folder / path).write_text(sources[path], encoding="utf-8")
        command = [*find_compiler(), *flags, "-march=haswell", f'-DPACKAGE="{ocp.name}.c"', "-I."]
        subprocess.run([*command, "-std=c99", str(DRIVER), "-o", "loop", "-lm"], cwd=folder, check=True)
        tool = ["valgrind", "--tool=callgrind", "--toggle-collect=sample", "--callgrind-out-file=/dev/null"]
        run = [*tool, "./loop", *(repr(float(factor)) for factor in jump)]
        text = subprocess.run(run, cwd=folder, check=True, capture_output=True, text=True).stderr
    found = re.search(r"Collected : (\d+)", text)
    if found is None:
        raise ValueError(f"callgrind has counted nothing:\n{text}")
    return int(found[1]) / SAMPLES
