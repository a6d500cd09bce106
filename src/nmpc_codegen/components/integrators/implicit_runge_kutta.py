"""Implicit Runge-Kutta integration with fixed step serves stiff models and algebraic equations.

    X_i = x + h sum_j a_ij K_j,   K_i = f(X_i, z_i, u, p),   0 = g(X_i, z_i, u, p),   x+ = x + h sum_i b_i K_i

Stages that depend on each other are solved together, by Newton's method with an LU factorisation of their Jacobian M;
derivatives follow from the implicit function theorem with the same factors (Hairer and Wanner, Solving Ordinary
Differential Equations II, sections IV.5, IV.6, IV.8 and VI.1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from nmpc_codegen.components.allowed import Named, Whole, check_options, option
from nmpc_codegen.components.base import EVERY_USE, Dims, Integrator
from nmpc_codegen.components.integrators.implicit.intervals import Intervals
from nmpc_codegen.components.integrators.implicit.stage_kernels import stage_kernels
from nmpc_codegen.components.integrators.jump import jump_kernel, jump_rows_kernel
from nmpc_codegen.components.integrators.noise import noise_tables
from nmpc_codegen.components.integrators.tableau import IMPLICIT, SDIRK3, ButcherTableau
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.model import Interval, IntervalProducts
from nmpc_codegen.ir.sweep import Call, Routine
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.signals import list_some
from nmpc_codegen.package.struct_layout import Field, Struct

#: Limits of the steps per interval, and of the numbers that a backward sweep stores on the stack.
MAX_STEPS, MAX_KEPT = 1000, 1 << 16

#: Largest number of Newton steps of a stage, which reaches rounding errors.
NEWTON_LIMIT = 30

#: Largest number of halvings of a Newton step for the algebraic variables of a node.
HALVINGS = 10

#: Default number of Newton steps of a stage in a sample.
NEWTON_STEPS = 2


@dataclass(frozen=True)
class ImplicitRungeKutta(Integrator):
    """The scheme is implicit, for stiff models and algebraic equations, with equal steps per interval.

    Args:
        tableau: the scheme.
        steps: number of steps per interval.
        newton: number of Newton steps per stage in a sample; None: 2, or up to 12 if the first plan needs them. The
            last correction of the stages is part of stats.residual. solve(), kkt(), integrate() and derivatives iterate
            to rounding errors.

    Examples:
        >>> from nmpc_codegen import ImplicitRungeKutta, Options, RadauIIA3
        >>> options = Options(integrator=ImplicitRungeKutta(RadauIIA3))
    """

    tableau: ButcherTableau = option(SDIRK3, Named(IMPLICIT, (ButcherTableau,)))
    steps: int = option(1, Whole(MAX_STEPS))
    newton: int | None = option(None, Whole(NEWTON_LIMIT - 1, optional=True))

    name: ClassVar[str] = "implicit_runge_kutta"
    template: ClassVar[str] = "integrators/implicit_runge_kutta.c"
    supports: ClassVar[frozenset[str]] = EVERY_USE

    def __post_init__(self) -> None:
        check_options(self, self.seam)
        if self.tableau.kind not in ("diagonally implicit", "fully implicit"):
            raise OptionError(
                f"ImplicitRungeKutta.tableau: {self.tableau.name} is {self.tableau.kind}; expected an implicit "
                f"scheme, of which only the first stage may be explicit: {', '.join(IMPLICIT)}"
            )

    def check(self, problem: Problem) -> None:
        """Raise OptionError unless the dynamics are a differential equation."""
        if problem.discrete:
            raise OptionError(
                f"integrator: {problem.name} is a discrete map; expected Discrete() (--set integrator=discrete) "
                "instead of ImplicitRungeKutta(...) (--set integrator=implicit_runge_kutta)"
            )
        if problem.solved and not self.tableau.a[0][0]:
            raise OptionError(
                f"ImplicitRungeKutta.tableau: the first stage of {self.tableau.name} is explicit, and Newton's method "
                f"solves for {list_some(problem.newton_names)}; expected a scheme without explicit stages, as RadauIIA3"
            )

    @property
    def small(self) -> ImplicitRungeKutta:
        """Return the integrator itself, whose code consists of loops."""
        return self

    @property
    def newton_steps(self) -> int:
        """Return the number of Newton steps of a stage in a sample."""
        return NEWTON_STEPS if self.newton is None else self.newton

    def longest_step(self, problem: Problem) -> float:
        """Return the length (s) of a step in the longest interval."""
        return max(problem.dt) / self.steps

    def _intervals(self, problem: Problem) -> Intervals:
        return Intervals(problem, self.tableau, self.steps, self.newton_steps)

    def interval(self, problem: Problem) -> Interval:
        """Return the routines of an interval with sensitivities, of a step, and of an interval without sensitivities.

        interval(x, u, p, dt, newton -> x_next, S, left), step(x, u, p, h, newton -> x_next),
        value(x, u, p, dt, newton -> x_next, left).
        """
        found = self._intervals(problem)
        return Interval(
            found.interval(),
            found.step(),
            value=found.value(leaving=True, jumps=False),
            failure=found.failure(),
            jump=jump_kernel(problem),
            jump_rows=jump_rows_kernel(problem),
        )

    def products(self, problem: Problem) -> IntervalProducts:
        """Return the value of an interval, and products with its Jacobians that do not form them."""
        self._refuse_long(problem, "derivatives")
        found = self._intervals(problem)
        return IntervalProducts(found.value(), found.adjoint(), found.columns(True), found.columns(False))

    def directional(self, problem: Problem) -> tuple[Routine, Routine]:
        """Return forward(x, u, p, dt, newton, dx, du -> dx_next) and adjoint(x, u, p, dt, newton, adj -> g)."""
        self._refuse_long(problem, "the adjoint")
        return self._intervals(problem).directional()

    def lift_hessian(self, problem: Problem, scheme: str, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, newton, more, lam) -> (x_next, S, g, Q, left) with second derivatives.

        ``start`` initialises g and Q. The interval adds d(integrated cost) / dz and the lower triangle of d2 (lam' Phi
        + integrated cost) / dz^2, where z = (x, u). ``scheme`` is "symmetric" (three sweeps) or "forward_over_adjoint".
        """
        self._refuse_long(problem, name)
        return self._intervals(problem).hessian(scheme, name, start, more)

    def integrated_cost(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, newton, more) -> l: the value from ``start`` plus the integral."""
        return self._intervals(problem).integral(name, start, more)

    def integrated_gradient(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, newton, more) -> g: the value from ``start`` plus its gradient."""
        self._refuse_long(problem, name)
        return self._intervals(problem).gradient(name, start, more)

    def integrated_product(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, newton, more, d) -> w: H d, added to the value from ``start``.

        H is the Gauss-Newton Hessian of the integral.
        """
        self._refuse_long(problem, name)
        return self._intervals(problem).product(name, start, more)

    def _refuse_long(self, problem: Problem, name: str) -> None:
        """Raise OptionError if a backward sweep, which stores the stages of all steps, would need too much stack."""
        kernels, block = stage_kernels(problem), self.tableau.block
        n, nv = block * kernels.nv, kernels.nv + problem.nu
        kept = self.steps * (self.tableau.stages // block) * (2 * n + block * kernels.nv * nv + n * n)
        if kept > MAX_KEPT:
            raise OptionError(
                f"ImplicitRungeKutta.steps: {self.steps}; {name} goes backward over all steps and stores {kept:,} "
                f"numbers on the stack; expected at most {MAX_KEPT:,}: fewer steps (--set integrator.steps=...), or a "
                "scheme with fewer stages"
            )

    def adds(self, features: Features) -> Features:
        """Return the features with stages that are solved by Newton's method."""
        return replace(features, implicit=True)

    def tables(self, problem: CompleteProblem) -> tuple[Table, ...]:
        """Return the scheme in the form of increments, and the variables that have second derivatives."""
        scheme, kernels = self.tableau, stage_kernels(problem)
        s, block = range(scheme.stages), scheme.block
        sizes = [*problem.scales.z[: problem.nx], *(problem.algebra.scale if problem.algebra else ())]
        units = tuple(float(f"{1 / size:.3g}") for size in sizes)
        first = [i - i % block for i in s]
        together = tuple(float(scheme.a[i][first[i] + j]) for i in s for j in range(block))
        a, b = increments(scheme)
        curved = kernels.curved
        return (
            Table("state_unit", "real", units * block, "1 / scale of a variable of a stage"),
            Table("stage_a", "real", together, "a_ij of stages that are solved together"),
            Table("stage_weight", "real", tuple(map(float, scheme.b)), "b_i"),
            Table("increment_a", "real", tuple(map(float, a.ravel())), "coefficients of increments in later stages"),
            Table("increment_b", "real", tuple(map(float, b)), "coefficients of increments in x_next"),
            Table("bent_variable", "int", curved, "variables of a stage and controls in which it is nonlinear"),
            Table("bent_count", "int", (len(curved),), "number of these variables"),
            *_start_table(problem),
            *noise_tables(problem),
        )

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        block, nv = self.tableau.block, dims.nx + dims.nalg
        return (
            ("STEPS", self.steps, "Runge-Kutta steps per interval"),
            ("STAGES", self.tableau.stages, "stages of a step"),
            ("GROUP", block, "stages that are solved together"),
            ("GROUPS", self.tableau.stages // block, "such groups of a step"),
            ("NXA", nv, "variables of a stage: NX + NALG"),
            ("NXAU", nv + dims.nu, "NXA + NU"),
            ("NB", nv * block, "variables of a group: GROUP * NXA"),
            ("EXPLICIT_FIRST", int(not self.tableau.a[0][0]), "1: the first stage is explicit"),
            ("HALVINGS", HALVINGS, "halvings of a Newton step of algebraic variables at most"),
            ("NEWTON", self.newton_steps, "Newton steps of a stage in a sample"),
            ("NEWTON_LIMIT", NEWTON_LIMIT, "Newton steps of a stage at most"),
        )

    def ranges(self, dims: Dims) -> Mapping[str, tuple[int, int]]:
        """Return the range of ``newton``: samples take a fixed number of Newton steps."""
        return {"newton": (self.newton_steps, self.newton_steps)}

    def structs(self, dims: Dims) -> tuple[Struct, ...]:
        """Return the members for the number of Newton steps, their start, and their last corrections."""
        nodes = dims.nodes
        return (
            Struct("solver", "", (Field("newton", (), "Newton steps of a stage", "keep", "int32"), *_failure_fields())),
            Struct("solver", "", (Field("z", (nodes, dims.nalg), "algebraic variables of the plan", "keep"),)),
            Struct(
                "node",
                "linearisation of a path node",
                (Field("left", (dims.nx,), "residuals of Newton's method in the stages", "data"),),
                shape=(dims.N,),
                only=lambda f: f.nodes,
            ),
        )


def increments(scheme: ButcherTableau) -> tuple[Array, Array]:
    """Return (a, b) of the scheme in increments D.

    base_i = x + sum_j a_ij D_j over earlier blocks, x_next = x + sum_i b_i D_i, where D = h A K with the coefficients A
    of the block, and D = h K for an explicit stage.
    """
    A, b, s = np.array(scheme.a, dtype=float), np.array(scheme.b, dtype=float), scheme.block
    of_blocks = np.zeros_like(A)
    for first in range(0, scheme.stages, s):
        own = slice(first, first + s)
        of_blocks[own, own] = A[own, own] if A[first, first] else np.eye(s)
    if s == 1:
        factor = np.diag(of_blocks)
        return A / factor, b / factor
    stiffly_accurate = bool(np.all(b == A[-1]))
    return np.zeros_like(A), np.eye(scheme.stages)[-1] if stiffly_accurate else np.linalg.solve(A.T, b)


def _start_table(problem: Problem) -> tuple[Table, ...]:
    if problem.algebra is None or not problem.solved:
        return ()
    doc = "where Newton's method of algebraic variables starts at first"
    return (Table("algebraic_start", "real", problem.algebra.start, doc),)


def _failure_fields() -> tuple[Field, ...]:
    """Return the members that name_failed_stage() writes."""
    docs = {
        "interval": "interval with a stage that cannot be solved, or -1",
        "step": "its step",
        "stage": "the stage of this step",
        "state": "state without a pivot, or NX + state that does not converge",
    }
    return tuple(Field(f"failed_{name}", (), doc, "result", "int32") for name, doc in docs.items())
