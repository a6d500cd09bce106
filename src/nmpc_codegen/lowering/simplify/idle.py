"""Zeros and ones that change nothing, where a number has taken the place of a name."""

from __future__ import annotations

import re

#: Without one of these only an assignment may be idle.
_NUMBER = re.compile(r"\b0\b|R\(1\)")
#: What goes, and what takes its place. A zero in a sum stands behind its first term and is no factor.
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
#: What is there is assigned.
_ASSIGNED = re.compile(r"^ *(\S[^=\n]*) = \1;\n", re.MULTILINE)


def without_idle(text: str) -> str:
    """The text without them."""
    for pattern, new in _RULES if _NUMBER.search(text) else ():
        text = pattern.sub(new, text)
    return _ASSIGNED.sub("", text)
