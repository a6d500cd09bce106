"""Figures 1, 3 and 4 of [Z20] with their data: <folder>/figure1.png, figure1.csv and so on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.lib.economic import figure3, figure4
from verification.economic import evaporation

LOSS_COLOURS = {
    "exact": "#1f5fa8",
    "M": "#c2571a",
    figure3.INDEFINITE: "#5f9e6e",
    "identity": "0.2",
    "LETEMPC": "#8a5fb0",
    "tracking": "#b3202c",
}
LABELS = {"tuned": "M", "corrected": "M, dual correction"}
COLOURS = {"exact": "#1f5fa8", "tuned": "#c2571a", "corrected": "#e0a070", "identity": "0.2"}


def draw(folder: str | Path) -> list[Path]:
    """All figures; the paths of the files."""
    where = Path(folder)
    where.mkdir(parents=True, exist_ok=True)
    residuals = {name: run[2] for name, run in evaporation.figure1().items()}
    return [
        *_curves(where / "figure1", residuals, "residual of the optimality conditions"),
        *_losses(where / "figure3", {"": _figure3()}, "initial distance of P2 from the steady state [kPa]"),
        *_losses(where / "figure4", _figure4(), "side step [m]"),
    ]


#: Argument -> loss in percent by scheme.
Table = Mapping[float, Mapping[str, float]]
#: Smaller losses are drawn here: to rounding, they are those of the converged scheme.
LEAST = 1e-10


def _figure3() -> Table:
    return {dP: figure3.losses(dP)[0] for dP in figure3.DISTURBANCES}


def _figure4() -> dict[str, Table]:
    return {
        word: {s: {name: 100 * v for name, v in figure4.losses(s, on).items()} for s in figure4.SIDE_STEPS}
        for word, on in (("foreseen", True), ("unforeseen", False))
    }


def _losses(stem: Path, tables: Mapping[str, Table], label: str) -> list[Path]:
    """A panel per table: loss of every scheme over the argument; dashed: converged. One file of data for all."""
    figure = Figure(figsize=(4.5 + 3 * len(tables), 4.5), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(tables), sharey=True))
    columns, header = [], []
    for panel, (word, table) in zip(panels, tables.items(), strict=True):
        at = list(table)
        for name in next(iter(table.values())):
            values = [table[a][name] for a in at]
            columns.append(values)
            header.append(f"{name} {word}".strip())
            _loss(panel, at, values, name)
        clipped = any(value < LEAST for row in table.values() for value in row.values())
        note = f"smaller losses drawn at {LEAST:g} %" if clipped else ""
        panel.set(xlabel=label, title=", ".join(filter(None, (word, note))))
        panel.grid(alpha=0.25)
    panels[0].set_ylabel("loss against the converged scheme [%]")
    figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, loc="outside right center")
    picture, data = stem.with_suffix(".png"), stem.with_suffix(".csv")
    figure.savefig(picture, dpi=110)
    arguments = list(next(iter(tables.values())))
    np.savetxt(
        data, np.column_stack([arguments, *columns]), delimiter=",", header=",".join(["at", *header]), comments=""
    )
    return [picture, data]


def _loss(panel: Any, at: Sequence[float], values: Sequence[float], name: str) -> None:
    """A curve on a logarithmic axis; a scheme that diverges has only its name."""
    finite = [max(v, LEAST) if np.isfinite(v) else np.nan for v in values]
    diverged = not np.any(np.isfinite(values))
    colour = LOSS_COLOURS[name.removesuffix(" converged")]
    style = "--" if name.endswith("converged") else ":" if name == figure3.INDEFINITE else "-"
    text = f"{name}: diverges" if diverged else name
    panel.semilogy(at, finite, style, marker="o", markersize=3, color=colour, label=text)


def _curves(stem: Path, curves: Mapping[str, list[float]], label: str) -> list[Path]:
    """One curve per name over the iterations, and a table with one column per curve."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axis = figure.subplots()
    for name, values in curves.items():
        style = "--" if name == "corrected" else "-"
        axis.semilogy(
            np.maximum(values, 1e-16), style, marker=".", color=COLOURS.get(name), label=LABELS.get(name, name)
        )
    axis.set(xlabel="iteration", ylabel=label)
    axis.grid(alpha=0.25)
    axis.legend(frameon=False)
    picture, table = stem.with_suffix(".png"), stem.with_suffix(".csv")
    figure.savefig(picture, dpi=110)
    longest = max(map(len, curves.values()))
    columns = [np.append(values, np.full(longest - len(values), np.nan)) for values in curves.values()]
    np.savetxt(table, np.column_stack(columns), delimiter=",", header=",".join(curves), comments="")
    return [picture, table]
