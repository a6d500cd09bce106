"""The window of an estimator is an optimal control problem with free x_0.

    min  1/2 |x_0 - xbar|^2_P^-1 + sum_{k<=N} 1/2 |a_k (h(x_k, u_{k-1}, p_k) - y_k)|^2 + sum_{k<N} 1/2 |w_k / std|^2

The states are those of the OCP and its unknown parameters; the controls of this problem are the noise w. The controls u
of the plant, the measurements y and their accuracy a, which is 0 for a missing one, are parameters of the nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.algebra.resolution import resolve
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.scales import scales
from nmpc_codegen.frontend.estimator.declaration import Estimator
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Array, Problem, Signal, Stage, c_identifier
from nmpc_codegen.frontend.statement import NOTHING, ResidualTerm
from nmpc_codegen.package.estimation import Estimation

#: Violation of a row, relative to its scale, that costs as much as an error of one standard deviation.
SOFTNESS = 0.01


def estimation_problem(estimator: Estimator) -> Problem:
    """Return the problem of an estimator; the OCP may be changed and the estimator built again.

    Raises:
        ProblemError: a part of the model is missing, or the estimator does not support it.
    """
    _refuse(estimator.ocp)
    model, h = _eliminate(estimator)
    window = _Window(estimator, model, h)
    window.state_dynamics()
    window.state_rows()
    window.state_ranges()
    window.state_costs()
    return window.problem()


def _refuse(ocp: OCP) -> None:
    """Raise ProblemError for what an estimator does not support."""
    missing = [d.signal.name for d in ocp.states if not _moves(ocp, d.signal)]
    if not ocp.states or missing:
        word = f"the dynamics of {', '.join(missing)} are" if missing else "a state is"
        raise ProblemError(f"estimator of '{ocp.name}': {word} missing")
    expressions = ca.vertcat(NOTHING, *ocp.derivatives.values(), *ocp.maps.values())
    if ca.depends_on(expressions, ocp.clock):
        raise ProblemError(f"estimator of '{ocp.name}': dynamics with ocp.time; expected a parameter in its place")
    if ocp.accumulators:
        raise ProblemError(f"estimator of '{ocp.name}': accumulator() resets a state, which no estimator can know")


def _moves(ocp: OCP, signal: Signal) -> bool:
    places = range(signal.offset, signal.offset + signal.size)
    return all(i in ocp.derivatives or i in ocp.maps or i in ocp.slopes for i in places)


def _eliminate(estimator: Estimator) -> tuple[OCP, Any]:
    """Return the model and the measurements without algebraic variables."""
    ocp, h = estimator.ocp, ca.vertcat(*(m.expression for m in estimator.measurements))
    if not (ocp.algebraics or ocp.equations):
        return ocp, h
    n = h.numel()
    twin = object.__new__(type(ocp))
    measured = ResidualTerm(h, ("",) * n, np.zeros(n), np.eye(n), False, "path")
    twin.__dict__ |= {**ocp.__dict__, "residuals": [measured], "costs": []}
    found = resolve(twin)
    assert found is not None
    if found.names:
        raise ProblemError(
            f"estimator of '{ocp.name}': {', '.join(found.names)} is found by Newton's method; expected equations "
            "that are linear in their algebraic variables, or a state in its place"
        )
    return found.ocp, found.ocp.residuals[0].y


@dataclass(frozen=True, eq=False)
class _Noise:
    """A control of the window stands for noise, with a symbol and a standard deviation."""

    symbol: Any
    std: float


class _Window:
    """A window collects the parts of its OCP while it is assembled."""

    def __init__(self, estimator: Estimator, model: OCP, h: Any) -> None:
        self.estimator, self.model, self.ocp = estimator, model, _grid(estimator)
        unknown = [d.signal for d in estimator.unknown]
        self.states = (*(d.signal for d in model.states), *unknown)
        self.sizes = [self._size(s) for s in self.states]
        self.known = {s.name: self._state(s, size) for s, size in zip(self.states, self.sizes, strict=True)}
        own = [d.signal for d in model.parameters if d.signal not in unknown]
        self.known |= {s.name: self._parameter(s) for s in own}
        self.own = sum(s.size for s in own)
        controls = [d.signal for d in model.controls]
        self.u = _stack(self._parameter(s) for s in controls)
        past = sorted(model.remembered)
        self.before = self.u
        reads = ca.vertcat(NOTHING, model.u, *(model.remembered[j] for j in past))
        moved = ca.vertcat(NOTHING, *model.derivatives.values(), *model.maps.values())
        self.has_before = bool(reads.numel()) and (
            ca.depends_on(h, reads) or bool(past and ca.depends_on(moved, ca.vertcat(*(model.remembered.values()))))
        )
        if self.has_before:
            self.before = _stack(self._parameter(s, f"{s.name}_before") for s in controls)
        measured = [m.signal for m in estimator.measurements]
        self.y = _stack(self._parameter(s, f"measured_{s.name}") for s in measured)
        self.std = np.concatenate([m.std for m in estimator.measurements])
        accuracy = [replace(m.signal, value=tuple(1.0 / m.std)) for m in estimator.measurements]
        self.accuracy = _stack(self._parameter(s, f"accuracy_{s.name}") for s in accuracy)
        self.noises: list[_Noise] = []
        self.row_names: dict[str, str] = {}
        self.at_end: list[tuple[int, int]] = []
        self.of_input = {n: self._channel(n, std) for n, std in estimator.input_std.items()}
        self.h = self._here(h, self.before)

    # Declarations ----------------------------------------------------------------------------------------------------

    def _size(self, signal: Signal) -> Array:
        """Return the sizes of a signal: the declared scale, else one that follows from other declarations.

        These are half the width of bounds, the initial value and its standard deviation, in this order.
        """
        bounds = {n: (s.lower[i], s.upper[i]) for s in self.model.statements for i, n in enumerate(s.names)}
        given = self.estimator.initial_std.get(signal.name, np.zeros(signal.size))
        found = []
        for i, element in enumerate(signal.elements):
            low, high = (signal.low[i], signal.high[i]) if signal.low else bounds.get(element, (-np.inf, np.inf))
            half = (high - low) / 2 if np.isfinite(high - low) else 0.0
            one = max((abs(v) for v in (low, high) if np.isfinite(v)), default=0.0)
            declared = signal.scale[i] if signal.scale else 0.0
            found.append(declared or max(half or one, abs(signal.value[i])) or float(given[i]) or 1.0)
        return np.array(found)

    def _state(self, s: Signal, scale: Array) -> Any:
        size = None if s.scalar else s.size
        return self.ocp.state(s.name, size=size, unit=s.unit, initial=list(s.value), scale=list(scale))

    def _parameter(self, s: Signal, name: str | None = None) -> Any:
        size, bounds = (None if s.scalar else s.size), (s.low, s.high) if s.low and name is None else None
        return self.ocp.parameter(name or s.name, value=list(s.value), size=size, unit=s.unit, bounds=bounds)

    def _noise(self, element: str, std: float) -> Any:
        """Add a control for noise and return its symbol; return 0 if there is no noise."""
        if not std:
            return ca.SX(0)
        symbol = self.ocp.control(f"noise_{c_identifier(element)}", scale=std)
        self.noises.append(_Noise(symbol, float(std)))
        return symbol

    def _channel(self, name: str, std: Array) -> Any:
        """Return the noise of the elements of a control or parameter."""
        signals = (d.signal for d in (*self.model.controls, *self.model.parameters))
        signal = next(s for s in signals if s.name == name)
        return _stack(self._noise(e, value) for e, value in zip(signal.elements, std, strict=True))

    # Expressions -----------------------------------------------------------------------------------------------------

    def _here(self, expression: Any, u: Any, disturbed: bool = False) -> Any:
        """Write an expression of the model in symbols of the window with the controls u.

        With noise if ``disturbed``.
        """
        old: list[Any] = [self.model.interval_before]
        new: list[Any] = [ca.SX(self.estimator.dt or 1.0)]
        for d in (*self.model.states, *self.model.parameters):
            old.append(d.symbol)
            noise = self.of_input.get(d.signal.name) if disturbed else None
            new.append(self.known[d.signal.name] if noise is None else self.known[d.signal.name] + noise)
        for d in self.model.controls:
            old.append(d.symbol)
            at = ca.vertcat(*(u[d.signal.offset + i] for i in range(d.signal.size)))
            new.append(at + self.of_input[d.signal.name] if disturbed and d.signal.name in self.of_input else at)
        for j, symbol in self.model.remembered.items():
            old.append(symbol)
            new.append(self.before[j])
        return ca.densify(ca.substitute(expression, ca.vertcat(*old), ca.vertcat(*new)))

    def state_dynamics(self) -> None:
        """Add the maps or derivatives of the states, with noise.

        Unknown parameters are constant except for their noise.
        """
        discrete = bool(self.model.discrete)
        stated = {**self.model.derivatives, **self.model.maps}
        for s, std in ((s, self.estimator.process_std.get(s.name, np.zeros(s.size))) for s in self.states):
            for e, element in enumerate(s.elements):
                i = self._place(s) + e
                known, symbol = s.offset + e if self._place(s) == s.offset else -1, self.known[s.name][e]
                moved = self._here(stated[known], self.u, True) if known in stated and s in self._own else None
                w, is_map = self._noise(element, std[e]), discrete or (moved is not None and known in self.model.maps)
                value = (symbol if discrete else ca.SX(0)) if moved is None else moved
                if not is_map and std[e]:
                    self.at_end.append((i, len(self.noises) - 1))
                target = self.ocp.maps if is_map and not discrete else self.ocp.derivatives
                target[i] = ca.densify(value + w) if is_map else value
        self.ocp._discrete = discrete

    @property
    def _own(self) -> Sequence[Signal]:
        """Return the states of the model."""
        return self.states[: len(self.model.states)]

    def _place(self, s: Signal) -> int:
        """Return the index of the first element of a state or unknown parameter among all states of the window."""
        return sum(t.size for t in self.states[: self.states.index(s)])

    def state_rows(self) -> None:
        """Add the rows that the estimator shares with the OCP as soft rows, with penalties from their scales.

        Raises:
            ProblemError: a named row contains a quantity that is unknown at the present sample.
        """
        wanted = self.estimator.rows
        known = ca.vertcat(*(d.symbol for d in (*self.model.states, *self.model.parameters)))
        states = self.model.x
        for s in self.model.statements:
            for i, name in enumerate(s.names):
                free = ca.vertcat(NOTHING, *ca.symvar(s.expression[i]))
                later = [str(v) for v in ca.vertsplit(free) if not ca.depends_on(known, v)] if free.numel() else []
                chosen = name in wanted if isinstance(wanted, tuple) else wanted and s.at == "path" and s.soft is None
                if isinstance(wanted, tuple) and chosen and later:
                    raise ProblemError(
                        f"estimator: the row '{name}' contains {', '.join(later)}; expected states alone"
                    )
                if chosen and not later and ca.depends_on(s.expression[i], states):
                    identifier, h = c_identifier(name), self._here(s.expression[i], self.u)
                    self.row_names[identifier] = name
                    self.ocp.subject_to(s.lower[i], h, s.upper[i], soft=(0.0, 1.0), name=identifier)

    def state_ranges(self) -> None:
        """State the declared bounds of unknown parameters as rows, which the estimates never violate."""
        for s in (d.signal for d in self.estimator.unknown if d.signal.low):
            for i, name in enumerate(s.elements):
                identifier = c_identifier(name)
                self.row_names[identifier] = name
                x = self.known[s.name][i]
                self.ocp.subject_to(s.low[i], x, s.high[i], soft=(0.0, 1.0), name=identifier)

    def state_costs(self) -> None:
        """State the costs: measurements at all nodes, noise on the intervals, and the arrival cost."""
        for m in self.estimator.measurements:
            at = range(m.signal.offset, m.signal.offset + m.signal.size)
            y = ca.vertcat(*(self.accuracy[i] * (self.h[i] - self.y[i]) for i in at))
            self.ocp.least_squares(y, weight=1.0, names=list(m.signal.elements))
            self.ocp.terminal_least_squares(y, weight=1.0, names=list(m.signal.elements))
        for noise in self.noises:
            self.ocp.least_squares(noise.symbol, weight=noise.std**-2)
        x = self.ocp.x
        value = [v for s in self.states for v in s.value]
        names = [f"initial_{c_identifier(e)}" for s in self.states for e in s.elements]
        self.ocp.start_least_squares(x, weight=self.initial_std**-2, reference=value, names=names)
        self.ocp.free_initial(x)

    @property
    def initial_std(self) -> Array:
        """Return the standard deviations of the initial values; by default that of a state is its size."""
        given = self.estimator.initial_std
        return np.concatenate([given.get(s.name, size) for s, size in zip(self.states, self.sizes, strict=True)])

    # The problem -----------------------------------------------------------------------------------------------------

    def problem(self) -> Problem:
        """Return the problem of the window, or of the filter, which has one interval and no cost."""
        found = classify(self.ocp)
        found = replace(found, noise=tuple(self.at_end), start=replace(found.start, dense_weight=True))
        found = _with_penalties(found, self.row_names)
        if self.estimator.kind == "ekf":
            found = _without_costs(found)
        x, p = found.terminal.x, found.terminal.p
        h = ca.substitute(self.h, ca.vertcat(self.ocp.x, self.ocp.p), ca.vertcat(x, p))
        observed = ca.Function("h", [x, p], [ca.densify(h)])
        return replace(found, observed=observed, estimation=self._estimation(found), uses=found.uses | {"measurements"})

    def _estimation(self, problem: Problem) -> Estimation:
        e = self.estimator
        return Estimation(
            kind=e.kind,
            measured=tuple(m.signal for m in e.measurements),
            inputs=tuple(d.signal for d in self.model.controls),
            noise_std=tuple(map(float, self.std)),
            process_std=tuple(n.std for n in self.noises) or (0.0,) * problem.nu,
            initial_std=tuple(map(float, self.initial_std)),
            thresholds=tuple(m.threshold for m in e.measurements for _ in m.signal.elements),
            states=tuple(self._state_of(m.expression[i]) for m in e.measurements for i in range(m.signal.size)),
            unknown=tuple(d.signal.name for d in e.unknown),
            own=self.own,
            before=self.has_before,
        )

    def _state_of(self, expression: Any) -> str:
        """Return the name of the state that an expression is, "" for other expressions."""
        element = self.estimator.ocp.element(expression)
        return element.name if element is not None and element.kind == "state" else ""


def _grid(e: Estimator) -> OCP:
    """Return an OCP with the intervals of the window."""
    if e.dt is None:
        return OCP(e.name, N=e.N)
    return OCP(e.name, intervals=[e.dt] * e.N, time_unit=e.ocp.time_unit)


def _stack(columns: Iterable[Any]) -> Any:
    return ca.vertcat(NOTHING, *columns)


def _with_penalties(problem: Problem, names: dict[str, str]) -> Problem:
    """Return the problem with quadratic penalties of its rows, under the names that they have in the OCP.

    A violation of SOFTNESS, relative to the scale of a row, counts as one standard deviation.
    """
    penalties = (SOFTNESS * scales(problem).rows) ** -2
    rows = (
        replace(row, soft=(0.0, float(l2)), name=names[row.name])
        for row, l2 in zip(problem.rows, penalties, strict=True)
    )
    return replace(problem, rows=tuple(rows))


def _without_costs(problem: Problem) -> Problem:
    """Return the problem of a filter, with bounds of states and without cost."""

    def bare(stage: Stage) -> Stage:
        stage = replace(stage, y=NOTHING, y_names=(), reference=np.zeros(0), weight=np.zeros((0, 0)), y_scale=())
        return replace(stage, h=NOTHING, h_names=(), scale_with_dt=(), bare=None, ties=None)

    rows = tuple(row for row in problem.rows if row.kind == "state")
    start, path, terminal = (bare(stage) for stage in (problem.start, problem.path, problem.terminal))
    return replace(problem, rows=rows, start=start, path=path, terminal=terminal)
