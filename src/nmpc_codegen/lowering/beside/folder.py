"""The folder of a package is written so that files of the user are not lost.

All new files are first written under temporary names; if the disk is full or the folder cannot be written to, the
export ends here and nothing has changed. Then each file is renamed to its final name, which is atomic: at any time
every file is complete, old or new. open_package() refuses a mixture of both.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from filelock import FileLock, Timeout

from nmpc_codegen.errors import ExportError, OptionError
from nmpc_codegen.package.seal import LARGEST, has_seal, intact, package_of

TEMPORARY = ".nmpc_codegen-new"
LOCK_TIMEOUT = 10.0  # longest time that an export waits for another one into the same folder
#: Files that an export for a microcontroller adds to a package; they belong to this package only.
BESIDE = ("certificate*.json", "certificate*.md", "library.json", "firmware/**/*", "zephyr/**/*", "arduino/**/*")
EXAMPLE = "main.c"  # an example, which is not needed, so that an edited one is kept


@dataclass(frozen=True)
class FileChange:
    """A change is a file to write: path and bytes, bytes and mode of the old file, and if the user has edited it."""

    target: Path
    data: bytes
    old: bytes | None
    mode: int | None
    foreign: bool

    @property
    def new(self) -> Path:
        """Return the temporary name of the new file."""
        return self.target.with_name(self.target.name + TEMPORARY)


def write(
    directory: str | os.PathLike[str],
    files: Mapping[str, str],
    *,
    force: bool = False,
    obsolete: Mapping[str, str] | None = None,
) -> Path:
    """Write ``files`` (relative path -> text) into the folder and return its absolute path.

    The folder is created if needed. Files with the right content are not touched. An edited main.c, or one of other
    origin, is kept, with a warning. Any other file that was not generated, was edited or is read-only is an error; with
    ``force`` such files are replaced, and copies of them are kept. Links, folders and devices with the name of a file
    are never replaced. Files of ``obsolete`` (relative path -> beginning) are removed if an export has written them and
    nobody has edited them since. Certificate and firmware of a package whose C is replaced by another package are
    removed as well.

    Raises:
        OptionError: ``directory`` or ``force`` has a wrong type.
        ExportError: a file must not be replaced (then no file is written), or one cannot be written.
    """
    if force is not True and force is not False:
        raise OptionError(f"force: {force!r}; expected True or False")
    folder = _resolve(directory)
    with _naming(folder, "the folder cannot be created"):
        folder.mkdir(parents=True, exist_ok=True)
    with _lock_folder(folder):
        changes, kept = _changes(folder, files, force)
        stale = _stale(folder, files, changes)
        try:
            for change in changes:
                with _naming(change.target, "cannot be written"):
                    _stage(change)
            for old in stale:
                with _naming(old, "cannot be removed"):
                    _remove(old)
            for change in changes:
                with _naming(change.target, "cannot be replaced"):
                    _replace(change)
            for path, beginning in (obsolete or {}).items():
                with _naming(folder / path, "cannot be removed"):
                    _remove(folder / path, beginning.encode())
        finally:
            for path in files:
                with suppress(OSError):
                    (folder / (path + TEMPORARY)).unlink()
    kept += [f"{old}: is of the package that was replaced, and edited" for old in stale if old.exists()]
    if removed := [old for old in stale if not old.exists()]:
        said = f"{removed[0]} and {len(removed) - 1} other files are removed: they belonged to the package before"
        warnings.warn(f"{said}; nmpc-export --target writes new ones", stacklevel=3)
    for what in kept:
        warnings.warn(f"{what}; left as it is (force=True, --force replaces it)", stacklevel=3)
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


def _resolve(directory: str | os.PathLike[str]) -> Path:
    """Return the absolute path of the folder; links are followed only here, because the caller named the path."""
    try:
        text = os.fspath(directory)
    except TypeError:
        text = ""
    if not isinstance(text, str) or not text or "\0" in text:
        raise OptionError(f"directory: {directory!r}; expected the path of a folder")
    try:
        return Path(text).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop of links; ValueError: not encodable
        raise ExportError(f"{text}: cannot be used as a folder: {getattr(error, 'strerror', None) or error}") from error


@contextmanager
def _lock_folder(folder: Path) -> Iterator[None]:
    """Lock the folder against other exports of this user.

    There are at most 256 lock files, which are never deleted, because a deleted one could be locked twice.
    """
    name = hashlib.sha256(os.fsencode(folder)).hexdigest()[:2]
    user = os.getuid() if hasattr(os, "getuid") else 0
    with _naming(folder, "the folder cannot be locked"):
        lock = FileLock(Path(tempfile.gettempdir()) / f"nmpc_codegen-{user}-{name}.lock", timeout=LOCK_TIMEOUT)
        try:
            lock.acquire()
        except Timeout:
            raise ExportError(f"{folder}: another process is writing into the folder; try again later") from None
    try:
        yield
    finally:
        lock.release()


# -- files that may be replaced ---------------------------------------------------------------------------------------


def _changes(folder: Path, files: Mapping[str, str], force: bool) -> tuple[list[FileChange], list[str]]:
    """Return the files to write, whose content differs, and the files that are kept.

    Raises:
        ExportError: a file must not be replaced.
    """
    changes, kept, refused = [], [], []
    for path, text in files.items():
        target, data = _target(folder, path), text.encode()
        mode = _mode(target)
        if mode is None:
            changes.append(FileChange(target, data, None, None, False))
            continue
        if not stat.S_ISREG(mode):
            raise ExportError(f"{target}: is {_kind(mode)}; export() writes only plain files: remove it")
        old = _read(target)
        reason = _objection(old, mode)
        if old == data:
            continue
        if reason is None or force:
            changes.append(FileChange(target, data, old, mode, reason is not None))
        elif path == EXAMPLE:
            kept.append(f"{target}: {reason}")
        else:
            refused.append(f"{path} ({reason})")
    if refused:
        raise ExportError(
            f"{folder}: export() would replace {', '.join(refused)}; choose another folder, move the files away, "
            "or let it replace them with force=True (--force), which keeps copies"
        )
    return changes, kept


def _stale(folder: Path, files: Mapping[str, str], changes: list[FileChange]) -> list[Path]:
    """Return sealed files beside packages whose C is replaced, if they are not written now."""
    headers = [change for change in changes if change.target.suffix == ".h" and change.target.parent == folder]
    replaced = {package_of((change.old or b"").decode(errors="replace")) for change in headers}
    gone = replaced - {None, *(package_of(text) for text in files.values())}
    if not gone:
        return []
    found = (path for pattern in BESIDE for path in sorted(folder.glob(pattern)))
    mine = (p for p in found if p.relative_to(folder).as_posix() not in files and stat.S_ISREG(_mode(p) or 0))
    return [path for path in mine if package_of((_read(path) or b"").decode(errors="replace")) in gone]


def _target(folder: Path, path: str) -> Path:
    """Return the place of a file; refuse anything on the path that is no folder, such as a link."""
    parts = PurePosixPath(path).parts
    if not parts or path.startswith("/") or ".." in parts or "\0" in path:
        raise ExportError(f"{path!r}: a component of the package wants to write outside of the folder")
    target = folder / path
    for parent in reversed(target.parents):
        if folder in parent.parents:
            mode = _mode(parent)
            if mode is not None and not stat.S_ISDIR(mode):
                raise ExportError(f"{parent}: is {_kind(mode)}; export() needs a folder there: remove it")
    return target


def _mode(path: Path) -> int | None:
    """Return type and permissions of a file, folder or link, without following links; None if it does not exist."""
    try:
        return path.lstat().st_mode
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ExportError(f"{path}: cannot be examined: {error.strerror}") from error


def _kind(mode: int) -> str:
    kinds = {stat.S_IFLNK: "a link", stat.S_IFDIR: "a folder", stat.S_IFREG: "a file", stat.S_IFIFO: "a pipe"}
    return kinds.get(stat.S_IFMT(mode), "a device or socket")


def _read(target: Path) -> bytes | None:
    """Return the bytes of a plain file; None if it is too large for a generated one."""
    with _naming(target, "cannot be read"):
        return target.read_bytes() if target.stat().st_size <= LARGEST else None


def _objection(old: bytes | None, mode: int) -> str | None:
    """Return the reason why a file must not be replaced, or None."""
    if old is None or not has_seal(old):
        return "not written by export()"
    if not intact(old):
        return "edited since export() wrote it"
    return None if mode & 0o222 else "read-only"


# -- writing ----------------------------------------------------------------------------------------------------------


def _stage(change: FileChange) -> None:
    """Write the new file under its temporary name, flushed to the disk, and copy a file of the user."""
    change.target.parent.mkdir(parents=True, exist_ok=True)
    change.new.unlink(missing_ok=True)
    with open(change.new, "xb") as file:
        file.write(change.data)
        file.flush()
        os.fsync(file.fileno())
    if change.mode is not None:
        change.new.chmod((change.mode & 0o777) | stat.S_IWUSR)
    if change.foreign:
        copies = (change.target.with_name(f"{change.target.name}.bak{n or ''}") for n in itertools.count())
        shutil.copy2(change.target, next(copy for copy in copies if not os.path.lexists(copy)), follow_symlinks=False)


def _replace(change: FileChange) -> None:
    """Rename the new file to its final name, unless somebody has just edited the old one."""
    mode = _mode(change.target)
    if (None if mode is None else _read(change.target)) != change.old:
        raise ExportError(f"{change.target}: has changed during the export; look at it and export again")
    os.replace(change.new, change.target)


def _remove(target: Path, beginning: bytes = b"") -> None:
    """Remove a generated file that has this beginning and was not edited."""
    mode = _mode(target)
    if mode is not None and stat.S_ISREG(mode):
        old = _read(target)
        if old is not None and old.startswith(beginning) and _objection(old, mode) is None:
            target.unlink()
