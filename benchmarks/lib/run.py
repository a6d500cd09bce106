"""A run holds the requested scale and seed of the benchmarks."""

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
    """Raised if a request names something that does not exist or cannot run here."""


@dataclass(frozen=True)
class Run:
    """A run takes the fraction ``scale`` of the counts, 0: one of each; ``seed`` selects the draws.

    ``pictures``: folder of pictures; ``base_programs``: closed loops of the base commit, which run in turn with ours.
    """

    scale: float
    seed: int
    pictures: Path = Path("out")
    base_programs: Sequence[Program] = ()

    def share(self, full: int, least: int = 1) -> int:
        """Return the fraction of a count, at least ``least``."""
        return max(least, round(self.scale * full))

    def cases(self, items: Iterable[Item]) -> list[Item]:
        """Return all cases, or the first one at scale 0."""
        return list(items) if self.scale else list(items)[:1]

    def some(self, items: Sequence[Item], least: int) -> list[tuple[int, Item]]:
        """Draw the fraction of the items with their indices; at least ``least``, all at scale 1, one at 0."""
        count = min(len(items), self.share(len(items), least if self.scale else 1))
        chosen = np.random.default_rng([39, self.seed]).permutation(len(items))[:count]
        return [(int(i), items[i]) for i in sorted(chosen)]
