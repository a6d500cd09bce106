"""Golden files: the text of every section, byte by byte. ``pytest --update-golden`` writes them anew.

All but one come from a hand-written Linearization, so that they change with the printer and the templates only; the
lifted one also changes with CasADi and is compared under the version that wrote it.
"""

from __future__ import annotations

import functools
from fractions import Fraction
from pathlib import Path

import casadi as ca
import pytest

from nmpc_codegen import OCP, ExactHessian, ExplicitRungeKutta, Options
from nmpc_codegen.components.base import SEAMS
from nmpc_codegen.components.integrators import TABLEAUS, ButcherTableau, Discrete
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir import stage_products as products
from nmpc_codegen.ir.kernel import Instruction, Kernel, Port
from nmpc_codegen.ir.print_c import CStyle
from nmpc_codegen.ir.sweep import print_routine
from nmpc_codegen.lowering.linearize import Linearization, linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import Sources, context, environment, render
from nmpc_codegen.options import REGISTRIES
from tests.models import problem_of
from tests.test_sweep import SWEEP, looped

GOLDEN = Path(__file__).with_name("golden")
PINNED_CASADI = "3.8.2"

COMPONENTS = [cls for seam in SEAMS for cls in REGISTRIES[seam].values()]

X, U, P = Port("x", 1), Port("u", 1), Port("p", 1)
DT, H, YREF, YREF_N = Port("dt", 1), Port("h", 1), Port("yref", 2), Port("yref", 1)
W, W_N = Port("W", 2, doc="diagonal of the weight"), Port("W", 1, doc="diagonal of the weight")
NEXT, S = Port("x_next", 1), Port("S", 1, 2)


def stated(discrete: bool) -> Problem:
    """x+ = x + dt (u - p x) or its rate; one control bound, one state bound, one path row, one terminal row."""
    grid = {"N": 2} if discrete else {"T": 1.0, "N": 2}
    ocp = OCP("golden", **grid)  # type: ignore[arg-type]
    x, u, p = ocp.state("x", initial=1.0), ocp.control("u"), ocp.parameter("p", value=0.5)
    ocp.dynamics({x: u - p * x}, discrete=discrete)
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


def cost(stage: str) -> tuple[Kernel, ...]:
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


def exact() -> tuple[Kernel, ...]:
    """x_next, S, g and Q of the node at once; the coupled rows, of which there are none, add nothing."""
    data = (X, U, P, DT, YREF, W, Port("mu", 1), Port("lam", 1))
    k = Program("path_exact", "Q = W + d2 (mu' h)", data, (NEXT, S, Port("g", 2), Port("Q", 2, 2)))
    x, u, p, dt = k.load("x"), k.load("u"), k.load("p"), k.load("dt")
    rate = k.op(ca.OP_SUB, u, k.op(ca.OP_MUL, p, x))
    k.store("x_next", 0, k.op(ca.OP_ADD, x, k.op(ca.OP_MUL, dt, rate)))
    k.store("S", 0, k.op(ca.OP_SUB, k.constant(1.0), k.op(ca.OP_MUL, dt, p)))
    k.store("S", 1, dt)
    for i, z in enumerate((x, u)):
        weight = k.load("W", i)
        k.store("g", i, k.op(ca.OP_MUL, weight, k.op(ca.OP_SUB, z, k.load("yref", i))))
        k.store("Q", 3 * i, weight)
    k.store("Q", 2, k.load("mu"))
    first = Program("initial_hessian", "", (Port("x_0", 1), X, Port("eta", 0), Port("Q_0", 4)), (Port("Q", 2, 2),))
    ends = (X, P, YREF_N, W_N, Port("mu", 1), Port("x_0", 1), Port("eta", 0))
    last = Program("terminal_hessian", "Q = W + 2 mu", ends, (Port("Q", 1, 1),))
    last.store("Q", 0, last.op(ca.OP_ADD, last.load("W"), last.op(ca.OP_TWICE, last.load("mu"))))
    return k.kernel(), first.kernel(), last.kernel()


