"""How a problem is solved: typed frozen objects that compose and validate themselves."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from nmpc_codegen.components import algorithms, condensing, hessians, integrators, qp
from nmpc_codegen.components.algorithms import RealTimeIteration
from nmpc_codegen.components.allowed import Flag, Words, check_options, option, rules
from nmpc_codegen.components.base import SEAMS, Component
from nmpc_codegen.components.hessians import GaussNewton
from nmpc_codegen.errors import OptionError

REGISTRIES: dict[str, dict[str, Any]] = {
    "integrator": dict(integrators.REGISTRY),
    "hessian": dict(hessians.REGISTRY),
    "condensing": dict(condensing.REGISTRY),
    "qp": dict(qp.REGISTRY),
    "algorithm": dict(algorithms.REGISTRY),
}

PRECISIONS = ("double", "single")

LAYOUTS = ("fixed", "shared", "node")


@dataclass(frozen=True)
class Online:
    """Which data can be changed at run time, and how they are stored.

    "fixed": the declared values, a constant table without a setter; "shared": one for all path nodes and one for the
    terminal node; "node": one for every node. ``dense_weight`` stores the whole matrix of a weight that is declared
    diagonal, so that one with entries off its diagonal can be set.
    """

    reference: str = option("node", Words(LAYOUTS))
    weight: str = option("shared", Words(LAYOUTS))
    bounds: str = option("shared", Words(LAYOUTS))
    parameter: str = option("node", Words(LAYOUTS))
    dense_weight: bool = option(False, Flag())

    def __post_init__(self) -> None:
        check_options(self, "online")
        if self.dense_weight and self.weight == "fixed":
            raise OptionError(
                'Online(dense_weight=True) clashes with Online(weight="fixed"): no weight can be set '
                "(--set online.dense_weight=True, --set online.weight=fixed)"
            )

    @property
    def layouts(self) -> dict[str, str]:
        """Kind of data -> how it is stored."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "dense_weight"}


@dataclass(frozen=True)
class Chosen:
    """Rule of a seam: one of its components, or, ``optional``, None: the compiler chooses."""

    seam: str
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

    integrator: Any = option(None, Chosen("integrator", optional=True))
    hessian: Any = option(GaussNewton(), Chosen("hessian"))
    condensing: Any = option(None, Chosen("condensing", optional=True))
    qp: Any = option(None, Chosen("qp", optional=True))
    algorithm: Any = option(RealTimeIteration(), Chosen("algorithm"))
    online: Online = option(Online(), Group(Online))
    precision: str = option("double", Words(PRECISIONS))
    solve: bool = option(True, Flag())

    def __post_init__(self) -> None:
        check_options(self, "")

    @property
    def components(self) -> tuple[Component, ...]:
        """The components in the order of their sections; only complete options have them."""
        return tuple(getattr(self, seam) for seam in SEAMS)
