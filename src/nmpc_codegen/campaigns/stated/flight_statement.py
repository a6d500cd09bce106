"""A statement defines starts, parameters, references and disturbances of every flight as functions of its number."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.campaigns.stated.defaults import Facts, default_known, default_starts, default_steps, default_unknown
from nmpc_codegen.campaigns.stated.distributions import Box, Distribution, DrawnVariable, Kind, Points, variables
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.signals import members
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.batch.random import Normal
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.loops.loop_data import Drawn
from nmpc_codegen.runtime.loops.sampling import interval_of

Array = NDArray[Any]
Values = Mapping[str, Any]

MOST = 2**31 - 1
REAL = np.dtype(np.float64)


class Stated(TypedDict, total=False):
    """The arguments of campaign() state the flights; by default, or with None, they follow from the problem.

    Attributes:
        starts: Box or Normal for all states, an array (flights, nx), or {state: Box, Normal, number or (flights,)};
            states that are not named start at their initial values. By default every state starts in its
            ``initial_range``, else in a box around its initial value, which is a tenth as wide as the distance of its
            bounds, or as twice its scale.
        parameters: {name: Box, Normal, or a table as in Batch.simulate()} for the plants only; the controllers keep
            their values. By default the parameters of the model that have bounds, uniform between them.
        known: the same for controllers and plants. By default the parameters with bounds on which only costs and rows
            depend.
        references: {residual: Box, Normal or table}, or a table of the path residual, as in Batch.simulate().
        disturbance: Normal(std) or Uniform(half_width), added to the state after every sample; a bare number is a
            standard deviation.
        noise: the same, added to the state that the controllers receive.
        added: (steps, nx) or (flights, steps, nx), added to the state after every sample, besides ``disturbance``.
        steps: number of samples of a flight; by default three horizons, at least 50 and at most 1000.
        dt: sampling time, as in simulate().
        plant: a controller whose integrator advances the state; by default each controller's own.
        sets: 0: independent random points; else the number of independent sets of scrambled Sobol points, from which
            the interval is computed.
        seed: seed of all random numbers.
    """

    starts: Distribution | ArrayLike | Values | None
    parameters: Values | None
    known: Values | None
    references: ArrayLike | Values | None
    disturbance: Drawn | None
    noise: Drawn | None
    added: ArrayLike | None
    steps: int | None
    dt: float | None
    plant: Controller | None
    sets: int
    seed: int


class Wish(Stated, total=False):
    """A wish is the arguments of campaign() that define the flights, with the number of flights."""

    flights: int | None


#: The statement with all default values.
SILENT = cast("Wish", {**dict.fromkeys(Wish.__annotations__), "sets": 0, "seed": 0})


def plant_of(wish: Wish) -> Controller | None:
    """Return the plant; raise ControllerError if it is no Controller."""
    plant = wish["plant"]
    if plant is not None and not isinstance(plant, Controller):
        raise ControllerError(f"plant is {plant!r:.60}; expected a Controller, as build() returns it")
    return plant


@dataclass(frozen=True, eq=False)
class Given:
    """The data that are given for each flight; every array has a first axis of flights."""

    starts: Mapping[int, Array]  # index of a state -> (F,)
    tables: Mapping[Kind, Mapping[str, Array]]  # (F, n) or (F, n, size)
    added: Array | None  # (F, steps, nx)

    def part(self, some: slice) -> Given:
        """Return the data of a part of the flights."""
        tables: dict[Kind, Mapping[str, Array]] = {
            kind: {name: table[some] for name, table in of_kind.items()} for kind, of_kind in self.tables.items()
        }
        starts = {place: values[some] for place, values in self.starts.items()}
        return Given(starts, tables, None if self.added is None else self.added[some])


@dataclass(frozen=True, eq=False)
class FlightData:
    """The data of some flights are arguments of Batch.simulate(), and the flights' random variables (F, n)."""

    starts: Array
    tables: Mapping[Kind, Mapping[str, Array]]
    added: Array | None
    drawn: Array

    @property
    def references(self) -> Any:
        """Return the references by name, or the references of the whole path residual."""
        found = self.tables["reference"]
        return found.get("", found) if found else None


