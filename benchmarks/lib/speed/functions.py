"""math_ulp: exp, log, sin, cos and sqrt in lanes against long double."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.lib.report import Report
from nmpc_codegen.host.lanes import transpose
from nmpc_codegen.lowering.parts import read_part, resolve
from nmpc_codegen.runtime.build import PROFILES, find_compiler, host

#: Function -> its values in long double.
EXACT: Mapping[str, Callable[[Any], Any]] = {
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "sqrt": np.sqrt,
}
PARTS = ("vector", "constants", "exp", "log", "sincos", "sqrt")
SAMPLES = 1_000_000
LIMIT = 2.0


def library(folder: Path, single: bool, lanes: int, avx512: bool, flags: tuple[str, ...]) -> ctypes.CDLL:
    """<name>(x, y, n): y = the function of x, n a multiple of ``lanes``."""
    real, suffix = ("float", "f") if single else ("double", "")
    sizes = {"HOST_LANES": lanes, "HOST_AVX512": int(avx512), "SINGLE": int(single)}
    texts = [resolve(read_part(f"lanes/{part}.c", lambda path: transpose(lanes)), sizes) for part in PARTS]
    head = "#include <math.h>\n#include <stdint.h>\n#include <string.h>\n"
    head += f"typedef {real} real_t;\n#define R(x) ((real_t)(x))\n#define HOST_LANES {lanes}\n"
    head += "".join(f"#define {name.upper()} {name}{suffix}\n" for name in ("sqrt", "fabs", "sin", "cos"))
    for name in EXACT:
        texts.append(
            f"void {name}_of(const real_t *x, real_t *y, long n) {{ for (long i = 0; i < n; i += HOST_LANES) {{ "
            f"lanes_t v; memcpy(&v, x + i, sizeof v); v = lanes_{name}(v); memcpy(y + i, &v, sizeof v); }} }}"
        )
    (folder / "functions.c").write_text(head + "\n".join(texts))
    command = [*find_compiler(), "-shared", "-fPIC", "-Wno-psabi", *flags, "functions.c", "-o", "functions.so", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "functions.so"))


def evaluate(loaded: ctypes.CDLL, name: str, x: np.ndarray) -> np.ndarray:
    """The function of a vector whose length is a multiple of the lanes."""
    y = np.empty_like(x)
    loaded[f"{name}_of"](x.ctypes.data_as(ctypes.c_void_p), y.ctypes.data_as(ctypes.c_void_p), ctypes.c_long(x.size))
    return y


def ulps(got: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Errors in units of the last place of the rounded exact value; infinite where only one is NaN or infinite."""
    with np.errstate(all="ignore"):
        rounded = exact.astype(got.dtype)
        unit = np.spacing(np.abs(rounded)).astype(np.longdouble)
        error = np.abs((got.astype(np.longdouble) - exact) / unit)
    same = (got == rounded) | (np.isnan(got) & np.isnan(rounded))
    return np.where(same & ~np.isfinite(got), 0.0, np.where(np.isfinite(got) & np.isfinite(rounded), error, np.inf))


def arguments(name: str, dtype: Any, random: np.random.Generator, n: int = SAMPLES) -> np.ndarray:
    """Where the function varies, all magnitudes, and special values."""
    info = np.finfo(dtype)
    near = random.uniform(-4.0, 4.0, n)
    with np.errstate(all="ignore"):
        wide = np.exp(random.uniform(np.log(info.tiny), np.log(info.max), n)) * random.choice([-1, 1], n)
    medium = random.uniform(-1.1 * np.log(info.max), 1.1 * np.log(info.max), n)
    special = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, info.max, info.tiny, info.smallest_subnormal] * 8
    return np.concatenate([near, wide, medium, special]).astype(dtype)


def measure(report: Report) -> None:
    """Both precisions, with and without contraction."""
    machine = host(None, "fast")
    for precision, dtype in (("double", np.float64), ("single", np.float32)):
        for profile in ("fast", "verify"):
            avx512 = machine.avx512 and profile == "fast"
            with tempfile.TemporaryDirectory() as folder:
                loaded = library(Path(folder), precision == "single", 8, avx512, PROFILES[profile].flags)
                for name, exact in EXACT.items():
                    x = arguments(name, dtype, np.random.default_rng(1))
                    with np.errstate(all="ignore"):
                        worst = ulps(evaluate(loaded, name, x), exact(x.astype(np.longdouble))).max()
                    report.add(
                        "math_ulp",
                        worst,
                        "ulp",
                        case=f"{name}, {precision}",
                        n=x.size,
                        limit=LIMIT,
                        profile=profile,
                        lanes=8,
                    )
