"""The functions of a package by their purpose."""

from __future__ import annotations

from nmpc_codegen import ExactHessian, GaussNewton, Options
from nmpc_codegen.compiler import model_of
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir.model import operations
from nmpc_codegen.ir.stage_products import pattern
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.package.opcount import OpCount
from verification.models import problem_of


def model(hessian: ExactHessian | GaussNewton) -> Model:
    return model_of(classify(problem_of("reactor", uniform=False)), Options(hessian=hessian))


def test_parts_are_found_by_what_they_are_for() -> None:
    m = model(ExactHessian())
    assert m.interval.curved is not None
    assert m.interval.curved.name == "path_exact"
    assert m.path.hessian is None
    assert m.terminal.hessian is not None
    assert pattern(m.terminal.hessian, "Q") == m.terminal.Q
    assert pattern(m.interval.linearize, "S") == m.products.S
    assert (m.products.nx, m.products.nu) == (m.problem.nx, m.problem.nu)


def test_operations_of_what_there_is() -> None:
    m = model(GaussNewton())
    assert operations(None) == OpCount()
    assert operations(m.path.cost, None, m.path.gradient) == m.path.cost.count + m.path.gradient.count


def test_completed_options_leave_no_choice() -> None:
    """They are the functions that the description of the package prints, and they lead to the same model."""
    m = model(GaussNewton())
    assert m.options.integrator is m.parts.integrator
    again = model_of(m.problem, m.options)
    assert again.parts == m.parts
    assert again.choices.reasons == ("probes at saddles: the slope of w vanishes somewhere",)
