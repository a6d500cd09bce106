"""Instructions of a sample of the bioreactor in its closed loop with a jump."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.lib import callgrind
from nmpc_codegen import OCP, Options, generate
from nmpc_codegen.runtime.compilers import find_compiler

DRIVER = Path(__file__).with_name("counted_loop.c")
SAMPLES = 160


def per_sample(ocp: OCP, options: Options, jump: Sequence[float]) -> float | None:
    """Mean number of instructions of step() over the closed loop; None: valgrind does not know one of them."""
    sources = generate(ocp, options)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in (f"{ocp.name}.h", f"{ocp.name}.c"):
            (folder / path).write_text(sources[path], encoding="utf-8")
        command = [*find_compiler(), *callgrind.FLAGS, f'-DPACKAGE="{ocp.name}.c"', "-I.", "-std=c99"]
        subprocess.run([*command, str(DRIVER), "-o", "loop", "-lm"], cwd=folder, check=True)
        count = callgrind.instructions(folder / "loop", [repr(float(f)) for f in jump], ["sample"])
    return None if count is None else count / SAMPLES
