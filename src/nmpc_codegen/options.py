"""How a problem is solved: typed frozen objects that compose and validate themselves."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from nmpc_codegen.components import algorithms, condensing, hessians, integrators, qp
from nmpc_codegen.components.algorithms import RealTimeIteration
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

    reference: str = "node"
    weight: str = "shared"
    bounds: str = "shared"
    parameter: str = "node"
    dense_weight: bool = False

    def __post_init__(self) -> None:
        for name, layout in self.layouts.items():
            if layout not in LAYOUTS:
                raise OptionError(f"online.{name}: {layout!r}; expected one of {', '.join(LAYOUTS)}")
        if not isinstance(self.dense_weight, bool):
            raise OptionError(f"online.dense_weight: {self.dense_weight!r}; expected True or False")
        if self.dense_weight and self.weight == "fixed":
            raise OptionError('online.dense_weight=True clashes with online.weight="fixed": no weight can be set')

    @property
    def layouts(self) -> dict[str, str]:
        """Kind of data -> how it is stored."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "dense_weight"}


@dataclass(frozen=True)
class Options:
    """One component per seam; None is chosen from the problem, and the report says why."""

    integrator: Any = None
    hessian: Any = field(default_factory=GaussNewton)
    condensing: Any = None
    qp: Any = None
    algorithm: Any = field(default_factory=RealTimeIteration)
    online: Online = field(default_factory=Online)
    precision: str = "double"

    def __post_init__(self) -> None:
        for seam in SEAMS:
            value = getattr(self, seam)
            classes = tuple(REGISTRIES[seam].values())
            optional = seam in ("integrator", "condensing", "qp")
            if not isinstance(value, classes) and not (optional and value is None):
                good = ", ".join(f"{c.__name__}(...)" for c in classes) + (" or None" if optional else "")
                raise OptionError(f"{seam}: {value!r}; expected {good}")
        if not isinstance(self.online, Online):
            raise OptionError(f"online: {self.online!r}; expected Online(...)")
        if self.precision not in PRECISIONS:
            raise OptionError(f"precision: {self.precision!r}; expected one of {', '.join(PRECISIONS)}")

    @property
    def components(self) -> tuple[Component, ...]:
        """The components in the order of their sections; only complete options have them."""
        return tuple(getattr(self, seam) for seam in SEAMS)
