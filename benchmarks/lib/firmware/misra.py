"""Findings of cppcheck's MISRA C:2012 addon, by rule, against the deviations that the project documents."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.lib.firmware.loops import loops, package
from benchmarks.lib.report import Report
from nmpc_codegen.firmware.deviations import DEVIATIONS

_FINDING = re.compile(r"^misra-c2012-(\d+\.\d+) ", re.MULTILINE)

#: Loops whose packages are examined.
EXAMINED = ("crane",)


def findings(sources: dict[str, str], name: str) -> Counter[str] | None:
    """Rule -> number of findings in a package; None if cppcheck has no such addon."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for ext in ("h", "c"):
            (folder / f"{name}.{ext}").write_text(sources[f"{name}.{ext}"], encoding="utf-8")
        command = ["cppcheck", "--addon=misra", "--std=c99", "--quiet", "--template={id} {line}", f"{name}.c"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0 or "addon" in done.stderr.lower():
        return None
    return Counter(_FINDING.findall(done.stderr))


def rules(report: Report, scale: float) -> None:
    """Findings of rules without a documented deviation."""
    for loop in (loop for loop in loops() if loop.name in EXAMINED):
        name, sources = package(loop, loop.options)
        found = findings(sources, name)
        if found is None:
            continue
        open_rules = {rule: n for rule, n in found.items() if rule not in DEVIATIONS}
        case = f"{loop.name}: {', '.join(f'{rule} ({n})' for rule, n in sorted(open_rules.items())) or 'none'}"
        report.add("misra_undocumented", sum(open_rules.values()), case=case, limit=0, profile="")
        report.add("misra_documented", sum(found.values()) - sum(open_rules.values()), case=loop.name, profile="")
