"""cache.py: damage, other users, killed and simultaneous builds."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from nmpc_codegen import open_package
from nmpc_codegen.errors import BuildError
from nmpc_codegen.lowering.beside.folder import write
from nmpc_codegen.runtime import cache
from tests.runtime import cache_faults
from verification.problems import toy_sources

pytestmark = pytest.mark.usefixtures("compiler")


@pytest.mark.few(2)
@pytest.mark.parametrize("case", sorted(set(cache_faults.FAULTS) - {"8 processes at once"}))
def test_fault(case: str) -> None:
    fault = cache_faults.FAULTS[case]
    if fault in cache_faults.AS_ROOT and not cache_faults.is_root():
        pytest.skip("only root can give files to another user")
    assert cache_faults.survived(fault)


@pytest.mark.slow
def test_eight_processes_at_once() -> None:
    assert cache_faults.survived(cache_faults.FAULTS["8 processes at once"])


def test_folder_is_private_under_any_mask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NMPC_CODEGEN_CACHE", str(tmp_path / "a" / "cache"))
    mask = os.umask(0)
    try:
        path = cache.entry("entry.so", lambda folder: (folder / "module").write_bytes(b"code") and None)
    finally:
        os.umask(mask)
    assert path.read_bytes() == b"code"
    assert all(p.stat().st_mode & 0o077 == 0 for p in (path.parent, *path.parent.rglob("*")))


def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NMPC_CODEGEN_CACHE", str(tmp_path / "cache"))

    def full(folder: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with (
        pytest.warns(RuntimeWarning, match="No space left"),
        pytest.raises(BuildError, match=r"cannot write to the cache .* temporary .*No space left .*NMPC_CODEGEN_CACHE"),
    ):
        cache.entry("entry.so", full)
    assert not cache_faults.leftovers(tmp_path / "cache")


def test_a_cache_that_cannot_be_written_to_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No warning for what is there already."""
    monkeypatch.setenv("NMPC_CODEGEN_CACHE", str(tmp_path / "cache"))
    path = cache.entry("entry.so", lambda folder: (folder / "module").write_bytes(b"code") and None)

    def fail(folder: Path, module: str) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(cache, "_lock", fail)
    assert cache.entry("entry.so", lambda folder: None) == path


def test_a_temporary_folder_of_a_killed_process_is_removed_by_the_next(tmp_path: Path) -> None:
    """Not that of a process that lives."""
    program = """
import os, sys, time
from nmpc_codegen.runtime.cache import temporary_directory
print(temporary_directory(), flush=True)
sys.stdin.read()
"""
    command = [sys.executable, "-c", program]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    killed, alive = (subprocess.Popen(command, env=environment, text=True, **pipes) for _ in range(2))  # type: ignore[call-overload]
    places = [Path(process.stdout.readline().strip()) for process in (killed, alive)]
    killed.kill()
    killed.wait()
    assert all(place.is_dir() for place in places)
    run = subprocess.run(command, env=environment, input="", capture_output=True, text=True, check=True)
    assert [place.is_dir() for place in places] == [False, True]
    assert not Path(run.stdout.strip()).exists()
    alive.communicate("")
    assert not list(tmp_path.iterdir())


def test_the_temporary_folder_is_removed_at_the_end(tmp_path: Path) -> None:
    """By the process that has made it, not by one that it has forked."""
    program = """
import os, sys
from nmpc_codegen.runtime.cache import temporary_directory
place = temporary_directory()
if os.fork() == 0:
    sys.exit(0)
os.wait()
print(place, place.is_dir())
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    place, alive = run.stdout.split()
    assert alive == "True"
    assert not Path(place).exists()


def test_a_link_is_no_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NMPC_CODEGEN_CACHE", str(tmp_path / "cache"))
    made: list[Path] = []

    def make(folder: Path) -> None:
        made.append(folder)
        (folder / "module").write_bytes(b"code")

    path = cache.entry("entry.so", make)
    assert cache.entry("entry.so", make) == path
    assert len(made) == 1
    path.rename(tmp_path / "elsewhere.so")
    path.symlink_to(tmp_path / "elsewhere.so")
    assert cache.entry("entry.so", make) == path
    assert len(made) == 2
    assert not path.is_symlink()


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"\xff\xfe", "is not UTF-8"), (b" " * (2**26 + 1), "bytes; expected at most")],
    ids=["not UTF-8", "100 MB"],
)
def test_a_file_that_cannot_be_read(tmp_path: Path, content: bytes, message: str) -> None:
    write(tmp_path, toy_sources())
    (tmp_path / "toy.json").write_bytes(content)
    with pytest.raises(BuildError, match=rf"toy\.json .*{message}"):
        open_package(tmp_path)
