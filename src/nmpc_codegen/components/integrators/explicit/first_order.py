"""One sweep computes the states and forward sensitivities of an interval.

K_i' = f_x(X_i) S_i + [0 f_u(X_i)], S_i = S + h sum_j a_ij K_j', S+ = S + h sum_i b_i K_i',  S = [I 0] at the start
"""

from __future__ import annotations

import casadi as ca

from nmpc_codegen.components.integrators.explicit.runge_kutta import MEANINGS, RungeKutta
from nmpc_codegen.components.integrators.tableau import ButcherTableau, combine
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Function, nonzeros
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.passes import copy
from nmpc_codegen.ir.sweep import NEXT_STEP, Affine, Call, For, Node, Slice, Sweep, add_notes
from nmpc_codegen.ir.tuning import PANEL


def step_sweep(problem: Problem, tableau: ButcherTableau) -> Sweep:
    """Return the sweep of x_next = one Runge-Kutta step of length h."""
    rk = RungeKutta(problem, tableau)
    nx, x = rk.nx, Slice("x", rk.nx)
    f = SchemeDynamics(problem).leaf_f()
    body: list[Node] = []
    for i, coefficients in enumerate(tableau.a):
        point = Slice("X", nx) if any(coefficients) else x
        stage: list[Node] = [Call(f, (point, *rk.up), (rk.slope(i),))]
        if any(coefficients):
            stage.insert(0, rk.combine(f"stage_{i}", coefficients, x, rk.slope, point))
        body += add_notes(stage, f"stage {i + 1}", i)
    body.append(rk.update("update", x, rk.slope, Slice("x_next", nx)))
    return Sweep(
        "integrator_step",
        f"x_next = one {tableau.name} step of length h from x",
        (*rk.ports[:3], Port("h", 1)),
        (Port("x_next", nx),),
        (("X", nx), ("K", rk.stages * nx)),
        tuple(body),
        columns=rk.columns,
        meanings=MEANINGS,
    )


class SchemeDynamics:
    """The right-hand side f and its derivatives are leaves of the sweeps."""

    def __init__(self, problem: Problem) -> None:
        self.x, self.u, self.p = problem.path.x, problem.path.u, problem.path.p
        self.nx, self.nu = problem.nx, problem.nu
        self.f = problem.dynamics(self.x, self.u, self.p)
        self.fx = ca.sparsify(ca.jacobian(self.f, self.x))
        self.fu = ca.sparsify(ca.jacobian(self.f, self.u))
        self.fu_rows = sorted(set(self.fu.sparsity().row()))

    def leaf_f(self) -> Function:
        """Return the leaf K = f(X, u, p)."""
        return ca.Function("f", [self.x, self.u, self.p], [self.f], ["x", "u", "p"], ["K"])

    def leaf_f_and_jacobian(self, ld: int) -> Function:
        """Return the leaf of K = f, the nonzeros of f_x, and the nonzero rows of [0 f_u], ld columns each."""
        values = ca.vertcat(ca.SX(0, 1), *nonzeros(self.fx))
        padded = ca.horzcat(ca.SX(self.nx, self.nx), self.fu, ca.SX(self.nx, ld - self.nx - self.nu))
        rows = ca.vertcat(ca.SX(0, 1), *(padded[i, :].T for i in self.fu_rows))
        inputs = [self.x, self.u, self.p]
        return ca.Function("linearize_f", inputs, [self.f, values, rows], ["x", "u", "p"], ["K", "fx", "Fu"])

    def leaf_slope(self, stage: int, tableau: ButcherTableau) -> Function:
        """Return the leaf of one column of K_i' = f_x (S + h sum_j a_ij K_j') + [0 f_u]."""
        coefficients = tableau.a[stage]
        values, column, h = ca.SX.sym("fx", self.fx.nnz()), ca.SX.sym("s", self.nx), ca.SX.sym("h")
        fu = ca.SX.sym("Fu", len(self.fu_rows))
        slopes = [ca.SX.sym(f"K{j}", self.nx) for j, c in enumerate(coefficients) if c]
        jacobian = ca.SX(self.fx.sparsity(), values) if self.fx.nnz() else ca.SX(self.nx, self.nx)
        forcing = ca.SX(self.nx, 1)
        for position, row in enumerate(self.fu_rows):
            forcing[row] = fu[position]
        value = jacobian @ combine(column, h, slopes, coefficients) + forcing
        names = ["fx", "s", "h", "Fu", *(f"K{j}" for j in range(len(slopes)))]
        return ca.Function(f"slope_{stage}", [values, column, h, fu, *slopes], [value], names, ["Ks"])


