"""The seams of the compiler are the interfaces of its components; each has a contract that every component fulfils.

A component is a frozen dataclass of its own options. Every seam has one protocol; the compiler uses nothing else and
never tests which component it has. The seams, in the order of their sections in the generated C, are integrator,
hessian, condensing, qp and algorithm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self, get_args

from nmpc_codegen.errors import OptionError
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.signals import list_some
from nmpc_codegen.package.struct_layout import Size

if TYPE_CHECKING:
    from nmpc_codegen.components.stage_cost import StageCosts
    from nmpc_codegen.frontend.completion.complete import CompleteProblem
    from nmpc_codegen.frontend.problem import Problem, Row
    from nmpc_codegen.ir.cmodule import Table
    from nmpc_codegen.ir.kernel import Port
    from nmpc_codegen.ir.model import HessianModel, Interval, IntervalProducts, ModelFunctions
    from nmpc_codegen.ir.stage_products import Products
    from nmpc_codegen.ir.sweep import Call, Routine
    from nmpc_codegen.package.estimation import Estimation
    from nmpc_codegen.package.features import Features
    from nmpc_codegen.package.signals import EntryPoint
    from nmpc_codegen.package.struct_layout import Precision, Struct

# C function -> operations of one run
Counts = Mapping[str, OpCount]

#: (x, u, p, dt) -> d x_next / d(x, u).
Transition = Callable[[Any, Any, Any, float], Any]

Seam = Literal["integrator", "hessian", "condensing", "qp", "algorithm"]

SEAMS: tuple[Seam, ...] = get_args(Seam)

#: The use of variables that Newton's method solves for.
NONLINEAR = "nonlinear algebraic equations"

#: The use that a recursion over the stages cannot support.
COUPLED_START = "rows that couple x_N with free components of x_0"

#: The use of estimators.
MEASUREMENTS = "measurements"

#: Everything that a problem may use beyond the core (``Problem.uses``). A component states its supported uses by
#: subtraction: a new use must be subtracted where it is not supported.
EVERY_USE = frozenset(
    {
        "general cost",
        "integrated cost",
        "accumulators",
        "free initial state",
        "soft rows",
        "rows with an infinite penalty",
        "coupled rows",
        "previous controls",
        "blocks of controls",
        "time",
        "discrete states",
        COUPLED_START,
        NONLINEAR,
        MEASUREMENTS,
    }
)

#: Uses that components support whose QP keeps the states.
USES_OF_STAGES = EVERY_USE - {COUPLED_START}

#: Parts of the core that an algorithm can use: the linearisation of every node, the multipliers, products with the
#: stage matrices, the KKT residuals, and products of the derivatives of an interval and of the cost with vectors.
Core = Literal["nodes", "multipliers", "products", "kkt", "directions"]


@dataclass(frozen=True)
class Dims:
    """Components share these sizes; each is a Size whose text is a macro of the package (without prefix)."""

    N: Size
    nx: Size
    nxhat: Size  # states of the user
    nu: Size
    nz: Size  # nx + nu
    np: Size
    ny: Size
    ny_N: Size
    nw: Size  # entries of the path weight: ny or ny^2
    nw_N: Size
    nh: Size  # general path rows
    nh_N: Size  # general terminal rows
    nr: Size  # scalar rows that the user stated
    nq: Size  # Hessian blocks of the path: 1 where the block is the same at all nodes, else N
    nf: Size  # free components of x_0
    ne: Size  # coupled rows
    ng: Size  # scalar rows of all nodes besides control bounds
    nalg: Size  # algebraic variables that Newton's method solves for
    nm: Size  # measurements of an estimator
    nin: Size  # controls of its plant
    condensed: QpDims | None  # sizes of the QP, None without condensing
    end_rows: int = 0  # hard rows that hold only at node N
    banded: int = 0  # number of last states that store previous controls and act on no state
    estimation: Estimation | None = None
    multiple: int = PANEL  # leading dimensions of stage matrices are rounded up to it; 1: no padding

    @property
    def nodes(self) -> Size:
        """Return the number of shooting nodes with the terminal one."""
        return Size("N + 1", self.N + 1)

    @property
    def constraints(self) -> Size:
        """Return the number of bounds of the controls of the QP and of its rows."""
        return Size(f"{self.qp.nv.text} + {self.ng.text}", self.qp.nv + self.ng)

    @property
    def qp(self) -> QpDims:
        """Return the sizes of the QP.

        Raises:
            ValueError: the package has no QP.
        """
        if self.condensed is None:
            raise ValueError("a package without condensing has no QP")
        return self.condensed


@dataclass(frozen=True)
class QpDims:
    """The QP that condensing forms has these sizes."""

    nvu: Size  # controls that are variables of the QP
    nv: Size  # variables of the QP
    nsl: Size  # slacks among them
    ld: Size  # nv rounded up to PANEL
    ldh: Size  # nv - nsl rounded up to PANEL


@dataclass(frozen=True)
class QpShape:
    """The QP that a condensing component forms has this shape.

    Its ``variables`` are ``controls`` and those that the component adds, of which ``slacks`` are slack variables.
    """

    controls: int
    variables: int
    slacks: int = 0


#: Names of the hooks of algorithms, and where they are called. A part in C states a hook as a call:
#: ``before_prepare(s);``, ``status = after_prepare(s, status);``. The generator writes one call for every hooked part
#: that defines the hook, in the order of hooked_parts(); a hook without a definition is removed.
HOOKS = {
    "on_reset": "init() and reset(), after the plan has been set",
    "before_prepare": "prepare(), before anything is evaluated",
    "after_prepare": "prepare(), with its status; returns the status",
    "before_sample": "step(), with the measured state",
    "before_qp": "feedback(), before the QP is solved",
    "after_qp": "feedback(), with the status of the QP; returns the status",
    "before_step": "feedback(), before the step of a QP that has been solved, with its status",
    "on_success": "feedback(), after the step has been taken, with the status of the QP",
    "after_feedback": "feedback(), with the status of the sample; returns the status",
    "before_solve": "solve(), before the first iteration",
    "place_terms": "single shooting: terms of the rows as far from them (0), or as close (1), as in a sample",
    "before_steps": "single shooting: a sample, before its steps",
    "follow_terms": "single shooting: a sample, after its steps; 1: all were accepted at once",
}


def _nothing(dims: Dims) -> tuple[Struct, ...]:
    return ()


@dataclass(frozen=True)
class HookedPart:
    """A hooked part is a C file in templates/hooked/ with this name, and the structs that the file needs."""

    name: str
    structs: Callable[[Dims], tuple[Struct, ...]] = _nothing

    @property
    def part(self) -> str:
        """Return the path of the file in templates/."""
        return f"hooked/{self.name}.c"


class Component(Protocol):
    """All components, of any seam, have this interface; the defaults add only the component's C file."""

    seam: ClassVar[Seam]
    name: ClassVar[str]  # its word on the command line
    template: ClassVar[str]  # path of its part below templates/
    needs: ClassVar[tuple[Seam, ...]] = ()  # other seams that a package with it must have
    supports: ClassVar[frozenset[str]]  # uses of a problem that it supports

    def check(self, problem: Problem) -> None:
        """Raise OptionError if options of this component clash with the problem."""
        return

    def adds(self, features: Features) -> Features:
        """Return the features of a package with this component.

        The argument holds the features of the problem and of the components before it.
        """
        return features

    def hooked_parts(self, features: Features) -> tuple[HookedPart, ...]:
        """Return the C files that run for this component at the hooks of the algorithm, in this order."""
        return ()

    @property
    def places(self) -> Mapping[str, str]:
        """Return {further kernel argument: its location in a node}, as in {"K": "(s)->stages.K[k]"}."""
        return {}

    def notes(self, problem: Problem) -> tuple[str, ...]:
        """Return notes for the user of a package with this component, which become part of the report."""
        return ()

    def tables(self, problem: CompleteProblem) -> tuple[Table, ...]:
        """Return the constant tables that the component's template reads."""
        return ()

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Return further compile-time sizes: (macro without prefix, value, meaning)."""
        return ()

    def absent_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        """Return sizes that the component's C files name and this package does not need."""
        return ()

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the structs of this component inside the solver struct."""
        return ()

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        """Return {integer member that limits loops: (least, largest value)}, for the worst case."""
        return {}

    def cost(self, dims: Dims, model: ModelFunctions) -> Counts:
        """Return exact operation counts of the component's C functions, except those whose count depends on data.

        ``model`` provides the functions that they call: the lifted functions and the stage products.
        """
        return {}

    def foreign_sources(self, prefix: str, precision: Precision, dims: Dims) -> Mapping[str, str]:
        """Return code of another generator: {path in a folder named after the component: text}."""
        return {}


class Integrator(Component, Protocol):
    """Computes the state at the next node and its derivatives."""

    seam: ClassVar[Seam] = "integrator"

    @property
    def small(self) -> Self:
        """Return this integrator with the least code that its options allow."""
        ...

    def longest_step(self, problem: Problem) -> float:
        """Return the length (s) of the longest integration step."""
        ...

    def interval(self, problem: Problem) -> Interval:
        """Return integrator_interval(x, u, p, dt -> x_next, S) and integrator_step(x, u, p, h -> x_next)."""
        ...

    def products(self, problem: Problem) -> IntervalProducts:
        """Return integrator_value, integrator_adjoint, integrator_forced and integrator_free."""
        ...

    def directional(self, problem: Problem) -> tuple[Routine, Routine]:
        """Return integrator_forward(x, u, p, dt, dx, du -> dx_next) and integrator_adjoint(x, u, p, dt, adj -> g)."""
        ...

    def lift_hessian(self, problem: Problem, scheme: str, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more, lam) -> (x_next, S, g, Q) with second derivatives of an interval.

        ``start`` initialises g and Q from all inputs except lam. The interval adds d(integrated cost) / dz and the
        lower triangle of d2 (lam' Phi + integrated cost) / dz^2, where z = (x, u).
        """
        ...

    def integrated_cost(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more) -> l: the value from ``start`` plus the integral of the cost rate."""
        ...

    def integrated_gradient(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more) -> g: the value from ``start`` plus the gradient of that integral."""
        ...

    def integrated_product(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more) -> w: H d, added to the value from ``start``.

        H is the Gauss-Newton Hessian of the integrated cost; ``more`` contains d.
        """
        ...


class Hessian(Component, Protocol):
    """A Hessian provides the Hessian block of every node."""

    seam: ClassVar[Seam] = "hessian"

    def blocks(self, problem: Problem, costs: StageCosts, integrator: Integrator) -> HessianModel:
        """Return the blocks of all stages; the integrator provides the second derivatives of the dynamics."""
        ...


class StageMatrices(Protocol):
    """The stage matrices, from which the counts of condensing and of QP solvers follow."""

    @property
    def products(self) -> Products:
        """Return the products with the stage matrices."""
        ...


class Condensing(Component, Protocol):
    """Converts the stage QP to a QP of the form ``gives``."""

    seam: ClassVar[Seam] = "condensing"

    gives: ClassVar[str]  # "condensed": without states, by products of the stage matrices; or "stages"

    def qp_shape(self, problem: Problem) -> QpShape:
        """Return the sizes of the condensed QP."""
        ...

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """Return operation counts, see Component; the functions that condensing calls are products."""
        return {}


class QpSolver(Component, Protocol):
    """Solves a QP of the form ``takes``."""

    seam: ClassVar[Seam] = "qp"

    takes: ClassVar[str]  # "condensed" or "stages"
    chosen_for: ClassVar[tuple[str, ...]]  # goals for which qp=None may choose it

    def cost(self, dims: Dims, model: StageMatrices) -> Counts:
        """Return operation counts, see Component; the functions that the solver calls are products."""
        return {}

    def search(self, dims: Dims) -> OpCount:
        """Estimate the further operations of a sample whose working set differs much from the predicted one."""
        return OpCount()


class Algorithm(Component, Protocol):
    """Solves the problem and defines the entry points of the package.

    ``needs`` lists the seams that its packages have; a component of any other seam is refused.
    """

    seam: ClassVar[Seam] = "algorithm"
    core: ClassVar[frozenset[Core]]  # parts of the core that it uses besides plan, data and stage costs
    default_hessian: ClassVar[str | None] = None  # its name, unless the problem needs another

    @property
    def shift(self) -> str | None:
        """Return the shift of the plan before every prepare(); None: no shift."""
        return None

    @property
    def sampling_time(self) -> float | None:
        """Return the time between samples (s), or None."""
        return None

    @property
    def simulates(self) -> bool:
        """Return True if the states of plans are simulated from x_0."""
        return False

    def decide(self, problem: Problem, small: bool) -> tuple[Self, tuple[str, ...]]:
        """Return the algorithm with every open option chosen for the problem, and the reasons.

        If ``small``, nothing in the package iterates, neither solve() nor samples.
        """
        return self, ()

    @property
    def convex(self) -> bool:
        """Return True if the algorithm needs a convex Hessian, so that an indefinite exact one must be changed."""
        return True

    def check_parts(self, parts: Parts) -> None:
        """Raise OptionError if the algorithm does not work with one of the other components."""
        return

    def entries(self, features: Features) -> tuple[EntryPoint, ...]:
        """Return the C functions of a sample and, with ``solve``, the one that iterates to convergence."""
        ...

    def reach(self, problem: Problem) -> float:
        """Return the longest time (s) over which the plan is integrated from a node, besides the intervals; 0: none."""
        return 0.0


@dataclass(frozen=True)
class Parts:
    """The components of a package, one for every seam that the algorithm needs; no choice is open."""

    integrator: Integrator
    algorithm: Algorithm
    hessian: Hessian | None = None
    condensing: Condensing | None = None
    qp: QpSolver | None = None

    @property
    def components(self) -> tuple[Component, ...]:
        """Return all components that are present, in the order of their sections."""
        found = (self.integrator, self.hessian, self.condensing, self.qp, self.algorithm)
        return tuple(component for component in found if component is not None)


def spell(component: Component | type[Component]) -> str:
    """Return a component as the user writes it, in Python and on the command line."""
    cls = component if isinstance(component, type) else type(component)
    return f"{cls.__name__}() (--set {cls.seam}={cls.name})"


def refuse_unsupported(
    problem: Problem, components: Iterable[Component], registries: Mapping[str, Mapping[str, type[Component]]]
) -> None:
    """Raise OptionError if the problem uses what a component does not support; name the components that do."""
    for component in components:
        missing = sorted(problem.uses - component.supports)
        if missing:
            of_rows = [r.name for r in problem.rows if any(_uses(r, use) for use in missing)]
            named = list_some([*of_rows, *(problem.newton_names if NONLINEAR in missing else ())])
            where = f" ({named})" if named else ""
            able = [spell(c) for c in registries[component.seam].values() if c.supports >= problem.uses]
            offer = f"choose {' or '.join(able)}" if able else f"no {component.seam} of this version does"
            refused = f"which {component.seam} {spell(component)} does not support"
            raise OptionError(f"{problem.name} uses {' and '.join(missing)}{where}, {refused}; {offer}")


def _uses(row: Row, use: str) -> bool:
    soft = row.soft is not None
    coupled = dict.fromkeys(("coupled rows", COUPLED_START), row.is_coupled)
    return ({"soft rows": soft, "rows with an infinite penalty": soft and row.hard} | coupled).get(use, False)
