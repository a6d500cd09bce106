"""rendering_differences: samples whose object code depends on how their text was rendered."""

from __future__ import annotations

import shutil
from collections.abc import Sequence

from benchmarks.lib.house.commits import packages_of
from benchmarks.lib.house.samples import SAMPLES
from benchmarks.lib.house.timed import Sample
from benchmarks.lib.house.unresolved import COMPILERS, differing, texts
from benchmarks.lib.report import Report


def measure(report: Report, before: str | None = None, samples: Sequence[Sample] = SAMPLES) -> None:
    """Compare raw with resolved text; with ``before``, also packages of that commit with those of this tree."""
    if any(shutil.which(program) is None for program in (*COMPILERS, "objdump")):
        print("rendering_differences: absent, it needs gcc, clang and objdump")
        return
    resolved = {sample.name: texts(sample) for sample in samples}
    pairs = {"raw, resolved": [(s.name, texts(s, resolved=False), resolved[s.name]) for s in samples]}
    if before is not None:
        old = packages_of(before, [sample.name for sample in samples])
        pairs[f"{before}, this tree"] = [(s.name, dict(old[s.name]), resolved[s.name]) for s in samples]
    for case, compared in pairs.items():
        different = differing(compared)
        if different:
            print(f"rendering_differences ({case}): {', '.join(different)}")
        report.add("rendering_differences", len(different), "samples", case=case, limit=0, n=len(compared))
