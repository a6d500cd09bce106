"""The command measures speed: python -m benchmarks.speed [--base COMMIT | --baseline FILE] [--scale S] [--table FILE].

Times and instructions of a sample are those of closed loops of nine problems: portable C as build() compiles it for
this processor, portable C for any processor, and C for the target of this machine. ``--base``: the loops of that commit
run in turn with ours, and its figures follow in parentheses. ``--json`` writes the figures; ``--table`` replaces the
table of a Markdown file (docs/performance.md) by the times.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.__main__ import add_page_options, page
from benchmarks.lib.report import Report, replace_table
from benchmarks.lib.speed.programs import BUILT
from nmpc_codegen.targets import NATIVE, PORTABLE

#: Name of a loop -> its line in the table.
LINES = {
    "crane": "crane, terminal constraint",
    "cstr": "stirred tank reactor, state bounds",
    "bioreactor": "bioreactor, exact Hessian",
    "quadrotor": "quadrotor, N = 20",
    "cart_pole": "cart-pole, N = 20",
    "chain3": "chain of 3, N = 40",
    "chain5": "chain of 5, N = 40",
    "chain7": "chain of 7, N = 40",
    "chain5_N160": "chain of 5, N = 160",
}
COLUMN = "time of a sample, us"
HEAD = (
    COLUMN,
    "as built, thereof feedback",
    "any processor",
    "native",
    "best peer",
    "as built to best peer",
    "native to it",
)


def table(report: Report) -> str:
    """Return the times as a Markdown table."""
    found = {record.place: record.value for record in report.records}

    def time(loop: str, form: str) -> str:
        total, feedback = (found[f"times/{loop}, {form}/{key}"] for key in ("total", "feedback"))
        return f"{digits(total)}, {digits(feedback)}"

    lines = [f"| {' | '.join(HEAD)} |", f"|---|{'---:|' * (len(HEAD) - 1)}"]
    for loop, name in LINES.items():
        cells = [name, *(time(loop, form) for form in (BUILT, PORTABLE.name, NATIVE))]
        ratios = [found.get(f"times/{loop}, {form}/to best peer") for form in (BUILT, NATIVE)]
        peer = "" if ratios[1] is None else digits(found[f"times/{loop}, {NATIVE}/total"] / ratios[1])
        cells += [peer, *("" if ratio is None else f"{ratio:.2f}" for ratio in ratios)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def digits(value: float) -> str:
    """Return two digits, and all before the point."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def main() -> None:
    """Run the command line: the page's options for times and instructions, and the table."""
    command = argparse.ArgumentParser(
        "benchmarks.speed", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add_page_options(command)
    command.add_argument("--table", metavar="FILE", type=Path, help="write the table of this file anew")
    command.set_defaults(only="times,instructions")
    options = command.parse_args()
    if options.table and not options.scale:
        command.error("--table has all loops; at --scale 0 one of them is measured")
    report = page(command, options)
    if options.table:
        replace_table(options.table, COLUMN, table(report))


if __name__ == "__main__":
    main()
