"""The declarations and names of a function are found: variables and their scopes, pointers to structs, free names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from functools import lru_cache

from nmpc_codegen.lowering.dialect.tree import Node, parse

_NO_CODE = re.compile(r"/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'", re.DOTALL)
_PASSES = re.compile(r"/\* at most ([^*]+?) passes")
_NOT_NEWLINE = re.compile(r"[^\n]")
_IDENTIFIER = re.compile(r"(?<![.\w])(?<!->)[A-Za-z_]\w*")
#: The type in a declaration of variables, up to the first name.
DECLARATION = re.compile(
    r"\s*(?:static )?(?:const )?(?:unsigned )?(?:int|double|char|\w+_t)(?: (?:const )?(?=[\w*(])|(?=\(\*))"
)
_POINTER = re.compile(r"\b(\w+)_t \*(?:const )?(\w+)")
_POINTER_TO = re.compile(r"\(\*\s*(\w+)")
_NAME = re.compile(r"[\s(*]*(?:const )?(\w+)")
_SIGNATURE = re.compile(r"(?P<name>API\(\w+\)|\b\w+)\((?P<parameters>.*)\)(?:\)\[\w+\])?\s*;?$", re.DOTALL)
_ATTRIBUTE = re.compile(r"__attribute__\(\(.*?\)\)")


@lru_cache(maxsize=16384)
def blank(text: str) -> str:
    """Return the text with blanks for its comments, strings and characters; all positions stay the same."""
    if "/" not in text and '"' not in text and "'" not in text:
        return text
    return _NO_CODE.sub(lambda found: _NOT_NEWLINE.sub(" ", found[0]), text)


def readable(text: str) -> str:
    """Return the code without comments.

    Only the bounds in "/* at most ... passes */" remain, as they name identifiers.
    """
    code = blank(text)
    for found in _PASSES.finditer(text):
        code = code[: found.start(1)] + found[1] + code[found.end(1) :]
    return code


@lru_cache(maxsize=32768)
def in_line(text: str) -> str:
    """Return the code of a text on one line, with its strings."""
    return " ".join(_NO_CODE.sub(lambda found: " " if found[0].startswith("/*") else found[0], text).split())


@lru_cache(maxsize=32768)
def names_in_code(text: str) -> frozenset[str]:
    """Return the identifiers of a text that are no members of a struct."""
    return frozenset(_IDENTIFIER.findall(blank(text)))


def split(code: str) -> list[str]:
    """Return the parts of a text between commas outside of brackets."""
    depth, first, found = 0, 0, []
    for mark in _MARK.finditer(code):
        if mark[0] == ",":
            if depth == 0:
                found.append(code[first : mark.start()])
                first = mark.end()
        else:
            depth += 1 if mark[0] in "([{" else -1
    return [*found, code[first:]]


_MARK = re.compile(r"[,()\[\]{}]")


@lru_cache(maxsize=32768)
def declarators(text: str) -> tuple[tuple[str, str], ...]:
    """Return (name, declarator) of every variable of a declaration; empty if a text declares nothing."""
    found = DECLARATION.match(text)
    if found is None:
        return ()
    each = split(blank(text)[found.end() :].rstrip().removesuffix(";"))
    return tuple((_NAME.match(d)[1], d.strip()) for d in each)  # type: ignore[index]


@lru_cache(maxsize=8192)
def signature(text: str) -> tuple[str, tuple[str, ...]]:
    """Return name and parameters of a function or a prototype."""
    found = _SIGNATURE.search(_ATTRIBUTE.sub("", " ".join(blank(text).split())))
    if found is None:
        raise ValueError(f"no signature of a function: {text.strip()!r}")
    given = [re.sub(r"\[[^\]]*\]", "", p) for p in split(found["parameters"]) if p.strip() not in ("void", "")]
    pointers = (_POINTER_TO.search(parameter) for parameter in given)
    names = (p[1] if p else _IDENTIFIER.findall(g)[-1:] for p, g in zip(pointers, given, strict=True))
    return found["name"], tuple("".join(name) for name in names)


def function_of(text: str) -> Node:
    """Return the function in a text with its comment."""
    return parse(text)[-1]


def head_of(text: str) -> str:
    """Return the head of a function: its type, name and parameters."""
    return text[slice(*function_of(text).head)].strip()


def pointers(text: str) -> Mapping[str, str]:
    """Return {pointer in a function: struct to which it points}.

    Raises:
        ValueError: pointers to different structs have the same name, so that a member does not tell its struct.
    """
    found: dict[str, str] = {}
    for struct, name in _POINTER.findall(blank(text)):
        if found.setdefault(name, struct) != struct:
            raise ValueError(f"{name} points to {found[name]}_t and to {struct}_t; expected a name for each")
    return found


def free_names(text: str) -> frozenset[str]:
    """Return the names that a function uses without declaring them: types, functions, macros, tables.

    Raises:
        ValueError: a block declares a variable twice, or a variable is used outside of the block that declares it.
    """
    return _names(text)[0]


def check_names(text: str, known: Set[str]) -> None:
    """Raise ValueError if a variable hides another one, or a table or function with known values.

    If the braces of a block are removed, a hiding variable would capture names in the code after it.
    """
    _, hidden, declared = _names(text)
    if hidden:
        raise ValueError(f"{sorted(hidden)[0]} is declared where there is a variable with this name")
    if taken := declared & known:
        raise ValueError(f"{sorted(taken)[0]} is a variable here and known elsewhere; expected another name")


@lru_cache(maxsize=16384)
def _names(text: str) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    """Return free names, names of variables that hide another one, and names of all variables and parameters."""
    function = function_of(text)
    head = text[slice(*function.head)]
    name, parameters = signature(head)
    scopes = _Scopes(text)
    scopes.visit(function.body, frozenset(parameters))
    outside = scopes.free & scopes.declared
    if outside:
        raise ValueError(f"{name}(): {sorted(outside)[0]} is declared in a block and used outside of it")
    free = scopes.free | names_in_code(head) - set(parameters) - {name}
    return frozenset(free), frozenset(scopes.hidden), frozenset(scopes.declared.union(parameters))


class _Scopes:
    """Free names, declared names, and names that hide others, collected while blocks are visited."""

    def __init__(self, text: str) -> None:
        self.text, self.free, self.declared, self.hidden = text, set[str](), set[str](), set[str]()

    def visit(self, body: Sequence[Node], outer: frozenset[str]) -> None:
        """Visit a block whose statements see the names ``outer``."""
        own: set[str] = set()
        for node in body:
            visible = outer | own
            if node.kind == "statement":
                found = declarators(self.text[node.start : node.end])
                for name, _ in found:
                    if name in own:
                        raise ValueError(f"{name} is declared twice in a block")
                    own.add(name)
                self.declared |= own
                self.hidden |= own & outer
                self.free |= names_in_code(self.text[node.start : node.end]) - visible - own
            elif node.kind in ("if", "loop", "block"):
                self.visit_inside(node, frozenset(visible))
            elif node.kind != "comment":
                self.free |= names_in_code(self.text[node.start : node.end]) - visible

    def visit_inside(self, node: Node, visible: frozenset[str]) -> None:
        head = self.text[slice(*node.head)]
        counted = {name for name, _ in declarators(head.partition(";")[0])} if node.kind == "loop" else set()
        self.declared |= counted
        self.hidden |= counted & visible
        self.free |= names_in_code(head) - visible - counted
        self.visit(node.body, visible | counted)
        if node.other is not None:
            self.visit_inside(node.other, visible)
