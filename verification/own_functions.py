"""The elementary functions of math="own" and of lanes are compiled separately, and compared with long double."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from nmpc_codegen.ir.printing.c_style import unit_style
from nmpc_codegen.lowering.lanes.nodes import in_lanes, transpose
from nmpc_codegen.lowering.unit.read import MATH, MATH_IN_LANES, own_names, read_part
from nmpc_codegen.package.program import OF_ONE, OF_TWO
from nmpc_codegen.runtime.compilers import find_compiler

#: Functions that have no text for lanes.
SCALAR_ONLY = ("fmod",)
LANE_PARTS = ("vector", "sqrt", "large_angles")
SAMPLES = 1_000_000
LIMIT = 2.0


def names() -> list[str]:
    """Return the names of all functions."""
    return sorted({*own_names(), "sqrt"})


def source(single: bool, lanes: int, avx512: bool) -> str:
    """Return a unit with own_<name>_of(x, y, z, n) and lanes_<name>_of(): z = the function of x and y."""
    real, suffix = ("float", "f") if single else ("double", "")
    sizes = {"VECTOR_LANES": lanes, "AVX512": int(avx512), "SINGLE": int(single)}
    head = (
        "#include <immintrin.h>\n" if avx512 else ""
    ) + "#include <math.h>\n#include <stdint.h>\n#include <string.h>\n"
    head += (
        f"typedef {real} real_t;\n#define R(x) ((real_t)(x))\n#define INF R(INFINITY)\n#define VECTOR_LANES {lanes}\n"
    )
    head += "".join(f"#define {name.upper()} {name}{suffix}\n" for name in ("sqrt", "fabs"))
    texts = [head, read_part(MATH, sizes=sizes)]
    if lanes > 1:
        texts += [read_part(f"lanes/{part}.c", lambda path: transpose(lanes), sizes) for part in LANE_PARTS]
        texts.append(in_lanes(own_names(MATH_IN_LANES), sizes, unit_style("single" if single else "double")))
    for name in names():
        second = ", w" if name in OF_TWO else ""
        loads = "memcpy(&v, x + i, sizeof v); memcpy(&w, y + i, sizeof w)"
        for prefix, ctype, width in (("own", "real_t", "1"), ("lanes", "lanes_t", "VECTOR_LANES")):
            if prefix == "lanes" and (lanes == 1 or name in SCALAR_ONLY):
                continue
            texts.append(
                f"void {prefix}_{name}_of(const real_t *x, const real_t *y, real_t *z, long n) "
                f"{{ for (long i = 0; i < n; i += {width}) {{ {ctype} v, w; {loads}; "
                f"v = {prefix}_{name}(v{second}); memcpy(z + i, &v, sizeof v); }} }}"
            )
    return "\n".join(texts)


def library(
    folder: Path, single: bool, lanes: int, avx512: bool, flags: tuple[str, ...], compiler: tuple[str, ...] = ()
) -> ctypes.CDLL:
    """Compile and load the unit."""
    (folder / "functions.c").write_text(source(single, lanes, avx512))
    command = [*(compiler or find_compiler()), "-shared", "-fPIC", "-Wno-psabi", *flags, "functions.c"]
    subprocess.run([*command, "-o", "functions.so", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "functions.so"))


def evaluate(loaded: ctypes.CDLL, name: str, x: np.ndarray, y: np.ndarray | None = None) -> np.ndarray:
    """Evaluate own_<name> or lanes_<name> for vectors whose length is a multiple of the lanes."""
    z = np.empty_like(x)
    addresses = [a.ctypes.data_as(ctypes.c_void_p) for a in (x, x if y is None else y, z)]
    loaded[f"{name}_of"](*addresses, ctypes.c_long(x.size))
    return z


def ulps(got: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return errors in units of the last place of the rounded exact value.

    Infinite where only one is NaN or infinite.
    """
    with np.errstate(all="ignore"):
        rounded = exact.astype(got.dtype)
        unit = np.spacing(np.abs(rounded)).astype(np.longdouble)
        error = np.abs((got.astype(np.longdouble) - exact) / unit)
    same = (got == rounded) | (np.isnan(got) & np.isnan(rounded))
    return np.where(same & ~np.isfinite(got), 0.0, np.where(np.isfinite(got) & np.isfinite(rounded), error, np.inf))


def special(dtype: Any) -> np.ndarray:
    """Return zeros, infinities, NaN, the ends of the range, and numbers near which functions change their form."""
    info, digits = np.finfo(dtype), float(2 ** np.finfo(dtype).nmant)
    values = [0.0, 0.5, 1.0, 2.0, 3.0, np.inf, info.max, info.tiny, info.smallest_subnormal, 1e15, np.pi, 11 * np.pi]
    values += [digits / 2, digits, digits + 1, 2 * digits - 1, 2 * digits, 4 * digits, 1.5e6, 3000.0, 0.25, 1e-300]
    with np.errstate(all="ignore"):
        return np.array([np.nan, *values, *(-v for v in values), 0.9, 1.1, 1e-5, -0.9]).astype(dtype)


def arguments(dtype: Any, random: np.random.Generator, n: int) -> np.ndarray:
    """Draw arguments where functions vary, of all magnitudes, subnormal, in the range of exp, and special ones."""
    info = np.finfo(dtype)
    near, unit = random.uniform(-4.0, 4.0, n), random.uniform(-1.0, 1.0, n)
    lowest, highest = np.log(float(info.tiny)) - info.nmant * np.log(2), np.log(float(info.max))
    wide = np.exp(random.uniform(max(lowest, -744.0), highest, n)) * random.choice([-1, 1], n)
    medium = random.uniform(-1.1 * highest, 1.1 * highest, n)
    return _whole(np.concatenate([near, unit, wide, medium, special(dtype)]).astype(dtype))


def pairs(dtype: Any, random: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw pairs of arguments: any, with powers in the range, with integer exponents, all pairs of special values."""
    x, y = arguments(dtype, random, n), arguments(dtype, random, n)
    base = (
        np.exp(random.uniform(-600, 600, n)).astype(dtype)
        if dtype == np.float64
        else np.exp(random.uniform(-80, 80, n))
    )
    largest = 1.1 * np.log(float(np.finfo(dtype).max))
    exponent = random.uniform(-largest, largest, n) / np.log(base)
    integers, few = np.round(random.uniform(-9, 9, n)), random.uniform(-5, 5, n)
    a, b = np.meshgrid(special(dtype), special(dtype))
    left = np.concatenate([x, base, few, a.ravel()]).astype(dtype)
    right = np.concatenate([random.permutation(y), exponent, integers, b.ravel()]).astype(dtype)
    return _whole(left), _whole(right)


def _whole(x: np.ndarray) -> np.ndarray:
    """Append copies of the last element, so that the length is a multiple of all numbers of lanes."""
    return np.concatenate([x, np.repeat(x[-1:], -x.size % 8)])


def exact(name: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the values in long double; fmod, whose result is a number of the type itself, in that type."""
    with np.errstate(all="ignore"):
        if name == "fmod":
            return np.asarray(np.fmod(x, y)).astype(np.longdouble)
        if name in OF_TWO:
            return np.asarray(OF_TWO[name](x.astype(np.longdouble), y.astype(np.longdouble)))
        return np.asarray(OF_ONE[name](x.astype(np.longdouble)))
