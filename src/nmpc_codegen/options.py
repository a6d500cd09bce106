"""How a problem is solved: typed frozen objects that compose and validate themselves."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from nmpc_codegen import algorithms, condensing, hessians, integrators, qp
from nmpc_codegen.algorithms import RealTimeIteration
from nmpc_codegen.component import SEAMS, Component
from nmpc_codegen.errors import OptionError
from nmpc_codegen.hessians import GaussNewton

REGISTRIES: dict[str, dict[str, Any]] = {
    "integrator": dict(integrators.REGISTRY),
    "hessian": dict(hessians.REGISTRY),
    "condensing": dict(condensing.REGISTRY),
    "qp": dict(qp.REGISTRY),
    "algorithm": dict(algorithms.REGISTRY),
}

PRECISIONS = ("double", "single")

_ONLINE = {"reference": "node", "weight": "shared", "bounds": "shared", "parameter": "node"}


@dataclass(frozen=True)
class Online:
    """Which data can be changed at run time, and whether per node or shared by all path nodes.

    This version has one layout: references and parameters per node, weights and bounds shared (one for the path, one
    for the terminal node).
    """

    reference: str = "node"
    weight: str = "shared"
    bounds: str = "shared"
    parameter: str = "node"

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value != _ONLINE[f.name]:
                raise OptionError(f'online.{f.name}: {value!r}; this version supports "{_ONLINE[f.name]}" only')


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
