"""Findings of cppcheck's MISRA C:2012 addon against the deviations that the project documents."""

from __future__ import annotations

from benchmarks.lib.firmware.loops import loops, package
from benchmarks.lib.report import Report
from nmpc_codegen.firmware.deviations import DEVIATIONS
from verification.misra import findings

#: Loops whose packages are examined.
EXAMINED = ("crane",)


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
