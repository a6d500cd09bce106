"""Matrices in options are checked for shape and definiteness."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from nmpc_codegen.errors import OptionError

#: Smallest eigenvalue of a positive definite matrix with unit diagonal; eigenvalues of smaller magnitude count as 0.
DEFINITE = 1e-12


def refuse_shape(value: ArrayLike, shape: tuple[int, ...], name: str, meaning: str) -> None:
    """Raise OptionError unless the value has this shape."""
    found = np.shape(value)
    if found != shape:
        raise OptionError(f"{name}: shape {found}; expected {shape}, {meaning}")


def refuse_indefinite(value: ArrayLike | None, name: str, *, strictly: bool = False) -> None:
    """Raise OptionError unless the matrix is positive semidefinite, or definite if ``strictly``; None is skipped.

    The test is made in units of the variables, that is, with unit diagonal.
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
