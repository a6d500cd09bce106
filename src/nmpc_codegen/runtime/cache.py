"""The folder of compiled controllers is private to its owner, verified before use, and cleaned after killed builds.

    <cache>/_nmpc_<name>_<key>.so        a module; loaded only if its checksum is right
    <cache>/_nmpc_<name>_<key>.sha256    its checksum, as sha256sum writes it
    <cache>/locks/<xx>.lock              at most 256, never deleted: a deleted lock file could be locked twice
    <cache>/<module>.building-<random>/  a build in progress; it is removed if nobody holds its lock
    <cache>/failed/<module>/             sources of the last builds that failed

A module is code that runs in the process that loads it. Hence the cache and its entries must belong to the current user
(or to root), and nobody else may have write access; users must not share a cache. Systems without POSIX owners skip
this check.

Where the cache cannot be written to, a temporary folder takes its place until the process ends.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from filelock import FileLock, Timeout
from platformdirs import user_cache_dir

from nmpc_codegen.errors import BuildError, warn

CACHE_VARIABLE = "NMPC_CODEGEN_CACHE"
BUILDING, FAILED, LOCKS, PRODUCT = ".building-", "failed", "locks", "module"
HOMELESS = Path(os.devnull, "no-home-directory")  # a path that cannot be created
TEMPORARY, ALIVE = "nmpc_codegen-cache-", "alive.lock"  # prefix of temporary folders; name of the lock in each
KEPT_FAILURES = 8
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH

#: Cache that cannot be written to -> folder that is used instead.
_SUBSTITUTES: dict[Path, Path] = {}
#: The lock of the temporary folder, held as long as the process lives.
_HELD: list[FileLock] = []


def cache_directory() -> Path:
    """Return the folder of compiled controllers: $NMPC_CODEGEN_CACHE, else the user's cache directory."""
    override = os.environ.get(CACHE_VARIABLE)
    if override:
        return Path(override).absolute()
    try:
        return Path(user_cache_dir("nmpc_codegen"))
    except RuntimeError:  # neither HOME nor an entry for the user in the system's list
        return HOMELESS


def entry(filename: str, make: Callable[[Path], None]) -> Path:
    """Return the path of an entry of the cache; ``make(folder)`` is called if it is missing or damaged.

    Args:
        filename: name of the entry; the part before the first dot names its lock and folders.
        make: writes the file "module" to the folder that it is given.

    Raises:
        BuildError: the cache is not private; neither it nor a temporary folder can be written to. Errors of ``make``
            are passed on.
    """
    folder = cache_directory()
    try:
        if folder not in _SUBSTITUTES:
            try:
                return _entry(_private(folder), filename, make)
            except (OSError, NotImplementedError) as error:  # NotImplementedError: a file system without locks
                _substitute(folder, error)
        return _entry(_SUBSTITUTES[folder], filename, make)
    except OSError as error:
        raise BuildError(
            f"cannot write to the cache {folder} or to a temporary folder: {error}; name another folder in "
            f"{CACHE_VARIABLE}"
        ) from error


def _entry(folder: Path, filename: str, make: Callable[[Path], None]) -> Path:
    """Return the path of an intact entry in a folder; make the entry there if necessary."""
    target = folder / filename
    if _is_intact(target):
        return target
    with _lock(folder, _module(target.name)):
        if not _is_intact(target):
            _sweep(folder, _module(target.name))
            with _workplace(target) as workplace:
                make(workplace)
                _store(workplace / PRODUCT, target)
    return target


def _substitute(folder: Path, error: BaseException) -> None:
    """Use a temporary folder of this process instead of the cache, and warn."""
    place = _SUBSTITUTES[folder] = temporary_directory()
    warn(
        f"cannot write to the cache {folder}: {error}; controllers are kept in {place} until this process ends and "
        f"compiled again in the next one; name another folder in {CACHE_VARIABLE}",
        RuntimeWarning,
    )


@cache
def temporary_directory() -> Path:
    """Return a private folder that lives as long as the process that first requested it.

    The process and its children hold a lock in the folder. If they are killed, the next process that calls this
    function removes it.
    """
    for left in Path(tempfile.gettempdir()).glob(f"{TEMPORARY}*"):
        with suppress(OSError, Timeout):
            info = left.lstat()
            if stat.S_ISDIR(info.st_mode) and not _distrust(info):
                with FileLock(left / ALIVE, timeout=0, mode=0o600):
                    shutil.rmtree(left, ignore_errors=True)
    place = Path(tempfile.mkdtemp(prefix=TEMPORARY))
    _HELD.append(FileLock(place / ALIVE, mode=0o600, thread_local=False))
    _HELD[-1].acquire()
    owner = os.getpid()
    atexit.register(lambda: shutil.rmtree(place, ignore_errors=True) if os.getpid() == owner else None)
    return place


