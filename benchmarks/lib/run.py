"""What a run of the benchmarks was asked for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from benchmarks.lib.speed.programs import Program

Item = TypeVar("Item")


class RefusedError(Exception):
    """What was asked for does not exist or cannot run here."""


@dataclass(frozen=True)
class Run:
    """``scale``: share of the counts that are asked for, 0: one of each; ``seed``: which of the draws; ``pictures``:
    folder for them; ``base_programs``: closed loops of the commit that is compared with, which run in turn with ours.
    """

    scale: float
    seed: int
    pictures: Path = Path("out")
    base_programs: Sequence[Program] = ()

    def share(self, full: int, least: int = 1) -> int:
        """The share of a count, but at least so many."""
        return max(least, round(self.scale * full))

    def cases(self, items: Iterable[Item]) -> list[Item]:
        """Cases of which there is no share: all, but at scale 0 the first."""
        return list(items) if self.scale else list(items)[:1]

    def some(self, items: Sequence[Item], least: int) -> list[tuple[int, Item]]:
        """The share of the items, but at least so many, drawn by the seed, with their numbers; all at 1, one at 0."""
        count = min(len(items), self.share(len(items), least if self.scale else 1))
        chosen = np.random.default_rng([39, self.seed]).permutation(len(items))[:count]
        return [(int(i), items[i]) for i in sorted(chosen)]
