"""Golden files: printed text, compared byte for byte. ``pytest --update-golden`` rewrites them.

All but one come from a hand-written Model, so that they change only with the printer and the templates; the
lifted one also changes with CasADi and is compared under the version that wrote it.
"""

from __future__ import annotations

import functools
import re
from fractions import Fraction
from pathlib import Path

import casadi as ca
import pytest

from nmpc_codegen import OCP, ExplicitRungeKutta, Options
from nmpc_codegen.components.base import SEAMS, Parts
from nmpc_codegen.components.integrators import TABLEAUS, ButcherTableau
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Instruction, Kernel, Port
from nmpc_codegen.ir.model import Block, Interval, StageModel
from nmpc_codegen.ir.print_c import CStyle
from nmpc_codegen.ir.print_sweep import print_routine
from nmpc_codegen.ir.stage_products import pattern
from nmpc_codegen.lowering.linearize import Model, linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import Sources, render
from nmpc_codegen.options import REGISTRIES, Online
from tests.ir.test_sweep import SWEEP, looped
from tests.models import problem_of

GOLDEN = Path(__file__).parents[1] / "golden"
PINNED_CASADI = "3.8.2"

X, U, P = Port("x", 1), Port("u", 1), Port("p", 1)
DT, H, YREF, YREF_N = Port("dt", 1), Port("h", 1), Port("yref", 2), Port("yref", 1)
W, W_N = Port("W", 2, doc="diagonal of the weight"), Port("W", 1, doc="diagonal of the weight")
NEXT, S = Port("x_next", 1), Port("S", 1, 2)


def stated() -> Problem:
    """x' = u - p x; one control bound, one state bound, one path row, one terminal row."""
    ocp = OCP("golden", T=1.0, N=2)
    x, u, p = ocp.state("x", initial=1.0), ocp.control("u"), ocp.parameter("p", value=0.5)
    ocp.dynamics({x: u - p * x})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 2.0])
    ocp.terminal_least_squares(x, weight=[3.0])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-2, x, 2)
    ocp.subject_to(-3, x * u, 3, name="product")
    ocp.subject_to(-4, x * x, 4, at="end", name="square")
    return classify(ocp)


class Program:
    """Writes a Kernel by hand: values are numbers, outputs are stored by name."""

    def __init__(self, name: str, doc: str, inputs: tuple[Port, ...], outputs: tuple[Port, ...]) -> None:
        self.name, self.doc, self.inputs, self.outputs = name, doc, inputs, outputs
        self.instructions: list[Instruction] = []
        self.stores: list[tuple[int, int, int]] = []

    def load(self, port: str, element: int = 0) -> int:
        return self._add(ca.OP_INPUT, ([p.name for p in self.inputs].index(port), element))

    def constant(self, value: float) -> int:
        self.instructions.append(Instruction(ca.OP_CONST, (), value))
        return len(self.instructions) - 1

    def op(self, opcode: int, *args: int) -> int:
        return self._add(opcode, args)

    def store(self, port: str, element: int, value: int) -> None:
        self.stores.append(([p.name for p in self.outputs].index(port), element, value))

    def _add(self, opcode: int, args: tuple[int, ...]) -> int:
        self.instructions.append(Instruction(opcode, args))
        return len(self.instructions) - 1

    def kernel(self) -> Kernel:
        return Kernel(self.name, self.doc, self.inputs, self.outputs, tuple(self.instructions), tuple(self.stores))


def dynamics() -> tuple[Kernel, Kernel]:
    """x_next = x + dt (u - p x)."""
    kernels = []
    for name, step, outputs in (("integrator_interval", DT, (NEXT, S)), ("integrator_step", H, (NEXT,))):
        k = Program(name, "x_next = x + dt (u - p x)", (X, U, P, step), outputs)
        x, u, p, dt = k.load("x"), k.load("u"), k.load("p"), k.load(step.name)
        rate = k.op(ca.OP_SUB, u, k.op(ca.OP_MUL, p, x))
        k.store("x_next", 0, k.op(ca.OP_ADD, x, k.op(ca.OP_MUL, dt, rate)))
        if S in outputs:
            k.store("S", 0, k.op(ca.OP_SUB, k.constant(1.0), k.op(ca.OP_MUL, dt, p)))
            k.store("S", 1, dt)
        kernels.append(k.kernel())
    return kernels[0], kernels[1]


def cost(stage: str) -> tuple[Kernel, Kernel, Kernel]:
    """Cost, gradient and Hessian of a diagonal least-squares term in (x, u) or x."""
    path = stage == "path"
    inputs = (X, U, P, DT) if path else (X, P)
    yref, weight = (YREF, W) if path else (YREF_N, W_N)
    names = ("x", "u") if path else ("x",)
    value = Program(f"{stage}_cost", "l = 1/2 |y - yref|^2_W", (*inputs, yref, weight), (Port("l", 1),))
    slope = Program(f"{stage}_gradient", "g = W (y - yref)", (*inputs, yref, weight), (Port("g", len(names)),))
    block = Program(f"{stage}_hessian", "Q = W", (*inputs, weight), (Port("Q", len(names), len(names)),))
    total = -1
    for i, name in enumerate(names):
        for k in (value, slope):
            r = k.op(ca.OP_SUB, k.load(name), k.load("yref", i))
            weighted = k.op(ca.OP_MUL, k.load("W", i), r)
            if k is slope:
                k.store("g", i, weighted)
            else:
                term = k.op(ca.OP_MUL, weighted, r)
                total = term if total < 0 else k.op(ca.OP_ADD, total, term)
        block.store("Q", i * (len(names) + 1), block.load("W", i))
    value.store("l", 0, value.op(ca.OP_MUL, value.constant(0.5), total))
    return value.kernel(), slope.kernel(), block.kernel()


