"""The folder of a package: which files in it may be replaced, and how new ones are written, all of them or none.

New files and hard links to the old ones are first created in STAGING inside the folder; then each new file is renamed
to its final name, which is atomic. After a failure the old files are put back. If the process is killed between two
renames, every file is complete, old or new; STAGING is left behind, and the next export removes it.
"""

from __future__ import annotations

import os
import shutil
import stat
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from nmpc_codegen.errors import ExportError, OptionError
from nmpc_codegen.runtime.seal import has_seal, intact

if sys.platform != "win32":
    import fcntl

STAGING = ".nmpc_codegen-export"
PATIENCE = 10.0  # seconds that an export waits for another one into the same folder
LARGEST = 1 << 28  # bytes; a larger file cannot be a generated one, and is not read


@dataclass(frozen=True)
class Change:
    """A file that is going to be written: its place, its bytes, its names in STAGING, and the mode of an old file."""

    target: Path
    data: bytes
    new: Path
    old: Path
    mode: int | None


def write(directory: str | os.PathLike[str], files: Mapping[str, str], *, force: bool = False) -> Path:
    """Write ``files`` (relative path -> text) into the folder, which is created if needed; return its absolute path.

    Files that already have the right content are not touched. Files that are not generated, have been edited or are
    read-only are replaced only with ``force``; links, folders and devices in the place of a file are never replaced.

    Raises:
        OptionError: ``directory`` or ``force`` has a wrong type.
        ExportError: a file must not be replaced, or it cannot be written; the folder is left unchanged.
    """
    if force is not True and force is not False:
        raise OptionError(f"force: {force!r}; expected True or False")
    folder = _resolved(directory)
    made: list[Path] = []
    try:
        _make(folder, made)
        with _alone(folder):
            staging = folder / STAGING
            _clear(staging)
            changes = _changes(folder, files, force)
            for change in changes:
                _make(change.target.parent, made)
            if changes:
                _replace(staging, changes)
    except BaseException:
        for path in reversed(made):
            with suppress(OSError):
                path.rmdir()
        raise
    return folder


@contextmanager
def _naming(path: Path, what: str) -> Iterator[None]:
    """Turn an error of the operating system into an ExportError that names the path."""
    try:
        yield
    except ExportError:
        raise
    except OSError as error:
        raise ExportError(f"{path}: {what}: {error.strerror or error}") from error


# -- the folder -------------------------------------------------------------------------------------------------------


def _resolved(directory: str | os.PathLike[str]) -> Path:
    """The absolute path of the folder. Links in the path are followed only here, because the caller named them."""
    if not isinstance(directory, str | os.PathLike) or not isinstance(os.fspath(directory), str):
        raise OptionError(f"directory: {directory!r}; expected the path of a folder")
    text = os.fspath(directory)
    if not text or "\0" in text:
        raise OptionError(f"directory: {text!r}; expected the path of a folder")
    path = Path(text)
    try:
        for part in (path, *path.parents):
            if part.is_symlink() and not part.exists():
                raise ExportError(f"{part}: is a link to nothing; expected a folder")
        return path.resolve()
    except ExportError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop of links; ValueError: not encodable
        raise ExportError(f"{path}: cannot be used as a folder: {getattr(error, 'strerror', None) or error}") from error


