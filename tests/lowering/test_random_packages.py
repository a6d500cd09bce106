"""Exported C of random problems, options and names compiles without a warning."""

from __future__ import annotations

import pytest
from conftest import require_tool

from nmpc_codegen import OCP, RK4, ExactHessian, ExplicitRungeKutta, Options, build
from tests.lowering.random_problems import Draw, draw
from verification import quality

LEVELS = ("-O2", "-Os", "-O3", "-O1")


def check(found: Draw, levels: tuple[str, ...]) -> None:
    """gcc's optimiser, and the front ends of all compilers as C99 and C++17."""
    assert quality.warnings_of(found.sources, levels, ("C99",), "gcc") == "", found
    assert quality.warnings_of(found.sources, ("-fsyntax-only",), ("C++17",), "gcc") == "", found
    assert quality.warnings_of(found.sources, ("-fsyntax-only",), ("C99", "C++17"), "clang") == "", found


@pytest.mark.few(3)
@pytest.mark.parametrize("number", range(30))
def test_some_packages(number: int) -> None:
    for tool in ("gcc", "g++", "clang"):
        require_tool(tool)
    check(draw(number), (LEVELS[number % 4],))


@pytest.mark.slow
@pytest.mark.parametrize("hundred", range(4))
def test_400_packages(hundred: int) -> None:
    """Most of the findings need the optimiser, whose levels find different ones."""
    for tool in ("gcc", "g++", "clang"):
        require_tool(tool)
    for number in range(100 * hundred, 100 * (hundred + 1)):
        check(draw(number), ("-O2", LEVELS[1 + number % 3]))


@pytest.mark.slow
def test_draws_differ_and_repeat() -> None:
    """A number stands for one package; together they have every algorithm, number of states and kind of row."""
    draws = [draw(number) for number in range(40)]
    assert draws[3].sources == draw(3).sources
    assert {d.options.algorithm.name for d in draws} == {
        "real_time_iteration",
        "augmented_lagrangian",
        "adjoint_shooting",
    }
    assert len({d.name for d in draws}) > 20
    headers = [d.sources[f"{d.name}.h"] for d in draws]
    for size in ("NX 1 ", "NX 3 ", "NU 1 ", "N 1 ", "NR 0 ", "NR 1 ", "NY 0 ", "NY_N 0 ", "NP 0 ", "NH_N 1 "):
        assert any(f"_{size}" in header for header in headers), size


def test_leaves_of_a_looped_sweep_have_names_of_their_own() -> None:
    """A state on which the integrated cost depends linearly: its slope in closed form is not the slope of stage 0."""
    controls = []
    for unroll in ("none", "all"):
        ocp = OCP("linear", T=1.0, N=4)
        x, v, u = ocp.state("x", initial=1.0), ocp.state("v", initial=0.5), ocp.control("u")
        ocp.dynamics({x: v**2 + u, v: -(v**3) + u})
        ocp.stage_cost(x + v**2 + u**2, integrate=True)
        ocp.subject_to(-1, u, 1)
        options = Options(integrator=ExplicitRungeKutta(RK4, steps=2, unroll=unroll), hessian=ExactHessian())
        controller = build(ocp, options, profile="test")
        controls.append([float(controller.step([1.0, 0.5])[0]) for _ in range(4)])
    assert controls[0] == pytest.approx(controls[1], rel=1e-12)
    assert -1 < controls[0][-1] < 0
