"""Choice of condensing and QP solver: the candidate that takes the fewest operations, counted exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from nmpc_codegen.components.base import Condensing, QpSolver, called
from nmpc_codegen.components.condensing import FullCondensing, NoCondensing, PartialCondensing
from nmpc_codegen.components.qp import REGISTRY
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.ir.model import ModelFunctions
from nmpc_codegen.lowering.dimensions import dimensions
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


#: Condensing, QP solver, and the reasons for the choice.
Choice = tuple[Condensing, QpSolver, tuple[str, ...]]


def choose_qp(problem: Problem, options: Options, constant_hessian: bool, model: ModelFunctions) -> Choice:
    """Condensing and QP solver: those that are given, adapted to the problem, completed by the choice that takes the
    fewest operations. The reason for this choice is the table of all candidates.

    Raises:
        OptionError: the two that are given clash.
    """
    given = options.condensing
    if given is not None and options.qp is not None:
        _check_forms(given, options.qp)
        condensing = given.adapted(problem)
        return condensing, options.qp, _instead(given, condensing)
    pairs = list(_pairs(given, options.qp))
    candidates, soft = [], "soft rows" in problem.features
    for stated, qp in pairs:
        condensing = stated.adapted(problem)
        if all(problem.features <= c.supports for c in (condensing, qp)):
            dims = dimensions(problem, condensing.qp_shape(problem), constant_hessian)
            counts = (*condensing.cost(dims, model).values(), *qp.cost(dims, model).values())
            total = sum(counts, qp.search(dims) if soft else OpCount())
            candidates.append(Candidate(condensing, qp, total.total))
    if not candidates:
        return *pairs[0], ()  # the checks of this pair raise the error that says why
    best = min(candidates, key=lambda c: c.operations)
    table = "; ".join(map(str, sorted(candidates, key=lambda c: c.operations)))
    sample = "warm-started sample and a search for its working set" if soft else "warm-started sample"
    why = f"fewest operations of a {sample} ({table})"
    chosen = [f"condensing: {best.condensing.name}"] if given is None else []
    chosen += [f"qp: {best.qp.name}"] if options.qp is None else []
    return best.condensing, best.qp, (*_instead(given, best.condensing), f"{', '.join(chosen)}; {why}")


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
