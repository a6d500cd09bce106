"""Which QP solver: the exact operations of every candidate on this problem, and the one with the fewest."""

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

#: Blocks of partial condensing that are looked at.
BLOCKS = (2, 3, 4, 5, 8, 10)


@dataclass(frozen=True)
class Candidate:
    """A condensing with a solver of its form, and what one warm-started sample takes whose working set is empty."""

    condensing: Condensing
    qp: QpSolver
    operations: int

    def __str__(self) -> str:
        return f"{self.condensing.label} + {self.qp.name}: {self.operations:,}"


#: Condensing, QP solver, and why they were chosen.
Choice = tuple[Condensing, QpSolver, tuple[str, ...]]


def choose_qp(problem: Problem, options: Options, constant_hessian: bool, model: ModelFunctions) -> Choice:
    """Condensing and QP solver: what is given, adapted to the problem, or what takes the fewest operations, with the
    table of all candidates.

    Raises:
        OptionError: the two that are given clash, or nothing that is left supports the problem.
    """
    given = options.condensing
    if given is not None and options.qp is not None:
        _check_forms(given, options.qp)
        condensing = given.adapted(problem)
        return condensing, options.qp, _instead(given, condensing)
    pairs = list(_pairs(given, options.qp))
    candidates = []
    for stated, qp in pairs:
        condensing = stated.adapted(problem)
        if all(problem.features <= c.supports for c in (condensing, qp)):
            dims = dimensions(problem, condensing.qp_shape(problem), constant_hessian)
            counts = (*condensing.cost(dims, model).values(), *qp.cost(dims, model).values())
            candidates.append(Candidate(condensing, qp, sum(counts, OpCount()).total))
    if not candidates:
        return *pairs[0], ()  # the component that refuses says why
    best = min(candidates, key=lambda c: c.operations)
    table = "; ".join(map(str, sorted(candidates, key=lambda c: c.operations)))
    why = f"fewest operations of a warm-started sample ({table})"
    chosen = [f"condensing: {best.condensing.name}"] if given is None else []
    chosen += [f"qp: {best.qp.name}"] if options.qp is None else []
    return best.condensing, best.qp, (*_instead(given, best.condensing), f"{', '.join(chosen)}; {why}")


def _instead(stated: Condensing | None, condensing: Condensing) -> tuple[str, ...]:
    """Why it is not the stated one, if it is not."""
    if stated is None or condensing is stated:
        return ()
    return (f"condensing: {condensing} instead of {stated.name}; coupled rows read free components of x_0",)


def _pairs(condensing: Condensing | None, qp: QpSolver | None) -> Iterator[tuple[Condensing, QpSolver]]:
    """Candidates that agree with what is given."""
    forms: tuple[Condensing, ...] = (FullCondensing(), NoCondensing(), *(PartialCondensing(block) for block in BLOCKS))
    for c in forms if condensing is None else (condensing,):
        for q in _solvers(c.gives) if qp is None else (qp,):
            if c.gives == q.takes:
                yield c, q


def _solvers(form: str) -> list[QpSolver]:
    """Solvers of a form that may be chosen."""
    return [cls() for cls in REGISTRY.values() if cls.takes == form and cls.automatic]


def _check_forms(condensing: Condensing, qp: QpSolver) -> None:
    if condensing.gives != qp.takes:
        raise OptionError(
            f"condensing {called(condensing)} clashes with qp {called(qp)}: it gives a QP in the form "
            f"{condensing.gives!r}, the solver takes {qp.takes!r}"
        )
