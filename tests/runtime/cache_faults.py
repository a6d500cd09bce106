"""Faults of a cache of compiled controllers; each fault is a function (cache, package) -> survived?"""

from __future__ import annotations

import atexit
import contextlib
import functools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from nmpc_codegen.lowering.beside.folder import write
from verification.problems import toy_sources

ROOT = Path(__file__).parents[2]
OPEN = "import sys; from nmpc_codegen import open_package; print(open_package(sys.argv[1], 'test').step([0.1, 0.0]))"
AFTERWARDS = """
import pickle, shutil, sys
from nmpc_codegen import open_package
c = open_package(sys.argv[1], "test")
first = c.step([0.1, 0.0])
shutil.rmtree(sys.argv[2])
c.reset()
for twin in (c, c.copy(), pickle.loads(pickle.dumps(c))):
    twin.reset()
    assert (twin.step([0.1, 0.0]) == first).all()
print(first)
"""
STRANGER = 54321  # a user number that no user has


def start(program: str, cache: Path, *arguments: Path) -> subprocess.Popen[str]:
    """A Python process in its own session with this cache."""
    environment = {**os.environ, "NMPC_CODEGEN_CACHE": str(cache), "PYTHONPATH": str(ROOT / "src")}
    command = [sys.executable, "-c", program, *map(str, arguments)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, env=environment, text=True, start_new_session=True, **pipes)


def opens(cache: Path, package: Path, program: str = OPEN) -> bool:
    """The package opens and steps, and the cache contains only modules, checksums and locks."""
    process = start(program, cache, package, cache)
    output, _ = process.communicate()
    return process.returncode == 0 and output.startswith("[") and not leftovers(cache)


def refused(cache: Path, package: Path) -> bool:
    """Exactly one BuildError, which names the cache and the remedy."""
    process = start(OPEN, cache, package)
    _, errors = process.communicate()
    last = errors.strip().splitlines()[-1] if errors.strip() else ""
    return process.returncode == 1 and "BuildError" in last and str(cache) in last and "NMPC_CODEGEN_CACHE" in last


def leftovers(cache: Path) -> list[str]:
    """Files that a build leaves behind only if it is killed."""
    return [p.name for p in cache.iterdir() if p.suffix not in (".so", ".sha256") and p.name not in ("locks", "failed")]


def module(cache: Path) -> Path:
    """The single module of a cache."""
    (found,) = cache.glob("*.so")
    return found


@functools.cache
def _filled() -> Path:
    """A cache that holds the toy package, made once."""
    folder = tempfile.TemporaryDirectory(prefix="cache-")
    atexit.register(folder.cleanup)
    cache = Path(folder.name) / "cache"
    write(cache.parent / "toy", toy_sources())
    if not opens(cache, cache.parent / "toy"):
        raise RuntimeError("the toy package does not open")
    return cache


def _damaged(damage: Callable[[Path], object]) -> Callable[[Path, Path], bool]:
    def fault(cache: Path, package: Path) -> bool:
        shutil.copytree(_filled(), cache)
        before = module(cache).stat().st_ino
        good = module(cache).read_bytes()
        keep = os.open(module(cache), os.O_RDONLY)  # so that its inode number is not given to the new file
        damage(module(cache))
        survived = opens(cache, package)
        os.close(keep)
        after = module(cache).stat()
        return survived and after.st_ino != before and after.st_size == len(good) and after.st_mode & 0o022 == 0

    return fault


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _stranger_owns_the_folder(cache: Path, package: Path) -> bool:
    cache.mkdir(mode=0o755)
    os.chown(cache, STRANGER, STRANGER)
    return refused(cache, package)


def _everybody_writes_the_folder(cache: Path, package: Path) -> bool:
    cache.mkdir()
    cache.chmod(0o777)
    survived = refused(cache, package)
    cache.chmod(0o1777)
    survived = survived and refused(cache, package)
    cache.chmod(0o700)
    return survived and opens(cache, package)


def _killed(whole_group: bool) -> Callable[[Path, Path], bool]:
    def fault(cache: Path, package: Path) -> bool:
        return any(_killed_while_building(cache, package, whole_group) for _ in range(20)) and opens(cache, package)

    return fault


