"""Rooms (packages) of the source tree: the place of every module, and the imports between them."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "nmpc_codegen"

#: A room imports only the rooms before it; the modules of the package itself are checked one by one.
ORDER = (
    *(
        "errors",
        "exclusive",
        "runtime",
        "ir",
        "frontend",
        "components",
        "options",
        "lowering",
        "host",
        "bounds",
        "oracle",
    ),
    *("economic", "compiler", "derivatives", "firmware", "cli"),
)
RANK = {room: rank for rank, room in enumerate(ORDER)}

MODULES = sorted(path for path in SOURCE.rglob("*.py"))


def place(path: Path) -> str:
    """Dotted name of a module below nmpc_codegen with slashes: "runtime/build"."""
    return "/".join(path.relative_to(SOURCE).with_suffix("").parts)


def room(name: str) -> str:
    """First part of a place or of a dotted name below nmpc_codegen."""
    return re.split(r"[./]", name)[0]


def imports(path: Path) -> Iterator[str]:
    """Dotted names of all modules that a file imports, inside functions and for type checking too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            if node.module == "nmpc_codegen":
                yield from (f"nmpc_codegen.{alias.name}" for alias in node.names)
            elif node.module:
                yield node.module


def own_imports(path: Path) -> set[str]:
    """Dotted names below nmpc_codegen that a source file imports."""
    return {name.removeprefix("nmpc_codegen.") for name in imports(path) if name.startswith("nmpc_codegen.")}


def upward_imports(path: Path) -> set[str]:
    """Imported names of rooms after the room of the file; the package itself re-exports names of all rooms."""
    here = place(path)
    if here == "__init__":
        return set()
    return {name for name in own_imports(path) if RANK[room(name)] > RANK[room(here)]}


def modules_per_room() -> Counter[Path]:
    """Folder -> its modules without __init__.py."""
    return Counter(path.parent for path in MODULES if path.name != "__init__.py")
