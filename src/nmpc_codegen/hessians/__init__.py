"""ADD A HESSIAN HERE: a component with seam "hessian" that yields cost, gradient and hessian routines of both stages

and the C function ``hessian(solver)`` that fills the blocks Q[k] and Q_N (lower triangles, z = (x, u)).
"""

from nmpc_codegen.hessians.gauss_newton import GaussNewton

REGISTRY: dict[str, type[GaussNewton]] = {GaussNewton.name: GaussNewton}

__all__ = ["REGISTRY", "GaussNewton"]