def _killed_while_building(cache: Path, package: Path, whole_group: bool) -> bool:
    """Kill the process that builds; False, with an empty cache, if the build was finished before the kill."""
    process = start(OPEN, cache, package)
    while process.poll() is None and not (cache.is_dir() and leftovers(cache)):
        time.sleep(0.002)
    time.sleep(0.01)
    kill = os.killpg if whole_group else os.kill
    kill(process.pid, signal.SIGKILL)
    process.communicate()
    _wait_for_the_compiler(process.pid)
    if process.returncode == -signal.SIGKILL and leftovers(cache):
        return True
    shutil.rmtree(cache)
    return False


def _wait_for_the_compiler(group: int) -> None:
    """An orphan that still writes into its folder would keep that from being removed."""
    end = time.monotonic() + 10
    with contextlib.suppress(ProcessLookupError):
        while time.monotonic() < end:
            os.killpg(group, 0)
            time.sleep(0.005)


def _eight_at_once(cache: Path, package: Path) -> bool:
    packages = [package]
    for k in range(3):
        packages.append(package.with_name(f"variant_{k}"))
        shutil.copytree(package, packages[-1])
        with (packages[-1] / "toy.c").open("a", encoding="utf-8") as source:
            source.write(f"/* variant {k} */\n")
    processes = [start(OPEN, cache, packages[k % 4]) for k in range(8)]
    outputs = [process.communicate()[0] for process in processes]
    done = all(process.returncode == 0 for process in processes) and len(set(outputs)) == 1
    return done and len(list(cache.glob("*.so"))) == 4 and not leftovers(cache)


def _leftovers_are_removed(cache: Path, package: Path) -> bool:
    cache.mkdir(mode=0o700)
    for k in range(3):
        (cache / f"_nmpc_dead_{k}.building-abc").mkdir()
        (cache / f"_nmpc_dead_{k}.building-abc" / "package.o").write_text("half")
    for k in range(30):
        (cache / "failed" / f"_nmpc_{k}").mkdir(parents=True)
    source = package / "toy.c"
    good = source.read_text(encoding="utf-8")
    source.write_text(good + "int broken(void) { return undeclared; }\n", encoding="utf-8")
    if opens(cache, package) or len(list((cache / "failed").iterdir())) > 8:
        return False
    source.write_text(good, encoding="utf-8")
    return opens(cache, package)


def _deleted_while_in_use(cache: Path, package: Path) -> bool:
    return opens(cache, package, AFTERWARDS)


Fault = Callable[[Path, Path], bool]

FAULTS: dict[str, Fault] = {
    "truncated": _damaged(lambda path: os.truncate(path, path.stat().st_size // 2)),
    "empty": _damaged(lambda path: os.truncate(path, 0)),
    "flipped byte": _damaged(_flip),
    "without a checksum": _damaged(lambda path: path.with_name(f"{path.name.split('.')[0]}.sha256").unlink()),
    "module of a stranger": _damaged(lambda path: os.chown(path, STRANGER, STRANGER)),
    "module that everybody writes": _damaged(lambda path: path.chmod(0o777)),
    "folder of a stranger": _stranger_owns_the_folder,
    "folder that everybody writes": _everybody_writes_the_folder,
    "kill -9 during a build": _killed(whole_group=False),
    "kill -9 of build and compiler": _killed(whole_group=True),
    "8 processes at once": _eight_at_once,
    "leftover folders": _leftovers_are_removed,
    "deleted while in use": _deleted_while_in_use,
}
AS_ROOT = (FAULTS["module of a stranger"], FAULTS["folder of a stranger"])


def is_root() -> bool:
    """Only root can transfer files to another user."""
    return hasattr(os, "geteuid") and os.geteuid() == 0


def survived(fault: Fault) -> bool:
    """Run one fault on a new cache and a copy of the toy package."""
    with tempfile.TemporaryDirectory() as temporary:
        package = Path(temporary) / "toy"
        write(package, toy_sources())
        return fault(Path(temporary) / "cache", package)
