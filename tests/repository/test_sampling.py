"""What `make test` leaves out of the combinations of a test."""

from __future__ import annotations

import itertools
import re

import pytest

CODE = """
import pytest

@pytest.mark.parametrize("a", [0, 1, 2])
@pytest.mark.parametrize("b", "xyz")
@pytest.mark.parametrize("c", [0.0, 1.0, 2.0])
def test_pairs(a, b, c):
    print("pairs", a, b, c)

@pytest.mark.few(2)
@pytest.mark.parametrize(("a", "b"), [(1, 1), (1, 2), (2, 2), (2, 1)])
def test_few(a, b):
    print("few", a, b)

@pytest.mark.parametrize("a", [0, 1, 2])
@pytest.mark.parametrize("b", "xyz")
def test_all(a, b):
    print("all", a, b)
"""
CONFTEST = """
import pytest
from sampling import thin

@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    thin(items)

def pytest_configure(config):
    for line in ("slow", "few(n)"):
        config.addinivalue_line("markers", line)
"""

pytest_plugins = ["pytester"]


def lines(pytester: pytest.Pytester, *arguments: str) -> dict[str, list[tuple[str, ...]]]:
    pytester.makepyfile(CODE)
    pytester.makeconftest(CONFTEST)
    found: dict[str, list[tuple[str, ...]]] = {"pairs": [], "few": [], "all": []}
    for line in pytester.runpytest_inprocess("-s", "-p", "no:xdist", *arguments).outlines:
        if printed := re.search(r"\b(pairs|few|all) (.+)$", line):
            found[printed[1]].append(tuple(printed[2].split()))
    return found


def test_every_pair_occurs(pytester: pytest.Pytester) -> None:
    found = lines(pytester, "-m", "not slow")
    assert 9 <= len(found["pairs"]) <= 14
    for first, second in itertools.combinations(range(3), 2):
        assert len({(values[first], values[second]) for values in found["pairs"]}) == 9
    assert len(found["few"]) == 2
    assert {a for a, _ in found["few"]} == {b for _, b in found["few"]} == {"1", "2"}
    assert len(found["all"]) == 9


def test_nothing_is_lost(pytester: pytest.Pytester) -> None:
    found = lines(pytester)
    assert [len(set(values)) for values in found.values()] == [27, 4, 9]
