"""ADD A CONDENSING HERE: a component that implements `Condensing` of base.py: it converts the stage QP for a solver.

C contract: condense_init, condense_prepare, condense_gradient, condense_rows, condense_solve, condense_shift.
``gives`` is the form of the resulting QP, "condensed" or "stages"; the QP solver must have the same ``takes``.
"""

from collections.abc import Mapping

from nmpc_codegen.components.base import Condensing
from nmpc_codegen.components.condensing.full import FullCondensing
from nmpc_codegen.components.condensing.none import NoCondensing

REGISTRY: Mapping[str, type[Condensing]] = {cls.name: cls for cls in (FullCondensing, NoCondensing)}

__all__ = ["REGISTRY", "FullCondensing", "NoCondensing"]
