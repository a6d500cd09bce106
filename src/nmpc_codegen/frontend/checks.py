"""User input is converted to checked values: names, numbers, CasADi columns; every failure raises ProblemError."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.ir.lookup_calls import called_lookup
from nmpc_codegen.ir.naming import C_KEYWORDS
from nmpc_codegen.package.signals import Soft
from nmpc_codegen.runtime.given import checked_weight

#: Mark of a linearly interpolated table in a set of operations; no expression contains this operation itself.
KINKS = ca.OP_HORZREPMAT

#: Operations of a CasADi SX Function that have a C spelling, and the mark of linearly interpolated tables.
C_OPERATIONS = (frozenset(OPERATIONS) | {ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, KINKS}) - {ca.OP_CALL}

#: Operations whose derivative vanishes or is discontinuous somewhere.
NONSMOOTH = {
    getattr(ca, f"OP_{name}"): word
    for name, word in {
        "LT": "<", "LE": "<=", "EQ": "==", "NE": "!=", "NOT": "not", "AND": "and", "OR": "or", "FLOOR": "floor",
        "CEIL": "ceil", "FMOD": "fmod", "REMAINDER": "remainder", "FABS": "fabs", "SIGN": "sign",
        "COPYSIGN": "copysign", "IF_ELSE_ZERO": "if_else", "FMIN": "fmin", "FMAX": "fmax",
    }.items()
} | {KINKS: 'lookup_table(kind="linear")'}  # fmt: skip

#: Maximum number of elements of one signal: for a state of that size, df/dx takes 128 MB at every node.
MAX_SIZE = 4_000

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def quote(value: Any) -> str:
    """Return a short text of a value for an error message."""
    try:
        text = " ".join(str(value).split())
    except Exception:  # a foreign object may fail in any way when it is printed
        text = f"<{type(value).__name__}>"
    return f"'{text}'" if len(text) <= 60 else f"'{text[:57]}...'"


def identifier(name: Any, what: str) -> str:
    """Return ``name`` if it is an identifier of C and C++ that is not reserved, else raise ProblemError."""
    if not isinstance(name, str):
        raise ProblemError(f"{what}: name must be a string, got {type(name).__name__} {quote(name)}")
    if not _IDENTIFIER.fullmatch(name):
        raise ProblemError(
            f"{what}: name {quote(name)} is no C identifier (a letter, then letters, digits and underscores)"
        )
    if name in C_KEYWORDS:
        raise ProblemError(f"{what}: name '{name}' is a keyword of C or C++; choose another one, e.g. '{name}_'")
    return name


def unit_text(unit: Any, what: str) -> str:
    """Return a unit, a printable text in one line, which may stand in comments of C and in tables."""
    if not isinstance(unit, str):
        raise ProblemError(f"{what} must be a string, got {type(unit).__name__} {quote(unit)}")
    if not unit.isprintable() or "*/" in unit or "|" in unit:
        raise ProblemError(f"{what} must be printable text in one line without */ and |, got {quote(unit)}")
    return unit


def duplicate(names: Iterable[str]) -> tuple[str, str] | None:
    """Return the first two equal names, or None."""
    seen: dict[str, str] = {}
    for name in names:
        if name in seen:
            return seen[name], name
        seen[name] = name
    return None


def integer(value: Any, what: str, minimum: int, maximum: int | None = None) -> int:
    """Return ``value`` as an integer between ``minimum`` and ``maximum``, else raise ProblemError."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise ProblemError(f"{what} must be an integer >= {minimum}, got {type(value).__name__} {quote(value)}")
    if value < minimum:
        raise ProblemError(f"{what} must be an integer >= {minimum}, got {value}")
    if maximum is not None and value > maximum:
        raise ProblemError(f"{what} must be an integer <= {maximum}, got {quote(value)}")
    return int(value)


def block_lengths(value: Any, intervals: int, what: str) -> tuple[int, ...]:
    """Return positive integers whose sum is the number of intervals, else raise ProblemError."""
    if not isinstance(value, (list, tuple, np.ndarray)) or not len(value):
        raise ProblemError(f"{what} must be a list of lengths of blocks, got {quote(value)}")
    found = tuple(integer(v, f"{what}: length", 1) for v in value)
    if sum(found) != intervals:
        raise ProblemError(f"{what}: the lengths sum up to {sum(found)}, expected {intervals}, the number of intervals")
    return found


def flag(value: Any, what: str) -> bool:
    """Return ``value`` if it is True or False, else raise ProblemError."""
    if not isinstance(value, (bool, np.bool_)):
        raise ProblemError(f"{what} must be True or False, got {type(value).__name__} {quote(value)}")
    return bool(value)


