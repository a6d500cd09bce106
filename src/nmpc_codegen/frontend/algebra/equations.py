"""Algebraic equations and implicit dynamics of an OCP are stated as g(x, z, u, p) = 0 and f(x', x, z, u, p) = 0."""

from __future__ import annotations

from typing import Any

import casadi as ca

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import duplicate, identifier, quote
from nmpc_codegen.frontend.expressions import NODE, Dynamics
from nmpc_codegen.frontend.statement import Element, Equation, Kind
from nmpc_codegen.frontend.symbol import is_comparison


class Algebraic(Dynamics):
    """This part of OCP states equations for variables."""

    def algebraic_equation(self, g: Any, *, name: str | None = None) -> None:
        """State 0 = g(x, z, u, p), one scalar equation per algebraic variable, in one call or several.

        The equations have to determine the algebraic variables: dg/dz is regular (index 1). The equations hold at every
        stage of the integrator, and z of a node belongs to its x, u and p; at node N, which has no control, z belongs
        to u_{N-1}.

        Args:
            g: column of expressions.
            name: name of the equations in messages, by default equation_i; several ones are called name[i].

        Raises:
            ProblemError: an expression contains a symbol that is not allowed there, or a name is used twice.
        """
        self._add_equations(g, name, "algebraic_equation", "equation", NODE)

    def implicit_dynamics(self, f: Any, *, name: str | None = None) -> None:
        """State 0 = f(x', x, z, u, p) with x' = der(x), for states whose derivatives are not given by dynamics().

        Together with the algebraic equations, there must be as many equations as such states and algebraic variables. A
        mass matrix M(x) is stated as implicit_dynamics(M @ ocp.der(v) - forces).

        Args:
            f: column of expressions, which may contain der() of states.
            name: as for algebraic_equation(); by default implicit_i.

        Raises:
            ProblemError: as for algebraic_equation(), or the dynamics are a discrete map.
        """
        if self.dt is None or self.discrete:
            raise ProblemError(f"implicit_dynamics: '{self.name}' is a discrete map, whose states have no derivatives")
        self._add_equations(f, name, "implicit_dynamics", "implicit", (*NODE, "derivative"))
        self._discrete = False

    def der(self, x: Any) -> Any:
        """Return the derivative of a state, SX of the shape of x, for implicit_dynamics().

        Args:
            x: symbol, name, or a column of symbols of states.
        """
        where, names = self._components(x, "der:"), self._state_names()
        for i in where:
            if i not in self.slopes:
                self.slopes[i] = ca.SX.sym(f"der({names[i]})")
                self._elements[self.slopes[i].element_hash()] = Element("derivative", i, f"der({names[i]})")
        return ca.vertcat(*(self.slopes[i] for i in where))

    def _add_equations(self, g: Any, name: str | None, call: str, word: str, kinds: tuple[Kind, ...]) -> None:
        what = call if name is None else f"{call} {quote(name)}"
        if isinstance(g, ca.SX) and is_comparison(g):
            raise ProblemError(f"{what}: {quote(g)} is a comparison; state 0 = left - right by its right side alone")
        found = self._expression(g, what, kinds)
        n, first = found.numel(), len(self.equations)
        if not n:
            raise ProblemError(f"{what}: the expression is empty")
        if name is None:
            names = [f"{word}_{first + i}" for i in range(n)]
        else:
            identifier(name, what)
            names = [name] if n == 1 else [f"{name}[{i}]" for i in range(n)]
        if clash := duplicate([*(e.name for e in self.equations), *names]):
            raise ProblemError(f"{what}: an equation is called '{clash[1]}' already; give another name=")
        for i, equation in enumerate(names):
            if not self._kinds(found[i]) & {"algebraic", "derivative"}:
                raise ProblemError(
                    f"{what}: '{equation}' contains no algebraic variable and no derivative, so that it determines "
                    "nothing: index 2 or higher; differentiate it with respect to time until it contains one"
                )
        self.equations.extend(map(Equation, names, ca.vertsplit(found)))
