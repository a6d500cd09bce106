"""This part of OCP provides symbols (states, controls, previous controls, time) and checks expressions and dynamics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError, warn
from nmpc_codegen.frontend.checks import NONSMOOTH, check_operations, column, list_names, quote
from nmpc_codegen.frontend.statement import Declared, Element, Kind, StatedProblem, explain_misplacement

#: Kinds of symbols that expressions of a node may contain.
NODE: tuple[Kind, ...] = ("state", "control", "parameter", "algebraic", "previous", "interval", "time")


class Expressions(StatedProblem):
    """This part of OCP checks expressions."""

    @property
    def x(self) -> Any:
        """Return all states declared so far, SX (nx,)."""
        return ca.vertcat(ca.SX(0, 1), *(d.symbol for d in self.states))

    @property
    def u(self) -> Any:
        """Return all controls declared so far, SX (nu,)."""
        return ca.vertcat(ca.SX(0, 1), *(d.symbol for d in self.controls))

    @property
    def p(self) -> Any:
        """Return all parameters declared so far, SX (np,)."""
        return ca.vertcat(ca.SX(0, 1), *(d.symbol for d in self.parameters))

    @property
    def z(self) -> Any:
        """Return all algebraic variables declared so far, SX (nz,)."""
        return ca.vertcat(ca.SX(0, 1), *(d.symbol for d in self.algebraics))

    def _expression(self, value: Any, what: str, kinds: tuple[Kind, ...]) -> Any:
        """Return a dense SX column; raise ProblemError unless it contains only symbols of the given kinds."""
        expression = column(value, what, self._symbols)
        for symbol in ca.symvar(expression):
            element = self.element(symbol)
            if element is None:
                raise ProblemError(
                    f"{what} contains the unknown symbol '{symbol.name()}'{list_names(self._symbols)}"
                    if symbol.name() not in self._symbols
                    else f"{what} contains a symbol '{symbol.name()}' that was not declared in this OCP"
                )
            if element.kind not in kinds:
                raise ProblemError(f"{what} contains {explain_misplacement(element, kinds)}")
        check_operations(expression, what)
        return expression

    def _kinds(self, scalar: Any) -> set[str]:
        return {e.kind for e in map(self.element, ca.symvar(scalar)) if e is not None}


class NodeBefore(Expressions):
    """This part of OCP has symbols for the controls of the previous node, their rates, and time."""

    def previous(self, u: Any) -> Any:
        """Return the previous control, u_{k-1} at node k and u_{N-1} at node N; SX of the shape of u.

        At node 0 this is the control that was applied last: the one that step() or feedback() returned, unless
        set_previous() states what the actuator did. init() and reset() set it to the first control of their plan, the
        reference of u. The previous control may occur in expressions of all nodes; in dynamics it models a dead time of
        one sample.

        Args:
            u: symbol, name, or a column of symbols of controls.
        """
        where = self.control_places(u, "previous:")
        names = self._control_names()
        for j in where:
            if j not in self.remembered:
                twin = ca.SX.sym(f"previous({names[j]})")
                self._elements[twin.element_hash()] = Element("previous", j, f"previous({names[j]})")
                self.remembered[j] = twin
        return ca.vertcat(*(self.remembered[j] for j in where))

    def rate(self, u: Any) -> Any:
        """Return (u - previous(u)) / dt, the slope of a control in its unit per unit of time; SX of the shape of u.

        dt is the sampling time at node 0, and the length of the interval k - 1 at node k = 1 .. N - 1.

        Args:
            u: symbol, name, or a column of symbols of controls.

        Examples:
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("valve", T=1.0, N=10)
            >>> u = ocp.control("u", unit="V")
            >>> ocp.subject_to(-5, ocp.rate(u), 5, name="slew")
        """
        where = self.control_places(u, "rate:")
        return (self.u[where] - self.previous(u)) / self.interval_before

    @property
    def time(self) -> Any:
        """Return the symbol of the time of the node, SX scalar.

        It is the time of the sample, 0 after init() and reset(), plus the lengths of the intervals before the node.
        step() advances it by the sampling time, set_time() sets it. In derivatives it is the time of the integrator's
        stage.
        """
        return self.clock

    def control_places(self, which: Any, what: str) -> list[int]:
        """Return the indices in u of a control, given by its symbol, a column of symbols, or its name (internal)."""
        found = self._places(which, "control", self.controls)
        if not found:
            raise ProblemError(f"{what} {quote(which)} is no control{list_names(self._control_names())}")
        return found

    def _places(self, which: Any, kind: str, declared: list[Declared]) -> list[int]:
        """Return the indices of a signal of this kind, given by its symbol, a column of symbols, or its name.

        The result is empty for anything else.
        """
        if isinstance(which, ca.SX):
            found = [self.element(which[i]) for i in range(which.numel())]
            places = [e.index for e in found if e is not None and e.kind == kind]
            return places if len(places) == len(found) else []
        if not isinstance(which, str):
            return []
        for signal in (d.signal for d in declared):
            if which == signal.name:
                return list(range(signal.offset, signal.offset + signal.size))
        names = [e for d in declared for e in d.signal.elements]
        return [names.index(which)] if which in names else []

    def _control_names(self) -> list[str]:
        return [e for d in self.controls for e in d.signal.elements]


class Dynamics(NodeBefore):
    """This part of OCP states the dynamics of states."""

    def dynamics(self, rhs: Any, *, discrete: Any = False) -> None:
        """State the derivatives x' = f(x, u, p), or the next states x_{k+1} = f(x_k, u_k, p_k) if ``discrete``.

        Args:
            rhs: {state symbol or name: expression}, in one call or several, or a column in declaration order.
            discrete: True: the expressions are the states at the next node. {state symbol or name: expression}: next
                values of states that are constant along an interval, beside the states that ``rhs`` integrates.

        Examples:
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("heater", T=60.0, N=30)
            >>> T, late, P = ocp.state("T"), ocp.state("late"), ocp.control("P")
            >>> ocp.dynamics({T: late - 0.1 * T}, discrete={late: ocp.previous(P)})
        """
        if isinstance(discrete, Mapping):
            self._add_maps(rhs, discrete)
            return
        if not isinstance(discrete, (bool, np.bool_)):
            raise ProblemError(
                f"dynamics: discrete must be True, False or {{state: next value}}, got {type(discrete).__name__} "
                f"{quote(discrete)}"
            )
        discrete = bool(discrete)
        if not discrete and self.dt is None:
            raise ProblemError(
                f"OCP '{self.name}' was given N only, so its dynamics must be discrete: "
                "give T= or intervals=, or dynamics(..., discrete=True)"
            )
        if self._discrete is not None and discrete != self._discrete:
            raise ProblemError("dynamics: discrete and continuous dynamics cannot be mixed")
        if not self.states:
            raise ProblemError("dynamics: no state is declared; declare states with ocp.state(name) first")
        given = self._by_name(rhs) if isinstance(rhs, Mapping) else self._in_order(rhs)
        for index, expression in given.items():
            self._warn_nonsmooth(self._state_names()[index], expression)
        self._discrete = discrete
        self.derivatives.update(given)

    def _add_maps(self, rhs: Any, discrete: Mapping[Any, Any]) -> None:
        """State the derivatives of some states, and the next values of others."""
        if not isinstance(rhs, Mapping):
            raise ProblemError("dynamics: with discrete={...} the derivatives must be {state: expression}, too")
        if self.dt is None:
            raise ProblemError(f"OCP '{self.name}' was given N only, so all its dynamics are discrete: discrete=True")
        given = self._by_name(discrete, "next value")
        self.dynamics(rhs)
        if both := sorted(set(given) & set(self.derivatives)):
            raise ProblemError(f"dynamics: the derivative of '{self._state_names()[both[0]]}' is given twice")
        for index, expression in given.items():
            self._warn_nonsmooth(self._state_names()[index], expression)
        self.maps.update(given)

    def _state_names(self) -> list[str]:
        return [e for d in self.states for e in d.signal.elements]

    def _in_order(self, rhs: Any) -> dict[int, Any]:
        nx = self.x.numel()
        f = self._expression(rhs, "dynamics", NODE)
        if f.numel() != nx:
            raise ProblemError(f"dynamics has {f.numel()} elements, expected {nx}: one per state, in declaration order")
        if self.derivatives:
            name = self._state_names()[min(self.derivatives)]
            raise ProblemError(f"dynamics: the derivative of '{name}' is given twice")
        return {i: f[i] for i in range(nx)}

    def _by_name(self, rhs: Mapping[Any, Any], word: str = "derivative") -> dict[int, Any]:
        given: dict[int, Any] = {}
        names = self._state_names()
        for key, value in rhs.items():
            where = self._components(key, "dynamics: key")
            what = f"dynamics: {word} of {quote(key)}"
            f = self._expression(value, what, NODE)
            if f.numel() != len(where):
                raise ProblemError(f"{what} has {f.numel()} elements, expected {len(where)}")
            for i, index in enumerate(where):
                if index in given or index in self.derivatives or index in self.maps:
                    raise ProblemError(f"dynamics: the {word} of '{names[index]}' is given twice")
                given[index] = f[i]
        return given

    def _components(self, which: Any, what: str) -> list[int]:
        """Return the indices in x of a state, given by its symbol, a column of symbols, or its name."""
        names = list_names(self._state_names())
        if not isinstance(which, (str, ca.SX)):
            raise ProblemError(f"{what} {quote(which)} must be the symbol or the name of a state{names}")
        found = self._places(which, "state", self.states)
        if not found:
            raise ProblemError(f"{what} {quote(which)} is no state{names}")
        return found

    def _warn_nonsmooth(self, name: str, expression: Any) -> None:
        found = sorted({NONSMOOTH[op] for op in check_operations(expression, "dynamics") if op in NONSMOOTH})
        if found:
            warn(
                f"dynamics of '{name}' contain {', '.join(found)}: derivatives jump or vanish there, and Newton-type "
                "iterations may stall; smooth a switch at s = 0, e.g. by 0.5 * (1 + tanh(s / 0.01)), a table by "
                'kind="cubic"'
            )
