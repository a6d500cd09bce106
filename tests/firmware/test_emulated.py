"""firmware/: packages on emulated boards, their certificates, and faults that must be found."""

from __future__ import annotations

import dataclasses
import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool

from examples import crane
from nmpc_codegen import OCP, AdjointShooting, BuildError, Options, generate
from nmpc_codegen.firmware.certificate import Certificate, certify
from nmpc_codegen.firmware.delivery import record_loop, sentences
from nmpc_codegen.firmware.image import build
from nmpc_codegen.firmware.recording import TOLERANCE, Event, Recording, ranges, record
from nmpc_codegen.firmware.toolchain import compile_flags, find
from nmpc_codegen.firmware.verify import Verdict, compare, verify
from nmpc_codegen.runtime.build import load
from nmpc_codegen.targets import TARGETS
from verification import problems

SAMPLES = 12
X0 = np.array([2.0, 0.0, 0.0, 0.0])
BOARDS = [("cortex-m7", "double"), ("cortex-m4f", "single"), ("cortex-m3", "single"), ("riscv32", "single")]


@pytest.fixture(scope="module", autouse=True)
def _tools() -> None:
    require_tool("cc")
    require_tool("arm")


def package(precision: str) -> dict[str, str]:
    return dict(problems.sources("crane_weight", precision))


def recording(precision: str, **more: Any) -> Recording:
    controller = load(package(precision), "crane", "verify")
    moved = Event(6, "set_reference", np.array([0.5, 0, 0, 0, 0]))
    end = Event(6, "set_terminal_reference", np.array([0.5, 0, 0, 0]))
    return record(controller, X0, SAMPLES, events=(moved, end), **more)


@pytest.fixture(scope="module")
def outcome(request: pytest.FixtureRequest) -> tuple[Recording, Certificate, Verdict]:
    target, precision = request.param
    for tool in ("riscv", "qemu-riscv32") if target == "riscv32" else ("arm", "qemu"):
        require_tool(tool)
    sources, inputs = package(precision), recording(precision)
    certificate = certify(sources, "crane", TARGETS[target])
    return inputs, certificate, verify(sources, "crane", inputs, TARGETS[target], "O2", certificate.stack_worst)


@pytest.mark.few(2)
@pytest.mark.parametrize("outcome", BOARDS, indirect=True, ids=lambda board: board[0])
def test_target_and_host_agree(outcome: tuple[Recording, Certificate, Verdict]) -> None:
    inputs, certificate, verdict = outcome
    assert verdict.passed
    assert verdict.statuses == 0
    assert verdict.error < 1e-6 if certificate.precision == "single" else verdict.error < 1e-14
    assert np.ptp(inputs.u) > 0.5, "the loop does something"
    assert verdict.samples == SAMPLES == len(verdict.run.u)
    assert 1000 < verdict.run.median <= verdict.run.worst


@pytest.mark.few(2)
@pytest.mark.parametrize("outcome", BOARDS, indirect=True, ids=lambda board: board[0])
def test_stack_of_the_run_is_within_the_certificate(outcome: tuple[Recording, Certificate, Verdict]) -> None:
    _, certificate, verdict = outcome
    assert {"init", "prepare", "feedback", "step", "solve", "kkt"} <= set(verdict.run.stack)
    assert not {e: used for e, used in verdict.run.stack.items() if used > certificate.stack_bytes[e]}
    assert verdict.run.stack["feedback"] > 100
    assert certificate.stack_bytes["step"] >= certificate.stack_bytes["prepare"] > 0


@pytest.mark.few(2)
@pytest.mark.parametrize("outcome", BOARDS, indirect=True, ids=lambda board: board[0])
def test_certificate(outcome: tuple[Recording, Certificate, Verdict]) -> None:
    inputs, certificate, _ = outcome
    assert certificate.struct_bytes == inputs.description.report.ram_bytes
    assert certificate.flash_bytes > certificate.flash_bytes_without_solve > certificate.flash_bytes_real_time > 5000
    suffix = "f" if certificate.precision == "single" else ""
    assert {f"sin{suffix}", f"cos{suffix}"} <= set(certificate.math_functions)
    assert certificate.double_functions == ()
    assert (certificate.arithmetic == "software") == (certificate.target in ("cortex-m3", "riscv32"))
    assert certificate.worst_operations["sample"] > 0


@pytest.mark.slow
def test_an_algorithm_without_phases() -> None:
    """A sample of single shooting is one call of step(); its struct is a ninth of that of a real-time iteration."""
    require_tool("qemu")
    options = Options(algorithm=AdjointShooting(), precision="single", solve=False)
    sources = generate(crane.build_ocp(), options)
    inputs = record_loop(sources, "crane")
    certificate = certify(sources, "crane", TARGETS["cortex-m4f"])
    verdict = verify(sources, "crane", inputs, TARGETS["cortex-m4f"])
    assert verdict.passed
    assert verdict.run.stack["step"] <= certificate.stack_bytes["step"]
    assert "feedback" not in verdict.run.stack
    assert certificate.struct_bytes <= 1280


