"""The topics of the benchmarks have names: first those of the page, then the figures of single methods."""

from __future__ import annotations

import shutil
from collections.abc import Callable

from benchmarks.lib import algebraic, batch, campaigns, estimation, export, stiff, strangers
from benchmarks.lib.convergence import starts
from benchmarks.lib.firmware import emulated, riscv
from benchmarks.lib.firmware import sizes as forms
from benchmarks.lib.report import Report
from benchmarks.lib.robustness import at_rest, cold, draws, episodes, qps, returns, work
from benchmarks.lib.run import RefusedError, Run
from benchmarks.lib.speed import instructions, recording, sizes, times

Topic = Callable[[Report, Run], None]


PAGE: dict[str, Topic] = {
    "times": times.measure,
    "sizes": sizes.sizes,
    "counts": sizes.counts,
    "instructions": instructions.measure,
    "export": export.measure,
    "returns": returns.measure,
    "episodes": episodes.measure,
    "qps": qps.measure,
    "solve": starts.measure,
    "strangers": strangers.measure,
    "stiff": stiff.measure,
    "algebraic": algebraic.measure,
}

#: Topics with a line per case and a column per figure.
MATRICES = frozenset(
    {
        *PAGE,
        *("batch", "campaigns", "estimation", "speed/recording"),
        "convergence/routes",
    }
)

TOPICS: dict[str, Topic] = {
    **PAGE,
    "batch": batch.measure,
    "campaigns": campaigns.measure,
    "estimation": estimation.measure,
    "strangers/solve": strangers.measure_solve,
    "speed/recording": recording.measure,
    "robustness/at_rest": at_rest.measure,
    "robustness/draws": draws.measure,
    "robustness/work": work.measure,
    "robustness/cold": cold.measure,
    "convergence/routes": starts.routes,
    "firmware/boards": emulated.boards,
    "firmware/bits": emulated.bits,
    "firmware/forms": forms.sizes,
    "firmware/counts": emulated.counts,
    "firmware/riscv": riscv.cores,
}

#: Topic -> programs without which it cannot run. Topics of the page leave out figures that need a missing program.
NEEDS = {
    "firmware/boards": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "firmware/bits": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "firmware/forms": ("arm-none-eabi-gcc",),
    "firmware/riscv": ("riscv64-unknown-elf-gcc",),
}


def chosen(only: str | None) -> list[str]:
    """Return the names of the topics that ``only`` lists.

    A name without its part means all parts. None means those of the page, "all" all whose programs are here.

    Raises:
        RefusedError: there is no such topic, or a program that it needs is missing.
    """
    if only is None:
        return list(PAGE)
    if only == "all":
        return [name for name in TOPICS if not _missing(name)]
    found: list[str] = []
    for word in only.split(","):
        names = [name for name in TOPICS if name == word or name.startswith(f"{word}/")]
        if not names:
            raise RefusedError(f"--only {word}: expected all, or some of {', '.join(TOPICS)}")
        for name in names:
            if missing := _missing(name):
                raise RefusedError(f"--only {name}: there is no {' and no '.join(missing)} on the path")
        found += names
    return found


def _missing(name: str) -> list[str]:
    """Return the programs that a topic needs and that are not installed."""
    return [program for program in NEEDS.get(name, ()) if shutil.which(program) is None]
