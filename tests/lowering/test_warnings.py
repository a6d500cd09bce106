"""The generated C has no warnings with gcc and clang, as C99 and as C++17, for all combinations.

Every pair of a structure, a QP solver, a precision, a shift, a Hessian and a storage of data is in a combination.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool

from benchmarks.lib import quality
from benchmarks.lib.combinations import ROUTES, Combination, combinations, shift
from benchmarks.lib.doors import doors_warnings
from benchmarks.lib.report import Report
from nmpc_codegen import (
    OCP,
    ExactHessian,
    ForwardOverAdjoint,
    GaussNewton,
    IdentityHessian,
    Mirror,
    Online,
    Options,
    generate,
)
from nmpc_codegen.lowering.render import Sources


def pendulum(name: str, N: int = 5) -> tuple[OCP, Any, Any, Any]:
    """(ocp, angle, rate, torque) of a pendulum without rows."""
    ocp = OCP(name, T=0.2 * N, N=N)
    q, w, u = ocp.state("q", initial=0.5), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) + u})
    ocp.least_squares(ca.vertcat(q, w, u), weight=[1.0, 0.1, 0.05])
    return ocp, q, w, u


def soft_without_terminal_rows() -> OCP:
    """A soft general row with a control, thus none at the last node."""
    ocp, q, w, u = pendulum("soft_path")
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-2, q * w + u, 2, soft=(10, 0), name="row")
    return ocp


def soft_at_the_end() -> OCP:
    """Soft rows, quadratic ones too, at nodes and at the end, besides a hard one; a dense weight."""
    ocp, q, w, u = pendulum("soft_end")
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[[8.0, 1.0], [1.0, 2.0]])
    ocp.subject_to(-0.2, w, np.inf, soft=(0.3, 0.2))
    ocp.subject_to(-1, q * w, 1, at="end", soft=(0.3, 0.0), name="gate")
    ocp.subject_to(-9, u * u, 9, name="effort")
    return ocp


def soft_bounds_only() -> OCP:
    """A soft state bound and no general row at all."""
    ocp, _, w, _ = pendulum("soft_bound", 3)
    ocp.subject_to(-0.2, w, np.inf, soft=(0.3, 0.0))
    return ocp


def coupled() -> OCP:
    """A free state, a cyclic one, a curved coupled row, a soft one; an integrated cost, an accumulator; parameters."""
    ocp = OCP("coupled", T=0.8, N=4)
    q, w, e, u = ocp.state("q", initial=0.5), ocp.state("w"), ocp.state("e"), ocp.control("u")
    m = ocp.parameter("m", size=2, value=[1.0, 2.0])
    ocp.dynamics({q: w, w: -ca.sin(q) + u, e: u**2})
    ocp.accumulator(e)
    ocp.subject_to(-np.inf, e, 3, at="end")
    ocp.stage_cost(m[0] * u**2 + m[1] * q**2 * w**2, integrate=True)
    ocp.free_initial(q)
    ocp.cyclic(q)
    ocp.boundary(-5, ocp.at_start(w) ** 3 + ocp.at_end(q) ** 2, 5, name="loop")
    ocp.boundary(-5, ocp.at_start(q) - ocp.at_end(w), 5, soft=(2.0, 0.0), name="near")
    return ocp


def convex_rows() -> OCP:
    """Curved rows on the path and at the end."""
    ocp, q, w, u = pendulum("convex")
    ocp.subject_to(-np.inf, q * q + u * u, 4, name="disc")
    ocp.subject_to(-np.inf, q * q + w * w, 4, at="end", name="ball")
    return ocp


def tiny() -> OCP:
    """nx = nu = N = 1, np = 0, linear dynamics, no rows."""
    ocp = OCP("tiny", T=0.5, N=1)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    return ocp


def discrete() -> OCP:
    """A map with two controls and a parameter; bounds."""
    ocp = OCP("map", N=4)
    x, u, p = ocp.state("x", size=2), ocp.control("u", size=2), ocp.parameter("p", value=0.8)
    ocp.dynamics(ca.vertcat(x[0] + 0.5 * x[1] ** 2 + p * u[0], 0.84 * x[1] - x[0] * ca.exp(u[1])), discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(4))
    ocp.subject_to(-0.2, u, 0.2)
    return ocp


STRUCTURES: tuple[Callable[[], OCP], ...] = (
    *(soft_without_terminal_rows, soft_at_the_end, soft_bounds_only, coupled),
    *(convex_rows, tiny, discrete),
)
SOFT = (soft_without_terminal_rows, soft_at_the_end, soft_bounds_only, coupled)
HESSIANS = {
    "gauss_newton": GaussNewton(),
    "convex_rows": GaussNewton(convex_rows=True, levenberg_marquardt=0.1),
    "identity": IdentityHessian(),
    "exact": ExactHessian(),
    "stage": ExactHessian(Mirror(level="stage"), ForwardOverAdjoint(), levenberg_marquardt=0.1),
    "unregularized": ExactHessian(None),
}
LAYOUTS = {
    "default": Online(),
    "fixed": Online("fixed", "fixed", "fixed", "fixed"),
    "shared": Online("shared", "shared", "shared", "shared", dense_weight=True),
    "node": Online("node", "node", "node", "node"),
}
SHIFTS = (None, "repeat", "periodic", "resample")

Choice = tuple[Callable[[], OCP], str, str, str | None, str, str]


def sources(choice: Choice) -> Sources:
    """The package of a combination. Raises OptionError if there is none."""
    make, route, precision, moves, hessian, layout = choice
    condensing, qp = ROUTES[route]
    options = Options(
        hessian=HESSIANS[hessian],
        condensing=condensing,
        qp=qp,
        algorithm=shift(moves, 0.05),
        online=LAYOUTS[layout],
        precision=precision,
    )
    return generate(make(), options)


def is_allowed(choice: Choice) -> bool:
    """No component refuses the combination."""
    make, route, precision, moves, hessian, _ = choice
    return not (
        (make is coupled and hessian in ("gauss_newton", "convex_rows"))
        or (route == "full + osqp" and (make in SOFT or precision == "single"))
        or (make is discrete and moves == "resample")
    )


def pairwise() -> list[Choice]:
    """Combinations that contain every allowed pair of values, each chosen for the largest number of missing pairs."""
    values = (STRUCTURES, tuple(ROUTES), ("double", "single"), SHIFTS, tuple(HESSIANS), tuple(LAYOUTS))
    every = [choice for choice in itertools.product(*values) if is_allowed(choice)]
    bits: dict[Any, int] = {}
    pairs = [sum(1 << bits.setdefault(p, len(bits)) for p in itertools.combinations(enumerate(c), 2)) for c in every]
    missing, chosen = (1 << len(bits)) - 1, []
    while missing:
        found = [(pair & missing).bit_count() for pair in pairs]
        best = found.index(max(found))
        chosen.append(every[best])
        missing &= ~pairs[best]
    return chosen


def label(choice: Choice) -> str:
    """Name of a test."""
    return "-".join(word.__name__ if callable(word) else str(word).replace(" ", "") for word in choice)


CHOICES = pairwise()


def covering(choices: list[Choice]) -> list[Choice]:
    """Combinations in double precision with a structure, solvers, a Hessian or a storage not used by earlier ones."""
    seen: set[Any] = set()
    found = []
    for choice in choices:
        values = {choice[0], choice[1], choice[4], choice[5]}
        if choice[2] == "double" and not values <= seen:
            found.append(choice)
            seen |= values
    return found


@pytest.mark.parametrize(("number", "choice"), list(enumerate(CHOICES)), ids=list(map(label, CHOICES)))
def test_combination(number: int, choice: Choice) -> None:
    """All findings of the front ends, which take turns; clang's include unused functions.

    benchmarks.doors asks both compilers, as C99 and as C++17, for all combinations of the examples.
    """
    text = sources(choice)
    compiler = ("gcc", "clang")[number % 2]
    require_tool(compiler)
    assert quality.warnings_of(text, ("-fsyntax-only",), ("C99",), compiler) == ""
    if "single" in choice and number % 2 == 0:
        require_tool("g++")
        assert quality.warnings_of(text, ("-fsyntax-only",), ("C++17",), "gcc") == ""


@pytest.mark.parametrize(
    ("number", "choice"), list(enumerate(covering(CHOICES))), ids=list(map(label, covering(CHOICES)))
)
def test_every_value_with_the_optimiser(number: int, choice: Choice) -> None:
    """gcc's optimiser finds values that may be uninitialised (benchmarks.doors: in all combinations).

    As C++17 the compilers take turns.

    In single precision the data flow is the same as in double precision.
    """
    text = sources(choice)
    require_tool("gcc")
    assert quality.warnings_of(text, ("-O1",), ("C99",), "gcc") == ""
    compiler = ("gcc", "clang")[number % 2]
    require_tool({"gcc": "g++", "clang": "clang"}[compiler])
    assert quality.warnings_of(text, ("-fsyntax-only",), ("C++17",), compiler) == ""


def test_covering_has_every_value() -> None:
    for index, values in ((0, STRUCTURES), (1, tuple(ROUTES)), (4, tuple(HESSIANS)), (5, tuple(LAYOUTS))):
        assert {choice[index] for choice in covering(CHOICES)} == set(values)
        single = {choice[index] for choice in CHOICES if "single" in choice}
        assert set(values) - single <= {"full + osqp"}  # which has no single precision


@pytest.mark.parametrize("compiler", list(quality.COMPILERS))
def test_most_optimised(compiler: str) -> None:
    require_tool(compiler)
    assert quality.warnings_of(generate(tiny()), ("-O3",), ("C99",), compiler) == ""


def test_soft_rows_without_terminal_rows() -> None:
    """The rows of the last node are those of its states, so that no value of a general row may be read there."""
    text = generate(soft_without_terminal_rows())
    assert "#define SOFT_PATH_NH_N 0 " in text["soft_path.h"]
    assert "h_N" not in text["soft_path.c"]


def test_uninitialised_values_are_seen() -> None:
    """Found by gcc only, with its optimiser."""
    require_tool("gcc")
    text = generate(tiny())
    text["tiny.c"] += "int tiny_late(int n);\nint tiny_late(int n)\n{\n    int found;\n    if (n > 3) {\n"
    text["tiny.c"] += "        found = n;\n    }\n    return found;\n}\n"
    assert quality.warnings_of(text, ("-O0",), ("C99",), "gcc") == ""
    assert "-Wmaybe-uninitialized" in quality.warnings_of(text, ("-O1",), ("C99",), "gcc")


@pytest.mark.parametrize("compiler", list(quality.COMPILERS))
def test_unused_functions_are_seen(compiler: str) -> None:
    """Found by gcc when it compiles; by the front end of clang also for functions declared inline."""
    require_tool(compiler)
    level = {"gcc": "-O0", "clang": "-fsyntax-only"}[compiler]
    text = generate(tiny())
    text["tiny.c"] += "static int spare(void)\n{\n    return 1;\n}\n"
    text["tiny.c"] += "static inline int spare_inline(void)\n{\n    return 1;\n}\n"
    found = quality.warnings_of(text, (level,), ("C99",), compiler)
    assert "spare" in found
    assert ("spare_inline" in found) == (compiler == "clang")


class Spoiled(Combination):
    """A package with a function that is never called."""

    def generate(self) -> Sources:
        text = super().generate()
        text["crane.c"] += "static int spare(void)\n{\n    return 1;\n}\n"
        return text


def test_benchmark_counts() -> None:
    """Warnings by compiler, without refused combinations: OSQP has no single precision."""
    require_tool("gcc")
    require_tool("clang")
    report = Report("warnings")
    words = ("none + riccati_interior_point", "single", "repeat")
    refused = Combination("crane", "full + osqp", "single", None)
    doors_warnings.measure(report, [Combination("crane", *words), Spoiled("crane", *words), refused])
    found = {(r.key, r.case): (r.value, r.n, r.limit) for r in report.records}
    assert found == {
        ("warnings_all_combinations", "gcc"): (1, 2, 0),
        ("warnings_all_combinations", "clang"): (1, 2, 0),
        ("warning_combinations", ""): (2, 2, None),
        ("warning_combinations_refused", ""): (1, 3, None),
    }
    assert len(list(combinations())) == 288
