"""Traces in the .c of a package of features that its problem does not use, counted by kind.

Kinds: loops over a size of 0, ``(void)`` statements, empty functions, functions without a caller (also inline ones),
unused macros and tables, tables of size 0.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from benchmarks.lib.house.samples import SAMPLES
from benchmarks.lib.house.timed import TIMED
from benchmarks.lib.report import Report
from nmpc_codegen import generate

#: Every example with the options shown in it, and with those for which it is timed.
EXAMPLES = (*SAMPLES[:6], *TIMED)

WARNINGS = {
    "unused_functions": "unused-function",
    "unused_macros": "unused-macros",
    "unused_tables": "unused-const-variable=2",
}


def measure(report: Report) -> None:
    """traces: all kinds together, in the package of every example; the kinds found are printed."""
    for sample in EXAMPLES:
        found = {kind: n for kind, n in traces(generate(sample.make(), sample.options)).items() if n}
        if found:
            print(f"traces ({sample.name}): {found}")
        report.add("traces", sum(found.values()), case=sample.name, limit=0)


def traces(sources: Mapping[str, str]) -> dict[str, int]:
    """Kind of trace -> its number of occurrences in a package (path -> text, as generate() returns it)."""
    unit = next(path for path in sources if path.endswith(".c") and path != "main.c" and "/" not in path)
    prefix = unit.removesuffix(".c").upper()
    text = re.sub(r"/\*.*?\*/", " ", sources[unit], flags=re.DOTALL)
    header = sources[unit.removesuffix(".c") + ".h"]
    zero = {name for name, value in re.findall(rf"#define {prefix}_(\w+) (\d+)", header) if int(value) == 0}
    heads = re.findall(r"\bfor \((?:int )?[^;]*;([^;]*);", text)
    return {
        "empty_loops": sum(
            any(re.search(rf"<=? *(?:{prefix}_)?{name}\b *(?:$|&&|\))", h) for name in zero) for h in heads
        )
        + sum(bool(re.search(r"< *0 *(?:$|&&|\))", h)) for h in heads),
        "void_statements": len(re.findall(r"^\s*\(void\)\s*\w+\s*;", text, re.MULTILINE)),
        "empty_functions": len(re.findall(r"^\w[^;{}]*\)\s*\{\s*(?:\(void\)\s*\w+\s*;\s*)*\}", text, re.MULTILINE)),
        "empty_tables": len(re.findall(r"\bstatic const \w+ \w+\[0\] =|= \{\s*\};", text)),
        **{kind: _warned(sources, unit, warning) for kind, warning in WARNINGS.items()},
    }


def _warned(sources: Mapping[str, str], unit: str, warning: str) -> int:
    """Number of warnings of gcc about the unit of this kind; all functions are treated as not inline."""
    with tempfile.TemporaryDirectory() as folder:
        for path, text in sources.items():
            if path.endswith((".c", ".h")):
                (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
                (Path(folder) / path).write_text(text.replace("static inline ", "static "), encoding="utf-8")
        command = ["gcc", "-std=c99", "-fsyntax-only", f"-W{warning}", unit]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return run.stderr.count(f"[-W{warning}]")
