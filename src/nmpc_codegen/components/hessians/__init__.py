"""ADD A HESSIAN HERE: a component that implements `Hessian` of base.py.

blocks() returns the routines of all stages. The C functions of a Hessian are ``expand_node(solver, k, x_next)``, which
linearises a node, and ``hessian(solver)``; after both have run, the blocks Q[k] and Q_N are filled (lower triangles,
z = (x, u)). Its feature ``regularize_reduced`` is True if an indefinite reduced Hessian is changed.
"""

from collections.abc import Mapping

from nmpc_codegen.components.base import Hessian
from nmpc_codegen.components.hessians.economic_gauss_newton import EconomicGaussNewton
from nmpc_codegen.components.hessians.exact import ExactHessian, ForwardOverAdjoint, Symmetric
from nmpc_codegen.components.hessians.gauss_newton import GaussNewton
from nmpc_codegen.components.hessians.regularization import Mirror, Project

REGISTRY: Mapping[str, type[Hessian]] = {
    GaussNewton.name: GaussNewton,
    ExactHessian.name: ExactHessian,
    EconomicGaussNewton.name: EconomicGaussNewton,
}

__all__ = [
    "REGISTRY",
    "EconomicGaussNewton",
    "ExactHessian",
    "ForwardOverAdjoint",
    "GaussNewton",
    "Mirror",
    "Project",
    "Symmetric",
]
