"""Instructions of a sample are measured phase by phase, with the bytes of a package."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.lib import callgrind
from benchmarks.papers.exhibit import Cell
from nmpc_codegen import generate
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.compilers import find_compiler
from verification.closed_loop import compile_driver, run_driver
from verification.robustness.work import Loop

#: Phase -> the beginnings of its functions' names; other functions belong to "rest".
GROUPS = {
    "integration": r"integrator|linearize|path_|adjoint_step|terminal_|(__)?(exp|sin|cos|tan)|__ieee754|pow",
    "regularisation": r"jacobi|regulari[sz]e|test_block|blend_block|add_curv",
    "condensing": r"condense",
    "QP": r"qp_|riccati|run_qp|solve_upper",
}


def phases(loop: Loop) -> dict[str, float] | None:
    """Return the instructions per sample of each phase in portable code.

    None without valgrind, or names of functions.
    """
    if not callgrind.available():
        return None
    sources = generate(loop.make(), loop.options)
    flags = (*PROFILES["fast"].flags, "-fno-inline-functions-called-once")
    with tempfile.TemporaryDirectory() as folder:
        program = compile_driver(sources, sources.description.name, Path(folder), flags)
        arguments = ["1", str(loop.steps), *loop.scenario.arguments()]
        counted = callgrind.profile(program, arguments, callgrind.PHASES)
    found = dict.fromkeys((*GROUPS, "rest"), 0.0)
    for name, instructions in counted.items():
        found[next((g for g, names in GROUPS.items() if re.match(names, name)), "rest")] += instructions / loop.steps
    return found if any(found.values()) else None


#: Phases of a sample with a least-squares cost; "regularisation" is the curvature of active rows.
ORDER = ("integration", "condensing", "QP", "regularisation", "rest")


def machine_code(sources: Sources, *flags: str) -> int:
    """Return the bytes of code and constants of the object file, by default of the profile "fast"."""
    name = sources.description.name
    with tempfile.TemporaryDirectory() as folder:
        for path in (f"{name}.h", f"{name}.c"):
            (Path(folder) / path).write_text(sources[path], encoding="utf-8")
        command = [*find_compiler(), *(flags or PROFILES["fast"].flags), "-std=c99", "-c", f"{name}.c", "-o", "p.o"]
        subprocess.run(command, cwd=folder, check=True)
        table = subprocess.run(["size", "p.o"], cwd=folder, check=True, capture_output=True, text=True).stdout
    return int(table.splitlines()[1].split()[0])


@dataclass(frozen=True, eq=False)
class Sample:
    """A sample of a closed loop has us, instructions of its phases (None without valgrind), kB of code and data."""

    us: float
    phases: dict[str, float] | None
    code: float
    data: float

    @classmethod
    def of(cls, loop: Loop) -> Sample:
        """Measure a sample of a loop."""
        sources, found = generate(loop.make(), loop.options), phases(loop)
        with tempfile.TemporaryDirectory() as folder:
            program = compile_driver(sources, sources.description.name, Path(folder))
            us = run_driver(program, loop.scenario, runs=9, steps=loop.steps).total
        return cls(us, found, machine_code(sources) / 1e3, sources.description.report.ram_bytes / 1e3)

    def share(self, *names: str) -> str:
        """Return the share of phases in percent."""
        return "-" if self.phases is None else f"{sum(map(self.phases.__getitem__, names)) / self.whole:.0%}"

    def less(self, other: Sample) -> str:
        """Return the reduction of the instructions relative to another sample, in percent."""
        return "-" if self.phases is None else f"{1 - self.whole / other.whole:.0%}"

    @property
    def whole(self) -> float:
        """Return the instructions of the sample."""
        return sum((self.phases or {}).values())

    def rows(self, word: str) -> list[Sequence[Cell]]:
        """Return rows with the instructions, and with shares and time."""
        shares: list[Cell] = [f"ours, {word}, share of instructions; us", *(self.share(p) for p in ORDER), self.us]
        if self.phases is None:
            return [[*shares, self.code, self.data]]
        counted: list[Cell] = [f"ours, {word}, instructions", *(self.phases[p] for p in ORDER)]
        return [[*counted, self.whole, self.code, self.data], [*shares, "", ""]]
