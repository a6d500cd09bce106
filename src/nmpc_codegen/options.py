"""Options determine how a problem is solved; they are typed frozen objects that validate themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from numbers import Real
from typing import Any, Literal, TypeVar, get_args

from nmpc_codegen.components import algorithms, condensing, hessians, integrators, qp
from nmpc_codegen.components.algorithms import KalmanFilter, MovingHorizon, RealTimeIteration
from nmpc_codegen.components.allowed import Flag, Words, check_options, option, rules
from nmpc_codegen.components.base import (
    SEAMS,
    Algorithm,
    Component,
    Condensing,
    Hessian,
    Integrator,
    QpSolver,
    Seam,
    spell,
)
from nmpc_codegen.errors import OptionError
from nmpc_codegen.package.kinds import EstimatorKind
from nmpc_codegen.package.signals import Layout, Layouts
from nmpc_codegen.package.struct_layout import Precision
from nmpc_codegen.runtime.native import native
from nmpc_codegen.targets import MATHS, NATIVE, TARGETS, Math, Target

REGISTRIES: Mapping[str, Mapping[str, type[Component]]] = {
    "integrator": integrators.REGISTRY,
    "hessian": hessians.REGISTRY,
    "condensing": condensing.REGISTRY,
    "qp": qp.REGISTRY,
    "algorithm": algorithms.REGISTRY,
}

C = TypeVar("C", bound=Component)

PRECISIONS: tuple[Precision, ...] = get_args(Precision)

LAYOUTS: tuple[Layout, ...] = get_args(Layout)

Goal = Literal["speed", "size"]
GOALS: tuple[Goal, ...] = get_args(Goal)


@dataclass(frozen=True)
class Online:
    """Online options choose the storage of the data that can be changed at run time.

    "fixed": the declared values, in a constant table without a setter; "shared": one value for all path nodes and one
    for the terminal node; "node": one value for every node. Unneeded setters and memory are left out of the package.

    Args:
        reference: references of the residuals.
        weight: their weights.
        bounds: bounds of the rows.
        parameter: values of the parameters.
        dense_weight: store the whole matrix of a weight that is declared diagonal, so that a weight with off-diagonal
            entries can be set; clashes with weight="fixed".
        soft: penalties of soft rows.

    Examples:
        >>> from nmpc_codegen import Online, Options
        >>> options = Options(online=Online(weight="fixed", parameter="shared"))
    """

    reference: Layout = option("node", Words(LAYOUTS))
    weight: Layout = option("shared", Words(LAYOUTS))
    bounds: Layout = option("shared", Words(LAYOUTS))
    parameter: Layout = option("node", Words(LAYOUTS))
    dense_weight: bool = option(False, Flag())
    soft: Layout = option("shared", Words(LAYOUTS))

    def __post_init__(self) -> None:
        check_options(self, "online")
        if self.dense_weight and self.weight == "fixed":
            raise OptionError(
                'Online(dense_weight=True) clashes with Online(weight="fixed"): no weight can be set '
                "(--set online.dense_weight=True, --set online.weight=fixed)"
            )

    @property
    def layouts(self) -> Layouts:
        """Return {kind of data: its storage}."""
        return {
            "reference": self.reference,
            "weight": self.weight,
            "bounds": self.bounds,
            "parameter": self.parameter,
            "soft": self.soft,
        }


@dataclass(frozen=True)
class Chosen:
    """The rule of a seam allows one of its components or, if ``optional``, None, with which the compiler chooses."""

    seam: Seam
    optional: bool = False

    def convert(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        return isinstance(value, tuple(REGISTRIES[self.seam].values())) or (self.optional and value is None)

    def __str__(self) -> str:
        classes = REGISTRIES[self.seam]
        objects = ", ".join(f"{c.__name__}(...)" for c in classes.values())
        return f"{objects}{' or None' if self.optional else ''}; on the command line {', '.join(classes)}"


@dataclass(frozen=True)
class Group:
    """The rule of a group of options allows an object of its class; the command line sets its options one by one."""

    cls: type

    def convert(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        return isinstance(value, self.cls)

    def __str__(self) -> str:
        return f"{self.cls.__name__}(...); on the command line {', '.join(rules(self.cls))} one by one"


@dataclass(frozen=True)
class Options:
    """Options choose one component for every part of the algorithm, the storage of data, and the form of the C.

    A component that is None is the default of the algorithm, or the compiler chooses it for the problem; the report
    gives the reason. All targets follow the same options; their results differ only by rounding.

    Args:
        integrator: the scheme of the dynamics.
        hessian: second derivatives of the QP.
        condensing: which states the QP keeps as variables.
        qp: the QP solver.
        algorithm: the method of a sample.
        online: storage of the data that can be changed at run time.
        precision: precision of all numbers of the package.
        solve: True or None: generate <name>_solve(), which iterates to convergence, and an exact Hessian for it and for
            samples that iterate. False: a smaller controller for real-time use only.
        math: "own": the package contains exp, sin, pow and similar functions, so that every machine computes the same
            bits and no libm is needed; "libm": it calls math.h. None: "own" for a microcontroller, else "libm".
        goal: "size": loops instead of straight-line code, matrices without padding and the smallest QP method; "speed":
            the fastest form.
        target: the machine for which export() and build() write the C; "portable" is ISO C99 for any machine, "native"
            the target of this machine.

    Raises:
        OptionError: a value is not allowed, or a component is given for a part that the algorithm does not have.

    Examples:
        >>> from nmpc_codegen import RK4, ExplicitRungeKutta, GaussNewton, Options
        >>> options = Options(integrator=ExplicitRungeKutta(RK4, steps=2), hessian=GaussNewton(), precision="single")
    """

    integrator: Integrator | None = option(None, Chosen("integrator", optional=True))
    hessian: Hessian | None = option(None, Chosen("hessian", optional=True))
    condensing: Condensing | None = option(None, Chosen("condensing", optional=True))
    qp: QpSolver | None = option(None, Chosen("qp", optional=True))
    algorithm: Algorithm = option(RealTimeIteration(), Chosen("algorithm"))
    online: Online = option(Online(), Group(Online))
    precision: Precision = option("double", Words(PRECISIONS))
    solve: bool | None = option(None, Flag(optional=True))
    math: Math | None = option(None, Words((*MATHS, None)))
    goal: Goal = option("speed", Words(GOALS))
    target: str = option("portable", Words((NATIVE, *TARGETS)))

    def __post_init__(self) -> None:
        check_options(self, "")
        for seam in SEAMS:
            given = getattr(self, seam)
            if seam != "algorithm" and given is not None and seam not in self.algorithm.needs:
                needed = ", ".join(self.algorithm.needs)
                raise OptionError(
                    f"{seam} {spell(given)} clashes with algorithm {spell(self.algorithm)}, which takes none; "
                    f"it needs {needed}"
                )

    def _repr_html_(self) -> str:
        """Return a table of all options with their values; given options are marked."""
        from nmpc_codegen.pictures.html import page, table

        mine, complete, default = as_data(self), as_data(self.with_defaults), as_data(Options())
        rows: list[tuple[object, ...]] = []
        for name, value in complete.items():
            given = name in mine and (name not in default or mine[name] != default[name])
            open_seam = value is None and name in SEAMS and name in self.algorithm.needs
            shown = "chosen from the problem" if open_seam else "" if value is None else value
            rows.append((name, shown, "given" if given else ""))
        return page("Options", "what is not given has its default", [table(("option", "value", ""), rows)])

    @property
    def with_defaults(self) -> Options:
        """Return these options with the open ones filled in.

        The algorithm's default Hessian is taken unless one is given, "native" becomes the target of this machine, and
        ``solve`` is decided.
        """
        word = self.algorithm.default_hessian
        hessian = self.hessian or (None if word is None else hessians.REGISTRY[word]())
        return replace(self, hessian=hessian, target=self.machine.name, solve=self.solves)

    @property
    def machine(self) -> Target:
        """Return the target; "native" becomes the target of this machine.

        Raises:
            BuildError: the target is "native", and there is no compiler.
        """
        return native() if self.target == NATIVE else TARGETS[self.target]

    @property
    def stores_matrices(self) -> bool:
        """Return True if weights that are declared diagonal are stored as matrices."""
        return self.online.dense_weight

    @property
    def limits_steps(self) -> bool:
        """Return True if proximal terms may limit steps: samples solve QPs with a Hessian that the compiler chooses."""
        return self.hessian is None and "qp" in self.algorithm.needs

    @property
    def solves(self) -> bool:
        """Return True if the package has a solve()."""
        return self.solve is not False


def for_estimator(options: Options, kind: EstimatorKind) -> Options:
    """Return the options of an estimator, with its own defaults for algorithm and storage of data.

    Raises:
        OptionError: an option is given that estimators do not have.
    """
    if options.solve or options.online != Online():
        word = "solve" if options.solve else "online"
        raise OptionError(f"{word}: {getattr(options, word)!r}; an estimator has no solve() and its own data of nodes")
    parameter: Layout = "node" if kind == "mhe" else "shared"
    online = Online("fixed", "fixed", "shared", parameter, False, "fixed")
    algorithm: Algorithm = MovingHorizon() if kind == "mhe" else KalmanFilter()
    given = options.algorithm if options.algorithm != RealTimeIteration() else algorithm
    return replace(options, algorithm=given, online=online, solve=False)


def common_options(options: Options | None) -> Options:
    """Return the options that an estimator beside a controller shares with the controller."""
    given = options or Options()
    names = ("integrator", "precision", "math", "goal", "target")
    return Options(**{name: getattr(given, name) for name in names})


def as_data(value: Any, path: str = "") -> dict[str, Any]:
    """Return options as {dotted name: value}, as for --set.

    A component, or another object, has the name of its class as its value, and its own options follow; matrices are
    lists.
    """
    if not is_dataclass(value):
        return {path: _plain(value)}
    found: dict[str, Any] = {path: type(value).__name__} if path else {}
    for field in fields(value):
        found |= as_data(getattr(value, field.name), f"{path}.{field.name}" if path else field.name)
    return found


def _plain(value: Any) -> Any:
    """Convert a value of an option for JSON: a number, a string, a list of them, else its repr()."""
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if value is None or isinstance(value, (int, str)):
        return value
    return float(value) if isinstance(value, Real) and math.isfinite(value) else repr(value)
