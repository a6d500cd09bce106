"""The faults of `make mutants` can still be put in, each in one place."""

from __future__ import annotations

from pathlib import Path

import pytest

from verification.mutants.__main__ import ROOT, put
from verification.mutants.mutants import MUTANTS, Mutant


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_fault_is_in_one_place(mutant: Mutant, tmp_path: Path) -> None:
    there = tmp_path / mutant.path
    there.parent.mkdir(parents=True)
    text = (ROOT / mutant.path).read_text(encoding="utf-8")
    there.write_text(text, encoding="utf-8")
    assert put(mutant, tmp_path) == text
    assert there.read_text(encoding="utf-8") == text.replace(mutant.before, mutant.after) != text
    assert all((ROOT / name).exists() for name in mutant.tests)


def test_a_text_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "part.c").write_text("int a;\nint a;\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"part.c contains 'int a;' 2 times; expected once"):
        put(Mutant("twice", "part.c", "int a;", "int b;", ()), tmp_path)


def test_all_differ() -> None:
    assert len(MUTANTS) == len({(m.path, m.before) for m in MUTANTS}) == 31
