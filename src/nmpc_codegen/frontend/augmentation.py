"""The augmented state adds states to the user's, through which a node knows its time and the previous controls.

    t_{k+1} = t_k + dt_k     (t' = 1 along an interval),   v_{k+1} = u_k

The maps of the added states are constant, so that kernels, integrators and second derivatives need no change; at node 0
the added states are known. Flags of blocks of controls, and the lengths of the intervals before the nodes, are
parameters added to the user's. Augmented.put_in() writes all expressions of a node in the symbols of a stage.
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

#: Derivatives below this value are rounding errors.
EQUAL = 1e-9


class Augmented:
    """An OCP without algebraic variables, with the states and data that its expressions need in addition.

    ``period`` is the time between samples, which is the length of the interval before node 0; None: the first interval.
    If all intervals have this length, expressions contain the number, else a parameter.
    """

    def __init__(self, ocp: OCP, period: float | None = None) -> None:
        found = {symbol.element_hash() for expression in _expressions(ocp) for symbol in ca.symvar(expression)}
        held = tuple(sorted(ocp.blocks))
        previous = tuple(j for j in sorted(ocp.remembered) if j in held or ocp.remembered[j].element_hash() in found)
        rates, time = (symbol.element_hash() in found for symbol in (ocp.interval_before, ocp.clock))
        self.ocp, self.dt = ocp, (1.0,) * ocp.N if ocp.dt is None else ocp.dt
        self.lengths = period or self.dt[0], *self.dt  # lengths of the intervals before the nodes
        self.same_length = [ca.SX(self.dt[0])] if rates and len(set(self.lengths)) == 1 else []
        self.added = Augmentation(previous, rates and not self.same_length, time, held, idle=not ocp.controls)
        self.own, self.nu, self.np_own = ocp.x.numel(), max(1, ocp.u.numel()), ocp.p.numel()
        self.nx = self.own + self.added.count
        self.np = self.np_own + self.added.data + ocp.node_data.numel()

    # Expressions -----------------------------------------------------------------------------------------------------

    def put_in(self, expressions: list[Expression], x: Expression, u: Expression, p: Expression) -> list[Expression]:
        """Write the expressions in the symbols x, u, p of a stage; u is empty if they contain no control."""
        ends = u.numel() == 0
        own, first = elements(p), self.np_own + len(self.added.held)  # flags of blocks have no symbol
        data = [*own[: self.np_own], *self.same_length, *own[first:]]
        new = ca.vertcat(x, *([] if ends else [self.acting(x, u, p)]), *data)
        return [ca.densify(e) for e in ca.substitute(expressions, [self._symbols[ends]], [new])]

    @cached_property
    def _symbols(self) -> tuple[Expression, Expression]:
        """Return the symbols of the OCP for (x, u, p), and for (x, p) of a node without controls.

        The length of the previous interval and the results of Newton's method follow the parameters.
        """
        ocp, added = self.ocp, self.added
        states = [ocp.x, *([ocp.clock] * added.time), *(ocp.remembered[j] for j in added.previous)]
        data = [ocp.p, *([ocp.interval_before] * (added.interval or bool(self.same_length))), ocp.node_data]
        return ca.vertcat(*states, ocp.u, *data), ca.vertcat(*states, *data)

    def acting(self, x: Expression, u: Expression, p: Expression) -> Expression:
        """Return the controls that act at a node: u_j where a block begins, else the control of the previous node."""
        added = self.added
        found = [] if added.idle else elements(u)
        for i, j in enumerate(added.held):
            begins, before = p[self.np_own + i], x[self.own + added.places[j]]
            found[j] = begins * u[j] + (1 - begins) * before
        return ca.vertcat(ca.SX(0, 1), *found)

    def dynamics(self) -> tuple[Function, tuple[int, ...], Function | None]:
        """Return the dynamics f(x, u, p), the indices of discrete states, and the function of their next values.

        The latter is (x, u, p, dt) -> values; the derivatives of discrete states in f are 0. A discrete map contains
        these states itself.

        Raises:
            ProblemError: a discrete map uses time on a grid of different intervals.
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
        """Return all states; the added ones start at 0."""
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
        """Return the controls.

        A problem without controls, which only chooses components of x_0, gets one without effect.
        """
        found = tuple(d.signal for d in self.ocp.controls)
        return found or (Signal("none", 1, "", (0.0,), 0, True, (1.0,)),)

    def parameters(self) -> tuple[Signal, ...]:
        """Return all parameters: the user's, then the data of the nodes."""
        ocp = self.ocp
        names = [e for d in ocp.controls for e in d.signal.elements]
        found = [(f"block start({names[j]})", "", 1.0) for j in self.added.held]
        found += [("interval before", ocp.time_unit, self.dt[0])] * self.added.interval
        return (
            *(d.signal for d in ocp.parameters),
            *(Signal(n, 1, unit, (v,), self.np_own + i, True) for i, (n, unit, v) in enumerate(found)),
        )

    def node_data(self) -> Array:
        """Return (N + 1, data): 1 where a block of a control begins; the length of the previous interval."""
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

#: Names that suggest a state which stores the control of the previous node.
_MEANT = re.compile(r"(^|_)(last|prev|previous|old|before|delayed)(_|$|\d)", re.IGNORECASE)


def warn_of_integrals(ocp: OCP) -> None:
    """Warn of a state that should store a control but integrates it: last' = u, with u - last in the problem."""
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
    """Return True if the expression depends on u and x only through u - x."""
    found = {s.element_hash() for s in ca.symvar(expression)}
    if not {u.element_hash(), x.element_hash()} <= found:
        return False
    change = ca.jacobian(expression, u) + ca.jacobian(expression, x)
    free = ca.symvar(change)
    at = ca.Function("change", [ca.vertcat(ca.SX(0, 1), *free)], [ca.densify(change)])
    draws = np.random.default_rng(0).uniform(0.5, 1.5, (3, len(free)))
    return all(abs(float(at(draw))) < EQUAL for draw in draws)