class Sensitivities:
    """This sweep computes x_next = Phi(x, u, p) and S = d x_next / d(x, u), [nx][nx + nu] row-major, over one interval.

    Local sensitivities are row-major with rows padded to PANEL columns, so that the loops over columns vectorise.
    """

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int) -> None:
        self.rk, self.f = RungeKutta(problem, tableau, steps), SchemeDynamics(problem)
        self.nz = problem.nx + problem.nu
        self.ld = -(-self.nz // PANEL) * PANEL

    def sweep(self, name: str = "integrator_interval", steps: int | None = None) -> Sweep:
        """Return the sweep (x, u, p, dt) -> x_next, S; ``steps`` limits the number of steps."""
        passes = self.rk.steps if steps is None else steps
        rk, nx, nz, ld = self.rk, self.rk.nx, self.nz, self.ld
        start = ca.SX.zeros(nx * ld)
        for i in range(nx):
            start[i * ld + i] = 1
        source, target = (Slice(name, nz, Affine(0, (("i", n),))) for name, n in (("Sx", ld), ("S", nz)))
        forcing = len(self.f.fu_rows) * ld
        body: list[Node] = [
            *rk.start(),
            Call(ca.Function("no_forcing", [], [ca.SX.zeros(forcing)]), (), (Slice("Fu", forcing),), note="start"),
            Call(ca.Function("identity", [], [start], [], ["s"]), (), (Slice("Sx", nx * ld),)),
            For("step", 0, passes, tuple(self._step())),
            Call(copy("copy_x", nx), (rk.state,), (Slice("x_next", nx),)),
            For("i", 0, nx, (Call(copy("copy_row", nz), (source,), (target,)),)),
        ]
        return Sweep(
            name,
            f"x_next = Phi(x, u, p): {rk.steps_over_dt}; S = d x_next / d(x, u)"
            if passes == rk.steps
            else f"x_next = one of {rk.steps} {rk.tableau.name} steps over dt, S = d x_next / d(x, u)",
            rk.ports,
            (Port("x_next", nx), Port("S", nx, nz)),
            self._locals(),
            tuple(body),
            columns={**rk.columns, "Sx": ld, "Ks": ld, "Fu": ld},
            meanings=MEANINGS,
            steps=passes,
        )

    def _locals(self) -> tuple[tuple[str, int], ...]:
        nx, ld, s = self.rk.nx, self.ld, self.rk.stages
        return (
            *(("h", 1), ("X", nx), ("Sx", nx * ld)),
            *(("Xi", nx), ("K", s * nx), ("Ks", s * nx * ld)),
            *(("fx", self.f.fx.nnz()), ("Fu", len(self.f.fu_rows) * ld)),
        )

    def _column(self, buffer: str, rows: int, block: int = 0) -> Slice:
        """Return column c of a matrix with padded rows."""
        return Slice(buffer, rows, Affine(block * rows * self.ld, (("c", 1),)), self.ld)

    def _slope(self, stage: int) -> Slice:
        return self._column("Ks", self.rk.nx, stage)

    def _step(self) -> list[Node]:
        """Return the statements of one step of X and Sx in place; K and Ks hold the slopes of the stages."""
        rk, f, ld = self.rk, self.f, self.ld
        S, h = self._column("Sx", rk.nx), Slice("h", 1)
        nodes: list[Node] = []
        for i, coefficients in enumerate(rk.tableau.a):
            point = Slice("Xi", rk.nx) if any(coefficients) else rk.state
            if any(coefficients):
                nodes.append(rk.point(i, point, "stage"))
            jacobian, forcing = Slice("fx", f.fx.nnz()), Slice("Fu", len(f.fu_rows) * ld)
            outs = (rk.slope(i), jacobian, forcing)
            nodes.append(Call(f.leaf_f_and_jacobian(ld), (point, *rk.up), outs, keeps_zeros=True))
            slopes = [self._slope(j) for j, c in enumerate(coefficients) if c]
            ins = (jacobian, S, h, self._column("Fu", len(f.fu_rows)), *slopes)
            nodes.append(For("c", 0, ld, (Call(f.leaf_slope(i, rk.tableau), ins, (self._slope(i),)),)))
            nodes = add_notes(nodes, f"stage {i + 1}", i)
        update: list[Node] = [rk.update_state(), For("c", 0, ld, (rk.update("update", S, self._slope),))]
        return [*nodes, *add_notes(update, "end", NEXT_STEP)]
