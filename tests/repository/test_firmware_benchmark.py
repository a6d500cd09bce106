"""The harness of the benchmarks of firmware, with few samples, and the record of deviations."""

from __future__ import annotations

import dataclasses
import re

import pytest
from conftest import missing, require_tool

from benchmarks import firmware
from benchmarks.lib.firmware import emulated, loops, misra, single, sizes
from benchmarks.lib.report import Report
from nmpc_codegen import generate
from nmpc_codegen.firmware.certificate import certify
from nmpc_codegen.firmware.deviations import DEVIATIONS
from nmpc_codegen.firmware.targets import TARGETS


def crane(precision: str = "single") -> loops.Loop:
    return loops.with_precision(loops.loops()[0], precision)


def test_a_loop_on_a_board() -> None:
    for tool in ("cc", "arm", "qemu"):
        require_tool(tool)
    report = Report("test")
    emulated.one(report, crane(), "cortex-m4f", 10)
    found = {record.key: record.value for record in report.records}
    assert {found[key] for key in ("emulator_mismatches", "stack_violations", "certificate_mismatches")} == {0}
    assert 10_000 < found["crane_instructions"] <= found["crane_instructions_worst"] < 1e6


def test_sizes_of_a_small_package() -> None:
    require_tool("arm")
    loop, report = crane(), Report("test")
    name, sources = loops.package(loop, loops.small(loop))
    sizes.add(report, "crane", "small", [certify(sources, name, TARGETS["cortex-m4f"], "Os")])
    found = {record.key: record for record in report.records}
    assert found["crane_flash_bytes"].value <= 20_000
    assert found["crane_flash_bytes"].limit == 20_000
    assert found["crane_ram_bytes_single_rti"].value <= 6_500
    assert found["stack_worst_bytes"].value <= 2_500


def test_single_against_double(monkeypatch: pytest.MonkeyPatch) -> None:
    require_tool("cc")
    course = single.of_loop(loops.loops()[0], 10)
    monkeypatch.setattr(single, "courses", lambda scale: [course])
    report = Report("test")
    single.single(report, 1.0)
    found = {record.key: record.value for record in report.records}
    assert 0 < found["float_cost_gap"] < 1e-3
    assert found["float_status_differs"] == 0


def test_a_course_sees_another_weight() -> None:
    """The cost is that of the problem: it changes with the controls, not by the factor of the controller's weight."""
    require_tool("cc")
    course = single.of_loop(loops.loops()[0], 10)
    plant = single.build(course.make(), course.options, profile="verify")

    def slow(controller: single.Controller) -> None:
        controller.set_weight([1.0, 1.0, 1.0, 1.0, 100.0])

    plain, other = (single.drive(c, "double", plant) for c in (course, dataclasses.replace(course, start=slow)))
    assert 0.01 < abs(other.cost.sum() / plain.cost.sum() - 1) < 1


def test_missing_programs_leave_parts_out(monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(firmware.NEEDS) <= set(firmware.PARTS)
    monkeypatch.setenv("PATH", "")
    assert firmware.missing("boards") == ["arm-none-eabi-gcc", "qemu-system-arm"]
    assert firmware.missing("single") == []


def test_deviations_are_documented() -> None:
    """Every rule of which the addon reports a finding in the crane has a reason."""
    require_tool("cppcheck")
    found = misra.findings(generate(crane().make()), "crane")
    if found is None:
        missing("this cppcheck has no MISRA addon", "misra")
    assert found, "the addon reports nothing: is the test blind?"
    assert not set(found) - set(DEVIATIONS)
    assert all(re.fullmatch(r"\d+\.\d+", rule) and len(reason) > 20 for rule, reason in DEVIATIONS.items())
