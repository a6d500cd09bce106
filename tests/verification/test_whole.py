"""The text that people edit compiles, and what is left out of it changes nothing: bits of closed loops."""

from __future__ import annotations

import pytest
from conftest import require_tool

from nmpc_codegen.targets import TARGETS
from verification import whole
from verification.samples import IN_LANES, SAMPLES
from verification.timed import Sample

#: Of every algorithm, QP solver and condensing one; the others are slow.
FEW = (
    "crane",
    "crane riccati single",
    "heater alone",
    "everything dense",
    "everything at stages",
    "tuned weights",
    "loop augmented",
    "soft rows lumped",
)
NATIVE = [sample for sample in IN_LANES if TARGETS[str(sample.options.target)].machine.startswith("x86")]


def differences(sample: Sample, *flags: str) -> list[str]:
    """What the compiler says of the whole unit, and the lines in which the closed loops differ."""
    require_tool("gcc")
    package, complete = whole.packages(sample)
    if refused := whole.errors_of(complete, *flags):
        return refused.splitlines()
    ours, theirs = (whole.closed_loop(text, *flags).splitlines() for text in (package, complete))
    assert len(ours) == len(theirs) >= 20
    return [f"{one} != {other}" for one, other in zip(ours, theirs, strict=True) if one != other]


@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.name in FEW], ids=lambda s: s.name)
def test_the_package_does_what_the_whole_text_does(sample: Sample) -> None:
    assert differences(sample) == []


@pytest.mark.slow
@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.name not in FEW], ids=lambda s: s.name)
def test_all_packages_do(sample: Sample) -> None:
    assert differences(sample) == []


@pytest.mark.slow
@pytest.mark.parametrize("sample", NATIVE, ids=lambda s: s.name)
def test_whole_units_with_lanes_compile(sample: Sample) -> None:
    require_tool("gcc")
    assert whole.errors_of(whole.packages(sample)[1], *TARGETS[str(sample.options.target)].of_machine) == ""
