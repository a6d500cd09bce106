"""ADD A QP SOLVER HERE: a component that implements `QpSolver` of base.py; the registry maps its name to its class."""

from collections.abc import Mapping

from nmpc_codegen.components.base import QpSolver
from nmpc_codegen.components.qp.dense_active_set import DenseActiveSet
from nmpc_codegen.components.qp.osqp import Osqp
from nmpc_codegen.components.qp.riccati_active_set import RiccatiActiveSet
from nmpc_codegen.components.qp.riccati_interior_point import RiccatiInteriorPoint

REGISTRY: Mapping[str, type[QpSolver]] = {
    cls.name: cls for cls in (DenseActiveSet, RiccatiActiveSet, RiccatiInteriorPoint, Osqp)
}

__all__ = ["REGISTRY", "DenseActiveSet", "Osqp", "RiccatiActiveSet", "RiccatiInteriorPoint"]
