"""Figures of the code base: sizes, types, rendering, style of the C, agreement of compilers, times against a commit.

    python -m benchmarks.house [--json FILE] [--only PART,...] [--before COMMIT]

With --before, rendering_differences also counts samples whose package from that commit compiles to different object
code than the package from this tree: the oracle of a change that affects only the text.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from functools import partial

from benchmarks.lib import command
from benchmarks.lib.house import disagreement, lint, ratios, rendering, sizes, suite
from benchmarks.lib.report import Report


def figures(module: str, report: Report) -> None:
    """measure() of a module of benchmarks/lib; an empty function if this tree does not contain the module."""
    name = f"benchmarks.lib.{module}"
    if importlib.util.find_spec(name) is None:
        print(f"{name}: not in this tree")
        return
    importlib.import_module(name).measure(report)


PARTS: dict[str, Callable[[Report], None]] = {
    "sizes": sizes.measure,
    "traces": partial(figures, "traces"),
    "typing": partial(figures, "typing_figures"),
    "rendering": rendering.measure,
    "lint": lint.measure,
    "compilers": disagreement.measure,
    "ratios": ratios.measure,
    "suite": suite.measure,
}


def main() -> None:
    """Run all parts, or some of them."""
    parser = command.parser(__doc__, PARTS)
    parser.add_argument("--before", metavar="COMMIT", help="compare object code with packages of this commit, too")
    options = parser.parse_args()
    parts = {**PARTS, "rendering": partial(rendering.measure, before=options.before)}
    names, report = command.chosen(parser, options, PARTS), Report("house")
    command.measure(report, names, lambda name: parts[name](report), options.json)


if __name__ == "__main__":
    main()
