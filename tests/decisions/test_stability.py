"""Stability of the explicit scheme at the points that a problem states."""

from __future__ import annotations

import pytest

from examples import chain, crane
from nmpc_codegen import OCP, Euler, ExplicitRungeKutta, Options
from nmpc_codegen.compiler import model_of
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.row_program import program
from nmpc_codegen.lowering.explain import warnings


def decay(rate: float, T: float = 1.0) -> OCP:
    ocp = OCP("decay", T=T, N=2)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -rate * x + u})
    ocp.least_squares(x, weight=1.0)
    return ocp


def warnings_of(ocp: OCP, integrator: ExplicitRungeKutta) -> list[str]:
    model = model_of(classify(ocp), Options(integrator))
    found = [text for text in warnings(model, program(model.problem)) if text.startswith("integrator")]
    return [text for text in found if "is not accurate" not in text]


@pytest.mark.parametrize(
    ("integrator", "rate", "steps"),
    [
        (ExplicitRungeKutta(steps=1), 5.5, None),  # h lambda = -2.75
        (ExplicitRungeKutta(steps=1), 5.6, 2),
        (ExplicitRungeKutta(steps=2), 5.6, None),
        (ExplicitRungeKutta(steps=3), 100.0, 18),  # 50 / 2.785
        (ExplicitRungeKutta(Euler, steps=1), 3.9, None),
        (ExplicitRungeKutta(Euler, steps=1), 41.0, 11),  # 20.5 / 2
    ],
)
def test_real_axis(integrator: ExplicitRungeKutta, rate: float, steps: int | None) -> None:
    found = warnings_of(decay(rate), integrator)
    assert len(found) == (steps is not None)
    assert steps is None or found[0].endswith(f"--set integrator.steps={steps}")


def test_a_model_that_is_too_stiff() -> None:
    (found,) = warnings_of(decay(1e5), ExplicitRungeKutta())
    assert "too stiff" in found


def test_unstable_modes_are_none_of_the_scheme() -> None:
    assert not warnings_of(decay(-50.0), ExplicitRungeKutta())


def test_examples_are_stable() -> None:
    assert not warnings_of(crane.build_ocp(), ExplicitRungeKutta(steps=2))
    assert not warnings_of(chain.build_ocp(3), ExplicitRungeKutta(steps=2))
