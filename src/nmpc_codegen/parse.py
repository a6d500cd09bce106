"""The text of <name>.json -> Description. Every entry is checked: its type, its range and that it fits the others.

The text is data of unknown origin: whatever is wrong with it is one ControllerError that names the entry. That it
describes the compiled code as well is checked in library.py.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from nmpc_codegen.description import INTEGERS, REAL, Description, Dimensions, Member, RowInfo, SignalInfo
from nmpc_codegen.errors import ControllerError

FORMAT = 1
MAX_CHARACTERS = 2**24
MAX_INTEGER = 2**31 - 1
MAX_SHOWN = 40  # characters of a name in an error
ELEMENT = re.compile(r"[A-Za-z_][A-Za-z_0-9]*(\[[0-9]+\](_start|_end)?)?")
LAYOUTS = ("fixed", "shared", "node")
ONLINE = ("reference", "weight", "bounds", "parameter")
DIMENSIONS = ("N", "NX", "NU", "NP", "NY", "NY_N", "NH", "NH_N", "NR")
ROW_KINDS = ("control", "state", "general", "coupled")
ENTRIES = (
    *("format", "name", "precision", "sizes", "structs", "states", "controls", "parameters", "rows", "y_names"),
    *("y_names_N", "dt", "discrete", "statuses", "shift", "online", "options", "report"),
)


def parse(text: str) -> Description:
    """Read the text of <name>.json.

    Raises:
        ControllerError: the text is no package description, one of another format, or one that contradicts itself.
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
    return _description(Entry("", raw))


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the entry {reprlib.repr(next(n for n in names if names.count(n) > 1))} stands there twice")
    return found


def _constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")


@dataclass(frozen=True)
class Entry:
    """A value of the description and where it stands: ``rows[2].nodes``."""

    place: str
    value: Any

    def fail(self, expected: str) -> NoReturn:
        """The one error for everything that is wrong with an entry."""
        self.refuse(f"is {reprlib.repr(self.value)}; expected {expected}")

    def refuse(self, what: str) -> NoReturn:
        """An error about this place."""
        raise ControllerError(f"the package description: {self.place or 'the whole'} {what}: export it again")

    def members(self, required: Iterable[str], optional: Iterable[str] = ()) -> dict[str, Entry]:
        """Entries of an object that has exactly these."""
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
        """Entries of a list, of that length if one is given."""
        if not isinstance(self.value, list):
            self.fail("a list")
        if count is not None and len(self.value) != count:
            self.fail(f"{count} entries, not {len(self.value)}")
        return tuple(Entry(f"{self.place}[{i}]", value) for i, value in enumerate(self.value))

    def integer(self, low: int = 0, high: int = MAX_INTEGER) -> int:
        """An integer in low..high; True is none."""
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
        """The name of an element: ``v`` or ``r[0]``."""
        if ELEMENT.fullmatch(self.text()) is None:
            self.fail("a name like v or r[0]")
        return self.text()

    def word(self, allowed: Iterable[str]) -> str:
        """One of a few words."""
        if not isinstance(self.value, str) or self.value not in tuple(allowed):
            self.fail(f"one of {', '.join(allowed)}")
        return self.value

    def flag(self) -> bool:
        """true or false."""
        if not isinstance(self.value, bool):
            self.fail("true or false")
        return self.value


def _description(whole: Entry) -> Description:
    raw = whole.members(ENTRIES, ("seal",))
    sizes = raw["sizes"].members(DIMENSIONS, raw["sizes"].object())
    dims = _dimensions(sizes)
    if raw["shift"].value is not None:
        raw["shift"].text()
    raw["report"].object()
    return Description(
        name=raw["name"].identifier(),
        precision=raw["precision"].word(REAL),
        dims=dims,
        sizes={name: size.integer(-MAX_INTEGER) for name, size in sizes.items()},
        structs=_structs(raw["structs"]),
        states=_signals(raw["states"], dims.nx),
        controls=_signals(raw["controls"], dims.nu),
        parameters=_signals(raw["parameters"], dims.np),
        rows=_rows(raw["rows"], dims),
        y_names=tuple(name.text() for name in raw["y_names"].items(dims.ny)),
        y_names_N=tuple(name.text() for name in raw["y_names_N"].items(dims.ny_N)),
        dt=tuple(_interval(dt) for dt in raw["dt"].items(dims.N)),
        discrete=raw["discrete"].flag(),
        statuses=_unique(raw["statuses"], Entry.identifier),
        online={kind: layout.word(LAYOUTS) for kind, layout in raw["online"].members(ONLINE).items()},
        options=raw["options"].text(),
        report=raw["report"].value,
    )


def _dimensions(sizes: Mapping[str, Entry]) -> Dimensions:
    return Dimensions(
        N=sizes["N"].integer(1),
        nx=sizes["NX"].integer(1),
        nu=sizes["NU"].integer(),
        np=sizes["NP"].integer(),
        ny=sizes["NY"].integer(),
        ny_N=sizes["NY_N"].integer(),
        nh=sizes["NH"].integer(),
        nh_N=sizes["NH_N"].integer(),
        nr=sizes["NR"].integer(),
    )


