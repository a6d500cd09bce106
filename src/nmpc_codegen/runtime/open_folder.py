"""Exported folders are opened here, without CasADi.

The C code of a folder is compiled and runs with the rights of the user, so open only folders that you trust.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from nmpc_codegen.errors import BuildError
from nmpc_codegen.package.seal import LARGEST, has_seal, intact, package_of
from nmpc_codegen.runtime.build import load, load_estimator
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.estimation.observer import Observer


def open_package(directory: str | Path, profile: str = "fast", name: str | None = None) -> Controller:
    """Compile and load an exported folder, without CasADi.

    The C code of the folder runs in this process, so open only folders that you trust.

    Args:
        directory: the folder.
        profile: as in build().
        name: name of the package, if the folder contains several.

    Raises:
        BuildError: the folder does not contain that package, or not exactly one <name>.json with <name>.h and <name>.c;
            the three files come from different exports; a file cannot be read; the package is made for another machine;
            or the compiler rejects the code.
        ControllerError: <name>.json is not the description of a controller, or it does not describe this C code.

    Examples:
        >>> from nmpc_codegen import export
        >>> package = export(ocp, directory="tank")
        >>> controller = open_package("tank")
    """
    files, prefix = _files(directory, name, estimator=False)
    return load(files, prefix, profile)


def open_estimator(directory: str | Path, profile: str = "fast", name: str | None = None) -> Observer:
    """Compile and load the estimator of an exported folder, under the same rules as open_package().

    Args:
        directory: the folder.
        profile: as in build().
        name: name of the estimator, if the folder contains several.
    """
    files, prefix = _files(directory, name, estimator=True)
    return load_estimator(files, prefix, profile)


def _files(directory: str | Path, name: str | None, estimator: bool) -> tuple[dict[str, str], str]:
    """Return the files of the package in a folder, and its name.

    If one of several packages is an estimator, the package of the wanted kind is chosen.
    """
    folder = Path(directory)
    try:
        found = [j for j in sorted(folder.glob("*.json")) if j.with_suffix(".h").exists() and name in (None, j.stem)]
    except OSError as error:
        raise BuildError(f"{folder} cannot be read: {error.strerror or error}") from error
    if len(found) > 1 and name is None:
        found = [j for j in found if _is_estimator(j) == estimator]
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
    data = files[paths[2].name].encode()
    if has_seal(data) and not intact(data):
        raise BuildError(f"{paths[2]}: edited since export() wrote it: export the package again")
    return files, prefix


def _is_estimator(path: Path) -> bool:
    """Return True if a file is a package description with measurements."""
    try:
        return msgspec.json.decode(_read(path)).get("estimation") is not None
    except (msgspec.MsgspecError, AttributeError):
        return False


def _read(path: Path) -> str:
    """Return the text of a file of a package."""
    try:
        if not path.is_file():
            raise BuildError(f"{path} is not a file")
        if path.stat().st_size > LARGEST:
            raise BuildError(f"{path} has {path.stat().st_size} bytes; expected at most {LARGEST}")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise BuildError(f"{path} is not UTF-8 text: {error}") from error
    except OSError as error:
        raise BuildError(f"cannot read {path}: {error}") from error
