"""QP solvers: one file per solver, found by its word on the command line."""

from typing import Any

from nmpc_codegen.components.qp.dense_active_set import DenseActiveSet
from nmpc_codegen.components.qp.osqp import Osqp
from nmpc_codegen.components.qp.riccati_active_set import RiccatiActiveSet
from nmpc_codegen.components.qp.riccati_interior_point import RiccatiInteriorPoint

REGISTRY: dict[str, Any] = {cls.name: cls for cls in (DenseActiveSet, RiccatiActiveSet, RiccatiInteriorPoint, Osqp)}

__all__ = ["REGISTRY", "DenseActiveSet", "Osqp", "RiccatiActiveSet", "RiccatiInteriorPoint"]
