"""Options: every bad value is an OptionError that lists the allowed ones; unsupported features are refused by name."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import crane
from nmpc_codegen import (
    OCP,
    RK4,
    DenseActiveSet,
    Discrete,
    EconomicGaussNewton,
    ExactHessian,
    ExplicitRungeKutta,
    FullCondensing,
    GaussNewton,
    Heun,
    Online,
    OptionError,
    Options,
    Osqp,
    ProblemError,
    RealTimeIteration,
    RiccatiActiveSet,
    build,
    generate,
)
from nmpc_codegen.components.base import SEAMS
from nmpc_codegen.options import REGISTRIES, as_data
from verification.routes import PURE


def integrator_ocp(**grid: Any) -> OCP:
    ocp = OCP("cart", **(grid or {"T": 1.0, "N": 2}))
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    return ocp


# Values ---------------------------------------------------------------------------------------------------------------

BAD: list[tuple[Callable[[], Any], list[str]]] = [
    (
        lambda: Options(integrator="rk4"),
        [
            "Options.integrator: 'rk4'",
            "explicit_runge_kutta",
            "--set integrator=",
            "ExplicitRungeKutta(...)",
            "Discrete(...)",
            "None",
        ],
    ),
    (lambda: Options(integrator=RK4), ["integrator", "ExplicitRungeKutta(...)"]),
    (lambda: Options(integrator=GaussNewton()), ["integrator: GaussNewton", "Discrete(...)"]),
    (lambda: Options(hessian=3), ["hessian: 3", "GaussNewton(...)", "gauss_newton", "--set hessian="]),
    (lambda: Options(hessian="exact"), ["hessian: 'exact'", "GaussNewton(...)"]),
    (lambda: Options(condensing="none"), ["condensing: 'none'", "FullCondensing(...)", "None"]),
    (lambda: Options(qp="qpoases"), ["qp: 'qpoases'", "DenseActiveSet(...)", "None", "--set qp="]),
    (lambda: Options(qp=DenseActiveSet), ["qp", "DenseActiveSet(...)"]),
    (lambda: Options(algorithm=None), ["algorithm: None", "RealTimeIteration(...)"]),
    (lambda: Options(online="node"), ["online: 'node'", "Online(...)"]),
    (lambda: Options(precision="half"), ["precision: 'half'", "double", "single"]),
    (lambda: Options(precision=64), ["precision: 64", "double", "single"]),
    (lambda: ExplicitRungeKutta("rk5"), ["tableau: 'rk5'", "Euler", "Midpoint", "Heun", "SSPRK3", "RK4"]),
    (lambda: ExplicitRungeKutta(4), ["tableau: 4", "RK4"]),
    (lambda: ExplicitRungeKutta(RK4, steps=0), ["ExplicitRungeKutta.steps: 0", ">= 1", "--set integrator.steps="]),
    (lambda: ExplicitRungeKutta(RK4, steps=2.0), ["steps: 2.0", "integer"]),
    (lambda: ExplicitRungeKutta(RK4, steps=True), ["steps: True", "integer"]),
    (lambda: ExplicitRungeKutta(RK4, unroll="some"), ["unroll: 'some'", "auto", "all", "none"]),
    (
        lambda: DenseActiveSet(max_iterations=0),
        ["DenseActiveSet.max_iterations: 0", ">= 1", "None", "--set qp.max_iterations="],
    ),
    (lambda: DenseActiveSet(max_iterations=1.5), ["max_iterations: 1.5", "integer"]),
    (lambda: DenseActiveSet(max_iterations=True), ["max_iterations: True", "integer"]),
    (lambda: RealTimeIteration(shift="once"), ["shift: 'once'", "None", "repeat", "periodic", "resample"]),
    (lambda: RealTimeIteration(shift=True), ["shift: True", "repeat"]),
    (lambda: RealTimeIteration(shift="resample"), ["sampling_time: None", "resample"]),
    (lambda: RealTimeIteration(relaxation="hard"), ["relaxation: 'hard'", "auto", "None"]),
    (lambda: RealTimeIteration(iterations=0), ["iterations: 0", ">= 1"]),
    (lambda: RealTimeIteration(tolerance=0.0), ["tolerance: 0.0", "> 0"]),
    (lambda: RealTimeIteration(shift="resample", sampling_time=-1.0), ["sampling_time: -1.0", "> 0"]),
    (lambda: ExplicitRungeKutta(steps=10**9), ["steps: 1000000000", "<= 100000"]),
    (lambda: DenseActiveSet(max_iterations=10**30), ["max_iterations: 1000000000", "<= 2147483647"]),
    (lambda: ExactHessian(regularization="clip"), ["regularization: 'clip'", "project, mirror, none", "Mirror(...)"]),
    (lambda: Osqp(eps=0), ["Osqp.eps: 0", "> 0"]),
    (
        lambda: Online(reference="each"),
        ["Online.reference: 'each'", "--set online.reference=", "fixed", "shared", "node"],
    ),
    (lambda: Online(weight=None), ["Online.weight: None", "fixed", "shared", "node"]),  # type: ignore[arg-type]
    (lambda: Online(bounds=["node"]), ["Online.bounds: ['node']", "fixed", "shared", "node"]),  # type: ignore[arg-type]
    (lambda: Online(parameter=True), ["Online.parameter: True", "fixed", "shared", "node"]),  # type: ignore[arg-type]
    (lambda: Online(dense_weight=1), ["Online.dense_weight: 1", "True", "False"]),  # type: ignore[arg-type]
    (
        lambda: Online(weight="fixed", dense_weight=True),
        ["dense_weight=True", "clashes", 'weight="fixed"', "--set online.weight=fixed"],
    ),
    (lambda: generate(integrator_ocp(), "fast"), ["options: 'fast'", "Options(...)"]),  # type: ignore[arg-type]
    (lambda: build(integrator_ocp(), profile="quick"), ["profile", "'quick'", "test", "fast", "verify"]),
    (lambda: Options(target="vax"), ["target", "'vax'", "native", "portable", "x86-64-v3", "aarch64", "riscv32"]),
]


@pytest.mark.parametrize(("make", "words"), BAD, ids=[words[0] for _, words in BAD])
def test_bad_value_lists_the_good_ones(make: Callable[[], Any], words: list[str]) -> None:
    with pytest.raises(OptionError) as caught:
        make()
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "part", [Options(), Online(), *(cls() for registry in REGISTRIES.values() for cls in registry.values())]
)
def test_parts_are_frozen_values(part: Any) -> None:
    """Equal by value, hashable if all parts are, and immutable."""
    assert part == type(part)()
    for f in dataclasses.fields(part):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(part, f.name, None)


def test_registries_cover_the_seams() -> None:
    assert tuple(REGISTRIES) == SEAMS
    for seam, registry in REGISTRIES.items():
        for word, cls in registry.items():
            assert (cls.seam, cls.name) == (seam, word)


# Combinations ---------------------------------------------------------------------------------------------------------


def test_integrator_must_fit_the_dynamics() -> None:
    with pytest.raises(OptionError, match=r"cart is an ordinary differential equation.*ExplicitRungeKutta"):
        generate(integrator_ocp(), Options(integrator=Discrete()))
    ocp = OCP("map", N=2)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x + u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    with pytest.raises(OptionError, match=r"map is a discrete map.*Discrete\(\)"):
        generate(ocp, Options(integrator=ExplicitRungeKutta()))


def _periodic(ocp: OCP) -> None:
    ocp.boundary(0, ocp.at_start(ocp.x[0]) - ocp.at_end(ocp.x[0]), 0)


def _doubling(ocp: OCP) -> None:
    """A row of x_0 and x_N that is no period."""
    ocp.boundary(0, 2 * ocp.at_start(ocp.x[0]) - ocp.at_end(ocp.x[0]), 0)


AUTOMATIC: list[tuple[dict[str, Any], Any, float | None, str | None, str]] = [
    ({}, None, None, "repeat", "one interval"),
    ({}, None, 0.1, "resample", "sampling time 0.1 differs"),
    ({}, None, 0.2, "repeat", "one interval"),
    ({"intervals": [0.1, 0.2]}, None, None, None, 'non-uniform grid; shift="resample"'),
    ({}, lambda ocp: ocp.free_initial(ocp.x[0]), None, None, 'free components of x_0; shift="repeat"'),
    ({}, lambda ocp: ocp.accumulator(ocp.x[0]), None, None, 'accumulators; shift="repeat"'),
    ({}, _periodic, None, "periodic", "rows compare x_N with x_0"),
    ({}, lambda ocp: (_periodic(ocp), ocp.free_initial(ocp.x[0])), None, None, "free components of x_0"),
    ({}, _periodic, 0.1, None, 'couple x_0 and x_N; shift="periodic"'),
    ({}, _doubling, None, None, 'couple x_0 and x_N; shift="periodic"'),
]


@pytest.mark.parametrize(("grid", "change", "sampling_time", "shift", "why"), AUTOMATIC)
def test_the_automatic_shift(grid: Any, change: Any, sampling_time: Any, shift: Any, why: str) -> None:
    ocp = integrator_ocp(**(grid or {"T": 0.8, "N": 4}))
    if change:
        change(ocp)
    files = generate(ocp, Options(algorithm=RealTimeIteration(sampling_time=sampling_time)))
    described = json.loads(files["cart.json"])
    assert described["shift"] == shift
    assert any(why in choice for choice in described["report"]["choices"])
    expected = sampling_time or (grid["intervals"][0] if grid else 0.2)
    assert f"#define CART_DT {expected:g}" in files["cart.h"]


def test_a_shift_by_one_interval_clashes_with_another_sampling_time() -> None:
    with pytest.raises(OptionError, match=r'shift="repeat".*0.2 s.*sampling_time=0.1; expected shift="resample"'):
        generate(integrator_ocp(T=0.8, N=4), Options(algorithm=RealTimeIteration(shift="repeat", sampling_time=0.1)))


@pytest.mark.parametrize("shift", ["repeat", "periodic"])
def test_shift_clashes_with_a_non_uniform_grid(shift: str) -> None:
    with pytest.raises(OptionError, match=rf'shift="{shift}".*clashes.*non-uniform grid'):
        generate(integrator_ocp(intervals=[0.1, 0.2]), Options(algorithm=RealTimeIteration(shift=shift)))


def test_choices_are_reported() -> None:
    report = generate(integrator_ocp())["cart.json"]
    for word in ("integrator: explicit_runge_kutta", "condensing: full", "qp: dense_active_set"):
        assert word in report
    assert report.count("fewest operations") == 1
    choose_qp_only = generate(integrator_ocp(), Options(condensing=FullCondensing()))["cart.json"]
    assert '"qp: dense_active_set; fewest operations' in choose_qp_only
    given = Options(ExplicitRungeKutta(), GaussNewton(), FullCondensing(), DenseActiveSet(), PURE)
    assert '"choices": []' in generate(integrator_ocp(), given)["cart.json"]


@pytest.mark.parametrize("name", ["Crane", "1st", "a-b", ""])
def test_prefix_of_the_package(name: str) -> None:
    """A prefix that is no lower-case identifier."""
    ocp = integrator_ocp()
    with pytest.raises(ProblemError, match=repr(name)):
        generate(ocp, name=name)


# Features that some components lack --------------------------------------------------------------------------------


def _soft(ocp: OCP) -> None:
    ocp.subject_to(-1, ocp.x, 1, soft=(1.0, 1.0), name="swing")


def _coupled(ocp: OCP) -> None:
    ocp.boundary(0, ocp.at_start(ocp.x) - ocp.at_end(ocp.x), 0)


def _free(ocp: OCP) -> None:
    ocp.free_initial("x")


def _coupled_and_free(ocp: OCP) -> None:
    _coupled(ocp)
    _free(ocp)


def _general(ocp: OCP) -> None:
    ocp.stage_cost(ocp.x**4)


def _terminal(ocp: OCP) -> None:
    ocp.terminal_cost(ocp.x**4)


def _integrated(ocp: OCP) -> None:
    ocp.stage_cost(ocp.x**4, integrate=True)


def _accumulated(ocp: OCP) -> None:
    ocp.accumulator("x")


@pytest.mark.parametrize(
    ("state", "feature"),
    [
        (_soft, "soft rows"),
        (_coupled, "coupled rows"),
        (_free, "free initial state"),
        (_coupled_and_free, "rows that couple x_N with free components of x_0"),
        (_general, "general cost"),
        (_terminal, "general cost"),
        (_integrated, "integrated cost"),
        (_accumulated, "accumulators"),
    ],
)
def test_unsupported_feature(state: Callable[[OCP], None], feature: str) -> None:
    """Every component supports the feature or is refused with the names of problem, feature, seam and component."""
    ocp = integrator_ocp()
    state(ocp)
    components = [cls for registry in REGISTRIES.values() for cls in registry.values()]
    hessian = ExactHessian() if "cost" in feature else GaussNewton()
    for cls in components:
        if feature in cls.supports:
            continue
        without = cls.seam == "algorithm" and "hessian" not in cls.needs
        chosen = {**({} if without else {"hessian": hessian}), cls.seam: cls()}
        with pytest.raises(OptionError) as caught:
            generate(ocp, Options(**chosen))
        message = str(caught.value)
        assert "cart" in message
        assert feature in message
        assert f"{cls.seam} {cls.__name__}() (--set {cls.seam}={cls.name})" in message
    assert generate(ocp, Options(hessian=hessian))


def test_options_as_data_have_the_names_of_set_and_survive_json() -> None:
    """Dotted names; a component has its class, arrays are lists, and what JSON cannot hold is text."""
    given = Options(ExplicitRungeKutta(Heun, steps=3), EconomicGaussNewton(np.eye(2), np.eye(1)), precision="single")
    found = as_data(given)
    assert (found["integrator"], found["integrator.tableau.name"], found["integrator.steps"]) == (
        "ExplicitRungeKutta",
        "Heun",
        3,
    )
    assert found["integrator.tableau.a"] == [[0.0, 0.0], [1.0, 0.0]]
    assert (found["hessian"], found["hessian.M"]) == ("EconomicGaussNewton", [[1.0, 0.0], [0.0, 1.0]])
    assert (found["qp"], found["precision"], found["algorithm.relaxation"]) == (None, "single", "auto")
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    listed = {name for name in found if "." in name and name.split(".")[0] in SEAMS}
    assert {f"algorithm.{field.name}" for field in dataclasses.fields(RealTimeIteration)} <= listed


def test_a_description_says_what_was_chosen() -> None:
    options = generate(crane.build_ocp(), Options(qp=RiccatiActiveSet())).description.options
    assert (options["condensing"], options["qp"], options["qp.fallback"]) == (
        "NoCondensing",
        "RiccatiActiveSet",
        "RiccatiInteriorPoint",
    )
    assert options["integrator.tableau.name"] == "RK4"
