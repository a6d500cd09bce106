"""Explicit Runge-Kutta integration with forward sensitivities, fixed step.

    X_i = x + h sum_j a_ij K_j,   K_i = f(X_i, u, p),   x+ = x + h sum_i b_i K_i
    S = d x / d(x_k, u_k):        K_i' = f_x(X_i) S_i + [0 f_u(X_i)],  same tableau, S = [I 0] at the start

([H11] section 3.1; algorithms.md 2). All are written as Sweeps: straight-line or looped code from one description.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, Literal, get_args

import casadi as ca

from nmpc_codegen.components.allowed import Named, Whole, Words, check_options, option
from nmpc_codegen.components.base import Defaults, Dims, Seam
from nmpc_codegen.components.integrators.forward_over_adjoint import AdjointSweep
from nmpc_codegen.components.integrators.quadrature import Quadrature
from nmpc_codegen.components.integrators.symmetric import ThreeSweeps
from nmpc_codegen.components.integrators.tableau import RK4, TABLEAUS, ButcherTableau, combine
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Function, nonzeros
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.model import Interval
from nmpc_codegen.ir.passes import expand_steps, fuse_steps
from nmpc_codegen.ir.stage_products import PANEL
from nmpc_codegen.ir.sweep import (
    Affine,
    Call,
    For,
    LoopedRoutine,
    Node,
    Routine,
    Slice,
    Sweep,
    looped,
    straight,
    unroll,
)

Unroll = Literal["auto", "all", "step", "none"]

# Steps per interval, and operations of a straight-line program, beyond which nobody waits for the code.
MAX_STEPS = 100_000
MAX_STRAIGHT = 100_000

# The same for steps of a backward sweep, and numbers that it may keep of all of them: they stand on the stack.
MAX_BACKWARD_STEPS = 200
MAX_KEPT = 1 << 16

# unroll="auto": the largest straight-line program, in instructions, before loops are preferred
AUTO_INSTRUCTIONS = 2500

# The same for second derivatives, whose loops over columns stay: the largest program in statements of all leaves.
AUTO_STATEMENTS = 4000

START = Affine()

SCHEMES: dict[str, type[ThreeSweeps] | type[AdjointSweep]] = {
    "symmetric": ThreeSweeps,
    "forward_over_adjoint": AdjointSweep,
}


@dataclass(frozen=True)
class ExplicitRungeKutta(Defaults):
    """Explicit Runge-Kutta scheme with ``steps`` equal steps per interval.

    unroll: "all" (one straight-line program per interval), "step" (a loop over steps), "none" (loops over steps and
    sensitivity columns, calls per stage), "auto" (the most unrolled one below a size limit). With second derivatives
    "all" keeps loops over columns and over the stages of a step: with vector instructions they are twice as fast as one
    straight-line program, in half the code.
    """

    tableau: ButcherTableau = option(RK4, Named(TABLEAUS, (ButcherTableau,)))
    steps: int = option(2, Whole(MAX_STEPS))
    unroll: Unroll = option("auto", Words(get_args(Unroll)))

    seam: ClassVar[Seam] = "integrator"
    name: ClassVar[str] = "explicit_runge_kutta"
    template: ClassVar[str] = "integrators/explicit_runge_kutta.c"
    needs: ClassVar[tuple[Seam, ...]] = ()
    supports: ClassVar[frozenset[str]] = frozenset(
        {"soft rows", "coupled rows", "free initial state", "general cost", "integrated cost", "accumulators"}
    )

    def __post_init__(self) -> None:
        check_options(self, self.seam)

    def check(self, problem: Problem) -> None:
        """The dynamics have to be a differential equation."""
        if problem.discrete:
            raise OptionError(
                f"integrator: {problem.name} is a discrete map; expected Discrete() (--set integrator=discrete) "
                "instead of ExplicitRungeKutta(...) (--set integrator=explicit_runge_kutta)"
            )

    def longest_step(self, problem: Problem) -> float:
        """The longest interval in ``steps`` equal ones."""
        return max(problem.dt) / self.steps

    def interval(self, problem: Problem) -> Interval:
        """interval(x, u, p, dt -> x_next, S) and step(x, u, p, h -> x_next)."""
        return Interval(self._interval(problem), straight(step_sweep(problem, self.tableau)))

    def curved(self, problem: Problem, scheme: str, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """(x, u, p, dt, more, lam) -> (x_next, S, g, Q): ``start`` fills g and Q from all inputs but lam, the interval
        adds its part d(integrated cost) / dz and d2 (lam' Phi + integrated cost) / dz^2, z = (x, u), lower triangle.

        scheme: "symmetric" (three sweeps) or "forward_over_adjoint".
        """
        self._refuse_long(name, ())
        b = SCHEMES[scheme](problem, self.tableau, self.steps, staggered=self.unroll != "step")
        nx, nz = problem.nx, problem.nx + problem.nu
        sweep = Sweep(
            name,
            f"x_next = Phi(x, u, p): {self.steps} {self.tableau.name} step(s) over dt, S = d x_next / d(x, u);"
            f" g, Q = gradient, Hessian of cost + lam' Phi + mu' h ({scheme.replace('_', ' ')})",
            (Port("x", nx), Port("u", problem.nu), Port("p", problem.np), Port("dt", 1), *more, Port("lam", nx)),
            (Port("x_next", nx), Port("S", nx, nz), Port("g", nz), Port("Q", nz, nz)),
            b.buffers(),
            (start, *b.body()),
        )
        self._refuse_long(name, sweep.locals)
        if self.unroll == "step":
            return looped(fuse_steps(sweep))
        rolled = looped(sweep)
        if self.unroll == "none" or (self.unroll == "auto" and rolled.statements * self.steps > 10 * AUTO_STATEMENTS):
            return rolled
        self._refuse_straight(rolled)
        expanded = looped(expand_steps(sweep))
        small = expanded.statements <= AUTO_STATEMENTS
        return expanded if small or self.unroll == "all" else rolled

    def _refuse_long(self, name: str, buffers: Sequence[tuple[str, int]]) -> None:
        """A backward sweep keeps stages of all steps, on the stack."""
        kept = sum(size for _, size in buffers)
        if self.steps > MAX_BACKWARD_STEPS or kept > MAX_KEPT:
            raise OptionError(
                f"ExplicitRungeKutta.steps: {self.steps}; {name} goes backward over all steps and keeps numbers "
                f"of them on the stack; expected at most {MAX_BACKWARD_STEPS} steps (--set integrator.steps=...) and "
                f"{MAX_KEPT:,} numbers" + (f" instead of {kept:,}" if kept else "")
            )

    def _refuse_straight(self, rolled: LoopedRoutine) -> None:
        """A straight-line program of all steps would be too long to be made and compiled."""
        if self.unroll == "all" and rolled.count.total > MAX_STRAIGHT:
            raise OptionError(
                f'ExplicitRungeKutta(steps={self.steps}, unroll="all"): {rolled.name} would be about '
                f"{rolled.count.total:,} operations in a row; expected at most {MAX_STRAIGHT:,}: fewer steps "
                "(--set integrator.steps=...) or loops (--set integrator.unroll=auto, step or none)"
            )

    def integrated_cost(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """(x, u, p, dt, more) -> l: what ``start`` leaves in l, plus the integral of the cost rate."""
        doc = "l = cost of the node + integral of the cost rate over dt"
        return self._spelled(Quadrature(problem, self.tableau, self.steps).value(name, doc, start, more))

    def integrated_gradient(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """(x, u, p, dt, more) -> g: what ``start`` leaves in g, plus the gradient of the integral, by its adjoint."""
        doc = "g = d (cost of the node + integral of the cost rate over dt) / d(x, u)"
        return self._spelled(Quadrature(problem, self.tableau, self.steps).gradient(name, doc, start, more))

    def _spelled(self, sweep: Sweep) -> Routine:
        """Straight-line or looped, as ``unroll`` says."""
        self._refuse_long(sweep.name, sweep.locals)
        if self.unroll == "step":
            return looped(fuse_steps(sweep))
        rolled = looped(sweep)
        self._refuse_straight(rolled)
        if self.unroll == "all":
            return straight(sweep)
        if self.unroll == "auto" and rolled.count.total <= 10 * AUTO_INSTRUCTIONS:
            program = straight(sweep)
            if len(program.instructions) <= AUTO_INSTRUCTIONS:
                return program
        return rolled

    def _interval(self, problem: Problem) -> Routine:
        if self.unroll == "step":
            return looped(interval_sweep(problem, self.tableau, self.steps, fuse_steps=True))
        rolled = looped(interval_sweep(problem, self.tableau, self.steps))
        self._refuse_straight(rolled)
        if self.unroll == "all":
            return straight(interval_sweep(problem, self.tableau, self.steps))
        if self.unroll == "none":
            return rolled
        # Straight-line code takes at most as many operations as the loops do: a bound known before unrolling.
        estimate = rolled.count.total
        if estimate <= 10 * AUTO_INSTRUCTIONS:
            program = straight(interval_sweep(problem, self.tableau, self.steps))
            if len(program.instructions) <= AUTO_INSTRUCTIONS:
                return program
        return rolled

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("STEPS", self.steps, "Runge-Kutta steps per interval"),)


class _Builder:
    """Leaves and slices of the Runge-Kutta sweeps of one problem."""

    def __init__(self, problem: Problem, tableau: ButcherTableau) -> None:
        self.nx, self.nu, self.np = problem.nx, problem.nu, problem.np
        self.tableau = tableau
        self.x, self.u, self.p = problem.path.x, problem.path.u, problem.path.p
        self.f = problem.dynamics(self.x, self.u, self.p)
        self.fx = ca.sparsify(ca.jacobian(self.f, self.x))
        self.fu = ca.sparsify(ca.jacobian(self.f, self.u))
        self.fu_rows = sorted(set(self.fu.sparsity().row()))
        self.nz = self.nx + self.nu
        self.ld = -(-self.nz // PANEL) * PANEL

    def leaf_f(self) -> Function:
        """K = f(X, u, p)."""
        return ca.Function("f", [self.x, self.u, self.p], [self.f], ["x", "u", "p"], ["K"])

    def leaf_f_and_jacobian(self) -> Function:
        """K = f, the nonzeros of f_x, and the nonzero rows of [0 f_u], ld columns each."""
        values = ca.vertcat(ca.SX(0, 1), *nonzeros(self.fx))
        padded = ca.horzcat(ca.SX(self.nx, self.nx), self.fu, ca.SX(self.nx, self.ld - self.nz))
        rows = ca.vertcat(ca.SX(0, 1), *(padded[i, :].T for i in self.fu_rows))
        return ca.Function(
            "linearize_f",
            [self.x, self.u, self.p],
            [self.f, values, rows],
            ["x", "u", "p"],
            ["K", "fx", "Fu"],
        )

    def leaf_slope(self, stage: int) -> Function:
        """One column of K_i' = f_x (S + h sum_j a_ij K_j') + [0 f_u]."""
        coefficients = self.tableau.a[stage]
        nonzeros, column, h = ca.SX.sym("fx", self.fx.nnz()), ca.SX.sym("s", self.nx), ca.SX.sym("h")
        fu = ca.SX.sym("Fu", len(self.fu_rows))
        slopes = [ca.SX.sym(f"K{j}", self.nx) for j, c in enumerate(coefficients) if c]
        jacobian = ca.SX(self.fx.sparsity(), nonzeros) if self.fx.nnz() else ca.SX(self.nx, self.nx)
        forcing = ca.SX(self.nx, 1)
        for position, row in enumerate(self.fu_rows):
            forcing[row] = fu[position]
        value = jacobian @ combine(column, h, slopes, coefficients) + forcing
        names = ["fx", "s", "h", "Fu", *(f"K{j}" for j in range(len(slopes)))]
        return ca.Function(f"slope_{stage}", [nonzeros, column, h, fu, *slopes], [value], names, ["Ks"])

    def leaf_combination(self, name: str, coefficients: Sequence[Fraction]) -> Function:
        """y = x + h sum_j c_j K_j over the nonzero c_j; equal coefficients share one product."""
        x, h = ca.SX.sym("x", self.nx), ca.SX.sym("h")
        slopes = [ca.SX.sym(f"K{j}", self.nx) for j, c in enumerate(coefficients) if c]
        y = combine(x, h, slopes, coefficients)
        return ca.Function(name, [x, h, *slopes], [y], ["x", "h", *(f"K{j}" for j in range(len(slopes)))], ["y"])

    def slopes(
        self, buffer: str, coefficients: Sequence[Fraction], size: int, offset: Affine = START, stride: int = 1
    ) -> list[Slice]:
        """Slices of the K_j with nonzero coefficient; K_j starts at j * size."""
        return [
            Slice(buffer, self.nx, Affine(offset.constant + j * size, offset.terms), stride)
            for j, c in enumerate(coefficients)
            if c
        ]


def step_sweep(problem: Problem, tableau: ButcherTableau) -> Sweep:
    """x_next = one Runge-Kutta step of length h."""
    b = _Builder(problem, tableau)
    nx, s = b.nx, tableau.stages
    x, h = Slice("x", nx), Slice("h", 1)
    up = (Slice("u", b.nu), Slice("p", b.np))
    body: list[Node] = []
    for i in range(s):
        point = x
        if any(tableau.a[i]):
            point = Slice("X", nx)
            slopes = b.slopes("K", tableau.a[i], nx)
            body.append(Call(b.leaf_combination(f"stage_{i}", tableau.a[i]), (x, h, *slopes), (point,)))
        body.append(Call(b.leaf_f(), (point, *up), (Slice("K", nx, Affine(i * nx)),)))
    slopes = b.slopes("K", tableau.b, nx)
    body.append(Call(b.leaf_combination("update", tableau.b), (x, h, *slopes), (Slice("x_next", nx),)))
    return Sweep(
        "integrator_step",
        f"x_next = one {tableau.name} step of length h from x",
        (Port("x", nx), Port("u", b.nu), Port("p", b.np), Port("h", 1)),
        (Port("x_next", nx),),
        (("X", nx), ("K", s * nx)),
        tuple(body),
    )


def interval_sweep(problem: Problem, tableau: ButcherTableau, steps: int, fuse_steps: bool = False) -> Sweep:
    """x_next = Phi(x, u, p) over one interval and S = d x_next / d(x, u), [nx][nx + nu] row-major.

    Local sensitivities are row-major with rows padded to PANEL columns, so that the loops over columns vectorise.
    ``fuse_steps`` unrolls one step into a single leaf.
    """
    b = _Builder(problem, tableau)
    nx, nz, ld = b.nx, b.nz, b.ld
    length = (lambda dt: dt / steps) if not problem.uniform else (lambda dt: ca.SX(problem.dt[0] / steps))
    dt = ca.SX.sym("dt")
    start = ca.SX.zeros(nx * ld)
    for i in range(nx):
        start[i * ld + i] = 1
    body: list[Node] = [
        Call(ca.Function("step_length", [dt], [length(dt)], ["dt"], ["h"]), (Slice("dt", 1),), (Slice("h", 1),)),
        Call(_copy("copy_x", nx), (Slice("x", nx),), (Slice("X", nx),)),
        Call(ca.Function("identity", [], [start], [], ["s"]), (), (Slice("Sx", nx * ld),)),
    ]
    step = tuple(_sensitivity_step(b))
    body.append(For("step", 0, steps, (_fused_step(b, step),) if fuse_steps else step))
    body.append(Call(_copy("copy_x", nx), (Slice("X", nx),), (Slice("x_next", nx),)))
    row = Call(
        _copy("copy_row", nz), (Slice("Sx", nz, Affine(0, (("i", ld),))),), (Slice("S", nz, Affine(0, (("i", nz),))),)
    )
    body.append(For("i", 0, nx, (row,)))
    return Sweep(
        "integrator_interval",
        f"x_next = Phi(x, u, p): {steps} {tableau.name} step(s) over dt; S = d x_next / d(x, u)",
        (Port("x", nx), Port("u", b.nu), Port("p", b.np), Port("dt", 1)),
        (Port("x_next", nx), Port("S", nx, nz)),
        _locals(b, step_only=fuse_steps),
        tuple(body),
    )


def _locals(b: _Builder, step_only: bool) -> tuple[tuple[str, int], ...]:
    state = (("h", 1), ("X", b.nx), ("Sx", b.nx * b.ld))
    s = b.tableau.stages
    inner = (
        *(("Xi", b.nx), ("K", s * b.nx), ("Ks", s * b.nx * b.ld)),
        *(("fx", b.fx.nnz()), ("Fu", len(b.fu_rows) * b.ld)),
    )
    return state if step_only else state + inner


def _copy(name: str, n: int) -> Function:
    x = ca.SX.sym("x", n)
    return ca.Function(name, [x], [x], ["x"], ["y"])


def _sensitivity_step(b: _Builder) -> list[Node]:
    """One step of X and Sx in place; K and Ks hold the slopes of the stages."""
    nx, nu, ld, t = b.nx, b.nu, b.ld, b.tableau
    state, h = Slice("X", nx), Slice("h", 1)
    column = Affine(0, (("c", 1),))
    S = Slice("Sx", nx, column, ld)
    nodes: list[Node] = []
    for i in range(t.stages):
        point = state
        if any(t.a[i]):
            point = Slice("Xi", nx)
            nodes.append(
                Call(b.leaf_combination(f"stage_{i}", t.a[i]), (state, h, *b.slopes("K", t.a[i], nx)), (point,))
            )
        jacobian, forcing = Slice("fx", b.fx.nnz()), Slice("Fu", len(b.fu_rows) * ld)
        arguments = (point, Slice("u", nu), Slice("p", b.np))
        nodes.append(Call(b.leaf_f_and_jacobian(), arguments, (Slice("K", nx, Affine(i * nx)), jacobian, forcing)))
        slopes = b.slopes("Ks", t.a[i], nx * ld, column, ld)
        target = Slice("Ks", nx, Affine(i * nx * ld, column.terms), ld)
        forcing_column = Slice("Fu", len(b.fu_rows), column, ld)
        nodes.append(For("c", 0, ld, (Call(b.leaf_slope(i), (jacobian, S, h, forcing_column, *slopes), (target,)),)))
    nodes.append(Call(b.leaf_combination("update", t.b), (state, h, *b.slopes("K", t.b, nx)), (state,)))
    slopes = b.slopes("Ks", t.b, nx * ld, column, ld)
    nodes.append(For("c", 0, ld, (Call(b.leaf_combination("update", t.b), (S, h, *slopes), (S,)),)))
    return nodes


def _fused_step(b: _Builder, step: tuple[Node, ...]) -> Call:
    """The step as one straight-line leaf (X, Sx, u, p, h) -> (X, Sx)."""
    nx, size = b.nx, b.nx * b.ld
    ports = (Port("X0", nx), Port("S0", size), Port("u", b.nu), Port("p", b.np), Port("h", 1))
    load: tuple[Node, ...] = (
        Call(_copy("copy_x", nx), (Slice("X0", nx),), (Slice("X", nx),)),
        Call(_copy("copy_S", size), (Slice("S0", size),), (Slice("Sx", size),)),
    )
    inner = tuple(entry for entry in _locals(b, step_only=False) if entry[0] not in ("h", "X", "Sx"))
    sweep = Sweep("step", "one step", ports, (Port("X", nx), Port("Sx", size)), inner, load + step)
    slices = (Slice("X", nx), Slice("Sx", size))
    return Call(unroll(sweep), (*slices, Slice("u", b.nu), Slice("p", b.np), Slice("h", 1)), slices)
