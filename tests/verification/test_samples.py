"""The samples on which rendering and style of the C are measured cover every part and every condition."""

from __future__ import annotations

import pytest
from conftest import require_tool

from nmpc_codegen.ir.cmodule import CModule
from verification.conditions import all_parts, covering, gaps, reached
from verification.samples import IN_LANES, SAMPLES
from verification.unresolved import COMPILERS, differing, lowered, objects_differ, texts


@pytest.fixture(scope="module")
def modules() -> tuple[CModule, ...]:
    return tuple(lowered(sample) for sample in (*SAMPLES, *IN_LANES))


def test_every_part_is_used_and_every_condition_true_once_and_false_once(modules: tuple[CModule, ...]) -> None:
    assert gaps(modules) == []


def test_names_are_unique() -> None:
    assert len({sample.name for sample in (*SAMPLES, *IN_LANES)}) == len(SAMPLES) + len(IN_LANES)


@pytest.mark.slow
def test_coverage_sees_a_missing_part_and_a_condition_of_one_value(modules: tuple[CModule, ...]) -> None:
    """Without OSQP its parts are missing; without a resampled plan no condition on it is true."""
    found = gaps(m for m in modules if not any("osqp" in section.template for section in m.sections))
    assert "qp/osqp.c: in no sample" in found
    found = gaps(m for m in modules if not m.switches["SHIFT_RESAMPLE"])
    assert any("#if SHIFT_RESAMPLE is never true" in line for line in found)


@pytest.mark.slow
def test_few_samples_cover_what_all_cover(modules: tuple[CModule, ...]) -> None:
    named = dict(zip((sample.name for sample in (*SAMPLES, *IN_LANES)), modules, strict=True))
    chosen = covering(named)
    assert len(chosen) < len(SAMPLES)
    assert gaps(named[name] for name in chosen) == []
    assert all(gaps(named[name] for name in chosen if name != left_out) for left_out in chosen[-3:])


@pytest.mark.slow
def test_coverage_walks_included_parts(modules: tuple[CModule, ...]) -> None:
    parts, values = reached(modules)
    assert parts == all_parts()
    assert all(value == {True, False} for value in values.values())


def test_raw_and_resolved_text_have_the_same_object_code() -> None:
    """Text with different behaviour has different object code."""
    sample = next(s for s in SAMPLES if s.name == "path dense")
    raw, resolved = texts(sample, resolved=False), texts(sample)
    name = sample.make().name
    assert resolved[f"{name}.c"].count("\n#if") < raw[f"{name}.c"].count("\n#if")
    assert not objects_differ(raw, resolved, ("gcc",), ("-O0",))
    changed = resolved[f"{name}.c"].replace("R(0.5)", "R(0.25)")
    assert changed != resolved[f"{name}.c"]
    assert objects_differ(raw, {**resolved, f"{name}.c": changed}, ("gcc",), ("-O0",))


@pytest.mark.slow
def test_raw_and_resolved_text_of_all_samples() -> None:
    for tool in (*COMPILERS, "objdump"):
        require_tool(tool)
    assert differing([(s.name, texts(s, resolved=False), texts(s)) for s in SAMPLES]) == []
