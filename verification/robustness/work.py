"""Operations of the samples of closed loops are counted: the worst against the median, and soft rows against none.

A loop is recorded with the compiled controller, then its measured states and set points are played to the same package
with a real type that counts. Counts are exact and repeatable. Recorded and counted controls are compared.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from examples import bioreactor, cart_pole, chain, crane, cstr, quadrotor
from nmpc_codegen import OCP, Controller, ExactHessian, Options, Project, Status, build, generate
from verification.closed_loop import Scenario, disturbed
from verification.counting import HEADER, counting_header
from verification.scenarios import CRANE_LOOP, CSTR, EXAMPLES, FIGURE_6, FIGURE_6_STEPS, QUADROTOR

Array = np.ndarray
DRIVER = Path(__file__).with_name("counted_loop.cpp")
STEPS = 1000  # most samples of a loop
LEAST = 60  # samples of a quick look
IN_USE = 0.2  # least fraction of samples in which soft rows have multipliers


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop has default options, except the integrator and Hessian of its example."""

    name: str
    make: Callable[[], OCP]
    options: Options
    scenario: Scenario
    steps: int = STEPS


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording has samples (set point or None, measured state), controls (n, nu), and uses of soft rows (n,).

    ``opened``: indices of the rows whose bounds were removed before the first sample.
    """

    opened: list[int]
    samples: list[tuple[Array | None, Array]]
    u: Array
    in_use: Array


@dataclass(frozen=True, eq=False)
class Counted:
    """Samples are counted: operations (n,), also with comparisons and signs, statuses (n,), controls (n, nu)."""

    operations: Array
    every: Array
    status: Array
    u: Array


def closed_loops() -> list[Loop]:
    """Return the loops of the other benchmarks."""
    exact = bioreactor.options(ExactHessian(Project()), "repeat")
    plain = Options(exact.integrator, exact.hessian, algorithm=exact.algorithm)
    fermenter = Scenario(bioreactor.START, bioreactor.SAMPLING, 50, restart=1e-2)
    return [
        Loop("crane", crane.build_ocp, Options(), CRANE_LOOP),
        *(Loop(e.name, e.make, e.options, e.scenario(), e.steps) for e in EXAMPLES),
        Loop("cstr, three set points", CSTR.make, CSTR.options, FIGURE_6, FIGURE_6_STEPS),
        Loop("bioreactor", lambda: bioreactor.build_ocp(soft=True), plain, fermenter, 200),
    ]


def _slow_crane() -> OCP:
    """Return the OCP of the crane with limits of trolley speed and load angle that a jump of the load violates."""
    ocp = crane.build_ocp(False)
    ocp.subject_to(-0.3, ocp.x[1], 0.3, name="speed", soft=(10.0, 0.0))
    ocp.subject_to(-0.02, ocp.x[2], 0.02, name="angle", soft=(50.0, 10.0))
    return ocp


def _warm_reactor() -> OCP:
    """Return the OCP of the reactor with temperature limits above the set point."""
    ocp = cstr.build_ocp(state_bounds=False)
    ocp.subject_to(115.0, ocp.x[2], np.inf, name="warm", soft=(1.0, 0.0))
    ocp.subject_to(-np.inf, ocp.x[3], 112.0, name="cool", soft=(1.0, 0.5))
    return ocp


def _gentle_quadrotor() -> OCP:
    """Return the OCP of the quadrotor with limits of speed and tilt as general rows."""
    ocp = quadrotor.build_ocp((0.0, 0.0, 0.0))
    ocp.subject_to(-np.inf, ca.dot(ocp.x[3:6], ocp.x[3:6]), 0.05, name="speed", soft=(20.0, 0.0))
    ocp.subject_to(0.999, ca.cos(ocp.x[6]) * ca.cos(ocp.x[7]), np.inf, name="tilt", soft=(100.0, 0.0))
    return ocp


def _walled_chain() -> OCP:
    """Return the OCP of the chain with a wall that the pushes drive it through."""
    ocp = chain.build_ocp(3)
    ocp.subject_to(-np.inf, ocp.x[1], 0.02, name="wall", soft=(5.0, 0.0))
    ocp.subject_to(-np.inf, ocp.x[4], 0.02, name="hand_wall", soft=(5.0, 0.0))
    return ocp


def _cautious_pole() -> OCP:
    """Return the OCP of the cart-pole with soft limits of position and force."""
    ocp = cart_pole.build_ocp()
    ocp.subject_to(-0.02, ocp.x[0], 0.02, name="place", soft=(100.0, 0.0))
    ocp.subject_to(-1.0, ocp.u[0], 1.0, name="force", soft=(1.0, 0.1))
    return ocp


def soft_loops() -> list[Loop]:
    """Return loops that run into soft rows again and again."""
    hover = np.array([*np.zeros(12), *np.full(4, quadrotor.HOVER)])
    there = hover + np.array([1.0, 1.0, 1.0, *np.zeros(13)])
    points = tuple((y, y[:12]) for y in (hover, there))
    reactor, at_rest = CSTR.scenario(), EXAMPLES[3].scenario().x0
    flights = Scenario(np.zeros(12), 0.05, 25, set_points=points)
    pushed = Scenario(at_rest, 0.2, 25, push=(-1.0, 1.0, 1.0), pushes=5)
    return [
        Loop("crane", _slow_crane, Options(), Scenario((0.0, 0, 0, 0), 0.3, 20, amplitude=0.8), 400),
        Loop("cstr", _warm_reactor, Options(), reactor, 400),
        Loop("quadrotor", _gentle_quadrotor, QUADROTOR.options, flights, 200),
        Loop("chain3", _walled_chain, Options(), pushed, 200),
        Loop("cart_pole", _cautious_pole, Options(), Scenario((0.0, 0, 0, 0), 0.05, 20, amplitude=0.1), 400),
    ]


def record(loop: Loop, steps: int, opened: list[int]) -> Recorded:
    """Run the loop with the compiled controller, these rows without bounds."""
    c = build(loop.make(), loop.options, profile="fast")
    for row in opened:
        c.set_bounds(c.names.rows[row], -np.inf, np.inf)
    s, random = loop.scenario, np.random.default_rng(1)
    x, samples, u, in_use = np.array(s.x0, dtype=float), [], [], []
    for k in range(steps):
        point = None
        if k % s.period == 0:
            x = disturbed(s, x, random, c.integrate)
            if s.set_points:
                y, y_N = s.set_points[k // s.period % len(s.set_points)]
                c.set_reference(y)
                c.set_terminal_reference(y_N)
                point = np.concatenate([y, y_N])
        samples.append((point, x))
        u.append(c.step(x))
        in_use.append(_soft_rows_in_use(c))
        x = np.asarray(c.integrate(x, u[-1], s.dt))
    return Recorded(opened, samples, np.array(u), np.array(in_use))


def _soft_rows_in_use(c: Controller) -> bool:
    """Return True if a row other than a control bound has a multiplier; these loops have no hard rows of that kind."""
    return c.status == Status.OK and any(np.any(v) for v in (c.mu_x, c.mu, c.mu_N, c.eta))


def soft_rows(c: Controller) -> list[int]:
    """Return the indices of the soft rows."""
    return [i for i, row in enumerate(c.description.rows) if row.soft]


def count(loop: Loop, *played: Recorded, optimise: bool = True) -> list[Counted]:
    """Play recordings to the package with the counting type.

    Without optimiser the program is there four times as fast, and as much slower.
    """
    sources = generate(loop.make(), loop.options)
    name = sources.description.name
    with tempfile.TemporaryDirectory(prefix="counted-") as temporary:
        folder = Path(temporary)
        (folder / HEADER.name).write_text(HEADER.read_text(encoding="utf-8"), encoding="utf-8")
        (folder / f"{name}.h").write_text(counting_header(sources[f"{name}.h"], name), encoding="utf-8")
        (folder / f"{name}.c").write_text(sources[f"{name}.c"], encoding="utf-8")
        phases = [] if sources.description.has_phases else ["-DONE_CALL"]
        define = [*phases, f"-DNAME={name}", f"-DMACRO={name.upper()}", f'-DPACKAGE="{name}.c"']
        compiler = ["g++", "-O1"] if optimise else [shutil.which("clang++") or "g++", "-O0"]
        command = [*compiler, "-std=c++17", "-w", *define, f"-I{folder}", str(DRIVER), "-o", "loop", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        return [_play(folder / "loop", recorded) for recorded in played]


def _play(program: Path, recorded: Recorded) -> Counted:
    lines = [" ".join(map(str, [len(recorded.opened), *recorded.opened]))]
    for point, x in recorded.samples:
        given = [] if point is None else point.tolist()
        lines.append(" ".join(map(repr, [int(point is not None), *map(float, given), *map(float, x)])))
    text = "\n".join(lines) + "\n"
    out = subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout
    table = np.array([[float(v) for v in line.split()] for line in out.splitlines()])
    return Counted(table[:, 1], table[:, 2], table[:, 0].astype(int), table[:, 3:])


def steps_of(loop: Loop, scale: float) -> int:
    """Return the requested fraction of the samples, but enough for the loop to be disturbed."""
    return min(loop.steps, max(LEAST, round(1.2 * loop.scenario.period), round(scale * loop.steps)))


def control_difference(recorded: Recorded, counted: Counted) -> float:
    """Return the largest difference of the controls, relative to the largest magnitude of each."""
    size = np.maximum(np.max(np.abs(recorded.u), axis=0), np.finfo(float).tiny)
    return float(np.max(np.abs(recorded.u - counted.u) / size))
