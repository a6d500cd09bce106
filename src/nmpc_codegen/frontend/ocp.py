"""An OCP is the user's statement of an optimal control problem in CasADi expressions, independent of any algorithm."""

from __future__ import annotations

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.checks import (
    MAX_SIZE,
    block_lengths,
    declared_range,
    declared_scale,
    duplicate,
    element_names,
    flag,
    identifier,
    integer,
    list_names,
    quote,
    unit_text,
    vector,
    weight_matrix,
)
from nmpc_codegen.frontend.expressions import NODE
from nmpc_codegen.frontend.grid import grid
from nmpc_codegen.frontend.other_tools import OF_PROBLEM
from nmpc_codegen.frontend.problem import LqrRequest, Signal, c_identifier
from nmpc_codegen.frontend.rows.constraints import Constraints
from nmpc_codegen.frontend.show import in_one_line
from nmpc_codegen.frontend.statement import (
    Declared,
    Element,
    GeneralCost,
    Kind,
    ResidualTerm,
    StageName,
)
from nmpc_codegen.frontend.symbol import Symbol, require_three
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.runtime.diagnosis.foreign_names import missing

__all__ = ["OCP"]

#: Kinds of symbols that expressions of node N and of node 0 may contain.
_END: tuple[Kind, ...] = ("state", "parameter", "algebraic", "previous", "time")
_START: tuple[Kind, ...] = ("state", "parameter")
#: The class of estimators, named here because its module imports this one.
_ESTIMATOR = "nmpc_codegen.frontend.estimator.declaration:Estimator"
#: Kinds of symbols that give a residual its name.
_NAMED: tuple[Kind, ...] = ("state", "control", "parameter", "algebraic")


