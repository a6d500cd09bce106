"""The command computes and draws the papers' figures, and writes them on one page beside the papers' numbers.

    python -m benchmarks.papers [--only PAPER,...] [--scale S] [--folder FOLDER]

Papers are H11, Q14, HSJ, Z20 and T09. The page is <folder>/papers.md, its pictures are in <folder>/papers; with --only
the sections of the other papers stay. At scale 0 every figure has its least size, and shows little more than that it
can be drawn. The exit status is 1 if a number misses its limit.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks.lib.run import Run
from benchmarks.papers import convexified, h11, hsj, q14, rod, rows, t09, z20
from benchmarks.papers.exhibit import Check, Exhibit, Table

Draw = Callable[[Run], Exhibit]
#: Name -> title, and the functions that draw its exhibits.
PAPERS: dict[str, tuple[str, Mapping[str, Draw]]] = {
    "H11": (h11.PAPER, h11.EXHIBITS),
    "Q14": (q14.PAPER, q14.EXHIBITS),
    "HSJ": (hsj.PAPER, {**hsj.EXHIBITS, "Section I": convexified.compared}),
    "Z20": (z20.PAPER, z20.EXHIBITS),
    "T09": (t09.PAPER, {**t09.EXHIBITS, **rod.EXHIBITS, **rows.EXHIBITS}),
}
TITLE = """# The five papers, figure by figure

`python -m benchmarks.papers` computes and draws this page. It shows what this compiler's code gives for the figures and
tables of the papers that it implements, beside the numbers that they print. Where a paper has CPU times, there are
operations (+, -, *, /, sqrt and functions of math.h, counted by a scalar type) or instructions (counted by callgrind),
which do not depend on the machine."""


def main() -> int:
    """Draw the papers that the command line names."""
    parser = argparse.ArgumentParser(
        "benchmarks.papers", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--only", metavar="PAPER", help=f"some of {', '.join(PAPERS)}")
    parser.add_argument("--scale", metavar="S", type=float, default=1.0, help="share of samples and starts, 0 to 1")
    parser.add_argument("--folder", metavar="FOLDER", type=Path, default=Path("docs"), help="of the page")
    options = parser.parse_args()
    names = options.only.split(",") if options.only else list(PAPERS)
    unknown = [name for name in names if name not in PAPERS]
    if unknown:
        parser.error(f"--only {unknown[0]}: expected some of {', '.join(PAPERS)}")
    if not 0 <= options.scale <= 1:
        parser.error(f"--scale {options.scale:g}: expected a share, 0 to 1")
    page = options.folder / "papers.md"
    found, held = sections(page), True
    for name in names:
        begin = time.perf_counter()
        found[name], missed = section(name, Run(options.scale, 0, options.folder / "papers"))
        for check in missed:
            print(f"{name}: {check.what} is {check.value:.3g}, more than {check.limit:.3g}")
        held = held and not missed
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text("\n\n".join([TITLE, *(found[name] for name in PAPERS if name in found)]) + "\n", encoding="utf-8")
    print(page)
    return 0 if held else 1


def section(name: str, run: Run) -> tuple[str, list[Check]]:
    """Return the section of the page on a paper, and the checks that fail."""
    title, exhibits = PAPERS[name]
    drawn: list[Exhibit] = []
    for place, draw in exhibits.items():
        begin = time.perf_counter()
        drawn.append(draw(run))
        print(f"  {place}: {time.perf_counter() - begin:.1f} s", flush=True)
    checks = [check for exhibit in drawn for check in exhibit.checks]
    lines = [(check.what, f"{check.value:.1e}", f"{check.limit:.0e}") for check in checks]
    table = str(Table(("value", "limit"), lines))
    parts = [f"## {name}: {title}", *([table] if lines else []), *map(str, drawn)]
    return "\n\n".join(parts), [check for check in checks if not check.holds]


def sections(page: Path) -> dict[str, str]:
    """Return {paper: its section} of a page that exists."""
    if not page.is_file():
        return {}
    parts = page.read_text(encoding="utf-8").rstrip("\n").split("\n\n## ")[1:]
    return {part.split(":")[0]: f"## {part}" for part in parts}


if __name__ == "__main__":
    sys.exit(main())