def test_an_implicit_scheme() -> None:
    """The same bits on the board, stages and all, inside the stack of the certificate."""
    require_tool("qemu")
    ocp = OCP("stiff", intervals=[0.2, 0.2, 0.3, 0.5])
    x, r, u = ocp.state("x", initial=1.0), ocp.state("r", initial=0.8), ocp.control("u")
    ocp.dynamics({x: -r + u, r: 400 * (ca.sin(x) - r - 0.2 * r**3)})
    ocp.least_squares(ca.vertcat(x, r, u), weight=[1, 0.5, 0.1])
    ocp.subject_to(-0.4, u, 0.4)
    sources = generate(ocp, Options(target="cortex-m4f", precision="single"))
    assert sources.description.options["integrator"] == "ImplicitRungeKutta"
    certificate = certify(sources, "stiff", TARGETS["cortex-m4f"])
    inputs, of_target = record_loop(sources, "stiff"), TARGETS["cortex-m4f"]
    verdict = verify(sources, "stiff", inputs, of_target, "O2", certificate.stack_worst)
    assert verdict.passed
    assert verdict.error == 0.0
    assert not {e: used for e, used in verdict.run.stack.items() if used > certificate.stack_bytes[e]}


@pytest.mark.slow
def test_instructions_are_repeatable() -> None:
    require_tool("qemu")
    sources, inputs = package("single"), recording("single")
    first, second = (verify(sources, "crane", inputs, TARGETS["cortex-m4f"]).run for _ in range(2))
    np.testing.assert_array_equal(first.sample, second.sample)
    assert first.instructions == second.instructions


def test_a_fault_in_the_code_of_the_target_is_found() -> None:
    """A model with another gravity on the target than on the host."""
    require_tool("qemu")
    sources, inputs = package("single"), recording("single")
    other = sources["crane.c"].replace("9.81F", "12.0F").replace("9.8100004F", "12.0F")
    assert other != sources["crane.c"]
    verdict = verify({**sources, "crane.c": other}, "crane", inputs, TARGETS["cortex-m4f"])
    assert not verdict.passed
    assert verdict.mismatches[0] < 3
    first = verdict.mismatches[0]
    assert f"The first is sample {first}: a " in sentences(verdict)
    assert verdict.error > 1e-3


def test_a_control_that_only_rounding_moves_has_a_range() -> None:
    """Its noise is no disagreement, and an error beside it is one."""
    description = recording("double").description
    assert description.dims.nu == 1
    noise = np.array([[0.0], [4e-18], [-3e-18]])
    rows = dataclasses.replace(description, rows=())
    accepted = TOLERANCE["double"] * ranges(rows, noise, 1.0)[0]
    assert 10 * np.ptp(noise) < accepted < 1e-15
    assert ranges(rows, np.array([[0.0], [2.0]]), 1.0)[0] == 2.0
    assert ranges(rows, np.zeros((2, 1)))[0] == 1.0


def test_comparison_sees_status_and_nan() -> None:
    class Run:
        u = np.zeros((2, 1), dtype=np.float32)
        status = np.array([0, 1])

    inputs = recording("single")
    short = Recording(inputs.description, inputs.x[:2], (), np.zeros((2, 1)), np.zeros(2, dtype=np.int64), np.ones(1))
    run: Any = Run()
    assert compare(short, run).mismatches == (1,)
    run.u = np.array([[np.nan], [0.0]], dtype=np.float32)
    assert compare(short, run).mismatches == (0, 1)


def test_the_program_has_no_warnings(tmp_path: Path) -> None:
    """Start-up code and replay, with the warnings of the project as errors."""
    sources = package("single")
    build(sources, "crane", recording("single").header, TARGETS["cortex-m4f"], "O2", tmp_path)
    strict = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Wundef", "-Werror"]
    flags = compile_flags(TARGETS["cortex-m4f"], "O2")
    for unit in ("start.c", "replay.c"):
        command = [require_tool("arm"), *flags, *strict, "-c", unit, "-o", "strict.o"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.stderr == ""


def test_missing_programs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BuildError, match=r"no program arm-none-eabi-gcc .*apt install gcc-arm-none-eabi libnewlib"):
        certify(package("single"), "crane", TARGETS["cortex-m4f"])
    with pytest.raises(BuildError, match=r"no program qemu-system-arm .*apt install qemu-system-arm"):
        find("qemu-system-arm")
