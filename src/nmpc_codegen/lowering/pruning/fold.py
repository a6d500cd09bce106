"""Loops over nothing and conditions that a package decides: they are not in its unit.

A part loops over rows, free components or slacks that a problem may not have: ``for (int m = 0; m < NG; m++)``. Where
NG is 0 the loop is left out with its comment, so that no part needs a condition around it. The same holds for an
``if`` whose condition is an expression in sizes, and for a statement that writes a member of size 0 or calls a kernel
that has nothing to compute.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from nmpc_codegen.lowering.parts import evaluate
from nmpc_codegen.lowering.pruning.text import (
    IDENTIFIER,
    blanked,
    changes,
    closing,
    has_effects,
    indent,
    split,
    without_comment_above,
)

_HEAD = re.compile(r" *(?P<word>if|for|while) \((?P<inside>.*)\) \{$", re.DOTALL)
_LOOP = re.compile(
    r"(?P<type>(?:int|ptrdiff_t) )?(?P<variable>\w+) = (?P<first>[^,;]+)(?:,[^;]*)?; (?P<condition>[^;]*);"
)
_ASSIGNMENT = re.compile(r" [+\-*/|&]?= ")
_COUNTED = re.compile(r"(?:\+\+|--)\w+|\w+(?:\+\+|--| \+= \w+)")
_ELSE_IF = re.compile(r" *\} else if \((?P<inside>.*)\) \{$", re.DOTALL)
#: KERNEL(...); memset(place, ...); memcpy(place, ...); place = value;
_WRITTEN = re.compile(
    r"\s*(?:(?P<kernel>[A-Z][A-Z_]*)\(.*\)|mem(?:set|cpy)\((?P<moved>[^,]*),.*\)"
    r"|(?P<assigned>\*?\w+(?:->|\.|\[)[^=;]*?) (?:[+\-*/|&]?=) (?P<value>[^;]*));\s*$",
    re.DOTALL,
)
_WORDS = re.compile(r"[A-Za-z_]\w*")
#: Behind it a block has nothing to do.
_LEAVES = re.compile(r" *(?:return\b.*|continue|break);")
#: A declaration of one variable or the first of some.
_DECLARED = re.compile(
    r" +(?:static )?(?:const )?(?:int|int32_t|ptrdiff_t|\w+_t)(?: \(?\**|\(\*)(?P<name>\w+)\b(?! *\()"
)
_STEP = "    "
#: Maximum length of a line.
WIDTH = 120


@dataclass(frozen=True)
class Constants:
    """What a package decides: sizes, the least and the largest entry of tables, members (struct, name) and kernels
    (their macros) that it lacks."""

    sizes: Mapping[str, int] = field(default_factory=dict)
    tables: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    members: frozenset[tuple[str, str]] = frozenset()
    kernels: frozenset[str] = frozenset()

    def voids(self, statement: str, types: Mapping[str, str]) -> bool:
        """True for a statement that writes what the package lacks, or calls a kernel that it lacks; ``types``: the
        structs to which pointers of the function point."""
        written = _WRITTEN.match(statement)
        if written is None:
            return False
        kernel, moved, assigned, value = written.groups()
        if changes(_ASSIGNMENT.sub(" ", statement, count=1) if assigned else statement) or has_effects(value or ""):
            return False
        if kernel:
            return kernel in self.kernels
        path = _WORDS.findall(re.sub(r"\[[^\]]*\]", "", moved or assigned))
        if len(path) < 2:
            return False
        struct = path[-2] if len(path) > 2 else types.get(path[0], "")
        return (struct, path[-1]) in self.members

    def value(self, atom: str) -> bool | None:
        """Truth of a comparison or a number; None: it depends on more than constants."""
        names = sorted(set(IDENTIFIER.findall(atom)) & self.tables.keys())
        entries = {name: re.compile(rf"\b{name}\[[^\[\]]*\]") for name in names}
        if any(name in IDENTIFIER.findall(entry.sub("", atom)) for name, entry in entries.items()):
            return None  # an index that is an entry itself
        for name, entry in entries.items():
            least, most = self.tables[name]
            if least < most and (len(entry.findall(atom)) > 1 or not re.search(r"[<>]", atom)):
                return None
            verdicts = {self.value(entry.sub(f"(0 {value:+d})", atom)) for value in (least, most)}
            return verdicts.pop() if len(verdicts) == 1 else None
        try:
            return evaluate(atom, self.sizes)
        except ValueError:
            return None

    def reduced(self, condition: str) -> bool | str:
        """A condition without the operands that constants decide; True or False if they decide it."""
        for word, decisive in (("||", True), ("&&", False)):
            operands = split(condition, word)
            if len(operands) > 1:
                return self._joined(operands, word, decisive)
        if condition.startswith("!") and not condition.startswith("!="):
            inner = self.reduced(condition[1:])
            return not inner if isinstance(inner, bool) else f"!{inner}"
        if _enclosed(condition):
            inner = self.reduced(condition[1:-1])
            return inner if isinstance(inner, bool) else f"({inner})"
        value = self.value(condition)
        return condition if value is None else value

    def _joined(self, operands: Sequence[str], word: str, decisive: bool) -> bool | str:
        kept: list[str] = []
        for operand in operands:
            value = self.reduced(operand)
            if value is decisive and not any(map(has_effects, kept)):
                return decisive
            if not isinstance(value, bool):
                kept.append(value)
            elif value is decisive:
                kept.append(operand)
        if not kept:
            return not decisive
        if len(kept) == 1 and len(operands) > 1:
            return kept[0][1:-1] if _enclosed(kept[0]) else kept[0]
        return f" {word} ".join(kept)

    def never_runs(self, head: str) -> bool:
        """True if a loop, ``head`` being what its parentheses hold, does not run once."""
        loop = _LOOP.match(head)
        if loop is None:
            return False
        condition = re.sub(rf"\b{loop['variable']}\b", f"({loop['first']})", loop["condition"])
        return self.reduced(condition) is False


def _enclosed(text: str) -> bool:
    """True if the text begins with a parenthesis that closes at its end."""
    depth = 0
    if not text.startswith("("):
        return False
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return character == ")" and position == len(text) - 1
    return False


def folded(lines: Sequence[str], constants: Constants, types: Mapping[str, str]) -> list[str]:
    """Lines of a function without what constants decide; ``types``: the structs to which its pointers point."""
    code = blanked("\n".join(lines)).split("\n")
    kept: list[str] = []
    number = 0
    while number < len(lines):
        first, end = number, _end_of_head(code, number)
        head = _HEAD.match(_joined_lines(code[number : end + 1])) if end is not None else None
        if end is None or head is None:
            last = _end_of_statement(code, number)
            if constants.voids("\n".join(code[number : last + 1]), types):
                without_comment_above(kept)
            else:
                kept += lines[number : last + 1]
            number = last + 1
            continue
        if head["word"] == "if":
            chain, number = _chain(lines, code, number, end)
            text = _printed(chain, constants, types)
            _check_scope(text, indent(lines[first]), code[number:])
        else:
            last = closing(code, end, indent(lines[number]))
            inside = folded(lines[end + 1 : last], constants, types)
            text = [*lines[number : end + 1], *inside, lines[last]]
            if _gone(head["word"], " ".join(head["inside"].split()), inside, constants, code[last + 1 :]):
                text = []
            number = last + 1
        if not text:
            without_comment_above(kept)
        kept += text
        if text and _LEAVES.match(text[-1]) and indent(text[-1]) == indent(lines[first]):
            return kept
    return kept


def _check_scope(text: Sequence[str], margin: str, later: Sequence[str]) -> None:
    """Raise ValueError if lines use a variable that a block before them declares: it is not C before it is folded."""
    declared = (_DECLARED.match(line) for line in text if indent(line) == margin)
    for name in (found["name"] for found in declared if found):
        line = next((line for line in later if re.search(rf"(?<![.\w>]){name}\b", line)), "")
        if line and not re.search(rf"\b(?:int|ptrdiff_t|\w+_t) \**(?:\w+, )*{name}\b", line):
            raise ValueError(
                f"{name}: declared in a block and used after it; expected its declaration before the block"
            )


def _joined_lines(code: Sequence[str]) -> str:
    return "\n".join(line.rstrip() for line in code)


def _gone(word: str, inside: str, block: Sequence[str], constants: Constants, later: Sequence[str]) -> bool:
    """True for a loop that never runs, or one that has nothing to do; ``later``: the lines after it."""
    if word == "while":
        return constants.reduced(inside) is False
    loop = _LOOP.match(inside)
    if loop is None or not (loop["type"] or _is_set_anew(loop["variable"], later)):
        return False
    if constants.never_runs(inside):
        return not has_effects(loop["first"])
    counted = _COUNTED.fullmatch(inside[loop.end() :].strip())
    idle = all(line.strip() in ("", "continue;") for line in block)
    return idle and counted is not None and not has_effects(loop["first"] + loop["condition"])


def _is_set_anew(variable: str, later: Sequence[str]) -> bool:
    """True if no line reads the variable of a loop before another loop sets it."""
    line = next((line for line in later if re.search(rf"\b{variable}\b", line)), "")
    return not line or line.lstrip().startswith(f"for ({variable} = ")


def _end_of_head(code: Sequence[str], number: int) -> int | None:
    """Last line of the head of the block that begins in a line."""
    if not code[number].lstrip().startswith(("if (", "for (", "while (")):
        return None
    for end in range(number, len(code)):
        line = code[end].rstrip()
        if line.endswith("{"):
            return end
        if line.endswith(";") and not code[number].lstrip().startswith("for ("):
            return None
    return None


def _end_of_statement(code: Sequence[str], number: int) -> int:
    """Last line of the statement that begins in a line; the line itself if none does."""
    for end in range(number, len(code)):
        line = code[end].rstrip()
        if line.endswith(";"):
            return end
        if not line or line.endswith(("{", "}", ":")):
            return number
    return number


@dataclass(frozen=True)
class _Branch:
    """A branch of an `if`: its condition ("" for else), the lines of its head, and its block."""

    condition: str
    head: tuple[str, ...]
    block: tuple[str, ...]


def _chain(lines: Sequence[str], code: Sequence[str], number: int, end: int) -> tuple[list[_Branch], int]:
    """The branches of the `if` that begins in a line, and the line after them."""
    margin, branches = indent(lines[number]), []
    while True:
        head = _joined_lines(code[number : end + 1])
        found = _HEAD.match(head) or _ELSE_IF.match(head)
        condition = "" if found is None else " ".join(found["inside"].split())
        last = closing(code, end, margin)
        branches.append(_Branch(condition, tuple(lines[number : end + 1]), tuple(lines[end + 1 : last])))
        if code[last].rstrip() == f"{margin}}}":
            return branches, last + 1
        number = last
        end = next(i for i in range(last, len(code)) if code[i].rstrip().endswith("{"))


def _printed(chain: Sequence[_Branch], constants: Constants, types: Mapping[str, str]) -> list[str]:
    """The branches that may be taken."""
    margin = indent(chain[0].head[0])
    kept: list[tuple[bool | str, _Branch, list[str]]] = []
    for branch in chain:
        condition = constants.reduced(branch.condition) if branch.condition else True
        if condition is False:
            continue
        kept.append((condition, branch, folded(branch.block, constants, types)))
        if condition is True:
            break
    if kept and kept[-1][0] is True and not any(map(str.strip, kept[-1][2])):
        kept.pop()
    while kept and not any(map(str.strip, kept[-1][2])) and not has_effects(str(kept[-1][0])):
        kept.pop()
    if not kept:
        return []
    if kept[0][0] is True:
        return [line.removeprefix(_STEP) for line in kept[0][2]]
    text: list[str] = []
    for place, (condition, branch, block) in enumerate(kept):
        same = condition == branch.condition and (place > 0) == branch.head[0].lstrip().startswith("}")
        text += branch.head if same and condition is not True else _head(margin, condition, place > 0)
        text += block
    return [*text, f"{margin}}}"]


def _head(margin: str, condition: bool | str, later: bool) -> list[str]:
    """The line that opens a branch."""
    opening = f"{margin}{'} else ' if later else ''}"
    if condition is True:
        return [f"{opening}{{"]
    return wrapped(f"{opening}if ({condition}) {{")


def wrapped(line: str) -> list[str]:
    """A statement in lines that are not too long, broken before an operator or after a comma."""
    margin = indent(line) + _STEP
    found = []
    while len(line) > WIDTH:
        place = max(line.rfind(" && ", 0, WIDTH), line.rfind(" || ", 0, WIDTH), line.rfind(", ", 0, WIDTH) + 1)
        if place <= len(margin):
            break
        found.append(line[:place])
        line = margin + line[place + 1 :]
    return [*found, line]