def numbers(value: Any, what: str) -> Array:
    """Return a float array of any shape; a CasADi DM becomes dense, infinities are allowed, NaN raises ProblemError."""
    if isinstance(value, (ca.SX, ca.MX)):
        if isinstance(value, ca.MX) or not value.is_constant():
            raise ProblemError(f"{what} must be numbers, got the expression {quote(value)}")
        value = ca.DM(value)
    if isinstance(value, ca.DM):
        value = value.full()
    try:
        if np.asarray(value).dtype.kind not in "biufO":
            raise TypeError
        array = np.array(value, dtype=float)
    except Exception as error:  # foreign objects may raise anything here
        raise ProblemError(f"{what} must be numbers, got {type(value).__name__} {quote(value)}") from error
    if np.isnan(array).any():
        raise ProblemError(f"{what} must be numbers, got NaN in {quote(value)}")
    return array


def vector(value: Any, size: int, what: str, *, finite: bool = True) -> Array:
    """Return an array of shape (size,); a scalar is repeated."""
    array = numbers(value, what)
    if array.ndim == 0 or array.shape == (1, 1):
        array = np.full(size, array.item())
    elif array.shape == (size, 1):
        array = array[:, 0]
    if array.shape != (size,):
        expected = "a scalar" if size == 1 else f"a scalar or {size} values"
        raise ProblemError(f"{what} has shape {array.shape}, expected {expected}")
    if finite and not np.isfinite(array).all():
        raise ProblemError(f"{what} must be finite, got {quote(value)}")
    return array


def declared_scale(value: Any, size: int, what: str) -> tuple[float, ...]:
    """Return the scales of the elements of a signal or residual, finite and positive; () for None."""
    if value is None:
        return ()
    found = tuple(float(v) for v in vector(value, size, what))
    if not all(v > 0.0 for v in found):
        raise ProblemError(f"{what} must be positive, got {quote(value)}")
    return found


