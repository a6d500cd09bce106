"""The command line from outside: every example, every snippet of the documents, and hostile files and flags.

cli_examples_failed    examples that nmpc-export does not turn into a package that passes its check
docs_snippets_failed   fenced blocks of README.md and docs/*.md that do not behave as their text states
tracebacks             hostile cases that end in a traceback, an unknown status, or without a message
silent_hours           hostile cases that do not end in time
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.lib.doors.hostile import GOOD, Case, catalogue
from benchmarks.lib.doors.snippets import ROOT, documents, walk
from benchmarks.lib.report import Report

EXAMPLE_SECONDS = 300
CASE_SECONDS = 20.0
PROCESSES = 80  # Hostile cases with an interpreter of their own; the others run in forks of this one.
UNCHECKED = {"chain"}  # IPOPT takes minutes
ENVIRONMENTS: tuple[dict[str, str], ...] = (
    {},
    {"PYTHONIOENCODING": "ascii"},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"PYTHONIOENCODING": "ascii:strict", "COLUMNS": "20", "TERM": "dumb"},
)


@dataclass(frozen=True)
class End:
    """How a case ended; status None: not within the time limit."""

    status: int | None
    output: str
    errors: str


def measure(report: Report) -> None:
    """All four figures."""
    measure_examples(report)
    measure_snippets(report)
    measure_hostile(report, catalogue())


def measure_examples(report: Report) -> None:
    """Every file in examples/ through the command, in a separate folder."""
    paths = sorted((ROOT / "examples").glob("[!_]*.py"))
    failed = {path.stem: 0 if _exports(path) else 1 for path in paths}
    report.add("cli_examples_failed", sum(failed.values()), "examples", case="all", n=len(paths), limit=0)
    for name, value in failed.items():
        report.add("cli_examples_failed", value, "examples", case=name, limit=0)


def _exports(path: Path) -> bool:
    check = () if path.stem in UNCHECKED else ("--check",)
    with tempfile.TemporaryDirectory() as folder:
        end = in_process(Case(path.stem, (str(path), *check)), Path(folder), {}, EXAMPLE_SECONDS)
        written = list(Path(folder).glob("out/*/*.c"))
    if end.status != 0:
        print(end.output[-2000:], end.errors)
    return end.status == 0 and len(written) > 0 and ("check passed" in end.output or not check)


def measure_snippets(report: Report) -> None:
    """Every fenced block, in the order of its document."""
    failed: dict[str, int] = {}
    for document in documents():
        with tempfile.TemporaryDirectory() as folder:
            for name, _, error in walk(document, Path(folder)):
                failed[name] = 1 if error else 0
                if error:
                    print(name, error[-2000:])
    report.add("docs_snippets_failed", sum(failed.values()), "snippets", case="all", n=len(failed), limit=0)
    for name, value in failed.items():
        report.add("docs_snippets_failed", value, "snippets", case=name, limit=0)


def measure_hostile(report: Report, cases: Sequence[Case]) -> None:
    """Every case once; some of them as separate processes in unusual environments."""
    apart = set(random.Random(2).sample([i for i, c in enumerate(cases) if passes(c)], min(PROCESSES, len(cases))))
    bad: dict[str, str] = {}
    late: dict[str, str] = {}
    for i, case in enumerate(cases):
        surroundings = ENVIRONMENTS[i % len(ENVIRONMENTS)]
        with tempfile.TemporaryDirectory() as folder:
            end = (
                in_process(case, Path(folder), surroundings, CASE_SECONDS) if i in apart else forked(case, Path(folder))
            )
        fault = judge(case, end)
        if fault:
            (late if end.status is None else bad)[case.name] = fault
            print(f"{case.name}: {fault}: {end.errors[-300:]}")
    for key, found in (("tracebacks", bad), ("silent_hours", late)):
        report.add(key, len(found), "cases", case="all", n=len(cases), limit=0)
        for name, fault in found.items():
            report.add(key, 1, "cases", case=f"{name}: {fault}"[:60], limit=0)


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


def passes(case: Case) -> bool:
    """True if the operating system passes such arguments to a process."""
    return not any("\0" in argument for argument in case.arguments)


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
