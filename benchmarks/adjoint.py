"""Single shooting with adjoints: derivatives and their growth, the figures of the thesis, the controller.

    python -m benchmarks.adjoint [--json FILE] [--only PART,...] [--draw FOLDER]

The figures are those of chapters 6 and 7 of the NTNU thesis of 2009 on adjoint derivatives in NMPC, as pictures in the
folder. Exponents are fitted to exact operation counts over N >= 100; times stand beside them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.lib import command
from benchmarks.lib.adjoint import (
    crane,
    cstr,
    rod,
    vandevusse,
)
from benchmarks.lib.report import Report


def without_pictures(measure: Callable[[Report], None]) -> Callable[[Report, Path], None]:
    """A part that draws nothing."""
    return lambda report, _: measure(report)


#: Part -> its function, which adds records and writes its pictures to the folder.
PARTS: dict[str, Callable[[Report, Path], None]] = {
    "crane": without_pictures(crane.measure),
    "cstr": without_pictures(cstr.measure),
    "vandevusse": vandevusse.measure,
    "heat_rod": without_pictures(rod.measure),
}


def main() -> None:
    """All parts, or some."""
    parser = command.parser(__doc__, PARTS)
    parser.add_argument("--draw", metavar="FOLDER", default="out/adjoint", help="folder of the pictures")
    options = parser.parse_args()
    names, report, folder = command.chosen(parser, options, PARTS), Report("adjoint"), Path(options.draw)
    command.measure(report, names, lambda name: PARTS[name](report, folder), options.json)


if __name__ == "__main__":
    main()