def declared_range(value: Any, within: tuple[float, ...], what: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return (lower, upper) of every element of a signal, which contain its values ``within``.

    Two empty ones for None.
    """
    if value is None:
        return (), ()
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ProblemError(f"{what} must be (lower, upper), got {quote(value)}")
    low, high = (tuple(float(v) for v in vector(side, len(within), what, finite=False)) for side in value)
    for a, v, b in zip(low, within, high, strict=True):
        if not a <= v <= b:
            raise ProblemError(f"{what}: the declared value {v:g} is not between {a:g} and {b:g}")
    return low, high


def weight_matrix(value: Any, size: int, what: str) -> Array:
    """Return a matrix (size, size), symmetric positive semidefinite up to rounding; a vector is its diagonal."""
    array = numbers(value, what)
    if array.shape != (size, size):
        try:
            array = np.diag(vector(array, size, what))
        except ProblemError as error:
            if np.isfinite(array).all():
                raise ProblemError(
                    f"{what} has shape {array.shape}, expected ({size}, {size}), or {size} diagonal values, or a scalar"
                ) from error
            raise
    if not np.isfinite(array).all():
        raise ProblemError(f"{what} must be finite, got {quote(value)}")
    return checked_weight(array, what, ProblemError)


def column(value: Any, what: str, symbols: dict[str, Any]) -> Any:
    """Return a dense SX column from an SX, DM, number, array, list of these, or MX expression.

    The symbols of an MX expression are replaced by the declared signals of the same name and size (``symbols``).
    """
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = list(value) if value.ndim == 1 else value
    if isinstance(value, (list, tuple)):
        if any(isinstance(item, (list, tuple)) for item in value):
            raise ProblemError(f"{what} must be a scalar or a column, got nested lists {quote(value)}")
        return ca.vertcat(ca.SX(0, 1), *(column(item, what, symbols) for item in value))
    if isinstance(value, ca.MX):
        value = _expand(value, what, symbols)
    if not isinstance(value, ca.SX):
        array = numbers(value, f"{what}: value")
        if array.ndim > 2:
            raise ProblemError(f"{what} has shape {array.shape}, expected a scalar or a column")
        value = ca.SX(ca.DM(array))
    if value.shape[1] != 1:
        hint = " (transpose it)" if value.shape[0] == 1 else ""
        raise ProblemError(f"{what} has shape {value.shape}, expected a scalar or a column{hint}")
    return ca.densify(value)


def _expand(value: Any, what: str, symbols: dict[str, Any]) -> Any:
    """Return the SX form of an MX expression."""
    free = ca.symvar(value)
    for s in free:
        if s.name() not in symbols:
            raise ProblemError(f"{what} contains the unknown symbol '{s.name()}'{list_names(symbols)}")
        if s.shape != symbols[s.name()].shape:
            raise ProblemError(
                f"{what}: the MX symbol '{s.name()}' has shape {s.shape}, declared was {symbols[s.name()].shape}"
            )
    try:
        return ca.Function("expression", free, [value]).expand()(*(symbols[s.name()] for s in free))
    except Exception as error:  # CasADi raises RuntimeError, NotImplementedError or worse, depending on the node
        raise ProblemError(
            f"{what} = {quote(value)} cannot be expanded to scalar operations, so it has no C equivalent; "
            "write it with SX"
        ) from error


def list_names(names: Iterable[str]) -> str:
    """Return the end of an error message: a list of the declared names."""
    listed = ", ".join(names)
    return f"; declared are: {listed}" if listed else "; nothing is declared yet"


def operations(expression: Any) -> set[int]:
    """Return the CasADi opcodes of an SX expression.

    OP_LOW marks a constant that is not finite, OP_CALL a function that is no look-up table, KINKS a table with linear
    interpolation.
    """
    f = ca.Function("expression", ca.symvar(expression), [expression])
    found: set[int] = set()
    constants: dict[int, float] = {}
    for i in range(f.n_instructions()):
        op = f.instruction_id(i)
        if op == ca.OP_CALL:
            found |= _mark_call(f.instruction_input(i), constants)
            continue
        found.add(op)
        if op == ca.OP_CONST:
            constants[f.instruction_output(i)[0]] = f.instruction_constant(i)
            if not np.isfinite(f.instruction_constant(i)):
                found.add(ca.OP_LOW)
    return found


def _mark_call(inputs: list[int], constants: dict[int, float]) -> set[int]:
    """Return the opcodes that mark a call with these inputs: none if it reads a smooth look-up table."""
    try:
        table = called_lookup(constants.get(inputs[0]) if inputs else None, len(inputs))
    except KeyError:
        return {ca.OP_CALL}
    return {KINKS} if table is not None and table.kinks else set()


def check_operations(expression: Any, what: str) -> set[int]:
    """Return the opcodes; raise ProblemError unless every operation has a C spelling and every constant is finite."""
    found = operations(expression)
    if ca.OP_LOW in found:
        raise ProblemError(f"{what} = {quote(expression)} contains a constant that is not finite (inf or nan)")
    foreign = found - C_OPERATIONS
    if foreign:
        word = "a function call (interpolant, callback, external)" if ca.OP_CALL in foreign else "an operation"
        advice = "; a look-up table is lookup_table(x, grid, values)" if ca.OP_CALL in foreign else ""
        raise ProblemError(
            f"{what} = {quote(expression)} contains {word} that has no C equivalent; use SX operations{advice}"
        )
    return found


def checked_soft(soft: Any, what: str) -> Soft:
    """Return the penalties (l1, l2) of both sides of a row, None for a hard side."""
    if not isinstance(soft, Soft):
        both = None if soft is None else _penalty(soft, f"{what}: soft")
        return Soft(both, both)
    lower, upper = (
        None if side is None else _penalty(side, f"{what}: soft {word}")
        for word, side in (("lower", soft.lower), ("upper", soft.upper))
    )
    if lower is None and upper is None:
        raise ProblemError(f"{what}: soft=Soft() names no side; expected lower=(l1, l2), upper=(l1, l2) or both")
    return Soft(lower, upper, flag(soft.scale_with_dt, f"{what}: soft: scale_with_dt"))


def _penalty(value: Any, what: str) -> tuple[float, float]:
    """Return (l1, l2); l1 may be infinite."""
    pair = (value, 0.0) if isinstance(value, (int, float)) and not isinstance(value, bool) else value
    if not isinstance(pair, (tuple, list, np.ndarray)) or len(pair) != 2:
        raise ProblemError(f"{what} must be None, (l1, l2) or Soft(lower=(l1, l2), upper=(l1, l2)), got {quote(value)}")
    l1, l2 = (float(v) for v in vector(pair, 2, what, finite=False))
    if l1 < 0 or l2 < 0 or l1 + l2 == 0 or l2 == np.inf:
        raise ProblemError(
            f"{what}=(l1, l2) must be nonnegative and not both zero, and l2 finite, got ({l1:g}, {l2:g})"
        )
    return l1, l2


_ELEMENT = re.compile(r"([^\[\]]*)(\[[0-9]+\])?")


def element_names(names: Any, size: int, what: str) -> list[str]:
    """Return one name per element; a single string names several elements name[i]."""
    if isinstance(names, str):
        names = [names] if size == 1 else [f"{names}[{i}]" for i in range(size)]
    if not isinstance(names, (list, tuple)) or len(names) != size:
        raise ProblemError(f"{what} must be {size} strings, got {quote(names)}")
    for name in names:
        match = _ELEMENT.fullmatch(name) if isinstance(name, str) else None
        identifier(match.group(1) if match else name, what)
    return list(names)
