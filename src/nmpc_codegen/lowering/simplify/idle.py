"""Zeros and ones that have no effect are removed where a number has replaced a name."""

from __future__ import annotations

import re

#: Numbers without which only an assignment can have no effect.
_NUMBER = re.compile(r"\b0\b|R\(1\)")
#: Pattern to remove -> replacement. A zero in a sum follows its first term and is no factor.
_RULES = (
    (re.compile(r"\b0 % \w+"), "0"),
    (re.compile(r" \* R\(1\)(?=[;,)\]])"), ""),
    (re.compile(r"(?<=[\w)\]]) [-+] R\(0\)(?! *[*/])"), ""),
    (re.compile(r"(?<=[\w)\]]) \+ 0(?=[\])};,]| [-<>=&|?:])"), ""),
    (re.compile(r"(?<=[\[(])0 \+ "), ""),
    (re.compile(r"(?<=[\[(])0 \* \w+(?=[\])])"), "0"),
    (re.compile(r"(?<=[\[(])0 \* \w+ \+ "), ""),
    (re.compile(r"(?<=[\w)\]]) \+ 0 \* \w+(?=[\])])"), ""),
)
#: An assignment of a variable to itself.
_ASSIGNED = re.compile(r"^ *(\S[^=\n]*) = \1;\n", re.MULTILINE)


def without_idle(text: str) -> str:
    """Return the text without zeros, ones and assignments that have no effect."""
    for pattern, new in _RULES if _NUMBER.search(text) else ():
        text = pattern.sub(new, text)
    return _ASSIGNED.sub("", text)
