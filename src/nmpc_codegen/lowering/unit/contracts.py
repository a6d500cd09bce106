"""Contracts at the top of parts lose the entries of functions that the package does not have."""

from __future__ import annotations

import re
from collections.abc import Collection

#: An entry of a contract: its margin, its names.
_ENTRY = re.compile(r"(?P<margin> \*   )(?P<names>\w+(?:, \w+)*)(?:\([^)]*\))? {2,}\S")


def without_entries(comment: str, there: Collection[str]) -> str:
    """Return a contract without the entries of functions that do not exist."""
    kept: list[str] = []
    margin = None  # margin of the removed entry
    for line in comment.split("\n"):
        entry = _ENTRY.match(line)
        if entry is not None:
            names = entry["names"].split(", ")
            margin = len(entry["margin"]) if not any(name in there for name in names) else None
        elif margin is not None and not line.startswith(" *" + " " * margin):
            margin = None
        if margin is None:
            kept.append(line)
    return "\n".join(kept)
