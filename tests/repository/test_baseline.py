"""Exact numbers of packages grow by 2 % at most beyond tests/data/baseline.json; ``--update-baseline`` rewrites it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from nmpc_codegen import Options, RiccatiActiveSet, worst_case
from nmpc_codegen.compiler import text_of
from verification.c_harness import module_of
from verification.timed import TIMED, Sample

BASELINE = Path(__file__).parents[1] / "data" / "baseline.json"
SLACK = 1.02
SAMPLES = (
    *TIMED,
    Sample("crane without solve", TIMED[0].make, Options(solve=False)),
    Sample("quadrotor without solve", TIMED[2].make, Options(solve=False, qp=RiccatiActiveSet(fallback=None))),
)
_COMMENT = re.compile(r"/\*.*?\*/", re.S)


def numbers(sample: Sample) -> dict[str, int]:
    """Bytes of the struct and of the source without comments and indentation; operations of the linearisation."""
    module = module_of(sample.make(), sample.options)
    sources = text_of(module)
    lines = (line.strip() for line in _COMMENT.sub("", sources[f"{module.name}.c"]).splitlines())
    report = module.description.report
    return {
        "struct_bytes": report.ram_bytes,
        "source_bytes": sum(len(line.encode()) + 1 for line in lines if line),
        "linearization_operations": report.linearization_operations,
        "worst_operations": worst_case(sources)["sample"],
    }


def test_numbers_do_not_grow(request: pytest.FixtureRequest) -> None:
    found = {sample.name.removeprefix("timed "): numbers(sample) for sample in SAMPLES}
    if request.config.getoption("--update-baseline"):
        BASELINE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    known = json.loads(BASELINE.read_text(encoding="utf-8"))
    assert {name: set(values) for name, values in known.items()} == {name: set(v) for name, v in found.items()}
    grown = [
        f"{name}: {key} {known[name][key]} -> {value}"
        for name, values in found.items()
        for key, value in values.items()
        if value > SLACK * known[name][key]
    ]
    assert not grown
