"""Units that evaluate several shooting nodes at once: the linearisation of exported C, their functions, their doors."""

from __future__ import annotations

import pickle
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool

from examples import chain, crane, cstr
from nmpc_codegen import (
    OCP,
    RK4,
    Controller,
    ExactHessian,
    ExplicitRungeKutta,
    NoCondensing,
    OptionError,
    Options,
    RiccatiActiveSet,
    build,
    export,
    generate,
    open_package,
)
from nmpc_codegen.host.unit import host_unit
from nmpc_codegen.runtime.build import host, load
from verification.c_harness import module_of
from verification.lanes import LIMIT, errors
from verification.samples import SAMPLES
from verification.timed import TIMED

KNOWN = {sample.name: sample for sample in (*TIMED, *SAMPLES)}

#: All kinds of outputs, layouts of data, single precision, loops, maps, conditions, functions of math.h by lane.
CHOSEN = (
    *("timed cstr", "timed bioreactor", "chain3", "crane riccati single", "path dense", "everything looped"),
    *("discrete rows partial", "functions dense", "functions riccati", "loop augmented"),
)


def pair(name: str, lanes: int) -> tuple[Controller, Controller]:
    sample = KNOWN[name]
    one, other = (build(sample.make(), sample.options, "test", lanes=n) for n in (1, lanes))
    return one, other


@pytest.mark.few(2)
@pytest.mark.filterwarnings("ignore::nmpc_codegen.ProblemWarning")
@pytest.mark.parametrize("lanes", [2, 8])
@pytest.mark.parametrize("name", CHOSEN)
def test_the_linearisation_is_that_of_exported_c(name: str, lanes: int) -> None:
    require_tool("cc")
    found = dict(errors(*pair(name, lanes), np.random.default_rng(1)))
    assert found
    assert max(found.values()) <= LIMIT, found


@pytest.mark.few(1)
@pytest.mark.parametrize("steps", [2, 3, 5])
def test_products_of_several_steps(steps: int) -> None:
    """Loops of exported C become straight-line steps whose Jacobians are multiplied; 9 x 12 has tiles of all shapes."""
    require_tool("cc")
    options = Options(ExplicitRungeKutta(RK4, steps=steps, unroll="none"))
    ocp = chain.build_ocp(3, N=11)
    assert "lanes_chain" in host_unit(module_of(ocp, options), 4, False)
    one, other = (build(ocp, options, "test", lanes=n) for n in (1, 4))
    assert max(dict(errors(one, other, np.random.default_rng(2))).values()) <= LIMIT


@pytest.mark.slow
def test_exact_hessians_without_multipliers_take_the_adjoint_sweep() -> None:
    """After reset() all multipliers are 0: both units compute them from node to node, and give the same control."""
    require_tool("cc")
    one, other = pair("timed bioreactor", 8)
    x0 = np.array(one.x[0])
    np.testing.assert_allclose(one.step(x0), other.step(x0), rtol=1e-12)
    np.testing.assert_allclose(one.lam, other.lam, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_more_controls_of_a_stage_than_lanes() -> None:
    """Two intervals of the quadrotor are a stage with eight controls."""
    require_tool("cc")
    one, other = pair("quadrotor partial", 4)
    x0 = np.array(one.x[0]) + 0.1
    for scale in (1.0, 3.0):
        np.testing.assert_allclose(other.step(scale * x0), one.step(scale * x0), rtol=1e-9)
    assert one.status == other.status == 0


def test_closed_loops_agree() -> None:
    require_tool("cc")
    one, other = (build(cstr.build_ocp(), profile="fast", lanes=n) for n in (1, 8))
    states = [np.array(one.x[0]), np.array(one.x[0])]
    for _ in range(40):
        controls = [c.step(x) for c, x in zip((one, other), states, strict=True)]
        assert one.status == other.status
        states = [c.integrate(x, u, cstr.SAMPLING) for c, x, u in zip((one, other), states, controls, strict=True)]
    np.testing.assert_allclose(states[0], states[1], rtol=1e-8)


@pytest.mark.parametrize("lanes", [0, 3, 16, True, "all"])
def test_other_numbers_of_lanes_are_refused(lanes: int) -> None:
    with pytest.raises(OptionError, match=r"lanes is .*expected None .* 2, 4 or 8"):
        build(crane.build_ocp(), lanes=lanes)


def test_an_exported_package_has_one_lane(tmp_path: Path) -> None:
    require_tool("cc")
    export(crane.build_ocp(), directory=tmp_path)
    assert not list(tmp_path.glob("*host*"))
    with pytest.raises(OptionError, match=r"one node at a time .* build\(\) more"):
        open_package(tmp_path, lanes=8)
    with pytest.raises(OptionError, match="lanes is 8"):
        load(generate(crane.build_ocp()), "crane", lanes=8)


def test_lanes_follow_the_processor_only_where_the_profile_does() -> None:
    require_tool("cc")
    assert host(None, "test").lanes == host(None, "verify").lanes == host(1, "fast").lanes == 1
    assert host(None, "fast").lanes in (1, 4, 8)
    assert host(4, "verify") == host(4, "test")


def test_controllers_with_lanes_are_copied_and_pickled() -> None:
    require_tool("cc")
    controller = build(crane.build_ocp(), profile="fast", lanes=4)
    x0 = np.array([1.0, 0.0, 0.1, 0.0])
    controller.step(x0)
    twin, restored = controller.copy(), pickle.loads(pickle.dumps(controller))
    expected = controller.step(x0)
    np.testing.assert_array_equal(twin.step(x0), expected)
    np.testing.assert_array_equal(restored.step(x0), expected)


def test_few_intervals_take_fewer_lanes() -> None:
    """N = 1 has one node: the unit is the exported text."""
    module = module_of(KNOWN["single dense"].make(), KNOWN["single dense"].options)
    assert "lanes_t" not in host_unit(module, 8, True)
    bare = module_of(KNOWN["bare dense"].make(), Options(hessian=ExactHessian()))
    assert "vector_size(HOST_LANES" in host_unit(bare, 8, True)
    assert "#define HOST_LANES 4" in host_unit(bare, 8, True)


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
@pytest.mark.parametrize(
    ("nx", "nu", "precision"), [*((*shape, "double") for shape in SHAPES), (2, 3, "single"), (9, 3, "single")]
)
def test_riccati_products_in_tiles(nx: int, nu: int, precision: str) -> None:
    """Sizes with tiles of all shapes and rests: factors, and controls at their bounds, are those of exported C."""
    require_tool("cc")
    options = Options(condensing=NoCondensing(), qp=RiccatiActiveSet(), precision=precision)
    ocp = linear(nx, nu)
    tolerance = 1e-11 if precision == "double" else 2e-3
    one, *others = (build(ocp, options, "test", lanes=n) for n in (1, 8))
    x0 = np.array(one.x[0])
    expected = [one.step(scale * x0) for scale in (1.0, 3.0, 0.1)]
    assert one.status == 0
    size = np.abs(one.view("riccati.P")[:, :nx, :nx]).max()
    for other in others:
        found = [other.step(scale * x0) for scale in (1.0, 3.0, 0.1)]
        np.testing.assert_allclose(found, expected, atol=tolerance)
        pair = (np.tril(c.view("riccati.P")[:, :nx, :nx]) for c in (other, one))
        np.testing.assert_allclose(*pair, atol=tolerance * size, err_msg="P")
        pair = (c.view("riccati.K")[:, :nu, :nx] for c in (other, one))
        np.testing.assert_allclose(*pair, atol=tolerance * size, err_msg="K")
