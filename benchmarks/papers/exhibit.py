"""An exhibit is a figure or table of a paper with our numbers, pictures, and a sentence on agreement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

from matplotlib.figure import Figure
from PIL import Image

from benchmarks.lib.report import number
from benchmarks.lib.run import Run

Cell = str | float | None
#: Number of colours of a picture, as more would double its bytes; longest curve with markers.
PALETTE, MOST_MARKED = 255, 30
BLUE, ORANGE, GREEN, VIOLET, RED, GREY = "#1f5fa8", "#c2571a", "#3a8a4f", "#8a5fb0", "#b3202c", "0.45"


@dataclass(frozen=True)
class Table:
    """A table has rows of numbers and words under its columns; the first cell of a row is its label."""

    columns: Sequence[str]
    rows: Iterable[Sequence[Cell]]
    corner: str = ""

    def __str__(self) -> str:
        lines = [[self.corner, *self.columns], ["---", *["---:"] * len(self.columns)], *map(list, self.rows)]
        return "\n".join(f"| {' | '.join(map(cell, line))} |" for line in lines)


@dataclass(frozen=True)
class Check:
    """A check is a number with an oracle, and its largest value."""

    what: str
    value: float
    limit: float

    @property
    def holds(self) -> bool:
        """Return True if the value is within its limit; NaN is not."""
        return self.value <= self.limit


@dataclass(frozen=True)
class Exhibit:
    """An exhibit belongs to a ``place`` in the paper; its ``sentence`` gives the numbers of both."""

    place: str
    title: str
    verdict: Literal["agrees with", "contradicts", "differs from", "extends"]
    sentence: str
    tables: Sequence[Table] = ()
    pictures: Sequence[str] = ()
    code: str = ""
    checks: Sequence[Check] = ()

    def __str__(self) -> str:
        parts = [f"### {self.place}: {self.title}", f"**Our result {self.verdict} the paper.** {self.sentence}"]
        parts += map(str, self.tables)
        parts += [f"![{self.place}: {self.title}]({picture})" for picture in self.pictures]
        parts += [f"```c\n{self.code}\n```"] if self.code else []
        return "\n\n".join(parts)


def cell(value: Cell) -> str:
    """Return a number in three digits, or "" for None."""
    return "" if value is None else value if isinstance(value, str) else number(value)


def sheet(rows: int, columns: int, width: float = 4.2, height: float = 3.0) -> tuple[Figure, Any]:
    """Return a figure with a grid of axes, (rows, columns)."""
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
    return figure, axes


def curves(
    axis: Any, x: Sequence[float], found: Mapping[str, Sequence[float]], *, log: str = "", **labels: str
) -> None:
    """Draw a curve per name, with a legend; ``log``: the logarithmic axes, "x", "y" or both."""
    colours = (BLUE, ORANGE, GREEN, VIOLET, RED, GREY, "#6fb1e0", "#e0a070")
    line = "o-" if len(x) <= MOST_MARKED else "-"
    for (name, values), colour in zip(found.items(), colours, strict=False):
        axis.plot(x[: len(values)], values, line, markersize=3, linewidth=1.3, color=colour, label=name)
    axis.set(**labels, **{f"{each}scale": "log" for each in log})
    if "x" in log:
        plain_ticks(axis, x[:: 1 + len(x) // 6])
    axis.legend(frameon=False, fontsize=8)


def plain_ticks(axis: Any, ticks: Sequence[float]) -> None:
    """Label a logarithmic axis at these values only, as plain numbers."""
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_xticks([], minor=True)


def save(figure: Figure, run: Run, name: str, says: str) -> str:
    """Write <pictures>/<name>.png with few colours and a caption; return its address on the page."""
    figure.suptitle(f"[{name.split('_')[0].upper()}] {says}", fontsize=9)
    run.pictures.mkdir(parents=True, exist_ok=True)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=80)
    drawn.seek(0)
    picture = Image.open(drawn).convert("RGB").quantize(PALETTE)
    picture.save(run.pictures / f"{name}.png", optimize=True)
    return f"{run.pictures.name}/{name}.png"


def beside(run: Run, name: str) -> Path:
    """Return the path of a picture of an example, which is on the page of examples, too."""
    return run.pictures.parent / name
