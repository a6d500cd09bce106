"""The translation unit as data: functions and macros of its C text, parsed on demand.

A comment ``/* at most <expression> passes */`` as the first item of a loop's body bounds the number of its passes; here
it becomes a pragma. So does ``/* <least> <= <variable> <= <most> */``, which states the values of an integer variable.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache

from pycparser import c_ast, c_parser

_PASSES = re.compile(r"/\* at most ([^*]+?) passes((?: in \w+)?) \*/")
_VALUES = re.compile(r"/\* (-?\w+) <= (\w+) <= ([^*]+?) \*/")
_COUNTING = re.compile(r"^#pragma .* in (\w+)$", re.MULTILINE)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_API = re.compile(r"API\((\w+)\)")
_FUNCTION = re.compile(r"^([A-Za-z_][^;={}#]*?[)\]])\s*\n\{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"(\w+)\((?!\*)")
_WORD = re.compile(r"[A-Za-z_]\w*")
_TYPE = re.compile(r"\b\w+_t\b")
_ENUM = re.compile(r"enum \{([^{}]*)\}")
_VALUE = re.compile(r"(\w+) = (-?\d+)\b")
_TABLE = re.compile(r"^static const int (\w+)\[\d+\] = \{ ([-\d, \n]+?) \};", re.MULTILINE)
_STRUCT = re.compile(r"typedef (?:struct|union) \{(.*?)\} \w+;", re.DOTALL)
_DEFINE = re.compile(r"^#define (\w+)(?:\(([^()]*)\))?[ \t]+(.+)$", re.MULTILINE)
_MEMBER = re.compile(r"(\w+) (\w+)((?:\[[^\]]+\])*);")


#: Types of integer members.
INTEGERS = ("int", "int32_t", "int64_t")

#: Operators that change their operand, or give its address away.
_CHANGING = ("++", "--", "p++", "p--", "&")
_NAMELESS = (c_ast.ID, c_ast.Constant, c_ast.TypeDecl, c_ast.PtrDecl, c_ast.ArrayDecl, c_ast.Typename)


@dataclass(frozen=True)
class Type:
    """Type of an expression: "real", "int" or the name of another type, below ``depth`` pointers or arrays."""

    base: str
    depth: int = 0

    @property
    def counts(self) -> bool:
        """Arithmetic with such a value is a floating-point operation."""
        return self.base == "real" and self.depth == 0


@dataclass(frozen=True)
class CMacro:
    """A macro with its parameters (none: an object-like macro) and its text."""

    parameters: tuple[str, ...]
    text: str

    @property
    def words(self) -> frozenset[str]:
        """The names in its text."""
        return _words(self.text)

    @property
    def expression(self) -> c_ast.Node:
        """Syntax tree of the text."""
        return _expression(self.text)


@dataclass(eq=False)
class CFunction:
    """A function definition as text; the same text gives the same object, which is parsed once."""

    name: str
    text: str
    _tree: c_ast.FuncDef | None = field(default=None, repr=False)

    @cached_property
    def counting(self) -> tuple[str, ...]:
        """Functions whose calls limit the passes of its loops."""
        return tuple(_COUNTING.findall(self.text))

    @cached_property
    def words(self) -> frozenset[str]:
        """The names in its text."""
        return _words(self.text)

    @cached_property
    def parameters(self) -> tuple[tuple[str, Type], ...]:
        """Name and type of its parameters."""
        arguments = self.tree.decl.type.args
        stated = [] if arguments is None else [p for p in arguments.params if isinstance(p, c_ast.Decl)]
        return tuple((p.name, type_of(p.type)) for p in stated)

    @cached_property
    def result(self) -> Type:
        """Type of its value."""
        return type_of(self.tree.decl.type)

    @property
    def tree(self) -> c_ast.FuncDef:
        """Its syntax tree."""
        parse((self,))
        return self._tree


def parse(found: Iterable[CFunction]) -> None:
    """Parse those functions that have not been parsed, all at once."""
    missing = [function for function in found if function._tree is None]
    if missing:
        text = "".join(function.text for function in missing)
        definitions = [d for d in c_parser.CParser().parse(_typedefs(text) + text).ext if isinstance(d, c_ast.FuncDef)]
        for function, tree in zip(missing, definitions, strict=True):
            function._tree = tree


@lru_cache(maxsize=4096)
def _words(text: str) -> frozenset[str]:
    return frozenset(_WORD.findall(text))


def functions(unit: str) -> dict[str, CFunction]:
    """The functions that a translation unit defines, by name."""
    text = _PASSES.sub(lambda found: f"\n#pragma {found[1]}{found[2]}\n", _API.sub(r"api_\1", unit))
    text = _COMMENT.sub(" ", _VALUES.sub(lambda found: f"\n#pragma {found[2]}: {found[1]}; {found[3]}\n", text))
    found = {}
    for head, body in _FUNCTION.findall(text):
        name = _NAME.search(head)
        if name:
            found[name[1]] = _function(name[1], f"{head}\n{{\n{body}}}\n")
    return found


@lru_cache(maxsize=4096)
def _function(name: str, text: str) -> CFunction:
    return CFunction(name, text)


def defined_macros(text: str) -> dict[str, CMacro]:
    """The macros that a text defines, by name."""
    found = _DEFINE.findall(_COMMENT.sub("", text).replace("\\\n", " "))
    return {
        name: CMacro(tuple(a.strip() for a in arguments.split(",")) if arguments else (), body.strip())
        for name, arguments, body in found
    }


def constants(unit: str) -> dict[str, int]:
    """Constants of the enums of the unit to which it gives a number."""
    return {name: int(value) for body in _ENUM.findall(unit) for name, value in _VALUE.findall(body)}


def tables(unit: str) -> dict[str, tuple[int, ...]]:
    """Entries of the constant tables of integers that the unit defines."""
    return {name: tuple(map(int, body.split(","))) for name, body in _TABLE.findall(unit)}


def struct_members(unit: str) -> dict[str, list[Type]]:
    """Types of the members of the structs that a text defines, by name of the member."""
    found: dict[str, list[Type]] = {}
    for body in _STRUCT.findall(_COMMENT.sub("", unit)):
        for ctype, name, sizes in _MEMBER.findall(body):
            base = "real" if ctype.endswith(("_real", "real_t")) else "int" if ctype in INTEGERS else ctype
            found.setdefault(name, []).append(Type(base, sizes.count("[")))
    return found


@cache
def type_of(node: c_ast.Node) -> Type:
    """Type of a declaration."""
    depth = 0
    while isinstance(node, c_ast.PtrDecl | c_ast.ArrayDecl | c_ast.FuncDecl | c_ast.TypeDecl | c_ast.Decl):
        depth += isinstance(node, c_ast.PtrDecl | c_ast.ArrayDecl)
        node = node.type
    names = getattr(node, "names", ["struct"])
    return Type({"real_t": "real"}.get(names[-1], names[-1]), depth)


@lru_cache(maxsize=1 << 16)
def assigned_names(node: c_ast.Node) -> frozenset[str]:
    """Variables that a statement changes, or whose address it takes; counters that its `for` loops declare excepted."""
    if isinstance(node, _NAMELESS):
        return frozenset()
    found = frozenset[str]().union(*(assigned_names(child) for child in node))
    if isinstance(node, c_ast.For) and isinstance(node.init, c_ast.DeclList):
        return (found - {d.name for d in node.init.decls}) | assigned_names(node.stmt)
    if isinstance(node, c_ast.Assignment) and isinstance(node.lvalue, c_ast.ID):
        return found | {node.lvalue.name}
    if isinstance(node, c_ast.UnaryOp) and node.op in _CHANGING and isinstance(node.expr, c_ast.ID):
        return found | {node.expr.name}
    return found


def _typedefs(text: str) -> str:
    return "".join(f"typedef int {name};\n" for name in sorted({*_TYPE.findall(text), "real_t"}))


@lru_cache(maxsize=4096)
def _expression(text: str) -> c_ast.Node:
    tree = c_parser.CParser().parse(f"{_typedefs(text)}void f(void)\n{{\n{text};\n}}\n")
    return tree.ext[-1].body.block_items[0]


#: Functions of the C library that the parts call, with their operations.
MATH: Mapping[str, int] = {"sqrt": 1, "exp": 1, "log": 1, "fabs": 1, "ceil": 1, "isfinite": 0, "memcpy": 0, "memset": 0}
