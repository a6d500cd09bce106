"""Functions are verbs, or nouns where they return a thing: none has the name of a participle."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.repository.test_architecture import SOURCE

#: Participles that do not end in "ed".
IRREGULAR = re.compile(
    "built|chosen|done|drawn|found|given|gone|grown|held|kept|known|made|met|paid|said|seen|sent|shown|spelt|stuck|taken"
    "|told|torn|understood|worn|written"
)
#: Words that end in "ed" and are no participles, or the object of a verb that stands before them.
NO_PARTICIPLES = frozenset({"feed", "need", "seed", "speed", "red", "shed", "embed", "exceed", "proceed"})
#: Words behind a participle that make it no noun.
ADVERBS = frozenset({"again", "alone", "apart", "at", "beside", "by", "from", "in", "through", "together", "with"})


def is_participle(name: str) -> bool:
    """Return True if the name is one word that is a participle, or begins with one and ends with an adverb."""
    words = [word for word in name.strip("_").split("_") if word]
    while len(words) > 1 and words[-1] in ADVERBS:
        words.pop()
    if len(words) != 1:
        return False
    return bool(IRREGULAR.fullmatch(words[0])) or (words[0].endswith("ed") and words[0] not in NO_PARTICIPLES)


def functions() -> Iterator[tuple[str, str]]:
    """(place, name) of all functions and methods; a property is a noun of its class."""
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and not any("property" in ast.unparse(d) for d in node.decorator_list):
                yield f"{path.relative_to(SOURCE)}:{node.lineno}", node.name


def test_no_function_has_the_name_of_a_participle() -> None:
    assert [f"{place} {name}" for place, name in functions() if is_participle(name)] == []


@pytest.mark.parametrize(
    ("name", "is_one"), [("decided", True), ("sealed_beside", True), ("seal", False), ("seed", False)]
)
def test_participles_are_told_from_other_words(name: str, is_one: bool) -> None:
    assert is_participle(name) is is_one
