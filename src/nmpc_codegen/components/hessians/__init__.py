"""ADD A HESSIAN HERE: a component that fulfils `Hessian` of base.py.

quadratic_model() has the functions of both stages. Its C functions are ``expand_node(solver, k, x_next)``, which
linearises a node, and ``hessian(solver)``; when both are done the blocks Q[k] and Q_N are filled (lower triangles,
z = (x, u)). Its ``switches`` have REGULARIZE_REDUCED: an indefinite reduced Hessian is changed.
"""

from collections.abc import Mapping

from nmpc_codegen.components.base import Hessian
from nmpc_codegen.components.hessians.exact import ExactHessian, ForwardOverAdjoint, Symmetric
from nmpc_codegen.components.hessians.gauss_newton import GaussNewton
from nmpc_codegen.components.hessians.identity import IdentityHessian
from nmpc_codegen.components.hessians.regularization import Mirror, Project

REGISTRY: Mapping[str, type[Hessian]] = {
    GaussNewton.name: GaussNewton,
    ExactHessian.name: ExactHessian,
    IdentityHessian.name: IdentityHessian,
}

__all__ = [
    "REGISTRY",
    "ExactHessian",
    "ForwardOverAdjoint",
    "GaussNewton",
    "IdentityHessian",
    "Mirror",
    "Project",
    "Symmetric",
]
