"""The topics of the benchmarks by name: first those of the page, then the figures of single methods and papers."""

from __future__ import annotations

import shutil
from collections.abc import Callable

from benchmarks.lib import export, strangers
from benchmarks.lib.adjoint import crane, cstr, precision, quasi_newton, rod, vandevusse
from benchmarks.lib.augmented import bounds, cold, loop, schemes, tracking
from benchmarks.lib.convergence import loops, singles, starts
from benchmarks.lib.economic import driving, evaporation, figure3, figure4, figures, timing
from benchmarks.lib.firmware import emulated, riscv, single
from benchmarks.lib.firmware import sizes as forms
from benchmarks.lib.hessian import bioreactor, iterations, second_order
from benchmarks.lib.report import Report
from benchmarks.lib.robustness import at_rest, episodes, qps, returns, violations, work, worst
from benchmarks.lib.run import RefusedError, Run
from benchmarks.lib.speed import choice, instructions, levels, own_math, sizes, times
from benchmarks.lib.tracking import accuracy, figure_6

Topic = Callable[[Report, Run], None]


def plain(measure: Callable[[Report], None]) -> Topic:
    """A topic without draws."""
    return lambda report, _: measure(report)


def scaled(measure: Callable[[Report, float], None]) -> Topic:
    """A topic that counts a share of its cases."""
    return lambda report, run: measure(report, run.scale)


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
}

#: Topics with a line per case and a column per figure.
MATRICES = frozenset({*PAGE, "speed/levels", "convergence/routes"})

TOPICS: dict[str, Topic] = {
    **PAGE,
    "strangers/solve": strangers.measure_solve,
    "speed/first_control": plain(levels.first_control),
    "speed/levels": plain(levels.levels),
    "speed/choice": plain(choice.measure),
    "speed/own_math": plain(own_math.measure),
    "tracking/accuracy": plain(accuracy.measure),
    "tracking/figure_6": plain(figure_6.measure),
    "robustness/at_rest": scaled(at_rest.measure),
    "robustness/work": scaled(work.measure),
    "robustness/worst": scaled(worst.measure),
    "robustness/violations": scaled(violations.measure),
    "convergence/routes": starts.routes,
    "convergence/singles": scaled(singles.measure),
    "convergence/loops": scaled(loops.measure),
    "firmware/boards": scaled(emulated.boards),
    "firmware/bits": scaled(emulated.bits),
    "firmware/forms": scaled(forms.sizes),
    "firmware/counts": scaled(emulated.counts),
    "firmware/single": scaled(single.single),
    "firmware/riscv": scaled(riscv.cores),
    "exact_hessian/times": plain(bioreactor.times),
    "exact_hessian/promise": plain(second_order.promise),
    "exact_hessian/table_1": plain(second_order.report_table_1),
    "exact_hessian/table_3": plain(bioreactor.table_3),
    "exact_hessian/iterations": plain(iterations.measure),
    "exact_hessian/orbits": plain(bioreactor.orbits),
    "exact_hessian/loops": plain(bioreactor.loops),
    "economic/tuning": plain(evaporation.measure_tuning),
    "economic/theory": plain(evaporation.measure_theory),
    "economic/figure_1": plain(evaporation.measure_figure1),
    "economic/figure_3": plain(figure3.measure),
    "economic/figure_4": plain(figure4.measure),
    "economic/driving": plain(driving.measure),
    "economic/times": plain(timing.measure),
    "economic/pictures": lambda _, run: print("\n".join(map(str, figures.draw(run.pictures)))),
    "augmented/loop": scaled(loop.measure),
    "augmented/bounds": scaled(bounds.measure),
    "augmented/cold": cold.measure,
    "augmented/tracking": scaled(tracking.measure),
    "augmented/schemes": scaled(schemes.measure),
    "adjoint/crane": plain(crane.measure),
    "adjoint/cstr": plain(cstr.measure),
    "adjoint/precision": plain(precision.measure),
    "adjoint/quasi_newton": plain(quasi_newton.measure),
    "adjoint/vandevusse": lambda report, run: vandevusse.measure(report, run.pictures),
    "adjoint/heat_rod": plain(rod.measure),
}

#: Topic -> programs without which it cannot run. Topics of the page leave out what needs a missing program.
NEEDS = {
    "firmware/boards": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "firmware/bits": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "firmware/forms": ("arm-none-eabi-gcc",),
    "firmware/riscv": ("riscv64-unknown-elf-gcc",),
}


def chosen(only: str | None) -> list[str]:
    """Names of the topics that ``only`` lists; a name without its part means all parts; None: those of the page.

    Raises:
        RefusedError: there is no such topic, or a program that it needs is missing.
    """
    if only is None:
        return list(PAGE)
    found: list[str] = []
    for word in only.split(","):
        names = [name for name in TOPICS if name == word or name.startswith(f"{word}/")]
        if not names:
            raise RefusedError(f"--only {word}: expected some of {', '.join(TOPICS)}")
        for name in names:
            missing = [program for program in NEEDS.get(name, ()) if shutil.which(program) is None]
            if missing:
                raise RefusedError(f"--only {name}: there is no {' and no '.join(missing)} on the path")
        found += names
    return found
