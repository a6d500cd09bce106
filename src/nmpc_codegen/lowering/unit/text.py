"""The items of a unit are printed as text."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.macros import print_macro
from nmpc_codegen.lowering.unit.names import rename, renamed_words
from nmpc_codegen.package.struct_layout import Struct

#: Header of the C library -> names, or beginnings of names, that a unit may read from it.
_LIBRARY: Mapping[str, str] = {"immintrin.h": "_mm512_", "math.h": "", "stddef.h": "ptrdiff_t", "string.h": ""}

_BEFORE_TABLES = ("alias", "macro", "directive")


def text_of_unit(items: Sequence[Item], header: str, name: str, structs: Iterable[Struct]) -> str:
    """Return the text of the items, whose names differ from those that the header of the package ``name`` declares."""
    inner = frozenset().union(*(item.words for item in items))
    members = {member.name for struct in structs for member in struct.fields}
    renamed = renamed_words(inner, header, name, members)
    text, above = "", ""
    for item in items:
        apart = item.apart or (item.kind == "table" and above in _BEFORE_TABLES)
        text += ("\n\n" if apart else "\n") + print_item(item, renamed)
        above = item.kind
    return text.lstrip("\n") + "\n"


def print_item(item: Item, renamed: Mapping[str, str]) -> str:
    """Return the text of an item with new inner names."""
    return print_macro(item, renamed) if item.kind in ("alias", "macro") else rename(item.text, renamed)


def library_headers(items: Iterable[Item]) -> list[str]:
    """Return the headers of the C library that a unit includes."""
    read: Collection[str] = frozenset().union(*(item.words for item in items))
    return [header for header, word in _LIBRARY.items() if any(name.startswith(word) for name in read)]
