"""Contract of every registered component: protocol, template, features, costs, and options that check themselves."""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import EconomicGaussNewton, GaussNewton, KalmanFilter, MovingHorizon, OptionError, Options
from nmpc_codegen.compiler import model_of, read, text_of
from nmpc_codegen.components.base import SEAMS, Component, Dims, refuse_unsupported, spell
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir.cmodule import Macro
from nmpc_codegen.ir.sweep import Routine
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.options import REGISTRIES, Online
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.struct_layout import Field, Size, Struct, struct_layout
from verification.estimation import PLANTS
from verification.models import discrete_map, problem_of

COMPONENTS = [cls for seam in SEAMS for cls in REGISTRIES[seam].values()]
every_component = pytest.mark.parametrize("cls", COMPONENTS, ids=lambda cls: cls.__name__)

#: Every feature that classify() can find.
FEATURES = {
    "soft rows",
    "rows with an infinite penalty",
    "coupled rows",
    "rows that couple x_N with free components of x_0",
    "free initial state",
    "general cost",
    "integrated cost",
    "accumulators",
    "previous controls",
    "blocks of controls",
    "time",
    "discrete states",
    "nonlinear algebraic equations",
    "measurements",
}

#: Macro names that lower.py and render.py define themselves.
OWN_MACROS = {f.upper() for f in ("MANY", "MAGIC", "PANEL", "PARAMS", "ALL", "OK")}


#: Algorithms of estimators, with their kind.
ESTIMATORS: dict[type, str] = {MovingHorizon: "mhe", KalmanFilter: "ekf"}


def linearization(cls: type) -> Model:
    """A tiny problem with the component among the options."""
    seam = cls.seam  # type: ignore[attr-defined]
    if cls in ESTIMATORS:
        return model_of(*read(PLANTS["reactor"].estimator(N=3, kind=ESTIMATORS[cls]), None))
    discrete = seam == "integrator" and cls.name == "discrete"  # type: ignore[attr-defined]
    constant = cls is EconomicGaussNewton
    ocp = discrete_map() if discrete else problem_of("reactor", uniform=constant)
    ocp.subject_to(-1, ocp.x[0] + ocp.u[0], 1, name="row")
    nx, nz = ocp.x.numel(), ocp.x.numel() + ocp.u.numel()
    component = EconomicGaussNewton(np.eye(nz), np.eye(nx)) if constant else cls()
    return model_of(classify(ocp), Options(**{seam: component}))


def parts(cls: type) -> tuple[Any, Model, Dims]:
    lin = linearization(cls)
    return getattr(lin.parts, cls.seam), lin, lin.dims  # type: ignore[attr-defined]


@every_component
def test_is_a_frozen_dataclass_with_defaults(cls: type) -> None:
    component = cls()
    assert dataclasses.is_dataclass(cls)
    for field in dataclasses.fields(cls):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(component, field.name, getattr(component, field.name))
    assert component == cls()
    assert hash(component) == hash(cls())
    assert repr(component).startswith(f"{cls.__name__}(")


@every_component
def test_has_every_member_of_the_protocol(cls: type) -> None:
    """Class variables have their type, and methods have the parameters that lower.py passes."""
    assert cls.seam in SEAMS  # type: ignore[attr-defined]
    for name in ("name", "template"):
        assert isinstance(getattr(cls, name), str)
        assert name in vars(cls), f"{name} is a class variable of the component itself"
    assert isinstance(cls.needs, tuple)  # type: ignore[attr-defined]
    assert isinstance(cls.supports, frozenset)  # type: ignore[attr-defined]
    for method in ("check", "tables", "sizes", "structs", "cost", "foreign_sources"):
        wanted = list(inspect.signature(getattr(Component, method)).parameters)
        assert list(inspect.signature(getattr(cls, method)).parameters) == wanted, method


@pytest.mark.few(8)
@every_component
def test_template_exists_and_is_included(cls: type) -> None:
    path = template_directory() / cls.template  # type: ignore[attr-defined]
    assert path.is_file()
    module = lower(linearization(cls))
    assert cls.template in {section.template for section in module.sections}  # type: ignore[attr-defined]
    assert f"/* ==== {cls.seam}: {cls.name} =" in text_of(module)[f"{module.name}.c"]  # type: ignore[attr-defined]


@every_component
def test_supports_known_features_and_refuses_the_others(cls: type) -> None:
    component, lin, _ = parts(cls)
    assert component.supports <= FEATURES
    refuse_unsupported(dataclasses.replace(lin.problem, uses=component.supports), [component], REGISTRIES)
    for feature in FEATURES - component.supports:
        problem = dataclasses.replace(lin.problem, uses=frozenset({feature}))
        with pytest.raises(OptionError, match=re.escape(spell(component))):
            refuse_unsupported(problem, [component], REGISTRIES)