@dataclass(frozen=True, eq=False)
class FlightStatement:
    """Flight i depends only on this statement and on i; ``tables`` holds the tables that all flights share."""

    flights: int
    steps: int
    dt: float
    seed: int
    x0: Array
    variables: tuple[DrawnVariable, ...]
    points: Points
    tables: Mapping[Kind, Mapping[str, Array]]
    given: Given
    added: Array | None
    disturbance: Drawn | None
    noise: Drawn | None
    states: tuple[str, ...]

    @property
    def drawn(self) -> tuple[str, ...]:
        """Return the names of the random variables that are no initial states."""
        return tuple(v.label for v in self.variables if v.kind != "start")

    @property
    def common(self) -> FlightStatement:
        """Return the statement without the data that are given for each flight."""
        return replace(self, given=Given({}, {}, None))

    def given_for(self, first: int, count: int = 1) -> Given:
        """Return the data that are given for the flights from ``first`` on."""
        return self.given.part(slice(first, first + count))

    def whole_data(self, first: int, count: int = 1) -> FlightData:
        """Return the data of the flights from ``first`` on."""
        return self.data(first, count, self.given_for(first, count))

    def data(self, first: int, count: int, own: Given) -> FlightData:
        """Return the data of the flights from ``first`` on; ``own`` holds the data given for each of them."""
        unit = self.points.at(first, count)
        starts = np.tile(self.x0, (count, 1))
        for place, values in own.starts.items():
            starts[:, place] = values
        found: dict[Kind, dict[str, Array]] = {
            kind: {**self.tables.get(kind, {}), **own.tables.get(kind, {})} for kind in ("plant", "known", "reference")
        }
        drawn = []
        for variable, p in zip(self.variables, unit.T, strict=True):
            value = variable.quantile(p)
            if variable.kind == "start":
                starts[:, self.states.index(variable.name)] = value
            else:
                found[variable.kind][variable.name] = value[:, None]
                drawn.append(value)
        added = self.added if own.added is None else own.added
        whole = np.array(drawn).reshape(len(drawn), count).T
        return FlightData(starts, cast("Mapping[Kind, Mapping[str, Array]]", found), added, whole)


def state_flights(controller: Controller, facts: Facts, wish: Wish) -> FlightStatement:
    """Check the arguments of campaign() and complete them.

    Raises:
        ControllerError: a shape or a number is wrong, or there is no such state, parameter or residual.
    """
    described = controller.description
    dt = interval_of(described, wish["dt"])
    flights = _count("flights", _flights_of(wish["starts"]) if wish["flights"] is None else wish["flights"], 1, MOST)
    steps = _count("steps", default_steps(described, dt) if wish["steps"] is None else wish["steps"], 1, MOST)
    seed = _count("seed", wish["seed"], 0, 2**64 - 1)
    length = _length_of_set(flights, wish["sets"])
    plant = plant_of(wish)
    reader = _Reader(controller, plant, flights, steps)
    starts = default_starts(described, facts) if wish["starts"] is None else wish["starts"]
    reader.read_starts(starts)
    of_plant = described.names.parameters if plant is None else plant.names.parameters
    unknown, told = _parameters_of(described, of_plant, facts, wish)
    reader.read("plant", unknown, "parameters", of_plant)
    reader.read("known", told, "known", described.names.parameters)
    if wish["references"] is not None:
        known = list(dict.fromkeys((*described.names.y, *described.names.y_N)))
        named = wish["references"] if isinstance(wish["references"], Mapping) else {"": wish["references"]}
        reader.read("reference", named, "references", known)
    every, own = reader.split_added(wish["added"], steps)
    return FlightStatement(
        *(flights, steps, dt, seed, reader.x0, tuple(reader.variables)),
        Points(seed, len(reader.variables), wish["sets"], length),
        reader.tables,
        Given(reader.starts, reader.each, own),
        every,
        wish["disturbance"],
        wish["noise"],
        described.names.states,
    )


