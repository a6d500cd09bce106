"""The choices that options leave open, from counts, and the sizes that follow from them.

First the Hessian, then the condensing and QP solver that take the fewest operations, counted exactly, or with
goal="size" the fewest bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from nmpc_codegen.components.base import Condensing, Dims, QpDims, QpShape, QpSolver, spell
from nmpc_codegen.components.condensing import FullCondensing, NoCondensing, PartialCondensing
from nmpc_codegen.components.hessians import ExactHessian, GaussNewton
from nmpc_codegen.components.qp import REGISTRY
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.model import ModelFunctions
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.lowering.first_plan import Growth
from nmpc_codegen.options import Goal, Options
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.memory import Precision, Size, struct_layout
from nmpc_codegen.package.opcount import OpCount

#: Block lengths of partial condensing that are considered.
BLOCKS = (2, 3, 4, 5, 8, 10)


@dataclass(frozen=True)
class Candidate:
    """A condensing, a solver for its QP, and their operations.

    ``operations``: of a warm-started sample with an empty working set; if there are soft rows, which are active in
    blocks that come and go, also those of finding another working set. ``searching``: with those in any case.
    ``dims``: the sizes of their structs.
    """

    condensing: Condensing
    qp: QpSolver
    operations: int
    searching: int
    dims: Dims

    def __str__(self) -> str:
        return f"{self.condensing.label} + {self.qp.name}: {self.operations:,}"


#: Controls of the horizon up to which an indefinite reduced Hessian is condensed. Its eigenvalues are mirrored one by
#: one; the recursion on stages can only shift all controls, and a shift that is large in one direction is too small or
#: too large in the others: samples of economic problems run away or stand still.
MOST_MIRRORED = 120

#: Bytes of the code of QP solvers that are chosen for goal="size", with what they need, at -Os for a Cortex-M4F.
CODE = {"dense_active_set": 9_000, "riccati_interior_point": 12_500}

#: A solver that takes at most this many times the fewest operations is close: the search for another working set, which
#: most of the longest samples consist of, decides between them.
CLOSE = 1.5


@dataclass(frozen=True)
class Choice:
    """Condensing, QP solver, the reasons for them, and warnings of the digits that they cost."""

    condensing: Condensing
    qp: QpSolver
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def choose_qp(
    problem: Problem, options: Options, constant_hessian: bool, model: ModelFunctions, grown: Growth
) -> Choice:
    """Condensing and QP solver: those that are given, adapted to the problem, completed by the choice that takes the
    fewest operations of those that keep enough digits, or with goal="size" the fewest bytes. The reason for this choice
    is the table of all candidates. The QP of a problem without any curvature is a linear program, whose degenerate
    vertices the recursion takes best.

    Raises:
        OptionError: the two that are given clash, or too few digits remain with every condensing that fits.
    """
    given = options.condensing
    if given is not None and options.qp is not None:
        _check_forms(given, options.qp)
        condensing = given.adapt(problem)
        return Choice(condensing, options.qp, _instead(given, condensing), warnings=grown.warning(problem, condensing))
    fitting = list(_pairs(_forms(problem, options, model, grown), options.qp, options.goal))
    candidates, soft = [], "soft rows" in problem.uses
    for stated, qp in fitting:
        condensing = stated.adapt(problem)
        if all(problem.uses <= c.supports for c in (condensing, qp)):
            shape, multiple = condensing.qp_shape(problem), multiple_of(options.goal)
            dims = dimensions(problem, shape, constant_hessian, multiple, model.products.banded)
            counts = (*condensing.cost(dims, model).values(), *qp.cost(dims, model).values())
            warm, search = sum(counts, OpCount()).total, qp.search(dims).total
            candidates.append(Candidate(condensing, qp, warm + search * soft, warm + search, dims))
    if not candidates:
        return Choice(*fitting[0])  # the checks of this pair raise the error that says why
    spared = [c for c in candidates if grown.spares(problem, c.condensing)]
    fit = spared or candidates
    best, reason = _smallest(fit, options.precision) if options.goal == "size" else _best(fit, soft)
    words = [f"condensing: {best.condensing.name}"] if given is None else []
    words += [f"qp: {best.qp.name}"] if options.qp is None else []
    warned = grown.warning(problem, best.condensing)
    lossy = () if warned else grown.left_out(problem, [pair[0] for pair in fitting])
    reasons = (*_instead(given, best.condensing), f"{', '.join(words)}; {reason}", *lossy)
    return Choice(best.condensing, best.qp, reasons, warned)


def _bytes(c: Candidate, precision: Precision) -> int:
    """Bytes of the structs of both, as if no feature left any member out, and of the code of the solver."""
    structs = (*c.condensing.structs(c.dims), *c.qp.structs(c.dims))
    layout = struct_layout([s for s in structs if s.name != "solver"], precision)
    held = {member.ctype for struct in structs for member in struct.fields}
    return CODE.get(c.qp.name, 0) + sum(size for name, (size, _) in layout.items() if name not in held)


def _smallest(candidates: list[Candidate], precision: Precision) -> tuple[Candidate, str]:
    """The candidate with the fewest bytes, and why."""
    ranked = sorted(((_bytes(c, precision), c) for c in candidates), key=lambda pair: pair[0])
    table = "; ".join(f"{c.condensing.label} + {c.qp.name}: {size:,}" for size, c in ranked)
    return ranked[0][1], f"fewest bytes of code and data, about ({table})"


def _best(candidates: list[Candidate], soft: bool) -> tuple[Candidate, str]:
    """The candidate to choose, and why: the fewest operations, or the fewest with a search among those close to it."""
    ranked = sorted(candidates, key=lambda c: c.operations)
    sample = "warm-started sample and a search for its working set" if soft else "warm-started sample"
    why = f"fewest operations of a {sample} ({'; '.join(map(str, ranked))})"
    of_solvers = (next(c for c in ranked if c.qp.name == name) for name in dict.fromkeys(c.qp.name for c in ranked))
    close = [c for c in of_solvers if c.operations <= CLOSE * ranked[0].operations]
    best = min(close, key=lambda c: c.searching)
    if best is not ranked[0]:
        table = "; ".join(f"{c.condensing.label} + {c.qp.name}: {c.searching:,}" for c in close)
        why = f"fewest operations with a search for the working set ({table}) among those within {CLOSE} of the {why}"
    return best, why


def _mirrors_few(problem: Problem, options: Options) -> bool:
    """True for a general cost whose Hessian may be indefinite in few controls: eigenvalues of the condensed one can be
    mirrored. The plain scheme, of one iteration without relaxed rows, takes the fewest operations."""
    found = Features() if options.hessian is None else options.hessian.adds(Features())
    safe = (algorithm := options.algorithm.adds(Features())).relax or algorithm.iterates or algorithm.repair
    indefinite = found.regularize_reduced and not problem.uses <= GaussNewton.supports
    return bool(safe and indefinite) and problem.N * problem.nu <= MOST_MIRRORED


def _instead(stated: Condensing | None, condensing: Condensing) -> tuple[str, ...]:
    """The reason if a component other than the stated one is used."""
    if stated is None or condensing is stated:
        return ()
    return (f"condensing: {condensing} instead of {stated.name}; coupled rows read free components of x_0",)


def _forms(problem: Problem, options: Options, model: ModelFunctions, grown: Growth) -> tuple[Condensing, ...]:
    """The condensing that is given, or what is compared: all, unless a problem without curvature or one whose
    indefinite Hessian is mirrored leaves one."""
    if options.condensing is not None:
        return (options.condensing,)
    if options.qp is None and not (model.path.Q or model.terminal.Q):
        return (NoCondensing(),)
    if options.qp is None and _mirrors_few(problem, options) and grown.spares(problem, FullCondensing()):
        return (FullCondensing(),)
    return (FullCondensing(), NoCondensing(), *(PartialCondensing(block) for block in BLOCKS))


def _pairs(forms: Iterable[Condensing], qp: QpSolver | None, goal: Goal) -> Iterator[tuple[Condensing, QpSolver]]:
    """All consistent pairs with these, and with the solver that is given."""
    for c in forms:
        for q in _solvers(c.gives, goal) if qp is None else (qp,):
            if c.gives == q.takes:
                yield c, q


def _solvers(form: str, goal: Goal) -> list[QpSolver]:
    """Solvers for QPs of a form that the compiler may choose: for goal="size" those that need no other one behind them,
    as the active-set method on stages does."""
    return [cls() for cls in REGISTRY.values() if cls.takes == form and goal in cls.chosen_for]


def _check_forms(condensing: Condensing, qp: QpSolver) -> None:
    if condensing.gives != qp.takes:
        raise OptionError(
            f"condensing {spell(condensing)} clashes with qp {spell(qp)}: it gives a QP in the form "
            f"{condensing.gives!r}, the solver takes {qp.takes!r}"
        )


def choose_hessian(problem: Problem, options: Options) -> tuple[Options, tuple[str, ...]]:
    """Return the options with the Hessian of samples, and the reason if it is not the default of the algorithm.

    Samples of a least-squares problem take the Gauss-Newton Hessian, whatever the rows of the problem. An exact Hessian
    has to be made convex near a nonconvex row, and its full step may then be far too long.
    """
    if options.hessian is not None or options.algorithm.default("hessian") != GaussNewton.name:
        return options, ()
    beyond = problem.uses - GaussNewton.supports
    if not beyond or not beyond <= ExactHessian.supports:
        return options, ()
    why = f"the problem has a {sorted(beyond)[0]}"
    exact = ExactHessian() if options.algorithm.convex else ExactHessian(regularization=None)
    return replace(options, hessian=exact), (f"hessian: {ExactHessian.name}; {why}",)


def is_small(options: Options) -> bool:
    """True if nothing in the package iterates: neither solve() nor samples."""
    return options.goal == "size" and not options.solves


def solves_exactly(problem: Problem, options: Options, chosen: bool) -> bool:
    """Return True if solve() has an exact Hessian beside the Gauss-Newton one of samples.

    So it is where the Hessian was ``chosen`` by the compiler, and the package has room for a second one.
    """
    approximate = isinstance(options.hessian, GaussNewton) and "qp" in options.algorithm.needs
    roomy = options.solves and options.goal == "speed"
    return approximate and chosen and roomy and not problem.couples_free_start


# -- sizes -------------------------------------------------------------------------------------------------------------


def multiple_of(goal: Goal) -> int:
    """To which leading dimensions of stage matrices are rounded up: small ones have no padding."""
    return 1 if goal == "size" else PANEL


def dimensions(
    problem: Problem, shape: QpShape | None, constant_hessian: bool, multiple: int = PANEL, banded: int = 0
) -> Dims:
    """All shared sizes; ``shape`` is None without a QP; ``constant_hessian``: one path block serves all nodes.

    Leading dimensions of stage matrices are rounded up to a multiple of ``multiple``.
    """
    p = problem
    sizes = {
        "N": p.N,
        "NX": p.nx,
        "NXHAT": p.measured,
        "NU": p.nu,
        "NZ": p.nx + p.nu,
        "NP": p.np,
        "NY": p.path.ny,
        "NY_N": p.terminal.ny,
        "NW": _weight_entries(p.path),
        "NW_N": _weight_entries(p.terminal),
        "NH": p.path.nh,
        "NH_N": p.terminal.nh,
        "NR": len(p.rows),
        "NQ": 1 if constant_hessian else p.N,
        "NF": len(p.free_initial),
        "NE": p.coupled_rows,
        "NG": len(p.qp_rows),
        "NALG": len(p.newton_names),
        "NM": p.estimation.ny if p.estimation else 0,
        "NIN": p.estimation.nu if p.estimation else 0,
    }
    fields = {"NY_N": "ny_N", "NW_N": "nw_N", "NH_N": "nh_N", "N": "N"}
    condensed = None if shape is None else _qp_dims(p, shape)
    return Dims(
        **_sizes(sizes, fields),
        condensed=condensed,
        end_rows=len(p.end_rows),
        banded=banded,
        estimation=p.estimation,
        multiple=multiple,
    )


def _qp_dims(problem: Problem, shape: QpShape) -> QpDims:
    sizes = {
        "NS": shape.stages,
        "NUS": shape.controls,
        "NXS": problem.nx + shape.copies,
        "NZS": problem.nx + shape.copies + shape.controls,
        "NV": shape.variables,
        "NSL": shape.slacks,
        "LDV": -(-shape.variables // PANEL) * PANEL,
        "LDH": -(-(shape.variables - shape.slacks) // PANEL) * PANEL,
    }
    return QpDims(**_sizes(sizes, {"LDV": "ld", "LDH": "ldh"}))


def _sizes(values: Mapping[str, int], fields: Mapping[str, str]) -> dict[str, Size]:
    """Field -> size, by macro; a field is its macro in lower case unless ``fields`` names it."""
    return {fields.get(name, name.lower()): Size(name, value) for name, value in values.items()}


def _weight_entries(stage: Stage) -> int:
    return stage.ny if stage.diagonal_weight else stage.ny**2
