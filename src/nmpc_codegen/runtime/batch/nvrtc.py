"""NVRTC, the run-time compiler of CUDA, compiles a kernel to machine code of an architecture; it needs no GPU."""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nmpc_codegen.errors import BuildError
from nmpc_codegen.runtime.build import SHOWN_LINES
from nmpc_codegen.runtime.cache import PRODUCT, entry
from nmpc_codegen.runtime.extras import extra

#: The package that contains the library.
HOME = "nvidia.cuda_nvrtc"


def compile_kernel(text: str, architecture: str, exact: bool) -> Path:
    """Compile a kernel, unless it is in the cache, and return the path of the machine code (cubin).

    Args:
        text: the kernel in CUDA C, without #include.
        architecture: e.g. "sm_90".
        exact: a * b + c is not contracted, as in the profiles "verify" and "test" of processors.

    Raises:
        ExtraError: NVRTC is not installed.
        BuildError: NVRTC rejects the text.
    """
    library = _library()
    options = [f"--gpu-architecture={architecture}", "-default-device", "--std=c++17"]
    options += ["--fmad=false"] if exact else []
    key = hashlib.sha256("\0".join([text, *options, _version(library)]).encode()).hexdigest()[:32]
    return entry(f"_nmpc_kernel_{key}.cubin", lambda folder: _store(library, text, options, folder / PRODUCT))


def _library() -> Any:
    """Load the installed library."""
    folders = list(extra(HOME, 'batch(device="cuda")').__path__)
    found = [path for folder in folders for path in sorted(Path(folder).glob("lib/libnvrtc.so.*"))]
    if not found:
        raise BuildError(f"{HOME} is installed without lib/libnvrtc.so in {', '.join(folders)}")
    return ctypes.CDLL(str(found[-1]))


def _version(library: Any) -> str:
    major, minor = ctypes.c_int(), ctypes.c_int()
    library.nvrtcVersion(ctypes.byref(major), ctypes.byref(minor))
    return f"{major.value}.{minor.value}"


def _store(library: Any, text: str, options: Sequence[str], path: Path) -> None:
    """Compile a text and write the machine code to ``path``."""
    program = ctypes.c_void_p()
    _expect(library.nvrtcCreateProgram(ctypes.byref(program), text.encode(), b"kernel.cu", 0, None, None), "create")
    try:
        words = (ctypes.c_char_p * len(options))(*(option.encode() for option in options))
        if library.nvrtcCompileProgram(program, len(options), words):
            lines = _read(library, program, "ProgramLog").decode(errors="replace").splitlines()
            raise BuildError("NVRTC refuses the kernel:\n" + "\n".join(lines[:SHOWN_LINES]))
        path.write_bytes(_read(library, program, "CUBIN"))
    finally:
        library.nvrtcDestroyProgram(ctypes.byref(program))


def _read(library: Any, program: Any, what: str) -> bytes:
    size = ctypes.c_size_t()
    _expect(getattr(library, f"nvrtcGet{what}Size")(program, ctypes.byref(size)), what)
    data = ctypes.create_string_buffer(size.value)
    _expect(getattr(library, f"nvrtcGet{what}")(program, data), what)
    return data.raw


def _expect(result: int, what: str) -> None:
    if result:
        raise BuildError(f"NVRTC fails ({what}): error {result}")
