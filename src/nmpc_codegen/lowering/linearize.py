"""linearize() lifts every function of a package; CasADi is not used after it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import casadi as ca

from nmpc_codegen.components.base import Dims, Integrator, Parts
from nmpc_codegen.components.integrators.implicit.node_data import algebraic_kernel, with_node_data
from nmpc_codegen.components.stage_cost import StageCost, slices
from nmpc_codegen.decisions.choices import Choices
from nmpc_codegen.frontend.completion.complete import CompleteProblem
from nmpc_codegen.frontend.problem import Problem, Stage, symbols
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import Block, HessianModel, ModelFunctions, StageModel
from nmpc_codegen.ir.stage_products import Pattern
from nmpc_codegen.ir.sweep import Call, Routine, Slice
from nmpc_codegen.options import Options
from nmpc_codegen.targets import Target


@dataclass(frozen=True, eq=False, kw_only=True)
class Model(ModelFunctions):
    """A model has the problem, the choices for it, and every function of the package."""

    problem: CompleteProblem
    choices: Choices

    @property
    def parts(self) -> Parts:
        """Return the components that solve the problem."""
        return self.choices.parts

    @property
    def options(self) -> Options:
        """Return all choices as options."""
        return self.choices.options

    @property
    def target(self) -> Target:
        """Return the machine for which the C is written."""
        return self.choices.target.value

    @property
    def dims(self) -> Dims:
        """Return the sizes that components share."""
        return self.choices.dims


def linearize(problem: CompleteProblem, choices: Choices) -> Model:
    """Return the functions of the package of a problem, with those that have already been made for counts."""
    found = _functions(problem, choices)
    functions = with_node_data(found, problem) if problem.solved else found
    of_node = {field.name: getattr(functions, field.name) for field in fields(ModelFunctions)}
    return Model(**of_node, problem=problem, choices=choices)


def _functions(problem: CompleteProblem, choices: Choices) -> ModelFunctions:
    """Return all functions that are lifted from CasADi."""
    integrator, made, algorithm = choices.parts.integrator, choices.made, choices.parts.algorithm
    costs, blocks, interval = made.costs, made.blocks, made.interval
    start, path, terminal = (stage_model(problem, integrator, c) for c in (costs.start, costs.path, costs.terminal))
    if "directions" in algorithm.core:
        forward, adjoint = integrator.directional(problem)
        interval = replace(interval, forward=forward, adjoint=adjoint)
        path, terminal = (
            replace(stage, product=stage_product(problem, integrator, cost))
            for stage, cost in ((path, costs.path), (terminal, costs.terminal))
        )
    slope = _elements(start.gradient)
    return ModelFunctions(
        replace(interval, curved=_with_zeros(blocks.curved, "g", slope)),
        made.products,
        replace(start, block=Block(hessian=blocks.start)),
        replace(
            path,
            gradient=_with_zeros(path.gradient, "g", slope),
            rows=_rows_kernel(problem, problem.path, "path"),
            block=_with_start(blocks),
        ),
        replace(terminal, rows=_rows_kernel(problem, problem.terminal, "terminal"), block=blocks.terminal),
        blocks.initial,
        _lift_coupled_rows(problem),
        exact=_exact_routines(choices.exact.value, slope),
        algebraic=algebraic_kernel(problem),
        measurement=_measurement_kernel(problem),
        control_start=_control_start_kernel(problem),
    )


def stage_model(problem: Problem, integrator: Integrator, cost: StageCost) -> StageModel:
    """Return cost and gradient of a stage; the integrator provides them if the cost contains an integral."""
    if cost.name != "path" or problem.path.cost_rate is None:
        return StageModel(cost.cost_kernel(), cost.gradient_kernel())
    arguments, symbols = slices(*cost.ports, *cost.data_ports), [*cost.inputs, cost.yref, cost.W]
    value = Call(ca.Function("node_cost", symbols, [ca.densify(cost.value)]), arguments, (Slice("l", 1),))
    leaf = ca.Function("node_gradient", symbols, [ca.densify(cost.gradient)])
    gradient = Call(leaf, arguments, (Slice("g", cost.nz),))
    return StageModel(
        integrator.integrated_cost(problem, "path_cost", value, cost.data_ports),
        integrator.integrated_gradient(problem, "path_gradient", gradient, cost.data_ports),
        integrated=True,
    )


def stage_product(problem: Problem, integrator: Integrator, cost: StageCost) -> Routine:
    """Return the Hessian of the cost of a stage times a vector d.

    For an integrated cost, only the second derivatives of the cost rate are included, along d.
    """
    if cost.name != "path" or problem.path.cost_rate is None:
        return cost.product_kernel()
    more = (*cost.data_ports, Port("d", cost.nz))
    symbols = [*cost.inputs, cost.yref, cost.W, cost.direction]
    leaf = ca.Function("node_product", symbols, [ca.densify(cost.product)])
    start = Call(leaf, slices(*cost.ports, *more), (Slice("w", cost.nz),))
    return integrator.integrated_product(problem, "path_product", start, more)


def _exact_routines(blocks: HessianModel | None, slope: Pattern) -> tuple[Routine, ...]:
    """Return the exact Hessian of solve(), in separate routines."""
    if blocks is None:
        return ()
    curved = _with_zeros(blocks.curved, "g", slope)
    ends = {"terminal_exact": blocks.terminal.hessian, "start_exact": blocks.start, "initial_exact": blocks.initial}
    named = (replace(routine, name=name) for name, routine in ends.items() if isinstance(routine, Kernel))
    return tuple(routine for routine in (curved, *named) if routine is not None)


def _with_start(blocks: HessianModel) -> Block:
    """Return the block of the path, with zeros stored in the entries to which the block of the start is added."""
    return replace(blocks.path, Q=blocks.Q, hessian=_with_zeros(blocks.path.hessian, "Q", blocks.Q))


def _elements(vector: Routine) -> Pattern:
    """Return (0, element) of every element that a routine with one output vector stores."""
    return frozenset((0, e) for _, e, _ in vector.stores) if isinstance(vector, Kernel) else frozenset()


R = TypeVar("R", Routine, Routine | None)


def _with_zeros(routine: R, port: str, entries: Pattern) -> R:
    """Return the routine with zeros stored in ``entries``, to which terms are added; looped ones store all entries."""
    return routine.with_zeros(port, sorted(entries)) if isinstance(routine, Kernel) else routine


def _rows_kernel(problem: Problem, stage: Stage, name: str) -> Kernel:
    """Return the kernel of h and J = dh / d(x, u) of the general rows of a stage."""
    z = ca.vertcat(stage.x, stage.u)
    terminal = not stage.nu
    reduce = problem.reduction(stage)
    h = ca.densify(reduce(stage.h, 0)) if stage.nh else ca.SX(0, 1)
    J = ca.sparsify(ca.jacobian(reduce(stage.h, 1), z)) if stage.nh else ca.SX(0, z.numel())
    args = [stage.x, stage.p] if terminal else [stage.x, stage.u, stage.p]
    ports = [Port("x", stage.nx), Port("p", int(stage.p.numel()))]
    if not terminal:
        ports.insert(1, Port("u", stage.nu))
    doc = f"h = general {name} rows, J = dh / d{'x' if terminal else '(x, u)'}"
    outputs = [Port("h", stage.nh), Port("J", stage.nh, int(z.numel()))]
    return lift(ca.Function("rows", args, [h, J]), f"{name}_rows", doc, ports, outputs)


def _control_start_kernel(problem: Problem) -> Kernel | None:
    """Return the kernel of the controls of the first plan, if a residual other than a single control defines one."""
    bare = set(problem.path.y_elements)
    if not any(problem.nx + j not in bare and problem.path.target_of(problem.nx + j) for j in range(problem.nu)):
        return None
    ports = Port("p", problem.np + problem.solved), Port("yref", problem.path.ny)
    doc = "controls at which their residuals have their references"
    return lift(problem.control_start, "control_start", doc, ports, (Port("start", problem.nu),))


def _measurement_kernel(problem: Problem) -> Kernel | None:
    """Return the kernel of y = h(x, p) and H = dh / dx of an estimator."""
    if problem.observed is None:
        return None
    x, _, p, _ = symbols(problem.nx, 0, problem.np)
    y = problem.observed(x, p)
    function = ca.Function("measurement", [x, p], [y, ca.sparsify(ca.jacobian(y, x))])
    ports, n = (Port("x", problem.nx), Port("p", problem.np)), int(y.numel())
    return lift(function, "measurement", "y = h(x, p), H = dh / dx", ports, (Port("y", n), Port("H", n, problem.nx)))


def _lift_coupled_rows(problem: Problem) -> Kernel:
    """Return the kernel of r(x_0, x_N) and its Jacobians."""
    x_0, x_N = (ca.SX.sym(name, problem.nx) for name in ("x_0", "x_N"))
    r = ca.SX(0, 1) if problem.coupled is None else problem.coupled(x_0, x_N)
    n = problem.coupled_rows
    values = [r] + [ca.sparsify(ca.jacobian(r, x)) if n else ca.SX(0, problem.nx) for x in (x_0, x_N)]
    outputs = [Port("r", n), Port("J_0", n, problem.nx), Port("J_N", n, problem.nx)]
    ports = [Port("x_0", problem.nx), Port("x_N", problem.nx)]
    function = ca.Function("coupled", [x_0, x_N], values)
    return lift(function, "coupled_rows", "coupled rows r(x_0, x_N), J_0 = dr / dx_0, J_N = dr / dx_N", ports, outputs)
