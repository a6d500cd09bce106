"""Stated operation counts against the generated C run with a counting scalar, class by class.

Tested are every printed routine, every stage product in both code styles, every function with a cost stated by a
component, and the sums in the table of contents.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

import numpy as np
import pytest

from nmpc_codegen import (
    ESDIRK3,
    OCP,
    SDIRK2,
    DenseActiveSet,
    EconomicGaussNewton,
    ExactHessian,
    ExplicitRungeKutta,
    ForwardOverAdjoint,
    GaussNewton,
    ImplicitRungeKutta,
    Options,
    RealTimeIteration,
    RiccatiActiveSet,
)
from nmpc_codegen.compiler import model_of, text_of
from nmpc_codegen.components.integrators import TABLEAUS
from nmpc_codegen.components.integrators.tableau import IMPLICIT
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir import stage_products as products
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.options import REGISTRIES
from nmpc_codegen.package.opcount import OpCount
from tests.components.test_condensing import PROBLEMS, SPELLINGS
from verification import problems, samples
from verification.c_harness import module_of
from verification.counting import CLASSES, count_mismatches, counting_header, mismatches
from verification.models import discrete_map, pendulum_of_everything, problem_of


def pendulum() -> OCP:
    return pendulum_of_everything("pendulum", [0.1, 0.2])


CASES: dict[str, tuple[Callable[[], OCP], Options]] = {
    **{f"condensing {name}": (PROBLEMS[name], Options(hessian=GaussNewton())) for name in ("general", "sparse")},
    **{
        f"tableau {name}": (lambda: problem_of("reactor", uniform=False), Options(ExplicitRungeKutta(tableau, 2)))
        for name, tableau in TABLEAUS.items()
    },
    **{
        f"unroll {unroll}": (lambda: problem_of("tanks"), Options(ExplicitRungeKutta(steps=3, unroll=unroll)))
        for unroll in ("none",)
    },
    **{
        f"implicit {name}": (lambda: problem_of("reactor", uniform=False), Options(ImplicitRungeKutta(tableau, 2)))
        for name, tableau in IMPLICIT.items()
    },
    "implicit, exact": (pendulum, Options(ImplicitRungeKutta(ESDIRK3), ExactHessian(), qp=RiccatiActiveSet())),
    "implicit, forward over adjoint": (
        pendulum,
        Options(ImplicitRungeKutta(SDIRK2, 2), ExactHessian(sweep=ForwardOverAdjoint()), qp=RiccatiActiveSet()),
    ),
    "discrete": (discrete_map, Options()),
    "dense weight": (problems.dense_weight, Options(hessian=GaussNewton())),
    "scaled": (problems.scaled, Options(algorithm=RealTimeIteration())),
    "constant": (samples.tuned, Options(hessian=EconomicGaussNewton(np.eye(3), np.eye(2)))),
    "constant, end fixed": (samples.tuned_end, Options(hessian=EconomicGaussNewton(np.eye(3)), qp=RiccatiActiveSet())),
    "tiny": (problems.tiny, Options(precision="single")),
}


@pytest.fixture(autouse=True)
def cxx(need: Callable[[str], str]) -> None:
    need("g++")


@pytest.mark.few(4)
@pytest.mark.parametrize("case", CASES)
def test_stated_counts_are_counted(case: str) -> None:
    make, options = CASES[case]
    assert count_mismatches(make(), options) == []


#: What is written out, of every structure; what are loops, of rows, of sparse stages and of several panels.
SPELLED = [*((name, "nonzeros") for name in PROBLEMS), *((name, "loops") for name in ("general", "sparse", "wide"))]


@pytest.mark.few(3)
@pytest.mark.parametrize(("name", "spelling"), SPELLED)
def test_both_spellings_of_the_products(name: str, spelling: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(products, "WRITTEN_OUT", SPELLINGS[spelling])
    module = module_of(PROBLEMS[name](), Options(hessian=GaussNewton(), qp=DenseActiveSet()))
    assert module.products.spelling == spelling
    assert mismatches(module, text_of(module)) == []


def test_what_is_stated_covers_routines_products_and_components() -> None:
    module = module_of(PROBLEMS["general"](), Options(hessian=ExactHessian(), qp=DenseActiveSet()))
    stated = set(module.description.report.operations)
    assert {r.name for r in module.routines} <= stated
    assert {r.name for r in module.called_products} <= stated
    assert {"hessian", "linearize", "condense_hessian", "condense_gradient", "condense_embed"} <= stated
    assert {"condense_expand", "qp_forward", "qp_backward"} <= stated


def test_a_wrong_count_is_found() -> None:
    """One additional operation, in a routine, a product and components, in every class; the others still agree."""
    module = module_of(problem_of("reactor"))
    functions = ("integrator_interval", "state_step", "condense_hessian", "linearize", "path_gradient")
    wrong = dict(zip(functions, CLASSES, strict=True))
    operations = dict(module.description.report.operations)
    for function, cls in wrong.items():
        operations[function] += OpCount(**{cls: 1})
    report = dataclasses.replace(module.description.report, operations=operations)
    altered = dataclasses.replace(module, description=dataclasses.replace(module.description, report=report))
    found = mismatches(altered, text_of(module))
    assert {name for name, _, _ in found} == set(functions)
    for name, stated, counted in found:
        assert {cls: stated[cls] - counted[cls] for cls in CLASSES} == {cls: int(cls == wrong[name]) for cls in CLASSES}


def test_sections_of_the_table_of_contents() -> None:
    """The figure of a section is the sum over its functions, and the text prints it."""
    module = module_of(PROBLEMS["general"](), Options(hessian=ExactHessian(), qp=DenseActiveSet()))
    operations = module.description.report.operations
    expected = {
        "condensing": (
            "condense_hessian",
            "condense_add_curvature",
            "condense_gradient",
            "condense_embed",
            "condense_expand",
        ),
        "hessian": ("hessian",),
        "algorithm": ("linearize",),
        "qp": ("qp_factorize_hessian", "qp_forward", "qp_backward"),
        "integrator": (),
    }
    assert set(expected) == set(REGISTRIES)
    text = text_of(module)[f"{module.name}.c"]
    for section in module.sections:
        functions = expected[section.title.split(":")[0]]
        total = sum((operations[f] for f in functions), OpCount())
        assert (section.count or OpCount()) == total
        line = next(line for line in text.splitlines() if section.template in line)
        assert re.search(rf" {total.total if functions else '-'} operations", line)
    for routine in module.routines:
        line = next(line for line in text.splitlines() if line.startswith(f" *   {routine.name} "))
        assert line.endswith(f" {routine.count.total} operations")


def test_the_counting_scalar_replaces_the_type_in_both_precisions() -> None:
    for ctype in ("double", "float"):
        assert counting_header(f"typedef {ctype} a_real;\n", "a") == "typedef counted a_real;\n"
    with pytest.raises(ValueError, match="a_real"):
        counting_header("typedef long double a_real;", "a")


def test_lower_states_the_same_counts_twice() -> None:
    """lower() is a pure function: a second call changes nothing."""
    lin = model_of(classify(problem_of("crane")), Options())
    assert lower(lin).description == lower(lin).description
