"""Discrete maps x+ = Phi(x, u, p) need no integration: map and Jacobian are one straight-line kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from nmpc_codegen.components.base import EVERY_USE, NONLINEAR, Dims, Integrator
from nmpc_codegen.components.integrators.explicit.directional import ADJOINT, ADJOINT_DOC, FORWARD, FORWARD_DOC
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Expression
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.model import Interval, IntervalProducts
from nmpc_codegen.ir.sweep import Call, Routine


@dataclass(frozen=True)
class Discrete(Integrator):
    """The integrator for dynamics that are already a map from node to node; it has no options."""

    name: ClassVar[str] = "discrete"
    template: ClassVar[str] = "integrators/discrete.c"
    supports: ClassVar[frozenset[str]] = EVERY_USE - {"integrated cost", "discrete states", NONLINEAR}

    def check(self, problem: Problem) -> None:
        """Raise OptionError unless the dynamics are a discrete map."""
        if not problem.discrete:
            raise OptionError(
                f"integrator: {problem.name} is an ordinary differential equation; expected ExplicitRungeKutta(...) "
                "(--set integrator=explicit_runge_kutta) instead of Discrete() (--set integrator=discrete)"
            )

    @property
    def small(self) -> Discrete:
        """Return the map itself."""
        return self

    def longest_step(self, problem: Problem) -> float:
        """Return the length (s) of the longest interval; the map is evaluated once per interval."""
        return max(problem.dt)

    def interval(self, problem: Problem) -> Interval:
        """Return interval(x, u, p, dt -> x_next, S) and step(x, u, p, h -> x_next)."""
        x, u, p = problem.path.x, problem.path.u, problem.path.p
        dt = ca.SX.sym("dt")
        phi = ca.densify(problem.dynamics(x, u, p))
        S = ca.sparsify(ca.jacobian(phi, ca.vertcat(x, u)))
        ports = (Port("x", problem.nx), Port("u", problem.nu), Port("p", problem.np))
        out = Port("x_next", problem.nx)
        interval = ca.Function("interval", [x, u, p, dt], [phi, S])
        step = ca.Function("step", [x, u, p, dt], [phi])
        return Interval(
            lift(
                interval,
                "integrator_interval",
                "x_next = Phi(x, u, p); S = d x_next / d(x, u)",
                (*ports, Port("dt", 1)),
                (out, Port("S", problem.nx, problem.nx + problem.nu)),
            ),
            lift(step, "integrator_step", "x_next = Phi(x, u, p)", (*ports, Port("h", 1)), (out,)),
        )

    def products(self, problem: Problem) -> IntervalProducts:
        """Return the map, and products with its Jacobians, each as one straight-line kernel."""
        x, u, p, nx, nu = problem.path.x, problem.path.u, problem.path.p, problem.nx, problem.nu
        dt, lam, S = ca.SX.sym("dt"), ca.SX.sym("lam", nx), ca.SX.sym("S", nx * nu)
        phi = ca.densify(problem.dynamics(x, u, p))
        adjoint = [ca.densify(ca.gradient(ca.dot(lam, phi), v)) for v in (x, u)]
        A, B = (ca.sparsify(ca.jacobian(phi, v)) for v in (x, u))
        free = A @ ca.reshape(S, nu, nx).T
        ports = (Port("x", nx), Port("u", nu), Port("p", problem.np), Port("dt", 1))
        out, columns = Port("x_next", nx), Port("S_next", nx * nu)

        def kernel(name: str, doc: str, more: list[Expression], results: list[Expression], *outs: Port) -> Kernel:
            function = ca.Function(name, [x, u, p, dt, *more], results)
            named = {"adjoint": (Port("lam", nx),), "free": (Port("S", nx * nu),)}
            return lift(function, f"integrator_{name}", doc, (*ports, *named.get(name, ())), outs)

        def rows(matrix: Expression) -> Expression:
            return ca.densify(ca.vec(matrix.T))

        return IntervalProducts(
            kernel("value", "x_next = Phi(x, u, p)", [], [phi], out),
            kernel("adjoint", "lam_x = A' lam, lam_u = B' lam", [lam], adjoint, Port("lam_x", nx), Port("lam_u", nu)),
            kernel("forced", "x_next = Phi(x, u, p); S_next = d x_next / du", [], [phi, rows(B)], out, columns),
            kernel("free", "x_next = Phi(x, u, p); S_next = (d x_next / dx) S", [S], [phi, rows(free)], out, columns),
        )

    def directional(self, problem: Problem) -> tuple[Routine, Routine]:
        """Return forward(x, u, p, dt, dx, du -> dx_next) and adjoint(x, u, p, dt, adj -> g)."""
        x, u, p, dt = problem.path.x, problem.path.u, problem.path.p, ca.SX.sym("dt")
        dx, du, adj = (ca.SX.sym(name, n) for name, n in (("dx", problem.nx), ("du", problem.nu), ("adj", problem.nx)))
        phi = ca.densify(problem.dynamics(x, u, p))
        moved = ca.densify(ca.jtimes(phi, x, dx) + ca.jtimes(phi, u, du))
        pulled = ca.densify(ca.vertcat(ca.jtimes(phi, x, adj, True), ca.jtimes(phi, u, adj, True)))
        ports = (Port("x", problem.nx), Port("u", problem.nu), Port("p", problem.np), Port("dt", 1))
        forward = ca.Function("forward", [x, u, p, dt, dx, du], [moved])
        adjoint = ca.Function("adjoint", [x, u, p, dt, adj], [pulled])
        directions = (Port("dx", problem.nx), Port("du", problem.nu))
        return (
            lift(forward, FORWARD, FORWARD_DOC, (*ports, *directions), (Port("dx_next", problem.nx),)),
            lift(
                adjoint, ADJOINT, ADJOINT_DOC, (*ports, Port("adj", problem.nx)), (Port("g", problem.nx + problem.nu),)
            ),
        )

    def lift_hessian(self, problem: Problem, scheme: str, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Return the routine (x, u, p, dt, more, lam) -> (x_next, S, g, Q) with second derivatives of the map.

        ``start`` initialises g and Q from all inputs except lam; the lower triangle of d2 (lam' Phi) / d(x, u)^2 is
        added. A map has no steps, so ``scheme`` makes no difference.
        """
        x, u, p, lam, dt = problem.path.x, problem.path.u, problem.path.p, ca.SX.sym("lam", problem.nx), ca.SX.sym("dt")
        z, nz = ca.vertcat(x, u), problem.nx + problem.nu
        phi = ca.densify(problem.dynamics(x, u, p))
        known = {"x": x, "u": u, "p": p, "dt": dt} | {port.name: ca.SX.sym(port.name, port.size) for port in more}
        g, Q = start.leaf.call([known[s.buffer] for s in start.ins])
        H = ca.tril(ca.reshape(Q, nz, nz).T) + ca.tril(ca.hessian(ca.dot(lam, phi), z)[0])
        values = [phi, ca.sparsify(ca.jacobian(phi, z)), ca.densify(g), ca.sparsify(H)]
        ports = (Port("x", problem.nx), Port("u", problem.nu), Port("p", problem.np), Port("dt", 1))
        return lift(
            ca.Function(name, [*known.values(), lam], values),
            name,
            "x_next = Phi(x, u, p), S = d x_next / d(x, u); g, Q = gradient, Hessian of cost + lam' Phi + mu' h",
            (*ports, *more, Port("lam", problem.nx)),
            (Port("x_next", problem.nx), Port("S", problem.nx, nz), Port("g", nz), Port("Q", nz, nz)),
        )

    def integrated_cost(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Raise OptionError: a map has no continuous time to integrate over."""
        raise OptionError(_no_time(problem))

    def integrated_gradient(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Raise OptionError: a map has no continuous time to integrate over."""
        raise OptionError(_no_time(problem))

    def integrated_product(self, problem: Problem, name: str, start: Call, more: tuple[Port, ...]) -> Routine:
        """Raise OptionError: a map has no continuous time to integrate over."""
        raise OptionError(_no_time(problem))

    def sizes(self, dims: Dims) -> tuple[tuple[str, int, str], ...]:
        return (("STEPS", 1, "evaluations of the map per interval"),)


def _no_time(problem: Problem) -> str:
    return f"{problem.name}: a discrete map has no cost per unit of time; expected a cost of its nodes"
