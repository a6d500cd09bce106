"""ADD A HESSIAN HERE: a component with seam "hessian" that yields cost and gradient routines of both stages,

the C functions ``expand_node(solver, k, x_next)``, which linearises a node, and ``hessian(solver)``; when both are done
the blocks Q[k] and Q_N are filled (lower triangles, z = (x, u)). Besides the contract of all components it has

    joint_routines(problem, integrator)   routines that the integrator helps to write: integrated costs, curvature
    switches                              with REGULARIZE_REDUCED: an indefinite reduced Hessian is changed
    patterns(routines)                    structural nonzeros of Q and Q_N
"""

from nmpc_codegen.components.hessians.exact import ExactHessian, ForwardOverAdjoint, Symmetric
from nmpc_codegen.components.hessians.gauss_newton import GaussNewton
from nmpc_codegen.components.hessians.identity import IdentityHessian
from nmpc_codegen.components.hessians.regularization import Mirror, Project

REGISTRY: dict[str, type[GaussNewton] | type[ExactHessian] | type[IdentityHessian]] = {
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
