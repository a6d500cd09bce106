"""QPs of closed loops of chains and the quadrotor: our solvers timed in C, CasADi's plugins by their own clocks.

Cold: no working set, no guess. Warm: from the solution of the preceding sample with the same active set.
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.lib.qp.recorded import read_qp
from nmpc_codegen import OCP, Options, build
from nmpc_codegen.components.condensing import NoCondensing
from nmpc_codegen.components.qp import RiccatiActiveSet
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import render
from nmpc_codegen.runtime.build import PROFILES, find_compiler
from nmpc_codegen.runtime.status import Status
from verification.c_harness import memory_layout
from verification.closed_loop import Scenario
from verification.oracles.stage_qp import Array, Point, StageQP, distance, residuals
from verification.qp.plugins import Formulation, Plugin, condensed_form, point_of, stage_form, without_start
from verification.qp.stage_solvers import write_qp
from verification.scenarios import EXAMPLES, Example

DRIVER = Path(__file__).with_name("qp_times.c")
BY_NAME = {example.name: example for example in EXAMPLES}
SAME, NEAR = 1e-7, 1e-3  # relative distance of the steps up to which an answer of ours, or of a plugin, is accepted
REPEATS = 20
SLOW = 5e5  # us: a plugin that takes longer runs once, and not on larger examples
PLUGINS = ("hpipm", "qpoases", "daqp", "osqp", "fatrop")
DENSE = ("qpoases", "daqp")  # these also get the condensed QP


@dataclass(frozen=True, eq=False)
class Recorded:
    """QPs of one closed loop, with our verified solution as ``optimum``; disturbed: first QP after a disturbance."""

    name: str
    N: int
    qps: tuple[StageQP, ...]
    disturbed: tuple[bool, ...]

    @property
    def cold(self) -> list[int]:
        """QPs right after a disturbance."""
        return [i for i, first in enumerate(self.disturbed) if first]

    @property
    def warm(self) -> list[int]:
        """QPs whose active set equals that of the preceding QP."""
        same = [i for i in range(1, len(self.qps)) if not self.disturbed[i] and self._active(i) == self._active(i - 1)]
        return same[:: max(1, len(same) // 12)]

    def _active(self, i: int) -> tuple[bytes, bytes]:
        optimum = self.qps[i].optimum
        assert optimum is not None
        return np.sign(optimum.mult_u).tobytes(), np.sign(optimum.mult).tobytes()


def stretched(example: Example, N: int) -> OCP:
    """The example with N intervals of its own length."""
    ocp = example.make()
    vars(ocp).update(N=N, dt=(ocp.dt[0],) * N)
    return ocp


@functools.cache
def record(name: str, N: int, disturbances: int = 6, samples: int = 20) -> Recorded:
    """Closed loop, ``samples`` after each disturbance, with the solver that handles long horizons best."""
    example = BY_NAME[name]
    ocp = stretched(example, N)
    exact = Options(example.options.integrator, condensing=NoCondensing(), qp=RiccatiActiveSet())
    problem, c = classify(ocp), build(ocp, exact)
    scenario, struct = example.scenario(), c._struct
    rng, x = np.random.default_rng(1), np.array(example.scenario().x0, dtype=float)
    qps, disturbed = [], []
    for event in range(disturbances):
        x = _disturbed(c, scenario, event, x, rng)
        for n in range(samples):
            c.prepare()
            plan = c.x.copy(), c.u.copy()
            qp = read_qp(problem, struct, x)
            u = c.feedback(x, on_failure="raise")
            step = struct["step"]
            point = Point(c.x - plan[0], step["du"].copy(), c.mu_u.copy(), np.zeros(0))
            qp = dataclasses.replace(qp, optimum=point, growth=np.inf)
            assert residuals(qp, point).worst < 1e-8
            qps.append(qp)
            disturbed.append(n == 0)
            x = np.asarray(c.integrate(x, u, scenario.dt))
    return Recorded(name, N, tuple(qps), tuple(disturbed))


def _disturbed(c: Any, s: Scenario, event: int, x: Array, rng: np.random.Generator) -> Array:
    x = x + s.amplitude * rng.uniform(-1, 1, x.size)
    if s.set_points:
        y, y_N = s.set_points[event % len(s.set_points)]
        c.set_reference(y)
        c.set_terminal_reference(y_N)
    for _ in range(s.pushes):
        x = np.asarray(c.integrate(x, np.array(s.push), s.dt))
    return x


# Ours -----------------------------------------------------------------------------------------------------------------


class Timed:
    """A package with its timing functions, in profile "fast"."""

    def __init__(self, name: str, N: int, options: Options) -> None:
        model = linearize(classify(stretched(BY_NAME[name], N)), options)
        self.options = model.options
        module = lower(model)
        sources = render(module)
        self.folder = tempfile.TemporaryDirectory(prefix="qp_times_")
        for file in (f"{name}.h", f"{name}.c"):
            Path(self.folder.name, file).write_text(sources[file], encoding="utf-8")
        command = [*find_compiler(), *PROFILES["fast"].flags, "-std=c99", f"-DNAME={name}", f'-DPACKAGE="{name}.c"']
        command += ["-DFULL_CONDENSING"] if model.parts.condensing.gives == "condensed" else []
        command += ["-I.", str(DRIVER), "-w", "-shared", "-fPIC", "-o", "library.so", "-lm"]
        subprocess.run(command, cwd=self.folder.name, check=True)
        self.library = ctypes.CDLL(str(Path(self.folder.name, "library.so")))
        self.library.time_qp.restype = ctypes.c_double
        layout = memory_layout(module)
        assert self.library.size_of_timed() == layout.itemsize
        self.memory, self.before = np.zeros((), layout), np.zeros((), layout)
        self.library.init_timed(self._pointer(self.memory))
        self.bytes = layout.itemsize

    @staticmethod
    def _pointer(array: Array) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    def solve(self, qp: StageQP) -> Status:
        """Solve from the predicted working set."""
        write_qp(self.memory, qp)
        return Status(self.library.run_timed_qp(self._pointer(self.memory), self._pointer(qp.dx0)))

    def agrees(self, qp: StageQP) -> bool:
        """True if the last solution is the recorded one."""
        step = self.memory["step"]
        mult = step["mult"] if "mult" in step.dtype.names else np.zeros(0)  # no member without rows
        return distance(qp, Point(step["dx"], step["du"], step["mult_u"], mult)) < SAME

    def time(self, qp: StageQP, *, cold: bool, repeats: int = REPEATS) -> float:
        """Minimum time (us) of both phases, without or with the last working set; NaN: not the recorded solution."""
        write_qp(self.memory, qp)
        self.before[...] = self.memory
        pointers = (self._pointer(a) for a in (self.memory, self.before, qp.dx0))
        least = float(self.library.time_qp(*pointers, repeats, int(cold)))
        return least if least > 0 and self.agrees(qp) else np.nan

    def time_condensing(self, qp: StageQP) -> float:
        """Minimum time (us) of full condensing alone."""
        write_qp(self.memory, qp)
        self.library.time_condensing.restype = ctypes.c_double
        return float(self.library.time_condensing(self._pointer(self.memory), REPEATS))


def our_times(timed: Timed, recorded: Recorded, *, cold: bool, repeats: int = REPEATS) -> Array:
    """Times (us) of the QPs of that kind, minimum over the repeats."""
    found = []
    for i in recorded.cold if cold else recorded.warm:
        if not cold:
            timed.solve(recorded.qps[i - 1])
        found.append(timed.time(recorded.qps[i], cold=cold, repeats=repeats))
    return np.array(found)


# The others -----------------------------------------------------------------------------------------------------------


#: Options that help a plugin on these QPs with few active bounds, and would be harmful in general.
TUNED: dict[str, dict[str, Any]] = {"qpoases": {"initialStatusBounds": "inactive"}}


@dataclass(frozen=True, eq=False)
class Contender:
    """A plugin on one form of the QP; ``extra`` (us): condensing, which a dense solver needs and CasADi omits."""

    plugin: str
    form: str
    extra: float = 0.0

    def __str__(self) -> str:
        return self.plugin if self.form == "stages" else f"{self.plugin} ({self.form})"

    @property
    def dense(self) -> bool:
        return self.form == "condensed"

    def solver(self, forms: Sequence[Formulation]) -> Plugin:
        """A solver for these QPs."""
        return Plugin(self.plugin, forms, dense=self.dense, **TUNED.get(self.plugin, {}))

    def formulate(self, qp: StageQP) -> Formulation:
        """The QP in the form for this plugin."""
        return condensed_form(qp) if self.dense else without_start(stage_form(qp), qp)

    def point(self, qp: StageQP, w: Array) -> Point:
        """Its solution as steps; the states of the condensed form are not compared."""
        assert qp.optimum is not None
        if self.dense:
            return dataclasses.replace(qp.optimum, du=w.reshape(qp.optimum.du.shape))
        return point_of(qp, np.append(qp.dx0, w))


def contenders(condensing: float) -> list[Contender]:
    """All plugins on the stages; the dense ones also on the condensed QP."""
    return [Contender(p, "stages") for p in PLUGINS] + [Contender(p, "condensed", condensing) for p in DENSE]


def plugin_times(one: Contender, recorded: Recorded, *, cold: bool, budget: float = 1e6) -> Array:
    """Times (us) by CasADi's clock, minimum over the repeats; as many QPs as fit into the budget (us), at least one.

    Cold: a new solver for every solve, because some keep their working set. NaN: failed, or another answer.
    """
    chosen = recorded.cold if cold else recorded.warm
    spent, times = 0.0, []
    for i in chosen:
        if times and spent > budget * len(times) / len(chosen):
            break
        before, form = one.formulate(recorded.qps[i - 1]), one.formulate(recorded.qps[i])
        solver, best = one.solver([before, form]), np.nan
        for repeat in range(REPEATS):
            if cold and repeat:
                solver = one.solver([before, form])
            if not cold:
                solver.solve(before, warm=repeat > 0)
                spent += solver.time
            ok, w = solver.solve(form, warm=not cold)
            spent += solver.time
            if ok and distance(recorded.qps[i], one.point(recorded.qps[i], w)) < NEAR:
                best = np.fmin(best, solver.time)
            late = spent > budget * (len(times) + 1) / len(chosen)
            if not ok or solver.time > SLOW or (late and repeat >= 2):
                break
        times.append(best + one.extra)
    return np.array(times)


def median(times: Sequence[float] | Array) -> float:
    """Median; NaN if one of the values is, or if there are none."""
    return float(np.median(times)) if len(times) else np.nan
