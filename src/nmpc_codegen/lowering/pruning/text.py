"""Places in C text that is formatted as the parts are: code without comments, arguments, blocks, conditions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

_NO_CODE = re.compile(r"/\*.*?\*/|//[^\n]*|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'", re.DOTALL)
_NOT_NEWLINE = re.compile(r"[^\n]")

#: An identifier that is no member of a struct.
IDENTIFIER = re.compile(r"(?<![.\w])(?<!->)[A-Za-z_]\w*")
#: What an initial value or an argument may do besides giving a number: count, assign; call a function.
_CHANGE = re.compile(r"\+\+|--|(?<![=!<>])=(?!=)")
_CALL = re.compile(r"\b[a-z_]\w*\(|\bAPI\(|\(\*[^()]*\)\(")
#: What the pruner does not know: a body without braces, do, switch, several statements in a line.
_BODY = re.compile(
    r" *(?:\} )?(?:else )?(?:if|for|while) \(.*\)$|.*\belse$|.*\belse [^i{].*|.*\b(?:do|switch)\b.*", re.DOTALL
)


def blanked(text: str) -> str:
    """The text with blanks for its comments, strings and characters: every place stays where it is."""
    return _NO_CODE.sub(lambda found: _NOT_NEWLINE.sub(" ", found[0]), text)


def has_effects(code: str) -> bool:
    """True if an expression may do more than give a number."""
    return changes(code) or bool(_CALL.search(code.replace("sizeof(", "SIZEOF(")))


def changes(code: str) -> bool:
    """True if an expression counts or assigns."""
    return bool(_CHANGE.search(code))


def check_dialect(name: str, lines: Sequence[str]) -> None:
    """Raise ValueError unless the lines of a function are such that its blocks can be told from their text."""
    code = [line.rstrip() for line in blanked("\n".join(lines)).split("\n")]
    for number, line in enumerate(code):
        head = line
        while head.count("(") > head.count(")") and number + 1 < len(code):
            number += 1
            head += "\n" + code[number]
        if head.lstrip().startswith("#"):
            continue
        if _BODY.fullmatch(head) or (";" in line[:-1] and not line.lstrip().startswith("for (")):
            raise ValueError(
                f"{name}(): {line.strip()!r}: expected one statement in a line, blocks in braces, no do or switch"
            )


def arguments(code: str, start: int) -> tuple[list[str], int]:
    """The arguments of the call whose parenthesis is at ``start``, and the position after it."""
    depth, first, found = 0, start + 1, []
    for position in range(start, len(code)):
        character = code[position]
        if character in "([{":
            depth += 1
        elif character in ")]}":
            depth -= 1
        if depth == 0 or (depth == 1 and character == ","):
            found.append(code[first:position])
            first = position + 1
        if depth == 0:
            return found, position + 1
    raise ValueError(f"unbalanced parentheses: {code[start : start + 60]!r}")


def split(code: str, between: str) -> list[str]:
    """The operands of ``&&`` or ``||`` in an expression that stand in no parentheses."""
    depth, first, found = 0, 0, []
    for position, character in enumerate(code):
        if character in "([{":
            depth += 1
        elif character in ")]}":
            depth -= 1
        elif depth == 0 and code.startswith(between, position):
            found.append(code[first:position].strip())
            first = position + len(between)
    return [*found, code[first:].strip()]


def indent(line: str) -> str:
    """The blanks before the first word."""
    return line[: len(line) - len(line.lstrip())]


def closing(code: Sequence[str], opening: int, margin: str) -> int:
    """Line of the brace that closes a block; ``margin``: the blanks before the line that opens it."""
    return next(i for i in range(opening + 1, len(code)) if code[i].startswith(f"{margin}}}"))


def without_comment_above(lines: list[str]) -> None:
    """Remove the comment in the last lines, as what follows it is gone."""
    if lines and lines[-1].rstrip().endswith("*/"):
        first = next((i for i in range(len(lines) - 1, -1, -1) if "/*" in lines[i]), None)
        if first is not None and lines[first].lstrip().startswith("/*"):
            del lines[first:]


def calls(code: str, name: str) -> Iterator[int]:
    """Places of the parenthesis in all calls of a function, the last one first."""
    found = [match.end() - 1 for match in re.finditer(rf"(?<![.\w])(?<!->){name}\(", code)]
    return reversed(found)