def handwritten(cls: type) -> Linearization:
    """The whole Linearization of stated(), with the component in its seam and defaults elsewhere."""
    discrete = cls is Discrete
    integrator = Discrete() if discrete else ExplicitRungeKutta(TABLEAUS["Euler"], 1)
    given = {"integrator": integrator, cls.seam: integrator if cls.seam == "integrator" else cls()}  # type: ignore[attr-defined]
    defaults = {seam: next(iter(REGISTRIES[seam].values()))() for seam in SEAMS}
    options = Options(**{**defaults, **given})
    routines = (*dynamics(), *cost("path"), *cost("terminal"), *rows())
    curved = options.hessian.name == "exact"
    if curved:
        routines = (*(r for r in routines if not r.name.endswith("_hessian")), *exact())
    return Linearization(stated(discrete), options, ("written by hand",), routines, not curved)


@functools.cache
def sources(cls: type) -> Sources:
    return render(lower(handwritten(cls)))


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


@pytest.mark.parametrize("cls", COMPONENTS, ids=lambda cls: cls.__name__)
def test_section_of_a_component(cls: type, check) -> None:  # type: ignore[no-untyped-def]
    title = f"{cls.seam}: {cls.name}"  # type: ignore[attr-defined]
    check(f"{cls.seam}_{cls.name}.c", section(sources(cls)["golden.c"], title))  # type: ignore[attr-defined]


def test_exact_hessian_on_stages(check) -> None:  # type: ignore[no-untyped-def]
    """The template that ExactHessian adds to the Riccati recursion."""
    check(
        "riccati_convexify.c", environment().get_template(ExactHessian().convexify).render(context("golden", "double"))
    )


def test_exact_hessian_on_the_condensed_qp(check) -> None:  # type: ignore[no-untyped-def]
    """The template that ExactHessian adds to full condensing."""
    template = environment().get_template(ExactHessian().regularize)
    check("regularize_reduced.c", template.render(context("golden", "double")))


@pytest.mark.parametrize(("spelling", "limit"), [("nonzeros", 10**9), ("loops", -1)])
def test_products(spelling: str, limit: int, check, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(products, "WRITTEN_OUT", limit)
    text = render(lower(handwritten(ExplicitRungeKutta)))["golden.c"]
    check(f"products_{spelling}.c", section(text, "stage products"))


def test_header(check) -> None:  # type: ignore[no-untyped-def]
    check("header.h", sources(ExplicitRungeKutta)["golden.h"])


def test_head_of_the_source(check) -> None:  # type: ignore[no-untyped-def]
    """Table of contents, tables, printed kernels, rows: everything before the first section."""
    text = sources(ExplicitRungeKutta)["golden.c"]
    check("head.c", text[: text.index("/* ==== stage products")])


def test_settings_and_results(check) -> None:  # type: ignore[no-untyped-def]
    check("api.c", section(sources(ExplicitRungeKutta)["golden.c"], "settings and results"))


def test_looped_routine(check) -> None:  # type: ignore[no-untyped-def]
    """A hand-written Sweep in single precision; its leaves are so small that every CasADi lifts them alike."""
    check("sweep.c", print_routine(looped(SWEEP), CStyle("real", True)) + "\n")


def test_lifted(check) -> None:  # type: ignore[no-untyped-def]
    """Ralston's method on the reactor, straight-line and looped: what CasADi derives and simplifies shows here."""
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
    wanted = {f"{cls.seam}_{cls.name}.c" for cls in COMPONENTS}  # type: ignore[attr-defined]
    wanted |= {
        "products_nonzeros.c",
        "products_loops.c",
        "riccati_convexify.c",
        "regularize_reduced.c",
        "header.h",
        "head.c",
        "api.c",
        "sweep.c",
        "lifted.c",
    }
    assert {path.name for path in GOLDEN.iterdir()} == wanted
