"""Condensing and QP solver are chosen if the options leave them open.

The choice takes the fewest operations, counted exactly, or with goal="size" the fewest bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from nmpc_codegen.components.base import Condensing, Dims, QpSolver, spell
from nmpc_codegen.components.condensing import FullCondensing, NoCondensing
from nmpc_codegen.components.hessians import GaussNewton
from nmpc_codegen.components.qp import REGISTRY
from nmpc_codegen.decisions.choices import Choices, QpChoice
from nmpc_codegen.errors import OptionError
from nmpc_codegen.options import Goal
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.struct_layout import Precision, struct_layout


@dataclass(frozen=True)
class QpCandidate:
    """A candidate is a condensing with a solver for its QP, and their operations.

    operations: of a warm-started sample with an empty working set; soft rows become active and inactive in blocks, so
    with them the search for another working set is included. searching: with that search in any case. dims: sizes of
    the structs.
    """

    condensing: Condensing
    qp: QpSolver
    operations: int
    searching: int
    dims: Dims

    def __str__(self) -> str:
        return f"{self.condensing.name} + {self.qp.name}: {self.operations:,}"


#: Largest number of controls of the horizon for which an indefinite reduced Hessian is condensed. Condensing mirrors
#: its eigenvalues one by one. The recursion on stages can only shift all controls by one amount, which is too large in
#: some directions and too small in others, so that samples of economic problems diverge or do not move.
MOST_MIRRORED = 120

#: Bytes of the code of QP solvers for goal="size", with everything that they call, at -Os for a Cortex-M4F.
CODE = {"dense_active_set": 9_000, "riccati_interior_point": 12_500}

#: Solvers whose operations are within this factor of the fewest are close. Between them, the search for another working
#: set decides, which takes most of the time of the longest samples.
CLOSE = 1.5


def choose_qp(found: Choices) -> QpChoice:
    """Choose condensing and QP solver: those that are given, completed by the pair with the fewest operations.

    Pairs that lose too much accuracy are excluded; with goal="size" the fewest bytes decide. The reason is the table of
    all candidates. The QP of a problem without any curvature is a linear program, for which the recursion on stages is
    chosen, because it handles degenerate vertices best.

    Raises:
        OptionError: the given components clash, or every condensing that fits loses too much accuracy.
    """
    problem, options, grown = found.problem, found.options, found.grown
    given = options.condensing
    if given is not None and options.qp is not None:
        _check_forms(given, options.qp)
        return QpChoice(given, options.qp, (), grown.warning(problem, given))
    fitting = list(_pairs(_forms(found), options.qp, options.goal))
    soft = "soft rows" in problem.uses
    candidates = list(_candidates(found, fitting, soft))
    if not candidates:
        return QpChoice(*fitting[0])  # the checks of this pair raise the error that says why
    spared = [c for c in candidates if grown.spares(problem, c.condensing)]
    fit = spared or candidates
    best, reason = _smallest(fit, options.precision) if options.goal == "size" else _best(fit, soft)
    words = [f"condensing: {best.condensing.name}"] if given is None else []
    words += [f"qp: {best.qp.name}"] if options.qp is None else []
    warned = grown.warning(problem, best.condensing)
    lossy = () if warned else grown.left_out(problem, [pair[0] for pair in fitting])
    reasons = (f"{', '.join(words)}; {reason}", *lossy)
    return QpChoice(best.condensing, best.qp, reasons, warned)


def _candidates(found: Choices, fitting: Iterable[tuple[Condensing, QpSolver]], soft: bool) -> Iterator[QpCandidate]:
    """Yield the pairs that support the problem, with their counts."""
    for condensing, qp in fitting:
        if all(found.problem.uses <= c.supports for c in (condensing, qp)):
            dims = found.dims_with(condensing)
            counts = (*condensing.cost(dims, found.made).values(), *qp.cost(dims, found.made).values())
            warm, search = sum(counts, OpCount()).total, qp.search(dims).total
            yield QpCandidate(condensing, qp, warm + search * soft, warm + search, dims)


def _bytes(c: QpCandidate, precision: Precision) -> int:
    """Return the bytes of the structs of both, with all members, and of the code of the solver."""
    structs = (*c.condensing.structs(c.dims), *c.qp.structs(c.dims))
    layout = struct_layout([s for s in structs if s.name != "solver"], precision)
    held = {member.ctype for struct in structs for member in struct.fields}
    return CODE.get(c.qp.name, 0) + sum(size for name, (size, _) in layout.items() if name not in held)


def _smallest(candidates: list[QpCandidate], precision: Precision) -> tuple[QpCandidate, str]:
    """Return the candidate with the fewest bytes, and the reason."""
    ranked = sorted(((_bytes(c, precision), c) for c in candidates), key=lambda pair: pair[0])
    table = "; ".join(f"{c.condensing.name} + {c.qp.name}: {size:,}" for size, c in ranked)
    return ranked[0][1], f"fewest bytes of code and data, about ({table})"


def _best(candidates: list[QpCandidate], soft: bool) -> tuple[QpCandidate, str]:
    """Return the candidate with the fewest operations, or with the cheapest search among close ones, and the reason."""
    ranked = sorted(candidates, key=lambda c: c.operations)
    sample = "warm-started sample and a search for its working set" if soft else "warm-started sample"
    why = f"fewest operations of a {sample} ({'; '.join(map(str, ranked))})"
    of_solvers = (next(c for c in ranked if c.qp.name == name) for name in dict.fromkeys(c.qp.name for c in ranked))
    close = [c for c in of_solvers if c.operations <= CLOSE * ranked[0].operations]
    best = min(close, key=lambda c: c.searching)
    if best is not ranked[0]:
        table = "; ".join(f"{c.condensing.name} + {c.qp.name}: {c.searching:,}" for c in close)
        why = f"fewest operations with a search for the working set ({table}) among those within {CLOSE} of the {why}"
    return best, why


def _mirrors_few(found: Choices) -> bool:
    """Return True for a general cost whose Hessian may be indefinite in few controls.

    Eigenvalues of the condensed Hessian can then be mirrored. The plain scheme, with one iteration and without relaxed
    rows, takes the fewest operations instead.
    """
    problem, hessian = found.problem, found.hessian.value
    added = Features() if hessian is None else hessian.adds(Features())
    safe = (algorithm := found.algorithm.value.adds(Features())).relax or algorithm.iterates or algorithm.repair
    indefinite = added.regularize_reduced and not problem.uses <= GaussNewton.supports
    return bool(safe and indefinite) and problem.N * problem.nu <= MOST_MIRRORED


def _forms(found: Choices) -> tuple[Condensing, ...]:
    """Return the given condensing, or those that are compared.

    All are compared, unless a problem without curvature, or one whose indefinite Hessian is mirrored, leaves only one.
    """
    given, blocks = found.options.condensing, found.made.blocks
    if given is not None:
        return (given,)
    if found.options.qp is None and not (blocks.Q or blocks.terminal.Q) and not found.problem.couples_free_start:
        return (NoCondensing(),)
    if found.options.qp is None and _mirrors_few(found) and found.grown.spares(found.problem, FullCondensing()):
        return (FullCondensing(),)
    return (FullCondensing(), NoCondensing())


def _pairs(forms: Iterable[Condensing], qp: QpSolver | None, goal: Goal) -> Iterator[tuple[Condensing, QpSolver]]:
    """Yield all consistent pairs with these condensings, and with the given solver."""
    for c in forms:
        for q in _solvers(c.gives, goal) if qp is None else (qp,):
            if c.gives == q.takes:
                yield c, q


def _solvers(form: str, goal: Goal) -> list[QpSolver]:
    """Return the solvers for QPs of a form that the compiler may choose.

    For goal="size" these are solvers without a fall-back, which the active-set method on stages has.
    """
    return [cls() for cls in REGISTRY.values() if cls.takes == form and goal in cls.chosen_for]


def _check_forms(condensing: Condensing, qp: QpSolver) -> None:
    if condensing.gives != qp.takes:
        raise OptionError(
            f"condensing {spell(condensing)} clashes with qp {spell(qp)}: it gives a QP in the form "
            f"{condensing.gives!r}, the solver takes {qp.takes!r}"
        )
