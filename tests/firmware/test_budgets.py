"""firmware/budgets.py: limits that refuse an export, and what the refusal says."""

from __future__ import annotations

import dataclasses

import pytest

from nmpc_codegen import OptionError
from nmpc_codegen.firmware.budgets import Budgets, check, parse_size
from nmpc_codegen.firmware.certificate import Certificate
from nmpc_codegen.package.description import PackageDescription
from verification import problems


def description() -> PackageDescription:
    return PackageDescription.from_json(problems.sources("crane")["crane.json"])


def certificate() -> Certificate:
    return Certificate(
        **{f.name: None for f in dataclasses.fields(Certificate)}
        | {"struct_bytes": 16000, "flash_bytes": 30000, "stack_bytes": {"step": 1500}, "stack_chain": ("step", "sin")}
    )


def worst() -> int:
    return 1000


@pytest.mark.parametrize(("text", "value"), [("6000", 6000), ("64k", 65536), ("1.5M", 1572864), ("2e6", 2000000)])
def test_numbers(text: str, value: int) -> None:
    assert parse_size("--max-ram", text) == value


@pytest.mark.parametrize("text", ["", "0", "-3", "64 kB", "nan", "inf", "1e", "k", "1e400", "1e3000k"])
def test_what_is_no_number(text: str) -> None:
    with pytest.raises(OptionError, match=r"--max-ram .*expected a number of at least 1"):
        parse_size("--max-ram", text)


def test_kept_budgets() -> None:
    check(Budgets(ram=16000, flash=30000, stack=1500), description(), certificate(), worst)
    check(Budgets(ram=10**6), description(), None, worst)
    check(Budgets(), description(), None, worst)


@pytest.mark.parametrize(
    ("budgets", "says"),
    [
        (Budgets(ram=15999), r"--max-ram 15999: crane takes 16,000 .*, 1 too many; try --set solve=False.*single"),
        (Budgets(flash=20000), r"--max-flash 20000: .*10,000 too many; try --level Os"),
        (Budgets(operations=999), r"--max-operations 999: .* 1,000 operations .*, 1 too many; try .*qp.max_iterations"),
        (Budgets(stack=1000), r"--max-stack 1000: .*1,500 bytes \(step > sin\), 500 too many; try "),
    ],
)
def test_exceeded_budgets(budgets: Budgets, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        check(budgets, description(), certificate(), worst)


def test_all_excesses_are_named() -> None:
    with pytest.raises(OptionError, match=r"--max-ram 1: .*; --max-flash 1: "):
        check(Budgets(ram=1, flash=1), description(), certificate(), worst)


@pytest.mark.parametrize("name", ["flash", "stack"])
def test_what_needs_a_target(name: str) -> None:
    with pytest.raises(OptionError, match=f"--max-{name} needs --target"):
        check(Budgets(**{name: 1}), description(), None, worst)
