"""Warnings of gcc and clang on every combination of example, QP solver with its condensing, precision and shift.

    python -m benchmarks.lib.doors.doors_warnings [--json FILE]

Clang warns in its front end. The warnings of gcc about values that may be uninitialised need its optimiser: packages in
double precision are compiled at -O2. In single precision the flow of the data is the same, so that -O0 is sufficient
for conversions and promotions; its front end alone would not report unused functions. Both compile the packages as C99;
tests/lowering/test_warnings.py compiles them as C++17, too.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from benchmarks.lib import quality
from benchmarks.lib.combinations import Combination, combinations
from benchmarks.lib.report import Report, arguments
from nmpc_codegen.errors import OptionError
from nmpc_codegen.lowering.render import Sources

#: Options that find all warnings, by compiler and precision.
FLAGS = {
    ("gcc", "double"): "-O2",
    ("gcc", "single"): "-O0",
    ("clang", "double"): "-fsyntax-only",
    ("clang", "single"): "-fsyntax-only",
}


def measure(report: Report, chosen: Iterable[Combination] | None = None) -> None:
    """Add ``warnings_all_combinations`` for every compiler that the machine has, and how many combinations there are.

    ``chosen``: combinations to compile; None: all.
    """
    compilers = [c for c, programs in quality.COMPILERS.items() if shutil.which(programs["C99"])]
    counts: dict[str, list[Future[int]]] = {compiler: [] for compiler in compilers}
    known: dict[str, Future[int]] = {}
    generated = refused = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for combination in combinations() if chosen is None else chosen:
            try:
                sources = combination.generate()
            except OptionError:
                refused += 1
                continue
            generated += 1
            for compiler in compilers:
                flag = FLAGS[compiler, combination.precision]
                key = _key(sources, compiler, flag)
                if key not in known:
                    known[key] = pool.submit(_warnings, sources, compiler, flag)
                counts[compiler].append(known[key])
    for compiler, found in counts.items():
        total = sum(f.result() for f in found)
        report.add("warnings_all_combinations", total, case=compiler, n=generated, limit=0)
    report.add("warning_combinations", generated, n=generated)
    report.add("warning_combinations_refused", refused, n=generated + refused)


def _key(sources: Sources, compiler: str, flag: str) -> str:
    """Key that is equal for equal texts, without their metadata."""
    texts = (text for path in sorted(sources) if path.endswith((".c", ".h")) for text in (path, sources[path]))
    return hashlib.sha256("\0".join((compiler, flag, *texts)).encode()).hexdigest()


def _warnings(sources: Sources, compiler: str, flag: str) -> int:
    return quality.count_warnings(quality.warnings_of(sources, (flag,), ("C99",), compiler))


if __name__ == "__main__":
    given = arguments("Warnings of gcc and clang on every combination of the examples with solvers and shifts.")
    collected = Report("warnings of gcc and clang")
    measure(collected)
    collected.print()
    if given.json:
        collected.write(given.json)
