"""A translation unit is read as data: functions, macros, sizes and tables of its C text, and the types of its names.

Functions are parsed by the reader of C parts (lowering/dialect), one by one and on demand.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

from nmpc_codegen.lowering.dialect.c_expressions import Expression, expression
from nmpc_codegen.lowering.dialect.scopes import DECLARATION, blank, declarators, split
from nmpc_codegen.lowering.dialect.tree import Node, parse

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_API = re.compile(r"API\((\w+)\)")
_FUNCTION = re.compile(r"^(?:/\*(?:(?!\*/).)*\*/\n)?(\w[^;={}#/]*?[)\]])\s*\n\{\n.*?^\}", re.MULTILINE | re.DOTALL)
_HEAD = re.compile(r"(\w+)\((?!\*)(.*)\)", re.DOTALL)
_SHARED = re.compile(r"/\* at most [^*]+? passes in (\w+) \*/")
ENUM = re.compile(r"enum \{([^{}]*)\}")
_VALUE = re.compile(r"(\w+) = (-?\d+)\b")
_TABLE = re.compile(r"^static const int (\w+)\[\d+\] = \{ ([-\d, \n]+?) \};", re.MULTILINE)
_STRUCT = re.compile(r"(?:typedef )?(?:struct|union) (?:\w+ )?\{(.*?)\}[ \w]*;", re.DOTALL)
_DEFINE = re.compile(r"^#define (\w+)(?:\(([^()]*)\))?[ \t]+(.+)$", re.MULTILINE)
_MEMBER = re.compile(r"(\w+) (\w+)((?:\[[^\]]+\])*);")
_BASE = re.compile(r"(?:static |inline |const |extern )*(\w+)")

#: Functions of the C library that the parts call -> their operations.
MATH: Mapping[str, int] = {"sqrt": 1, "exp": 1, "log": 1, "fabs": 1, "ceil": 1, "isfinite": 0, "memcpy": 0, "memset": 0}


class Type(NamedTuple):
    """The type of an expression is "real", "int" or the name of another type, below ``depth`` pointers or arrays."""

    base: str
    depth: int = 0

    @property
    def counts(self) -> bool:
        """Return True if arithmetic with such a value is a floating-point operation."""
        return self.base == "real" and self.depth == 0


INT, REAL = Type("int"), Type("real")


@lru_cache(maxsize=4096)
def type_of(text: str) -> Type:
    """Return the type of a declaration such as ``const real_t *x`` or ``real_t (*S)[NX]``."""
    found = _BASE.match(text.strip())
    base = found[1] if found else ""
    depth = text.count("*") + text.count("[")
    integer = base in ("int", "int32_t", "int64_t", "unsigned")
    return Type("real" if base.endswith(("_real", "real_t")) else "int" if integer else base, depth)


class Code(NamedTuple):
    """Code is an expression together with the text that contains it."""

    text: str
    tree: Expression

    @property
    def operands(self) -> tuple[Code, ...]:
        """Return the operands of the expression; for a call the arguments, for a list the items."""
        inner = self.tree.operands[1:] if self.tree.kind == "call" else self.tree.operands
        return tuple(part for each in inner for part in _parts(Code(self.text, each)))

    @property
    def cast(self) -> Type:
        """Return the type of a cast."""
        return type_of(self.text[self.tree.start + 1 : self.tree.operands[0].start].rstrip(" )("))


def _parts(code: Code) -> tuple[Code, ...]:
    """Return the expressions between commas."""
    if (code.tree.kind, code.tree.word) != ("binary", ","):
        return (code,)
    return tuple(part for each in code.tree.operands for part in _parts(Code(code.text, each)))


@lru_cache(maxsize=1 << 15)
def code_of(text: str) -> Code | None:
    """Return a text without comments as an expression; None for an empty one."""
    return Code(text, expression(text)) if text.strip() else None


class TextMacro(NamedTuple):
    """A macro has parameters (none: an object-like macro) and a text."""

    parameters: tuple[str, ...]
    text: str


@dataclass(frozen=True, eq=False)
class Function:
    """A function of a unit has a name and a text."""

    name: str
    head: str
    text: str

    @cached_property
    def result(self) -> Type:
        """Return the type of the function's value."""
        before, _, after = self.head.partition(self.name)
        return type_of(before + after[after.rindex(")") :])

    @cached_property
    def parameters(self) -> tuple[tuple[str, Type], ...]:
        """Return name and type of the parameters."""
        found = _HEAD.search(self.head)
        given = [p.strip() for p in split(found[2] if found else "") if p.strip() not in ("", "void")]
        return tuple((_parameter_name(p), type_of(p)) for p in given)

    @cached_property
    def body(self) -> tuple[Node, ...]:
        """Return the statements of the body."""
        return parse(self.text)[-1].body

    @cached_property
    def code(self) -> str:
        """Return the text of the function with blanks for comments."""
        return blank(self.text)

    @cached_property
    def changed(self) -> frozenset[str]:
        """Return the variables that the function changes, or whose address it takes, except counters of its loops."""
        return find_changes(self.code, self.body)


def _parameter_name(text: str) -> str:
    pointer = re.search(r"\(\*(\w+)", text)
    return pointer[1] if pointer else re.findall(r"\w+", re.sub(r"\[[^\]]*\]", "", text))[-1]


