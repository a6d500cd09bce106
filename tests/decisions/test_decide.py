"""Choices: each is taken once, with its reason, from what is tried and counted once."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from nmpc_codegen import (
    OCP,
    ExplicitRungeKutta,
    GaussNewton,
    ImplicitRungeKutta,
    Online,
    OptionError,
    Options,
    generate,
)
from nmpc_codegen.compiler import model_of
from nmpc_codegen.components.hessians import ExactHessian
from nmpc_codegen.decisions.decide import Choices, decide
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion import complete as completion
from verification.models import problem_of


def stiff() -> OCP:
    """A mode that decays 500 times in an interval."""
    ocp = OCP("stiff", T=2.0, N=4)
    x, v = ocp.state("x", initial=1.0), ocp.state("v")
    u = ocp.control("u", scale=1.0)
    ocp.dynamics({x: 1000 * (v - x) - x**3, v: u - v})
    ocp.least_squares(x, weight=1.0)
    return ocp


def decided(ocp: OCP, options: Options | None = None) -> Choices:
    options = options or Options()
    return decide(completion.complete(classify(ocp), options), options)


def test_nothing_is_computed_or_made_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: Counter[str] = Counter()

    def counted(owner: Any, name: str, key: str) -> None:
        plain = getattr(owner, name)

        def call(*given: Any, **named: Any) -> Any:
            calls[key] += 1
            return plain(*given, **named)

        monkeypatch.setattr(owner, name, call)

    for name in ("scales", "find_saddles", "proximal_terms"):
        counted(completion, name, name)
    for cls in (ExplicitRungeKutta, ImplicitRungeKutta):
        counted(cls, "interval", cls.name)
    for hessian in (GaussNewton, ExactHessian):
        counted(hessian, "blocks", hessian.name)
    found = generate(stiff()).description
    assert found.options["integrator"] == "ImplicitRungeKutta"
    assert calls == Counter(["scales", "find_saddles", "implicit_runge_kutta", "gauss_newton", "exact"])


def test_linearize_takes_what_was_counted() -> None:
    model = model_of(classify(stiff()), Options())
    made = model.choices.made
    assert model.interval.linearize is made.interval.linearize
    assert model.products is made.products
    assert model.choices.parts.components == model.parts.components


@pytest.mark.parametrize("goal", ["speed", "size"])
def test_a_scheme_that_is_given_is_stated(goal: Any) -> None:
    given = ExplicitRungeKutta(steps=3)
    assert decided(problem_of("crane"), Options(given, goal=goal)).integrator.stated
    assert not decided(problem_of("crane"), Options(goal=goal)).integrator.stated


def test_data_of_nodes_need_parameters_of_nodes() -> None:
    ocp = OCP("held", T=1.0, N=4)
    x, u = ocp.state("x", initial=1.0), ocp.control("u", hold=[2, 2])
    ocp.dynamics({x: u})
    ocp.least_squares([x, u], weight=1.0)
    choices = decided(ocp, Options(online=Online(parameter="shared")))
    assert choices.options.online.parameter == choices.online.value.parameter == "node"
    assert any(reason.startswith("online.parameter: node") for reason in choices.reasons)
    ocp.parameter("p")
    with pytest.raises(OptionError, match="clashes with control"):
        decided(ocp, Options(online=Online(parameter="shared")))
