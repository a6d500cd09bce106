"""A C part is parsed to a tree of functions, blocks, statements and `#if`, each with its place in the text.

The dialect: blocks stand in braces, a line holds one statement, there is no do, switch or goto, `#if` is the only
conditional directive and each of its branches holds whole statements. Everything else is refused. A node knows where it
begins and ends, so that a pass changes the text between two places and keeps layout and comments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from textwrap import wrap
from typing import Literal, NamedTuple

#: Maximum length of a line.
WIDTH = 120

Kind = Literal["comment", "directive", "conditional", "branch", "function", "if", "loop", "block", "leave", "statement"]

_COMMENT = r"/\*.*?\*/"
_TEXT = r"\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'"
_TOKEN = re.compile(
    rf"{_COMMENT}|//|{_TEXT}|#(?:\\.|{_COMMENT}|[^\\\n])*|[{{}}();]"
    r"|\b(?:if|else|for|while|do|switch|case|default|goto|return|break|continue)\b",
    re.DOTALL,
)
_BLANK = re.compile(r"\s*")
_REST = re.compile(r"[ \t]*/\*")
_CONDITIONAL = re.compile(r"#(if|elif|else|endif)\b[ \t]*(.*)", re.DOTALL)
_OPEN, _CLOSE = frozenset("({"), frozenset(")}")
_DIALECT = "expected one statement in a line, blocks in braces, no do, switch or goto"
_DIRECTIVES = "expected #if, #elif, #else or #endif at the start of a line"


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """A node is a piece of text[start:end].

    head: place of the condition of an "if", of the parentheses of a "loop", of the signature of a "function", of the
    condition of a "branch" of `#if`. inside: place of its content. other: the "if" or the "block" after else.
    """

    kind: Kind
    start: int
    end: int
    head: tuple[int, int] = (0, 0)
    inside: tuple[int, int] = (0, 0)
    body: tuple[Node, ...] = ()
    other: Node | None = None

    def walk(self) -> Iterator[Node]:
        """Yield the node and all nodes below it, in the order of the text."""
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
    """Return the nodes of a text.

    Raises:
        ValueError: the text does not belong to the dialect; the message holds the line and what was expected.
    """
    return _Parser(text).whole()


class _Parser:
    """The parser reads tokens: brackets, semicolons, comments, directives and words that begin a statement."""

    def __init__(self, text: str) -> None:
        self.text, self.place = text, 0
        self.tokens = [_Token(m.start(), m.end(), m[0]) for m in _TOKEN.finditer(text)]
        self.tokens.append(_Token(len(text), len(text), ""))

    def whole(self) -> tuple[Node, ...]:
        if note := next((t for t in self.tokens if t.text == "//"), None):
            raise self.error(note.start, "expected a comment between /* and */")
        nodes, _ = self.sequence(0)
        token = self.tokens[self.place]
        if token.text:
            raise self.error(token.start, f"{token.text!r} closes what nothing has opened")
        return nodes

    def error(self, at: int, expected: str) -> ValueError:
        """Return an error that shows the line of a place."""
        begin = self.text.rfind("\n", 0, at) + 1
        line = self.text[begin:].split("\n", 1)[0].strip()
        return ValueError(f"line {self.text.count(chr(10), 0, begin) + 1}, {line!r}: {expected}")

    def next(self, at: int) -> tuple[int, _Token]:
        """Return the place after blanks, and the first token from there on."""
        blank = _BLANK.match(self.text, at)
        return (blank.end() if blank else at), self.tokens[self.place]

    def sequence(self, at: int) -> tuple[tuple[Node, ...], int]:
        """Return the nodes from a place up to the token that closes them, and its place."""
        nodes: list[Node] = []
        while True:
            at, token = self.next(at)
            if at == token.start and (token.text in ("", "}") or token.text.startswith(("#el", "#endif"))):
                return tuple(nodes), at
            nodes.append(self.node(at, token))
            at = nodes[-1].end

    def node(self, at: int, token: _Token) -> Node:
        """Return the node that begins at a place; ``token`` is the first token from there on."""
        word = token.text if at == token.start else ""
        if word.startswith("/*"):
            self.place += 1
            return Node("comment", at, token.end)
        if self.text[self.text.rfind("\n", 0, at) + 1 : at].strip():
            raise self.error(at, "expected one statement in a line")
        if word.startswith("#"):
            return self.directive(token)
        if word == "{":
            nodes, inside, end = self.braces(at)
            return Node("block", at, end, (0, 0), inside, nodes)
        if word in ("if", "for", "while"):
            return self.read_head(at, "if" if word == "if" else "loop")
        if word in ("do", "switch", "case", "default", "goto", "else", ")", "//"):
            raise self.error(at, _DIALECT)
        return self.statement(at, word)

    def directive(self, token: _Token) -> Node:
        """Return a directive, or an `#if` with its branches up to `#endif`."""
        start = token.start
        if not token.text.startswith("#if"):
            if token.text[1:2].isspace():
                raise self.error(start, _DIRECTIVES)
            self.place += 1
            return Node("directive", start, token.end)
        branches: list[Node] = []
        while True:
            found = _CONDITIONAL.match(token.text)
            if found is None or self.text[:start].rpartition("\n")[2]:
                raise self.error(token.start, _DIRECTIVES)
            self.place += 1
            bare = re.sub(_COMMENT, "", found[2]).strip()
            if found[1] in ("else", "endif") and bare:
                raise self.error(token.start, f"expected nothing after #{found[1]}")
            if found[1] == "endif":
                return Node("conditional", start, token.end, body=tuple(branches))
            if branches and self.text.startswith("#else", branches[-1].start):
                raise self.error(token.start, f"#{found[1]} after #else")
            nodes, end = self.sequence(token.end)
            following = self.tokens[self.place]
            if not following.text.startswith("#"):
                expected = "a branch of an #if closes a brace" if following.text else "#if without #endif"
                raise self.error(following.start, expected)
            head = (token.start + found.start(2), token.end)
            branches.append(Node("branch", token.start, end, head, (token.end + 1, end), nodes))
            token = following

    def read_head(self, at: int, kind: Kind) -> Node:
        """Return a loop, or an if with its else."""
        self.place += 1
        if self.tokens[self.place].text != "(":
            raise self.error(at, "expected a parenthesis")
        head = (self.tokens[self.place].end, self.skip())
        body, inside, end = self.braces(head[1] + 1)
        place, token = self.next(end)
        if kind == "loop" or token.text != "else" or token.start != place:
            return Node(kind, at, end, head, inside, body)
        self.place += 1
        place, following = self.next(token.end)
        if following.text == "if" and following.start == place:
            other = self.read_head(place, "if")
        else:
            nodes, within, end = self.braces(token.end)
            other = Node("block", place, end, (0, 0), within, nodes)
        return Node("if", at, other.end, head, inside, body, other)

    def skip(self) -> int:
        """Skip the next bracket and its content; return the place of the closing bracket."""
        depth = 0
        while self.tokens[self.place].text:
            token = self.tokens[self.place]
            if token.text.startswith("#"):
                raise self.error(token.start, "expected whole statements in the branches of an #if")
            self.place += 1
            depth += (token.text in _OPEN) - (token.text in _CLOSE)
            if depth == 0:
                return token.start
        raise self.error(self.tokens[-2].start, "a bracket is open at the end")

    def braces(self, after: int) -> tuple[tuple[Node, ...], tuple[int, int], int]:
        """Return the nodes of the block that begins after a place, the place inside, and its end."""
        at, token = self.next(after)
        if token.text != "{" or token.start != at:
            raise self.error(after - 1, _DIALECT)
        self.place += 1
        nodes, end = self.sequence(token.end)
        closing = self.tokens[self.place]
        if closing.text != "}":
            raise self.error(closing.start if closing.text else at, "opens a brace without closing it")
        self.place += 1
        return nodes, (token.end, end), closing.end

    def statement(self, at: int, word: str) -> Node:
        """Parse a statement or declaration with the comment after it.

        A brace that begins a line marks a function, which is returned instead.
        """
        while True:
            token = self.tokens[self.place]
            if token.text == "{" and self.text[token.start - 1] == "\n":
                nodes, inside, end = self.braces(token.start)
                return Node("function", at, end, (at, token.start), inside, nodes)
            if token.text in _OPEN:
                self.skip()
                continue
            self.place += 1
            if token.text == ";":
                break
            if not token.text or token.text in _CLOSE or token.text.startswith("#"):
                raise self.error(at, "expected a semicolon")
        end = token.end
        if _REST.match(self.text, end):
            end = self.tokens[self.place].end
            self.place += 1
        return Node("leave" if word in ("return", "break", "continue") else "statement", at, end)


_COMMENT_BEHIND = re.compile(rf"[ \t]*{_COMMENT}", re.DOTALL)


class Edit(NamedTuple):
    """An edit replaces text[start:end] by ``new``."""

    start: int
    end: int
    new: str


def edit(text: str, edits: Sequence[Edit]) -> str:
    """Return the text with edits applied; an edit inside another one is left for the next pass."""
    kept: list[str] = []
    at = 0
    for edit in sorted(edits, key=lambda e: (e.start, -e.end)):
        if edit.start >= at:
            kept += [text[at : edit.start], edit.new]
            at = edit.end
    return "".join([*kept, text[at:]])


def margin(text: str, node: Node) -> str:
    """Return the blanks before a node on its line."""
    return text[text.rfind("\n", 0, node.start) + 1 : node.start]


def whole_lines(text: str, node: Node, above: Node | None) -> tuple[int, int]:
    """Return the place of a node with its lines, and with the comment directly above it."""
    behind = _COMMENT_BEHIND.match(text, node.end)
    start, end = node.start, text.find("\n", behind.end() if behind else node.end)
    if above is not None and above.kind == "comment" and "\n\n" not in text[above.end : start]:
        start = start if margin(text, above).strip() else above.start
    return text.rfind("\n", 0, start) + 1, len(text) if end < 0 else end + 1


def wrap_line(line: str) -> list[str]:
    """Return a statement in lines that are not too long."""
    inner = line[: len(line) - len(line.lstrip())] + "    "
    return wrap(line, WIDTH, subsequent_indent=inner, break_long_words=False, break_on_hyphens=False) or [line]
