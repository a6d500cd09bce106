"""Derivatives of single-shooting problems are generated as C functions that Python can call.

    x_{k+1} = Phi(x_k, u_k, p_k),   J(u) = sum_k l_k(x_k, u_k, p_k) + l_N(x_N, p_N),   z_k = g(x_k, u_k, p_k)

generate(), export() and build() take an OCP and an expression of outputs; build() returns Derivatives with the gradient
of J, the impulse response matrix dz/du and the sensitivities of the states, each by several methods. The numbers of
algorithms are those of the NTNU thesis of 2009 on adjoint derivatives in NMPC, called [T09].
"""

from nmpc_codegen.derivatives.derivative_package import Folder, build, export, generate, operations
from nmpc_codegen.derivatives.toolbox import GRADIENTS, IMPULSE_RESPONSES, Derivatives, Trajectory

__all__ = [
    "GRADIENTS",
    "IMPULSE_RESPONSES",
    "Derivatives",
    "Folder",
    "Trajectory",
    "build",
    "export",
    "generate",
    "operations",
]
