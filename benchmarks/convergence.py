"""solve() from random cold starts with default options, compared with IPOPT from the same first guess.

python -m benchmarks.convergence [--json FILE] [--only starts] [--scale S]
"""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.lib import command
from benchmarks.lib.convergence import loops, singles, starts, units
from benchmarks.lib.report import Report

PARTS: dict[str, Callable[[Report, float], None]] = {
    "starts": starts.measure,
    "singles": singles.measure,
    "units": units.measure,
    "loops": loops.measure,
}


def main() -> None:
    """All parts, or some."""
    parser = command.parser(__doc__, PARTS)
    command.add_scale(parser)
    options = parser.parse_args()
    names, report = command.chosen(parser, options, PARTS), Report("convergence")
    command.measure(report, names, lambda name: PARTS[name](report, options.scale), options.json)


if __name__ == "__main__":
    main()
