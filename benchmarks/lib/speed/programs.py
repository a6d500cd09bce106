"""The closed loops are compiled as programs in three forms.

The forms are portable C as build() compiles it, for this processor; portable C for any processor; C for the target of
this machine.

    python -m benchmarks.lib.speed.programs FOLDER

compiles those of this checkout; FOLDER/programs.json names them with their arguments. So programs of two commits can
run in turn, each made by the code of its own commit.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.lib.speed.loops import LOOPS, for_target, module_of, package_of
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.targets import NATIVE, PORTABLE
from verification.closed_loop import Timing, compile_driver, run_program
from verification.robustness.work import Loop

INDEX = "programs.json"
#: Portable C as build() compiles it.
BUILT = "as built"
RUNS = 3  # of a loop in a process


def forms() -> Mapping[str, tuple[str, tuple[str, ...]]]:
    """Return {form: (target of the package, flags of the compiler besides those of the target)}."""
    fast = PROFILES["fast"]
    return {
        BUILT: (PORTABLE.name, fast.all_flags()),
        PORTABLE.name: (PORTABLE.name, fast.flags),
        NATIVE: (NATIVE, fast.flags),
    }


@dataclass(frozen=True)
class Program:
    """A program is a compiled loop in a form; ``arguments`` are those of closed_loop.c after runs and steps."""

    loop: str
    form: str
    path: str
    arguments: list[str]
    steps: int
    target: str

    @property
    def case(self) -> str:
        """Return the name of its line on the page."""
        return f"{self.loop}, {self.form}"

    def run(self) -> Timing:
        """Run the loop several times from its start."""
        return run_program(Path(self.path), self.arguments, runs=RUNS, steps=self.steps)


def compile_programs(folder: Path, loops: Sequence[Loop] = LOOPS) -> list[Program]:
    """Write all units one after the other, and compile two at a time."""
    jobs: list[tuple[Program, Future[Path]]] = []
    with ThreadPoolExecutor(2) as pool:
        for loop in sorted(loops, key=lambda loop: -len(loop.scenario.x0)):
            arguments, name = loop.scenario.arguments(), module_of(loop).name
            for form, (target, flags) in forms().items():
                sources = package_of(for_target(loop, target))
                place = folder / f"{loop.name}, {form}"
                place.mkdir(parents=True)
                job = pool.submit(compile_driver, sources, name, place, flags)
                program = Program(
                    loop.name, form, str(place / "closed_loop"), arguments, loop.steps, sources.description.target
                )
                jobs.append((program, job))
    for _, job in jobs:
        job.result()
    order = [loop.name for loop in LOOPS]
    return sorted((program for program, _ in jobs), key=lambda p: order.index(p.loop))


def read_programs(folder: Path) -> list[Program]:
    """Read the programs that main() has compiled there."""
    return [Program(**entry) for entry in json.loads((folder / INDEX).read_text(encoding="utf-8"))]


def main() -> None:
    """Compile into the given folder."""
    folder = Path(sys.argv[1])
    found = [asdict(program) for program in compile_programs(folder)]
    (folder / INDEX).write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
