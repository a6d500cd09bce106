"""Explicit Runge-Kutta integration with forward sensitivities, fixed step.

    X_i = x + h sum_j a_ij K_j,   K_i = f(X_i, u, p),   x+ = x + h sum_i b_i K_i
    S = d x / d(x_k, u_k):        K_i' = f_x(X_i) S_i + [0 f_u(X_i)],  same tableau, S = [I 0] at the start

([H11] section 3.1; algorithms.md 2). All are written as Sweeps: straight-line or looped code from one description.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal, get_args

import casadi as ca

from nmpc_codegen.component import Counts, Dims
from nmpc_codegen.errors import OptionError
from nmpc_codegen.integrators.tableau import RK4, TABLEAUS, ButcherTableau
from nmpc_codegen.kernel import Kernel, OpCount, Port
from nmpc_codegen.problem import Problem
from nmpc_codegen.sweep import Affine, Call, For, LoopedRoutine, Node, Routine, Slice, Sweep, looped, straight, unroll

Unroll = Literal["auto", "all", "step", "none"]

# unroll="auto": the largest straight-line program, in instructions, before loops are preferred
AUTO_INSTRUCTIONS = 4000


@dataclass(frozen=True)
class ExplicitRungeKutta:
    """Explicit Runge-Kutta scheme with ``steps`` equal steps per interval.

    unroll: "all" (one straight-line program per interval), "step" (a loop over steps), "none" (loops over steps and
    sensitivity columns, calls per stage), "auto" (the most unrolled one below a size limit).
    """

    tableau: ButcherTableau = RK4
    steps: int = 2
    unroll: Unroll = "auto"

    seam: ClassVar[str] = "integrator"
    name: ClassVar[str] = "explicit_runge_kutta"
    template: ClassVar[str] = "integrators/explicit_runge_kutta.c.jinja"
    needs: ClassVar[tuple[str, ...]] = ()
    supports: ClassVar[frozenset[str]] = frozenset({"soft rows", "coupled rows", "free initial state", "general cost"})

    def __post_init__(self) -> None:
        if isinstance(self.tableau, str) and self.tableau in TABLEAUS:
            object.__setattr__(self, "tableau", TABLEAUS[self.tableau])
        if not isinstance(self.tableau, ButcherTableau):
            raise OptionError(f"tableau: {self.tableau!r}; expected one of {', '.join(TABLEAUS)} or a ButcherTableau")
        if isinstance(self.steps, bool) or not isinstance(self.steps, int) or self.steps < 1:
            raise OptionError(f"steps: {self.steps!r}; expected an integer >= 1")
        if self.unroll not in get_args(Unroll):
            raise OptionError(f"unroll: {self.unroll!r}; expected one of {', '.join(get_args(Unroll))}")

    def routines(self, problem: Problem) -> tuple[Routine, ...]:
        """interval(x, u, p, dt -> x_next, S) and step(x, u, p, h -> x_next)."""
        if problem.discrete:
            raise OptionError(f"integrator: {problem.name} is a discrete map; expected Discrete()")
        return self._interval(problem), straight(step_sweep(problem, self.tableau))

    def _interval(self, problem: Problem) -> Routine:
        if self.unroll == "all":
            return straight(interval_sweep(problem, self.tableau, self.steps))
        if self.unroll == "step":
            return looped(interval_sweep(problem, self.tableau, self.steps, fuse_steps=True))
        rolled = looped(interval_sweep(problem, self.tableau, self.steps))
        if self.unroll == "none":
            return rolled
        # Straight-line code takes at most as many operations as the loops do: a bound known before unrolling.
        estimate = rolled.count.total
        if estimate <= 10 * AUTO_INSTRUCTIONS:
            program = straight(interval_sweep(problem, self.tableau, self.steps))
            if len(program.instructions) <= AUTO_INSTRUCTIONS:
                return program
        if estimate <= 10 * AUTO_INSTRUCTIONS * self.steps:
            stepped = looped(interval_sweep(problem, self.tableau, self.steps, fuse_steps=True))
            if sum(len(k.instructions) for k in stepped.kernels) <= AUTO_INSTRUCTIONS:
                return stepped
        return rolled

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("STEPS", self.steps, "Runge-Kutta steps per interval"),)

    def structs(self, dims: Dims) -> tuple[Any, ...]:
        return ()

    def cost(self, dims: Dims, known: Counts) -> dict[str, OpCount]:
        return {}


class _Builder:
    """Leaves and slices of the Runge-Kutta sweeps of one problem."""

    def __init__(self, problem: Problem, tableau: ButcherTableau) -> None:
        self.nx, self.nu, self.np = problem.nx, problem.nu, problem.np
        self.tableau = tableau
        self.x, self.u, self.p = problem.path.x, problem.path.u, problem.path.p
        self.f = problem.dynamics(self.x, self.u, self.p)
        self.fx = ca.sparsify(ca.jacobian(self.f, self.x))
        self.fu = ca.densify(ca.jacobian(self.f, self.u))

    def leaf_f(self) -> Any:
        """K = f(X, u, p)."""
        return ca.Function("f", [self.x, self.u, self.p], [self.f], ["x", "u", "p"], ["K"])

    def leaf_f_and_jacobian(self) -> Any:
        """K = f, the nonzeros of f_x, and f_u by columns."""
        nonzeros = ca.vertcat(*self.fx.nonzeros()) if self.fx.nnz() else ca.SX(0, 1)
        return ca.Function(
            "linearize_f",
            [self.x, self.u, self.p],
            [self.f, nonzeros, ca.vec(self.fu)],
            ["x", "u", "p"],
            ["K", "fx", "fu"],
        )

    def leaf_product(self) -> Any:
        """K' = f_x S for one column of S."""
        nonzeros, column = ca.SX.sym("fx", self.fx.nnz()), ca.SX.sym("s", self.nx)
        return ca.Function("fx_times", [nonzeros, column], [self._jacobian(nonzeros) @ column], ["fx", "s"], ["Ks"])

    def leaf_product_control(self) -> Any:
        """K' = f_x S + f_u for one control column."""
        nonzeros, column, fu = (ca.SX.sym(n, k) for n, k in (("fx", self.fx.nnz()), ("s", self.nx), ("fu", self.nx)))
        value = self._jacobian(nonzeros) @ column + fu
        return ca.Function("fx_times_plus_fu", [nonzeros, column, fu], [value], ["fx", "s", "fu"], ["Ks"])

    def _jacobian(self, nonzeros: Any) -> Any:
        return ca.SX(self.fx.sparsity(), nonzeros) if self.fx.nnz() else ca.SX(self.nx, self.nx)

    def leaf_combination(self, name: str, coefficients: Sequence[Fraction]) -> Any:
        """y = x + h sum_j c_j K_j over the nonzero c_j; equal coefficients share one product."""
        x, h = ca.SX.sym("x", self.nx), ca.SX.sym("h")
        slopes = [ca.SX.sym(f"K{j}", self.nx) for j, c in enumerate(coefficients) if c]
        values = [c for c in coefficients if c]
        y = x
        for c in dict.fromkeys(values):
            same = [k for k, v in zip(slopes, values, strict=True) if v == c]
            total = same[0]
            for k in same[1:]:
                total = total + k
            y = y + (h if c == 1 else h * float(c)) * total
        return ca.Function(name, [x, h, *slopes], [y], ["x", "h", *(f"K{j}" for j in range(len(slopes)))], ["y"])

    def stage_slopes(
        self, buffer: str, coefficients: Sequence[Fraction], offset: Affine, stage_size: int
    ) -> list[Slice]:
        """Slices of the K_j with nonzero coefficient."""
        return [
            Slice(buffer, self.nx, Affine(offset.constant + j * stage_size, offset.terms))
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
            slopes = b.stage_slopes("K", tableau.a[i], Affine(), nx)
            body.append(Call(b.leaf_combination(f"stage_{i}", tableau.a[i]), (x, h, *slopes), (point,)))
        body.append(Call(b.leaf_f(), (point, *up), (Slice("K", nx, Affine(i * nx)),)))
    slopes = b.stage_slopes("K", tableau.b, Affine(), nx)
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

    Local S is kept by columns, so that one leaf serves the state and every sensitivity column. ``fuse_steps`` unrolls
    one step into a single leaf.
    """
    b = _Builder(problem, tableau)
    nx, nz = b.nx, b.nx + b.nu
    length = (lambda dt: dt / steps) if not problem.uniform else (lambda dt: ca.SX(problem.dt[0] / steps))
    dt = ca.SX.sym("dt")
    start = ca.vec(ca.horzcat(ca.DM.eye(nx), ca.DM.zeros(nx, b.nu)))
    body: list[Node] = [
        Call(ca.Function("step_length", [dt], [length(dt)], ["dt"], ["h"]), (Slice("dt", 1),), (Slice("h", 1),)),
        Call(_copy(nx), (Slice("x", nx),), (Slice("X", nx),)),
        Call(ca.Function("identity", [], [ca.SX(ca.densify(start))], [], ["s"]), (), (Slice("Sc", nx * nz),)),
    ]
    step = tuple(_sensitivity_step(b))
    if fuse_steps:
        step = (_fused_step(b, step),)
    body.append(For("step", 0, steps, step))
    body.append(Call(_copy(nx), (Slice("X", nx),), (Slice("x_next", nx),)))
    scatter = Call(
        _copy(nx), (Slice("Sc", nx, Affine(0, (("c", nx),))),), (Slice("S", nx, Affine(0, (("c", 1),)), nz),)
    )
    body.append(For("c", 0, nz, (scatter,)))
    return Sweep(
        "integrator_interval",
        f"x_next = Phi(x, u, p): {steps} {tableau.name} step(s) over dt; S = d x_next / d(x, u)",
        (Port("x", nx), Port("u", b.nu), Port("p", b.np), Port("dt", 1)),
        (Port("x_next", nx), Port("S", nx, nz)),
        _locals(b, step_only=fuse_steps),
        tuple(body),
    )


def _locals(b: _Builder, step_only: bool) -> tuple[tuple[str, int], ...]:
    nx, nz, s = b.nx, b.nx + b.nu, b.tableau.stages
    state = (("h", 1), ("X", nx), ("Sc", nx * nz))
    inner = (("Xi", nx), ("Si", nx), ("K", s * nx), ("Ks", s * nx * nz), ("fx", b.fx.nnz()), ("fu", nx * b.nu))
    return state if step_only else state + inner


def _copy(n: int) -> Any:
    x = ca.SX.sym("x", n)
    return ca.Function("copy", [x], [x], ["x"], ["y"])


def _sensitivity_step(b: _Builder) -> list[Node]:
    """One step of X and Sc (columns) in place; K and Ks hold the stage slopes."""
    nx, nu, nz, t = b.nx, b.nu, b.nx + b.nu, b.tableau
    state, h = Slice("X", nx), Slice("h", 1)
    column = Affine(0, (("c", nx),))
    nodes: list[Node] = []
    for i in range(t.stages):
        leaf = b.leaf_combination(f"stage_{i}", t.a[i])
        moved = any(t.a[i])
        point = Slice("Xi", nx) if moved else state
        if moved:
            nodes.append(Call(leaf, (state, h, *b.stage_slopes("K", t.a[i], Affine(), nx)), (point,)))
        jacobian, fu = Slice("fx", b.fx.nnz()), Slice("fu", nx * nu)
        nodes.append(
            Call(
                b.leaf_f_and_jacobian(),
                (point, Slice("u", nu), Slice("p", b.np)),
                (Slice("K", nx, Affine(i * nx)), jacobian, fu),
            )
        )

        def columns(
            first: int, count: int, product: Any, with_fu: bool, i: int = i, leaf: Any = leaf, moved: bool = moved
        ) -> For:
            s = Slice("Si", nx) if moved else Slice("Sc", nx, column)
            slopes = b.stage_slopes("Ks", t.a[i], column, nx * nz)
            calls: list[Node] = [Call(leaf, (Slice("Sc", nx, column), h, *slopes), (s,))] if moved else []
            extra = (Slice("fu", nx, Affine(-nx * nx, (("c", nx),))),) if with_fu else ()
            target = Slice("Ks", nx, Affine(i * nx * nz, (("c", nx),)))
            calls.append(Call(product, (Slice("fx", b.fx.nnz()), s, *extra), (target,)))
            return For("c", first, count, tuple(calls))

        nodes.append(columns(0, nx, b.leaf_product(), with_fu=False))
        nodes.append(columns(nx, nu, b.leaf_product_control(), with_fu=True))
    update = b.leaf_combination("update", t.b)
    nodes.append(Call(update, (state, h, *b.stage_slopes("K", t.b, Affine(), nx)), (state,)))
    s = Slice("Sc", nx, column)
    nodes.append(For("c", 0, nz, (Call(update, (s, h, *b.stage_slopes("Ks", t.b, column, nx * nz)), (s,)),)))
    return nodes


def _fused_step(b: _Builder, step: tuple[Node, ...]) -> Call:
    """The step as one straight-line leaf (X, Sc, u, p, h) -> (X, Sc)."""
    nx, nz = b.nx, b.nx + b.nu
    ports = (Port("X0", nx), Port("S0", nx * nz), Port("u", b.nu), Port("p", b.np), Port("h", 1))
    load: tuple[Node, ...] = (
        Call(_copy(nx), (Slice("X0", nx),), (Slice("X", nx),)),
        Call(_copy(nx * nz), (Slice("S0", nx * nz),), (Slice("Sc", nx * nz),)),
    )
    inner = tuple(entry for entry in _locals(b, step_only=False) if entry[0] not in ("h", "X", "Sc"))
    sweep = Sweep("step", "one step", ports, (Port("X", nx), Port("Sc", nx * nz)), inner, load + step)
    slices = (Slice("X", nx), Slice("Sc", nx * nz))
    return Call(unroll(sweep), (*slices, Slice("u", b.nu), Slice("p", b.np), Slice("h", 1)), slices)


__all__ = ["ExplicitRungeKutta", "Kernel", "LoopedRoutine", "interval_sweep", "step_sweep"]
