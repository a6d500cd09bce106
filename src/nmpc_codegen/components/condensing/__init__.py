"""THE CONDENSING: a component that fulfils `Condensing` of base.py and turns the stage QP into the QP of the qp seam.

C contract: condense_init, condense_prepare, condense_gradient, condense_rows, condense_solve, condense_shift.
``gives`` says which form of QP it hands on, "condensed" or "stages"; a QP solver of the same ``takes`` follows it.
"""

from collections.abc import Mapping

from nmpc_codegen.components.base import Condensing
from nmpc_codegen.components.condensing.full import FullCondensing
from nmpc_codegen.components.condensing.none import NoCondensing
from nmpc_codegen.components.condensing.partial import PartialCondensing

REGISTRY: Mapping[str, type[Condensing]] = {cls.name: cls for cls in (FullCondensing, NoCondensing, PartialCondensing)}

__all__ = ["REGISTRY", "FullCondensing", "NoCondensing", "PartialCondensing"]
