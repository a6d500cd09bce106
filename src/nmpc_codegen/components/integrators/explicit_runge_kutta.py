"""Explicit Runge-Kutta integration with fixed step also computes forward sensitivities.

    X_i = x + h sum_j a_ij K_j,   K_i = f(X_i, u, p),   x+ = x + h sum_i b_i K_i
    S = d x / d(x_k, u_k):        K_i' = f_x(X_i) S_i + [0 f_u(X_i)],  same tableau, S = [I 0] at the start

(Houska, Ferreau and Diehl, Automatica 47, 2011, section 3.1). All are written as Sweeps, so that one description yields
straight-line code or loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, get_args

from nmpc_codegen.components.allowed import Named, Whole, Words, check_options, option
from nmpc_codegen.components.base import EVERY_USE, NONLINEAR, Dims, Integrator
from nmpc_codegen.components.integrators.explicit.directional import Directional
from nmpc_codegen.components.integrators.explicit.first_order import Sensitivities, step_sweep
from nmpc_codegen.components.integrators.explicit.forward_over_adjoint import AdjointSweep
from nmpc_codegen.components.integrators.explicit.products import IntervalSweeps
from nmpc_codegen.components.integrators.explicit.quadrature import Quadrature
from nmpc_codegen.components.integrators.explicit.runge_kutta import MEANINGS
from nmpc_codegen.components.integrators.explicit.symmetric import ThreeSweeps
from nmpc_codegen.components.integrators.jump import jump_kernel, jump_rows_kernel, with_end
from nmpc_codegen.components.integrators.noise import noise_tables
from nmpc_codegen.components.integrators.tableau import RK4, TABLEAUS, ButcherTableau
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.model import Interval, IntervalProducts
from nmpc_codegen.ir.passes import with_number
from nmpc_codegen.ir.sweep import (
    Call,
    LoopedRoutine,
    Routine,
    Sweep,
    lift_loops,
    lift_straight,
)
from nmpc_codegen.ir.tuning import AUTO_INSTRUCTIONS, STEP_OPERATIONS

Unroll = Literal["auto", "all", "none"]

# Limits on the steps per interval and on the operations of a straight-line program: more take too long to compile.
MAX_STEPS = 100_000
MAX_STRAIGHT = 100_000

# Limits on the steps of a backward sweep and on the numbers that it stores, which are on the stack.
MAX_BACKWARD_STEPS = 200
MAX_KEPT = 1 << 16

SCHEMES: dict[str, type[ThreeSweeps] | type[AdjointSweep]] = {
    "symmetric": ThreeSweeps,
    "forward_over_adjoint": AdjointSweep,
}


@dataclass(frozen=True)
class ExplicitRungeKutta(Integrator):
    """The scheme is explicit, with equal steps in every interval.

    Args:
        tableau: the scheme.
        steps: number of steps per interval.
        unroll: "all" (one straight-line program per interval), "none" (loops over steps and sensitivity columns, with a
            call per stage), "auto" ("all" below a size limit). Second derivatives are always loops: with vector
            instructions these are twice as fast as one straight-line program, in less code.

    Examples:
        >>> from nmpc_codegen import RK4, ExplicitRungeKutta, Options
        >>> options = Options(integrator=ExplicitRungeKutta(RK4, steps=2))
    """

    tableau: ButcherTableau = option(RK4, Named(TABLEAUS, (ButcherTableau,)))
    steps: int = option(2, Whole(MAX_STEPS))
    unroll: Unroll = option("auto", Words(get_args(Unroll)))

    name: ClassVar[str] = "explicit_runge_kutta"
    template: ClassVar[str] = "integrators/explicit_runge_kutta.c"
    supports: ClassVar[frozenset[str]] = EVERY_USE - {NONLINEAR}

    def __post_init__(self) -> None:
        check_options(self, self.seam)
        if self.tableau.kind != "explicit":
            raise OptionError(
                f"ExplicitRungeKutta.tableau: {self.tableau.name} is {self.tableau.kind}; expected an explicit scheme, "
                f"one of {', '.join(TABLEAUS)}, or ImplicitRungeKutta({self.tableau.name}) "
                "(--set integrator=implicit_runge_kutta)"
            )

    def check(self, problem: Problem) -> None:
        """Raise OptionError unless the dynamics are a differential equation."""
        if problem.discrete:
            raise OptionError(
                f"integrator: {problem.name} is a discrete map; expected Discrete() (--set integrator=discrete) "
                "instead of ExplicitRungeKutta(...) (--set integrator=explicit_runge_kutta)"
            )

    @property
    def small(self) -> ExplicitRungeKutta:
        """Return the integrator with loops, unless ``unroll`` is stated."""
        return replace(self, unroll="none") if self.unroll == "auto" else self

    def _complete(self, sweep: Sweep, problem: Problem) -> Sweep:
        """Return the sweep of an interval with the maps and noise at its end."""
        return with_end(self._fix_length(sweep, problem), problem)

    def _fix_length(self, sweep: Sweep, problem: Problem) -> Sweep:
        """Return the sweep with a number for the length of a step if all intervals are equal."""
        return with_number(sweep, "h", problem.dt[0] / self.steps) if problem.uniform else sweep

    def longest_step(self, problem: Problem) -> float:
        """Return the length (s) of a step in the longest interval."""
        return max(problem.dt) / self.steps

    def interval(self, problem: Problem) -> Interval:
        """Return interval(x, u, p, dt -> x_next, S) and step(x, u, p, h -> x_next)."""
        sensitivities = Sensitivities(problem, self.tableau, self.steps)
        interval = self._unroll(self._complete(sensitivities.sweep(), problem))
        loops = isinstance(interval, LoopedRoutine) and interval.count.total <= STEP_OPERATIONS * self.steps
        loops = loops and not problem.noise  # lanes would add noise to every step
        one_step = (
            lift_straight(self._fix_length(sensitivities.sweep("integrator_one_step", 1), problem)) if loops else None
        )
        step = self._unroll(step_sweep(problem, self.tableau))
        return Interval(
            interval, step, one_step=one_step, jump=jump_kernel(problem), jump_rows=jump_rows_kernel(problem)
        )

    def operations(self, problem: Problem) -> int:
        """Count the operations of a linearisation of an interval in loops, without its functions."""
        one = Sensitivities(problem, self.tableau, 1)
        return lift_loops(self._complete(one.sweep(), problem)).count.total * self.steps

    def products(self, problem: Problem) -> IntervalProducts:
        """Return the value of an interval, and products with its Jacobians that do not form them."""
        sweeps = IntervalSweeps(problem, self.tableau, self.steps)
        return IntervalProducts(
            self._unroll(self._complete(sweeps.value(), problem)),
            self._backward(self._complete(sweeps.adjoint(), problem)),
            self._unroll(self._complete(sweeps.columns(forced=True), problem)),
            self._unroll(self._complete(sweeps.columns(forced=False), problem)),
        )

    def directional(self, problem: Problem) -> tuple[Routine, Routine]:
        """Return forward(x, u, p, dt, dx, du -> dx_next) and adjoint(x, u, p, dt, adj -> g)."""
        sweeps = Directional(problem, self.tableau, self.steps)
        forward, adjoint = (self._complete(sweep, problem) for sweep in (sweeps.forward(), sweeps.adjoint()))
        return self._unroll(forward), self._backward(adjoint)

    def lift_hessian(self, problem: Problem, scheme: str, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more, lam) -> (x_next, S, g, Q) with second derivatives of an interval.

        ``start`` initialises g and Q from all inputs except lam. The interval adds d(integrated cost) / dz and the
        lower triangle of d2 (lam' Phi + integrated cost) / dz^2, where z = (x, u). ``scheme`` is "symmetric" (three
        sweeps) or "forward_over_adjoint".
        """
        self._refuse_long(name, ())
        b = SCHEMES[scheme](problem, self.tableau, self.steps)
        nx, nz = problem.nx, problem.nx + problem.nu
        sweep = Sweep(
            name,
            f"x_next = Phi(x, u, p): {b.rk.steps_over_dt}, S = d x_next / d(x, u);"
            f" g, Q = gradient, Hessian of cost + lam' Phi + mu' h ({scheme.replace('_', ' ')})",
            (Port("x", nx), Port("u", problem.nu), Port("p", problem.np), Port("dt", 1), *more, Port("lam", nx)),
            (Port("x_next", nx), Port("S", nx, nz), Port("g", nz), Port("Q", nz, nz)),
            b.buffers(),
            (replace(start, note="cost and rows of the node"), *b.body()),
            columns=b.row_lengths(),
            meanings=MEANINGS,
            steps=self.steps,
        )
        sweep = self._complete(sweep, problem)
        self._refuse_long(name, sweep.locals)
        return lift_loops(sweep)

    def _refuse_long(self, name: str, buffers: Sequence[tuple[str, int]]) -> None:
        """Raise OptionError if a backward sweep, which stores the stages of all steps, would need too much stack."""
        kept = sum(size for _, size in buffers)
        if self.steps > MAX_BACKWARD_STEPS or kept > MAX_KEPT:
            raise OptionError(
                f"ExplicitRungeKutta.steps: {self.steps}; {name} goes backward over all steps and stores numbers "
                f"of each on the stack; expected at most {MAX_BACKWARD_STEPS} steps (--set integrator.steps=...) and "
                f"{MAX_KEPT:,} numbers" + (f" instead of {kept:,}" if kept else "")
            )

    def _refuse_straight(self, rolled: LoopedRoutine) -> None:
        """Raise OptionError if a straight-line program of all steps would be too long to generate and compile."""
        if self.unroll == "all" and rolled.count.total > MAX_STRAIGHT:
            raise OptionError(
                f'ExplicitRungeKutta(steps={self.steps}, unroll="all"): {rolled.name} would be about '
                f"{rolled.count.total:,} operations in a row; expected at most {MAX_STRAIGHT:,}: fewer steps "
                "(--set integrator.steps=...) or loops (--set integrator.unroll=auto or none)"
            )

    def integrated_cost(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more) -> l: the value from ``start`` plus the integral of the cost rate."""
        doc = "l = cost of the node + integral of the cost rate over dt"
        sweep = Quadrature(problem, self.tableau, self.steps).value(name, doc, start, more)
        return self._backward(self._fix_length(sweep, problem))

    def integrated_gradient(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more) -> g: the value from ``start`` plus the gradient of the integral."""
        doc = "g = d (cost of the node + integral of the cost rate over dt) / d(x, u)"
        sweep = Quadrature(problem, self.tableau, self.steps).gradient(name, doc, start, more)
        return self._backward(self._fix_length(sweep, problem))

    def integrated_product(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more, d) -> w: H d, added to the value from ``start``.

        H is the Gauss-Newton Hessian of the integral: the second derivatives of the cost rate along the linearised
        states.
        """
        doc = "w = (Hessian of the cost of the node + Gauss-Newton Hessian of the integral of the cost rate over dt) d"
        sweep = Quadrature(problem, self.tableau, self.steps).product(name, doc, start, more)
        return self._backward(self._fix_length(sweep, problem))

    def _backward(self, sweep: Sweep) -> Routine:
        self._refuse_long(sweep.name, sweep.locals)
        return self._unroll(sweep)

    def _unroll(self, sweep: Sweep) -> Routine:
        """Return the sweep as straight-line code or loops, according to ``unroll``."""
        rolled = lift_loops(sweep)
        self._refuse_straight(rolled)
        if self.unroll == "all":
            return lift_straight(sweep)
        # Straight-line code takes at most as many operations as the loops; this bound is known before unrolling.
        if self.unroll == "auto" and rolled.count.total <= 10 * AUTO_INSTRUCTIONS:
            program = lift_straight(sweep)
            if len(program.instructions) <= AUTO_INSTRUCTIONS:
                return program
        return rolled

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """Return the tables of the states and controls with noise."""
        return noise_tables(problem)

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("STEPS", self.steps, "Runge-Kutta steps per interval"),)
