"""Tests call generated C in a shared library: printed routines, and static functions of complete packages.

All code is compiled with the flags of the profile "test"; every warning that the project forbids, and that the compiler
knows, is an error.
"""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmpc_codegen import OCP, Options
from nmpc_codegen.compiler import model_of, read, text_of
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.package.description import union_dtype
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.build import PROFILES, WARNINGS
from nmpc_codegen.runtime.compilers import find_compiler

UNPRUNED = (*WARNINGS, "-Wno-unused-function")
SCALARS = {"double": np.float64, "single": np.float32}


@functools.cache
def build_directory() -> tempfile.TemporaryDirectory[str]:
    """Return the temporary directory of this process, which is removed at exit."""
    return tempfile.TemporaryDirectory(prefix="c_harness_")


def shared_library(files: Mapping[str, str], main: str, warnings: Sequence[str] = WARNINGS) -> ctypes.CDLL:
    """Compile the file ``main`` among ``files`` and load it."""
    folder = Path(tempfile.mkdtemp(dir=build_directory().name))
    for path, text in files.items():
        (folder / path).write_text(text, encoding="utf-8")
    words = [*find_compiler(), *PROFILES["test"].flags, *warnings, "-shared", "-fPIC", main, "-o", "library.so", "-lm"]
    run = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return ctypes.CDLL(str(folder / "library.so"))


class Routines:
    """Tests call printed routines with NumPy vectors; a key distinguishes routines with equal names."""

    def __init__(self, routines: Mapping[str, Routine], precision: str = "double") -> None:
        self.routines = dict(routines)
        self.scalar = SCALARS[precision]
        style = CStyle("real", precision == "single")
        ctype = {"double": "double", "single": "float"}[precision]
        texts = ["#include <math.h>", "#include <stddef.h>", "#include <string.h>", f"typedef {ctype} real;"]
        for key, routine in self.routines.items():
            texts.append(print_routine(routine, style).replace(routine.name, key))
            ports = [f"const real *{p.name}" for p in routine.inputs] + [f"real *{p.name}" for p in routine.outputs]
            names = ", ".join(
                f"(real(*)[{p.cols}]){p.name}" if p.cols else p.name for p in (*routine.reads, *routine.writes)
            )
            passed = {*routine.reads, *routine.writes}
            unused = "".join(f"(void){p.name}; " for p in (*routine.inputs, *routine.outputs) if p not in passed)
            texts.append(f"void call_{key}({', '.join(ports)});")
            texts.append(f"void call_{key}({', '.join(ports)}) {{ {unused}{key}({names}); }}")
        # Only a package drops functions whose calls are all expanded.
        self.library = shared_library({"routines.c": "\n".join(texts) + "\n"}, "routines.c", UNPRUNED)

    def __call__(self, key: str, *inputs: object) -> list[np.ndarray]:
        """Return the outputs in their shapes; entries that the routine does not write are zero."""
        routine = self.routines[key]
        arguments = []
        for port, value in zip(routine.inputs, inputs, strict=True):
            array = np.ascontiguousarray(value, dtype=self.scalar).reshape(-1)
            assert array.size == port.size, f"{key}: {port.name}"
            arguments.append(array if array.size else np.zeros(1, self.scalar))
        shapes = [(p.rows, p.cols) if p.cols else (p.rows,) for p in routine.outputs]
        outputs = [np.zeros(shape, self.scalar) if np.prod(shape) else np.zeros(1, self.scalar) for shape in shapes]
        self.raw(key, *arguments, *outputs)
        return [
            o.reshape(shape) if np.prod(shape) else np.zeros(shape) for o, shape in zip(outputs, shapes, strict=True)
        ]

    def raw(self, key: str, *arrays: np.ndarray) -> None:
        """Call with exactly these arrays, which may overlap."""
        getattr(self.library, f"call_{key}")(*(ctypes.c_void_p(a.ctypes.data) for a in arrays))


def memory_layout(module: CModule) -> np.dtype[Any]:
    """Return the NumPy type of the solver struct, by NumPy's implementation of the C layout rules."""
    types: dict[str, Any] = {"real": SCALARS[module.precision], "int32": np.int32}
    for struct in module.structs:
        members = [(f.name, np.dtype(types[f.ctype]), f.padded) for f in struct.fields]
        types[struct.name] = union_dtype(members) if struct.union else np.dtype(members, align=True)
    found: np.dtype[Any] = types["solver"]
    return found


def module_of(ocp: OCP, options: Options | None = None, name: str | None = None) -> CModule:
    """Run the pipeline up to the CModule."""
    return lower(model_of(*read(ocp, options)), name)


class Package:
    """A package gives access to its static functions.

    ``call(f)`` runs f(s), ``self["node"]`` is the view of a member of s.
    """

    def __init__(self, module: CModule, functions: Sequence[str] = (), sources: Sources | None = None) -> None:
        self.module = module
        self.sources = sources or text_of(module)
        p = module.name
        lines = [
            f'#include "{p}.c"',
            "int size_of_solver(void);",
            f"int size_of_solver(void) {{ return (int)sizeof({p}_solver_t); }}",
        ]
        for function in functions:
            lines.append(f"void call_{function}({p}_solver_t *s);")
            lines.append(f"void call_{function}({p}_solver_t *s) {{ {function}(s); }}")
        self.library = shared_library({**self.sources, "main.c": "\n".join(lines) + "\n"}, "main.c")
        self.memory = np.zeros((), memory_layout(module))
        assert self.library.size_of_solver() == self.memory.nbytes
        getattr(self.library, f"{p}_init")(self.pointer)

    @property
    def pointer(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.memory.ctypes.data)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a member; a member of size 0, which does not exist, is an empty array."""
        return self.memory[name] if name in self.memory.dtype.names else np.zeros(0)

    def call(self, function: str) -> None:
        getattr(self.library, f"call_{function}")(self.pointer)
