"""Targets with lanes on other processors than this one's: ARM64, and x86 with AVX2, both emulated."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import require_tool

from examples import crane, quadrotor
from nmpc_codegen import BuildError, OptionError, Options, generate
from nmpc_codegen.firmware.process import emulator_command
from nmpc_codegen.firmware.recording import record
from nmpc_codegen.firmware.verify import Verdict, verify
from nmpc_codegen.runtime.build import load, warnings_for
from nmpc_codegen.targets import TARGETS
from verification.samples import SAMPLES
from verification.timed import TIMED

KNOWN = {sample.name: sample for sample in (*TIMED, *SAMPLES)}
#: Dense and stage solvers, exact Hessians, single precision, loops.
CHOSEN = ("crane", "timed cstr", "timed bioreactor", "crane riccati single", "everything looped")
STEPS = 30


def replayed(make: object, options: Options | None, target: str) -> Verdict:
    """The closed loop of portable C on this machine against the target in its emulator."""
    options = options or Options()
    packages: list[Mapping[str, str]] = [
        generate(make(), replace(options, target=name), name="package")  # type: ignore[operator]
        for name in ("portable", target)
    ]
    controller = load(packages[0], "package", "verify")
    inputs = record(controller, controller.description.x_initial, STEPS)
    return verify(packages[1], "package", inputs, TARGETS[target])


def tools(target: str) -> None:
    for tool in ("cc", "aarch64", "qemu-aarch64") if target == "aarch64" else ("cc", "qemu-x86_64"):
        require_tool(tool)


@pytest.mark.few(2)
@pytest.mark.filterwarnings("ignore::nmpc_codegen.ProblemWarning")
@pytest.mark.parametrize("target", ["aarch64", "x86-64-v3"])
@pytest.mark.parametrize("name", CHOSEN)
def test_emulated_targets_compute_the_controls_of_portable_c(name: str, target: str) -> None:
    tools(target)
    verdict = replayed(KNOWN[name].make, KNOWN[name].options, target)
    assert verdict.samples == STEPS
    assert verdict.passed, verdict.mismatches
    assert verdict.statuses == 0


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["aarch64", "x86-64-v3"])
@pytest.mark.parametrize("example", [crane, quadrotor], ids=["crane", "quadrotor"])
def test_own_functions_have_the_same_bits_there(example: object, target: str) -> None:
    """Without tiles, whose sums have another order."""
    tools(target)
    verdict = replayed(example.build_ocp, Options(math="own"), target)  # type: ignore[attr-defined]
    assert (verdict.bits, verdict.statuses, verdict.error) == (0, 0, 0.0)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", CHOSEN)
def test_no_warning_of_the_cross_compiler(name: str, tmp_path: Path) -> None:
    arm, target = require_tool("aarch64"), TARGETS["aarch64"]
    sample = KNOWN[name]
    for path, text in generate(
        sample.make(), replace(sample.options or Options(), target="aarch64"), "package"
    ).items():
        (tmp_path / path).write_text(text)
    command = [arm, "-O1", *warnings_for(target), "-c", "package.c", "-o", "package.o"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_what_cannot_be_emulated(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OptionError, match="--verify: the target portable is every machine"):
        emulator_command(TARGETS["portable"])
    monkeypatch.setattr("nmpc_codegen.firmware.process.runs", lambda _: False)
    with pytest.raises(BuildError, match="no emulator of x86 with AVX-512"):
        emulator_command(TARGETS["x86-64-v4"])
    monkeypatch.setenv("PATH", "")
    with pytest.raises(BuildError, match=r"qemu-aarch64 on the path, which --verify needs: .*apt install qemu-user"):
        emulator_command(TARGETS["aarch64"])
    monkeypatch.setattr("nmpc_codegen.firmware.process.runs", lambda _: True)
    assert emulator_command(TARGETS["aarch64"]) == ()


def test_a_wrong_control_is_a_mismatch() -> None:
    """The replay of another package than the recorded one does not agree."""
    tools("x86-64-v3")
    controller = load(generate(crane.build_ocp(), name="package"), "package", "verify")
    inputs = record(controller, np.array([2.0, 0.0, 0.0, 0.0]), STEPS)
    other = generate(crane.build_ocp(), Options(target="x86-64-v3"), name="package")
    wrong = {**other, "package.c": other["package.c"].replace("9.81", "9.0")}
    assert wrong["package.c"] != other["package.c"]
    assert not verify(wrong, "package", inputs, TARGETS["x86-64-v3"]).passed
