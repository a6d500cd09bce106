"""The command nmpc-export run on a case: in a process of its own, or in a fork of this one."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

from tests.cli.hostile import GOOD, Case
from tests.snippets import ROOT

CASE_SECONDS = 20.0


@dataclass(frozen=True)
class End:
    """How a case ended; status None: not within the time limit."""

    status: int | None
    output: str
    errors: str


def judge(case: Case, end: End) -> str:
    """Description of the fault in the end of a case; "" if there is none."""
    if end.status is None:
        return "not in time"
    if "Traceback (most recent call last)" in end.output + end.errors:
        return "traceback"
    if end.status not in (0, 1, 2):
        return f"status {end.status}"
    if end.status not in case.statuses:
        return f"status {end.status} instead of {' or '.join(map(str, case.statuses))}"
    if end.status and not end.errors.strip():
        return "not a word"
    return ""


def _write(case: Case, folder: Path) -> None:
    for name, content in case.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def in_process(case: Case, folder: Path, surroundings: dict[str, str], seconds: float) -> End:
    """Run the case as a separate process."""
    _write(case, folder)
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "MPLBACKEND": "Agg", **surroundings}
    command = [sys.executable, "-m", "nmpc_codegen.cli", *case.arguments]
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return End(None, "", "")
    return End(done.returncode, done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace"))


def forked(case: Case, folder: Path, seconds: float = CASE_SECONDS) -> End:
    """Run the case in a fork of this process, which has imported all modules."""
    _preload()
    where = folder / "where"
    where.mkdir()
    _write(case, where)
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        _be_the_command(case, folder, where)
    status = _wait(child, time.monotonic() + seconds)
    output, errors = ((folder / name).read_text(encoding="utf-8", errors="replace") for name in ("output", "errors"))
    return End(status, output, errors)


def _preload() -> None:
    import nmpc_codegen.cli.check
    import nmpc_codegen.cli.listing
    import nmpc_codegen.compiler  # noqa: F401


def _be_the_command(case: Case, folder: Path, where: Path) -> None:
    """In the fork: run the command line to its end; never returns."""
    status = 70
    try:
        for number, name in ((1, "output"), (2, "errors")):
            os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        output, errors = (os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))
        sys.stdout, sys.stderr = output, errors
        sys.__stdout__, sys.__stderr__ = output, errors  # type: ignore[misc]
        os.chdir(where)
        sys.argv = ["nmpc-export", *case.arguments]
        from nmpc_codegen.cli import main

        status = main()
    except BaseException:
        os.write(2, traceback.format_exc().encode(errors="backslashreplace"))
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _wait(child: int, until: float) -> int | None:
    """Exit status of a child; None if it was killed at its time limit."""
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def good() -> Case:
    """A case without a fault."""
    return Case("good", ("problem.py", "-o", "out"), {"problem.py": (GOOD + "ocp = good()\n").encode()}, (0,))
