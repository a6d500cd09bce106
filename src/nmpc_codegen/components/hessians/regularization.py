"""An indefinite Hessian is regularised by changing eigenvalues of every stage block or of the reduced Hessian.

    V max(|Lambda|, floor) V'   (mirror; Quirynen et al., CDC 2014, eq. 4)      V max(Lambda, floor) V'   (project)

floor = 1e-8 times the largest |Lambda| of the block; for a zero block, the largest entry of all blocks replaces
|Lambda|. At level "reduced" the predicted working set is held first (templates/riccati/convexify.c,
templates/hessians/regularize_reduced.c); a mirrored eigenvalue is raised by a tenth of the most negative one. On stages
the reduced Hessian is not formed: its diagonal is shifted, in units D of the variables,

    H + 9/8 s D   (project)      H + 2 s D   (mirror)      s: the smallest of 1e-3 4^n with H + s D positive definite

The condensed Hessian is also treated in units of its variables. solve() has its own method
(templates/algorithms/solve/curved.c).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nmpc_codegen.components.allowed import Words, check_options, option

LEVELS = ("reduced", "stage")


@dataclass(frozen=True)
class EigenvalueFloor:
    """A regularisation changes eigenvalues of the block of every node, or of the Hessian without the states."""

    level: str = option("reduced", Words(LEVELS))

    mirrors: ClassVar[bool]  # True: negative eigenvalues change their sign; False: they are raised to the floor

    def __post_init__(self) -> None:
        check_options(self, "hessian.regularization")


@dataclass(frozen=True)
class Project(EigenvalueFloor):
    """The regularisation raises eigenvalues below the floor to the floor.

    Args:
        level: as in Mirror.
    """

    mirrors: ClassVar[bool] = False


@dataclass(frozen=True)
class Mirror(EigenvalueFloor):
    """The regularisation changes the sign of negative eigenvalues, and raises small ones to the floor.

    It is the default.

    Args:
        level: "reduced" changes the Hessian on the predicted working set, and only if it is not positive definite;
            "stage" treats the block of every node.
    """

    mirrors: ClassVar[bool] = True
