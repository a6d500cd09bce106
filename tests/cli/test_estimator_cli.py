"""nmpc-export of a file with a controller and its estimator: both packages, one loop, certificates of both."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from conftest import require_tool

from nmpc_codegen import export, open_estimator, open_package
from nmpc_codegen.cli.command import main
from nmpc_codegen.errors import OptionError
from verification.estimation import PLANTS, charging

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "estimation.py")


@pytest.mark.usefixtures("compiler")
def test_both_packages_and_one_loop(tmp_path: Path) -> None:
    """main.c and CMakeLists.txt build the loop of both without a warning, and all its samples are OK."""
    assert main([EXAMPLE, "-o", str(tmp_path)]) == 0
    files = {path.name for path in tmp_path.iterdir()}
    packages = {f"{name}.{ending}" for name in ("cart", "cart_estimator") for ending in ("h", "c", "json")}
    assert files == packages | {"main.c", "CMakeLists.txt", "README.md"}
    require_tool("gcc")
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-O1"]
    units = ["main.c", "cart.c", "cart_estimator.c"]
    subprocess.run(["gcc", *flags, *units, "-lm", "-o", "loop"], cwd=tmp_path, check=True)
    lines = subprocess.run([tmp_path / "loop"], capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(lines) == 30
    assert all(line.count(" ok ") == 2 for line in lines)
    assert open_package(tmp_path, "test").description.kind.noun == "controller"
    assert open_estimator(tmp_path, "test").description.kind.words == "moving horizon estimator"
    require_tool("cmake")
    subprocess.run(["cmake", "-S", ".", "-B", "build"], cwd=tmp_path, check=True, capture_output=True)
    subprocess.run(["cmake", "--build", "build"], cwd=tmp_path, check=True, capture_output=True)
    again = subprocess.run([tmp_path / "build" / "cart_main"], capture_output=True, text=True, check=True).stdout
    assert len(again.splitlines()) == 30


@pytest.mark.slow
@pytest.mark.usefixtures("compiler")
def test_certificates_of_both(tmp_path: Path) -> None:
    """On an emulated Cortex-M4F both give the bits of the host, inside the stacks of their certificates."""
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        require_tool(tool)
    command = [EXAMPLE, "-o", str(tmp_path), "--target", "cortex-m4f", "--set", "precision=single", "--verify"]
    assert main([*command, "--level", "Os"]) == 0
    for name in ("certificate", "certificate_cart_estimator"):
        found = json.loads((tmp_path / f"{name}.json").read_text())
        assert found["emulated"]["mismatches"] == 0
        assert found["emulated"]["bit_mismatches"] == 0
        assert max(found["emulated"]["painted_stack_bytes"].values()) <= found["stack_bytes_worst"]
        assert found["worst_operations"]["sample"] > 0
        assert not found["double_functions"]
    lists = (tmp_path / "CMakeLists.txt").read_text()
    assert lists.count(" -Os ") == 2
    assert " -O2 " not in lists


def test_an_estimator_of_another_plant_is_refused(tmp_path: Path) -> None:
    ocp, _ = charging()
    with pytest.raises(OptionError, match="expected the states"):
        export(ocp, None, tmp_path, estimator=PLANTS["reactor"].estimator())
    assert not any(tmp_path.iterdir())


def test_a_file_whose_estimator_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = Path(EXAMPLE).read_text().replace("    return found", '    return "found"')
    (tmp_path / "problem.py").write_text(text)
    assert main([str(tmp_path / "problem.py"), "-o", str(tmp_path / "out")]) == 1
    assert "estimator is a str; expected ocp.estimator(...)" in capsys.readouterr().err
