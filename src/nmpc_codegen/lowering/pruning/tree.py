"""The tree of a C part: functions, blocks, statements and `#if`, each with its place in the text.

The dialect: blocks stand in braces, a line holds one statement, there is no do, switch or goto, `#if` is the only
conditional directive and each of its branches holds whole statements. Everything else is refused. A node knows where it
begins and ends, so that a pass changes the text between two places and leaves layout and comments as they are.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

Kind = Literal["comment", "directive", "conditional", "branch", "function", "if", "loop", "block", "leave", "statement"]

_COMMENT = r"/\*.*?\*/"
_TEXT = r"\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'"
_TOKEN = re.compile(
    rf"{_COMMENT}|//|{_TEXT}|^[ \t]*#(?:\\.|{_COMMENT}|[^\\\n])*|[{{}}();]"
    r"|\b(?:if|else|for|while|do|switch|case|default|goto|return|break|continue)\b",
    re.DOTALL | re.MULTILINE,
)
_BLANK = re.compile(r"\s*")
_REST = re.compile(r"[ \t]*(/\*)?")
_CONDITIONAL = re.compile(r"#(if|elif|else|endif)\b[ \t]*(.*)", re.DOTALL)
_OPEN, _CLOSE = frozenset("({"), frozenset(")}")


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """A piece of text[start:end].

    ``head``: the place of the condition of an "if", of what stands in the parentheses of a "loop", of the signature of
    a "function", of the condition of a "branch" of `#if`. ``inside``: the place of what it holds. ``other``: the "if"
    or the "block" behind else.
    """

    kind: Kind
    start: int
    end: int
    head: tuple[int, int] = (0, 0)
    inside: tuple[int, int] = (0, 0)
    body: tuple[Node, ...] = ()
    other: Node | None = None

    def walk(self) -> Iterator[Node]:
        """The node and all below it, in the order of the text."""
        yield self
        for node in self.body:
            yield from node.walk()
        if self.other is not None:
            yield from self.other.walk()


class _Token(NamedTuple):
    start: int
    end: int
    text: str


@lru_cache(maxsize=4096)
def parse(text: str) -> tuple[Node, ...]:
    """The nodes of a text.

    Raises:
        ValueError: the text is not of the dialect; the line and what was expected.
    """
    return _Parser(text).whole()


class _Parser:
    """Reads tokens, that is brackets, semicolons, comments, directives and words that begin a statement."""

    def __init__(self, text: str) -> None:
        self.text, self.place = text, 0
        self.tokens = [_Token(m.start(), m.end(), m[0]) for m in _TOKEN.finditer(text)]
        self.tokens.append(_Token(len(text), len(text), ""))

    def whole(self) -> tuple[Node, ...]:
        nodes, _ = self.sequence(0)
        token = self.tokens[self.place]
        if token.text:
            self.fail(token.start, f"{token.text.strip()!r} closes what nothing has opened")
        return nodes

    def fail(self, at: int, expected: str) -> None:
        """Raise ValueError for the line at a place."""
        begin = self.text.rfind("\n", 0, at) + 1
        line = self.text[begin:].split("\n", 1)[0].strip()
        raise ValueError(f"line {self.text.count(chr(10), 0, begin) + 1}, {line!r}: {expected}")

    def sequence(self, at: int) -> tuple[tuple[Node, ...], int]:
        """Nodes from a place on to what closes them, and the place there."""
        nodes: list[Node] = []
        while True:
            blank = _BLANK.match(self.text, at)
            assert blank is not None
            token, at = self.tokens[self.place], blank.end()
            directive = (
                _CONDITIONAL.match(token.text.lstrip()) if "#" in token.text[:1] + token.text.lstrip()[:1] else None
            )
            if at >= token.start and (not token.text or token.text == "}" or (directive and directive[1] != "if")):
                return tuple(nodes), at
            node = self.conditional(token) if directive and at >= token.start else self.node(at, token)
            nodes.append(node)
            at = node.end

    def node(self, at: int, token: _Token) -> Node:
        """The node that begins at a place; ``token``: the first one from there on."""
        word = token.text if at == token.start else ""
        if word.startswith("/*"):
            self.place += 1
            return Node("comment", at, token.end)
        if at > token.start or word.startswith("#"):  # a directive begins at the margin
            self.place += 1
            if token.text.lstrip().startswith(("#ifdef", "#ifndef")):
                self.fail(token.start, "expected #if, #elif, #else or #endif at the start of a line")
            return Node("directive", token.start, token.end)
        if self.text[self.text.rfind("\n", 0, at) + 1 : at].strip():
            self.fail(at, "expected one statement in a line")
        if word == "{":
            nodes, inside, end = self.braces(at, at)
            return Node("block", at, end, (0, 0), inside, nodes)
        if word == "if":
            return self.choice(at)
        if word in ("for", "while"):
            return self.loop(at)
        if word in ("do", "switch", "case", "default", "goto", "else") or word[:1] in (")", "/"):
            self.fail(at, "expected one statement in a line, blocks in braces, no do, switch or goto")
        return self.statement(at, word)

    def conditional(self, token: _Token) -> Node:
        """`#if` with its branches, to `#endif`."""
        start, last = token.start, False
        branches: list[Node] = []
        while True:
            found = _CONDITIONAL.match(token.text)
            if found is None:
                self.fail(token.start, "expected #if, #elif, #else or #endif at the start of a line")
                raise AssertionError
            self.place += 1
            if found[1] == "endif":
                self.check_bare(token, found)
                return Node("conditional", start, token.end, body=tuple(branches))
            if last:
                self.fail(token.start, f"#{found[1]} after #else")
            last = found[1] == "else"
            if last:
                self.check_bare(token, found)
            nodes, _ = self.sequence(token.end)
            after = self.tokens[self.place]
            if not _CONDITIONAL.match(after.text.lstrip()):
                self.fail(after.start, "#if without #endif" if not after.text else "a branch of an #if closes a brace")
            head = (token.start + found.start(2), token.end)
            inside = (token.end + 1, after.start)
            branches.append(Node("branch", token.start, after.start, head, inside, nodes))
            token = after

    def check_bare(self, token: _Token, found: re.Match[str]) -> None:
        if re.sub(_COMMENT, "", found[2]).strip():
            self.fail(token.start, f"expected nothing after #{found[1]}")

    def choice(self, at: int) -> Node:
        """An if with what stands behind its else."""
        self.place += 1
        head = self.parentheses(at)
        body, inside, end = self.braces(at, head[1] + 1)
        other = None
        blank = _BLANK.match(self.text, end)
        token = self.tokens[self.place]
        if blank is not None and token.text == "else" and token.start == blank.end():
            self.place += 1
            blank = _BLANK.match(self.text, token.end)
            assert blank is not None
            following = self.tokens[self.place]
            if following.text == "if" and following.start == blank.end():
                other = self.choice(following.start)
            else:
                nodes, within, end = self.braces(token.start, token.end)
                other = Node("block", blank.end(), end, (0, 0), within, nodes)
            end = other.end
        return Node("if", at, end, head, inside, body, other)

    def loop(self, at: int) -> Node:
        self.place += 1
        head = self.parentheses(at)
        body, inside, end = self.braces(at, head[1] + 1)
        return Node("loop", at, end, head, inside, body)

    def parentheses(self, at: int) -> tuple[int, int]:
        """The place between the parentheses that open next."""
        first = self.tokens[self.place]
        if first.text != "(":
            self.fail(at, "expected a parenthesis")
        return first.end, self.skip()

    def skip(self) -> int:
        """Go behind the bracket that closes the next one; returns its place."""
        depth = 0
        for number in range(self.place, len(self.tokens)):
            text = self.tokens[number].text
            depth += (text in _OPEN) - (text in _CLOSE)
            if depth == 0 or not text:
                self.place = number + 1
                break
        token = self.tokens[self.place - 1]
        if not token.text:
            self.fail(self.tokens[-2].start, "a bracket is open at the end")
        return token.start

    def braces(self, at: int, after: int) -> tuple[tuple[Node, ...], tuple[int, int], int]:
        """The nodes of the block that begins behind a place, the place inside, and its end."""
        blank = _BLANK.match(self.text, after)
        token = self.tokens[self.place]
        if blank is None or token.text != "{" or token.start != blank.end():
            self.fail(at, "expected one statement in a line, blocks in braces, no do, switch or goto")
        self.place += 1
        nodes, end = self.sequence(token.end)
        closing = self.tokens[self.place]
        if closing.text != "}":
            self.fail(closing.start if closing.text else at, "opens a brace without closing it")
        self.place += 1
        return nodes, (token.end, end), closing.end

    def statement(self, at: int, word: str) -> Node:
        """A statement or a declaration with the comment behind it; a function, whose brace begins a line."""
        while True:
            token = self.tokens[self.place]
            if token.text == "{" and self.text[token.start - 1] == "\n":
                nodes, inside, end = self.braces(at, token.start)
                return Node("function", at, end, (at, token.start), inside, nodes)
            if token.text in _OPEN:
                self.skip()
                continue
            self.place += 1
            if token.text == ";":
                break
            if not token.text or token.text in _CLOSE or token.text.lstrip().startswith("#"):
                self.fail(at, "expected a semicolon")
        rest, end = _REST.match(self.text, token.end), token.end
        if rest is not None and rest[1]:
            end = self.tokens[self.place].end
            self.place += 1
        return Node("leave" if word in ("return", "break", "continue") else "statement", at, end)


class Edit(NamedTuple):
    """text[start:end] becomes ``new``; if that is "", the line and the comment above it go as well."""

    start: int
    end: int
    new: str


def edited(text: str, edits: Sequence[Edit]) -> str:
    """The text with edits; one inside another one is left for the next pass."""
    kept: list[str] = []
    at = 0
    for edit in sorted(edits, key=lambda e: (e.start, -e.end)):
        if edit.start >= at:
            kept += [text[at : edit.start], edit.new]
            at = edit.end
    return "".join([*kept, text[at:]])


def whole_lines(text: str, node: Node, above: Node | None) -> tuple[int, int]:
    """The place of a node with its lines, and with the comment just above it."""
    start, end = node.start, text.find("\n", node.end)
    if above is not None and above.kind == "comment" and "\n\n" not in text[above.end : start]:
        alone = not text[text.rfind("\n", 0, above.start) + 1 : above.start].strip()
        start = above.start if alone else start
    return text.rfind("\n", 0, start) + 1, len(text) if end < 0 else end + 1
