"""What the names of a translation unit mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from nmpc_codegen.analysis.c_source import MATH, CFunction, CMacro, Type

INT = Type("int")


@dataclass(frozen=True)
class Callee:
    """What is called: the type of its value, and for functions of the unit those of its parameters.

    A macro has its text; kernels, and functions of the C library, have ``operations`` that are known.
    """

    kind: Literal["known", "function", "macro", "unknown"]
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

    def functions_below(self, function: str) -> list[CFunction]:
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
            return Callee("known", Type("void"), operations=self.counts[name])
        word = name if name in MATH else name.removesuffix("f").removeprefix("own_")
        if word in MATH:
            return Callee("known", Type("real" if MATH[word] else "int"), operations=MATH[word])
        if name in self.functions:
            function = self.functions[name]
            return Callee("function", function.result, tuple(t for _, t in function.parameters))
        if name in self.macros:
            return Callee("macro", macro=self.macros[name])
        return Callee("unknown")