def keep_failed(workplace: Path) -> Path:
    """Move the folder of a failed build to FAILED for inspection; only the last few are kept."""
    failed = workplace.parent / FAILED
    kept = failed / _module(workplace.name)
    failed.mkdir(exist_ok=True)
    shutil.rmtree(kept, ignore_errors=True)
    os.utime(workplace)
    os.replace(workplace, kept)
    aged = []
    for folder in failed.iterdir():
        with suppress(OSError):  # another build has just removed it
            aged.append((folder.stat().st_mtime, folder))
    for _, folder in sorted(aged)[:-KEPT_FAILURES]:
        shutil.rmtree(folder, ignore_errors=True)
    return kept


def _private(folder: Path) -> Path:
    """Return the folder, created if needed; refuse it if another user could put code into it."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    reason = _distrust(folder.stat())
    if reason:
        raise BuildError(
            f"the cache {folder} {reason}, who could have put any code into it: make it yours with "
            f"'chown -R {_user()} {folder}; chmod -R go-w {folder}' if you trust what is in it, "
            f"or name a folder of your own in {CACHE_VARIABLE}"
        )
    return folder


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0


def _distrust(info: os.stat_result) -> str:
    """Return the reason why a file or folder may contain code of another user, or ""; root is trusted."""
    if not hasattr(os, "geteuid"):
        return ""
    if info.st_uid not in (0, os.geteuid()):
        return f"belongs to user {info.st_uid}"
    if info.st_mode & OTHERS_WRITE:
        return f"can be written by other users (mode {stat.S_IMODE(info.st_mode):04o})"
    return ""


def _is_intact(target: Path) -> bool:
    """Return True for a trusted module with the recorded checksum; loading a truncated one may kill the process."""
    recorded, content = _read_own(_checksum_file(target)), _read_own(target)
    return content is not None and recorded == _checksum(content, target)


def _read_own(path: Path) -> bytes | None:
    """Return the content of a regular file that no other user can have written; None for anything else."""
    try:
        # Do not wait for a named pipe, and do not follow a link.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(descriptor, "rb") as stream:
            info = os.fstat(descriptor)
            return None if not stat.S_ISREG(info.st_mode) or _distrust(info) else stream.read()
    except OSError:
        return None


def _store(product: Path, target: Path) -> None:
    """Move a new module and its checksum into place; a reader between the two moves sees a damaged entry."""
    record = product.with_suffix(".sha256")
    record.write_bytes(_checksum(product.read_bytes(), target))
    record.chmod(0o600)
    product.chmod(0o700)
    os.replace(record, _checksum_file(target))
    os.replace(product, target)


def _checksum_file(target: Path) -> Path:
    return target.with_name(f"{_module(target.name)}.sha256")


def _checksum(content: bytes, target: Path) -> bytes:
    return f"{hashlib.sha256(content).hexdigest()}  {target.name}\n".encode()


def _module(filename: str) -> str:
    return filename.split(".")[0]


def _lock_file(folder: Path, module: str) -> Path:
    return folder / LOCKS / f"{hashlib.sha256(module.encode()).hexdigest()[:2]}.lock"


@contextmanager
def _lock(folder: Path, module: str) -> Iterator[None]:
    """Allow one build of this module at a time."""
    path = _lock_file(folder, module)
    path.parent.mkdir(mode=0o700, exist_ok=True)
    with FileLock(path, mode=0o600):
        yield


@contextmanager
def _workplace(target: Path) -> Iterator[Path]:
    """Create a folder for one build, which only the holder of the module's lock uses; remove it afterwards."""
    workplace = Path(tempfile.mkdtemp(prefix=f"{_module(target.name)}{BUILDING}", dir=target.parent))
    try:
        yield workplace
    finally:
        shutil.rmtree(workplace, ignore_errors=True)


def _sweep(folder: Path, held: str) -> None:
    """Remove the folders of killed builds, whose lock nobody holds; the caller holds the lock of ``held``."""
    for left in folder.glob(f"*{BUILDING}*"):
        path = _lock_file(folder, _module(left.name))
        if path == _lock_file(folder, held):
            shutil.rmtree(left, ignore_errors=True)
            continue
        with suppress(Timeout), FileLock(path, timeout=0, mode=0o600):
            shutil.rmtree(left, ignore_errors=True)
