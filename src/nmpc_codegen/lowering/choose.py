"""Choice of condensing and QP solver: the candidate that takes the fewest operations, counted exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from nmpc_codegen.components.base import Condensing, QpSolver, called
from nmpc_codegen.components.condensing import FullCondensing, NoCondensing, PartialCondensing
from nmpc_codegen.components.hessians import GaussNewton
from nmpc_codegen.components.qp import REGISTRY
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.model import ModelFunctions
from nmpc_codegen.lowering.dimensions import dimensions, multiple_of
from nmpc_codegen.lowering.growth import Growth
from nmpc_codegen.options import Options

#: Block lengths of partial condensing that are considered.
BLOCKS = (2, 3, 4, 5, 8, 10)


@dataclass(frozen=True)
class Candidate:
    """A condensing, a solver for its QP, and their operations.

    ``operations``: of a warm-started sample with an empty working set; if there are soft rows, which are active in
    blocks that come and go, also those of finding another working set.
    """

    condensing: Condensing
    qp: QpSolver
    operations: int

    def __str__(self) -> str:
        return f"{self.condensing.label} + {self.qp.name}: {self.operations:,}"


#: Controls of the horizon up to which an indefinite reduced Hessian is condensed. Its eigenvalues are mirrored one by
#: one; the recursion on stages can only shift all controls, and a shift that is large in one direction is too small or
#: too large in the others: samples of economic problems run away or stand still.
MOST_MIRRORED = 120

#: A solver that takes at most this many times the fewest operations is close: the worst case decides between them.
CLOSE = 1.5


@dataclass(frozen=True)
class Choice:
    """Condensing, QP solver, the reasons for them, the candidates with other solvers that are close to them, and
    warnings of the digits that they cost."""

    condensing: Condensing
    qp: QpSolver
    reasons: tuple[str, ...] = ()
    rivals: tuple[Choice, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Both in words."""
        return f"{self.condensing.label} + {self.qp.name}"


def choose_qp(
    problem: Problem, options: Options, constant_hessian: bool, model: ModelFunctions, grown: Growth
) -> Choice:
    """Condensing and QP solver: those that are given, adapted to the problem, completed by the choice that takes the
    fewest operations of those that keep enough digits. The reason for this choice is the table of all candidates. The
    QP of a problem without any curvature is a linear program, whose degenerate vertices the recursion takes best.

    Raises:
        OptionError: the two that are given clash, or too few digits remain with every condensing that fits.
    """
    given = options.condensing
    if given is not None and options.qp is not None:
        _check_forms(given, options.qp)
        condensing = given.adapted(problem)
        return Choice(condensing, options.qp, _instead(given, condensing), warnings=grown.warning(problem, condensing))
    fitting = list(_pairs(given, options.qp))
    if given is None and options.qp is None and not (model.path.Q or model.terminal.Q):
        fitting = list(_pairs(NoCondensing(), None))
    elif (
        given is None
        and options.qp is None
        and _mirrors_few(problem, options)
        and grown.spares(problem, FullCondensing())
    ):
        fitting = list(_pairs(FullCondensing(), None))
    pairs = [pair for pair in fitting if grown.spares(problem, pair[0])] or fitting
    candidates, soft = [], "soft rows" in problem.features
    for stated, qp in pairs:
        condensing = stated.adapted(problem)
        if all(problem.features <= c.supports for c in (condensing, qp)):
            dims = dimensions(problem, condensing.qp_shape(problem), constant_hessian, multiple_of(options.goal))
            counts = (*condensing.cost(dims, model).values(), *qp.cost(dims, model).values())
            total = sum(counts, qp.search(dims) if soft else OpCount())
            candidates.append(Candidate(condensing, qp, total.total))
    if not candidates:
        return Choice(*pairs[0])  # the checks of this pair raise the error that says why
    ranked = sorted(candidates, key=lambda c: c.operations)
    table = "; ".join(map(str, ranked))
    sample = "warm-started sample and a search for its working set" if soft else "warm-started sample"
    why = f"fewest operations of a {sample} ({table})"
    best, *others = (next(c for c in ranked if c.qp.name == name) for name in dict.fromkeys(c.qp.name for c in ranked))

    def chosen(c: Candidate) -> Choice:
        words = [f"condensing: {c.condensing.name}"] if given is None else []
        words += [f"qp: {c.qp.name}"] if options.qp is None else []
        warned = grown.warning(problem, c.condensing)
        lossy = () if warned else grown.left_out(problem, [pair[0] for pair in fitting])
        reasons = (*_instead(given, c.condensing), f"{', '.join(words)}; {why}", *lossy)
        return Choice(c.condensing, c.qp, reasons, warnings=warned)

    close = (chosen(c) for c in others if c.operations <= CLOSE * best.operations)
    return replace(chosen(best), rivals=tuple(close))


def _mirrors_few(problem: Problem, options: Options) -> bool:
    """True for a general cost whose Hessian may be indefinite in few controls: eigenvalues of the condensed one can be
    mirrored. The plain scheme, which neither relaxes rows nor repairs plans, takes the fewest operations."""
    found = {} if options.hessian is None else options.hessian.switches
    safe = options.algorithm.switches.get("RELAX") or options.algorithm.switches.get("REPAIR")
    indefinite = found.get("REGULARIZE_REDUCED") and not problem.features <= GaussNewton.supports
    return bool(safe and indefinite) and problem.N * problem.nu <= MOST_MIRRORED


def _instead(stated: Condensing | None, condensing: Condensing) -> tuple[str, ...]:
    """The reason if a component other than the stated one is used."""
    if stated is None or condensing is stated:
        return ()
    return (f"condensing: {condensing} instead of {stated.name}; coupled rows read free components of x_0",)


def _pairs(condensing: Condensing | None, qp: QpSolver | None) -> Iterator[tuple[Condensing, QpSolver]]:
    """All pairs that are consistent with the given components."""
    forms: tuple[Condensing, ...] = (FullCondensing(), NoCondensing(), *(PartialCondensing(block) for block in BLOCKS))
    for c in forms if condensing is None else (condensing,):
        for q in _solvers(c.gives) if qp is None else (qp,):
            if c.gives == q.takes:
                yield c, q


def _solvers(form: str) -> list[QpSolver]:
    """Solvers for QPs of a form that the compiler may choose."""
    return [cls() for cls in REGISTRY.values() if cls.takes == form and cls.automatic]


def _check_forms(condensing: Condensing, qp: QpSolver) -> None:
    if condensing.gives != qp.takes:
        raise OptionError(
            f"condensing {called(condensing)} clashes with qp {called(qp)}: it gives a QP in the form "
            f"{condensing.gives!r}, the solver takes {qp.takes!r}"
        )