def _interval(entry: Entry) -> float:
    dt = entry.number()
    return dt if dt > 0 else entry.fail("a positive number")


def _unique(entry: Entry, read: Callable[[Entry], str], count: int | None = None) -> tuple[str, ...]:
    """Names of a list, no two alike."""
    names: dict[str, None] = {}
    for item in entry.items(count):
        if read(item) in names:
            item.fail("a name that no other entry has")
        names[read(item)] = None
    return tuple(names)


def _structs(entry: Entry) -> dict[str, tuple[Member, ...]]:
    """Structs by name; a member's type is known before, so that no struct contains itself."""
    structs: dict[str, tuple[Member, ...]] = {}
    for item in entry.items():
        raw = item.members(("name", "doc", "fields"))
        raw["doc"].text()
        name = raw["name"].identifier()
        if name in structs or name in ("real", *INTEGERS):
            raw["name"].fail("a name that no other type has")
        types = ("real", *INTEGERS, *structs)
        structs[name] = tuple(_member(field, types) for field in raw["fields"].items())
        if len({member.name for member in structs[name]}) != len(structs[name]):
            raw["fields"].fail("members of different names")
    if "solver" not in structs:
        entry.fail("a struct solver among them")
    return structs


def _member(entry: Entry, types: Iterable[str]) -> Member:
    raw = entry.members(("name", "type", "shape", "padded", "role", "doc"))
    shape = tuple(size.integer() for size in raw["shape"].items())
    padded = tuple(size.integer(1) for size in raw["padded"].items(len(shape)))
    if padded != tuple(max(1, size) for size in shape):
        raw["padded"].fail(f"the shape {list(shape)} with 1 for 0")
    return Member(
        raw["name"].identifier(), raw["type"].word(types), shape, padded, raw["role"].text(), raw["doc"].text()
    )


def _signals(entry: Entry, total: int) -> tuple[SignalInfo, ...]:
    """Signals that fill a vector of ``total`` elements one after the other."""
    signals: list[SignalInfo] = []
    offset = 0
    for item in entry.items():
        raw = item.members(("name", "size", "unit", "value", "offset", "scalar"))
        size, scalar = raw["size"].integer(1), raw["scalar"].flag()
        if scalar and size != 1:
            raw["size"].fail("1, as it is a scalar")
        if raw["offset"].integer() != offset:
            raw["offset"].fail(f"{offset}, where the one before ends")
        if any(s.name == raw["name"].identifier() for s in signals):
            raw["name"].fail("a name that no other one has")
        value = tuple(v.number() for v in raw["value"].items(size))
        signals.append(SignalInfo(raw["name"].identifier(), size, raw["unit"].text(), value, offset, scalar))
        offset += size
    if offset != total:
        entry.fail(f"{total} elements in all, not {offset}")
    return tuple(signals)


def _rows(entry: Entry, dims: Dimensions) -> tuple[RowInfo, ...]:
    rows = tuple(_row(item, dims) for item in entry.items(dims.nr))
    if len({row.name for row in rows}) != len(rows):
        entry.fail("rows of different names")
    return rows


def _row(entry: Entry, dims: Dimensions) -> RowInfo:
    raw = entry.members(("name", "kind", "index", "index_terminal", "nodes", "lower", "upper"), ("soft",))
    kind = raw["kind"].word(ROW_KINDS)
    limit = {"control": dims.nu, "state": dims.nx, "general": dims.nh, "coupled": dims.nr}[kind]
    limit_N = {"general": dims.nh_N, "state": dims.nx}.get(kind, 0)
    lower, upper = raw["lower"].bound(), raw["upper"].bound()
    if lower > upper:
        raw["lower"].fail(f"at most the upper bound {upper}")
    if "soft" in raw and raw["soft"].value is not None:
        for penalty in raw["soft"].items(2):
            penalty.bound()
    return RowInfo(
        name=raw["name"].element(),
        kind=kind,
        index=raw["index"].integer(-1 if kind == "general" else 0, limit - 1),
        index_terminal=raw["index_terminal"].integer(-1, limit_N - 1),
        nodes=_nodes(raw["nodes"], kind, dims.N),
        lower=lower,
        upper=upper,
    )


def _nodes(entry: Entry, kind: str, N: int) -> tuple[int, ...]:
    """Nodes of a row; those of controls and of coupled rows are always the same."""
    nodes = tuple(node.integer(0, N) for node in entry.items())
    expected = {"control": tuple(range(N)), "coupled": (0, N)}.get(kind, tuple(sorted(set(nodes))))
    if nodes != expected:
        entry.fail(
            "all nodes but the last for a control, the first and the last for a coupled row, else ascending ones"
        )
    return nodes
