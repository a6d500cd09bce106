"""IR 2: which functions are evaluated. Chooses what the options leave open; CasADi ends here."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from nmpc_codegen.components.base import refuse_unsupported
from nmpc_codegen.components.integrators import Discrete, ExplicitRungeKutta
from nmpc_codegen.frontend.problem import Problem, Stage
from nmpc_codegen.ir.kernel import Kernel, OpCount, Port, lift
from nmpc_codegen.ir.stage_products import Products
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.lowering.choose import choose_qp
from nmpc_codegen.options import REGISTRIES, Online, Options


@dataclass(frozen=True, eq=False)
class Linearization:
    """The problem, the completed options, why they were chosen, and every routine of the package.

    ``constant_hessian``: the path Hessian block is the same at all nodes.
    """

    problem: Problem
    options: Options
    choices: tuple[str, ...]
    routines: tuple[Routine, ...]
    constant_hessian: bool

    def count(self, name: str) -> OpCount:
        """Operations of one evaluation of the routine of that name."""
        return next(r.count for r in self.routines if r.name == name)

    @property
    def products(self) -> Products:
        """Products with the stage matrices."""
        return Products.of(self.problem.nx, self.problem.nu, self.options.hessian, self.routines)


def linearize(problem: Problem, options: Options) -> Linearization:
    """Problem -> Linearization. Raises OptionError for a combination that no component supports."""
    online = options.online
    path, terminal = (replace(s, dense_weight=online.dense_weight) for s in (problem.path, problem.terminal))
    problem = replace(problem, path=path, terminal=terminal)
    options, choices = _choose_integrator(problem, options)
    first = (options.integrator, options.hessian)
    refuse_unsupported(problem, first, REGISTRIES)
    routines: list[Routine] = [r for c in first for r in c.routines(problem)]
    routines += options.hessian.joint_routines(problem, options.integrator)
    routines += [_rows(problem.path, "path"), _rows(problem.terminal, "terminal"), _coupled(problem)]
    constant = _constant_hessian(problem, online, routines)
    products = Products.of(problem.nx, problem.nu, options.hessian, routines)
    known = {r.name: r.count for r in routines} | products.counts | products.column_counts
    options, why = choose_qp(problem, options, constant, known)
    rest = (options.condensing, options.qp, options.algorithm)
    refuse_unsupported(problem, rest, REGISTRIES)
    routines += [r for c in rest for r in c.routines(problem)]
    return Linearization(problem, options, (*choices, *why), tuple(routines), constant)


def _constant_hessian(problem: Problem, online: Online, routines: list[Routine]) -> bool:
    """The path Hessian reads nothing that differs from node to node."""
    named = {r.name: r for r in routines}
    block = named.get("path_hessian")  # a routine of its own: it depends on nothing but what it reads
    varying = {"x", "u"} if problem.uniform else {"x", "u", "dt"}
    varying |= {name for name, layout in (("p", online.parameter), ("W", online.weight)) if layout == "node"}
    return block is not None and "path_curvature" not in named and not varying & _inputs_read(block)


def _choose_integrator(problem: Problem, options: Options) -> tuple[Options, tuple[str, ...]]:
    if options.integrator is not None:
        return options, ()
    chosen = Discrete() if problem.discrete else ExplicitRungeKutta()
    why = "the dynamics are a discrete map" if problem.discrete else "default for differential equations: RK4"
    return replace(options, integrator=chosen), (f"integrator: {chosen.name}; {why}",)


def _rows(stage: Stage, name: str) -> Kernel:
    """h and J = dh / d(x, u) of the general rows of a stage."""
    z = ca.vertcat(stage.x, stage.u)
    terminal = not stage.nu
    h = ca.densify(stage.h) if stage.nh else ca.SX(0, 1)
    J = ca.sparsify(ca.jacobian(h, z)) if stage.nh else ca.SX(0, z.numel())
    args = [stage.x, stage.p] if terminal else [stage.x, stage.u, stage.p]
    ports = [Port("x", stage.nx), Port("p", int(stage.p.numel()))]
    if not terminal:
        ports.insert(1, Port("u", stage.nu))
    doc = f"h = general {name} rows, J = dh / d{'x' if terminal else '(x, u)'}"
    outputs = [Port("h", stage.nh), Port("J", stage.nh, int(z.numel()))]
    return lift(ca.Function("rows", args, [h, J]), f"{name}_rows", doc, ports, outputs)


def _coupled(problem: Problem) -> Kernel:
    """r(x_0, x_N) and its Jacobians."""
    x_0, x_N = (ca.SX.sym(name, problem.nx) for name in ("x_0", "x_N"))
    r = ca.SX(0, 1) if problem.coupled is None else problem.coupled(x_0, x_N)
    n = problem.coupled_rows
    values = [r] + [ca.sparsify(ca.jacobian(r, x)) if n else ca.SX(0, problem.nx) for x in (x_0, x_N)]
    outputs = [Port("r", n), Port("J_0", n, problem.nx), Port("J_N", n, problem.nx)]
    ports = [Port("x_0", problem.nx), Port("x_N", problem.nx)]
    function = ca.Function("coupled", [x_0, x_N], values)
    return lift(function, "coupled_rows", "coupled rows r(x_0, x_N), J_0 = dr / dx_0, J_N = dr / dx_N", ports, outputs)


def _inputs_read(routine: Routine) -> set[str]:
    """Names of the input ports that a routine really reads."""
    if isinstance(routine, LoopedRoutine):
        return {p.name for p in routine.inputs}
    return {routine.inputs[i.args[0]].name for i in routine.instructions if i.opcode == ca.OP_INPUT}
