"""THE CONDENSING: a component with seam "condensing" that turns the stage QP into the QP of the qp seam.

C contract: condense_init, condense_hessian, condense_gradient, condense_rows, condense_embed, condense_expand.
"""

from nmpc_codegen.condensing.full import FullCondensing

REGISTRY: dict[str, type[FullCondensing]] = {FullCondensing.name: FullCondensing}

__all__ = ["REGISTRY", "FullCondensing"]
