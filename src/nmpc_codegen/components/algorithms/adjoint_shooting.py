"""Single shooting with adjoints has only the controls as variables and stores no derivative of the dynamics.

    min_u  sum_k l_k(x_k, u_k) + l_N(x_N) + sum_m psi_m(v_m),   lower <= u <= upper,   x_{k+1} = Phi_k(x_k, u_k)

Bounds of controls hold exactly. The dynamics hold because the states are simulated. Every other row v_m becomes a term
psi_m of the cost. Gradients come from the exact discrete adjoint, lam_k = A_k' lam_{k+1} + dl_k/dx. The memory is some
vectors of N (nx + nu) numbers, because A_k and B_k are evaluated again whenever a sweep multiplies with them.

A Gauss-Newton step minimises the quadratic model inside the bounds by conjugate gradients, each of which takes a
forward and an adjoint sweep. Terminal rows enter the model by their Jacobian Xi = dv / du, which takes one adjoint
sweep per row, and by weights that make the model satisfy the rows. The preconditioner is a Schur complement of the size
of their number.

"Adjoint-based derivative evaluation methods for nonlinear model predictive control", thesis, 2009, chapters 6 and 7.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from nmpc_codegen.components.algorithms.hooked_parts import RESTART_SAMPLES, watch_fields
from nmpc_codegen.components.algorithms.hooked_parts import ROWS as TERMS
from nmpc_codegen.components.algorithms.real_time_iteration import SAMPLE, SOLVE, SOLVED, shift_entry
from nmpc_codegen.components.algorithms.row_scales import cost_magnitude, row_sizes, tolerance_table, variable_scales
from nmpc_codegen.components.algorithms.shifts import (
    SHIFTS,
    check_sampling_time,
    check_shift,
    decide_shift,
    resample_reach,
    resample_tables,
    resample_time,
    with_shift,
)
from nmpc_codegen.components.allowed import Number, Whole, Words, check_options, option
from nmpc_codegen.components.base import EVERY_USE, MEASUREMENTS, NONLINEAR, Algorithm, Core, Dims, HookedPart, Seam
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.package.features import Features, KernelName
from nmpc_codegen.package.signals import EntryPoint
from nmpc_codegen.package.struct_layout import Field, Size, Struct, only_if

METHODS = ("gauss_newton", "quasi_newton")
ROWS = ("augmented_lagrangian", "smooth_l1", "barrier", "lumped")

#: PRECISION: relative residuals of conjugate gradients in a sample and in solve(). SHARPNESS: of the smooth max in the
#: scale of a row, first and last value. ARMIJO: fraction of the predicted decrease that a step must reach. SHORTEST:
#: least fraction of a step with which a later search begins.
PRECISION, SHARPNESS, ARMIJO, SHORTEST = (1e-3, 1e-6), (100.0, 1e4, 1e9), 1e-4, 1 / 64

#: The default penalty, relative to the curvature of the cost, and the default weight of barriers.
FACTOR, BARRIER = 3.0, 1e-2

#: MARGIN: distance from a bound, in the scale of a row, at which the barrier becomes a parabola, for the first weight;
#: it changes with the weight. WEIGHTS: fractions of that weight in the first sample, least one in a sample, least one
#: in solve().
MARGIN, WEIGHTS = 1e-2, (1.0, 1e-2, 1e-10)

#: Largest number of simulations of a step of solve().
MAX_TRIALS = 30

#: Largest number of steps of the method of multipliers for the terminal rows of the model.
MAX_ROUNDS = 3

#: PRODUCTS: limits of the number of products with the Hessian in a Gauss-Newton step, which is else the number of
#: controls. MEMORY: pairs of vectors that the quasi-Newton method stores.
PRODUCTS, MEMORY = (12, 100), 5
ITERATIONS = {"gauss_newton": 1, "quasi_newton": 10}

#: Terms of rows that a continuation over the samples makes sharper. Gauss-Newton steps of their model are short, so
#: that a sample takes more of them, with more simulations each.
FOLLOWED = ("smooth_l1", "barrier", "lumped")
FOLLOWED_STEPS, TRIALS, FOLLOWED_TRIALS = 3, 2, 4

#: Largest number of terminal rows that enter the model by their slopes; if there are more, they are terms like other
#: rows.
MAX_TERMINAL = 16

STEP = EntryPoint(
    "step",
    "Compute u0 for the measured xhat; u0 is finite and inside its bounds on every return.",
    *((arguments,) for arguments in (SAMPLE[0].inputs[0], SAMPLE[0].outputs[0])),
)


@dataclass(frozen=True)
class AdjointShooting(Algorithm):
    """Single shooting with adjoints takes a fixed number of steps per sample, each with a bound on its simulations.

    With rows="smooth_l1", "barrier" and "lumped", a continuation over the samples sharpens the penalty terms as long as
    steps are accepted at once. A sample then has 3 Gauss-Newton steps with 4 trials by default.

    Args:
        method: "gauss_newton", by conjugate gradients inside the bounds, or "quasi_newton", a projected method that
            needs only gradients.
        iterations: number of steps of a sample; None: 1, or 10 with "quasi_newton".
        rows: the terms that replace rows other than bounds of controls. "augmented_lagrangian": exact, with one update
            of the multipliers per sample. "smooth_l1": an l1 penalty with a smooth max, exact in the limit of solve()
            if no multiplier exceeds the weight. "barrier": logarithmic barriers, which keep a distance from the bounds
            and are recentred in every sample at the end of the plan; solve() decreases their weight to 0. "lumped": the
            sum C of the smooth l1 terms as one scalar row C <= 0, whose multiplier solve() increases. Soft rows keep
            their penalties and have no barriers.
        penalty: weight of the rows in their scales. The scale of a row is the magnitude of its slopes or that of its
            bounds, whichever is smaller. None: three times the largest curvature of the cost of a node along a state in
            its scale; for a general cost N times its slope is used, for a cost of controls only its curvature along
            them; barriers have a hundredth of that weight.
        tolerance: violation of a hard row, in its scale, above which a sample is NOT_CONVERGED. It is also
            NOT_CONVERGED if the last step was shortened and changes the first control by more than this in its scale.
        repair: number of steps that a sample may add while the last step was shortened and is longer than ``tolerance``
            in the scale of a control; 0 in packages without solve() and for microcontrollers.
        shift: how the plan moves before every step but the first, as in RealTimeIteration.
        sampling_time: time between samples, as in RealTimeIteration.
    """

    method: str = option("gauss_newton", Words(METHODS))
    iterations: int | None = option(None, Whole(most=1000, optional=True))
    rows: str = option("augmented_lagrangian", Words(ROWS))
    penalty: float | None = option(None, Number(optional=True))
    tolerance: float = option(0.1, Number())
    repair: int = option(3, Whole(most=100, least=0))
    shift: str | None = option("auto", Words(("auto", *SHIFTS)))
    sampling_time: float | None = option(None, Number(optional=True, unit="s"))

    name: ClassVar[str] = "adjoint_shooting"
    template: ClassVar[str] = "algorithms/adjoint_shooting.c"
    needs: ClassVar[tuple[Seam, ...]] = ("integrator",)
    core: ClassVar[frozenset[Core]] = frozenset({"directions", "kkt"})
    supports: ClassVar[frozenset[str]] = EVERY_USE - {
        "free initial state",
        "rows with an infinite penalty",
        NONLINEAR,
        MEASUREMENTS,
    }

    def __post_init__(self) -> None:
        check_options(self, self.seam)
        check_sampling_time("AdjointShooting", self.shift, self.sampling_time)

    @property
    def simulates(self) -> bool:
        """Return True, because the states are never variables."""
        return True

    @property
    def second_order(self) -> bool:
        """Return True if the method multiplies with a Hessian."""
        return self.method == "gauss_newton"

    def decide(self, problem: Problem, small: bool) -> tuple[AdjointShooting, tuple[str, ...]]:
        """Choose the shift for "auto"; switch repair off in a package that cannot iterate."""
        shift, reasons = decide_shift(self.shift, self.sampling_time, problem)
        if self.repair and small:
            reasons.append('repair: 0; goal="size" without solve()')
        time = resample_time(shift, self.sampling_time, problem)
        found = replace(self, shift=shift, sampling_time=time, repair=0 if small else self.repair)
        return found, tuple(reasons)

    def entries(self, features: Features) -> tuple[EntryPoint, ...]:
        """Return the entry points: a sample in one call, the shift of the plan, and the iteration to convergence."""
        return (STEP, shift_entry(self.shift), *((SOLVE,) if features.solve else ()))

    def adds(self, features: Features) -> Features:
        """Return the features without kernels of the linearisation and of x_0, which are not used.

        Without a Hessian, the kernels of its products are removed as well.
        """
        products: tuple[KernelName, ...] = ("integrator_forward", "path_product", "terminal_product")
        unused = () if self.second_order else products
        return replace(
            with_shift(features.without("integrator_interval", "start_gradient", *unused), self.shift),
            quasi_newton=not self.second_order,
            lumped_rows=self.rows == "lumped",
            barrier_rows=self.rows == "barrier",
        )

    def hooked_parts(self, features: Features) -> tuple[HookedPart, ...]:
        """Return the C file with the penalty terms of the rows."""
        has_rows = features.state_rows or features.general_rows or features.has("coupled_rows")
        return (TERMS[self.rows],) if has_rows else ()

    def check(self, problem: Problem) -> None:
        """Raise OptionError for shifts that clash with the grid, or rows that the penalty terms cannot represent."""
        check_shift("AdjointShooting", self.shift, self.sampling_time, problem)
        self._check_rows(problem)

    def _check_rows(self, problem: Problem) -> None:
        """Raise OptionError for rows that the penalty terms cannot represent."""
        rows = [problem.rows[row] for _, _, _, row in problem.qp_rows]
        hard = [row for row in rows if row.soft is None]
        if self.rows in ("smooth_l1", "lumped") and self.penalty is None and hard:
            raise OptionError(
                f'AdjointShooting(rows="{self.rows}") penalises the hard row {hard[0].name!r}; expected penalty=..., a '
                "weight that exceeds the multipliers of hard rows in their scales (--set algorithm.penalty=...)"
            )
        outside = [row for row in rows if row.soft is not None or row.is_equation]
        if self.rows == "barrier" and outside:
            kind = "equation" if outside[0].soft is None else "soft row"
            raise OptionError(
                f'AdjointShooting(rows="barrier") has no terms for the {kind} {outside[0].name!r}; expected other '
                "terms, such as the default (--set algorithm.rows=augmented_lagrangian)"
            )

    def terminal(self, problem: Problem) -> tuple[int, ...]:
        """Return the indices in qp_rows of the rows in the model: hard rows that are imposed only at node N."""
        return problem.end_rows[: self._terminal_rows(len(problem.end_rows))]

    def _terminal_rows(self, found: int) -> int:
        """Return the number of terminal rows in the model, 0 if they are too many or of another kind of penalty."""
        exact = self.second_order and self.rows == "augmented_lagrangian"
        return found if exact and found <= MAX_TERMINAL else 0

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        scale = variable_scales(problem)
        rows, terminal = problem.qp_rows, self.terminal(problem)
        positions = [terminal.index(m) if m in terminal else -1 for m in range(len(rows))]
        accumulators = [int(i in problem.accumulators) for i in range(problem.nx)]
        weights = 1.0 / row_sizes(problem, scale) ** 2
        return (
            Table("is_accumulator", "int", tuple(accumulators), "1: the state starts at 0 at every sample"),
            Table("control_scale", "real", tuple(scale[problem.nx :]), "scales of the controls"),
            Table("penalty_weight", "real", (self._penalty(problem),), "weight of the rows in their scales"),
            tolerance_table(self.tolerance),
            Table("row_weight", "real", tuple(weights), "1 / scale^2 of row m"),
            Table("terminal_row", "int", terminal, "row m of terminal row t in the model"),
            Table("terminal_index", "int", tuple(positions), "terminal row t of row m, or -1"),
            Table("model_precision", "real", PRECISION, "relative residual of conjugate gradients: first, last"),
            Table("smooth_sharpness", "real", SHARPNESS, "sharpness of the smooth max in the scale of a row"),
            Table("barrier_margin", "real", (MARGIN,), "distance from a bound where the barrier becomes a parabola"),
            Table(
                "barrier_weight",
                "real",
                tuple(part * self._penalty(problem) for part in WEIGHTS),
                "weight of the barriers: first, least in a sample, least in solve()",
            ),
            Table("shortest_length", "real", (SHORTEST,), "least fraction of a step in a first trial"),
            Table("armijo_part", "real", (ARMIJO,), "fraction of the decrease that the slope predicts"),
            *resample_tables(self.shift, self.sampling_time, problem),
        )

    def _penalty(self, problem: Problem) -> float:
        if self.penalty is not None:
            return float(self.penalty)
        factor = BARRIER if self.rows == "barrier" else FACTOR
        scale = variable_scales(problem)
        states = np.where(np.arange(scale.size) < problem.nx, scale, 0.0)
        return factor * (cost_magnitude(problem, states, otherwise=0.0) or cost_magnitude(problem, scale))

    def notes(self, problem: Problem) -> tuple[str, ...]:
        """Describe how many terminal rows are in the model, and the penalty of the other rows."""
        count, others = len(self.terminal(problem)), len(problem.qp_rows) > len(self.terminal(problem))
        chosen = f"penalty {self._penalty(problem):.4g}, from the cost in the scales of its variables"
        return (
            *((f"adjoint shooting: {count} terminal rows by a Schur complement",) if count else ()),
            *((f"adjoint shooting: {chosen}",) if others and self.penalty is None else ()),
        )

    def reach(self, problem: Problem) -> float:
        return resample_reach(self.shift, self.sampling_time, problem)

    def _steps(self) -> int:
        followed = self.rows in FOLLOWED and self.second_order
        return self.iterations or (FOLLOWED_STEPS if followed else ITERATIONS[self.method])

    def _products(self, dims: Dims) -> int:
        return min(max(PRODUCTS[0], dims.N * dims.nu), PRODUCTS[1])

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        followed = self.rows in FOLLOWED
        newton, memory = self._of_methods(dims)
        return (
            ("NT", self._terminal_rows(dims.end_rows), "terminal rows in the model"),
            ("ITERATIONS", self._steps(), "steps of a sample"),
            ("REPAIRS", self.repair, "further steps of a sample whose last one is long and was not taken as a whole"),
            ("TRIALS", FOLLOWED_TRIALS if followed else TRIALS, "simulations of a step at most"),
            ("MOST_TRIALS", MAX_TRIALS, "steps that any search tries, at most"),
            *(newton if self.second_order else memory),
            ("RESTART_SAMPLES", RESTART_SAMPLES, "failed samples in a row after which a plan starts anew"),
            ("MOST_PENALTY", 1_000_000_000, "largest penalty of solve()"),
            ("SHIFT", int(self.shift is not None), "1: step() moves the plan before the sample"),
        )

    def absent_sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        newton, memory = self._of_methods(dims)
        return (*newton, *memory)

    def _of_methods(self, dims: Dims) -> tuple[tuple[tuple[str, int, str], ...], ...]:
        """Return the sizes of Newton steps, and of the quasi-Newton method."""
        controls = dims.N * dims.nu
        newton = (
            ("MAX_PRODUCTS", self._products(dims), "products with the Hessian of a step at most"),
            ("PRODUCTS_OF_SOLVE", 4 * controls + 20, "the same in solve()"),
            ("MAX_FACES", 2 * controls + 10, "faces of the box that a step visits at most"),
            ("MAX_ROUNDS", MAX_ROUNDS, "steps of the method of multipliers for terminal rows in a step"),
        )
        return newton, (("MEMORY", MEMORY, "pairs of the quasi-Newton method"),)

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        """Return the range of ``solving``: a sample does not run inside solve()."""
        return {"solving": (0, 0)} if self.second_order else {}

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        members = (
            Field("row", (dims.ng,), "multipliers of the rows", "keep"),
            replace(SOLVED, only=lambda f: f.solve and self.shift),
            Field("samples", (), "samples since init or reset", "keep", "int32", only=lambda f: self.shift),
            *watch_fields(dims),
            Field("stats", (), "counters", "result", "stats"),
            Field("kkt", (), "KKT residuals of the last solve", "result", "kkt", only=lambda f: f.solve),
        )
        return (_stats(self.second_order), self._shooting(dims), Struct("solver", "", members))

    def _growing(self, dims: Dims) -> tuple[Field, ...]:
        """Return the weights that solve() changes, and the weight of a lumped row."""
        has, lumped = dims.ng > 0, self.rows == "lumped"

        def growing(name: str, doc: str, present: bool) -> Field:
            return Field(name, (), doc, "scratch", only=lambda f: f.solve and present)

        return (
            growing("penalty", "weight of the rows in their scales", has and self.rows != "barrier"),
            growing("multiplier", "of the lumped row", has and lumped),
            Field(
                "lump",
                (),
                "weight of the lumped hard rows at the plan",
                "scratch",
                only=lambda f: has and lumped,
            ),
        )

    def _shooting(self, dims: Dims) -> Struct:
        terminal = Size("NT", self._terminal_rows(dims.end_rows))
        pairs = Size("MEMORY", MEMORY)
        controls = (dims.N, dims.nu)

        def real(name: str, shape: tuple[Size, ...], doc: str) -> Field:
            return Field(name, shape, doc, "scratch")

        sharpness = Field("sharpness", (), "sharpness of the smooth max, in the scale of a row", "keep")
        change = real("lump_change", (), "its change along a direction")
        terms = {
            "smooth_l1": (sharpness,),
            "barrier": (
                Field("penalty", (), "weight of the barriers", "keep"),
                real("tilt", (dims.ng,), "slope of the barriers at their centres"),
            ),
            "lumped": (
                sharpness,
                *only_if(self.second_order, change),
            ),
        }
        chosen = terms.get(self.rows, ()) if dims.ng else ()
        names = {member.name for member in chosen}
        newton = (
            real("dx", (dims.N, dims.nx), "states of a direction at nodes 1 .. N"),
            real("Xi", (terminal, *controls), "slopes of the terminal rows"),
            real("S", (terminal, terminal), "factor of their Schur complement"),
            real("gap", (terminal,), "their distances from the bounds that they are held at"),
            real("omega", (terminal,), "their weights in the model and then in the merit function"),
            real("model", (), "change of the model by the step"),
            Field("solving", (), "1 during solve()", "scratch", "int32", only=lambda f: f.solve and not f.quasi_newton),
            Field("left", (), "products that remain", "scratch", "int32"),
        )
        memory = (
            real("Y", (pairs, *controls), "changes of the gradient"),
            real("Z", (pairs, *controls), "changes of the controls"),
            real("D", controls, "diagonal of the inverse Hessian without pairs"),
            Field("pairs", (), "pairs since reset; MEMORY .. 2 MEMORY - 1 once the memory is full", "keep", "int32"),
            Field("paired", (), "1: the last step belongs to the present problem", "scratch", "int32"),
        )
        return Struct(
            "shooting",
            "single shooting",
            (
                *self._growing(dims),
                *chosen,
                *only_if(False, *(member for member in terms["lumped"] if member.name not in names)),
                Field("length", (), "fraction of the step for the first trial", "keep"),
                real("r", controls, "gradient in scaled controls"),
                real("d", controls, "step"),
                real("p", controls, "direction; controls before the step"),
                real("w", controls, "product with the Hessian; gradient before the step"),
                Field("held", controls, "-1, 1: held at the lower, upper bound", "scratch", "int32"),
                *(replace(member, only=member.only or (lambda f: not f.quasi_newton)) for member in newton),
                *(replace(member, only=lambda f: f.quasi_newton) for member in memory),
            ),
        )


def _stats(second_order: bool) -> Struct:
    def count(name: str, doc: str) -> Field:
        return Field(name, (), doc, "result", "int32")

    products = (
        count("cg_iterations", "products with the Hessian"),
        count("faces", "faces on which the model was minimised"),
        count("negative_curvature", "directions of negative curvature"),
    )
    return Struct(
        "stats",
        "counters of the last sample or solve",
        (
            count("newton_iterations", "steps"),
            count("accepted", "those that were accepted"),
            count("simulations", "simulations of the plan"),
            *only_if(second_order, *products),
            Field("sqp_iterations", (), "iterations of the last solve", "result", "int32", only=lambda f: f.solve),
            Field("violation", (), "largest violation of a hard row, scaled", "result"),
        ),
    )
