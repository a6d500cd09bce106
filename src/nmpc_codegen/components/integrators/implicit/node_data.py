"""Functions of a node with algebraic variables first compute z and W = -(dg/dz)^-1, stored after the parameters.

Node N has no control; its equations use the controls of node N - 1, which are states.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import casadi as ca

from nmpc_codegen.components.integrators.implicit.intervals import START
from nmpc_codegen.components.integrators.implicit.operation_counts import factors_of, solution_of
from nmpc_codegen.components.integrators.implicit.stage_kernels import stage_kernels
from nmpc_codegen.components.integrators.jump import rename_buffer
from nmpc_codegen.frontend.problem import Problem, symbols
from nmpc_codegen.ir.casadi_types import Function, elements
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import ModelFunctions, StageModel
from nmpc_codegen.ir.sweep import Call, LoopedRoutine, Node, Routine, Slice, Sweep, Written, calls
from nmpc_codegen.package.opcount import OpCount

#: The buffer of parameters, z and W; the leaf that reads it; the number of Newton steps in operation counts.
DATA, LEAF, STEPS = "data", "of_data", 2

R = TypeVar("R", Routine, Routine | None)


def with_node_data(functions: ModelFunctions, problem: Problem) -> ModelFunctions:
    """Return the functions of a package; those that read z and W first compute them."""
    complete = _Completion(problem)

    def stage(model: StageModel) -> StageModel:
        block = replace(model.block, hessian=complete(model.hessian), curvature=complete(model.curvature))
        rows, product = complete(model.rows), complete(model.product)
        return replace(
            model, cost=complete(model.cost), gradient=complete(model.gradient), rows=rows, product=product, block=block
        )

    return replace(
        functions,
        following=complete.count(slopes=False),
        interval=replace(functions.interval, curved=complete(functions.interval.curved)),
        start=stage(functions.start),
        path=stage(functions.path),
        terminal=stage(functions.terminal),
        exact=tuple(complete(routine) for routine in functions.exact),
    )


def algebraic_kernel(problem: Problem) -> Kernel | None:
    """Return stage_algebraic(x, u, p -> z): all algebraic variables of a point (x, variables of Newton's method)."""
    algebra = problem.algebra
    if algebra is None or not algebra.signals:
        return None
    x, u, p, _ = symbols(problem.nx, problem.nu, problem.np)
    z = ca.SX.sym("z", algebra.size)
    function = ca.Function("algebraic", [ca.vertcat(x, z), u, p], [ca.densify(algebra.values(x, u, p, z))])
    ports = (Port("x", problem.nx + algebra.size), Port("u", problem.nu), Port("p", problem.np))
    out = Port("z", int(function.size1_out(0)))
    return lift(function, "stage_algebraic", "z = algebraic variables", ports, (out,))


class _Completion:
    """The completion adds z and W to the routines of one problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.kernels = problem, stage_kernels(problem)
        self.size = problem.np + problem.solved
        assert self.kernels.equation is not None
        self.equation = self.kernels.equation
        self.reads = {port.name for port in self.equation.reads}

    def __call__(self, routine: R) -> R:
        """Return the routine with the parameters of the node as input.

        A routine that reads z or W begins with the call that computes z and W.
        """
        if routine is None or all(port.name != "p" for port in routine.inputs):
            return routine
        inputs = tuple(Port("p", self.problem.np) if port.name == "p" else port for port in routine.inputs)
        if isinstance(routine, Kernel):
            numbers = self._numbers(routine, [port.name for port in routine.inputs])
            if numbers <= self.problem.np:
                return replace(routine, inputs=inputs)
            return self._around(_with_leaf(routine), inputs, numbers)
        leaves = routine.leaves
        names = [(leaves[c.leaf.name()], [s.buffer for s in c.ins]) for c in calls(routine.sweep.body)]
        numbers = max((self._numbers(leaf, buffers) for leaf, buffers in names), default=0)
        if numbers <= self.problem.np:
            return LoopedRoutine(replace(routine.sweep, inputs=inputs), leaves)
        return self._around(routine, inputs, numbers)

    def _numbers(self, kernel: Kernel, buffers: list[str]) -> int:
        """Return how many of the parameters, z and W the kernel reads, up to the last one."""
        places = {i for i, buffer in enumerate(buffers) if buffer == "p"}
        loads = (i.args for i in kernel.instructions if i.opcode == ca.OP_INPUT)
        return max((element + 1 for port, element in loads if port in places), default=0)

    def _around(self, routine: LoopedRoutine, inputs: tuple[Port, ...], numbers: int) -> LoopedRoutine:
        """Return the routine after the call that computes z and W; its own calls read them with the parameters."""
        problem, sweep, leaves = self.problem, routine.sweep, dict(routine.leaves)
        known = {port.name for port in inputs}
        inputs = inputs if START in known else (*inputs, Port(START, self.kernels.na))
        scratch, before = [*sweep.locals, (DATA, self.size)], list[Node]()
        if "u" in self.reads and "u" not in known:
            leaf = _controls_before(problem)
            leaves[leaf.name()] = lift(
                leaf, f"{sweep.name}_{leaf.name()}", "", (Port("x", problem.nx),), (Port("u", problem.nu),)
            )
            scratch.append(("u", problem.nu))
            before.append(Call(leaf, (Slice("x", problem.nx),), (Slice("u", problem.nu),)))
        given = (
            *(Slice("x", problem.nx), Slice(START, self.kernels.na)),
            *(Slice("u", problem.nu) if "u" in self.reads else "0", Slice("p", problem.np) if problem.np else "0"),
        )
        slopes = numbers > problem.np + self.kernels.na
        function, found = f"implicit_node_{'data' if slopes else 'point'}", (Slice(DATA, self.size),)
        before.append(Written(function, given, found, self.count(slopes), (self.equation,)))
        own = (rename_buffer((node,), "p", DATA)[0] if isinstance(node, Call) else node for node in sweep.body)
        return LoopedRoutine(
            replace(sweep, inputs=inputs, locals=tuple(scratch), body=(*before, *own)),
            leaves,
        )

    def count(self, slopes: bool) -> OpCount:
        """Count the operations for the algebraic variables of a node, and for W with ``slopes``."""
        n = self.kernels.na
        step = self.equation.count + factors_of(n) + solution_of(n, 1)
        return step * STEPS + (solution_of(n, n) if slopes else OpCount())


def _with_leaf(kernel: Kernel) -> LoopedRoutine:
    """Return a kernel as a routine that calls it."""
    leaf = replace(
        kernel,
        name=f"{kernel.name}_of_data",
        outputs=tuple(Port(port.name, port.size, doc=port.doc, flat=True) for port in kernel.outputs),
    )
    ins, outs = (tuple(Slice(port.name, port.size) for port in ports) for ports in (leaf.inputs, leaf.outputs))
    call = Call(ca.Function(LEAF, [], []), ins, outs)
    return LoopedRoutine(Sweep(kernel.name, kernel.doc, kernel.inputs, kernel.outputs, (), (call,)), {LEAF: leaf})


def _controls_before(problem: Problem) -> Function:
    """Return the function (x) -> controls of the previous node, as far as the problem stores them."""
    x = ca.SX.sym("x", problem.nx)
    u = ca.SX(ca.vertcat(*problem.controls_before(elements(x))))
    return ca.Function("controls_before", [x], [ca.densify(u)])