@every_component
def test_sizes_and_structs(cls: type) -> None:
    component, _, dims = parts(cls)
    sizes = [*vars(dims).values(), *(vars(dims.qp).values() if dims.condensed else ())]
    common = {size.text for size in sizes if isinstance(size, Size)} | OWN_MACROS
    for name, value, doc in component.sizes(dims):
        assert Macro(name, value, doc)
        assert name.isupper()
        assert name not in common
        assert isinstance(value, int)
        assert doc
    for struct in component.structs(dims):
        assert isinstance(struct, Struct)
        assert all(isinstance(f, Field) and f.doc for f in struct.fields)
        assert len({f.name for f in struct.fields}) == len(struct.fields)


@pytest.mark.few(6)
@every_component
def test_costs_are_of_functions_in_its_own_section(cls: type) -> None:
    component, lin, dims = parts(cls)
    module = lower(lin)
    known = {*(r.name for r in lin.routines), *module.products.counts, *module.products.column_counts}
    cost = component.cost(dims, lin)
    text = text_of(module)[f"{module.name}.c"]
    section = text[text.index(f"/* ==== {component.seam}: ") :].split("/* ==== ")[1]
    for name, count in cost.items():
        assert isinstance(count, OpCount)
        assert f" {name}(" in section
        assert name not in known


def test_macros_structs_and_routines_of_all_components_are_apart() -> None:
    for cls in COMPONENTS:
        lin = linearization(cls)
        module = lower(lin)
        macros = [m.name for m in module.macros]
        assert len(set(macros)) == len(macros)
        structs = [s.name for s in module.structs]
        assert len(set(structs)) == len(structs)
        names = [r.name for r in lin.routines]
        assert len(set(names)) == len(names)
        assert all(isinstance(r, Routine) and r.doc for r in lin.routines)
        members = [f.name for f in module.structs[-1].fields]
        assert len(set(members)) == len(members)
        assert struct_layout(module.structs, "double")["solver"][0] == module.bytes


@every_component
def test_needs_name_seams(cls: type) -> None:
    assert set(cls.needs) <= set(SEAMS) - {cls.seam}  # type: ignore[attr-defined]


# Options --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seam", SEAMS)
@pytest.mark.parametrize("bad", ["word", 3, object, Options])
def test_options_list_what_is_allowed(seam: str, bad: object) -> None:
    names = [cls.__name__ for cls in REGISTRIES[seam].values()]
    with pytest.raises(OptionError, match=rf"{seam}: .*expected {names[0]}\(\.\.\.\)") as caught:
        Options(**{seam: bad})  # type: ignore[arg-type]
    assert all(name in str(caught.value) for name in names)


def test_there_is_always_an_algorithm() -> None:
    with pytest.raises(OptionError, match="algorithm: None"):
        Options(algorithm=None)  # type: ignore[arg-type]


def test_the_algorithm_has_a_hessian_by_default() -> None:
    assert Options().hessian is None
    assert Options().with_defaults.hessian == GaussNewton()
    assert model_of(classify(problem_of("crane")), Options()).parts.hessian == GaussNewton()


def test_components_stand_under_their_own_seam_only() -> None:
    for cls in COMPONENTS:
        for seam in set(SEAMS) - {cls.seam}:
            with pytest.raises(OptionError, match=f"{seam}: "):
                Options(**{seam: cls()})


@pytest.mark.parametrize("precision", ["half", "float", None, 64])
def test_precision(precision: Any) -> None:
    with pytest.raises(OptionError, match=r"precision: .*; expected one of double, single"):
        Options(precision=precision)


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(Online)])
def test_online(field: str) -> None:
    assert Online() == Online(**{field: getattr(Online(), field)})
    with pytest.raises(OptionError, match=f"{field}: 'often'"):
        Online(**{field: "often"})
    with pytest.raises(OptionError, match=r"online: .*expected Online"):
        Options(online=field)  # type: ignore[arg-type]


def test_what_is_not_given_is_chosen_and_said() -> None:
    ode, discrete = (model_of(classify(ocp), Options()) for ocp in (problem_of("crane"), discrete_map()))
    assert ode.parts.integrator.name == "explicit_runge_kutta"
    assert discrete.parts.integrator.name == "discrete"
    for lin in (ode, discrete):
        for seam in ("integrator", "condensing", "qp"):
            chosen = [part for choice in lin.choices.reasons for part in choice.split(";")[0].split(", ")]
            assert f"{seam}: {getattr(lin.parts, seam).name}" in chosen
    given = Options(*(getattr(ode.parts, seam) for seam in SEAMS))
    assert model_of(classify(problem_of("crane")), given).choices.reasons == ()
