"""Discrete states are constant along an interval and jump at its end: x_i+ = g_i(x, u, p).

The sweeps of an integrator treat them as states with the derivative 0. Calls after a sweep complete its results at the
end of the interval:

    x_next, S: the rows of g and dg / d(x, u);   dx_next = g_z (dx, du);   A S: g_x S
    adjoints: those of the maps are 0 in the sweep, then g_z' lam is added;   Q: d2 (lam' g) is added
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

import casadi as ca

from nmpc_codegen.components.integrators.noise import with_noise
from nmpc_codegen.frontend.problem import Problem, symbols
from nmpc_codegen.ir.casadi_types import Expression, nonzeros
from nmpc_codegen.ir.kernel import Kernel, Port, lift
from nmpc_codegen.ir.sweep import Affine, Block, Call, Node, Slice, Sweep

#: An argument of a call.
A = TypeVar("A", Slice, Slice | str)

#: Names of input ports with multipliers of the end of an interval.
ADJOINTS = ("lam", "adj")


def jump_kernel(problem: Problem) -> Kernel | None:
    """Return integrator_jump(x, u, p, dt -> x_next), the values of the maps; None if there are none."""
    if problem.jump is None:
        return None
    x, u, p, dt = symbols(problem.nx, problem.nu, problem.np)
    value = problem.jump(x, u, without_solution(problem, p), dt)
    end = ca.SX(problem.nx, 1)
    for n, i in enumerate(problem.maps):
        end[i] = value[n]
    ports = (Port("x", problem.nx), Port("u", problem.nu), Port("p", problem.np), Port("dt", 1))
    return lift(
        ca.Function("jump", [x, u, p, dt], [end]),
        "integrator_jump",
        "x_next of the states that are constant along an interval",
        ports,
        (Port("x_next", problem.nx),),
    )


def jump_rows_kernel(problem: Problem) -> Kernel | None:
    """Return integrator_jump_rows(x, u, p, dt -> x_next, S): values of the maps, and their rows of S with zeros."""
    if problem.jump is None:
        return None
    x, u, p, dt = symbols(problem.nx, problem.nu, problem.np)
    nz = problem.nx + problem.nu
    value, slopes = problem.jump_slopes(x, u, without_solution(problem, p), dt)
    end, S = ca.SX(problem.nx, 1), ca.SX(problem.nx, nz)
    for n, i in enumerate(problem.maps):
        end[i], S[i, :] = value[n], slopes[n, :]
    ports = (Port("x", problem.nx), Port("u", problem.nu), Port("p", problem.np), Port("dt", 1))
    kernel = lift(
        ca.Function("jump_rows", [x, u, p, dt], [end, ca.sparsify(S)]),
        "integrator_jump_rows",
        "x_next and rows of S of the states that are constant along an interval",
        ports,
        (Port("x_next", problem.nx), Port("S", problem.nx, nz)),
    )
    return kernel.with_zeros("S", [(i, j) for i in problem.maps for j in range(nz)])


def without_solution(problem: Problem, p: Expression) -> Expression:
    """Return the parameters with zeros for results of Newton's method, on which maps do not depend."""
    return ca.vertcat(p, ca.SX.zeros(problem.solved))


def with_end(sweep: Sweep, problem: Problem) -> Sweep:
    """Return the sweep of an interval with the calls at its end: maps of discrete states, and noise."""
    return with_noise(_with_jump(sweep, problem), problem)


def _with_jump(sweep: Sweep, problem: Problem) -> Sweep:
    """Return the sweep of an interval with the calls for the maps."""
    if problem.jump is None:
        return sweep
    jump = _Jump(problem)
    held = next((port for port in sweep.inputs if port.name in ADJOINTS), None)
    free = any(port.name == "S" for port in sweep.inputs)
    body, more = sweep.body, [*jump.results({port.name for port in sweep.outputs}, held, free)]
    if held is None:
        return replace(sweep, body=(*body, *more))
    masked = f"{held.name}_held"
    return replace(
        sweep,
        locals=(*sweep.locals, (masked, held.size)),
        body=(jump.mask(held, masked), *rename_buffer(body, held.name, masked), *more),
    )


def rename_buffer(nodes: Iterable[Node], old: str, new: str) -> tuple[Node, ...]:
    """Return the nodes with a buffer renamed."""

    def slices(of: Iterable[A]) -> tuple[A, ...]:
        return tuple(replace(s, buffer=new) if isinstance(s, Slice) and s.buffer == old else s for s in of)

    found: list[Node] = []
    for node in nodes:
        if isinstance(node, Block):
            found.append(replace(node, body=rename_buffer(node.body, old, new)))
        elif isinstance(node, Call):
            found.append(replace(node, ins=slices(node.ins), outs=slices(node.outs)))
        else:
            found.append(replace(node, ins=slices(node.ins), outs=slices(node.outs)))
    return tuple(found)


