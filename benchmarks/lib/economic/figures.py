"""Figures 1 and 2 of [Z20] with their data: <folder>/figure1.png and .csv, figure2.png and .csv."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.lib.economic import artificial, evaporation

COLOURS = {"exact": "#1f5fa8", "tuned": "#c2571a", "corrected": "#e0a070", "identity": "0.2"}


def draw(folder: str | Path) -> list[Path]:
    """Both figures; the paths of the files."""
    where = Path(folder)
    where.mkdir(parents=True, exist_ok=True)
    residuals = {name: run[2] for name, run in evaporation.figure1().items()}
    errors = {"original": artificial.run(False).errors, "rotated": artificial.run(True).errors}
    return [
        *_curves(where / "figure1", residuals, "residual of the optimality conditions"),
        *_curves(where / "figure2", errors, "distance from the solution"),
    ]


def _curves(stem: Path, curves: Mapping[str, list[float]], label: str) -> list[Path]:
    """One curve per name over the iterations, and a table with one column per curve."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axis = figure.subplots()
    for name, values in curves.items():
        style = "--" if name == "corrected" else "-"
        axis.semilogy(np.maximum(values, 1e-16), style, marker=".", color=COLOURS.get(name), label=name)
    axis.set(xlabel="iteration", ylabel=label)
    axis.grid(alpha=0.25)
    axis.legend(frameon=False)
    picture, table = stem.with_suffix(".png"), stem.with_suffix(".csv")
    figure.savefig(picture, dpi=110)
    longest = max(map(len, curves.values()))
    columns = [np.append(values, np.full(longest - len(values), np.nan)) for values in curves.values()]
    np.savetxt(table, np.column_stack(columns), delimiter=",", header=",".join(curves), comments="")
    return [picture, table]
