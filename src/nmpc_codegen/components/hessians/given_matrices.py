"""Matrices and points that an option holds as tuples: their rules, and the checks of their shape and definiteness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Array

#: Relative asymmetry that counts as rounding.
ASYMMETRY = 1e-9
#: Smallest eigenvalue of a positive definite matrix with unit diagonal; less, and not below its negative, counts as 0.
DEFINITE = 1e-12


@dataclass(frozen=True)
class Matrix:
    """A symmetric matrix of finite numbers, or None."""

    def converted(self, value: Any) -> Any:
        """Tuples of numbers, so that options are equal by value; (value + value') / 2 if that differs by rounding."""
        array = _numbers(value)
        if array is None or array.ndim != 2 or array.shape[0] != array.shape[1] or not _symmetric(array):
            return value
        return tuple(map(tuple, ((array + array.T) / 2).tolist()))

    def takes(self, value: Any) -> bool:
        array = _numbers(value)
        return value is None or (array is not None and isinstance(value, tuple) and array.ndim == 2)

    def __str__(self) -> str:
        return "a symmetric matrix of finite numbers, or None"


@dataclass(frozen=True)
class Point:
    """A pair of vectors (x, u) of finite numbers, or None."""

    def converted(self, value: Any) -> Any:
        """Tuples of numbers."""
        if not isinstance(value, tuple | list) or len(value) != 2:
            return value
        vectors = [_numbers(part) for part in value]
        if not all(vector is not None and vector.ndim == 1 for vector in vectors):
            return value
        return tuple(tuple(vector.tolist()) for vector in vectors if vector is not None)

    def takes(self, value: Any) -> bool:
        return value is None or (
            isinstance(value, tuple)
            and len(value) == 2
            and all(isinstance(part, tuple) and _numbers(part) is not None for part in value)
        )

    def __str__(self) -> str:
        return "a pair of vectors (x_s, u_s) of finite numbers, or None"


def refuse_shape(value: Any, shape: tuple[int, ...], name: str, meaning: str) -> None:
    """Raise OptionError unless the value has this shape."""
    found = np.shape(value)
    if found != shape:
        raise OptionError(f"{name}: shape {found}; expected {shape}, {meaning}")


def refuse_indefinite(value: Any, name: str, *, strictly: bool = False) -> None:
    """Raise OptionError unless the matrix is positive semidefinite, or definite if ``strictly``; None is skipped.

    It is judged in units of its variables, that is, with unit diagonal.
    """
    if value is None:
        return
    matrix = np.asarray(value, dtype=float)
    word = "definite" if strictly else "semidefinite"
    diagonal = np.diag(matrix)
    worst = int(np.argmin(diagonal))
    if diagonal[worst] < 0 or (strictly and diagonal[worst] == 0):
        raise OptionError(f"{name}: entry {worst} of the diagonal is {diagonal[worst]:.3g}; expected positive {word}")
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    unit = matrix / scale / scale[:, None]
    least = float(np.linalg.eigvalsh(unit).min())
    if not least >= (DEFINITE if strictly else -DEFINITE):
        raise OptionError(f"{name}: smallest eigenvalue {least:.3g} with unit diagonal; expected positive {word}")


def _numbers(value: Any) -> Array | None:
    """The value as an array of finite numbers; None if it is something else."""
    if isinstance(value, str | bytes) or value is None:
        return None
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "fiu" or given.size == 0:
            return None
        array = given.astype(float)
    except (TypeError, ValueError, OverflowError):
        return None
    return array if bool(np.all(np.isfinite(array))) else None


def _symmetric(array: Array) -> bool:
    size = float(np.max(np.abs(array)))
    return bool(np.max(np.abs(array - array.T)) <= ASYMMETRY * size)