def rows() -> tuple[Kernel, Kernel]:
    """h = x u with J = (u, x); h_N = x^2 with J = 2 x."""
    path = Program("path_rows", "h = x u", (X, U, P), (Port("h", 1), Port("J", 1, 2)))
    x, u = path.load("x"), path.load("u")
    path.store("h", 0, path.op(ca.OP_MUL, x, u))
    path.store("J", 0, u)
    path.store("J", 1, x)
    end = Program("terminal_rows", "h = x^2", (X, P), (Port("h", 1), Port("J", 1, 1)))
    x = end.load("x")
    end.store("h", 0, end.op(ca.OP_SQ, x))
    end.store("J", 0, end.op(ca.OP_TWICE, x))
    return path.kernel(), end.kernel()


def handwritten() -> Model:
    """The whole Model of stated(), with the first component of every seam."""
    defaults = {seam: next(iter(REGISTRIES[seam].values()))() for seam in SEAMS}
    parts = Parts(**{**defaults, "integrator": ExplicitRungeKutta(TABLEAUS["Euler"], 1)})
    path, terminal = (
        StageModel(value, slope, row, Block(pattern(block, "Q"), block))
        for (value, slope, block), row in zip((cost("path"), cost("terminal")), rows(), strict=True)
    )
    nothing = (
        Program("start_cost", "l = 0", (X,), (Port("l", 1),)),
        Program("start_gradient", "g = 0", (X,), (Port("g", 1),)),
    )
    start = StageModel(*(program.kernel() for program in nothing))
    return Model(
        *(Interval(*dynamics()), start, path, terminal, None, None),
        problem=stated(),
        parts=parts,
        online=Online(),
        precision="double",
        math="libm",
        solve=True,
        reasons=("written by hand",),
        choice=None,
        constant_hessian=True,
    )


@functools.cache
def sources() -> Sources:
    return render(lower(handwritten()))


def section(text: str, title: str) -> str:
    """From the heading of a section to the next one."""
    start = text.index(f"/* ==== {title}")
    end = text.find("\n/* ==== ", start)
    return text[start : end if end > 0 else len(text)].rstrip() + "\n"


@pytest.fixture
def check(request: pytest.FixtureRequest):  # type: ignore[no-untyped-def]
    """Compare with a golden file, or write it."""

    def compare(name: str, text: str) -> None:
        path = GOLDEN / name
        if request.config.getoption("--update-golden"):
            GOLDEN.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        assert path.is_file(), f"{name} is missing: run pytest --update-golden"
        assert text == path.read_text(encoding="utf-8"), f"{name} differs: look, then run pytest --update-golden"

    return compare


def test_products(check) -> None:  # type: ignore[no-untyped-def]
    check("products.c", section(sources()["golden.c"], "stage products"))


STRUCTS = re.compile(r"^typedef struct \{.*?^\} \w+;$", re.M | re.S)


def test_header(check) -> None:  # type: ignore[no-untyped-def]
    check("header.h", STRUCTS.sub("", sources()["golden.h"]))


def test_layout_of_the_structs(check) -> None:  # type: ignore[no-untyped-def]
    check("structs.h", "\n\n".join(STRUCTS.findall(sources()["golden.h"])) + "\n")


def test_head_of_the_source(check) -> None:  # type: ignore[no-untyped-def]
    """Table of contents, short names, tables: everything before the first printed kernel."""
    text = sources()["golden.c"]
    check("head.c", text[: text.index("/* x_next = ")])


def test_settings_and_results(check) -> None:  # type: ignore[no-untyped-def]
    check("api.c", section(sources()["golden.c"], "settings and results"))


def test_looped_routine(check) -> None:  # type: ignore[no-untyped-def]
    """A hand-written Sweep in single precision; its leaves are so small that every CasADi version lifts them alike."""
    check("sweep.c", print_routine(looped(SWEEP), CStyle("real", True)) + "\n")


def test_lifted(check) -> None:  # type: ignore[no-untyped-def]
    """Ralston's method on the reactor, straight-line and looped, with the derivatives and simplifications of CasADi."""
    if ca.__version__ != PINNED_CASADI:
        pytest.skip(f"the golden file was written with CasADi {PINNED_CASADI}, this is {ca.__version__}")
    F = Fraction
    ralston = ButcherTableau("Ralston", ((F(0), F(0)), (F(2, 3), F(0))), (F(1, 4), F(3, 4)), 2)
    texts = []
    for unroll in ("all", "none"):
        options = Options(ExplicitRungeKutta(ralston, 2, unroll))  # type: ignore[arg-type]
        lin = linearize(classify(problem_of("reactor", uniform=False)), options)
        texts += [print_routine(r, CStyle("real", False)) for r in lin.routines if r.name == "integrator_interval"]
    check("lifted.c", "\n\n".join(texts) + "\n")


def test_no_golden_file_is_left_over() -> None:
    wanted = {"products.c", "header.h", "structs.h", "head.c", "api.c", "sweep.c", "lifted.c"}
    assert {path.name for path in GOLDEN.iterdir()} == wanted
