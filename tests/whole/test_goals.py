"""Options(goal, target): forms of the same algorithm. What differs is code and memory, not the controls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool

from examples import cart_pole, chain, crane, quadrotor
from nmpc_codegen import (
    OCP,
    AugmentedLagrangian,
    DenseActiveSet,
    Discrete,
    ExplicitRungeKutta,
    FullCondensing,
    Options,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    Status,
    build,
    generate,
)
from nmpc_codegen.errors import OptionError
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.runtime.controller import Controller
from verification.routes import PURE

DENSE = Options(qp=DenseActiveSet(), condensing=FullCondensing(), algorithm=PURE)
CASES: dict[str, tuple[Callable[[], OCP], Options]] = {
    "dense": (crane.build_ocp, DENSE),
    "stages": (cart_pole.build_ocp, Options(qp=RiccatiActiveSet())),
    "interior point": (cart_pole.build_ocp, Options(qp=RiccatiInteriorPoint())),
    "odd sizes": (lambda: chain.build_ocp(3), Options(solve=False)),
    "even sizes": (quadrotor.build_ocp, Options(solve=False)),
    "augmented Lagrangian": (cart_pole.build_ocp, Options(algorithm=AugmentedLagrangian())),
}
SAMPLES = 15


@pytest.fixture(autouse=True)
def _compiler() -> None:
    require_tool("cc")


def made(name: str, **more: Any) -> Controller:
    """Without contraction of products and sums, so that every form rounds alike."""
    make, options = CASES[name]
    options = replace(options, algorithm=replace(options.algorithm, iterations=1))  # a small one has no second Hessian
    return build(make(), replace(options, **more), profile="test")


def loop(controller: Controller) -> np.ndarray:
    """Controls of a closed loop that begins away from its set point."""
    x, dt = controller.description.x_initial, controller.description.dt[0]
    if controller.description.name != "crane":  # its terminal state is just within reach
        x = x + 0.05 * np.cos(np.arange(len(x)))
    controls = []
    for _ in range(SAMPLES):
        u = controller.step(x).copy()
        assert controller.status == Status.OK
        x = controller.integrate(x, u, dt)
        controls.append(u)
    return np.array(controls)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", CASES)
def test_sums_in_variables_have_the_same_bits(name: str) -> None:
    expected, found = loop(made(name)), loop(made(name, target="cortex-m7", math="libm"))
    assert np.ptp(expected) > 1e-3
    np.testing.assert_array_equal(expected, found)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", CASES)
def test_a_small_controller_computes_the_same_controls(name: str) -> None:
    fast, small = made(name), made(name, goal="size")
    expected, found = loop(fast), loop(small)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
    assert small.nbytes <= fast.nbytes


@pytest.mark.parametrize(("horizon", "qp"), [(3, "dense_active_set"), (40, "riccati_interior_point")])
def test_a_small_package_has_the_qp_method_of_the_fewest_bytes(horizon: int, qp: str) -> None:
    """One method alone; a given one stays."""

    def described(**more: Any) -> PackageDescription:
        ocp = OCP("one", T=float(horizon), N=horizon)
        x, u = ocp.state("x", initial=0.5), ocp.control("u")
        ocp.dynamics({x: u - 0.1 * x**2})
        ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
        ocp.subject_to(-1, u, 1)
        ocp.subject_to(0, x, 1)
        return generate(ocp, Options(precision="single", solve=False, **more)).description

    small = described(goal="size")
    chosen = next(choice for choice in small.report.choices if "fewest bytes" in choice)
    assert f"qp: {qp};" in chosen
    assert chosen.count("riccati_active_set") == 0
    assert small.report.ram_bytes < described().report.ram_bytes or horizon == 3
    assert described(goal="size", qp=RiccatiActiveSet()).options["qp"] == "RiccatiActiveSet"


@pytest.mark.parametrize("name", ["stages", "odd sizes"])
def test_matrices_of_stages_have_no_padding(name: str) -> None:
    fast, small = (PackageDescription.from_json(text(name, goal)) for goal in ("speed", "size"))
    assert (fast.sizes["LDX"], fast.sizes["LDU"]) == (-(-fast.dims.nx // 4) * 4, -(-fast.dims.nu // 4) * 4)
    assert (small.sizes["LDX"], small.sizes["LDU"]) == (small.dims.nx, small.dims.nu)
    assert small.report.ram_bytes < 0.9 * fast.report.ram_bytes


def text(name: str, goal: Any) -> str:
    make, options = CASES[name]
    return generate(make(), replace(options, goal=goal), name="package")["package.json"]


def test_loops_are_chosen_only_where_the_options_leave_it_open() -> None:
    choices = PackageDescription.from_json(text("dense", "size")).report.choices
    assert any("unroll='none'" in choice and "goal: size" in choice for choice in choices)
    given = replace(CASES["dense"][1], integrator=ExplicitRungeKutta(unroll="all"), goal="size")
    options = PackageDescription.from_json(generate(crane.build_ocp(), given)["crane.json"]).options
    assert options["integrator.unroll"] == "all"
    assert ExplicitRungeKutta(unroll="all").small == ExplicitRungeKutta(unroll="all")
    assert Discrete().small == Discrete()


def test_what_is_no_goal() -> None:
    with pytest.raises(OptionError, match="goal"):
        Options(goal="small")  # type: ignore[arg-type]


def test_a_small_package_has_one_lane() -> None:
    """The goal "size" takes lanes and tiles from a target, and leaves its flags."""
    text = generate(crane.build_ocp(), Options(goal="size", target="x86-64-v3"))
    assert "lanes_t" not in text["crane.c"]
    assert "-march=x86-64-v3" in text["CMakeLists.txt"]
