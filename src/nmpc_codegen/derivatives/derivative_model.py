"""A derivative model holds the functions that the derivative toolbox evaluates, lifted from CasADi."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from nmpc_codegen.components.base import Integrator
from nmpc_codegen.components.hessians.exact import ForwardOverAdjoint, Symmetric
from nmpc_codegen.components.integrators import Discrete, ExplicitRungeKutta
from nmpc_codegen.components.stage_cost import StageCost, stage_costs
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.classify import classify, outputs_of
from nmpc_codegen.frontend.completion.complete import CompleteProblem, complete
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.kernel import Port, lift
from nmpc_codegen.ir.model import IntervalProducts, StageModel
from nmpc_codegen.ir.sweep import Call, LoopedRoutine, Routine, Slice
from nmpc_codegen.lowering.linearize import stage_model
from nmpc_codegen.options import Options
from nmpc_codegen.package.struct_layout import Precision

#: Largest number of entries of a matrix that C's type int can count.
MOST_ENTRIES = 2**31 - 1


@dataclass(frozen=True, eq=False)
class DerivativeModel:
    """A derivative model has the functions of one problem and its outputs.

    linearize: (x, u, p, dt) -> x_next, S = [A B]; products: see IntervalProducts; path, terminal: cost and gradient.
    output: (x, u, p) -> z, and output_jacobian G = [C D], row by row; both None without outputs. hessians: {sweep: (x,
    u, p, dt, lam) -> x_next, S, g = 0, Q = lower triangle of d2 (lam' Phi) / d(x, u)^2}, empty without second order.
    """

    problem: CompleteProblem
    integrator: Integrator
    precision: Precision
    linearize: Routine
    products: IntervalProducts
    path: StageModel
    terminal: StageModel
    output_names: tuple[str, ...]
    output: Routine | None
    output_jacobian: Routine | None
    hessians: Mapping[str, Routine]

    @property
    def second_order(self) -> bool:
        """Return True if there are second derivatives."""
        return bool(self.hessians)

    @property
    def outputs(self) -> int:
        """Return the number of outputs."""
        return len(self.output_names)

    @property
    def routines(self) -> tuple[Routine, ...]:
        """Return all functions in the order of the C text: those that other functions call come first."""
        own = self._own_routines
        called = (k for r in own if isinstance(r, LoopedRoutine) for k in r.kernels_of_parts)
        return (*{kernel.name: kernel for kernel in called}.values(), *own)

    @property
    def _own_routines(self) -> tuple[Routine, ...]:
        products = self.products
        found = (
            *(products.value, self.linearize, products.adjoint, products.forced, products.free),
            *(self.path.cost, self.path.gradient, self.terminal.cost, self.terminal.gradient),
            *(self.output, self.output_jacobian, *self.hessians.values()),
        )
        return tuple(routine for routine in found if routine is not None)


def derivative_model(
    ocp: OCP, outputs: Any, names: Sequence[str] | None, options: Options | None, second_order: bool = False
) -> DerivativeModel:
    """Run the pipeline up to the lifted functions.

    Raises:
        ProblemError: the problem or the outputs are stated wrongly.
        OptionError: the integrator does not support the problem, or the problem has a start cost or a free x_0, or
            the impulse response matrix is too large for C.
    """
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    chosen = options or Options()
    _refuse_options(chosen)
    problem = complete(classify(ocp), chosen)
    integrator = _integrator(problem, chosen)
    problem.refuse_augmented("derivatives")
    _refuse(problem)
    names, z = outputs_of(ocp, problem, outputs, names)
    entries = problem.N**2 * problem.nu * len(names)
    if entries > MOST_ENTRIES:
        raise OptionError(
            f"{problem.name}: the impulse response matrix has {entries:,} entries; at most {MOST_ENTRIES:,}"
        )
    costs = stage_costs(problem)
    output, jacobian = _output(problem, z) if names else (None, None)
    return DerivativeModel(
        problem=problem,
        integrator=integrator,
        precision=chosen.precision,
        linearize=integrator.interval(problem).linearize,
        products=integrator.products(problem),
        path=_cost(problem, integrator, costs.path),
        terminal=_cost(problem, integrator, costs.terminal),
        output_names=tuple(names),
        output=output,
        output_jacobian=jacobian,
        hessians=_hessians(problem, integrator) if second_order else {},
    )


def _integrator(problem: Problem, options: Options) -> Integrator:
    """Return the integrator of the options; by default the map itself, or one RK4 step per interval."""
    default: Integrator = Discrete() if problem.discrete else ExplicitRungeKutta(steps=1)
    integrator = options.integrator or default
    integrator.check(problem)
    return integrator


def _refuse_options(options: Options) -> None:
    """Raise OptionError if an option of the optimiser or of storage is set, which derivatives do not have."""
    default = Options()
    for field in dataclasses.fields(Options):
        if field.name not in ("integrator", "precision") and getattr(options, field.name) != getattr(
            default, field.name
        ):
            raise OptionError(
                f"options.{field.name} does not apply to derivatives; expected integrator and precision only"
            )


def _refuse(problem: Problem) -> None:
    """Raise OptionError if J would not depend on the controls only."""
    if problem.free_initial:
        free = ", ".join(problem.state_names[i] for i in problem.free_initial)
        raise OptionError(f"{problem.name}: {free} is free_initial; derivatives are taken for a given x_0")
    if problem.start.ny or problem.start.cost is not None:
        raise OptionError(f"{problem.name} has a start cost, which no control changes; expected costs of path and end")


def _hessians(problem: Problem, integrator: Integrator) -> dict[str, Routine]:
    """Return the second derivatives of an interval by both sweeps, without the cost rate."""
    nz = problem.nx + problem.nu
    dynamics = replace(problem, path=replace(problem.path, cost_rate=None))
    zeros = ca.Function("zeros", [], [ca.SX.zeros(nz), ca.SX.zeros(nz * nz)])
    start = Call(zeros, (), (Slice("g", nz), Slice("Q", nz * nz)))
    sweeps = (Symmetric.scheme, ForwardOverAdjoint.scheme)
    return {s: integrator.lift_hessian(dynamics, s, f"interval_{s}", start, ()) for s in sweeps}


def _cost(problem: Problem, integrator: Integrator, cost: StageCost) -> StageModel:
    """Return cost and gradient of a stage; every entry of the gradient is written, even structural zeros."""
    if cost.name == "path" and problem.path.cost_rate is not None:
        return stage_model(problem, integrator, cost)
    return StageModel(
        cost.kernel("cost", "l = cost of the node", ca.densify(cost.value), Port("l", 1)),
        cost.kernel("gradient", "g = gradient of the cost of the node", ca.densify(cost.gradient), Port("g", cost.nz)),
    )


def _output(problem: Problem, z: Expression) -> tuple[Routine, Routine]:
    """Return z and G = dz / d(x, u)."""
    x, u, p, n = problem.path.x, problem.path.u, problem.path.p, int(z.numel())
    nx, nu = problem.nx, problem.nu
    ports = (Port("x", nx), Port("u", nu), Port("p", problem.np))
    G = ca.densify(ca.vec(ca.jacobian(z, ca.vertcat(x, u)).T))
    value, jacobian = ca.Function("output", [x, u, p], [ca.densify(z)]), ca.Function("output", [x, u, p], [G])
    doc = "outputs z = g(x, u, p)"
    return (
        lift(value, "output", doc, ports, (Port("z", n),)),
        lift(jacobian, "output_jacobian", "G = dz / d(x, u), row by row", ports, (Port("G", n * (nx + nu)),)),
    )
