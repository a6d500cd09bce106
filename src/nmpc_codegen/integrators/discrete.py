"""Discrete maps x+ = Phi(x, u, p) pass through; their Jacobian is one straight-line kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from nmpc_codegen.cmodule import Table
from nmpc_codegen.component import Counts, Dims
from nmpc_codegen.errors import OptionError
from nmpc_codegen.kernel import OpCount, Port, lift
from nmpc_codegen.problem import Problem
from nmpc_codegen.sweep import Routine


@dataclass(frozen=True)
class Discrete:
    """The dynamics are already a map from node to node; nothing to choose."""

    seam: ClassVar[str] = "integrator"
    name: ClassVar[str] = "discrete"
    template: ClassVar[str] = "integrators/discrete.c.jinja"
    needs: ClassVar[tuple[str, ...]] = ()
    supports: ClassVar[frozenset[str]] = frozenset(
        {"soft rows", "coupled rows", "free initial state", "general cost", "accumulators"}
    )

    def routines(self, problem: Problem) -> tuple[Routine, ...]:
        """interval(x, u, p, dt -> x_next, S) and step(x, u, p, h -> x_next)."""
        if not problem.discrete:
            raise OptionError(
                f"integrator: {problem.name} is an ordinary differential equation; expected ExplicitRungeKutta(...)"
            )
        x, u, p = problem.path.x, problem.path.u, problem.path.p
        dt = ca.SX.sym("dt")
        phi = ca.densify(problem.dynamics(x, u, p))
        S = ca.sparsify(ca.jacobian(phi, ca.vertcat(x, u)))
        ports = (Port("x", problem.nx), Port("u", problem.nu), Port("p", problem.np))
        out = Port("x_next", problem.nx)
        interval = ca.Function("interval", [x, u, p, dt], [phi, S])
        step = ca.Function("step", [x, u, p, dt], [phi])
        return (
            lift(
                interval,
                "integrator_interval",
                "x_next = Phi(x, u, p); S = d x_next / d(x, u)",
                (*ports, Port("dt", 1)),
                (out, Port("S", problem.nx, problem.nx + problem.nu)),
            ),
            lift(step, "integrator_step", "x_next = Phi(x, u, p)", (*ports, Port("h", 1)), (out,)),
        )

    @property
    def parts(self) -> tuple[str, ...]:
        """Nothing to choose between."""
        return ()

    def tables(self, problem: Problem) -> tuple[Table, ...]:
        """No tables."""
        return ()

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("STEPS", 1, "evaluations of the map per interval"),)

    def structs(self, dims: Dims) -> tuple[Any, ...]:
        return ()

    def cost(self, dims: Dims, known: Counts) -> dict[str, OpCount]:
        return {}
