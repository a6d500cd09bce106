"""The benchmarks print one page of figures that a change can affect, and by name those of single methods.

The papers' figures are drawn by python -m benchmarks.papers.

    python -m benchmarks [--only TOPIC,...] [--base COMMIT] [--scale S] [--seed N] [--json FILE]

Every figure is followed, in parentheses, by its value at the baseline. The baseline is a file which --json wrote or,
with --base, a commit, whose checkout runs on this machine, its closed loops in turn with ours. A triangle marks bytes,
instructions and operations that are 2 % above the baseline, and times that are 10 % above it if both were measured on
one machine. The reference kernel converts times of another machine.

The default scale is that of a page in some minutes: draws of QPs, controllers and starts are samples that the seed
chooses, which is the number of commits. At scale 1 they are complete, at 0 every topic has one case, which shows that
it runs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from benchmarks.lib.base import Base, checkout, commits, head
from benchmarks.lib.report import Baseline, Report, listed, machine
from benchmarks.lib.run import RefusedError, Run
from benchmarks.lib.speed import where
from benchmarks.lib.speed.programs import read_programs
from benchmarks.topics import MATRICES, PAGE, TOPICS, chosen
from verification.qp.verdicts import replay as replay_qp
from verification.robustness.episodes import replay as replay_episode

COMMITTED = Path(__file__).with_name("baseline.json")
SCALE = 0.2


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    found = argparse.ArgumentParser("benchmarks", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    more = ", ".join(name for name in TOPICS if name not in PAGE)
    found.add_argument("--only", metavar="TOPIC", help=f"some of {', '.join(PAGE)};\nnot on the page: {more}; all")
    add_page_options(found)
    found.add_argument("--replay", metavar="NAME", help="class/number/solver/precision or controller/number: print it")
    found.add_argument("--where", metavar="LOOP", choices=where.NAMES, help="shares of functions in a sample's time")
    return found


def add_page_options(found: argparse.ArgumentParser) -> None:
    """Add the options of page() besides the topics."""
    baseline = found.add_mutually_exclusive_group()
    baseline.add_argument("--base", metavar="COMMIT", help="compare with this commit, run in turn")
    baseline.add_argument("--baseline", metavar="FILE", type=Path, default=COMMITTED, help="benchmarks/baseline.json")
    found.add_argument("--scale", metavar="S", type=float, default=SCALE, help=f"share of the draws (default {SCALE})")
    found.add_argument("--seed", metavar="N", type=int, default=commits(), help="of the draws")
    found.add_argument("--json", metavar="FILE", help="write all records")


def main() -> None:
    """Print the page, or the results of the given options."""
    command = parser()
    options = command.parse_args()
    if options.replay:
        (replay_qp if options.replay.count("/") == 3 else replay_episode)(options.replay)
        return
    if options.where:
        where.show(options.where)
        return
    page(command, options)


def page(command: argparse.ArgumentParser, options: argparse.Namespace) -> Report:
    """Measure and print the requested topics; the command ends where it cannot."""
    if not 0 <= options.scale <= 1:
        command.error(f"--scale {options.scale:g}: expected a share, 0 to 1")
    if not options.baseline.is_file():
        command.error(f"--baseline {options.baseline}: there is no such file")
    try:
        names = chosen(options.only)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            base = stack.enter_context(checkout(options.base, folder)) if options.base else None
            return measure(options, names, base, folder)
    except RefusedError as error:
        command.error(str(error))


def measure(options: argparse.Namespace, names: list[str], base: Base | None, folder: Path) -> Report:
    """Run the topics and print each as soon as it is measured."""
    start, run = time.perf_counter(), Run(options.scale, options.seed)
    if base is None:
        baseline = Baseline.of(options.baseline, options.baseline.name)
    else:
        baseline, run = figures_of(base, names, run, folder)
    report = Report(baseline)
    print(f"{head()}  {machine()}\nbaseline: {report.baseline.label}; scale {run.scale:g}, seed {run.seed}\n")
    for name in names:
        begin, report.topic = time.perf_counter(), name
        TOPICS[name](report, run)
        (report.print_matrix if name in MATRICES else report.print_list)(name)
        print(f"{time.perf_counter() - begin:.0f} s\n", flush=True)
    print(verdict(report) + f"\n{time.perf_counter() - start:.0f} s in all")
    if options.json:
        report.write(options.json, commit=head(), scale=run.scale, seed=run.seed)
    return report


def figures_of(base: Base, names: list[str], run: Run, folder: Path) -> tuple[Baseline, Run]:
    """Return the baseline of a commit, and the run with its programs, if there are times to compare."""
    others, label = [name for name in names if name != "times"], f"commit {base.name}, in turn"
    baseline = Baseline.empty(label)
    if others:
        file = folder / "base.json"
        asked = ("--only", ",".join(others), "--scale", str(run.scale), "--seed", str(run.seed), "--json", str(file))
        base.run("benchmarks", *asked)
        baseline = Baseline.of(file, label, same_machine=True)
    if "times" in names:
        base.run("benchmarks.lib.speed.programs", str(folder / "programs"))
        run = replace(run, base_programs=read_programs(folder / "programs"))
    return baseline, run


def verdict(report: Report) -> str:
    """Return the figures that grew and those beyond their limits."""
    grown, missed = report.grown(), report.missed()
    lines = [f"{len(grown)} figures grew, {len(missed)} are beyond their limits"]
    lines += [f"grown:\n{listed(grown)}"] if grown else []
    lines += [f"beyond their limits:\n{listed(missed)}"] if missed else []
    return "\n".join(lines)


if __name__ == "__main__":
    main()
