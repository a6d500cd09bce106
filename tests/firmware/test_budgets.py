"""firmware/budgets.py: limits that refuse an export, and what the refusal says."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from examples import crane
from nmpc_codegen import AugmentedLagrangian, DenseActiveSet, OptionError, Options, RiccatiActiveSet, generate
from nmpc_codegen.cli import main
from nmpc_codegen.components.base import QpSolver
from nmpc_codegen.firmware.budgets import Budgets, check, parsed
from nmpc_codegen.firmware.certificate import Certificate
from nmpc_codegen.runtime.package_description import PackageDescription
from verification import problems


def description() -> PackageDescription:
    return PackageDescription.from_json(problems.sources("crane")["crane.json"])


def certificate() -> Certificate:
    return Certificate(
        **{f.name: None for f in dataclasses.fields(Certificate)}
        | {"struct_bytes": 16000, "flash_bytes": 30000, "stack_bytes": {"step": 1500}, "stack_chain": ("step", "sin")}
    )


@pytest.mark.parametrize(("text", "value"), [("6000", 6000), ("64k", 65536), ("1.5M", 1572864), ("2e6", 2000000)])
def test_numbers(text: str, value: int) -> None:
    assert parsed("--max-ram", text) == value


@pytest.mark.parametrize("text", ["", "0", "-3", "64 kB", "nan", "inf", "1e", "k"])
def test_what_is_no_number(text: str) -> None:
    with pytest.raises(OptionError, match=r"--max-ram .*expected a positive number"):
        parsed("--max-ram", text)


def test_kept_budgets() -> None:
    check(Budgets(ram=16000, flash=30000, stack=1500, operations=10**9), description(), certificate())
    check(Budgets(ram=10**6), description(), None)
    check(Budgets(), description(), None)


@pytest.mark.parametrize(
    ("budgets", "says"),
    [
        (Budgets(ram=15999), r"--max-ram 15999: crane takes 16,000 .*, 1 too many; try --set solve=False.*single"),
        (Budgets(flash=20000), r"--max-flash 20000: .*10,000 too many; try --level Os"),
        (Budgets(stack=1000), r"--max-stack 1000: .*1,500 bytes \(step > sin\), 500 too many; try "),
        (
            Budgets(operations=1000),
            r"--max-operations 1000: .*try --qp dense_active_set and a smaller --set qp.max_iterations=",
        ),
    ],
)
def test_exceeded_budgets(budgets: Budgets, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        check(budgets, description(), certificate())


def test_all_excesses_are_named() -> None:
    with pytest.raises(OptionError, match=r"--max-ram 1: .*; --max-flash 1: "):
        check(Budgets(ram=1, flash=1), description(), certificate())


@pytest.mark.parametrize("name", ["flash", "stack"])
def test_what_needs_a_target(name: str) -> None:
    with pytest.raises(OptionError, match=f"--max-{name} needs --target"):
        check(Budgets(**{name: 1}), description(), None)


def test_the_advice_names_options_of_the_algorithm() -> None:
    options = Options(algorithm=AugmentedLagrangian())
    augmented = PackageDescription.from_json(generate(crane.build_ocp(), options)["crane.json"])
    with pytest.raises(OptionError, match=r"try a smaller --set algorithm\.iterations=") as error:
        check(Budgets(operations=1000), augmented, None)
    assert "qp" not in str(error.value)


@pytest.mark.parametrize("qp", [DenseActiveSet(), RiccatiActiveSet(), RiccatiActiveSet(fallback=None)], ids=repr)
def test_the_advice_on_operations_helps(qp: QpSolver, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the message offers is taken by the command line, and lowers the worst case."""
    options = Options(qp=qp)
    package = PackageDescription.from_json(generate(crane.build_ocp(False), options)["crane.json"])
    worst = package.report.worst_operations["sample"]
    with pytest.raises(OptionError) as error:
        check(Budgets(operations=1), package, None)
    offered = re.findall(r"--(?:set|qp) [\w.]+(?:=\w+)?", str(error.value).replace("=...", "=3"))
    assert offered
    problem = tmp_path / "problem.py"
    problem.write_text(
        f"from nmpc_codegen import *\nfrom examples.crane import build_ocp as made\n"
        f"ocp, options = made(False), {options!r}\n".replace(repr(options), f"Options(qp={qp!r})"),
        encoding="utf-8",
    )
    flags = [word for flag in offered for word in flag.split()]
    assert main([str(problem), "-o", str(tmp_path / "out"), *flags, "--max-operations", str(worst - 1)]) == 0
