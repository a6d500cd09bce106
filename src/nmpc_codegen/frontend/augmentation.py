"""The augmented state: states behind those of the user, by which a node knows the one before it, and its time.

    t_{k+1} = t_k + dt_k     (t' = 1 along an interval),   v_{k+1} = u_k

Their maps are constant, so that kernels, integrators and second derivatives stay as they are; at node 0 they are known.
Where blocks of controls begin, and the lengths of the intervals before the nodes, are parameters behind those of the
user. All expressions of a node pass Augmented.put_in(), which writes them in the symbols of a stage.
"""

from __future__ import annotations

import re
from functools import cached_property

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError, warn
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, Augmentation, Signal, model_function, symbols
from nmpc_codegen.ir.casadi_types import Expression, Function, elements

#: Derivatives below this are rounding errors.
EQUAL = 1e-9


class Augmented:
    """An OCP without algebraic variables, with the states and data that its expressions need behind its own.

    ``period``: time between samples, the length of the interval before node 0; None: the first interval. Where all
    intervals have this length, expressions read the number, else a parameter.
    """

    def __init__(self, ocp: OCP, period: float | None = None) -> None:
        found = {symbol.element_hash() for expression in _expressions(ocp) for symbol in ca.symvar(expression)}
        held = tuple(sorted(ocp.blocks))
        previous = tuple(j for j in sorted(ocp.remembered) if j in held or ocp.remembered[j].element_hash() in found)
        rates, time = (symbol.element_hash() in found for symbol in (ocp.interval_before, ocp.clock))
        self.ocp, self.dt = ocp, (1.0,) * ocp.N if ocp.dt is None else ocp.dt
        self.lengths = period or self.dt[0], *self.dt  # of the intervals before the nodes
        self.same_length = [ca.SX(self.dt[0])] if rates and len(set(self.lengths)) == 1 else []
        self.added = Augmentation(previous, rates and not self.same_length, time, held, idle=not ocp.controls)
        self.own, self.nu, self.np_own = ocp.x.numel(), max(1, ocp.u.numel()), ocp.p.numel()
        self.nx = self.own + self.added.count
        self.np = self.np_own + self.added.data + ocp.node_data.numel()

    # Expressions -----------------------------------------------------------------------------------------------------

    def put_in(self, expressions: list[Expression], x: Expression, u: Expression, p: Expression) -> list[Expression]:
        """The expressions in the symbols x, u, p of a stage (u empty: they contain no control)."""
        ends = u.numel() == 0
        own, first = elements(p), self.np_own + len(self.added.held)  # marks of blocks have no symbol
        data = [*own[: self.np_own], *self.same_length, *own[first:]]
        new = ca.vertcat(x, *([] if ends else [self.acting(x, u, p)]), *data)
        return [ca.densify(e) for e in ca.substitute(expressions, [self._symbols[ends]], [new])]

    @cached_property
    def _symbols(self) -> tuple[Expression, Expression]:
        """The symbols of the OCP for (x, u, p), and for (x, p) of a node without controls. Behind the parameters stand
        the length of the interval before and what Newton's method finds."""
        ocp, added = self.ocp, self.added
        states = [ocp.x, *([ocp.clock] * added.time), *(ocp.remembered[j] for j in added.previous)]
        data = [ocp.p, *([ocp.interval_before] * (added.interval or bool(self.same_length))), ocp.node_data]
        return ca.vertcat(*states, ocp.u, *data), ca.vertcat(*states, *data)

    def acting(self, x: Expression, u: Expression, p: Expression) -> Expression:
        """The controls that act at a node: u_j where a block begins, else that of the node before."""
        added = self.added
        found = [] if added.idle else elements(u)
        for i, j in enumerate(added.held):
            begins, before = p[self.np_own + i], x[self.own + added.places[j]]
            found[j] = begins * u[j] + (1 - begins) * before
        return ca.vertcat(ca.SX(0, 1), *found)

    def dynamics(self) -> tuple[Function, tuple[int, ...], Function | None]:
        """The dynamics f(x, u, p), with the derivative 0 of states that are maps; their positions and their values at
        the next node (x, u, p, dt). A discrete map has these states in itself.

        Raises:
            ProblemError: a discrete map on a grid of different intervals asks for their lengths.
        """
        ocp, added, own = self.ocp, self.added, self.own
        if ocp.discrete and added.time and len(set(self.dt)) > 1:
            raise ProblemError(f"OCP '{ocp.name}': time of a discrete map requires intervals of one length")
        x, u, p, length = symbols(self.nx, self.nu, self.np)
        stated = {**ocp.derivatives, **ocp.maps}
        f = elements(self.put_in([ca.vertcat(*(stated[i] for i in range(own)))], x, u, p)[0])
        acting = self.acting(x, u, p)
        controls = [acting[j] for j in added.previous]
        if ocp.discrete:
            time = [x[own] + self.dt[0]] if added.time else []
            return model_function("f", [x, u, p], [*f, *time, *controls]), (), None
        maps = (*sorted(ocp.maps), *range(own + added.time, self.nx))
        jumps = [*(f[i] for i in sorted(ocp.maps)), *controls]
        rates = [*(ca.SX(0) if i in ocp.maps else f[i] for i in range(own))]
        rates += [ca.SX(int(added.time and i == own)) for i in range(own, self.nx)]
        jump = model_function("g", [x, u, p, length], jumps) if maps else None
        return model_function("f", [x, u, p], rates), maps, jump

    # Signals ---------------------------------------------------------------------------------------------------------

    def states(self) -> tuple[Signal, ...]:
        """All states; those behind the user's start at 0."""
        ocp, added = self.ocp, self.added
        names = [(e, d.signal.unit) for d in ocp.controls for e in d.signal.elements]
        found: list[tuple[str, str, tuple[float, ...]]] = []
        found += [("time", ocp.time_unit, (sum(self.dt),))] * added.time
        found += [(f"previous({names[j][0]})", names[j][1], ()) for j in added.previous]
        return (
            *(d.signal for d in ocp.states),
            *(Signal(n, 1, unit, (0.0,), self.own + i, True, scale) for i, (n, unit, scale) in enumerate(found)),
        )

    def controls(self) -> tuple[Signal, ...]:
        """The controls; one that acts on nothing where a problem has components of x_0 alone to choose."""
        found = tuple(d.signal for d in self.ocp.controls)
        return found or (Signal("none", 1, "", (0.0,), 0, True, (1.0,)),)

    def parameters(self) -> tuple[Signal, ...]:
        """All parameters; behind those of the user stand the data of the nodes."""
        ocp = self.ocp
        names = [e for d in ocp.controls for e in d.signal.elements]
        found = [(f"block start({names[j]})", "", 1.0) for j in self.added.held]
        found += [("interval before", ocp.time_unit, self.dt[0])] * self.added.interval
        return (
            *(d.signal for d in ocp.parameters),
            *(Signal(n, 1, unit, (v,), self.np_own + i, True) for i, (n, unit, v) in enumerate(found)),
        )

    def node_data(self) -> Array:
        """(N + 1, data): 1 where a block of a control begins; the length of the interval before."""
        blocks = np.zeros((self.ocp.N + 1, len(self.added.held)))
        for i, j in enumerate(self.added.held):
            blocks[np.cumsum((0, *self.ocp.blocks[j])), i] = 1.0
        return np.hstack([blocks, np.array([self.lengths]).T[:, : self.added.interval]])


