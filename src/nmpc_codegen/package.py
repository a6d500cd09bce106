"""Exported folders, read back without CasADi."""

from __future__ import annotations

from pathlib import Path

from nmpc_codegen.build import load
from nmpc_codegen.controller import Controller
from nmpc_codegen.errors import BuildError


def open_package(directory: str | Path, profile: str = "fast", lanes: int | None = None) -> Controller:
    """Compile and load an exported folder.

    Raises:
        BuildError: the folder does not hold exactly one package <name>.json with its <name>.h and <name>.c.
    """
    folder = Path(directory)
    found = [j for j in sorted(folder.glob("*.json")) if j.with_suffix(".h").exists()]
    if len(found) != 1:
        names = ", ".join(j.name for j in found) or "none"
        raise BuildError(f"{folder}: expected one package (<name>.json, <name>.h, <name>.c), found {names}")
    name = found[0].stem
    paths = [folder / f"{name}.{ext}" for ext in ("h", "c", "json")]
    if not paths[1].exists():
        raise BuildError(f"{folder}: {name}.c is missing")
    return load({p.name: p.read_text(encoding="utf-8") for p in paths}, name, profile, lanes=lanes)
