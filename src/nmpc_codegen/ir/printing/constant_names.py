"""Constants in printed kernels are named after the user's signals, their stages, and functions of them.

x[2] -> phi,   yref[2] -> phi_ref,   stage 3 of step 1 -> phi_13, its slope -> phi_dot_13,   cos(phi) -> cos_phi
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

#: Buffer -> text before the name of a signal, kind of the signals, text after it.
_OF_SIGNALS = {
    **dict.fromkeys(("x", "X", "Xi", "Xs"), ("", "states", "")),
    "x_next": ("", "states", "_next"),
    "u": ("", "controls", ""),
    "p": ("", "parameters", ""),
    "yref": ("", "residuals", "_ref"),
    "W": ("W_", "residuals", ""),
    "lam": ("lam_", "states", ""),
    "adj": ("adj_", "states", ""),
    "dx": ("d_", "states", ""),
    "du": ("d_", "controls", ""),
    **dict.fromkeys(("x_0", "first"), ("", "states", "_0")),
    **dict.fromkeys(("x_N", "last"), ("", "states", "_N")),
}
#: The buffer with the slopes of all stages, one after the other.
_SLOPES = "K"
#: Largest length of a name that is derived from another one.
_LONGEST = 24


@dataclass(frozen=True)
class LocalNames:
    """The user's signals are identifiers of C, element by element; constants must not have names in ``reserved``."""

    states: tuple[str, ...] = ()
    controls: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    residuals: tuple[str, ...] = ()
    residuals_N: tuple[str, ...] = ()
    reserved: frozenset[str] = frozenset()
    algebraic: tuple[str, ...] = ()  # after the states of a stage, and after the parameters with their slopes

    def signal(self, kernel: str, buffer: str, element: int, size: int) -> str:
        """Return the name for an element of a buffer of ``size`` elements in a kernel; "" if it is no signal."""
        before, kind, behind = _OF_SIGNALS.get(buffer, ("", "", ""))
        if kind == "residuals" and not kernel.startswith("path"):
            kind = "residuals_N" if kernel.startswith("terminal") else ""
        names = getattr(self, kind) if kind else ()
        if kind in ("states", "parameters") and len(names) < size:
            names = (*names, *self.algebraic)
        if kind == "parameters" and len(names) < size:
            names = (*names, *(f"W_{name}_{i}" for name in self.algebraic for i in range(len(self.algebraic))))
        return f"{before}{names[element]}{behind}" if len(names) == size else ""

    def variable(self, element: int) -> str:
        """Return the name of a component of (x, u)."""
        names = (*self.states, *self.controls)
        return names[element] if element < len(names) else ""

    def value(self, buffer: str, element: int, mark: str) -> str:
        """Return the name for a value of a stage; "" if the value has no name."""
        n = len(self.states)
        if not (mark and n):
            return ""
        if buffer in ("X", "Xi", "Xs") and element < n:
            return f"{self.states[element]}_{mark}"
        return f"{self.states[element]}_dot_{mark}" if buffer == _SLOPES and element < n else ""


#: No signals: constants are named after ports.
NO_NAMES = LocalNames()


class Taken:
    """The names that are in use in a function."""

    def __init__(self, names: LocalNames, others: Iterable[str] = ()) -> None:
        self._reserved: Collection[str] = names.reserved
        self._taken = set(others)
        self._number = 0

    def of(self, wish: str, otherwise: str) -> str:
        """Return the wanted name, with _ appended if it is in use, or else the other name."""
        for name in (wish, f"{wish}_") if wish else ():
            if name not in self._reserved and name not in self._taken:
                self._taken.add(name)
                return name
        while otherwise in self._taken or otherwise in self._reserved:
            otherwise += "_"
        self._taken.add(otherwise)
        return otherwise

    def next(self, wish: str = "") -> str:
        """Return the wanted name if it is short and free, else t1, t2, ..."""
        if wish and len(wish) <= _LONGEST and wish not in self._taken and wish not in self._reserved:
            self._taken.add(wish)
            return wish
        self._number += 1
        return self.of("", f"t{self._number}")
