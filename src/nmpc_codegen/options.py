"""How a problem is solved: typed frozen objects that compose and validate themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

from nmpc_codegen.components import algorithms, condensing, hessians, integrators, qp
from nmpc_codegen.components.algorithms import RealTimeIteration
from nmpc_codegen.components.allowed import Flag, Words, check_options, option, rules
from nmpc_codegen.components.base import Algorithm, Component, Condensing, Hessian, Integrator, QpSolver, Seam
from nmpc_codegen.components.hessians import GaussNewton
from nmpc_codegen.errors import OptionError
from nmpc_codegen.runtime.package_description import Layout, Layouts, Precision

REGISTRIES: Mapping[str, Mapping[str, type[Component]]] = {
    "integrator": integrators.REGISTRY,
    "hessian": hessians.REGISTRY,
    "condensing": condensing.REGISTRY,
    "qp": qp.REGISTRY,
    "algorithm": algorithms.REGISTRY,
}

PRECISIONS: tuple[Precision, ...] = get_args(Precision)

LAYOUTS: tuple[Layout, ...] = get_args(Layout)


@dataclass(frozen=True)
class Online:
    """Which data can be changed at run time, and how they are stored.

    "fixed": the declared values, a constant table without a setter; "shared": one for all path nodes and one for the
    terminal node; "node": one for every node. ``dense_weight`` stores the whole matrix of a weight that is declared
    diagonal, so that one with entries off its diagonal can be set.
    """

    reference: Layout = option("node", Words(LAYOUTS))
    weight: Layout = option("shared", Words(LAYOUTS))
    bounds: Layout = option("shared", Words(LAYOUTS))
    parameter: Layout = option("node", Words(LAYOUTS))
    dense_weight: bool = option(False, Flag())

    def __post_init__(self) -> None:
        check_options(self, "online")
        if self.dense_weight and self.weight == "fixed":
            raise OptionError(
                'Online(dense_weight=True) clashes with Online(weight="fixed"): no weight can be set '
                "(--set online.dense_weight=True, --set online.weight=fixed)"
            )

    @property
    def layouts(self) -> Layouts:
        """Kind of data -> how it is stored."""
        return {
            "reference": self.reference,
            "weight": self.weight,
            "bounds": self.bounds,
            "parameter": self.parameter,
        }


@dataclass(frozen=True)
class Chosen:
    """Rule of a seam: one of its components, or, ``optional``, None: the compiler chooses."""

    seam: Seam
    optional: bool = False

    def converted(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        return isinstance(value, tuple(REGISTRIES[self.seam].values())) or (self.optional and value is None)

    def __str__(self) -> str:
        classes = REGISTRIES[self.seam]
        objects = ", ".join(f"{c.__name__}(...)" for c in classes.values())
        return f"{objects}{' or None' if self.optional else ''}; on the command line {', '.join(classes)}"


@dataclass(frozen=True)
class Group:
    """Rule of a group of options: an object of its class; on the command line its options one by one."""

    cls: type

    def converted(self, value: Any) -> Any:
        return value

    def takes(self, value: Any) -> bool:
        return isinstance(value, self.cls)

    def __str__(self) -> str:
        return f"{self.cls.__name__}(...); on the command line {', '.join(rules(self.cls))} one by one"


@dataclass(frozen=True)
class Options:
    """One component per seam; None is chosen from the problem, and the report says why.

    ``solve``: whether the package has <name>_solve(), which iterates to convergence; a controller for the real time
    alone is smaller without.
    """

    integrator: Integrator | None = option(None, Chosen("integrator", optional=True))
    hessian: Hessian = option(GaussNewton(), Chosen("hessian"))
    condensing: Condensing | None = option(None, Chosen("condensing", optional=True))
    qp: QpSolver | None = option(None, Chosen("qp", optional=True))
    algorithm: Algorithm = option(RealTimeIteration(), Chosen("algorithm"))
    online: Online = option(Online(), Group(Online))
    precision: Precision = option("double", Words(PRECISIONS))
    solve: bool = option(True, Flag())

    def __post_init__(self) -> None:
        check_options(self, "")
