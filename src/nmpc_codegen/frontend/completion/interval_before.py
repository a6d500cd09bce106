"""The time since the sample before, where expressions read the length of the interval before a node."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from nmpc_codegen.frontend.problem import Algebra, Problem, Stage, model_function, symbols
from nmpc_codegen.ir.casadi_types import Expression, part


def with_interval_before(problem: Problem, sampling_time: float | None) -> Problem:
    """The problem with the time since the sample before as the length of the interval before node 0, and without such
    lengths where all are the same."""
    period = sampling_time or problem.dt[0]
    if not problem.augmentation.interval:
        return problem
    if not problem.uniform or period != problem.dt[0]:
        data = problem.node_data.copy()
        data[0, -1] = period
        return replace(problem, node_data=data)
    fewer, last = int(problem.path.p.numel()) - 1, problem.np - 1

    def complete(p: Expression) -> Expression:
        """The parameters with the length of the interval before, which is in front of what Newton's method finds."""
        return ca.vertcat(part(p, 0, last), period, part(p, last))

    def stage(old: Stage) -> Stage:
        p = ca.SX.sym("p", fewer)

        def reduce(value: Expression) -> Expression:
            return ca.densify(ca.substitute(value, old.p, complete(p)))

        return replace(
            old,
            p=p,
            y=reduce(old.y),
            h=reduce(old.h),
            cost=None if old.cost is None else reduce(old.cost),
            cost_rate=None if old.cost_rate is None else reduce(old.cost_rate),
        )

    x, u, p, dt = symbols(problem.nx, problem.nu, fewer)
    jump = problem.jump
    return replace(
        problem,
        parameters=problem.parameters[:-1],
        dynamics=model_function("f", [x, u, p], [problem.dynamics(x, u, complete(p))]),
        start=stage(problem.start),
        path=stage(problem.path),
        terminal=stage(problem.terminal),
        augmentation=replace(problem.augmentation, interval=False),
        jump=None if jump is None else model_function("g", [x, u, p, dt], [jump(x, u, complete(p), dt)]),
        node_data=problem.node_data[:, :-1],
        algebra=_with_period(problem, period),
    )


def _with_period(problem: Problem, period: float) -> Algebra | None:
    """The algebraic variables with a fixed length of the interval before, the last parameter."""
    if problem.algebra is None:
        return None
    x, u, p, _ = symbols(problem.nx, problem.nu, problem.np - 1)
    z = ca.SX.sym("z", problem.algebra.size)
    values, equations = (
        ca.Function("of_z", [x, u, p, z], [f(x, u, ca.vertcat(p, period), z)])
        for f in (problem.algebra.values, problem.algebra.equations)
    )
    return replace(problem.algebra, values=values, equations=equations)
