"""The folder of compiled controllers: private to its owner, verified before use, cleaned of what killed builds left.

    <cache>/_nmpc_<name>_<key>.so        a module; loaded only if its checksum is right
    <cache>/_nmpc_<name>_<key>.sha256    its checksum, as sha256sum writes it
    <cache>/locks/<xx>.lock              at most 256, never deleted: a lock that is deleted can be held twice
    <cache>/<module>.building-<random>/  a build under way; without the holder of its lock it is garbage
    <cache>/failed/<module>/             sources of the last builds that failed

A module is code that runs in the process that loads it. Hence the cache and its entries have to belong to the user who
runs (or to root), and nobody else may write to them; a cache is not to be shared between users. On systems without
POSIX owners this check is left out.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout
from platformdirs import user_cache_dir

from nmpc_codegen.errors import BuildError

CACHE_VARIABLE = "NMPC_CODEGEN_CACHE"
BUILDING, FAILED, LOCKS, PRODUCT = ".building-", "failed", "locks", "module"
KEPT_FAILURES = 8
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def cache_directory() -> Path:
    """Where compiled controllers are kept: $NMPC_CODEGEN_CACHE, else the user's cache directory."""
    override = os.environ.get(CACHE_VARIABLE)
    return Path(override).absolute() if override else Path(user_cache_dir("nmpc_codegen"))


def cached(filename: str, make: Callable[[Path], None]) -> Path:
    """Path of the intact entry of that name; ``make(folder)`` is called for a missing or damaged one.

    Args:
        filename: name of the entry; what stands before its first dot names its lock and folders.
        make: leaves the file "module" in the folder that it is given.

    Raises:
        BuildError: the cache is not private or cannot be written, or what ``make`` raises.
    """
    folder = _private_folder()
    target = folder / filename
    if _is_intact(target):
        return target
    try:
        with _lock(folder, _module(target.name)):
            if not _is_intact(target):
                _sweep(folder, _module(target.name))
                with _workplace(target) as workplace:
                    make(workplace)
                    _store(workplace / PRODUCT, target)
    except (OSError, NotImplementedError) as error:  # the latter: a file system without locks
        raise _unwritable(folder, error) from error
    return target


def keep_failed(workplace: Path) -> Path:
    """Move the folder of a failed build to where it can be looked at; only the last few are kept."""
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


def _unwritable(folder: Path, error: BaseException) -> BuildError:
    return BuildError(f"cannot write to the cache {folder}: {error}; name another folder in {CACHE_VARIABLE}")


def _private_folder() -> Path:
    """The cache directory, made if needed; refused if another user could put code into it."""
    folder = cache_directory()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        reason = _distrust(folder.stat())
    except OSError as error:
        raise _unwritable(folder, error) from error
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
    """Why a file or folder may hold the code of somebody else; empty if it may not. Root is trusted as it is anyway."""
    if not hasattr(os, "geteuid"):
        return ""
    if info.st_uid not in (0, os.geteuid()):
        return f"belongs to user {info.st_uid}"
    if info.st_mode & OTHERS_WRITE:
        return f"can be written by other users (mode {stat.S_IMODE(info.st_mode):04o})"
    return ""


def _is_intact(target: Path) -> bool:
    """True for a trusted module whose checksum is the recorded one. To load a truncated one may kill the process."""
    recorded, content = _read_trusted(_checksum_file(target)), _read_trusted(target)
    return content is not None and recorded == _checksum(content, target)


def _read_trusted(path: Path) -> bytes | None:
    """Contents of a regular file that nobody else can have written; None for anything else."""
    try:
        # What is not a file is not waited for (a named pipe), what is a link is not followed.
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
    """One build at a time of this module."""
    path = _lock_file(folder, module)
    path.parent.mkdir(mode=0o700, exist_ok=True)
    with FileLock(path, mode=0o600):
        yield


@contextmanager
def _workplace(target: Path) -> Iterator[Path]:
    """A folder for one build, which only the holder of the module's lock has; gone afterwards."""
    workplace = Path(tempfile.mkdtemp(prefix=f"{_module(target.name)}{BUILDING}", dir=target.parent))
    try:
        yield workplace
    finally:
        shutil.rmtree(workplace, ignore_errors=True)


def _sweep(folder: Path, held: str) -> None:
    """Remove the folders of builds that were killed: those whose lock nobody holds. The lock of ``held`` is ours."""
    for left in folder.glob(f"*{BUILDING}*"):
        path = _lock_file(folder, _module(left.name))
        if path == _lock_file(folder, held):
            shutil.rmtree(left, ignore_errors=True)
            continue
        with suppress(Timeout), FileLock(path, timeout=0, mode=0o600):
            shutil.rmtree(left, ignore_errors=True)