def _parameters_of(
    described: PackageDescription, of_plant: Sequence[str], facts: Facts, wish: Wish
) -> tuple[Values, Values]:
    """Return the parameters of the plants, and those that controllers know as well.

    A parameter that occurs in both has the first value in the plants.
    """
    for what in ("parameters", "known"):
        value = dict(wish)[what]
        if value is not None and not isinstance(value, Mapping):
            raise ControllerError(f"{what} is {value!r:.60}; expected {{name of a parameter: Box, Normal or table}}")
    names = described.names.parameters

    def free(default: Values, other: Values | None) -> Values:
        taken = {i for name in (other or {}) for i in members(name, names)}
        return {name: value for name, value in default.items() if names.index(name) not in taken}

    unknown = wish["parameters"]
    if unknown is None:
        unknown = free(default_unknown(described, facts), wish["known"])
        unknown = {name: value for name, value in unknown.items() if name in of_plant}
    told = free(default_known(described, facts), wish["parameters"]) if wish["known"] is None else wish["known"]
    return unknown, told


def _count(what: str, value: object, least: int, most: int) -> int:
    if not given.is_integer(value) or not least <= cast("int", value) <= most:
        raise ControllerError(f"{what} is {value!r}; expected an integer between {least} and {most}")
    return int(cast("int", value))


def _flights_of(starts: Any) -> int:
    """Return the default number of flights: the length of an array of starts, else 1000."""
    return len(starts) if not isinstance(starts, Box | Normal) and given.ndim(starts) == 2 else 1000


def _length_of_set(flights: int, sets: int) -> int:
    """Return the number of flights in a set of quasi-random points."""
    if not given.is_integer(sets) or sets < 0 or sets == 1 or (sets and flights % sets):
        raise ControllerError(
            f"sets is {sets!r}; expected 0, independent draws, or a number of sets of equal length of Sobol sequences, "
            f"at least 2, that divides the {flights} flights; a length of a power of 2 serves best"
        )
    return flights // sets if sets else 0


