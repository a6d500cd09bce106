"""Which of the parametrizations of a test run in `make test`; all of them run in `make test-all`.

A test with three or more parameters runs with a set of combinations in which every pair of values of two parameters
occurs, as defects rarely need three. A test with the marker few(n) runs with n combinations, in which as many values as
possible occur. All other combinations get the marker "slow".
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Iterable, Sequence

import pytest

#: Parameters from which on pairs are enough.
PAIRWISE = 3


def thin(items: Sequence[pytest.Item]) -> None:
    """Mark the combinations that are left out."""
    groups: dict[tuple[object, ...], list[pytest.Function]] = {}
    for item in items:
        if isinstance(item, pytest.Function) and hasattr(item, "callspec") and not item.get_closest_marker("slow"):
            groups.setdefault((item.path, item.cls, item.originalname), []).append(item)
    for group in groups.values():
        chosen = _chosen(group)
        for number, item in enumerate(group):
            if number not in chosen:
                item.add_marker(pytest.mark.slow)


def _chosen(group: Sequence[pytest.Function]) -> set[int]:
    axes, few = _axes(group), group[0].get_closest_marker("few")
    if few is not None:
        return _cover([list(enumerate(values)) for values in zip(*axes, strict=True)], few.args[0])
    if len(axes) < PAIRWISE:
        return set(range(len(group)))
    pairs = [list(itertools.combinations(enumerate(values), 2)) for values in zip(*axes, strict=True)]
    return _cover(pairs, len(group))


def _axes(group: Sequence[pytest.Function]) -> list[tuple[int, ...]]:
    """For every parameter the number of its value in every item; parameters that change together are one."""
    vectors = [_numbered([id(item.callspec.params[name]) for item in group]) for name in group[0].callspec.params]
    return [vector for vector in dict.fromkeys(vectors) if len(set(vector)) > 1]


def _numbered(values: Sequence[Hashable]) -> tuple[int, ...]:
    first = {value: number for number, value in enumerate(dict.fromkeys(values))}
    return tuple(first[value] for value in values)


def _cover(features: Sequence[Iterable[Hashable]], most: int) -> set[int]:
    """At most so many numbers of items that have as many features as possible, chosen one by one; ties are spread."""
    left, sets, chosen = set(itertools.chain(*features)), [set(f) for f in features], set[int]()
    while len(chosen) < min(most, len(sets)):
        rest = [i for i in range(len(sets)) if i not in chosen]
        gains = {i: len(sets[i] & left) for i in rest}
        best = max(gains.values())
        if best == 0 and most >= len(sets):
            break
        ties = [i for i in rest if gains[i] == best]
        number = ties[len(ties) * len(chosen) // (len(chosen) + 1) % len(ties)]
        chosen.add(number)
        left -= sets[number]
    return chosen
