"""The spelling of types, numbers, functions and signals in C, on numbers or on vectors of them."""

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

#: A number with a longer literal is written as a quotient if its denominator is at most that.
LONGEST_LITERAL, LARGEST_DENOMINATOR = 14, 1000
#: The same if a numerator of so many digits and a divisor up to that have this value: steps and weights of a tableau.
LONGEST_NUMERATOR, LARGEST_DIVISOR = 6, 24


@dataclass(frozen=True)
class CStyle:
    """Spelling of types, literals and functions: ``real`` is the typedef, ``single`` selects 0.5F and sinf.

    lanes: values are GNU C vectors, with functions of their own for what has no operator. own: functions of the
    package's text take the place of those of math.h. names: the user's signals, after which constants are named.
    """

    real: str
    single: bool
    lanes: bool = False
    own: bool = False
    names: LocalNames = NO_NAMES

    #: Functions that are instructions, or made of bits, and round the same everywhere: those of math.h serve always.
    INSTRUCTIONS: ClassVar[tuple[str, ...]] = ("sqrt", "fabs")

    #: Opcodes of conditions -> the words of their functions on vectors.
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

    #: Words of the text of the elementary functions -> the same on vectors.
    ON_VECTORS: ClassVar[Mapping[str, str]] = {
        "real_t": "lanes_t",
        "bits_t": "words_t",
        "truth_t": "mask_t",
        "static": "LANES_INLINE",
        "inline ": "",
    }

    @property
    def on_vectors(self) -> CStyle:
        """The spelling of the same on vectors."""
        return replace(self, real="lanes_t", lanes=True, own=False)

    def literal(self, value: float) -> str:
        """A C literal that reads back to the same number, e.g. ``0.1`` or ``0.1F``."""
        text = repr(float(value))
        if "." not in text and "e" not in text:
            text += ".0"
        return text + ("F" if self.single else "")

    def number(self, value: float) -> str:
        """A literal, or the quotient of two short ones that has this value, e.g. ``1.0 / 6.0`` or ``0.15 / 6.0``."""
        if len(repr(value)) > LONGEST_LITERAL:
            ratio = Fraction(value).limit_denominator(LARGEST_DENOMINATOR)
            parts = [(float(f"{value * q:.{LONGEST_NUMERATOR}g}"), q) for q in range(2, LARGEST_DIVISOR + 1)]
            shortest = sorted(parts, key=lambda part: (len(repr(part[0])), part[1]))
            for p, q in ((ratio.numerator, ratio.denominator), *shortest):
                if q > 1 and p / q == value and self._holds(p, q, value):
                    return f"{self.literal(p)} / {self.literal(q)}"
        return self.literal(value)

    def _holds(self, p: float, q: int, value: float) -> bool:
        """True if a quotient has this value in the working precision, too."""
        return not self.single or bool(np.float32(p) / np.float32(q) == np.float32(value))

    def function(self, name: str) -> str:
        """Name of a function of math.h, or of the package's own, in the working precision; that of a look-up table."""
        if self.lanes:
            return f"lanes_{name}"
        if name.startswith("lookup_"):
            return name
        if self.own and name not in self.INSTRUCTIONS:
            return f"own_{name}"
        return name + ("f" if self.single else "")

    def word(self, word: str) -> str:
        """A word of the text of the elementary functions."""
        if not self.lanes:
            return word
        return self.function(word.removeprefix("own_")) if word.startswith("own_") else self.ON_VECTORS.get(word, word)

    def needs_values(self, opcode: int) -> bool:
        """True if the operands must be values: a vector cannot be compared with a number, nor a function take one."""
        return self.lanes and (opcode in self.CONDITIONS or bool(OPERATIONS[opcode].function))

    def whole(self, text: str) -> str:
        """A number as a value."""
        return f"lanes_all({text})" if self.lanes else text


_WORD = re.compile(r"\binline |[A-Za-z_]\w*")


def spell(text: str, style: CStyle) -> str:
    """The text of elementary functions, which is that on numbers, in a spelling."""
    return _WORD.sub(lambda found: style.word(found[0]), text)


def unit_style(precision: str, own: bool = False, names: LocalNames = NO_NAMES) -> CStyle:
    """Spelling of numbers, functions and signals inside the translation unit."""
    return CStyle("real_t", precision == "single", own=own, names=names)
