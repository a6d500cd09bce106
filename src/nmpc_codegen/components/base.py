"""The seams of the compiler and the contract that every component fulfils.

A component is a frozen dataclass of its own options. lower.py loops over components and never asks which one it holds.
Seams, in the order in which their sections stand in the generated C: integrator, hessian, condensing, qp, algorithm.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

from nmpc_codegen.errors import OptionError

if TYPE_CHECKING:
    from nmpc_codegen.frontend.problem import Problem, Row
    from nmpc_codegen.ir.cmodule import Size, Struct, Table
    from nmpc_codegen.ir.kernel import OpCount
    from nmpc_codegen.ir.sweep import Routine
    from nmpc_codegen.runtime.package_description import Precision

# C function -> operations of one run
Counts = Mapping[str, "OpCount"]

SEAMS = ("integrator", "hessian", "condensing", "qp", "algorithm")


@dataclass(frozen=True)
class Dims:
    """The sizes that components share; each is a Size whose text is a macro of the package (without prefix)."""

    N: Size
    nx: Size
    nu: Size
    nz: Size  # nx + nu
    np: Size
    ny: Size
    ny_N: Size
    nw: Size  # entries of the path weight: ny or ny^2
    nw_N: Size
    nh: Size  # general path rows
    nh_N: Size  # general terminal rows
    nr: Size  # scalar rows the user stated
    nq: Size  # Hessian blocks of the path: 1 where the block is the same at all nodes, else N
    nf: Size  # free components of x_0
    ne: Size  # coupled rows
    ns: Size  # stages of the QP after condensing
    nus: Size  # controls of such a stage
    nxs: Size  # states of such a stage: nx and copies of components of x_0
    nzs: Size  # nxs + nus
    nv: Size  # variables of the QP
    nsl: Size  # slacks among them
    ng: Size  # rows of the QP besides control bounds
    ld: Size  # leading dimension of condensed matrices: nv rounded up to PANEL


@dataclass(frozen=True)
class QpShape:
    """What a condensing component makes of N stages with nu controls each.

    ``stages`` of ``controls`` controls; ``variables`` of the QP: the controls of all stages, and what else it adds to
    them; ``slacks`` among the variables; ``copies`` of components of x_0 among the states of a stage.
    """

    stages: int
    controls: int
    variables: int
    slacks: int = 0
    copies: int = 0


class Component(Protocol):
    """What lower.py asks of a component.

    A condensing component has besides qp_shape(problem) -> QpShape, adapted(problem) -> the component that does the
    same for this problem, itself as a rule, ``gives``, the form of QP it hands on ("condensed", "stages"), and
    ``columns``: it calls the products with columns.
    A QP solver has ``takes``, the form it reads, and ``automatic``: qp=None may choose it.
    """

    seam: ClassVar[str]
    name: ClassVar[str]  # the word of the command line
    template: ClassVar[str]  # its part, below templates/
    needs: ClassVar[tuple[str, ...]]  # other seams whose contract it calls
    supports: ClassVar[frozenset[str]]  # problem features it takes

    def routines(self, problem: Problem) -> tuple[Routine, ...]:
        """Functions lifted from CasADi that its template calls."""
        ...

    @property
    def switches(self) -> Mapping[str, int]:
        """Names that its part tests in `#if` besides the sizes, 1 or 0; they do not stand in the header."""
        ...

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Constant tables that its template reads."""
        ...

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Further compile-time sizes: (macro without prefix, value, meaning)."""
        ...

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """The structs it owns inside the solver struct."""
        ...

    def cost(self, dims: Dims, known: Counts) -> dict[str, OpCount]:
        """Exact operation counts of its C functions whose count does not depend on data, by function name.

        ``known`` has the counts of what they call: the printed routines and the stage products.
        """
        ...

    def foreign_sources(self, prefix: str, precision: Precision, dims: Dims) -> Mapping[str, str]:
        """Code of another generator: path, below a folder of the component's name, -> text."""
        ...


class Defaults:
    """A component that adds nothing to a package besides its part."""

    @property
    def switches(self) -> Mapping[str, int]:
        return {}

    def foreign_sources(self, prefix: str, precision: Precision, dims: Dims) -> Mapping[str, str]:
        return {}


def called(component: Component | type[Component]) -> str:
    """A component as its user names it: in Python, and on the command line."""
    cls = component if isinstance(component, type) else type(component)
    return f"{cls.__name__}() (--set {cls.seam}={cls.name})"


def refuse_unsupported(
    problem: Problem, components: Iterable[Component], registries: Mapping[str, Mapping[str, type[Component]]]
) -> None:
    """Raise OptionError if the problem uses a feature that a chosen component does not take; name those that do."""
    for component in components:
        missing = sorted(problem.features - component.supports)
        if missing:
            named = ", ".join(r.name for r in problem.rows if any(_uses(r, feature) for feature in missing))
            where = f" ({named})" if named else ""
            able = [called(c) for c in registries[component.seam].values() if c.supports.issuperset(missing)]
            offer = f"choose {' or '.join(able)}" if able else f"no {component.seam} of this version does"
            refused = f"which {component.seam} {called(component)} does not support"
            raise OptionError(f"{problem.name} uses {' and '.join(missing)}{where}, {refused}; {offer}")


def _uses(row: Row, feature: str) -> bool:
    return (feature == "soft rows" and row.soft is not None) or (feature == "coupled rows" and row.kind == "coupled")
