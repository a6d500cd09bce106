"""Data of a closed loop that are known over its samples: forecasts, tariffs, trajectories, limits.

An array has a row for each sample. At sample k a node of time t_j after it takes the row of the sample that is the last
one at or before that time, so that a forecast moves along by itself; the last row holds from there on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.signals import Kind, members
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.given import ndim, pair
from nmpc_codegen.runtime.loops.sampling import samples_ahead

Array = NDArray[Any]
Before = Callable[[int, Controller], Any]
OverSamples = Mapping[str, ArrayLike]
References = ArrayLike | OverSamples
Bounds = Mapping[str, tuple[ArrayLike, ArrayLike]]


def forecast(
    ctrl: Controller,
    interval: float,
    parameters: OverSamples | None,
    bounds: Bounds | None,
    references: References | None,
    before: Before | None,
) -> Before:
    """What sets the data of a sample, as a function (k, ctrl); it calls ``before`` after that.

    ``interval``: time between samples.

    Raises:
        ControllerError: a mapping is none, or an array has no row.
    """
    ahead = samples_ahead(ctrl.description, interval)
    found: list[Before] = []
    if parameters is not None:
        found.append(_of_parameters(ctrl, ahead, parameters))
    if bounds is not None:
        found.append(_of_bounds(ctrl, ahead, bounds))
    if references is not None:
        columns = _columns(ctrl, references)
        found.append(lambda k, c: c.set_reference(_at(k, ahead, c, "reference", columns)))
    twin = ctrl.copy() if found else ctrl
    for each in found:  # what is refused changes nothing
        each(0, twin)
    if before is not None and not callable(before):
        raise ControllerError(f"before is {before!r}; expected a function (k, ctrl)")
    found += [] if before is None else [before]

    def tell(k: int, c: Controller) -> None:
        for each in found:
            each(k, c)

    return tell


def _of_parameters(ctrl: Controller, ahead: Array, parameters: OverSamples) -> Before:
    """What sets the parameters of a sample."""
    tables = _tables("parameters", parameters)
    sizes = {signal.name: signal.size for signal in ctrl.description.parameters}
    for name, table in tables.items():
        _check_columns("parameters", name, table, sizes.get(name, 1))
    return lambda k, c: c.set_parameters(_at(k, ahead, c, "parameter", tables))


def _of_bounds(ctrl: Controller, ahead: Array, bounds: Bounds) -> Before:
    """What sets the bounds of a sample."""
    both = {name: pair(value, f"bounds of {name!r}") for name, value in _mapping("bounds", bounds).items()}
    for name, (low, high) in both.items():
        for side in (low, high):
            _check_columns("bounds", name, np.asarray(side), _count_rows(ctrl, name))
    lower, upper = (_tables("bounds", {name: value[i] for name, value in both.items()}) for i in (0, 1))
    return lambda k, c: c.set_bounds(_pairs(k, ahead, c, lower, upper))


def _columns(ctrl: Controller, references: References) -> dict[str, Array]:
    """Residual -> its values over the samples."""
    names = list(dict.fromkeys((*ctrl.names.y, *ctrl.names.y_N)))
    if not isinstance(references, Mapping):
        table = np.asarray(references)
        if table.ndim != 2 or table.shape[1] != ctrl.dims.ny or not len(table):
            raise ControllerError(
                f"references has shape {table.shape}; expected (n, {ctrl.dims.ny}), a row for each sample"
            )
        return dict(zip(ctrl.names.y, table.T, strict=True))
    found: dict[str, Array] = {}
    for name, table in _tables("references", references).items():
        elements = [names[i] for i in members(name, names)] or [name]
        _check_columns("references", name, table, len(elements))
        columns = [table] * len(elements) if table.ndim == 0 else table.reshape(len(table), -1).T
        found |= zip(elements, columns, strict=True)
    return found


def _count_rows(ctrl: Controller, name: str) -> int:
    """Rows of the user that a name means."""
    known = list(dict.fromkeys(row.user_name for row in ctrl.description.rows))
    return 1 if name in ctrl.names.rows else len(members(name, known))


def _check_columns(what: str, name: str, table: Array, size: int) -> None:
    """ControllerError unless it is a number, or has a row of so many numbers for each sample."""
    if table.ndim and table.shape[1:] not in ([(), (1,)] if size == 1 else [(size,)]):
        expected = "(n,)" if size == 1 else f"(n, {size})"
        raise ControllerError(
            f"{what}: {name!r} has shape {table.shape}; expected a number or {expected}, a row for each sample"
        )


def _mapping(what: str, given: Any) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise ControllerError(f"{what} is {type(given).__name__}; expected {{name: array over the samples}}")
    return given


def _tables(what: str, given: Mapping[str, Any]) -> dict[str, Array]:
    """Name -> a number, or an array with a row for each sample."""
    for name, value in _mapping(what, given).items():
        if ndim(value) < 0 or not np.size(value):
            raise ControllerError(f"{what}: {name!r} is no array with a row for each sample")
    return {name: np.asarray(value) for name, value in given.items()}


def _at(
    k: int, ahead: NDArray[np.int64], ctrl: Controller, kind: Kind, tables: Mapping[str, Array]
) -> dict[str, Array]:
    """The values of sample k: by node, or those of the sample itself where all nodes share one."""
    each = ctrl.description.online[kind] == "node"
    found = {}
    for name, table in tables.items():
        path = kind == "reference" and name not in ctrl.names.y_N
        nodes = ahead[:-1] if path else ahead
        last = len(table) - 1 if table.ndim else 0
        found[name] = table if not table.ndim else table[np.minimum(k + nodes, last)] if each else table[min(k, last)]
    return found


def _pairs(
    k: int, ahead: NDArray[np.int64], ctrl: Controller, lower: Mapping[str, Array], upper: Mapping[str, Array]
) -> dict[str, tuple[ArrayLike, ArrayLike]]:
    lows, highs = (_at(k, ahead, ctrl, "bounds", tables) for tables in (lower, upper))
    return {name: (lows[name], highs[name]) for name in lows}
