"""Which QP solver: the exact operations of every candidate on this problem, and the one with the fewest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from nmpc_codegen.components.base import Counts, called
from nmpc_codegen.components.condensing import FullCondensing, NoCondensing, PartialCondensing
from nmpc_codegen.components.qp import REGISTRY
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import OpCount
from nmpc_codegen.lowering.dimensions import dimensions
from nmpc_codegen.options import Options

#: Blocks of partial condensing that are looked at.
BLOCKS = (2, 3, 4, 5, 8, 10)


@dataclass(frozen=True)
class Candidate:
    """A condensing with a solver of its form, and what one warm-started sample takes whose working set is empty."""

    condensing: Any
    qp: Any
    operations: int

    def __str__(self) -> str:
        block = f"({self.condensing.block})" if isinstance(self.condensing, PartialCondensing) else ""
        return f"{self.condensing.name}{block} + {self.qp.name}: {self.operations:,}"


def choose_qp(
    problem: Problem, options: Options, constant_hessian: bool, known: Counts
) -> tuple[Options, tuple[str, ...]]:
    """Complete ``condensing`` and ``qp``; what was chosen and why, with the table of all candidates.

    Raises:
        OptionError: the two that are given clash, or nothing that is left supports the problem.
    """
    given: tuple[Any, Any] = (options.condensing, options.qp)
    if None not in given:
        _check_forms(options)
        return _adapted(problem, options)
    candidates = []
    for stated, qp in _pairs(*given):
        condensing = stated.adapted(problem)
        if all(problem.features <= c.supports for c in (condensing, qp)):
            dims = dimensions(problem, condensing.qp_shape(problem), constant_hessian)
            counts = (condensing.cost(dims, known), qp.cost(dims, known))
            total = sum((c for count in counts for c in count.values()), OpCount())
            candidates.append(Candidate(condensing, qp, total.total))
    if not candidates:
        first = next(_pairs(*given))  # the component that refuses says why
        return replace(options, condensing=first[0], qp=first[1]), ()
    best = min(candidates, key=lambda c: c.operations)
    table = "; ".join(map(str, sorted(candidates, key=lambda c: c.operations)))
    why = f"fewest operations of a warm-started sample ({table})"
    chosen = replace(options, condensing=best.condensing, qp=best.qp)
    parts = zip(("condensing", "qp"), given, strict=True)
    named = ", ".join(f"{seam}: {getattr(best, seam).name}" for seam, was in parts if was is None)
    return chosen, (*_instead(given[0], best.condensing), f"{named}; {why}")


def _adapted(problem: Problem, options: Options) -> tuple[Options, tuple[str, ...]]:
    """The condensing that does for this problem what the stated one does for others."""
    condensing = options.condensing.adapted(problem)
    return replace(options, condensing=condensing), _instead(options.condensing, condensing)


def _instead(stated: Any, condensing: Any) -> tuple[str, ...]:
    """Why it is not the stated one, if it is not."""
    if stated is None or condensing is stated:
        return ()
    return (f"condensing: {condensing} instead of {stated.name}; coupled rows read free components of x_0",)


def _pairs(condensing: Any, qp: Any) -> Iterator[tuple[Any, Any]]:
    """Candidates that agree with what is given."""
    forms: tuple[Any, ...] = (FullCondensing(), NoCondensing(), *(PartialCondensing(block) for block in BLOCKS))
    for c in forms if condensing is None else (condensing,):
        for q in _solvers(c.gives) if qp is None else (qp,):
            if c.gives == q.takes:
                yield c, q


def _solvers(form: str) -> list[Any]:
    """Solvers of a form that may be chosen."""
    return [cls() for cls in REGISTRY.values() if cls.takes == form and cls.automatic]


def _check_forms(options: Options) -> None:
    if options.condensing.gives != options.qp.takes:
        raise OptionError(
            f"condensing {called(options.condensing)} clashes with qp {called(options.qp)}: it gives a QP in the form "
            f"{options.condensing.gives!r}, the solver takes {options.qp.takes!r}"
        )
