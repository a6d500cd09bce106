"""Exported folders, read back without CasADi."""

from __future__ import annotations

from pathlib import Path

from nmpc_codegen.errors import BuildError
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.controller import Controller


def open_package(
    directory: str | Path, profile: str = "fast", lanes: int | None = None, name: str | None = None
) -> Controller:
    """Compile and load an exported folder; ``name`` picks one of several packages in it.

    Raises:
        BuildError: the folder does not hold that package, or not exactly one <name>.json with <name>.h and <name>.c.
    """
    folder = Path(directory)
    found = [j for j in sorted(folder.glob("*.json")) if j.with_suffix(".h").exists() and name in (None, j.stem)]
    if len(found) != 1:
        names = ", ".join(j.name for j in found) or "none"
        wanted = "one package" if name is None else f"the package {name!r}"
        raise BuildError(f"{folder}: expected {wanted} (<name>.json, <name>.h, <name>.c), found {names}")
    prefix = found[0].stem
    paths = [folder / f"{prefix}.{ext}" for ext in ("h", "c", "json")]
    if not paths[1].exists():
        raise BuildError(f"{folder}: {prefix}.c is missing")
    paths += sorted(p for p in folder.glob("osqp/**/*.[ch]"))
    files = {p.relative_to(folder).as_posix(): p.read_text(encoding="utf-8") for p in paths}
    return load(files, prefix, profile, lanes=lanes)
