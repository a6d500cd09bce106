"""The package raises these errors and warnings on purpose."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path

__all__ = [
    "BuildError",
    "ControllerError",
    "DerivativeError",
    "ExportError",
    "ExtraError",
    "NmpcError",
    "OptionError",
    "ProblemError",
    "ProblemWarning",
]


class NmpcError(Exception):
    """All errors of this package have this base class; the message names what is wrong and what was expected."""


class ProblemError(NmpcError, ValueError):
    """The optimal control problem is stated wrongly."""


class OptionError(NmpcError, ValueError):
    """An option has a value that is not allowed, or two options clash."""


class BuildError(NmpcError, RuntimeError):
    """The C compiler is missing or rejected the generated code."""


class ExportError(NmpcError, OSError):
    """A folder cannot be written to, or contains something that export() must not replace."""


class ControllerError(NmpcError, RuntimeError):
    """A controller was called wrongly, or it failed with on_failure="raise"."""


class ExtraError(NmpcError, ImportError):
    """A package that only some functions need is not installed; the message names the extra that installs it."""


class DerivativeError(NmpcError, ValueError):
    """A derivative function was called wrongly, or its result is not finite."""


class ProblemWarning(UserWarning):
    """The problem is valid, but a part of it is likely to give poor results."""


_PACKAGE = f"{Path(__file__).parent}{os.sep}"


def warn(text: str, category: type[Warning] = ProblemWarning) -> None:
    """Issue a warning at the line outside of this package that called it."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)
