"""Bytes of compiled code and constants of a package, for comparisons between algorithms."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from nmpc_codegen import OCP, Options, generate
from nmpc_codegen.runtime.compilers import find_compiler


def text_bytes(ocp: OCP, options: Options) -> int:
    """Section "text" of the object file, code and constants, optimised for size."""
    sources = generate(ocp, options)
    with tempfile.TemporaryDirectory() as folder:
        for path in (f"{ocp.name}.h", f"{ocp.name}.c"):
            (Path(folder) / path).write_text(sources[path], encoding="utf-8")
        command = [*find_compiler(), "-std=c99", "-Os", "-c", f"{ocp.name}.c", "-o", "package.o"]
        subprocess.run(command, cwd=folder, check=True)
        table = subprocess.run(["size", "package.o"], cwd=folder, check=True, capture_output=True, text=True).stdout
    return int(table.splitlines()[1].split()[0])
