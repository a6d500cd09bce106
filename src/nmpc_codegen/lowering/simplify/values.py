"""Local variables that have one number as their value are replaced by that number."""

from __future__ import annotations

import re
from collections.abc import Iterator

from nmpc_codegen.lowering.dialect.scopes import declarators, readable
from nmpc_codegen.lowering.dialect.tree import Edit, Node, whole_lines

#: A declaration of one variable with a number, or of an integer with a size.
_NUMBER = re.compile(r"(?:const )?(?:(?:int|real_t) \w+ = (R\(\d[\w.]*\)|\d+)|int \w+ = ([A-Z]\w*));")


def of_known_value(text: str, body: tuple[Node, ...], end: int) -> Iterator[Edit]:
    """Yield the edits for the first such variable of a block, which ends at ``end``."""
    for place, node in enumerate(body):
        found = _NUMBER.fullmatch(text[node.start : node.end]) if node.kind == "statement" else None
        if found is None:
            continue
        name = declarators(found[0])[0][0]
        scope = readable(text[node.end : end])
        if not _changes(name).search(scope):
            yield Edit(*whole_lines(text, node, body[place - 1] if place else None), "")
            for use in re.finditer(rf"(?<![.\w])(?<!->){name}\b", scope):
                yield Edit(node.end + use.start(), node.end + use.end(), found[1] or found[2])
            return


def _changes(name: str) -> re.Pattern[str]:
    """Return the pattern of code that may change a variable: an assignment, a count, its address."""
    return re.compile(rf"(?<![.\w])(?<!->){name}(?:\s*(?:[-+*/%&|^]|<<|>>)?=(?!=)|\+\+|--)|(?:\+\+|--|(?<!&)&){name}\b")