class _Reader:
    """A reader sorts the named values into random variables, tables for all flights, and tables for each flight."""

    def __init__(self, controller: Controller, plant: Controller | None, flights: int, steps: int) -> None:
        self._controller, self._plant, self._flights, self._steps = controller, plant, flights, steps
        self.x0 = np.array(controller.description.x_initial, dtype=float)
        self.variables: list[DrawnVariable] = []
        self.tables: dict[Kind, dict[str, Array]] = {}
        self.each: dict[Kind, dict[str, Array]] = {}
        self.starts: dict[int, Array] = {}
        self._taken: set[tuple[str, str]] = set()

    def read_starts(self, starts: Any) -> None:
        """Read initial states: a distribution for all, an array (F, nx), or values by name."""
        names = list(self._controller.names.states)
        described = self._controller.description
        if isinstance(starts, Box | Normal):
            self.variables += variables("start", names, starts, described.x_initial, "starts")
        elif isinstance(starts, Mapping):
            for name, value in starts.items():
                self._read_start(name, value, names)
        else:
            every = given.checked_array(starts, "starts", REAL, (self._flights, len(names)))
            self.starts = dict(enumerate(every.T))

    def _read_start(self, name: str, value: Any, names: list[str]) -> None:
        places = self._places("starts", name, names)
        what = f"starts: {name!r}"
        if isinstance(value, Box | Normal):
            middle = self._controller.description.x_initial[places]
            self.variables += variables("start", [names[i] for i in places], value, middle, what)
            return
        shape: tuple[int, ...] = np.shape(value) if given.ndim(value) >= 0 else ()
        per_flight = len(shape) > 0 and shape[0] == self._flights and len(shape) == (1 if len(places) == 1 else 2)
        rows = given.checked_array(value, what, REAL, shape if per_flight or not shape else (len(places),))
        for j, place in enumerate(places):
            if per_flight:
                self.starts[place] = rows[:, j] if rows.ndim == 2 else rows
            else:
                self.x0[place] = rows[j] if rows.ndim else rows

    def read(self, kind: Kind, values: Values, what: str, known: Sequence[str]) -> None:
        """Read parameters or references by name."""
        for name, value in values.items():
            elements = [known[i] for i in self._places(what, name, known)] if name else list(self._controller.names.y)
            for element in elements:
                if (kind, element) in self._taken:
                    raise ControllerError(f"{what}: {element!r} is given twice")
                self._taken.add((kind, element))
            if isinstance(value, Box | Normal):
                middle = self._declared_values(kind, elements)
                self.variables += variables(kind, elements, value, middle, f"{what}: {name!r}")
                self._check_range(kind, elements, what)
            else:
                self._read_table(kind, name, value, len(elements), what)

    def _read_table(self, kind: Kind, name: str, value: Any, size: int, what: str) -> None:
        array = given.checked_array(value, f"{what}: {name!r}", REAL, np.shape(value) if given.ndim(value) >= 0 else ())
        vector = size > 1 or not name
        axes: tuple[int, ...] = array.shape[:-1] if vector and array.ndim else array.shape
        if len(axes) == 2 and axes[0] == 1:  # one table for all flights
            array, axes = array[0], axes[1:]
        if vector and not array.ndim:
            array = np.full((1, size), array)
        if len(axes) == 1 and axes[0] == self._flights > 1 and axes[0] != self._steps:
            raise ControllerError(
                f"{what}: {name!r} has shape {array.shape}, a table over samples; expected a row for each of the "
                f"{self._steps} samples, or one value for each flight, ({self._flights}, 1{', ...' * vector})"
            )
        into = self.each if len(axes) == 2 and axes[0] not in (0, 1) else self.tables
        if into is self.each and array.shape[0] != self._flights:
            raise ControllerError(f"{what}: {name!r} has shape {array.shape}; expected {self._flights} flights first")
        into.setdefault(kind, {})[name] = array

    def _places(self, what: str, name: str, known: Sequence[str]) -> list[int]:
        found = members(name, known)
        if not found:
            raise ControllerError(f"{what}: there is no {name!r}; there is {', '.join(known) or 'none'}")
        return found

    def _description_of(self, kind: Kind) -> PackageDescription:
        """Return the description of the package that declares data of this kind: the plant's or the controller's."""
        return (self._plant if kind == "plant" and self._plant is not None else self._controller).description

    def _declared_values(self, kind: Kind, elements: list[str]) -> Array:
        """Return the declared values of parameters or references."""
        described = self._description_of(kind)
        if kind == "reference":
            values = {r.name: r.reference for r in (*described.residuals_N, *described.residuals)}
        else:
            values = {e: v for s in described.parameters for e, v in zip(s.elements, s.value, strict=True)}
        return np.array([values[element] for element in elements])

    def _check_range(self, kind: Kind, elements: list[str], what: str) -> None:
        """Raise ControllerError if a box exceeds the bounds of a parameter; normal variables are truncated to them."""
        ends = {
            e: (low, high)
            for s in self._description_of(kind).parameters
            for e, low, high in zip(s.elements, s.low, s.high, strict=False)
        }
        for i, v in enumerate(self.variables[-len(elements) :], len(self.variables) - len(elements)):
            low, high = ends.get(v.name, (-math.inf, math.inf)) if v.kind != "reference" else (-math.inf, math.inf)
            if v.normal:
                self.variables[i] = replace(v, low=low, high=high)
            elif v.begin < low or v.begin + v.size > high + 1e-12 * abs(high):
                raise ControllerError(
                    f"{what}: {v.name!r} between {v.begin:g} and {v.begin + v.size:g}; its bounds are {low:g}, {high:g}"
                )

    def split_added(self, added: ArrayLike | None, steps: int) -> tuple[Array | None, Array | None]:
        """Split the added states into those shared by all flights, and those of each flight."""
        if added is None:
            return None, None
        nx = self._controller.dims.nx
        shape = np.shape(added) if given.ndim(added) >= 0 else ()
        expected = (steps, nx) if len(shape) == 2 else (self._flights, steps, nx)
        array = given.checked_array(added, "added", REAL, expected)
        return (array, None) if array.ndim == 2 else (None, array)