class OCP(Constraints):
    """An OCP is an optimal control problem over N intervals.

        min   sum_{k<N} l_k(x_k, u_k, p_k) + l_N(x_N, p_N)
        s.t.  x_0 = xhat
              x' = f(x, z, u, p), 0 = g(x, z, u, p) on every interval, or x_{k+1} = f(x_k, u_k, p_k)
              lower <= h(x_k, u_k, p_k) <= upper,   lower <= r(x_0, x_N) <= upper

    Args:
        name: C identifier of at most 60 characters, which is the prefix of the generated C and the name of its files.
            Refused, in upper or lower case, are names of standard headers (math, string), of other files of the folder
            (main, README), of CMake targets (clean), of devices (con), and prefixes of system macros (x).
        T: length of the horizon (s, or ``time_unit``), divided into N equal intervals.
        N: number of intervals. If neither T nor intervals is given, the dynamics are a discrete map with dt = 1.
        intervals: lengths of the intervals, instead of T.
        time_unit: unit of T, of the derivatives and of every later time; it is only printed.

    Raises:
        ProblemError: the problem is stated wrongly; the message names the wrong input and what was expected. All
            methods raise it.

    Examples:
        >>> import casadi as ca
        >>> from nmpc_codegen import OCP
        >>> ocp = OCP("cart", T=2.0, N=20)
        >>> p, v = ocp.state("p", unit="m", initial=1.0), ocp.state("v", unit="m/s")
        >>> F = ocp.control("F", unit="N")
        >>> ocp.dynamics({p: v, v: F / 0.5})
        >>> ocp.least_squares(ca.vertcat(p, v, F), weight=[10, 1, 0.1])
        >>> ocp.subject_to(-1, F, 1)

    Attributes:
        name: name of the problem.
        N: number of intervals.
        dt: lengths of the intervals (N,); None for a discrete map.
        time_unit: unit of time.
    """

    def __init__(
        self, name: str, *, T: float | None = None, N: int | None = None, intervals: Any = None, time_unit: str = "s"
    ) -> None:
        check_package_name(name, "OCP: name")
        unit = unit_text(time_unit, f"OCP '{name}': time_unit")
        super().__init__(name, *grid(name, T, N, intervals, unit), unit)
        self._start: list[Any] = []
        self._end: list[Any] = []

    def __setattr__(self, attribute: str, value: Any) -> None:
        """Refuse to assign public attributes, which only the constructor and the methods set."""
        if not attribute.startswith("_") and (attribute in self.__dict__ or hasattr(type(self), attribute)):
            raise ProblemError(
                f"OCP '{self.name}': the attribute {attribute} cannot be assigned; "
                "name, T, N, intervals and time_unit are given to OCP(...), everything else to its methods"
            )
        super().__setattr__(attribute, value)

    if not TYPE_CHECKING:  # a type checker must find names that do not exist

        def __getattr__(self, attribute: str) -> Any:
            """Raise an error for an attribute that does not exist.

            For attributes of other tools it names the right one.
            """
            raise missing("OCP", attribute, OF_PROBLEM, dir(self))

    def __repr__(self) -> str:
        return in_one_line(self)

    def _repr_html_(self) -> str:
        from nmpc_codegen.pictures.ocp_in_html import in_html

        return in_html(self)

    # Signals ---------------------------------------------------------------------------------------------------------

    def state(
        self,
        name: str,
        *,
        size: int | None = None,
        unit: str = "",
        initial: Any = 0.0,
        scale: Any = None,
        initial_range: Any = None,
    ) -> Any:
        """Declare a state.

        Args:
            name: its name; elements of a vector are name[0], name[1], ...
            size: number of elements; None: a scalar.
            unit: it is printed and written into the C.
            initial: x_0 for --check, --simulate, main.c and the test vectors, a number or (size,).
            scale: positive number or (size,): a value that is neither small nor large, in the unit of the state.
                Tolerances are relative to it, and values far below it count as 0. None: the largest of half the width
                of the bounds, the initial value and the references; if all are 0, the change that the controls cause.
            initial_range: (lower, upper), the range of measured states at the start of a loop; the compiler checks its
                corners for warnings, and campaigns start inside.

        Returns:
            Its SX symbol, a scalar or a column, which can be the key of a dictionary.

        Examples:
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("drone", T=1.0, N=10)
            >>> position = ocp.state("position", size=3, unit="m", initial=[0, 0, 1])
        """
        symbol = self._declare("state", self.states, name, size, unit, initial, "initial", scale, initial_range)
        for which, kind in ((self._start, "start"), (self._end, "end")):
            twin = ca.SX.sym(f"{name}_{kind}", symbol.numel())
            which.append(twin)
            for i, element in enumerate(self.states[-1].signal.elements):
                offset = self.states[-1].signal.offset
                self._elements[twin[i].element_hash()] = Element(kind, offset + i, element)  # type: ignore[arg-type]
        return symbol

    def control(
        self, name: str, *, size: int | None = None, unit: str = "", scale: Any = None, hold: Any = None
    ) -> Any:
        """Declare a control, which is constant on every interval.

        Args:
            name: its name; elements of a vector are name[0], name[1], ...
            size: number of elements; None: a scalar.
            unit: it is printed and written into the C.
            scale: as for state().
            hold: lengths of blocks of intervals with one value each, whose sum is N: [1, 1, 2, 4] are four values over
                eight intervals. None: one value per interval.

        Returns:
            Its SX symbol, a scalar or a column.
        """
        blocks = None if hold is None else block_lengths(hold, self.N, f"control {quote(name)}: hold")
        symbol = self._declare("control", self.controls, name, size, unit, 0.0, "value", scale)
        if blocks is not None and max(blocks) > 1:
            where = self.control_places(symbol, "hold:")
            self.blocks.update(dict.fromkeys(where, blocks))
            self.previous(symbol)
        return symbol

    def parameter(
        self, name: str, *, value: Any = 0.0, size: int | None = None, unit: str = "", bounds: Any = None
    ) -> Any:
        """Declare a parameter, which can be changed at run time, for all nodes or for each.

        Args:
            name: its name; elements of a vector are name[0], name[1], ...
            value: a number or (size,), used until set_parameter() changes it.
            size: number of elements; None: a scalar.
            unit: it is printed and written into the C.
            bounds: (lower, upper), numbers or one per element; set_parameter() refuses values outside, the compiler
                checks the corners for warnings, and campaigns draw values between them.

        Returns:
            Its SX symbol, a scalar or a column.
        """
        return self._declare("parameter", self.parameters, name, size, unit, value, "value", None, bounds)

    def algebraic(
        self, name: str, *, size: int | None = None, unit: str = "", initial: Any = 0.0, scale: Any = None
    ) -> Any:
        """Declare an algebraic variable, which an algebraic_equation() determines.

        Args:
            name: its name; elements of a vector are name[0], name[1], ...
            size: number of elements; None: a scalar.
            unit: it is printed and written into the C.
            initial: start of Newton's method in the first sample, and after it has failed.
            scale: as for state().

        Returns:
            Its SX symbol, a scalar or a column.

        Examples:
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("diode", T=1.0, N=10)
            >>> i, u = ocp.algebraic("i", unit="A", initial=0.1), ocp.control("u", unit="V")
            >>> ocp.algebraic_equation(i + i**3 - u)
        """
        return self._declare("algebraic", self.algebraics, name, size, unit, initial, "initial", scale)

    @property
    def x_start(self) -> Any:
        """Return the symbols of x_0 that at_start() substitutes for the states, SX (nx,)."""
        return ca.vertcat(ca.SX(0, 1), *self._start)

    @property
    def x_end(self) -> Any:
        """Return the symbols of x_N that at_end() substitutes for the states, SX (nx,)."""
        return ca.vertcat(ca.SX(0, 1), *self._end)

    def at_start(self, expr: Any) -> Any:
        """Return an expression at node 0, for boundary().

        Args:
            expr: of states.
        """
        return ca.substitute(self._expression(expr, "at_start", ("state",)), self.x, self.x_start)

    def at_end(self, expr: Any) -> Any:
        """Return an expression at node N, for boundary().

        Args:
            expr: of states.
        """
        return ca.substitute(self._expression(expr, "at_end", ("state",)), self.x, self.x_end)

    def _declare(
        self,
        kind: Kind,
        to: list[Declared],
        name: str,
        size: int | None,
        unit: str,
        value: Any,
        word: str,
        scale: Any = None,
        limits: Any = None,
    ) -> Any:
        what = f"{kind} {quote(name)}"
        identifier(name, what)
        unit = unit_text(unit, f"{what}: unit")
        n = 1 if size is None else integer(size, f"{what}: size", 1, MAX_SIZE)
        values = tuple(float(v) for v in vector(value, n, f"{what}: {word}"))
        sizes = declared_scale(scale, n, f"{what}: scale")
        limits = declared_range(limits, values, f"{what}: {'initial_range' if kind == 'state' else 'bounds'}")
        signal = Signal(name, n, unit, values, sum(d.signal.size for d in to), size is None, sizes, *limits)
        earlier = [d.signal for d in (*self.states, *self.controls, *self.parameters, *self.algebraics)]
        taken = {c_identifier(e): s.name for s in earlier for e in (*s.elements, s.name)}
        for element in (*signal.elements, name):
            if c_identifier(element) in taken:
                other = taken[c_identifier(element)]
                raise ProblemError(f"{what}: the name '{element}' clashes with '{other}', declared before")
        symbol = Symbol(ca.SX.sym(name) if size is None else ca.SX.sym(name, n))
        to.append(Declared(signal, symbol))
        self._symbols[name] = symbol
        for i, element in enumerate(signal.elements):
            self._elements[symbol[i].element_hash()] = Element(kind, signal.offset + i, element)
        return symbol

    def estimator(self, **statement: Any) -> Any:
        """Return an Estimator of the states of this model from measurements.

        Build() and export() accept it like an OCP.

        Args:
            statement: the arguments of Estimator after the OCP.

        Examples:
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("cart", T=2.0, N=20)
            >>> p, v = ocp.state("p"), ocp.state("v")
            >>> ocp.dynamics({p: v, v: 0})
            >>> estimator = ocp.estimator(N=10, measure={"p": p}, noise_std={"p": 0.01}, process_std={"v": 0.1})
        """
        return resolve_name(_ESTIMATOR)(self, **statement)

    # Cost ------------------------------------------------------------------------------------------------------------

    def least_squares(
        self,
        expr: Any,
        weight: Any,
        *,
        reference: Any = None,
        names: Any = None,
        scale_with_dt: bool = False,
        scale: Any = None,
    ) -> None:
        """Add 1/2 (y - reference)' W (y - reference) at the nodes 0..N-1; several calls add up.

        Args:
            expr: y(x, u, p), column (ny,).
            weight: W, symmetric positive semidefinite (ny, ny); a vector or scalar gives its diagonal.
            reference: (ny,) or scalar, zero by default; it can be changed at run time.
            names: one name per element; by default that of a single symbol, else y_i.
            scale_with_dt: multiply the weight by the length of the interval.
            scale: (ny,) or scalar > 0, a deviation that is neither small nor large; None: the size of y that follows
                from the scales of states and controls. Together with the weight it defines which costs count as 0.

        Examples:
            >>> import casadi as ca
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("cart", T=2.0, N=20)
            >>> p, F = ocp.state("p"), ocp.control("F")
            >>> ocp.least_squares(ca.vertcat(p, F), weight=[10, 0.1], reference=[1, 0])
        """
        self._residual("least_squares", expr, weight, reference, names, scale_with_dt, "path", scale)

    def terminal_least_squares(
        self, expr: Any, weight: Any, *, reference: Any = None, names: Any = None, scale: Any = None
    ) -> None:
        """Add 1/2 (y - reference)' W (y - reference) at node N; it is never scaled.

        Args:
            expr: y(x, p), column (ny_N,).
            weight: as in least_squares().
            reference: as in least_squares(); set_terminal_reference() changes it.
            names: as in least_squares(). If a residual of the path has the same name, a reference set by name holds for
                both.
            scale: as in least_squares().
        """
        self._residual("terminal_least_squares", expr, weight, reference, names, False, "terminal", scale)

    def start_least_squares(self, expr: Any, weight: Any, *, reference: Any = None, names: Any = None) -> None:
        """Add 1/2 (y - reference)' W (y - reference) at node 0; it is never scaled.

        A cost of x_0, e.g. an arrival cost, changes the solution only if components of x_0 are free (free_initial).
        Its weight and reference are fixed; use parameters for data that change at run time.

        Args:
            expr: y(x, p), column.
            weight: as in least_squares().
            reference: a number or one per element, 0 by default.
            names: as in least_squares().
        """
        self._residual("start_least_squares", expr, weight, reference, names, False, "start")

    def _residual(
        self,
        what: str,
        expr: Any,
        weight: Any,
        reference: Any,
        names: Any,
        with_dt: Any,
        stage: StageName,
        scale: Any = None,
    ) -> None:
        kinds = {"start": _START, "path": NODE, "terminal": _END}[stage]
        y = self._expression(expr, f"{what}: expression", kinds)
        ny = y.numel()
        if ny == 0:
            raise ProblemError(f"{what}: the expression is empty")
        earlier = [n for r in self.residuals if r.stage == stage for n in r.names]
        found = self._residual_names(what, y, names, earlier)
        W = weight_matrix(weight, ny, f"{what}: weight")
        yref = np.zeros(ny) if reference is None else vector(reference, ny, f"{what}: reference")
        sizes = declared_scale(scale, ny, f"{what}: scale")
        self.residuals.append(ResidualTerm(y, found, yref, W, flag(with_dt, f"{what}: scale_with_dt"), stage, sizes))

    def _residual_names(self, what: str, y: Any, names: Any, earlier: list[str]) -> tuple[str, ...]:
        if names is None:
            found: list[str] = []
            for i in range(y.numel()):
                element = self.element(y[i])
                named = element if element is not None and element.kind in _NAMED else None
                taken = named is None or named.name in earlier or named.name in found
                found.append(f"y_{len(earlier) + i}" if named is None or taken else named.name)
        else:
            found = element_names(names, y.numel(), f"{what}: names")
        clash = duplicate(c_identifier(n) for n in [*earlier, *found])
        if clash:
            raise ProblemError(f"{what}: the name '{clash[1]}' is used twice; give other names=")
        return tuple(found)

    def stage_cost(self, expr: Any, *, integrate: bool = False, scale_with_dt: bool = True) -> None:
        """Add a general cost l(x, u, p) of the path, with exact Hessians or a constant one.

        Args:
            expr: l, a scalar.
            integrate: True: integrate it over every interval by the scheme of the dynamics, without further scaling.
                False: evaluate it at the nodes 0..N-1.
            scale_with_dt: multiply the value at node k by the length of its interval.
        """
        l = self._scalar(expr, "stage_cost", NODE)  # noqa: E741
        integrate, scale = flag(integrate, "stage_cost: integrate"), flag(scale_with_dt, "stage_cost: scale_with_dt")
        self.costs.append(GeneralCost(l, integrate, scale and not integrate, "path"))

    def terminal_cost(self, expr: Any) -> None:
        """Add a general cost at node N; it is never scaled.

        Args:
            expr: l_N(x, p), a scalar.
        """
        l = self._scalar(expr, "terminal_cost", _END)  # noqa: E741
        self.costs.append(GeneralCost(l, False, False, "terminal"))

    def lqr_terminal_cost(self, *, economic: bool = False, x: Any = None, u: Any = None) -> None:
        """Add the cost-to-go of the linear-quadratic regulator at a steady state (x_s, u_s) as terminal cost at node N.

            1/2 (x - x_s)' P (x - x_s),   with ``economic``: (lam_s - D' mu_s)' (x - x_s) + 1/2 (x - x_s)' P (x - x_s)

        P solves the Riccati equation of the discrete map, so it is computed when the options are known: by build(),
        export() and tune(). States named by cyclic() are left out, and rows that are strictly active at the steady
        state are eliminated first. D and mu_s are the slopes and multipliers of those rows that hold at node N. P of an
        economic cost may be indefinite.

        Args:
            economic: True: take the steady state with the least cost, the Hessian of its Lagrangian, and its
                multipliers lam_s for the linear term. False: the least-squares cost, with J' W J.
            x: (nx,) steady state; by default that of the references. With ``economic`` it is only a guess.
            u: (nu,) control of the steady state.
        """
        if self._terminal_lqr is not None:
            raise ProblemError("lqr_terminal_cost is stated twice")
        given = (
            None if x is None else vector(x, self.x.numel(), "lqr_terminal_cost: x"),
            None if u is None else vector(u, self.u.numel(), "lqr_terminal_cost: u"),
        )
        self._terminal_lqr = LqrRequest(flag(economic, "lqr_terminal_cost: economic"), *given)

    def start_cost(self, expr: Any) -> None:
        """Add a general cost at node 0, which acts on free components of x_0, as in start_least_squares().

        It is never scaled.

        Args:
            expr: l_0(x, p), a scalar.
        """
        l = self._scalar(expr, "start_cost", _START)  # noqa: E741
        self.costs.append(GeneralCost(l, False, False, "start"))

    def _scalar(self, expr: Any, what: str, kinds: tuple[Kind, ...]) -> Any:
        l = self._expression(expr, what, kinds)  # noqa: E741
        if l.numel() != 1:
            raise ProblemError(f"{what} must be a scalar, got {l.numel()} elements")
        return l

    # Constraints -----------------------------------------------------------------------------------------------------

    def subject_to(
        self,
        lower: Any,
        expr: Any = None,
        upper: Any = None,
        *,
        at: Any = "path",
        soft: Any = None,
        name: str | None = None,
    ) -> None:
        """Add the rows lower <= expr <= upper; all three arguments are required.

        Args:
            lower: number, or one per row; -inf is allowed; lower = upper states an equality.
            upper: number, or one per row; +inf is allowed.
            expr: h(x, u, p), column. Elements that are a single state or control become simple bounds.
            at: "path": nodes 0..N-1 for a row with a control, else 1..N (and 0 if one of its states is free there);
                "start": node 0; "end": node N; or an iterable of nodes.
            soft: (l1, l2), or l1: the row may be violated on either side by s >= 0, at the cost l1 s + 1/2 l2 s^2.
                Soft(lower=(l1, l2), upper=(l1, l2)): penalties by side; if they differ, the sides become the rows
                name_lower and name_upper. set_soft() changes the penalties at run time; with l1 = inf the row is hard
                until then.
            name: by default that of a single symbol, else row_i; several rows are called name[i]; at="start" and
                at="end" append _start and _end.

        If a single state or control already has a row of this name with the same ``at`` and ``soft``, no second row is
        added; the bounds of that row become the intersection.

        Examples:
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("robot", T=2.0, N=20)
            >>> x, y, v = ocp.state("x"), ocp.state("y"), ocp.control("v")
            >>> ocp.subject_to(-1, v, 1)
            >>> ocp.subject_to(0.4**2, x**2 + y**2, float("inf"), soft=(1e3, 0), name="pillar")
            >>> ocp.subject_to(0, x, 0, at="end")
        """
        what = f"subject_to {quote(name)}" if name is not None else "subject_to"
        require_three(lower, expr, upper, what, "subject_to")
        nodes = self._at(at, what)
        h = self._expression(expr, f"{what}: expression", NODE)
        suffix = f"_{nodes}" if nodes in ("start", "end") else ""
        for i in range(h.numel()):
            kinds = self._kinds(h[i])
            if not kinds & {"state", "control", "algebraic", "previous"}:
                raise ProblemError(
                    f"{what}: {quote(h[i])} depends on no state and no control; the order is lower, expression, upper"
                )
            last = nodes == "end" or (isinstance(nodes, tuple) and self.N in nodes)
            if last and "control" in kinds:
                raise ProblemError(
                    f"{what}: {quote(h[i])} contains a control, and node {self.N} (the end) has none; "
                    f"use at='path' or nodes 0..{self.N - 1}"
                )
        self._add_rows(lower, h, upper, nodes, soft, name, suffix, what)

    def boundary(
        self, lower: Any, expr: Any = None, upper: Any = None, *, soft: Any = None, name: str | None = None
    ) -> None:
        """Add the rows lower <= r(x_0, x_N) <= upper, which couple both ends, e.g. for periodicity.

        Args:
            lower: as in subject_to().
            expr: r, written with at_start() and at_end(), column.
            upper: as in subject_to().
            soft: as in subject_to().
            name: as in subject_to().

        Examples:
            >>> from nmpc_codegen import OCP
            >>> ocp = OCP("orbit", T=1.0, N=10)
            >>> x = ocp.state("x")
            >>> ocp.boundary(0, ocp.at_start(x) - ocp.at_end(x), 0, name="period")
        """
        what = f"boundary {quote(name)}" if name is not None else "boundary"
        require_three(lower, expr, upper, what, "boundary")
        r = self._expression(expr, f"{what}: expression", ("start", "end"))
        for i in range(r.numel()):
            kinds = self._kinds(r[i])
            if "end" not in kinds:
                raise ProblemError(
                    f"{what}: {quote(r[i])} does not depend on the end of the horizon; use at_end(), or subject_to"
                )
        self._add_rows(lower, r, upper, None, soft, name, "", what)

    # Initial state ---------------------------------------------------------------------------------------------------

    def free_initial(self, *states: Any) -> None:
        """Let the solver choose components of x_0; xhat is their initial guess.

        Args:
            states: symbols or names.
        """
        self.free.update(self._list_states(states, "free_initial"))

    def accumulator(self, *states: Any) -> None:
        """Mark states that are reset to 0 at every sample, e.g. running averages; their entries of xhat are ignored.

        Args:
            states: symbols or names.
        """
        self.accumulators.update(self._list_states(states, "accumulator"))

    def cyclic(self, *states: Any) -> None:
        """Mark states that grow without bound, e.g. a position; steady state, tune() and LQR leave them out.

        Args:
            states: symbols or names.
        """
        self.cyclic_states.update(self._list_states(states, "cyclic"))

    def _list_states(self, states: tuple[Any, ...], what: str) -> list[int]:
        if not states:
            raise ProblemError(f"{what} names no state{list_names(self._state_names())}")
        return [i for s in states for i in self._components(s, f"{what}:")]
