"""The constant Hessian of economic NMPC against the statements and figures of its paper; times of a sample.

python -m benchmarks.economic_gn [--json FILE] [--only PART,...] [--draw FOLDER]

Zanon, "A Gauss-Newton-like Hessian approximation for economic NMPC" (2020).
"""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.lib import command
from benchmarks.lib.economic import driving, evaporation, figure3, figure4, figures, timing
from benchmarks.lib.report import Report

PARTS: dict[str, Callable[[Report], None]] = {
    "tuning": evaporation.measure_tuning,
    "theory": evaporation.measure_theory,
    "figure1": evaporation.measure_figure1,
    "figure3": figure3.measure,
    "figure4": figure4.measure,
    "driving": driving.measure,
    "timing": timing.measure,
}


def main() -> None:
    """All parts, or some."""
    parser = command.parser(__doc__, PARTS)
    parser.add_argument("--draw", metavar="FOLDER", help="draw Figures 1, 3 and 4, with their data as CSV")
    options = parser.parse_args()
    names, report = command.chosen(parser, options, PARTS), Report("economic_gn")
    command.measure(report, names, lambda name: PARTS[name](report), options.json)
    if options.draw:
        print("\n".join(map(str, figures.draw(options.draw))))


if __name__ == "__main__":
    main()
