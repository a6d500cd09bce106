"""Findings of linters on the C of the samples: clang-tidy, clang -Weverything, gcc -fanalyzer, cppcheck.

A finding consists of a check, its message and its line of C, and counts once, no matter how many samples show it.
A comparison of floating-point numbers for equality is no finding if there is a comment on its line or directly above.
A printed kernel is as long as the user's model: its length and its complexity are no findings about the core, and are
counted separately. Findings of gcc -fanalyzer in a kernel about uninitialised values are ignored: the analyzer forgets
values that a loop stores at ``tape[8 * step]`` before another loop loads them. All other messages are findings.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.package.sources import Sources
from verification.quality import package_name, written
from verification.rendered import lowered, texts
from verification.timed import Sample

ROOT = Path(__file__).parents[2]
JOBS = os.cpu_count() or 1

#: Tool -> command, which is followed by the file.
TOOLS: dict[str, tuple[str, ...]] = {
    "clang-tidy": ("clang-tidy", "--quiet", f"--config-file={ROOT / '.clang-tidy'}"),
    "clang": ("clang", "-fsyntax-only", "-std=c99", "-Weverything", "-Wno-padded", "-Wno-declaration-after-statement"),
    "gcc": ("gcc", "-std=c99", "-O2", "-fanalyzer", "-c", "-o", "/dev/null"),
    "cppcheck": (
        *("cppcheck", "--quiet", "--std=c99", "--language=c", "--max-configs=1", "--suppress=toomanyconfigs"),
        *(
            "--enable=warning,style,performance,portability",
            "--template={file}:{line}:{column}: warning: {message} [{id}]",
        ),
    ),
}
#: Arguments of clang-tidy after the file.
TRAILING = {"clang-tidy": ("--", "-std=c99")}
_FINDING = re.compile(r"^([^\s:]+):(\d+):\d+: (?:warning|error): (.*?)(?: \[CWE-\d+\])? \[([\w.,+=-]+)\]$", re.M)
#: Checks of the length of a function.
LENGTH = ("readability-function-size", "readability-function-cognitive-complexity")
_FUNCTION = re.compile(r"function '(\w+)'")
#: The check of gcc that fails on loops with symbolic offsets, and the line in which gcc names the function.
UNINITIALIZED = "-Wanalyzer-use-of-uninitialized-value"
_INSIDE = re.compile(r"In function [‘'](\w+)[’']")
_COMMENT = re.compile(r"/\*|\*/|//")


@dataclass(frozen=True)
class Finding:
    """A message of a check of a tool about a line.

    origin: the part or the file of the package that contains the line.
    of_length: the message is about the length of a printed kernel.
    """

    tool: str
    check: str
    message: str
    line: str
    origin: str
    of_length: bool = False


def findings(samples: Iterable[Sample], tools: Iterable[str] = tuple(TOOLS)) -> set[Finding]:
    """Distinct findings of the tools over the packages of the samples."""
    work = [(tool, texts(sample), _printed(sample)) for sample in samples for tool in tools]
    with ThreadPoolExecutor(JOBS) as pool:
        return {finding for found in pool.map(lambda job: run(*job), work) for finding in found}


def _printed(sample: Sample) -> frozenset[str]:
    """Names of the functions that are printed from the model."""
    routines = lowered(sample).routines
    return frozenset(name for routine in routines for name in (routine.name, *(k.name for k in routine.kernels)))


def run(tool: str, sources: Sources, printed: Collection[str] = ()) -> set[Finding]:
    """Findings of one tool on one package; ``printed``: names of its printed kernels.

    Raises:
        RuntimeError: the tool failed without a finding.
    """
    name = package_name(sources)
    with written(sources) as folder:
        command = [*TOOLS[tool], f"{name}.c", *TRAILING.get(tool, ())]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    found = set(_parsed(tool, done.stdout + done.stderr, sources, printed))
    if done.returncode and not found:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr[-1000:]}")
    return found


def _parsed(tool: str, text: str, sources: Mapping[str, str], printed: Collection[str]) -> Iterator[Finding]:
    for found in _FINDING.finditer(text):
        path, number, message, check = found.groups()
        file = Path(path).name
        lines = sources[file].splitlines() if file in sources else []
        line = lines[int(number) - 1] if lines else ""
        before = lines[int(number) - 2] if int(number) > 1 and lines else ""
        if "float-equal" in check and (_COMMENT.search(line) or before.rstrip().endswith("*/")):
            continue
        if check == UNINITIALIZED and set(_INSIDE.findall(text[: found.start()])[-1:]) & set(printed):
            continue
        function = _FUNCTION.search(message)
        of_length = check in LENGTH and function is not None and function[1] in printed
        yield Finding(tool, check, message, line.strip(), _origin(line.strip(), file), of_length)


def _origin(line: str, file: str) -> str:
    """Parts that contain the line; the file of the package if none or many do."""
    parts = _parts_by_line().get(line, ())
    return " ".join(parts) if 0 < len(parts) <= 3 else file


@cache
def _parts_by_line() -> dict[str, tuple[str, ...]]:
    found: dict[str, set[str]] = defaultdict(set)
    root = template_directory()
    for path in [*root.rglob("*.c"), *root.rglob("*.jinja")]:
        for line in path.read_text(encoding="utf-8").splitlines():
            found[line.strip()].add(str(path.relative_to(root)))
    return {line: tuple(sorted(parts)) for line, parts in found.items()}
