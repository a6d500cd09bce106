"""Random QPs of 13 classes go through every QP solver of ours, in both precisions.

Wrong OKs and failures are counted.

draw.py draws the QPs, stage_package.py makes the packages, judge.py computes the residuals. Two QPs of three are solved
by a controller after reset, the third from the working set of another QP of the same class.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from nmpc_codegen import Controller, Status, build
from nmpc_codegen.package.struct_layout import Precision
from verification.built import build_all
from verification.oracles.stage_qp import Shape, StageQP
from verification.qp.draw import SHAPES, draw, multipliers_of_dynamics, shapes_of
from verification.qp.judge import LIMITS, Verdict, judge
from verification.qp.stage_package import SCALARS, SOLVERS, Answer, answer, options, rounded, stage_ocp

QPS = 20_000  # per solver and precision
CHUNK = 60
SHOWN = 3  # examples of a class, solver and precision
UNSOLVED_LIMITS = {"double": 0.002, "single": 0.02}
#: Classes that single precision need not solve, if no wrong answer is called OK.
BEYOND_SINGLE = ("ill-conditioned", "nearly linear")
Package = tuple[Shape, str, Precision]


@dataclass
class Tally:
    """A tally counts the answers of a solver in a precision to the QPs of a class; examples: (number, fault)."""

    qps: int = 0
    feasible: int = 0
    status: Counter[str] = field(default_factory=Counter)
    false_ok: int = 0
    unsolved: int = 0
    examples: list[tuple[int, str]] = field(default_factory=list)

    def add(self, number: int, feasible: bool, status: Status, verdict: Verdict | None) -> None:
        """Count one answer; ``verdict``: its fault if it is wrong although it is called OK."""
        self.qps += 1
        self.feasible += feasible
        self.status[status.name] += 1
        given_up = feasible and status != Status.OK
        self.unsolved += given_up
        self.false_ok += verdict is not None
        if verdict is not None:
            figures = f"violation {verdict.violation:.1e}, stationarity {verdict.stationarity:.1e}"
            self.examples.insert(0, (number, f"OK, but {figures}: {verdict.where}"))
        elif given_up:
            self.examples.append((number, status.name))

    def merge(self, other: Tally) -> None:
        """Add another tally."""
        self.qps += other.qps
        self.feasible += other.feasible
        self.status += other.status
        self.false_ok += other.false_ok
        self.unsolved += other.unsolved
        self.examples = (self.examples + other.examples)[: 20 * SHOWN]


Tallies = dict[tuple[str, str, str], Tally]
#: Controllers of this process.
_controllers: dict[Package, Controller] = {}


def controllers(shapes: Iterable[Shape] = SHAPES) -> dict[Package, Controller]:
    """Return all packages, compiled side by side."""
    wanted = [(shape, solver, precision) for shape in shapes for solver in SOLVERS for precision in SCALARS]

    ocps = ((stage_ocp(shape), options(solver, precision)) for shape, solver, precision in wanted)
    return dict(zip(wanted, build_all(ocps), strict=True))


def solve(controller: Controller, qp: StageQP, precision: Precision) -> Answer:
    """Return the answer to a QP by a controller after reset, or by one that has just solved another QP."""
    controller.reset()
    if qp.seed % 3 == 2:
        answer(controller, rounded(draw(qp.kind, qp.seed + len(shapes_of(qp.kind))), precision))
    return answer(controller, rounded(qp, precision))


def verdict_of(qp: StageQP, found: Answer, precision: Precision) -> Verdict | None:
    """Return the verdict on a wrong answer that is called OK; None otherwise."""
    if found.status != Status.OK:
        return None
    verdict = judge(rounded(qp, precision), found.point, found.lam, LIMITS[precision])
    return verdict if verdict.wrong(LIMITS[precision]) else None


def run(kind: str, numbers: Iterable[int], packages: dict[Package, Controller]) -> Tallies:
    """Solve QPs of a class by all solvers."""
    tallies: Tallies = {(kind, solver, precision): Tally() for solver in SOLVERS for precision in SCALARS}
    for number in numbers:
        qp = draw(kind, number)
        for solver in SOLVERS:
            for precision in SCALARS:
                found = solve(packages[qp.shape, solver, precision], qp, precision)
                wrong = verdict_of(qp, found, precision)
                tallies[kind, solver, precision].add(number, qp.optimum is not None, found.status, wrong)
    return tallies


def take_packages(packages: dict[Package, Controller]) -> None:
    _controllers.update(packages)


def run_chunk(job: tuple[str, Sequence[int]]) -> Tallies:
    kind, numbers = job
    with np.errstate(all="ignore"):
        return run(kind, numbers, _controllers)


def replay(name: str) -> None:
    """Print the data of a QP, the answer to it and its residuals.

    Args:
        name: "class/number/solver/precision".
    """
    kind, number, solver, word = name.split("/")
    precision: Precision = "single" if word == "single" else "double"
    qp = draw(kind, int(number))
    controller = build(stage_ocp(qp.shape), options(solver, precision), profile="fast")
    found = solve(controller, qp, precision)
    data = rounded(qp, precision)
    with np.printoptions(precision=17, linewidth=140, suppress=False, threshold=10_000):
        for field_ in ("S", "b", "Q", "Q_N", "g", "g_N", "C", "c", "lower", "upper", "lower_u", "upper_u", "dx0"):
            print(f"{field_} =\n{getattr(data, field_)}")
        print(f"rows (node, kind, index) =\n{np.column_stack([qp.rows.node, qp.rows.kind, qp.rows.index])}")
        for part in ("dx", "du", "mult_u", "mult"):
            print(f"answer {part} =\n{getattr(found.point, part)}")
            if qp.optimum is not None:
                print(f"built around {part} =\n{getattr(qp.optimum, part)}")
    print(f"{qp.shape}: {found.status.name}, {controller.stats}")
    print(f"answer: {judge(data, found.point, found.lam, LIMITS[precision])}")
    if qp.optimum is not None:
        print(f"built around: {judge(data, qp.optimum, multipliers_of_dynamics(qp), LIMITS[precision])}")
