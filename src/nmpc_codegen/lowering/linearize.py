"""IR 2: the functions that a package evaluates, and the choices that the options leave open. CasADi ends here."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from pkgutil import resolve_name
from typing import TypeVar

import casadi as ca

from nmpc_codegen.components.base import (
    SEAMS,
    Algorithm,
    Component,
    Dims,
    Hessian,
    Integrator,
    Parts,
    refuse_unsupported,
)
from nmpc_codegen.components.hessians import ExactHessian
from nmpc_codegen.components.integrators.implicit.node_data import algebraic_kernel, with_node_data
from nmpc_codegen.components.stage_cost import StageCost, slices, stage_costs
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.controls import Saddles, find_saddles, flat_controls, proximal_terms
from nmpc_codegen.frontend.inner import complete_inner
from nmpc_codegen.frontend.problem import Problem, Stage, symbols
from nmpc_codegen.frontend.scales import Scales, scales
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import Block, HessianModel, ModelFunctions, StageModel
from nmpc_codegen.ir.stage_products import Pattern, pattern
from nmpc_codegen.ir.sweep import Call, LoopedRoutine, Routine, Slice
from nmpc_codegen.lowering.choose import (
    Choice,
    choose_hessian,
    choose_qp,
    dimensions,
    is_small,
    multiple_of,
    solves_exactly,
)
from nmpc_codegen.lowering.first_plan import Growth, growth
from nmpc_codegen.lowering.schemes.choose import choose_integrator
from nmpc_codegen.options import REGISTRIES, Online, Options
from nmpc_codegen.targets import NATIVE, PORTABLE, TARGETS, Target


@dataclass(frozen=True, eq=False, kw_only=True)
class Model(ModelFunctions):
    """The problem, the components that solve it with the reasons for their choice, and every function of the package.

    ``options``: those after all choices have been made. ``flat``: controls without curvature, which have
    proximal terms. ``choice``: condensing and QP solver with their reasons, if the algorithm has a QP; ``reasons``:
    those for other parts. ``grown``: growth of the open loop. ``constant_hessian``: the path Hessian block is the same
    at all nodes.
    """

    problem: Problem
    parts: Parts
    options: Options
    flat: tuple[str, ...]
    reasons: tuple[str, ...]
    choice: Choice | None
    grown: Growth
    constant_hessian: bool

    @property
    def target(self) -> Target:
        """The machine for which the C is written."""
        return TARGETS[self.options.target]

    @cached_property
    def dims(self) -> Dims:
        """The sizes that components share."""
        condensing = self.parts.condensing
        shape = None if condensing is None else condensing.qp_shape(self.problem)
        multiple = multiple_of(self.options.goal)
        return dimensions(self.problem, shape, self.constant_hessian, multiple, self.products.banded)

    @cached_property
    def scales(self) -> Scales:
        """The sizes of the quantities of the problem."""
        return scales(self.problem)

    @cached_property
    def saddles(self) -> Saddles:
        """The controls whose slope vanishes somewhere."""
        return find_saddles(self.problem, self.scales.z)

    @property
    def choices(self) -> tuple[str, ...]:
        """All choices with their reasons."""
        problem, found = self.problem, self.saddles
        idle = [problem.control_names[j] for j in found.controls] + [problem.state_names[i] for i in found.states]
        probes = (f"probes at saddles: the slope of {', '.join(idle)} vanishes somewhere",) if idle else ()
        return (*self.reasons, *probes, *(() if self.choice is None else self.choice.reasons))


def linearize(problem: Problem, options: Options | None = None) -> Model:
    """Problem -> Model.

    Raises:
        OptionError: a component does not support the problem, or options clash.
        ProblemError: the terminal cost of lqr_terminal_cost() does not exist.
    """
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    options = options or Options()
    problem = complete(problem, options)
    problem = complete_inner(problem, options.algorithm.sampling_time)
    options = with_blocks(problem, options)
    chosen = options.hessian is None
    options, of_hessian = choose_hessian(problem, options)
    wanted, options = options, options.with_defaults
    target, of_target = TARGETS[options.target], _target_reasons(wanted, TARGETS[options.target])
    algorithm, of_algorithm = options.algorithm.decide(problem, is_small(options))
    options = replace(options, algorithm=algorithm)
    online = options.online
    problem = _with_weights(problem, online)
    problem, flat = _with_proximal(problem, options) if chosen else (problem, ())
    integrator, choices = choose_integrator(problem, options)
    _check(problem, integrator, options.hessian)
    functions = _functions(problem, integrator, options.hessian, options.algorithm)
    if solves_exactly(problem, options, chosen):
        functions, of_solve = _with_exact(problem, integrator, functions)
        of_hessian = (*of_hessian, *of_solve)
    functions = with_node_data(functions, problem) if problem.solved else functions
    constant = _constant_hessian(problem, online, functions)
    parts = Parts(integrator, options.algorithm, options.hessian)
    choice: Choice | None = None
    asked = "qp" in algorithm.needs or algorithm.simulates
    grown = growth(problem, integrator, options.precision) if asked else Growth((), options.precision)
    if "qp" in options.algorithm.needs:
        choice = choose_qp(problem, options, constant, functions, grown)
        parts = replace(parts, condensing=choice.condensing, qp=choice.qp)
    _check(problem, *parts.components)
    parts.algorithm.check_parts(parts)
    notes = (note for component in parts.components for note in component.notes(problem))
    made = {seam: getattr(parts, seam) for seam in SEAMS}
    return Model(
        **{field.name: getattr(functions, field.name) for field in fields(ModelFunctions)},
        problem=problem,
        parts=parts,
        options=replace(options, **made, math=options.math or target.math),
        flat=flat,
        reasons=(*choices, *of_target, *_of_flat(flat), *of_hessian, *of_algorithm, *notes),
        choice=choice,
        grown=grown,
        constant_hessian=constant,
    )


def with_blocks(problem: Problem, options: Options) -> Options:
    """The options with parameters by node, where blocks of controls or rates need some.

    Raises:
        OptionError: parameters of the user have another layout.
    """
    if not problem.inner.data or options.online.parameter == "node":
        return options
    if problem.own_parameters:
        raise OptionError(
            f'Online.parameter: "{options.online.parameter}" clashes with control(hold=...) and with rates on '
            'unequal intervals, which have data of nodes; expected "node" (--set online.parameter=node)'
        )
    return replace(options, online=replace(options.online, parameter="node"))


def _with_weights(problem: Problem, online: Online) -> Problem:
    """Return the problem with full matrices for those weights that may be set to a full matrix at run time."""
    path, terminal = (replace(s, dense_weight=online.dense_weight) for s in (problem.path, problem.terminal))
    return replace(problem, path=path, terminal=terminal)


def _with_proximal(problem: Problem, options: Options) -> tuple[Problem, tuple[str, ...]]:
    """The problem with proximal terms for controls without curvature, where samples solve QPs, and their names."""
    sizes = scales(problem)
    needed = "qp" in options.algorithm.needs and problem.estimation is None
    flat = flat_controls(problem, sizes) if needed else ()
    if not flat:
        return problem, ()
    return replace(problem, proximal=proximal_terms(problem, sizes)), tuple(problem.control_names[j] for j in flat)


def no_curvature_in(flat: tuple[str, ...]) -> str:
    """What the report and a warning say of controls without curvature."""
    return f"the cost has no curvature in {', '.join(flat)}"


def _of_flat(flat: tuple[str, ...]) -> tuple[str, ...]:
    return (f"proximal terms in the QPs of samples: {no_curvature_in(flat)}",) if flat else ()


def _target_reasons(asked: Options, target: Target) -> tuple[str, ...]:
    """Return what the report says of the target: its name, what its packages lack, and what "native" has become."""
    if target != PORTABLE:
        return (f"target: {target.name}; {target.machine}",)
    return ("target: portable; of this machine the compiler knows no vectors",) if asked.target == NATIVE else ()


def complete(problem: Problem, options: Options | None = None) -> Problem:
    """The problem with the terminal cost of lqr_terminal_cost(), which depends on the integrator."""
    if problem.terminal_lqr is None:
        return problem
    found: Problem = resolve_name(problem.terminal_lqr.rule)(problem, options)
    return found


def _check(problem: Problem, *components: Component | None) -> None:
    """Raise OptionError if a component does not support the problem or its options clash with it."""
    present = [component for component in components if component is not None]
    refuse_unsupported(problem, present, REGISTRIES)
    for component in present:
        component.check(problem)


def _functions(
    problem: Problem, integrator: Integrator, hessian: Hessian | None, algorithm: Algorithm
) -> ModelFunctions:
    """All functions that are lifted from CasADi."""
    interval = integrator.interval(problem)
    costs = stage_costs(problem)
    start, path, terminal = (stage_model(problem, integrator, c) for c in (costs.start, costs.path, costs.terminal))
    if "directions" in algorithm.core:
        forward, adjoint = integrator.directional(problem)
        interval = replace(interval, forward=forward, adjoint=adjoint)
        path, terminal = (
            replace(stage, product=stage_product(problem, integrator, cost))
            for stage, cost in ((path, costs.path), (terminal, costs.terminal))
        )
    elif algorithm.pulls_back:
        interval = replace(interval, adjoint=integrator.directional(problem)[1])
    blocks = HessianModel(None, Block(), Block()) if hessian is None else hessian.blocks(problem, costs, integrator)
    slope = _elements(start.gradient)
    return ModelFunctions(
        replace(interval, curved=_with_zeros(blocks.curved, "g", slope)),
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
        previous=len(problem.inner.previous),
        algebraic=algebraic_kernel(problem),
        measurement=_measurement_kernel(problem),
        control_start=_control_start_kernel(problem),
    )


def stage_model(problem: Problem, integrator: Integrator, cost: StageCost) -> StageModel:
    """Cost and gradient of a stage; the integrator provides them if the cost contains an integral."""
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
    """Hessian of the cost of a stage times a vector d; of an integral the part that is that of its rate, along d."""
    if cost.name != "path" or problem.path.cost_rate is None:
        return cost.product_kernel()
    more = (*cost.data_ports, Port("d", cost.nz))
    symbols = [*cost.inputs, cost.yref, cost.W, cost.direction]
    leaf = ca.Function("node_product", symbols, [ca.densify(cost.product)])
    start = Call(leaf, slices(*cost.ports, *more), (Slice("w", cost.nz),))
    return integrator.integrated_product(problem, "path_product", start, more)


def _with_exact(
    problem: Problem, integrator: Integrator, functions: ModelFunctions
) -> tuple[ModelFunctions, tuple[str, ...]]:
    """The functions with the exact Hessian of solve(), in routines of its own; the reason if there is none."""
    try:
        blocks = ExactHessian().blocks(problem, stage_costs(problem), integrator)
    except OptionError as error:
        return functions, (f"solve(): the Hessian of the samples; {error}",)
    curved = _with_zeros(blocks.curved, "g", _elements(functions.start.gradient))
    ends = {"terminal_exact": blocks.terminal.hessian, "start_exact": blocks.start, "initial_exact": blocks.initial}
    named = (replace(routine, name=name) for name, routine in ends.items() if isinstance(routine, Kernel))
    exact = tuple(routine for routine in (curved, *named) if routine is not None)
    return replace(functions, exact=exact), ("solve(): exact Hessian; for convergence from afar",)


def _with_start(blocks: HessianModel) -> Block:
    """The block of the path, with zeros stored in the entries to which the block of the start is added."""
    path, start = blocks.path, blocks.start
    if path.hessian is None or start is None:
        return path
    Q = path.Q | pattern(start, "Q")
    return replace(path, Q=Q, hessian=_with_zeros(path.hessian, "Q", Q))


def _elements(vector: Routine) -> Pattern:
    """(0, element) of every element that a routine with one output vector stores."""
    return frozenset((0, e) for _, e, _ in vector.stores) if isinstance(vector, Kernel) else frozenset()


R = TypeVar("R", Routine, Routine | None)


def _with_zeros(routine: R, port: str, entries: Pattern) -> R:
    """The routine with zeros stored in ``entries``, to which terms are added; a looped one stores all entries."""
    return routine.with_zeros(port, sorted(entries)) if isinstance(routine, Kernel) else routine


def _constant_hessian(problem: Problem, online: Online, functions: ModelFunctions) -> bool:
    """True if the path Hessian reads nothing that differs between nodes and nothing is added to its first block."""
    path, start = functions.path, functions.start.hessian
    if start is not None and start.writes:
        return False
    varying = {"x", "u"} if problem.uniform else {"x", "u", "dt"}
    varying |= {name for name, layout in (("p", online.parameter), ("W", online.weight)) if layout == "node"}
    return path.hessian is not None and path.curvature is None and not varying & _inputs_read(path.hessian)


def _rows_kernel(problem: Problem, stage: Stage, name: str) -> Kernel:
    """h and J = dh / d(x, u) of the general rows of a stage."""
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
    """Controls of the first plan, where a residual that is no bare control tells one."""
    bare = set(problem.path.y_elements)
    if not any(problem.nx + j not in bare and problem.path.target_of(problem.nx + j) for j in range(problem.nu)):
        return None
    ports = Port("p", problem.np + problem.solved), Port("yref", problem.path.ny)
    doc = "controls at which their residuals have their references"
    return lift(problem.control_start, "control_start", doc, ports, (Port("start", problem.nu),))


def _measurement_kernel(problem: Problem) -> Kernel | None:
    """y = h(x, p) and H = dh / dx of an estimator."""
    if problem.observed is None:
        return None
    x, _, p, _ = symbols(problem.nx, 0, problem.np)
    y = problem.observed(x, p)
    function = ca.Function("measurement", [x, p], [y, ca.sparsify(ca.jacobian(y, x))])
    ports, n = (Port("x", problem.nx), Port("p", problem.np)), int(y.numel())
    return lift(function, "measurement", "y = h(x, p), H = dh / dx", ports, (Port("y", n), Port("H", n, problem.nx)))


def _lift_coupled_rows(problem: Problem) -> Kernel:
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
    """Names of the input ports that a routine reads."""
    if isinstance(routine, LoopedRoutine):
        return {p.name for p in routine.inputs}
    return {routine.inputs[i.args[0]].name for i in routine.instructions if i.opcode == ca.OP_INPUT}
