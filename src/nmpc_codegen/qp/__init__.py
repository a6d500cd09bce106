"""QP solvers: one file per solver, found by its word on the command line."""

from nmpc_codegen.qp.dense_active_set import DenseActiveSet

REGISTRY = {DenseActiveSet.name: DenseActiveSet}

__all__ = ["REGISTRY", "DenseActiveSet"]
