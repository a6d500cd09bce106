"""The functions on which counts depend are made by the integrator and the Hessian of samples.

linearize() reuses these functions.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from nmpc_codegen.components.base import Hessian, Integrator
from nmpc_codegen.components.stage_cost import StageCosts, stage_costs
from nmpc_codegen.decisions.trials import Trials
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.model import Block, HessianModel, Interval, products_of
from nmpc_codegen.ir.stage_products import Products
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.options import Online


@dataclass(frozen=True, eq=False)
class Made:
    """The functions of the stages have been made for counts.

    costs: expressions of the stages; interval: the dynamics; blocks: the Hessian of samples; products: products with
    the stage matrices.
    """

    costs: StageCosts
    interval: Interval
    blocks: HessianModel
    products: Products


def make(trials: Trials, integrator: Integrator, hessian: Hessian | None) -> Made:
    """Make the functions of an integrator and a Hessian."""
    problem = trials.problem
    interval, costs = trials.interval(integrator), stage_costs(problem)
    none = HessianModel(None, Block(), Block())
    blocks = none if hessian is None else hessian.blocks(problem, costs, integrator)
    return Made(costs, interval, blocks, products_of(interval, blocks, len(problem.augmentation.previous)))


def is_constant(made: Made, problem: Problem, online: Online) -> bool:
    """Return True if the path Hessian is the same at all nodes, and nothing is added to its first block."""
    path, start = made.blocks.path, made.blocks.start
    if start is not None and start.writes:
        return False
    varying = {"x", "u", "found"} if problem.uniform else {"x", "u", "found", "dt"}
    varying |= {name for name, layout in (("p", online.parameter), ("W", online.weight)) if layout == "node"}
    return path.hessian is not None and path.curvature is None and not varying & _reads(path.hessian, problem.np)


def _reads(routine: Routine, parameters: int) -> set[str]:
    """Return the names of the input ports that a routine reads; "found" stands for results of Newton's method."""
    if isinstance(routine, LoopedRoutine):
        return {port.name for port in routine.inputs}
    loads = [i.args for i in routine.instructions if i.opcode == ca.OP_INPUT]
    names = [(routine.inputs[port].name, element) for port, element in loads]
    return {"found" if name == "p" and element >= parameters else name for name, element in names}
