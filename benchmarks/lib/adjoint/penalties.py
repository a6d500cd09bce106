"""Figures 7.1 and 7.2: barriers and the smooth maximum, which replace output constraints by terms of the cost.

B(t) = -ln(t_max - t) - ln(t - t_min),   Bbar(t) = B(t) - B(0) - B'(0) t
max(t, 0) ~ max(t, 0) + log1p(exp(-alpha |t|)) / alpha, whose derivative is 1 / (1 + exp(-alpha t))
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.lib.adjoint import drawing
from benchmarks.lib.report import Report

Array = NDArray[np.float64]

LOWER, UPPER = -1.0, 2.0
SHADES = ("#9ecae1", "#4a90c2", "#1f5fa8")


def barrier(t: Array) -> Array:
    """B(t) on LOWER < t < UPPER."""
    return np.asarray(-np.log(UPPER - t) - np.log(t - LOWER))


def recentred(t: Array) -> Array:
    """Bbar(t): value and slope are zero at t = 0."""
    slope = 1 / UPPER + 1 / LOWER
    return np.asarray(barrier(t) - barrier(np.zeros(1))[0] - slope * t)


def smooth_max(t: Array, alpha: float) -> Array:
    """The smooth maximum of t and 0; no exponential overflows."""
    return np.asarray(np.maximum(t, 0) + np.log1p(np.exp(-alpha * np.abs(t))) / alpha)


def smooth_step(t: Array, alpha: float) -> Array:
    """Its derivative."""
    e = np.exp(-alpha * np.abs(t))
    return np.asarray(np.where(t >= 0, 1.0, e) / (1 + e))


def measure(report: Report, folder: Path) -> None:
    """Draw both figures; record the error of the smooth maximum, log(2) / alpha at 0, and its overflow-free range."""
    figure, axes = drawing.axes(1, 1, 5.4, 3.8)
    axis, t = axes[0, 0], np.linspace(LOWER + 1e-9, UPPER - 1e-9, 4001)
    axis.plot(t, barrier(t), "--", color="#b3202c", label="B(t)")
    for mu, colour in zip((1.0, 0.3, 0.05), SHADES, strict=True):
        axis.plot(t, mu * recentred(t), color=colour, label=rf"$\mu\,\bar B(t)$, $\mu$ = {mu:g}")
    axis.plot([LOWER, LOWER, UPPER, UPPER], [4, 0, 0, 4], color="0.15", linewidth=1.6, label="indicator")
    axis.set(xlabel="t", ylim=(-1.2, 3.5), xlim=(-1.3, 2.3))
    axis.legend(frameon=False, fontsize=8)
    axis.grid(alpha=0.25)
    drawing.save(figure, folder, "figure_7_1")

    figure, axes = drawing.axes(1, 2)
    t = np.linspace(-1.5, 1.5, 601)
    for axis, smooth, exact, name in (
        (axes[0, 0], smooth_max, np.maximum(t, 0), "max(t, 0)"),
        (axes[0, 1], smooth_step, np.where(t > 0, 1.0, 0.0), r"$\sigma(t)$"),
    ):
        for alpha, colour in zip((2.0, 5.0, 20.0), SHADES, strict=True):
            axis.plot(t, smooth(t, alpha), color=colour, label=rf"$\alpha$ = {alpha:g}")
        axis.plot(t, exact, color="0.15", linewidth=1.2, label="exact")
        axis.set(xlabel="t", title=name)
        axis.legend(frameon=False, fontsize=8)
        axis.grid(alpha=0.25)
    drawing.save(figure, folder, "figure_7_2")

    wide = np.array([-1e6, -1e3, 0.0, 1e3, 1e6])
    worst = max(np.abs(smooth_max(wide, a) - np.maximum(wide, 0)).max() * a / np.log(2) for a in (1.0, 10.0, 1e3))
    report.add("smooth_max_error", worst, "log(2) / alpha", case="|t| up to 1e6", limit=1 + 1e-12, profile="")
