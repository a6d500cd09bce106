"""The augmented Lagrangian: the bioreactor in closed loop, tracking errors.

python -m benchmarks.augmented_lagrangian [--json FILE] [--only loop,bounds,...] [--scale S]
"""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.lib import command
from benchmarks.lib.augmented import bounds, loop, schemes, tracking
from benchmarks.lib.report import Report

PARTS: dict[str, Callable[[Report, float], None]] = {
    "loop": loop.measure,
    "bounds": bounds.measure,
    "tracking": tracking.measure,
    "schemes": schemes.measure,
}


def main() -> None:
    """All parts, or some."""
    parser = command.parser(__doc__, PARTS)
    command.add_scale(parser)
    options = parser.parse_args()
    names, report = command.chosen(parser, options, PARTS), Report("augmented Lagrangian")
    command.measure(report, names, lambda name: PARTS[name](report, options.scale), options.json)


if __name__ == "__main__":
    main()
