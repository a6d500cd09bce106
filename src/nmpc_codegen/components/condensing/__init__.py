"""THE CONDENSING: a component with seam "condensing" that turns the stage QP into the QP of the qp seam.

C contract: condense_init, condense_prepare, condense_gradient, condense_rows, condense_solve, condense_shift.
``gives`` says which form of QP it hands on, "condensed" or "stages"; a QP solver of the same ``takes`` follows it.
"""

from typing import Any

from nmpc_codegen.components.condensing.full import FullCondensing
from nmpc_codegen.components.condensing.none import NoCondensing
from nmpc_codegen.components.condensing.partial import PartialCondensing

REGISTRY: dict[str, Any] = {cls.name: cls for cls in (FullCondensing, NoCondensing, PartialCondensing)}

__all__ = ["REGISTRY", "FullCondensing", "NoCondensing", "PartialCondensing"]
