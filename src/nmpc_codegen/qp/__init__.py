"""QP solvers: one file per solver, found by its word on the command line."""

from typing import Any

from nmpc_codegen.qp.dense_active_set import DenseActiveSet
from nmpc_codegen.qp.osqp import Osqp

REGISTRY: dict[str, Any] = {cls.name: cls for cls in (DenseActiveSet, Osqp)}

__all__ = ["REGISTRY", "DenseActiveSet", "Osqp"]