class _Jump:
    """The jump consists of the maps g, their derivatives, and the calls that write them."""

    def __init__(self, problem: Problem) -> None:
        assert problem.jump is not None
        self.nx, self.nu, self.nz, self.maps = problem.nx, problem.nu, problem.nx + problem.nu, problem.maps
        x, u, p, dt = symbols(problem.nx, problem.nu, problem.np)
        self.symbols, self.z = [x, u, p, dt], ca.vertcat(x, u)
        self.value = ca.densify(problem.jump(x, u, without_solution(problem, p), dt))
        self.slopes = ca.jacobian(self.value, self.z)
        self.given = (Slice("x", self.nx), Slice("u", self.nu), Slice("p", problem.np), Slice("dt", 1))

    def mask(self, port: Port, target: str) -> Call:
        """Return the multipliers of the integrated states, with 0 for the maps."""
        lam = ca.SX.sym(port.name, port.size)
        kept = ca.vertcat(*(ca.SX(0) if i in self.maps else lam[i] for i in range(self.nx)))
        leaf = ca.Function("hold", [lam], [kept])
        return Call(leaf, (Slice(port.name, port.size),), (Slice(target, port.size),), note="start")

    def results(self, outputs: set[str], held: Port | None, free: bool) -> Iterable[Call]:
        """Yield the calls for these outputs of a sweep; S_next is A S if ``free``, else B."""
        rows = [self.slopes[n, :].T for n in range(len(self.maps))]
        if "x_next" in outputs:
            values = [self.value[n] for n in range(len(self.maps))]
            yield self._call("jump", [], values, [Slice("x_next", 1, Affine(i)) for i in self.maps])
        if "S" in outputs:
            yield self._call("jump_rows", [], rows, [Slice("S", self.nz, Affine(i * self.nz)) for i in self.maps])
        if "dx_next" in outputs:
            d = (Slice("dx", self.nx), Slice("du", self.nu))
            moved = self.slopes @ ca.vertcat(*(symbols_ := [ca.SX.sym(s.buffer, s.size) for s in d]))
            targets = [Slice("dx_next", 1, Affine(i)) for i in self.maps]
            yield self._call("jump_moved", list(zip(symbols_, d, strict=True)), ca.vertsplit(moved), targets)
        if "S_next" in outputs:
            yield self._product(free)
        if held is None:
            return
        lam, source = ca.SX.sym(held.name, held.size), Slice(held.name, held.size)
        weighted = ca.vertcat(*(lam[i] for i in self.maps))
        if "lam_x" in outputs or "Q" not in outputs:
            names = {"lam_x": (0, self.nx), "lam_u": (self.nx, self.nu)} if "lam_x" in outputs else {"g": (0, self.nz)}
            pulled = self.slopes.T @ weighted
            for name, (first, size) in names.items():
                sum_, here = ca.SX.sym(name, size), Slice(name, size)
                more = [(lam, source), (sum_, here)]
                yield self._call(f"jump_{name}", more, [sum_ + pulled[first : first + size]], [here])
        if "Q" in outputs:
            yield from self._curvature(lam, source, weighted)

    def _curvature(self, lam: Expression, source: Slice, weighted: Expression) -> Iterable[Call]:
        """Yield Q += d2 (lam' g), lower triangle, if g is nonlinear."""
        H = ca.sparsify(ca.tril(ca.hessian(ca.dot(weighted, self.value), self.z)[0]))
        entries = list(zip(*H.sparsity().get_triplet(), strict=True))
        if not entries:
            return
        places = [Slice("Q", 1, Affine(i * self.nz + j)) for i, j in entries]
        sums = [ca.SX.sym(f"q{n}") for n in range(len(entries))]
        values = [q + v for q, v in zip(sums, nonzeros(H), strict=True)]
        yield self._call("jump_Q", [(lam, source), *zip(sums, places, strict=True)], values, places)

    def _product(self, free: bool) -> Call:
        """Return the rows of S_next = B, or of A S."""
        n = self.nx * self.nu
        targets = [Slice("S_next", self.nu, Affine(i * self.nu)) for i in self.maps]
        S, source = ca.SX.sym("S", n), Slice("S", n)
        product = self.slopes[:, : self.nx] @ ca.reshape(S, self.nu, self.nx).T if free else self.slopes[:, self.nx :]
        more = [(S, source)] if free else []
        return self._call("jump_columns", more, [product[m, :].T for m in range(len(self.maps))], targets)

    def _call(
        self, name: str, more: Iterable[tuple[Expression, Slice]], values: Iterable[Expression], targets: list[Slice]
    ) -> Call:
        symbols_, slices = zip(*more, strict=True) if (more := list(more)) else ((), ())
        leaf = ca.Function(name, [*self.symbols, *symbols_], [ca.densify(v) for v in values])
        return Call(leaf, (*self.given, *slices), tuple(targets), note="states that are constant along an interval")