def find_changes(code: str, nodes: Sequence[Node]) -> frozenset[str]:
    """Return the variables that statements change, or whose address they take.

    A counter that a loop declares is included only if the body changes it.
    """
    found: set[str] = set()
    for node in nodes:
        if node.kind == "loop":
            start, *rest = split_head(code, node)
            inside = find_changes(code, node.body)
            counters = {name for name, _ in declarators(start)}
            texts = [*_values(start), *rest]
            found |= inside | frozenset().union(*(_find_changes(text) for text in texts)) - counters
        elif node.kind in ("if", "block"):
            found |= _find_changes(code[slice(*node.head)]) | find_changes(code, node.body)
            found |= find_changes(code, (node.other,)) if node.other is not None else frozenset()
        elif node.kind in ("statement", "leave"):
            found = found.union(*(_find_changes(text) for text in _values(code[node.start : node.end])))
    return frozenset(found)


def _values(statement: str) -> list[str]:
    """Return the initialisers of a declaration, or any other statement itself."""
    text = statement.strip().removesuffix(";").removeprefix("return")
    if text in ("break", "continue") or ENUM.match(text):
        return []
    if DECLARATION.match(statement) is None:
        return [text]
    return [d.partition("=")[2] for _, d in declarators(statement) if "=" in d]


@lru_cache(maxsize=1 << 15)
def _find_changes(text: str) -> frozenset[str]:
    def walk(tree: Expression) -> set[str]:
        found = set[str]().union(*(walk(operand) for operand in tree.operands))
        if (tree.kind == "assign" or (tree.kind, tree.word) == ("unary", "&")) and tree.operands[0].kind == "name":
            found.add(tree.operands[0].word)
        return found

    return frozenset(walk(expression(text)) if text.strip() else ())


def split_head(code: str, node: Node) -> list[str]:
    """Return the three parts in the parentheses of a for loop; for a while loop its condition between empty parts."""
    head = code[slice(*node.head)]
    return head.split(";") if code.startswith("for", node.start) else ["", head, ""]


@dataclass(frozen=True)
class Callee:
    """The target of a call has the type of its value, and is a macro, a function of the unit, or known operations."""

    result: Type = INT
    macro: TextMacro | None = None
    function: Function | None = None
    operations: int | None = None


@dataclass(frozen=True, eq=False)
class Unit:
    """A unit holds the known facts of a translation unit.

    counts: functions with known operations; sizes: integer constants; tables: entries of constant integer tables;
    ranges: values that integer members can have; members: types of the members of all structs.
    """

    functions: Mapping[str, Function]
    macros: Mapping[str, TextMacro]
    counts: Mapping[str, int]
    sizes: Mapping[str, int]
    tables: Mapping[str, Sequence[int]]
    ranges: Mapping[str, tuple[int, int]]
    members: Mapping[str, Sequence[Type]]

    @cached_property
    def counting(self) -> frozenset[str]:
        """Return the functions whose calls limit the passes of loops."""
        return frozenset(name for f in self.functions.values() for name in _SHARED.findall(f.text))

    def member(self, name: str) -> Type:
        """Return the type of a member; "real" if members of several structs share the name."""
        known = self.members.get(name, ())
        return next((t for t in known if t.base == "real"), known[0] if known else INT)

    def constant(self, name: str) -> Type:
        """Return the type of a name that is no variable."""
        macro = self.macros.get(name)
        return REAL if macro is not None and ("real_t" in macro.text or name.startswith("TOL_")) else INT

    def callee(self, name: str) -> Callee | None:
        """Return the target of a call of this name, None if it is unknown; SQRT stands for sqrt or sqrtf."""
        macro = self.macros.get(name)
        name = name if macro is None or macro.parameters else macro.text
        if name in self.counts:
            return Callee(Type("void"), operations=self.counts[name])
        word = name if name in MATH else name.removesuffix("f").removeprefix("own_")
        if word in MATH:
            return Callee(REAL if MATH[word] else INT, operations=MATH[word])
        if name in self.functions:
            return Callee(self.functions[name].result, function=self.functions[name])
        return Callee(macro=self.macros[name]) if name in self.macros else None


def functions(unit: str) -> dict[str, Function]:
    """Return the functions that a translation unit defines, by name; API(f) is api_f."""
    found = {}
    for match in _FUNCTION.finditer(_API.sub(r"api_\1", unit)):
        if name := _HEAD.search(match[1]):
            found[name[1]] = _function(name[1], match[1], match[0])
    return found


@lru_cache(maxsize=4096)
def _function(name: str, head: str, text: str) -> Function:
    return Function(name, head, text)


def defined_macros(text: str) -> dict[str, TextMacro]:
    """Return the macros that a text defines, by name."""
    found = _DEFINE.findall(_COMMENT.sub("", text).replace("\\\n", " "))
    return {
        name: TextMacro(tuple(a.strip() for a in arguments.split(",")) if arguments else (), body.strip())
        for name, arguments, body in found
    }


def constants(unit: str) -> dict[str, int]:
    """Return the constants of the enums of the unit to which it gives a number."""
    return {name: int(value) for body in ENUM.findall(unit) for name, value in _VALUE.findall(body)}


def tables(unit: str) -> dict[str, tuple[int, ...]]:
    """Return the entries of the constant tables of integers that the unit defines."""
    return {name: tuple(map(int, body.split(","))) for name, body in _TABLE.findall(unit)}


def struct_members(unit: str) -> dict[str, list[Type]]:
    """Return the types of the members of the structs that a text defines, by name of the member."""
    found: dict[str, list[Type]] = {}
    for body in _STRUCT.findall(_COMMENT.sub("", unit)):
        for ctype, name, sizes in _MEMBER.findall(body):
            found.setdefault(name, []).append(type_of(ctype + " " + sizes))
    return found
