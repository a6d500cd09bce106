"""Closed loops are timed in C, because a call from Python takes as long as the feedback phase of the crane."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.compilers import find_compiler
from nmpc_codegen.targets import TARGETS

DRIVER = Path(__file__).with_name("closed_loop.c")


Vector = Sequence[float] | NDArray[np.float64]


@dataclass(frozen=True)
class Scenario:
    """A scenario is a closed loop from x0 with samples of dt (s) and the controller's model as plant.

    At every sample n with n % period == 0, in this order: amplitude U(-1, 1) is added to all states; set point
    n / period (cyclically) becomes the reference (y, y_N) of all nodes; the plant runs for ``pushes`` samples under
    ``push``.
    With ``restart`` every state becomes x0 (1 + restart U(-1, 1)) first.
    """

    x0: Vector
    dt: float
    period: int
    amplitude: float = 0.0
    restart: float = 0.0
    set_points: Sequence[tuple[Vector, Vector]] = ()
    push: Vector = ()
    pushes: int = 0

    def arguments(self) -> list[str]:
        """Return the command line of closed_loop.c, from dt onwards."""
        numbers = [self.dt, self.period, self.amplitude, self.restart, *self.x0, len(self.set_points)]
        numbers += [value for point in self.set_points for part in point for value in part]
        numbers += [self.pushes, *(self.push if self.pushes else ())]
        return [repr(v) if isinstance(v, int) else repr(float(v)) for v in numbers]


def disturbed(
    scenario: Scenario, x: np.ndarray, random: np.random.Generator, integrate: Callable[..., np.ndarray]
) -> np.ndarray:
    """Apply what a scenario does to the state at the first sample of a period; the caller sets the set points."""
    if scenario.restart:
        x = np.array(scenario.x0, dtype=float) * (1 + scenario.restart * random.uniform(-1, 1, x.size))
    x = x + scenario.amplitude * random.uniform(-1, 1, x.size)
    for _ in range(scenario.pushes):
        x = np.asarray(integrate(x, np.array(scenario.push), scenario.dt))
    return x


@dataclass(frozen=True)
class Timing:
    """A timing has minimum and median over the runs of the median over the steps, us, and failures and QP iterations.

    ``worst``: largest total of a step, where the total of a step is its minimum over the runs. All runs are alike, so
    that this leaves out delays by the operating system in one of them.
    """

    total: float
    feedback: float
    total_median: float
    worst: float
    failed: int
    qp_iterations: float
    qp_iterations_max: int
    samples: int


def compile_driver(
    sources: Sources, name: str, folder: Path, flags: Sequence[str] = PROFILES["fast"].flags, driver: Path = DRIVER
) -> Path:
    """Compile the driver together with the package, with these flags and those of its target."""
    for path in (f"{name}.h", f"{name}.c"):
        (folder / path).write_text(sources[path], encoding="utf-8")
    program = folder / "closed_loop"
    flags = (*flags, *TARGETS[sources.description.target].of_machine)
    command = [*find_compiler(), *flags, "-std=c99", f"-DNAME={name}", f"-DMACRO={name.upper()}"]
    command += [f'-DPACKAGE="{name}.c"', f"-DQP_ITERATIONS={member_path(sources[f'{name}.h'], 'qp_iterations')}"]
    subprocess.run([*command, f"-I{folder}", str(driver), "-o", str(program), "-lm"], check=True)
    return program


def member_path(header: str, member: str) -> str:
    """Return the access path, in the solver struct, of a member that exactly one struct has: "stats.qp_iterations".

    Packages of other commits may store it in a different struct.
    """
    pattern = r"^(?:typedef )?struct (\w*) ?\{(.*?)^\} ?(\w*);$"
    structs = {m[3] or f"{m[1]}_t": m[2] for m in re.finditer(pattern, header, re.M | re.S)}
    solver = next(name for name in structs if name.endswith("_solver_t"))
    path, owner = member, _owner(structs, rf"\w+ {member}")
    while owner != solver:
        holder = _owner(structs, rf"{owner} (\w+)")
        found = re.search(rf"^\s*{owner} (\w+);", structs[holder], re.M)
        if found is None:
            raise ValueError(f"{owner} is no plain member of {holder}")
        path, owner = f"{found[1]}.{path}", holder
    return path


def _owner(structs: Mapping[str, str], declaration: str) -> str:
    """Return the struct that declares the member; exactly one is expected."""
    (owner,) = (name for name, text in structs.items() if re.search(rf"^\s*{declaration};", text, re.M))
    return owner


def pinned_core() -> set[int]:
    """Return the core to which all timed processes are pinned."""
    return {max(os.sched_getaffinity(0))}


def closed_loop(sources: Sources, name: str, scenario: Scenario, *, runs: int = 15, steps: int = 1000) -> Timing:
    """Time a package."""
    with tempfile.TemporaryDirectory() as folder:
        return run_driver(compile_driver(sources, name, Path(folder)), scenario, runs=runs, steps=steps)


def run_driver(program: Path, scenario: Scenario, *, runs: int, steps: int) -> Timing:
    """Time a compiled driver in a scenario."""
    return run_program(program, scenario.arguments(), runs=runs, steps=steps)


def run_program(program: Path, arguments: Sequence[str], *, runs: int, steps: int) -> Timing:
    """Time a compiled driver with the arguments of a scenario, pinned to one core."""
    core = pinned_core()
    command = [str(program), str(runs), str(steps), *arguments]
    text = subprocess.run(
        command, check=True, capture_output=True, text=True, preexec_fn=lambda: os.sched_setaffinity(0, core)
    ).stdout
    *lines, worst = text.splitlines()
    table = np.array([[float(v) for v in line.split()] for line in lines])
    return Timing(
        total=float(table[:, 0].min()),
        feedback=float(table[:, 1].min()),
        total_median=float(np.median(table[:, 0])),
        worst=float(worst),
        failed=int(table[:, 2].max()),
        qp_iterations=float(table[:, 3].mean()),
        qp_iterations_max=int(table[:, 4].max()),
        samples=runs * steps,
    )
