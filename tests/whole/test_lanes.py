"""Targets that evaluate several shooting nodes at once: results of portable C, this machine, other machines."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from conftest import require_target, require_tool

from examples import chain, crane, cstr
from nmpc_codegen import (
    OCP,
    RK4,
    AugmentedLagrangian,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    NoCondensing,
    Online,
    Options,
    RealTimeIteration,
    RiccatiActiveSet,
    build,
    export,
    generate,
    open_package,
)
from nmpc_codegen.lowering.dialect.c_expressions import words
from nmpc_codegen.lowering.lanes.nodes import ANGLES, REDUCTION, ROOTS, in_lanes
from nmpc_codegen.lowering.unit.read import MATH_IN_LANES, own_names
from nmpc_codegen.package.struct_layout import Precision
from nmpc_codegen.runtime.build import warnings_for
from nmpc_codegen.runtime.native import native, runs
from nmpc_codegen.targets import TARGETS
from tests.whole.in_lanes import LIMIT, errors
from verification.rendered import lowered
from verification.samples import IN_LANES, SAMPLES, wide
from verification.timed import TIMED, Sample

KNOWN = {sample.name: sample for sample in (*TIMED, *SAMPLES)}

#: All kinds of outputs, layouts of data, single precision, loops, maps, conditions, functions of math.h by lane.
CHOSEN = (
    *("timed cstr", "timed bioreactor", "chain3", "crane riccati single", "path dense", "everything looped"),
    *("discrete rows riccati", "functions dense", "functions riccati", "loop augmented"),
)


#: Of four and of eight lanes.
WIDE = ("x86-64-v3", "x86-64-v4")


def pair(ocp: OCP, options: Options | None, target: str, profile: str = "test") -> tuple[Controller, Controller]:
    """The controllers of portable C and of a target."""
    require_target(target)
    one, other = (build(ocp, replace(options or Options(), target=t), profile) for t in ("portable", target))
    return one, other


def known(name: str, target: str) -> tuple[Controller, Controller]:
    sample = KNOWN[name]
    return pair(sample.make(), sample.options, target)


@pytest.mark.few(2)
@pytest.mark.filterwarnings("ignore::nmpc_codegen.ProblemWarning")
@pytest.mark.parametrize("target", WIDE)
@pytest.mark.parametrize("name", CHOSEN)
def test_the_linearisation_is_that_of_portable_c(name: str, target: str) -> None:
    found = dict(errors(*known(name, target), np.random.default_rng(1)))
    assert found
    assert max(found.values()) <= LIMIT, found


@pytest.mark.few(1)
@pytest.mark.parametrize("steps", [2, 3, 5])
def test_products_of_several_steps(steps: int) -> None:
    """Loops of portable C become straight-line steps whose Jacobians are multiplied; 9 x 12 has tiles of all shapes."""
    options = Options(ExplicitRungeKutta(RK4, steps=steps, unroll="none"))
    one, other = pair(chain.build_ocp(3, N=11), options, "x86-64-v3")
    assert "lanes_chain" in other._package.files["chain3.c"]
    assert max(dict(errors(one, other, np.random.default_rng(2))).values()) <= LIMIT


@pytest.mark.few(2)
@pytest.mark.parametrize("layout", ["shared", "node"])
@pytest.mark.parametrize("intervals", [None, (0.1, 0.3, 0.1, *[0.7] * 9)], ids=["equal", "other"])
@pytest.mark.parametrize("algorithm", [RealTimeIteration, AugmentedLagrangian])
@pytest.mark.parametrize("target", WIDE)
def test_plans_are_resampled_as_in_portable_c(
    target: str,
    algorithm: type[RealTimeIteration | AugmentedLagrangian],
    intervals: Sequence[float] | None,
    layout: Any,
) -> None:
    """On grids of 11 and 12 intervals, of which some are integrated in more steps than others; by two sampling times,
    of which one ends in a node; parameters of all nodes and of each."""
    ocp = OCP("pendulum", intervals=intervals) if intervals else OCP("pendulum", T=3.0, N=11)
    q, w, u, m = ocp.state("q", initial=0.3), ocp.state("w"), ocp.control("u"), ocp.parameter("m", value=1.2)
    ocp.dynamics({q: w, w: -ca.sin(q) - 0.1 * w + u / m})
    ocp.least_squares(ca.vertcat(q, w, u), weight=[2.0, 0.5, 0.5])
    ocp.subject_to(-0.4, u, 0.4)
    for time in (0.04, 0.4):
        chosen = algorithm(shift="resample", sampling_time=time)
        options = Options(ExplicitRungeKutta(RK4, steps=2), algorithm=chosen, online=Online(parameter=layout))
        one, other = pair(ocp, options, target)
        assert "integrator_step_lanes" in other._package.files["pendulum.c"]
        for c in (one, other):
            c.solve([0.9, 0.2])
            c.shift()
        for name in ("x", "u", "lam"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_exact_hessians_without_multipliers_take_the_adjoint_sweep() -> None:
    """After reset() all multipliers are 0: both units compute them from node to node, and give the same control."""
    one, other = known("timed bioreactor", "x86-64-v4")
    x0 = np.array(one.x[0])
    np.testing.assert_allclose(one.step(x0), other.step(x0), rtol=1e-12)
    np.testing.assert_allclose(one.lam, other.lam, rtol=1e-9, atol=1e-9)


def test_more_controls_of_a_stage_than_lanes() -> None:
    one, other = pair(wide(), Options(condensing=NoCondensing(), qp=RiccatiActiveSet()), "x86-64-v3")
    x0 = np.array(one.x[0]) + 0.1
    for scale in (1.0, 3.0):
        np.testing.assert_allclose(other.step(scale * x0), one.step(scale * x0), rtol=1e-9)
    assert one.status == other.status == 0


@pytest.mark.few(1)
@pytest.mark.parametrize("target", WIDE)
def test_closed_loops_agree(target: str) -> None:
    pairs = pair(cstr.build_ocp(), None, target, "fast")
    states = [np.array(pairs[0].x[0])] * 2
    for _ in range(40):
        controls = [c.step(x) for c, x in zip(pairs, states, strict=True)]
        assert pairs[0].status == pairs[1].status
        states = [c.integrate(x, u, cstr.SAMPLING) for c, x, u in zip(pairs, states, controls, strict=True)]
    np.testing.assert_allclose(states[0], states[1], rtol=1e-8)


@pytest.mark.few(1)
@pytest.mark.parametrize("target", [name for name, t in TARGETS.items() if t.defines])
def test_export_writes_what_build_compiles(target: str, tmp_path: Path) -> None:
    """The files of the folder are those of the controller, with the flags of the target in its build."""
    package = export(crane.build_ocp(), Options(target=target), tmp_path)
    assert "lanes_t" in (tmp_path / "crane.c").read_text()
    assert any(f"target: {target}" in choice for choice in package.report["choices"])
    flags = " ".join(TARGETS[target].flags)
    for name in ("CMakeLists.txt", "README.md"):
        assert flags in (tmp_path / name).read_text()
    require_target(target)
    built, opened = build(crane.build_ocp(), Options(target=target)), open_package(tmp_path)
    x0 = np.array([1.0, 0.0, 0.1, 0.0])
    np.testing.assert_array_equal(built.step(x0), opened.step(x0))
    assert built._package.fingerprint == opened._package.fingerprint


def test_a_cross_compiler_says_nothing_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmpc_codegen.runtime.native.macros_of", lambda *_: {"__GNUC__": "12", "__aarch64__": "1"})
    monkeypatch.setattr("nmpc_codegen.runtime.native.platform.machine", lambda: "x86_64")
    assert native().name == "portable"
    choices = generate(crane.build_ocp(), Options(target="native")).description.report.choices
    assert "target: portable; of this machine the compiler knows no vectors" in choices


def test_native_is_a_target_by_its_name() -> None:
    """What is generated for "native" is the text of the target of this machine, to the byte."""
    require_tool("cc")
    found = generate(crane.build_ocp(), Options(target="native"))
    assert found.description.target == native().name
    assert found == generate(crane.build_ocp(), Options(target=native().name))


@pytest.mark.parametrize(
    ("macros", "expected"),
    [
        ({"__GNUC__": "12", "__AVX2__": "1", "__FMA__": "1", "__BMI2__": "1"}, "x86-64-v3"),
        ({"__clang__": "1", "__GNUC__": "4", "__aarch64__": "1"}, "aarch64"),
        ({"__GNUC__": "11", "__aarch64__": "1"}, "portable"),
        ({"__GNUC__": "12", "__AVX2__": "1"}, "portable"),
        ({}, "portable"),
    ],
)
def test_native_follows_the_compiler(macros: dict[str, str], expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    require_tool("cc")
    monkeypatch.setattr("nmpc_codegen.runtime.native.macros_of", lambda *_: macros)
    machine = "aarch64" if "__aarch64__" in macros else "x86_64"
    monkeypatch.setattr("nmpc_codegen.runtime.native.platform.machine", lambda: machine)
    assert native().name == expected


@pytest.mark.few(1)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_another_machine_is_an_error_of_the_compiler(compiler: str, tmp_path: Path) -> None:
    """Flags that the target does not have, or those of another machine."""
    program = require_tool(compiler)
    for target in ("x86-64-v3", "x86-64-v4", "aarch64"):
        export(crane.build_ocp(), Options(target=target), tmp_path / target)
        command = [program, "-c", "crane.c", "-o", "crane.o"]
        done = subprocess.run(command, cwd=tmp_path / target, capture_output=True, text=True, check=False)
        if target != "aarch64" or not runs(TARGETS[target]):
            assert done.returncode != 0
            assert f"crane is written for {target}" in done.stderr


@pytest.mark.few(2)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("sample", IN_LANES, ids=lambda sample: sample.name)
def test_no_warning(sample: Sample, compiler: str, tmp_path: Path) -> None:
    """That of aarch64 on a machine of that family only; see test_other_processors.py."""
    program, target = require_tool(compiler), TARGETS[sample.options.target]
    if target.name == "aarch64" and not runs(target):
        pytest.skip("another family of processors")
    for path, text in generate(sample.make(), sample.options, "package").items():
        (tmp_path / path).write_text(text)
    command = [program, "-O1", *target.flags, *warnings_for(target), "-c", "package.c", "-o", "package.o"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", sorted({*own_names(MATH_IN_LANES), "sqrt"}))
def test_functions_in_lanes_state_what_they_need(name: str) -> None:
    """The tables by which lowering chooses parts, against the text of the functions."""
    module = lowered(SAMPLES[0])
    found = words(in_lanes([name], module.sizes, module.style))
    assert (REDUCTION in found) == (name in ANGLES)
    assert ("lanes_sqrt" in found or name == "sqrt") == (name in ROOTS)


def test_few_intervals_take_fewer_lanes() -> None:
    """N = 1 has one node: its linearisation is that of portable C."""
    sample = KNOWN["single dense"]
    text = generate(sample.make(), replace(sample.options, target="x86-64-v4"), name="one")["one.c"]
    assert "lanes_t" not in text
    text = generate(KNOWN["bare dense"].make(), Options(hessian=ExactHessian(), target="x86-64-v4"), name="bare")[
        "bare.c"
    ]
    assert "vector_size(VECTOR_LANES" in text
    assert "#define VECTOR_LANES 4" in text


def linear(nx: int, nu: int) -> OCP:
    """A random stable map with a quadratic cost."""
    random = np.random.default_rng([nx, nu])
    ocp = OCP("linear", N=9)
    x, u = ocp.state("x", size=nx, initial=random.uniform(-1, 1, nx)), ocp.control("u", size=nu)
    A = random.uniform(-1, 1, (nx, nx))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B = random.uniform(-1, 1, (nx, nu))
    ocp.dynamics({"x": ca.mtimes(ca.DM(A), x) + ca.mtimes(ca.DM(B), u)}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(nx + nu))
    ocp.terminal_least_squares(x, weight=random.uniform(1, 2, nx))
    ocp.subject_to(-0.2, u, 0.2)
    return ocp


SHAPES = [(1, 1), (2, 3), (3, 1), (5, 2), (8, 4), (9, 3), (13, 5), (17, 1)]


@pytest.mark.few(2)
@pytest.mark.parametrize("target", WIDE)
@pytest.mark.parametrize(
    ("nx", "nu", "precision"), [*((*shape, "double") for shape in SHAPES), (2, 3, "single"), (9, 3, "single")]
)
def test_riccati_products_in_tiles(nx: int, nu: int, precision: Precision, target: str) -> None:
    """Sizes with tiles of all shapes and rests: factors, and controls at their bounds, are those of portable C."""
    options = Options(condensing=NoCondensing(), qp=RiccatiActiveSet(), precision=precision)
    tolerance = 1e-11 if precision == "double" else 2e-3
    one, other = pair(linear(nx, nu), options, target)
    x0 = np.array(one.x[0])
    expected = [one.step(scale * x0) for scale in (1.0, 3.0, 0.1)]
    assert one.status == 0
    size = np.abs(one.view("riccati.P")[:, :nx, :nx]).max()
    found = [other.step(scale * x0) for scale in (1.0, 3.0, 0.1)]
    np.testing.assert_allclose(found, expected, atol=tolerance)
    factors = (np.tril(c.view("riccati.P")[:, :nx, :nx]) for c in (other, one))
    np.testing.assert_allclose(*factors, atol=tolerance * size, err_msg="P")
    factors = (c.view("riccati.K")[:, :nu, :nx] for c in (other, one))
    np.testing.assert_allclose(*factors, atol=tolerance * size, err_msg="K")
