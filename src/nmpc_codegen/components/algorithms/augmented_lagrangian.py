"""The real-time augmented Lagrangian takes a fixed number of Newton steps and one dual update in a sample.

    min_z  cost + sum_i (lam_i + rho_i/2 c_i) c_i + sum_m psi_m(v_m)   subject to bounds of controls and states,
    z = (x_0, u_0, .., x_N),   c_0 = xhat - x_0,   c_{k+1} = Phi_k(x_k, u_k) - x_{k+1},   rho_i = rho / scale_i^2

The terms psi_m stand for all other rows; their multipliers are at least 0 for an inequality and at most the weight of a
soft row. Every sample takes ``iterations`` steps of a trust-region method and then sets lam_i += rho_i c_i. If no step
was accepted, or a large violation has not decreased, rho grows instead. The method needs no QP and no convex Hessian.

Hours, Shukla and Jones, "A parametric augmented Lagrangian algorithm for real-time economic NMPC", ECC 2016.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from nmpc_codegen.components.algorithms.hooked_parts import FIRST_SAMPLE, RESTART_SAMPLES, SHIFT, watch_fields
from nmpc_codegen.components.algorithms.real_time_iteration import (
    SAMPLE,
    SAMPLES,
    SOLVE,
    SOLVED,
    shift_entry,
    state_size,
)
from nmpc_codegen.components.algorithms.row_scales import (
    cost_magnitude,
    linear_rows,
    row_scales,
    row_sizes,
    tolerance_table,
    variable_scales,
)
from nmpc_codegen.components.algorithms.shifts import (
    SHIFTS,
    check_sampling_time,
    check_shift,
    decide_shift,
    initial_tables,
    resample_reach,
    resample_tables,
    resample_time,
    with_shift,
)
from nmpc_codegen.components.allowed import Number, Whole, Words, check_options, option
from nmpc_codegen.components.base import (
    COUPLED_START,
    EVERY_USE,
    MEASUREMENTS,
    Algorithm,
    Core,
    Dims,
    HookedPart,
    Parts,
    Seam,
)
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.tuning import PANEL
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.signals import EntryPoint
from nmpc_codegen.package.struct_layout import Field, Size, Struct, only_if

PREPARE = EntryPoint(
    "prepare",
    "Preparation phase: evaluate and linearise the plan, and repair one that is new or far from the model. After a "
    "call that fails feedback returns the control of the plan, and restarts a plan that fails repeatedly.",
)

#: Largest numbers of faces per iteration, of shifts of a factorisation, of trials of a projected search, and of
#: iterations of conjugate gradients.
MAX_FACES, MAX_SHIFTS, MAX_BACKTRACKS, MAX_CG = 8, 3, 8, 20

#: The default penalty, relative to the curvature of the cost.
PENALTY = 3e3

#: The default weight of the proximal term with a Hessian of the Lagrangian, relative to the curvature of the stages.
PROXIMAL = 0.3


@dataclass(frozen=True)
class AugmentedLagrangian(Algorithm):
    """Newton iterations minimise the augmented Lagrangian, without a QP.

    Variables are scaled by their declared initial values or bounds, rows by their declared magnitudes. The status is OK
    if the plan is near the model; it need not be optimal yet. A sample is NOT_CONVERGED if stats.residual, its largest
    gap or violation in these scales, exceeds ``tolerance``, or if the last step did not reach the decrease that its
    model predicted. A plan that is then farther from the model than the initial plan is replaced by the initial plan,
    and so is every plan after 10 such samples in a row.

    Args:
        iterations: number of Newton iterations per sample.
        penalty: rho in the scales of states and rows; None: 3,000 times the change of the cost in the scale of a
            variable, by its curvature or, for general costs, by N times its slope. It grows by factors of 10 while
            accepted steps do not reduce a large violation, up to 100 times its usual value.
        proximal: weight r of the term r/2 |z - z_c|^2 that keeps the refinement near the Cauchy point z_c; None: 0.3
            times the largest curvature of a stage with a Hessian that depends on multipliers, else 0.
        repair: number of rounds, each with the work of a sample, that prepare() may add at the predicted x_0 of a new
            plan, or after a sample that failed or was NOT_CONVERGED; 0: none.
        tolerance: stats.residual above which a sample is NOT_CONVERGED.
        shift: how the plan moves before every prepare but the first, as in RealTimeIteration.
        sampling_time: time between samples, as in RealTimeIteration.
    """

    iterations: int = option(3, Whole(most=1000))
    penalty: float | None = option(None, Number(optional=True))
    proximal: float | None = option(None, Number(closed=True, optional=True))
    repair: int = option(3, Whole(most=100, least=0))
    tolerance: float = option(0.1, Number())
    shift: str | None = option("auto", Words(("auto", *SHIFTS)))
    sampling_time: float | None = option(None, Number(optional=True, unit="s"))

    name: ClassVar[str] = "augmented_lagrangian"
    template: ClassVar[str] = "algorithms/augmented_lagrangian.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator", "hessian")
    default_hessian: ClassVar[str | None] = "gauss_newton"
    core: ClassVar[frozenset[Core]] = frozenset({"nodes", "multipliers", "kkt"})
    supports: ClassVar[frozenset[str]] = EVERY_USE - {
        "blocks of controls",
        "rows with an infinite penalty",
        COUPLED_START,
        MEASUREMENTS,
    }

    def __post_init__(self) -> None:
        check_options(self, self.seam)
        check_sampling_time("AugmentedLagrangian", self.shift, self.sampling_time)

    @property
    def convex(self) -> bool:
        """Return False, because the trust region follows negative curvature."""
        return False

    def check_parts(self, parts: Parts) -> None:
        """Raise OptionError for a Hessian that is made convex or was computed off line."""
        found = Features() if parts.hessian is None else parts.hessian.adds(Features())
        if found.regularize_reduced or found.regularize_stages:
            raise OptionError(
                "AugmentedLagrangian() (--set algorithm=augmented_lagrangian) follows negative curvature and clashes "
                "with a regularisation of the Hessian; expected ExactHessian(regularization=None) "
                "(--set hessian.regularization=none) or GaussNewton() (--set hessian=gauss_newton)"
            )
        if found.tuned:
            raise OptionError(
                "AugmentedLagrangian() (--set algorithm=augmented_lagrangian) clashes with a Hessian that was computed "
                "off line for QPs; expected ExactHessian(regularization=None) (--set hessian.regularization=none) or "
                "GaussNewton() (--set hessian=gauss_newton)"
            )

    def entries(self, features: Features) -> tuple[EntryPoint, ...]:
        """Return the entry points: both phases of a sample, a sample in one call, the shift, and solve()."""
        return (PREPARE, *SAMPLE, shift_entry(self.shift), *((SOLVE,) if features.solve else ()))

    def adds(self, features: Features) -> Features:
        return replace(
            with_shift(features.without("initial_hessian"), self.shift), start_is_measured=True, repair=self.repair
        )

    def hooked_parts(self, features: Features) -> tuple[HookedPart, ...]:
        """Return the parts for a shift before every preparation, and for a first sample at the measured state.

        The latter is used if plans are repaired.
        """
        wanted = ((SHIFT, self.shift is not None), (FIRST_SAMPLE, self.repair > 0))
        return tuple(part for part, present in wanted if present)

    def check(self, problem: Problem) -> None:
        """Raise OptionError for shifts that clash with the grid."""
        check_shift("AugmentedLagrangian", self.shift, self.sampling_time, problem)

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        scale = variable_scales(problem)
        weight, padding = 1.0 / scale**2, (0.0,) * (-scale.size % PANEL)
        initial = [0.0 if i in problem.free_initial else w for i, w in enumerate(weight[: problem.nx])]
        rows = problem.qp_rows
        soft = [problem.rows[row].soft is not None for _, _, _, row in rows]
        bends = tuple(int(s or linear) for s, linear in zip(soft, linear_rows(problem), strict=True))
        relaxed = tuple(2 * int(s) or int(kind != 0) for (_, kind, _, _), s in zip(rows, soft, strict=True))
        return (
            *initial_tables(problem),
            tolerance_table(self.tolerance),
            Table("penalty_weight", "real", (self._penalty(problem),), "penalty of gaps and rows in their scales"),
            Table(
                "proximal_weight",
                "real",
                (0.0, PROXIMAL) if self.proximal is None else (float(self.proximal), 0.0),
                "weight of the proximal term: absolute, and relative to the curvature of the stages",
            ),
            Table("variable_scale", "real", (*scale, *padding), "scales of (x, u), with padding"),
            Table("variable_weight", "real", (*weight, *padding), "1 / scale^2, with padding"),
            Table("initial_weight", "real", tuple(initial), "weight of x_0; 0 for states that are not measured"),
            Table("row_weight", "real", tuple(1.0 / row_scales(problem, scale) ** 2), "1 / scale^2 of row m"),
            Table("row_size", "real", tuple(row_sizes(problem, scale)), "scale of a violation of row m"),
            Table("row_bends", "int", bends, "1: row that is soft or linear, so that its term changes along a step"),
            Table("row_relaxed", "int", relaxed, "1: hard row that is relaxed, 2: soft row, 0: bound that holds"),
            *resample_tables(self.shift, self.sampling_time, problem),
        )

    def _penalty(self, problem: Problem) -> float:
        if self.penalty is not None:
            return float(self.penalty)
        return PENALTY * cost_magnitude(problem, variable_scales(problem))

    def decide(self, problem: Problem, small: bool) -> tuple[AugmentedLagrangian, tuple[str, ...]]:
        """Choose the shift for "auto"."""
        shift, reasons = decide_shift(self.shift, self.sampling_time, problem)
        time = resample_time(shift, self.sampling_time, problem)
        return replace(self, shift=shift, sampling_time=time), tuple(reasons)

    def notes(self, problem: Problem) -> tuple[str, ...]:
        """Describe the chosen penalty."""
        if self.penalty is not None:
            return ()
        chosen = self._penalty(problem)
        rule = f"{PENALTY:,g} times the change of the cost, {chosen / PENALTY:.4g}, in the scale of a variable"
        return (f"penalty: {chosen:.4g}; {rule}",)

    def reach(self, problem: Problem) -> float:
        return resample_reach(self.shift, self.sampling_time, problem)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (
            ("LDZ", _pad(dims), "NZ rounded up to a multiple of 4"),
            ("VARIABLES", (dims.N + 1) * _pad(dims), "(N + 1) LDZ"),
            ("ITERATIONS", self.iterations, "Newton iterations of a sample"),
            ("RESTART_SAMPLES", RESTART_SAMPLES, "failed samples in a row after which a plan starts anew"),
            *(self.absent_sizes(dims) if self.repair else ()),
            ("SHIFT", int(self.shift is not None), "1: step() moves the plan before preparing"),
            ("MAX_FACES", MAX_FACES, "faces of the box that one iteration visits"),
            ("FACES_OF_SOLVE", 40, "the same in solve()"),
            ("MAX_INNER", 100, "iterations of solve() between updates of the multipliers"),
            ("MAX_SHIFTS", MAX_SHIFTS, "shifts of a factorisation"),
            ("MAX_BACKTRACKS", MAX_BACKTRACKS, "trials of a projected search"),
            ("MAX_CG", MAX_CG, "conjugate-gradient iterations on a face"),
        )

    def absent_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("REPAIRS", self.repair, "rounds that repair a plan, at most"),)

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        keep = (
            Field("xhat", (dims.nx,), "state measured at the last feedback", "keep"),
            Field("prepared", (), "1 between prepare and feedback", "keep", "int32"),
            replace(SAMPLES, only=lambda f: self.shift or f.repair),
            replace(SOLVED, only=lambda f: f.solve and self.shift),
            state_size(dims),
            *watch_fields(dims),
        )
        results = (
            Field("stats", (), "counters", "result", "stats"),
            Field("kkt", (), "KKT residuals of the last solve", "result", "kkt", only=lambda f: f.solve),
        )
        return (_stats(self.repair), _auglag(dims), Struct("solver", "", (*keep, *results)))


def _pad(dims: Dims) -> Size:
    return Size("LDZ", -(-dims.nz // PANEL) * PANEL)


def _stats(repair: int) -> Struct:
    def count(name: str, doc: str) -> Field:
        return Field(name, (), doc, "result", "int32")

    return Struct(
        "stats",
        "counters of the last feedback or solve",
        (
            count("newton_iterations", "Newton iterations"),
            count("accepted", "those whose step was accepted"),
            count("cg_iterations", "iterations of conjugate gradients"),
            count("faces", "faces on which the model was minimised"),
            count("shifts", "shifts of the preconditioner"),
            count("negative_curvature", "directions of negative curvature"),
            Field("sqp_iterations", (), "iterations of the last solve", "result", "int32", only=lambda f: f.solve),
            *only_if(repair, count("repairs", "rounds that have repaired the plan")),
            Field("violation", (), "largest gap or violation of a hard row, scaled", "result"),
            Field("residual", (), "largest gap or violation of a hard row, in the scale of states and rows", "result"),
        ),
    )


def _auglag(dims: Dims) -> Struct:
    nodes = dims.nodes
    padded = _pad(dims)
    step, states, controls = (nodes, padded), (nodes, dims.nx), (dims.N, dims.nu)

    def real(name: str, shape: tuple[Size, ...], doc: str) -> Field:
        return Field(name, shape, doc, "scratch")

    return Struct(
        "auglag",
        "augmented Lagrangian",
        (
            real("lam", states, "multipliers of the gaps after the last update"),
            real("row", (dims.ng,), "multipliers of the relaxed rows after the last update"),
            real("gap", states, "xhat - x_0, Phi_k - x_{k+1}"),
            real("value", (dims.ng,), "values of the rows"),
            real("term", (dims.ng,), "their terms: value at the present plan of the parabolas of the model"),
            real("slope", (dims.ng,), "slope of the parabolas there"),
            real("curvature", (dims.ng,), "curvature of the parabolas"),
            *only_if(
                dims.ng > 0,
                real("offset", (), "change of the values since the model was assembled"),
                real("best", (), "least value of the model"),
                real("kept_d", step, "step before that on the present face"),
                real("kept_Hd", step, "H kept_d"),
            ),
            real("cost", (), "cost of the plan"),
            Field("penalty", (), "penalty of gaps and rows, rho", "keep"),
            real("proximal", (), "r"),
            Field("radius", (), "radius of the trust region", "keep"),
            Field("settled", (), "1: the last step reduced the cost as its model predicted", "scratch", "int32"),
            real("precision", (), "of conjugate gradients, squared"),
            real("largest", (), "largest diagonal entry of the Hessian, scaled"),
            real("bend", (), "largest diagonal entry of the Hessian of the stages, scaled"),
            real("predicted", (), "reduction that the last step promised"),
            Field("factorized", (), "1: the factors exist", "scratch", "int32"),
            real("shift", (), "of the factorisation"),
            Field("shifts", (), "shifts of this iteration", "scratch", "int32"),
            real("H", (nodes, padded, padded), "blocks H_k of the Hessian of the model"),
            real("B", (dims.N, dims.nx, padded), "blocks B_k between x_{k+1} and node k"),
            real("L", (nodes, padded, padded), "factors of the blocks"),
            real("W", (dims.N, dims.nx, padded), "factors of the couplings"),
            real("g", step, "gradient"),
            real("lower", step, "lower bounds of the step"),
            real("upper", step, "upper bounds of the step"),
            real("open", step, "1: free variable of the face"),
            real("d", step, "step"),
            real("Hd", step, "H d"),
            real("w", step, "direction on a face"),
            real("Hw", step, "H w"),
            real("residual", step, "residual of conjugate gradients"),
            real("p", step, "their direction"),
            real("Hp", step, "H p"),
            real("kept_x", states, "states before the step"),
            real("kept_u", controls, "controls before the step"),
            real("kept_gap", states, "gaps before the step"),
            real("kept_value", (dims.ng,), "values of the rows before the step"),
            real("kept_cost", (), "cost before the step"),
        ),
    )
