"""The functions of an interval are sweeps with one call of a function of templates/integrators/implicit each.

A function that adds to g, w, l or Q is called after the call that initialises the result.
"""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.components.integrators.explicit.directional import ADJOINT, ADJOINT_DOC, FORWARD, FORWARD_DOC
from nmpc_codegen.components.integrators.implicit.operation_counts import ImplicitCounts
from nmpc_codegen.components.integrators.implicit.stage_kernels import stage_kernels
from nmpc_codegen.components.integrators.jump import with_end
from nmpc_codegen.components.integrators.tableau import ButcherTableau
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.sweep import Affine, Call, LoopedRoutine, Node, Slice, Sweep, Written, lift_loops
from nmpc_codegen.package.opcount import OpCount

#: Names of the number of Newton steps per stage, and of the last corrections of the stages.
NEWTON, LEFT = "newton", "left"

#: Name of the start of Newton's method for algebraic variables at the beginning of an interval.
START = "z"


class Intervals:
    """The routines belong to one problem, scheme, number of steps per interval and of Newton steps per stage."""

    def __init__(self, problem: Problem, tableau: ButcherTableau, steps: int, newton: int) -> None:
        self.problem, self.kernels = problem, stage_kernels(problem)
        self.count = ImplicitCounts(self.kernels, tableau, steps, newton)
        self.nx, self.nu, self.nz = problem.nx, problem.nu, problem.nx + problem.nu
        self.na = self.kernels.na
        self.phi = f"x_next = Phi(x, u, p): {steps} {tableau.name} step{'s' if steps > 1 else ''} over dt"
        read = {port.name for kernel in self.kernels.all for port in kernel.reads}
        data = {"u": Slice("u", self.nu), "p": Slice("p", problem.np)}
        given = [s if name in read else "0" for name, s in data.items()]
        self._data = (Slice(START, self.na) if self.na else "0", *given)

    # Parts -----------------------------------------------------------------------------------------------------------

    def _ports(self, length: str, body: tuple[Node, ...]) -> tuple[Port, ...]:
        """Return the inputs; calls that begin with the terms of a node read more than parameters."""
        more = self.problem.solved if any(isinstance(node, Call) for node in body) else 0
        sizes = (("x", self.nx), ("u", self.nu), ("p", self.problem.np + more), (length, 1))
        start = (Port(START, self.na),) if self.na else ()
        return (*(Port(name, size) for name, size in sizes), *start, Port(NEWTON, 1, whole=True))

    def _call(
        self,
        function: str,
        more: tuple[Slice, ...],
        outs: tuple[Slice, ...],
        count: OpCount,
        length: str = "dt",
        nonzeros: Mapping[str, frozenset[int]] | None = None,
    ) -> Written:
        ins = (Slice("x", self.nx), *self._data, Slice(length, 1), NEWTON_ARGUMENT, *more)
        return Written(f"implicit_{function}", ins, outs, count, self.kernels.of(function), nonzeros or {})

    def _routine(
        self,
        name: str,
        doc: str,
        body: tuple[Node, ...],
        outputs: tuple[Port, ...],
        more: tuple[Port, ...] = (),
        length: str = "dt",
        jumps: bool = True,
        scratch: tuple[tuple[str, int], ...] = (),
    ) -> LoopedRoutine:
        sweep = Sweep(name, doc, (*self._ports(length, body), *more), outputs, scratch, body)
        return lift_loops(with_end(sweep, self.problem) if jumps else sweep)

    @property
    def _S(self) -> Mapping[str, frozenset[int]]:
        """Return the elements of S that may be nonzero."""
        return {"S": frozenset(i * self.nz + j for i, j in self.kernels.reached)}

    @property
    def _results(self) -> tuple[Slice, ...]:
        return (Slice("x_next", self.nx), Slice("S", self.nx * self.nz), Slice(LEFT, self.nx))

    # Routines --------------------------------------------------------------------------------------------------------

    def interval(self) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton) -> x_next, S, left."""
        call = self._call("interval", (), self._results, self.count.columns(self.nz), nonzeros=self._S)
        outputs = (Port("x_next", self.nx), Port("S", self.nx, self.nz), Port(LEFT, self.nx))
        return self._routine("integrator_interval", f"{self.phi}; S = d x_next / d(x, u)", (call,), outputs)

    def step(self) -> LoopedRoutine:
        """Return the routine (x, u, p, h, newton) -> x_next, without the maps of discrete states."""
        out = Slice("x_next", self.nx)
        call = self._call("step", (), (out,), self.count.step, "h")
        doc = f"x_next = one {self.count.tableau.name} step of length h from x"
        return self._routine("integrator_step", doc, (call,), (Port("x_next", self.nx),), length="h", jumps=False)

    def value(self, leaving: bool = False, jumps: bool = True) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton) -> x_next, left; ``left`` is an output only if ``leaving``."""
        outs = (Slice("x_next", self.nx), Slice(LEFT, self.nx))
        call = self._call("value", (), outs, self.count.value)
        end, rest = Port("x_next", self.nx), Port(LEFT, self.nx)
        outputs = (end, rest) if leaving else (end,)
        scratch = () if leaving else ((LEFT, self.nx),)
        return self._routine("integrator_value", self.phi, (call,), outputs, jumps=jumps, scratch=scratch)

    def failure(self) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton) -> failure: reason, step and stage, see implicit_failure()."""
        call = self._call("failure", (), (Slice("failure", 3),), self.count.value)
        doc = "failure = reason, step, stage of the first stage that cannot be solved; reason -1: none"
        return self._routine("integrator_failure", doc, (call,), (Port("failure", 3),), jumps=False)

    def adjoint(self) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton, lam) -> lam_x, lam_u."""
        outs = (Slice("lam_x", self.nx), Slice("lam_u", self.nu))
        call = self._call("adjoint", (Slice("lam", self.nx),), outs, self.count.adjoint)
        outputs = (Port("lam_x", self.nx), Port("lam_u", self.nu))
        doc = f"lam_x = A' lam, lam_u = B' lam: adjoint of {self.phi.partition(': ')[2]}"
        return self._routine("integrator_adjoint", doc, (call,), outputs, (Port("lam", self.nx),))

    def columns(self, forced: bool) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton) -> x_next, S_next = B if ``forced``.

        Otherwise S is an input and S_next = A S; both are [nx][nu].
        """
        name, size = "forced" if forced else "free", self.nx * self.nu
        more = () if forced else (Slice("S", size),)
        outs = (Slice("x_next", self.nx), Slice("S_next", size))
        call = self._call(name, more, outs, self.count.columns(self.nu))
        doc = f"{self.phi}; " + ("S_next = d x_next / du" if forced else "S_next = (d x_next / dx) S")
        outputs = (Port("x_next", self.nx), Port("S_next", size))
        ports = () if forced else (Port("S", size),)
        return self._routine(f"integrator_{name}", doc, (call,), outputs, ports)

    def directional(self) -> tuple[LoopedRoutine, LoopedRoutine]:
        """Return the routines (x, u, p, dt, newton, dx, du) -> dx_next and (x, u, p, dt, newton, adj) -> g."""
        directions = (Port("dx", self.nx), Port("du", self.nu))
        slices = (Slice("dx", self.nx), Slice("du", self.nu))
        out = (Slice("dx_next", self.nx),)
        moved = self._call("forward", slices, out, self.count.columns(1))
        forward = self._routine(FORWARD, FORWARD_DOC, (moved,), (Port("dx_next", self.nx),), directions)
        outs = (Slice("g", self.nx), Slice("g", self.nu, Affine(self.nx)))
        pulled = self._call("adjoint", (Slice("adj", self.nx),), outs, self.count.adjoint)
        adjoint = self._routine(ADJOINT, ADJOINT_DOC, (pulled,), (Port("g", self.nz),), (Port("adj", self.nx),))
        return forward, adjoint

    def hessian(self, scheme: str, name: str, start: Call, more: tuple[Port, ...]) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton, more, lam) -> x_next, S, g, Q, left."""
        nx, nz, count = self.nx, self.nz, self.count
        added = (Slice("g", nz), Slice("Q", nz * nz))
        counts = {"symmetric": count.symmetric, "forward_over_adjoint": count.forward_over_adjoint}
        bent = frozenset(i * nz + j for i, j in self.kernels.bent)
        nonzeros = {**self._S, "Q": bent, "g": frozenset(range(nz)) if self.kernels.rated else frozenset[int]()}
        call = self._call(scheme, (Slice("lam", nx),), (*self._results, *added), counts[scheme], nonzeros=nonzeros)
        doc = (
            f"{self.phi}, S = d x_next / d(x, u);"
            f" g, Q = gradient, Hessian of cost + lam' Phi + mu' h ({scheme.replace('_', ' ')})"
        )
        ports = (("x_next", nx, 0), ("S", nx, nz), ("g", nz, 0), ("Q", nz, nz), (LEFT, nx, 0))
        outputs = tuple(Port(*port) for port in ports)
        return self._routine(name, doc, (start, call), outputs, (*more, Port("lam", nx)))

    def integral(self, name: str, start: Call, more: tuple[Port, ...]) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton, more) -> l."""
        call = self._call("integral", (), (Slice("l", 1),), self.count.integral)
        doc = "l = cost of the node + integral of the cost rate over dt"
        return self._routine(name, doc, (start, call), (Port("l", 1),), more, jumps=False)

    def gradient(self, name: str, start: Call, more: tuple[Port, ...]) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton, more) -> g."""
        call = self._call("integral_gradient", (), (Slice("g", self.nz),), self.count.integral_gradient)
        doc = "g = d (cost of the node + integral of the cost rate over dt) / d(x, u)"
        return self._routine(name, doc, (start, call), (Port("g", self.nz),), more, jumps=False)

    def product(self, name: str, start: Call, more: tuple[Port, ...]) -> LoopedRoutine:
        """Return the routine (x, u, p, dt, newton, more) -> w; ``more`` ends with the direction d = (dx, du)."""
        direction, out = (Slice("d", self.nz),), (Slice("w", self.nz),)
        call = self._call("integral_product", direction, out, self.count.integral_product)
        doc = "w = (Hessian of the cost of the node + Gauss-Newton Hessian of the integral of the cost rate over dt) d"
        return self._routine(name, doc, (start, call), (Port("w", self.nz),), more, jumps=False)


#: The number of Newton steps is an argument that is passed by value.
NEWTON_ARGUMENT = Slice(NEWTON, 1)
