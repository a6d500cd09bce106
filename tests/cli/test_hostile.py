"""Hostile files and command lines end with a message and a known status, never with a traceback."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.hostile import Case, catalogue
from tests.cli.running import End, forked, good, in_process, judge


def test_cases_differ_and_are_many() -> None:
    cases = catalogue()
    assert len(cases) >= 300
    assert len({(case.arguments, tuple(case.files.items())) for case in cases}) == len(cases)
    assert [case.name for case in cases] == [case.name for case in catalogue()]


def test_a_good_file_is_exported(tmp_path: Path) -> None:
    end = forked(good(), tmp_path)
    assert judge(good(), end) == "", end
    assert (tmp_path / "where" / "out" / "cart.c").exists()


@pytest.mark.parametrize(
    ("end", "fault"),
    [
        (End(1, "", "Traceback (most recent call last)"), "traceback"),
        (End(-11, "", "gone"), "status -11"),
        (End(70, "", "gone"), "status 70"),
        (End(1, "out", " "), "not a word"),
        (End(None, "", ""), "not in time"),
        (End(0, "", ""), "status 0 instead of 1"),
        (End(1, "", "said"), ""),
    ],
)
def test_judge(end: End, fault: str) -> None:
    assert judge(Case("x", (), {}, (1,)), end) == fault


def test_time_is_limited(tmp_path: Path) -> None:
    case = Case("sleeps", ("problem.py",), {"problem.py": b"while True: pass"})
    assert forked(case, tmp_path, seconds=1.0).status is None


def test_exceptions_out_of_main_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmpc_codegen.cli.main", lambda: 1 / 0)
    assert judge(good(), forked(good(), tmp_path)) == "traceback"


@pytest.mark.parametrize("case", catalogue()[:230:23], ids=lambda case: case.name)
def test_hostile_files(case: Case, tmp_path: Path) -> None:
    end = forked(case, tmp_path)
    assert judge(case, end) == "", end


def test_hostile_surroundings(tmp_path: Path) -> None:
    case = next(case for case in catalogue() if case.name == "raised in module: unencodable")
    end = in_process(case, tmp_path, {"PYTHONIOENCODING": "ascii:strict"}, 60.0)
    assert judge(case, end) == "", end
    assert "\\u03c0" in end.errors


@pytest.mark.slow
def test_every_hostile_file(tmp_path: Path) -> None:
    faults = {}
    for number, case in enumerate(catalogue()):
        folder = tmp_path / str(number)
        folder.mkdir()
        fault = judge(case, forked(case, folder))
        if fault:
            faults[case.name] = fault
    assert not faults
