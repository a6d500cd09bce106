"""Exported folders, read back without CasADi."""

from __future__ import annotations

from pathlib import Path

from nmpc_codegen.build import load
from nmpc_codegen.controller import Controller
from nmpc_codegen.errors import BuildError
from nmpc_codegen.seal import package_of


def open_package(
    directory: str | Path, profile: str = "fast", lanes: int | None = None, name: str | None = None
) -> Controller:
    """Compile and load an exported folder; ``name`` picks one of several packages in it.

    Raises:
        BuildError: the folder does not hold that package, or not exactly one <name>.json with <name>.h and <name>.c;
            the three come from different exports, or cannot be read.
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
    files = {p.relative_to(folder).as_posix(): _read(p) for p in paths}
    if len({package_of(files[p.name]) for p in paths[:3]} - {None}) > 1:
        raise BuildError(
            f"{folder}: {', '.join(p.name for p in paths[:3])} come from different exports (one was interrupted, or "
            "files were copied one by one): export the package again"
        )
    return load(files, prefix, profile, lanes=lanes)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BuildError(f"{path} cannot be read: {error}") from error
