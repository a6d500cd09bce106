"""What the pictures of the derivative benchmarks share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

COLOURS = {
    "finite differences": "0.45",
    "forward": "#c2571a",
    "adjoint": "#1f5fa8",
    "adjoint, matrices": "#7aa6d6",
    "alternative": "#3a8a4f",
    "structure ignored": "#b3202c",
}

#: Function of the package -> its word in pictures.
WORDS = {
    "finite_differences": "finite differences",
    "forward": "forward",
    "adjoint": "adjoint",
    "adjoint_matrices": "adjoint, matrices",
    "alternative": "alternative",
    "structure_ignored": "structure ignored",
}


def axes(rows: int, columns: int, width: float = 4.4, height: float = 3.4) -> tuple[Figure, Any]:
    """A figure with a grid of axes, (rows, columns)."""
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def curves(axis: Any, x: Sequence[float], y: Mapping[str, Sequence[float]], *, log: bool = False) -> None:
    """One curve per name, with a legend."""
    for name, values in y.items():
        plot = axis.loglog if log else axis.plot
        plot(x[: len(values)], values, "o-", markersize=3, color=COLOURS.get(name), label=name)
    axis.legend(frameon=False, fontsize=8)
    axis.grid(alpha=0.25)


def save(figure: Figure, folder: Path, name: str) -> Path:
    """Write <folder>/<name>.png."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.png"
    figure.savefig(path, dpi=110)
    print(path)
    return path
