"""A style spells types, numbers, functions and signals in C, for numbers or for vectors of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import ClassVar

import casadi as ca
import numpy as np

from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.ir.printing.constant_names import NO_NAMES, LocalNames

#: Numbers with longer literals are written as quotients if the denominator is at most LARGEST_DENOMINATOR.
LONGEST_LITERAL, LARGEST_DENOMINATOR = 14, 1000
#: They are also written as quotients of a numerator with at most LONGEST_NUMERATOR digits and a divisor up to
#: LARGEST_DIVISOR, as steps and weights of a tableau.
LONGEST_NUMERATOR, LARGEST_DIVISOR = 6, 24


@dataclass(frozen=True)
class CStyle:
    """A style spells types, literals and functions: ``real`` is the typedef, ``single`` selects 0.5F and sinf.

    If ``lanes``, values are GNU C vectors, and functions replace missing operators. If ``own``, functions of the
    package's text replace those of math.h. ``names`` holds the user's signals, after which constants are named.
    """

    real: str
    single: bool
    lanes: bool = False
    own: bool = False
    names: LocalNames = NO_NAMES

    #: Functions that are instructions or bit operations and round equally everywhere; math.h always provides them.
    INSTRUCTIONS: ClassVar[tuple[str, ...]] = ("sqrt", "fabs")

    #: Opcode of a condition -> word of its function on vectors.
    CONDITIONS: ClassVar[Mapping[int, str]] = {
        ca.OP_SIGN: "sign",
        ca.OP_LT: "lt",
        ca.OP_LE: "le",
        ca.OP_EQ: "eq",
        ca.OP_NE: "ne",
        ca.OP_NOT: "not",
        ca.OP_AND: "and",
        ca.OP_OR: "or",
        ca.OP_IF_ELSE_ZERO: "if_else_zero",
    }

    #: Word in the text of the elementary functions -> its counterpart on vectors.
    ON_VECTORS: ClassVar[Mapping[str, str]] = {
        "real_t": "lanes_t",
        "bits_t": "words_t",
        "truth_t": "mask_t",
        "static": "LANES_INLINE",
        "inline ": "",
    }

    @property
    def on_vectors(self) -> CStyle:
        """Return the same spelling for vectors."""
        return replace(self, real="lanes_t", lanes=True, own=False)

    def literal(self, value: float) -> str:
        """Return a C literal that a compiler reads as the same number, e.g. ``0.1`` or ``0.1F``."""
        text = repr(float(value))
        if "." not in text and "e" not in text:
            text += ".0"
        return text + ("F" if self.single else "")

    def number(self, value: float) -> str:
        """Return a literal, or a quotient of two short ones, of this value: ``1.0 / 6.0`` or ``0.15 / 6.0``."""
        if len(repr(value)) > LONGEST_LITERAL:
            ratio = Fraction(value).limit_denominator(LARGEST_DENOMINATOR)
            parts = [(float(f"{value * q:.{LONGEST_NUMERATOR}g}"), q) for q in range(2, LARGEST_DIVISOR + 1)]
            shortest = sorted(parts, key=lambda part: (len(repr(part[0])), part[1]))
            for p, q in ((ratio.numerator, ratio.denominator), *shortest):
                if q > 1 and p / q == value and self._holds(p, q, value):
                    return f"{self.literal(p)} / {self.literal(q)}"
        return self.literal(value)

    def _holds(self, p: float, q: int, value: float) -> bool:
        """Return True if a quotient has this value in the working precision as well."""
        return not self.single or bool(np.float32(p) / np.float32(q) == np.float32(value))

    def function(self, name: str) -> str:
        """Return the name, in the working precision, of a function of math.h, of the package, or of a look-up table."""
        if self.lanes:
            return f"lanes_{name}"
        if name.startswith("lookup_"):
            return name
        if self.own and name not in self.INSTRUCTIONS:
            return f"own_{name}"
        return name + ("f" if self.single else "")

    def word(self, word: str) -> str:
        """Spell a word of the text of the elementary functions."""
        if not self.lanes:
            return word
        return self.function(word.removeprefix("own_")) if word.startswith("own_") else self.ON_VECTORS.get(word, word)

    def needs_values(self, opcode: int) -> bool:
        """Return True if operands must be vectors: a number cannot be compared with a vector, nor passed for one."""
        return self.lanes and (opcode in self.CONDITIONS or bool(OPERATIONS[opcode].function))

    def whole(self, text: str) -> str:
        """Return a number as a value of the style."""
        return f"lanes_all({text})" if self.lanes else text


_WORD = re.compile(r"\binline |[A-Za-z_]\w*")


def spell(text: str, style: CStyle) -> str:
    """Spell the text of elementary functions, which is written for numbers, in this style."""
    return _WORD.sub(lambda found: style.word(found[0]), text)


def unit_style(precision: str, own: bool = False, names: LocalNames = NO_NAMES) -> CStyle:
    """Return the spelling of numbers, functions and signals inside the translation unit."""
    return CStyle("real_t", precision == "single", own=own, names=names)
