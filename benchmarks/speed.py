"""Times of a sample on this machine: lanes, exported C, elementary functions.

    python -m benchmarks.speed [--json FILE] [--only PART,...] [--where NAME]

Limits belong to a machine on which the reference kernel (benchmarks/lib/speed/reference.c) takes 27.3 us; keys with
_scaled are times carried to it.
With --where the only output is a table: which functions the time of a sample of this loop goes to.
"""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.lib import command
from benchmarks.lib.report import Report
from benchmarks.lib.speed import choice, loops, own_math, where

PARTS: dict[str, Callable[[Report], None]] = {
    "loops": loops.measure,
    "first": loops.first_control,
    "levels": loops.levels,
    "choice": choice.measure,
    "math": own_math.measure,
}


def main() -> None:
    """All parts, or some."""
    parser = command.parser(__doc__, PARTS)
    parser.add_argument("--where", metavar="NAME", choices=where.NAMES, help=f"one of {', '.join(where.NAMES)}")
    options = parser.parse_args()
    if options.where:
        where.show(options.where)
        return
    names, report = command.chosen(parser, options, PARTS), Report("speed")
    command.measure(report, names, lambda name: PARTS[name](report), options.json)


if __name__ == "__main__":
    main()
