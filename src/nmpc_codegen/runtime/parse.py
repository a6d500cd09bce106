"""Strict parser of <name>.json: every entry knows its place in the file and checks its own type and range.

As the origin of the text is unknown, everything that is wrong with it raises a ControllerError that names the entry.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

from nmpc_codegen.errors import ControllerError

FORMAT = 1
MAX_CHARACTERS = 2**24
MAX_INTEGER = 2**31 - 1
MAX_SHOWN = 40  # characters of a name in an error
ELEMENT = re.compile(r"[A-Za-z_][A-Za-z_0-9]*(\[[0-9]+\](_start|_end)?)?")

Word = TypeVar("Word", bound=str)


def read(text: str) -> Entry:
    """The whole text of <name>.json as an Entry.

    Raises:
        ControllerError: the text is too long, is not JSON, or has another format.
    """
    if len(text) > MAX_CHARACTERS:
        raise ControllerError(f"the package description has {len(text)} characters; expected at most {MAX_CHARACTERS}")
    try:
        raw = json.loads(text, object_pairs_hook=_object, parse_constant=_constant)
        version = raw["format"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        what = "too deeply nested" if isinstance(error, RecursionError) else str(error)
        raise ControllerError(f"the package description is not the JSON that export() writes: {what}") from error
    if type(version) is not int or version != FORMAT:
        raise ControllerError(
            f"the package description has format {reprlib.repr(version)}, this version reads {FORMAT}: export it again"
        )
    return Entry("", raw)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the entry {reprlib.repr(next(n for n in names if names.count(n) > 1))} occurs twice")
    return found


def _constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")


@dataclass(frozen=True)
class Entry:
    """A value of the description and its place, e.g. ``rows[2].nodes``."""

    place: str
    value: Any

    def fail(self, expected: str) -> NoReturn:
        """Raise ControllerError for an entry with a wrong value."""
        self.refuse(f"is {reprlib.repr(self.value)}; expected {expected}")

    def refuse(self, what: str) -> NoReturn:
        """Raise ControllerError about this place."""
        raise ControllerError(f"the package description: {self.place or 'the whole'} {what}: export it again")

    def members(self, required: Iterable[str], optional: Iterable[str] = ()) -> dict[str, Entry]:
        """Entries of an object, which has all required ones and possibly optional ones; any other one is refused."""
        required, found = tuple(required), self.object()
        for name in required:
            if name not in found:
                Entry(self._inner(name), None).refuse("is missing")
        for name in found:
            if name not in required and name not in optional:
                Entry(self._inner(reprlib.repr(name)), None).refuse("is an entry that this version does not know")
        return found

    def object(self) -> dict[str, Entry]:
        """Entries of an object."""
        if not isinstance(self.value, dict):
            self.fail("an object")
        return {name: Entry(self._inner(name[:MAX_SHOWN]), value) for name, value in self.value.items()}

    def _inner(self, name: str) -> str:
        return f"{self.place}.{name}" if self.place else name

    def items(self, count: int | None = None) -> tuple[Entry, ...]:
        """Entries of a list, of the length ``count`` if it is given."""
        if not isinstance(self.value, list):
            self.fail("a list")
        if count is not None and len(self.value) != count:
            self.fail(f"{count} entries, not {len(self.value)}")
        return tuple(Entry(f"{self.place}[{i}]", value) for i, value in enumerate(self.value))

    def integer(self, low: int = 0, high: int = MAX_INTEGER) -> int:
        """An integer in low..high; True and False are refused."""
        if type(self.value) is not int or not low <= self.value <= high:
            self.fail(f"an integer in {low}..{high}")
        return int(self.value)

    def number(self) -> float:
        """A finite number."""
        if type(self.value) not in (int, float):
            self.fail("a number")
        try:
            number = float(self.value)
        except OverflowError:
            self.fail("a finite number")
        return number if math.isfinite(number) else self.fail("a finite number")

    def bound(self) -> float:
        """A finite number, "inf" or "-inf"."""
        return float(self.value) if self.value in ("inf", "-inf") else self.number()

    def text(self) -> str:
        """A string that can be printed (a lone surrogate cannot)."""
        if not isinstance(self.value, str):
            self.fail("a text")
        try:
            self.value.encode()
        except UnicodeEncodeError:
            self.fail("a text of Unicode characters")
        return self.value

    def identifier(self) -> str:
        """An identifier of C."""
        if not (self.text().isascii() and self.text().isidentifier()):
            self.fail("a C identifier")
        return self.text()

    def element(self) -> str:
        """The name of an element, ``v`` or ``r[0]``, or of a row that holds at one end only, ``r[0]_end``."""
        if ELEMENT.fullmatch(self.text()) is None:
            self.fail("a name like v or r[0]")
        return self.text()

    def word(self, allowed: tuple[Word, ...]) -> Word:
        """One of the allowed words."""
        for word in allowed:
            if isinstance(self.value, str) and self.value == word:
                return word
        return self.fail(f"one of {', '.join(allowed)}")

    def flag(self) -> bool:
        """true or false."""
        if not isinstance(self.value, bool):
            self.fail("true or false")
        return self.value
