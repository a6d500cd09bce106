"""--target, --verify and budgets on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import require_tool

from nmpc_codegen.cli import main
from nmpc_codegen.runtime.seal import intact

PROBLEM = str(Path(__file__).parents[2] / "examples" / "crane.py")


def test_export_for_a_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Certificate and program are written, sealed, and say what the run showed; the C is that of any other export."""
    for tool in ("cc", "arm", "qemu"):
        require_tool(tool)
    folder, plain = tmp_path / "target", tmp_path / "plain"
    command = [PROBLEM, "--precision", "single", "--set", "solve=False"]
    assert main([*command, "-o", str(plain)]) == 0
    assert main([*command, "-o", str(folder), "--target", "cortex-m4f", "--level", "Os", "--verify"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "All 200 samples agree with the host" in out
    for path in plain.iterdir():
        assert (folder / path.name).read_bytes() == path.read_bytes(), "a target changes nothing that any export writes"
    files = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert {"certificate.md", "certificate.json", "firmware/replay.c", "firmware/image.ld"} <= set(files)
    assert all(intact(data) for data in files.values())
    found = json.loads(files["certificate.json"])
    assert found["emulated"]["mismatches"] == 0
    assert found["emulated"]["samples"] == 200
    assert found["flash_bytes"] < 20_000
    page = files["certificate.md"].decode()
    assert f"{found['flash_bytes']:,}" in page
    assert "-Os" in page
    assert main([*command, "-o", str(folder), "--target", "cortex-m4f", "--level", "Os"]) == 0, (
        "exporting again is safe"
    )


def test_exceeded_budgets_leave_no_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "c"
    assert main([PROBLEM, "-o", str(folder), "--max-ram", "6k", "--max-operations", "1e5"]) == 1
    err = capsys.readouterr().err
    assert "--max-ram 6144: crane takes 15,888 bytes" in err
    assert "--max-operations 100000" in err
    assert "try --set solve=False" in err
    assert not folder.exists()
    assert main([PROBLEM, "-o", str(folder), "--max-ram", "16k"]) == 0


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["--verify"], 2, "--verify needs --target"),
        (["--max-stack", "4k"], 2, "--max-stack needs --target"),
        (["--target", "z80"], 2, "invalid choice: 'z80'"),
        (["--max-ram", "much"], 1, "expected a positive number"),
    ],
)
def test_wrong_usage(
    arguments: list[str], status: int, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([PROBLEM, "-o", str(tmp_path / "c"), *arguments]) == status
    assert says in capsys.readouterr().err


def test_missing_toolchain(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main([PROBLEM, "-o", str(tmp_path / "c"), "--target", "cortex-m7"]) == 1
    assert "apt install gcc-arm-none-eabi libnewlib-arm-none-eabi" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()
