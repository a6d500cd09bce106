"""The example: a drone past a pillar."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from examples import pillar


def test_pillar_main(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A margin of 0.1 m keeps nearly all drones away from the pillar; without one light ones touch it."""
    few = partial(pillar.fly, flights=200)
    monkeypatch.setattr(pillar, "fly", few)
    wide = pillar.main(str(tmp_path / "pillar.png"))
    assert (tmp_path / "pillar.png").stat().st_size > 10_000
    bare = few(0.0)
    assert bare.share > 0.1
    assert wide.share < 0.01
    mass = bare.flown.drawn[:, bare.flown.labels.drawn.index("plant.m")]
    assert np.mean(mass[bare.lost]) < 0.46 < np.mean(mass[~bare.lost])
    assert "the worst flight again: 0.4" in capsys.readouterr().out
