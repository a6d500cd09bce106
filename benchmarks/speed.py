"""Speed: python -m benchmarks.speed [--base COMMIT] [--scale S] [--json FILE] [--table FILE]

Times and instructions of a sample in closed loops of nine problems: portable C as build() compiles it for this
processor, portable C for any processor, and C for the target of this machine. ``--base``: the loops of that commit run
in turn with ours, and its figures stand in parentheses. ``--table`` writes them in place of the table of a Markdown
file (README.md).
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import ExitStack
from pathlib import Path

from benchmarks.lib.base import checkout, commits, figures_of, head
from benchmarks.lib.report import Baseline, Report, machine, replace_table
from benchmarks.lib.run import RefusedError, Run
from benchmarks.lib.speed import instructions, times
from benchmarks.lib.speed.programs import BUILT
from nmpc_codegen.targets import NATIVE, PORTABLE

TOPICS = {"times": times.measure, "instructions": instructions.measure}
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
    """The times as a Markdown table."""
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
    """Two digits, and all before the point."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def main() -> None:
    """The command line."""
    command = argparse.ArgumentParser("benchmarks.speed", description=__doc__)
    command.add_argument("--base", metavar="COMMIT", help="compare with this commit, run in turn")
    command.add_argument("--scale", metavar="S", type=float, default=0.5, help="share of the rounds (default 0.5)")
    command.add_argument("--json", metavar="FILE", help="write all records")
    command.add_argument("--table", metavar="FILE", type=Path, help="write the table of this file anew")
    options = command.parse_args()
    if not 0 < options.scale <= 1:
        command.error(f"--scale {options.scale:g}: expected a share, more than 0 and at most 1")
    run, baseline = Run(options.scale, commits()), Baseline.empty("none")
    try:
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            if options.base:
                base = stack.enter_context(checkout(options.base, folder))
                baseline, run = figures_of(base, list(TOPICS), run, folder)
            report = Report(baseline)
            print(f"{head()}  {machine()}\nbaseline: {baseline.label}\n")
            for name, measure in TOPICS.items():
                report.topic = name
                measure(report, run)
                report.print_matrix(name)
    except RefusedError as error:
        command.error(str(error))
    if options.json:
        report.write(options.json, commit=head(), scale=run.scale, seed=run.seed)
    if options.table:
        replace_table(options.table, COLUMN, table(report))


if __name__ == "__main__":
    main()
