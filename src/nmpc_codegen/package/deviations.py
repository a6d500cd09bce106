"""Generated packages deviate from these rules of MISRA C:2012; each rule has a reason for the deviation.

The rules are those that cppcheck's addon reports on the packages of crane, quadrotor and a tank with a parameter, a
rate and a soft row. None of them is a mandatory rule.
"""

from __future__ import annotations

from collections.abc import Mapping

DEVIATIONS: Mapping[str, str] = {
    "2.2": "The addon reports expressions in sizes that have the value 0 or 1 in a package; these reports are false.",
    "2.5": "Short names of sizes and tables are defined in one block, and a package need not use all of them.",
    "5.5": "Macros such as WEIGHT(s, k) or N belong to this translation unit; names in the user's header are prefixed.",
    "8.7": "Entry points are external on purpose, because the firmware calls them from another unit.",
    "8.9": "Tables are defined together at the top of the unit, where a reader looks for them.",
    "9.3": "An array of zeros is initialised by its first element, and the language guarantees the others.",
    "10.3": "Sizes, counters and results of comparisons are int throughout; all values fit.",
    "10.4": "sizeof is unsigned, counts of elements are int; the products are small and positive.",
    "10.6": "A conditional expression chooses between sizes or signs, whose values fit into less than an int.",
    "12.1": "Sums of products are printed without parentheses, because the precedence of * over + is well known.",
    "12.3": "Declarations of several scalars with their initial values share a line; no comma operator is used.",
    "14.2": "Loops with a stated largest number of passes may end early; the generator proves their bound.",
    "15.5": "Guards return at the top of a function, before anything is written.",
    "15.7": "A chain of else if covers a closed set of cases and needs no final else.",
    "17.8": "A function may change counters and pointers that it receives by value.",
    "18.4": "Rows of a matrix are addressed by pointer plus offset, as in the formulas of blocked factorisations.",
    "19.2": "Phases that never overlap share a union of work space; no member is read after another is written.",
    "20.10": "API(name) composes the prefix of the package, the only use of ##.",
}
