"""Each option has one rule for its values, which validates them, words the error message and lists the choices."""

from __future__ import annotations

import dataclasses
import reprlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import OptionError

#: Largest integer that becomes a C int.
INT_MAX = 2**31 - 1

#: Relative asymmetry of a matrix that counts as rounding.
ASYMMETRY = 1e-9

_KEY = "allowed"


class Rule(Protocol):
    """A rule tests the values of an option; its text completes "expected ..."."""

    def convert(self, value: Any) -> Any:
        """Return the object for a word, and any other value unchanged."""
        ...

    def takes(self, value: Any) -> bool:
        """Return True if the converted value is allowed."""
        ...


@dataclass(frozen=True)
class Words:
    """The value is one of the given words; None may be among them."""

    words: tuple[str | None, ...]

    def convert(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        return (value is None or isinstance(value, str)) and value in self.words

    def __str__(self) -> str:
        return "one of " + ", ".join(map(str, self.words))


@dataclass(frozen=True)
class Flag:
    """The value is True or False."""

    optional: bool = False

    def convert(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        return isinstance(value, bool) or (value is None and self.optional)

    def __str__(self) -> str:
        return "True, False or None" if self.optional else "True or False"


@dataclass(frozen=True)
class Whole:
    """The value is an integer from ``least`` to ``most``."""

    most: int = INT_MAX
    optional: bool = False
    least: int = 1

    def convert(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        if value is None:
            return self.optional
        return isinstance(value, int) and not isinstance(value, bool) and self.least <= value <= self.most

    def __str__(self) -> str:
        return f"an integer >= {self.least} and <= {self.most}" + (" or None" if self.optional else "")


@dataclass(frozen=True)
class Number:
    """The value is a finite number > 0 (>= 0 if ``closed``)."""

    closed: bool = False
    optional: bool = False
    unit: str = ""

    def convert(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        if value is None:
            return self.optional
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return 0 < value <= sys.float_info.max or (self.closed and value == 0)

    def __str__(self) -> str:
        text = f"a finite number {'>=' if self.closed else '>'} 0"
        text += f" ({self.unit})" if self.unit else ""
        return text + (" or None" if self.optional else "")


@dataclass(frozen=True)
class Named:
    """The value is an object of one of the given classes, or a word for such an object."""

    words: Mapping[str, Any]
    classes: tuple[type, ...]

    def convert(self, value: Any) -> Any:
        return self.words[value] if isinstance(value, str) and value in self.words else value

    def takes(self, value: Any) -> bool:
        return isinstance(value, self.classes) or (value is None and None in self.words.values())

    def __str__(self) -> str:
        objects = ", ".join(f"{cls.__name__}(...)" for cls in self.classes)
        return f"one of {', '.join(self.words)}; in Python also {objects}"


@dataclass(frozen=True)
class Matrix:
    """The value is a symmetric matrix of finite numbers, or None."""

    def convert(self, value: Any) -> Any:
        """Return the matrix as tuples of numbers, so that options are equal by value.

        An asymmetry that is rounding is removed: (value + value') / 2.
        """
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
class AllowedPoint:
    """The value is a pair of vectors (x, u) of finite numbers, or None."""

    def convert(self, value: Any) -> Any:
        """Return the vectors as tuples of numbers."""
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


def option(default: Any, rule: Rule) -> Any:
    """Return the dataclass field of an option, with its default value and the rule for its values."""
    return field(default=default, metadata={_KEY: rule})


def rules(part: Any) -> dict[str, Rule | None]:
    """Return {name of an option: rule} of a dataclass or instance; None for a field without a rule."""
    fields = dataclasses.fields(part) if dataclasses.is_dataclass(part) else ()
    return {f.name: f.metadata.get(_KEY) for f in fields}


def check_options(part: Any, key: str) -> None:
    """Convert words and refuse values that are not allowed.

    ``key`` is the prefix on the command line, "" at the top level.

    Raises:
        OptionError: a value is not allowed; the message names class, option, value, allowed values, and the flag.
    """
    for name, rule in _has_rules(part):
        given = getattr(part, name)
        value = rule.convert(given)
        if not rule.takes(value):
            flag = f"--set {key}.{name}=..." if key else f"--set {name}=..."
            raise OptionError(f"{type(part).__name__}.{name}: {show(given)}; expected {rule} ({flag})")
        if value is not given:
            object.__setattr__(part, name, value)


def _has_rules(part: Any) -> Iterator[tuple[str, Rule]]:
    return ((name, rule) for name, rule in rules(part).items() if rule is not None)


def show(value: Any) -> str:
    """Return a short repr of any value, even if its own repr fails or is very long."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 120
    try:
        return short.repr(value)
    except Exception:  # an integer that is too long, or an object whose __repr__ raises
        return f"a value of type {type(value).__name__}"


def _numbers(value: Any) -> NDArray[np.float64] | None:
    """Return the value as an array of finite numbers, None for anything else."""
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


def _symmetric(array: NDArray[np.float64]) -> bool:
    size = float(np.max(np.abs(array)))
    return bool(np.max(np.abs(array - array.T)) <= ASYMMETRY * size)
