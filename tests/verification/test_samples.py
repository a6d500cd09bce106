"""The samples on which rendering and style of the C are measured cover every part and every condition."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from conftest import require_tool

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.dialect.directives import resolve
from nmpc_codegen.lowering.unit.read import read_part
from verification.conditions import all_parts, covering, gaps, reached
from verification.contracts.contract import FILE, chosen_by_the_compiler
from verification.rendered import lowered
from verification.samples import IN_LANES, SAMPLES


@pytest.fixture(scope="module")
def modules() -> tuple[CModule, ...]:
    return tuple(lowered(sample) for sample in (*SAMPLES, *IN_LANES))


def test_every_part_is_used_and_every_condition_true_once_and_false_once(modules: tuple[CModule, ...]) -> None:
    assert gaps(modules) == []


@pytest.mark.usefixtures("modules")
def test_the_file_of_components_is_what_the_compiler_chooses() -> None:
    """After a change of samples or defaults: python -m verification --write."""
    known = json.loads(FILE.read_text(encoding="utf-8"))
    assert [s.name for s in SAMPLES if known[s.name] != chosen_by_the_compiler(s)] == []


def test_names_are_unique() -> None:
    assert len({sample.name for sample in (*SAMPLES, *IN_LANES)}) == len(SAMPLES) + len(IN_LANES)


@pytest.mark.slow
def test_coverage_sees_a_missing_part_and_a_condition_of_one_value(modules: tuple[CModule, ...]) -> None:
    """Without OSQP its parts are missing; without a resampled plan no condition on it is true."""
    found = gaps(m for m in modules if not any("osqp" in section.template for section in m.sections))
    assert "qp/osqp.c: in no sample" in found
    found = gaps(m for m in modules if not m.features.shift_resample)
    assert any("SHIFT_RESAMPLE is never true" in line for line in found)


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


def test_conditions_are_resolved_as_the_preprocessor_does(modules: tuple[CModule, ...], tmp_path: Path) -> None:
    """The words of the parts, with the directives and without."""
    require_tool("gcc")
    for module in modules[::9]:
        defined = "".join(f"#define {name} {value}\n" for name, value in module.sizes.items())
        texts = [read_part(section.template, lambda path: "") for section in module.sections]
        for text in texts:
            assert _words(defined + text, tmp_path) == _words(defined + resolve(text, module.sizes), tmp_path)


def _words(text: str, folder: Path) -> list[str]:
    (folder / "part.c").write_text(text)
    command = ["gcc", "-E", "-P", "-Wundef", "-Werror", str(folder / "part.c")]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
