"""The seams are independent: a package whose algorithm needs only an integrator contains nothing else, and works."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    Controller,
    ControllerError,
    DenseActiveSet,
    GaussNewton,
    NoCondensing,
    OptionError,
    Options,
    Status,
    build,
    generate,
    open_package,
)
from nmpc_codegen.components.base import Algorithm, Core, Dims, Seam
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.options import REGISTRIES
from nmpc_codegen.oracle.reference import Reference, node_data
from nmpc_codegen.package.signals import Argument, EntryPoint
from nmpc_codegen.package.struct_layout import Field, Struct

PART = Path(__file__).parents[1] / "data" / "algorithms" / "projected_gradient.c"


@dataclass(frozen=True)
class ProjectedGradient(Algorithm):
    """Single shooting by projected gradients: no multipliers, no QP, no second derivatives."""

    name: ClassVar[str] = "projected_gradient"
    template: ClassVar[str] = str(PART)
    needs: ClassVar[tuple[Seam, ...]] = ("integrator",)
    core: ClassVar[frozenset[Core]] = frozenset()
    supports: ClassVar[frozenset[str]] = frozenset({"general cost"})
    shift: ClassVar[None] = None
    sampling_time: ClassVar[float | None] = None

    def entries(self, solve: bool) -> tuple[EntryPoint, ...]:
        xhat, u0 = Argument("xhat", "real", ("NX",)), Argument("u0", "real", ("NU",))
        return (EntryPoint("step", "The control for the measured xhat.", (xhat,), (u0,)),)

    def check(self, problem: Problem) -> None:
        others = [row.name for row in problem.rows if row.kind != "control"]
        if others:
            raise OptionError(f"ProjectedGradient() clashes with the row {others[0]}")

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("MAX_STEPS", 400, "gradient steps of a sample"), ("MAX_HALVINGS", 60, "of the length of a step"))

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        members = (
            Field("slope", (dims.N, dims.nu), "gradient in the controls", "scratch"),
            Field("before", (dims.N, dims.nu), "controls before the step", "scratch"),
            Field("length", (), "of the last step", "scratch"),
            Field("steps", (), "gradient steps so far", "result", "int32"),
        )
        return (Struct("solver", "", members),)


@pytest.fixture(scope="module", autouse=True)
def registered() -> Iterator[None]:
    registry = dict[str, type[Algorithm]](REGISTRIES["algorithm"])  # type: ignore[arg-type]
    registry[ProjectedGradient.name] = ProjectedGradient
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(REGISTRIES, "algorithm", registry)  # type: ignore[arg-type]
        yield


def pendulum() -> OCP:
    ocp = OCP("pendulum", T=1.0, N=5)
    q, w, u = ocp.state("q", initial=0.5), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) - 0.1 * w + u})
    ocp.least_squares(ca.vertcat(q, w, u), weight=[2.0, 0.5, 0.5])
    ocp.terminal_least_squares(q, weight=1.0)
    ocp.subject_to(-0.4, u, 0.4)
    return ocp


@pytest.fixture(scope="module")
def controller(registered: None) -> Controller:
    return build(pendulum(), Options(algorithm=ProjectedGradient()), "test")


def test_the_package_has_the_integrator_and_the_cost_and_nothing_else() -> None:
    sources = generate(pendulum(), Options(algorithm=ProjectedGradient()))
    for file in ("pendulum.h", "pendulum.c", "README.md", "main.c"):
        assert not re.findall(r"(?i)\w*(?:condens|hessian|\bqp\b|working_set|riccati|multiplier)\w*", sources[file])
    declared = re.findall(r"pendulum_(\w+)\(", sources["pendulum.h"])
    own = ["init", "reset", "step", "integrate", "cost", "status_string"]
    setters = [
        f"set_{name}"
        for name in ("reference", "reference_range", "terminal_reference", "weight", "terminal_weight", "bounds")
    ]
    assert sorted(declared) == sorted([*own, *setters])
    assert "_kkt" not in sources["pendulum.h"]


def test_its_closed_loop_is_that_of_ipopt(controller: Controller) -> None:
    problem = classify(pendulum())
    reference, x = Reference(problem), np.array([1.0, 0.6])
    clipped = 0
    for _ in range(8):
        u = controller.step(x, on_failure="raise")
        found = reference.solve(node_data(problem, x0=x))
        assert found.success
        np.testing.assert_allclose(controller.u, found.u, atol=2e-6)
        np.testing.assert_allclose(controller.x, found.x, atol=2e-6)
        assert controller.cost == pytest.approx(found.cost, rel=1e-9)
        clipped += abs(u[0]) == 0.4
        x = controller.integrate(x, u, 0.2)
    assert 0 < clipped < 8


def test_a_changed_reference_acts_at_once(controller: Controller) -> None:
    problem, ctrl = classify(pendulum()), controller.copy()
    ctrl.set_reference([0.2, 0.0, 0.1])
    ctrl.step([0.3, -0.1])
    found = Reference(problem).solve(node_data(problem, x0=[0.3, -0.1], yref=[0.2, 0.0, 0.1]))
    np.testing.assert_allclose(ctrl.u, found.u, atol=2e-6)


def test_what_it_lacks_is_an_error_that_says_so(controller: Controller) -> None:
    with pytest.raises(ControllerError, match=r"exported without solve\(\)"):
        controller.solve([0.5, 0.0])
    with pytest.raises(ControllerError, match=r"exported without feedback\(\)"):
        controller.feedback([0.5, 0.0])
    with pytest.raises(ControllerError, match=r"exported without kkt\(\)"):
        controller.kkt()
    with pytest.raises(AttributeError, match="has no 'lam'"):
        _ = controller.lam
    assert controller.stats.qp_iterations == 0
    assert controller.stats.violated_row is None


def test_a_bad_measurement_gives_the_planned_control(controller: Controller) -> None:
    ctrl = controller.copy()
    planned = ctrl.u[0].copy()
    np.testing.assert_array_equal(ctrl.step([np.nan, 0.0]), planned)
    assert ctrl.status is Status.NOT_FINITE


def test_seams_that_it_does_not_need_are_refused() -> None:
    for more in ({"hessian": GaussNewton()}, {"condensing": NoCondensing()}, {"qp": DenseActiveSet()}):
        (seam,) = more
        with pytest.raises(OptionError, match=rf"{seam} .* clashes with algorithm ProjectedGradient.*integrator"):
            Options(algorithm=ProjectedGradient(), **more)  # type: ignore[arg-type]


def test_it_says_which_row_it_does_not_take() -> None:
    ocp = pendulum()
    ocp.subject_to(-1, ocp.x[1], 1)
    with pytest.raises(OptionError, match="clashes with the row w"):
        generate(ocp, Options(algorithm=ProjectedGradient()))


def test_the_exported_folder_opens(tmp_path: Path, controller: Controller) -> None:
    for path, text in generate(pendulum(), Options(algorithm=ProjectedGradient())).items():
        (tmp_path / path).write_text(text, encoding="utf-8")
    opened = open_package(tmp_path, profile="test")
    assert [entry.name for entry in opened.description.entry_points] == ["step"]
    np.testing.assert_array_equal(opened.step([0.4, 0.1]), opened.u[0])
