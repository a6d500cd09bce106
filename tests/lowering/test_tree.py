"""The tree of a part: against tree-sitter on all parts, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import tree_sitter
import tree_sitter_c

from nmpc_codegen.lowering.dialect.tree import Edit, Node, edit, parse
from nmpc_codegen.lowering.templates import template_directory
from verification.conditions import all_parts

#: Nodes of tree-sitter -> kind; it reads nothing else than C, so that it knows no macro that is a statement.
KINDS = {
    "if_statement": "if",
    "for_statement": "loop",
    "while_statement": "loop",
    "function_definition": "function",
    "preproc_if": "conditional",
    "comment": "comment",
    "return_statement": "leave",
    "break_statement": "leave",
    "continue_statement": "leave",
}


def ours(nodes: tuple[Node, ...]) -> Iterator[tuple[str, int]]:
    for node in (found for top in nodes for found in top.walk()):
        if node.kind in KINDS.values():
            yield node.kind, node.start


def theirs(node: Any) -> Iterator[tuple[str, int]]:
    if node.type in KINDS:
        yield KINDS[node.type], node.start_byte
    for child in node.children:
        yield from theirs(child)


@pytest.mark.parametrize("part", sorted(all_parts()))
def test_blocks_are_those_of_another_parser(part: str) -> None:
    """Kinds and places of blocks, functions, comments and directives; a comment inside a statement is none of ours."""
    text = (template_directory() / part).read_text(encoding="utf-8")
    assert text.isascii()
    parser = tree_sitter.Parser(tree_sitter.Language(tree_sitter_c.language()))
    found, expected = set(ours(parse(text))), set(theirs(parser.parse(text.encode()).root_node))
    assert found - expected == set()
    assert {place for place in expected - found if place[0] != "comment"} == set()


def test_places() -> None:
    choice = "    if (n > 0) { /* all */\n        return n;\n    } else if (n) {\n        n++;\n    }\n"
    text = f"int f(int n)\n{{\n{choice}    return 0;\n}}"
    (function,) = parse(text)
    first, last = function.body
    assert text[slice(*function.head)] == "int f(int n)\n"
    assert text[slice(*first.head)] == "n > 0"
    assert first.other is not None
    assert text[slice(*first.other.head)] == "n"
    assert [node.kind for node in first.body] == ["comment", "leave"]
    assert text[last.start : last.end] == "return 0;"
    assert edit(text, [Edit(last.start, last.end, "return 1;"), Edit(*first.head, "n < 0")]).count("n < 0") == 1


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ("if (s->a)\n    s->b = 1;", "blocks in braces"),
        ("for (int m = 0; m < NG; m++)\n    s->b = m;", "blocks in braces"),
        ("if (s->a) {\n    s->b = 1;\n} else\n    s->b = 2;", "blocks in braces"),
        ("do {\n    s->a--;\n} while (s->a);", "no do, switch or goto"),
        ("switch (s->a) {\ndefault:\n    s->b = 1;\n}", "no do, switch or goto"),
        ("goto end;", "no do, switch or goto"),
        ("s->a = 1; s->b = 2;", "one statement in a line"),
        ("s->a = 1 }", "expected a semicolon"),
        ("s->a = (1;", "a bracket is open at the end"),
        ("#ifdef A\n#endif", "expected #if"),
        ("#if A\nif (a) {\n#endif\n}", "opens a brace without closing it"),
        ("if (a) {\n#if A\n}\n#endif", "a branch of an #if closes a brace"),
        ("s->a = 1 +\n#if A\n2;\n#endif", "expected a semicolon"),
        ("if (a) {", "opens a brace without closing it"),
        ("# if A\n# endif", "expected #if"),
        ("f(a,\n#if A\nb);\n#endif", "expected whole statements"),
        ("int a; // note", "expected a comment between"),
    ],
)
def test_what_is_refused(block: str, expected: str) -> None:
    with pytest.raises(ValueError, match=rf"line \d+, .*{expected}"):
        parse(block)