def _make(folder: Path, made: list[Path]) -> None:
    """Create the folder and its parents; ``made`` collects what did not exist before."""
    with _naming(folder, "the folder cannot be created"):
        missing = []
        for path in (folder, *folder.parents):
            if _mode(path) is not None:
                break
            missing.append(path)
        for path in reversed(missing):
            made.append(path)  # recorded first: a folder that exists despite an error must be removed, too
            try:
                path.mkdir()
            except FileExistsError:  # another process was faster
                made.pop()
    if not folder.is_dir():
        raise ExportError(f"{folder}: is no folder; choose another path")


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other exports out of the folder: a lock on the folder itself leaves no file and ends with the process.

    Some network file systems and Windows have no such lock; concurrent exports are not prevented there.
    """
    if sys.platform == "win32":
        yield
        return
    with _naming(folder, "the folder cannot be opened"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        end = time.monotonic() + PATIENCE
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > end:
                    raise ExportError(f"{folder}: another process has locked the folder; try again later") from None
                time.sleep(0.02)
                continue
            except OSError:
                pass
            break
        yield
    finally:
        os.close(handle)


def _clear(staging: Path, trouble: str = "cannot be removed") -> None:
    """Remove STAGING; raise ExportError if it contains anything that export() did not write."""
    mode = _mode(staging)
    if mode is None:
        return
    if not stat.S_ISDIR(mode):
        raise ExportError(f"{staging}: is in the way of export(); remove it")
    with _naming(staging, trouble):
        found = list(staging.iterdir())
        strange = [path.name for path in found if path.suffix not in (".new", ".old") or path.is_dir()]
        if strange:
            raise ExportError(f"{staging}: holds {', '.join(strange)}, which export() did not write; remove the folder")
        for path in found:
            path.unlink()
        staging.rmdir()


# -- files that may be replaced ---------------------------------------------------------------------------------------


def _changes(folder: Path, files: Mapping[str, str], force: bool) -> list[Change]:
    """The files to write, whose content differs. Raises ExportError if one of them must not be replaced."""
    changes, refused = [], []
    for path, text in files.items():
        target, data = folder / _checked(path), text.encode()
        _check_way(folder, target)
        mode = _mode(target)
        if mode is not None:
            if not stat.S_ISREG(mode):
                raise ExportError(f"{target}: is {_kind(mode)}; export() writes only plain files: remove it")
            old = _read(target)
            if old == data:
                continue
            reason = _objection(old, mode)
            if reason and not force:
                refused.append(f"{path} ({reason})")
        name = path.replace("/", "+")
        staging = folder / STAGING
        changes.append(Change(target, data, staging / f"{name}.new", staging / f"{name}.old", mode))
    if refused:
        raise ExportError(
            f"{folder}: export() would replace {', '.join(refused)}; choose another folder, move the files away, "
            "or let it replace them with force=True (--force)"
        )
    return changes


def _checked(path: str) -> str:
    parts = PurePosixPath(path).parts
    if not parts or path.startswith("/") or ".." in parts or "\0" in path:
        raise ExportError(f"{path!r}: a component of the package wants to write outside of the folder")
    return path


def _check_way(folder: Path, target: Path) -> None:
    """Refuse a link, or anything else that is not a folder, between the folder and a file in it."""
    for path in reversed(target.parents):
        if folder in path.parents:
            mode = _mode(path)
            if mode is not None and not stat.S_ISDIR(mode):
                raise ExportError(f"{path}: is {_kind(mode)}; export() needs a folder there: remove it")


def _mode(path: Path) -> int | None:
    """Type and permissions of the file, folder or link at a path, without following links; None if there is none."""
    try:
        return path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise ExportError(f"{path}: cannot be examined: {error.strerror}") from error


def _kind(mode: int) -> str:
    kinds = {stat.S_IFLNK: "a link", stat.S_IFDIR: "a folder", stat.S_IFREG: "a file", stat.S_IFIFO: "a pipe"}
    return kinds.get(stat.S_IFMT(mode), "a device or socket")


def _read(target: Path) -> bytes | None:
    """The bytes of a plain file; None if they cannot be read, or are too many for a generated file."""
    try:
        return target.read_bytes() if target.stat().st_size <= LARGEST else None
    except OSError:
        return None


def _objection(old: bytes | None, mode: int) -> str | None:
    """The reason why a file must not be replaced, or None."""
    if old is None or not has_seal(old):
        return "not written by export(), or by an older version"
    if not intact(old):
        return "edited since export() wrote it"
    if not mode & 0o222:
        return "read-only"
    return None


# -- all or none ------------------------------------------------------------------------------------------------------


def _replace(staging: Path, changes: Sequence[Change]) -> None:
    """Write all new files to STAGING, then rename them to their final names; after a failure put the old ones back."""
    try:
        with _naming(staging.parent, "the folder cannot be written to"):
            staging.mkdir()
        for change in changes:
            with _naming(change.target, "cannot be written"):
                _stage(change)
        try:
            for change in changes:
                with _naming(change.target, "cannot be replaced"):
                    os.replace(change.new, change.target)
        except BaseException as error:
            _put_back(staging, changes, error)
            raise
    except BaseException:
        if not any(_is_lost(change) for change in changes):
            with suppress(ExportError):
                _clear(staging)
        raise
    _clear(staging, "the package is complete, but this folder cannot be removed")


def _stage(change: Change) -> None:
    """Write the new file, flushed to the disk, and create a hard link to (or copy of) the old one."""
    with open(change.new, "xb") as file:
        file.write(change.data)
        file.flush()
        os.fsync(file.fileno())
    if change.mode is not None:
        change.new.chmod((change.mode & 0o777) | stat.S_IWUSR)
        try:
            os.link(change.target, change.old, follow_symlinks=False)
        except OSError:  # a file system without hard links
            shutil.copy2(change.target, change.old, follow_symlinks=False)


def _is_lost(change: Change) -> bool:
    """True if an old file exists in STAGING only."""
    return not change.new.exists() and change.old.exists()


def _put_back(staging: Path, changes: Sequence[Change], error: BaseException) -> None:
    """Undo the renames that have been done: those of new files that are not in STAGING."""
    stuck = []
    for change in (c for c in changes if not c.new.exists()):
        try:
            if change.mode is None:
                change.target.unlink()
            else:
                os.replace(change.old, change.target)
        except OSError:
            stuck.append(change.target.name)
    if stuck:
        raise ExportError(
            f"{error}; and not everything could be put back: {', '.join(stuck)} are new, all other files are as before "
            f"(what they replaced is in {staging})"
        ) from error
