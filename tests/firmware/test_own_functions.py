"""math="own" on emulated boards: the bits of the host, and nothing of libm."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
from conftest import require_tool

from examples import crane, cstr
from nmpc_codegen import Options, generate
from nmpc_codegen.firmware.certificate import certify
from nmpc_codegen.firmware.image import sources, write
from nmpc_codegen.firmware.recording import record
from nmpc_codegen.firmware.toolchain import compile_flags, cross
from nmpc_codegen.firmware.verify import verify
from nmpc_codegen.package.struct_layout import Precision
from nmpc_codegen.runtime.build import load
from nmpc_codegen.targets import TARGETS

EXAMPLES: dict[str, ModuleType] = {"crane": crane, "cstr": cstr}
SAMPLES = 20
CASES: list[tuple[str, str, Precision]] = [
    ("crane", "cortex-m4f", "single"),
    ("crane", "cortex-m3", "single"),
    ("cstr", "cortex-m7", "double"),
    ("cstr", "riscv32", "double"),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("name", "board", "precision"), CASES)
def test_the_board_computes_the_bits_of_the_host(name: str, board: str, precision: Precision) -> None:
    for tool in ("cc", *(("riscv", "qemu-riscv32") if board == "riscv32" else ("arm", "qemu"))):
        require_tool(tool)
    package = generate(EXAMPLES[name].build_ocp(), Options(target=board, precision=precision, solve=False))
    controller = load(package, name, "verify")
    inputs = record(controller, controller.description.x_initial, SAMPLES)
    verdict = verify(package, name, inputs, TARGETS[board])
    assert verdict.samples == SAMPLES
    assert verdict.bits == verdict.statuses == 0
    assert verdict.error == 0


@pytest.mark.slow
@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "board", "precision"), [c for c in CASES if c[1] in ("cortex-m4f", "cortex-m7")])
def test_the_program_is_linked_without_libm(name: str, board: str, precision: Precision, tmp_path: Path) -> None:
    require_tool("cc")
    require_tool("arm")
    package = generate(EXAMPLES[name].build_ocp(), Options(math="own", precision=precision))
    target = TARGETS[board]
    certificate = certify(package, name, target)
    assert certificate.math_functions == ()
    assert precision == "double" or certificate.double_functions == ()
    controller = load(package, name, "verify")
    inputs = record(controller, controller.description.x_initial, 2)
    write(package, name, sources(target, inputs.header), tmp_path)
    units = (f"{name}.c", "start.c", "replay.c")
    flags = [
        *compile_flags(target, "O2"),
        "-nostartfiles",
        "-nodefaultlibs",
        "--specs=nosys.specs",
        "-Wl,--gc-sections",
    ]
    cross(target, "gcc", tmp_path, *flags, "-Timage.ld", *units, "-lc", "-lnosys", "-lgcc", "-o", "image.elf")
    assert (tmp_path / "image.elf").exists()