def _expressions(ocp: OCP) -> list[Expression]:
    return [
        *ocp.derivatives.values(),
        *ocp.maps.values(),
        *(r.y for r in ocp.residuals),
        *(c.expression for c in ocp.costs),
        *(s.expression for s in ocp.statements),
        *(s.end for s in ocp.statements if s.end is not None),
    ]


# Mistakes ------------------------------------------------------------------------------------------------------------

#: Names of states that are meant to be controls of the node before.
_MEANT = re.compile(r"(^|_)(last|prev|previous|old|before|delayed)(_|$|\d)", re.IGNORECASE)


def warn_of_integrals(ocp: OCP) -> None:
    """Warn of a state that is meant to remember a control and integrates it: last' = u, and u - last in the problem."""
    names = [e for d in ocp.states for e in d.signal.elements]
    for i, derivative in sorted(ocp.derivatives.items()):
        control = ocp.element(derivative)
        if ocp.discrete or control is None or control.kind != "control":
            continue
        u, x = ocp.u[control.index], ocp.x[i]
        compared = any(_is_difference(e, u, x) for expression in _expressions(ocp) for e in elements(expression))
        if compared or _MEANT.search(names[i]):
            warn(
                f"dynamics: '{names[i]}' is the integral of {control.name}, not its last value; the control of the "
                f"node before is ocp.previous({control.name}), its slope ocp.rate({control.name})"
            )


def _is_difference(expression: Expression, u: Expression, x: Expression) -> bool:
    """True if the expression depends on u and x through u - x alone."""
    found = {s.element_hash() for s in ca.symvar(expression)}
    if not {u.element_hash(), x.element_hash()} <= found:
        return False
    change = ca.jacobian(expression, u) + ca.jacobian(expression, x)
    free = ca.symvar(change)
    at = ca.Function("change", [ca.vertcat(ca.SX(0, 1), *free)], [ca.densify(change)])
    draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, len(free)))
    return all(abs(float(at(draw))) < EQUAL for draw in draws)
