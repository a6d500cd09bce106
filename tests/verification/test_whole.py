"""The text that people edit compiles, and what is left out of it changes nothing: bits of closed loops."""

from __future__ import annotations

import pytest
from conftest import require_tool

from nmpc_codegen.targets import TARGETS
from verification import whole
from verification.samples import IN_LANES
from verification.timed import Sample

NATIVE = [sample for sample in IN_LANES if TARGETS[str(sample.options.target)].machine.startswith("x86")]


@pytest.mark.slow
@pytest.mark.parametrize("sample", NATIVE, ids=lambda s: s.name)
def test_whole_units_with_lanes_compile(sample: Sample) -> None:
    require_tool("gcc")
    assert whole.errors_of(whole.packages(sample)[1], *TARGETS[str(sample.options.target)].of_machine) == ""
