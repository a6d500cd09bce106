"""The functions of a package by their purpose, and their order in C."""

from __future__ import annotations

import pytest

from nmpc_codegen import ExactHessian, GaussNewton, Options
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.model import operations
from nmpc_codegen.ir.stage_products import pattern
from nmpc_codegen.lowering.linearize import Model, linearize
from verification.models import problem_of

INTERVAL = ("integrator_interval", "integrator_step")
ROWS = ("path_rows", "terminal_rows", "coupled_rows")
PATH = ("path_cost", "path_gradient")
START = ("start_cost", "start_gradient")
TERMINAL = ("terminal_cost", "terminal_gradient", "terminal_hessian")

ORDERS = {
    "gauss_newton": (
        GaussNewton(),
        False,
        (*INTERVAL, *PATH, "path_hessian", *TERMINAL, *START, "start_hessian", *ROWS),
    ),
    "exact": (
        ExactHessian(),
        False,
        (*INTERVAL, *PATH, *TERMINAL, *START, "start_hessian", "initial_hessian", "path_exact", *ROWS),
    ),
    "exact, integrated": (
        ExactHessian(),
        True,
        (*INTERVAL, *TERMINAL, *START, "start_hessian", "initial_hessian", *PATH, "path_exact", *ROWS),
    ),
    "linear rows": (
        GaussNewton(convex_rows=True),
        False,
        (
            *INTERVAL,
            *PATH,
            "path_hessian",
            *TERMINAL,
            *START,
            "start_hessian",
            *ROWS,
        ),
    ),
}


def model(case: str) -> Model:
    hessian, integrated, _ = ORDERS[case]
    ocp = problem_of("reactor", uniform=False)
    if integrated:
        ocp.stage_cost(ocp.x[0] ** 2, integrate=True)
    return linearize(classify(ocp), Options(hessian=hessian))  # type: ignore[arg-type]


@pytest.mark.parametrize("case", ORDERS)
def test_routines_have_names_and_an_order(case: str) -> None:
    assert tuple(r.name for r in model(case).routines) == ORDERS[case][2]


def test_parts_are_found_by_what_they_are_for() -> None:
    m = model("exact")
    assert m.interval.curved is not None
    assert m.interval.curved.name == "path_exact"
    assert m.path.hessian is None
    assert m.terminal.hessian is not None
    assert pattern(m.terminal.hessian, "Q") == m.terminal.Q
    assert pattern(m.interval.linearize, "S") == m.products.S
    assert (m.products.nx, m.products.nu) == (m.problem.nx, m.problem.nu)


def test_operations_of_what_there_is() -> None:
    m = model("gauss_newton")
    assert operations(None) == OpCount()
    assert operations(m.path.cost, None, m.path.gradient) == m.path.cost.count + m.path.gradient.count


def test_completed_options_leave_no_choice() -> None:
    """They are the functions that the description of the package prints, and they lead to the same model."""
    m = model("gauss_newton")
    assert m.options.integrator is m.parts.integrator
    again = linearize(m.problem, m.options)
    assert again.parts == m.parts
    assert again.choices == ()
