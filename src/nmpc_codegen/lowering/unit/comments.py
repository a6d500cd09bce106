"""Comments without what the package lacks: phrases of it, and entries of contracts for functions that it does not have.

A phrase that depends on sizes or features is written [if NE > 0: and coupled], or [if SOLVE: both else: one]: the
condition is one of C, in which, as in #if, a name that the package does not have is 0.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from itertools import groupby
from textwrap import wrap

from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.expressions import expression
from nmpc_codegen.lowering.dialect.tree import WIDTH

_WORDS = r"(?:[^\[\]]|\[[^\[\]]*\])*?"
_PHRASE = re.compile(
    rf"(?P<blank> ?)\[if\s+(?P<condition>[^:\]]+):(?P<there>{_WORDS})(?:\s+else:(?P<otherwise>{_WORDS}))?\]"
)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
#: A line of a formula, of a list, or between paragraphs; all others are filled.
_APART = re.compile(r" *(?:/\*|\*)?(?: {2,}\S| ?-{20}|$)")
#: Blanks that a phrase leaves: before a mark, or two.
_BLANKS = re.compile(r"(?<=[\w)]) +(?=[,.;:](?:\s|$))|(?<=\S) +(?= \S)")
#: The end of a comment in a line of its own.
_END = re.compile(r"\n *\* *\*/$")
#: Stands for a blank at which no line ends.
_TIE = "\x01"
#: An entry of a contract: its margin, its names.
_ENTRY = re.compile(r"(?P<margin> \*   )(?P<names>\w+(?:, \w+)*)(?:\([^)]*\))? {2,}\S")


def word_comments(unit: str, constants: Constants | None) -> str:
    """A unit whose comments have the phrases of what the package has; None: of everything.

    Raises:
        ValueError: constants do not decide a condition.
    """

    def comment(found: re.Match[str]) -> str:
        if "[if" not in found[0]:
            return found[0]
        return _word_comment(unit[unit.rfind("\n", 0, found.start()) + 1 : found.start()], found[0], constants)

    return _COMMENT.sub(comment, unit)


def _word_comment(before: str, comment: str, constants: Constants | None) -> str:
    """Return a comment with its conditional phrases resolved, and its paragraphs with such phrases filled again;
    ``before``: what stands in front of the comment in its line."""
    runs = groupby(comment.split("\n"), key=lambda line: _APART.match(line) is not None)
    margin = before if not before.strip() else ""
    lines: list[str] = []
    for is_apart, run in runs:
        text = "\n".join(run)
        if "[if" in text:
            whole = text if is_apart else " ".join(line.strip().removeprefix("* ") for line in text.split("\n"))
            there = _PHRASE.sub(lambda found: _phrase(found, constants), whole)
            text = _without_empty_lines(there, text) if is_apart else _fill(there, margin, bool(before.strip()))
        lines += text.split("\n") if text else []
    kept = [line for line, above in zip(lines, ["", *lines], strict=False) if not line.strip() == above.strip() == "*"]
    return _END.sub(" */", "\n".join(kept).removeprefix(margin))


def _phrase(found: re.Match[str], constants: Constants | None) -> str:
    value = True if constants is None else _holds(found["condition"], constants)
    words = (found["there"] if value else found["otherwise"]) or ""
    return found["blank"] * bool(words.strip()) + words.strip()


def _holds(condition: str, constants: Constants) -> bool:
    known = re.sub(r"[A-Z]\w*", lambda name: name[0] if name[0] in constants.sizes else "0", condition)
    value = constants.truth(expression(known))
    if value is None:
        raise ValueError(f"[if {condition}: ...]: expected a condition on sizes and features of the package")
    return value


def _without_empty_lines(lines: str, before: str) -> str:
    """Lines without those of which phrases have left nothing."""
    known = set(before.split("\n"))
    return "\n".join(line.rstrip() for line in lines.split("\n") if line in known or line.strip() not in ("", "*"))


def _fill(paragraph: str, margin: str, is_beside: bool) -> str:
    """A paragraph in filled lines, of which the last is not the end of the comment alone; in one line beside code."""
    words = _BLANKS.sub("", paragraph).strip()
    words = words.replace(" */", f"{_TIE}*/")
    first = margin if words.startswith("/*") else f"{margin} * "
    width = len(words) + len(first) if is_beside else WIDTH
    lines = wrap(words, width, initial_indent=first, subsequent_indent=f"{margin} * ", break_long_words=False)
    return "\n".join(lines).replace(_TIE, " ")


def without_entries(comment: str, there: Collection[str]) -> str:
    """A contract without the entries of functions that are not there."""
    kept: list[str] = []
    margin = None  # of the entry that is left out
    for line in comment.split("\n"):
        entry = _ENTRY.match(line)
        if entry is not None:
            names = entry["names"].split(", ")
            margin = len(entry["margin"]) if not any(name in there for name in names) else None
        elif margin is not None and not line.startswith(" *" + " " * margin):
            margin = None
        if margin is None:
            kept.append(line)
    return "\n".join(kept)
