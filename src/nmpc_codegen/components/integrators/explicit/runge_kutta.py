"""All Runge-Kutta sweeps consist of steps of vectors by one tableau, and of the adjoint of a step.

    y = x + h sum_j c_j K_j;   kappa_i = h b_i lam + h sum_j a_ji Xbar_j over later stages j;   lam += sum_i Xbar_i

The buffers are h, the length of a step, X, the state, and K, the slopes of all stages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import casadi as ca

from nmpc_codegen.components.integrators.tableau import ButcherTableau, Coefficient, combine
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression, Function
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import NEXT_STEP, Affine, Call, Slice

#: Length of a step.
LENGTH = Slice("h", 1)

#: Buffer -> its content. In names of matrices, columns belong to those elements of (x, u) whose column does not depend
#: only on time.
MEANINGS: Mapping[str, str] = {
    "h": "length of a step",
    "X": "state at the beginning of a step, then at its end",
    "Xi": "stage point",
    "Xs": "stage points",
    "K": "slopes f at the stage points",
    "Ks": "derivatives of the slopes, columns d / d(x, u)",
    "Sx": "derivatives of the state, columns d / d(x, u)",
    "fx": "nonzeros of f_x at the stage point",
    "Fu": "what controls add to the derivatives of the slopes",
    "E": "columns of the controls: unit rows",
    "tape": "factors of the derivatives of f at the stage points",
    "m": "calls of math.h at a stage point",
    "M": "the same for all stages of a step",
    "adj": "multipliers of the state at the end of a step",
    "lam": "multipliers of the state at the end of a step",
    "Xbar": "adjoints of the stage points",
    "kappa": "adjoints of the slopes that are nonlinear",
    "Hs": "entries of d2 (kappa' f) / d(x, u)^2 at a stage",
    "Z": "derivatives of the stage points, rows in which f is nonlinear",
    "Zs": "derivatives of the stage points, rows in which f is nonlinear",
    "HZ": "second derivatives times derivatives of the stage points",
    "H": "Hessian of the interval, lower triangle",
    "adjS": "derivatives of the multipliers",
    "XbarS": "derivatives of the adjoints of the stage points",
    "ubarS": "derivatives of the adjoints of the controls",
    "dX": "derivative of the state along a direction",
    "dXi": "derivative of the stage point along the direction",
    "dXs": "derivatives of the stage points along the direction",
    "dK": "derivatives of the slopes along the direction",
    "L": "rates of the cost at the stage points",
}


class RungeKutta:
    """Sweeps of one problem, scheme and number of steps consist of these calls."""

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int = 1) -> None:
        self.tableau, self.steps, self.stages = tableau, steps, tableau.stages
        self.nx, self.nu, self.np = problem.nx, problem.nu, problem.np
        self.state, self.up = Slice("X", self.nx), (Slice("u", self.nu), Slice("p", self.np))

    @property
    def steps_over_dt(self) -> str:
        """Return ``2 RK4 steps over dt``."""
        return f"{self.steps} {self.tableau.name} step{'s' if self.steps > 1 else ''} over dt"

    @property
    def columns(self) -> dict[str, int]:
        """Return the row lengths of the buffers that hold stages one after the other."""
        return dict.fromkeys(("K", "Xs", "Xbar", "dK", "dXs"), self.nx)

    @property
    def ports(self) -> tuple[Port, ...]:
        """Return the input ports of an interval."""
        return Port("x", self.nx), Port("u", self.nu), Port("p", self.np), Port("dt", 1)

    def start(self) -> list[Call]:
        """Return the calls h = dt / steps, X = x."""
        dt = ca.SX.sym("dt")
        length = ca.Function("step_length", [dt], [dt / self.steps], ["dt"], ["h"])
        return [
            Call(length, (Slice("dt", 1),), (LENGTH,), note="start"),
            Call(copy("copy_x", self.nx), (Slice("x", self.nx),), (self.state,), note="start"),
        ]

    def slope(self, stage: int) -> Slice:
        """Return K of a stage."""
        return Slice("K", self.nx, Affine(stage * self.nx))

    def combine(
        self, name: str, coefficients: Sequence[Coefficient], x: Slice, slope: Callable[[int], Slice], y: Slice
    ) -> Call:
        """Return the statement y = x + h sum_j c_j K_j over the nonzero c_j; equal coefficients share one product."""
        value, h = ca.SX.sym("x", x.size), ca.SX.sym("h")
        used = [j for j, c in enumerate(coefficients) if c]
        slopes = [ca.SX.sym(f"K{j}", x.size) for j in used]
        names = ["x", "h", *(f"K{j}" for j in range(len(used)))]
        leaf = ca.Function(name, [value, h, *slopes], [combine(value, h, slopes, coefficients)], names, ["y"])
        return Call(leaf, (x, LENGTH, *(slope(j) for j in used)), (y,))

    def point(self, stage: int, target: Slice, name: str = "point") -> Call:
        """Return the stage point X + h sum_j a_ij K_j."""
        return self.combine(f"{name}_{stage}", self.tableau.a[stage], self.state, self.slope, target)

    def update(self, name: str, x: Slice, slope: Callable[[int], Slice], target: Slice | None = None) -> Call:
        """Return the statement target = x + h sum_i b_i K_i; without a target, x is updated in place."""
        return self.combine(name, self.tableau.b, x, slope, target or x)

    def update_state(self, target: Slice | None = None) -> Call:
        """Return the update X + h sum_i b_i K_i."""
        return replace(self.update("update", self.state, self.slope, target), note="end", stage=NEXT_STEP)

    # Directions ------------------------------------------------------------------------------------------------------

    @property
    def moved(self) -> Slice:
        """Return dX, the derivative of the state along a direction."""
        return Slice("dX", self.nx)

    def tangent(self, stage: int) -> Slice:
        """Return dK of a stage."""
        return Slice("dK", self.nx, Affine(stage * self.nx))

    def move(self, stage: int, target: Slice) -> Call:
        """Return dX_i = dX + h sum_j a_ij dK_j."""
        return self.combine(f"moved_{stage}", self.tableau.a[stage], self.moved, self.tangent, target)

    def slopes(self, stage: int, leaf: Function, point: Slice, moved: Slice, du: Slice) -> Call:
        """Return the call of K_i and dK_i at a stage point, by slope_and_tangent()."""
        return Call(leaf, (point, *self.up, moved, du), (self.slope(stage), self.tangent(stage)))

    def slope_and_tangent(self, f: Expression, x: Expression, u: Expression, p: Expression) -> Function:
        """Return the leaf (x, u, p, dx, du) -> f and f_x dx + f_u du."""
        dx, du = ca.SX.sym("dx", self.nx), ca.SX.sym("du", self.nu)
        tangent = ca.jtimes(f, x, dx) + ca.jtimes(f, u, du)
        return ca.Function("f_and_tangent", [x, u, p, dx, du], [f, tangent])

    # Adjoints --------------------------------------------------------------------------------------------------------

    def later(self, stage: int) -> list[int]:
        """Return the stages whose point depends on K_stage."""
        return [j for j in range(stage + 1, self.stages) if self.tableau.a[j][stage]]

    def adjoint_of_slope(
        self, stage: int, value: Expression, h: Expression, bars: Mapping[int, Expression]
    ) -> Expression:
        """Return h b_i value + h sum_j a_ji Xbar_j over later stages j."""
        later = [j for j in self.later(stage) if j in bars]
        coefficients = (self.tableau.b[stage], *(self.tableau.a[j][stage] for j in later))
        slopes = [value, *(bars[j] for j in later)][0 if coefficients[0] else 1 :]
        return combine(ca.SX.zeros(*value.shape), h, slopes, coefficients)

    def update_adjoint(self, name: str, adjoint: Slice, bar: Callable[[int], Slice], down: bool = False) -> Call:
        """Return the statement adjoint += sum_i Xbar_i, summed from the last stage ``down`` or from the first stage."""
        value = ca.SX.sym("adj", adjoint.size)
        stages = range(self.stages)[:: -1 if down else 1]
        bars = [ca.SX.sym(f"Xbar{i}", adjoint.size) for i in stages]
        leaf = ca.Function(name, [value, *bars], [sum(bars, value)])
        return Call(leaf, (adjoint, *map(bar, stages)), (adjoint,), note="adjoint of the step")
