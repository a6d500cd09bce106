"""What the names of a translation unit mean, and what of it the text of a function depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from nmpc_codegen.bounds.c_source import MATH, CFunction, CMacro, Type

INT = Type("int")


@dataclass(frozen=True)
class Callee:
    """What is called: the type of its value, and for functions of the unit those of its parameters.

    A macro has its text, a function of the C library its operations.
    """

    kind: Literal["counted", "function", "macro", "library", "unknown"]
    result: Type = INT
    parameters: tuple[Type, ...] = ()
    macro: CMacro | None = None
    operations: int = 0


@dataclass(frozen=True)
class Unit:
    """What is known about a translation unit.

    ``counts``: functions whose operations are known; ``sizes``: integer constants; ``tables``: entries of constant
    integer tables; ``ranges``: values that integer members can have; ``members``: types of the members of all structs.
    """

    functions: Mapping[str, CFunction]
    macros: Mapping[str, CMacro]
    counts: Mapping[str, int]
    sizes: Mapping[str, int]
    tables: Mapping[str, Sequence[int]]
    ranges: Mapping[str, tuple[int, int]]
    members: Mapping[str, Sequence[Type]]

    @cached_property
    def counting(self) -> frozenset[str]:
        """Functions whose calls limit the passes of loops."""
        return frozenset(name for function in self.functions.values() for name in function.counting)

    def reached(self, function: str) -> list[CFunction]:
        """The functions of unknown operations that a function may call, itself included."""
        known = {*self.functions, *self.macros} - set(self.counts)
        found: set[str] = set()
        names = {function}
        while names:
            found |= names
            texts = (self.functions[n].words if n in self.functions else self.macros[n].words for n in names)
            names = known & frozenset[str]().union(*texts) - found
        return [self.functions[name] for name in sorted(found) if name in self.functions]

    def member(self, name: str) -> Type:
        """Type of a member; "real" if members of several structs share the name."""
        known = self.members.get(name, ())
        return next((t for t in known if t.base == "real"), known[0] if known else INT)

    def constant(self, name: str) -> Type:
        """Type of a name that is no variable."""
        macro = self.macros.get(name)
        real = macro is not None and ("real_t" in macro.text or name.startswith("TOL_"))
        return Type("real") if real else INT

    def callee(self, name: str) -> Callee:
        """What a call of this name calls; SQRT is another name of sqrt or sqrtf."""
        macro = self.macros.get(name)
        name = name if macro is None or macro.parameters else macro.text
        if name in self.counts:
            return Callee("counted", Type("void"))
        if name in self.functions:
            function = self.functions[name]
            return Callee("function", function.result, tuple(t for _, t in function.parameters))
        if name in self.macros:
            return Callee("macro", macro=self.macros[name])
        word = name if name in MATH else name.removesuffix("f").removeprefix("own_")
        if word not in MATH:
            return Callee("unknown")
        return Callee("library", Type("real" if MATH[word] else "int"), operations=MATH[word])


class Names:
    """The names of a unit, with a record of all that was asked about them."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self.members: dict[str, Type] = {}
        self.constants: dict[str, Type] = {}
        self.callees: dict[str, Callee] = {}

    def member(self, name: str) -> Type:
        """See Unit.member()."""
        if name not in self.members:
            self.members[name] = self._unit.member(name)
        return self.members[name]

    def constant(self, name: str) -> Type:
        """See Unit.constant()."""
        if name not in self.constants:
            self.constants[name] = self._unit.constant(name)
        return self.constants[name]

    def callee(self, name: str) -> Callee:
        """See Unit.callee()."""
        if name not in self.callees:
            self.callees[name] = self._unit.callee(name)
        return self.callees[name]

    def another(self) -> Names:
        """The names of the same unit with an empty record."""
        return Names(self._unit)

    def same_in(self, other: Names) -> bool:
        """Whether the names mean the same in the unit of ``other``."""
        return (
            all(other.member(name) == known for name, known in self.members.items())
            and all(other.constant(name) == known for name, known in self.constants.items())
            and all(other.callee(name) == known for name, known in self.callees.items())
        )
