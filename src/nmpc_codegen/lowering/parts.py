"""Plain C parts: `#include "part.c"` is inlined and `#if` over sizes is resolved; nothing else is rewritten.

A part compiles unchanged after its preamble (preamble.py), so that linters check the code that is shipped. A condition
is an integer expression of C in the sizes and features of the package (0: absent); a name that the package does not
define is an error, as it is for a compiler with -Wundef.

What parts include as ``generated/<name>.c`` is written here: products with the stage matrices, tables of their
structure. So are the elementary functions that a package contains, of which a unit has those that it calls.

Names inside the unit differ from all names of its header. The header declares <name>_..., where <name> is the user's;
names inside the unit are short and the same in every package. Both can be one word: the package "ny" declares NY_N, the
number of its intervals, and NY_N is also the short name of the number of terminal residuals. The inner name, of a
macro, function, variable or member, then ends in "_".
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.ir.print_c import CStyle, print_routine
from nmpc_codegen.lowering.pruning.text import blanked

_INCLUDE = re.compile(r'^#include "([\w/]+\.c)".*\n', re.MULTILINE)
_DIRECTIVE = re.compile(r"#(if|elif|else|endif)\b\s*(.*)")
_ANY_DIRECTIVE = re.compile(r"\s*#\s*(?:if|elif|else|endif)")
_WORD = re.compile(r"[A-Za-z_]\w*")
_DEFINITION = re.compile(
    r"^#define (\w+)|^typedef \w+ (\w+);|^(?:static|LANES_INLINE) [\w *]*?\b(\w+)[(\[]", re.MULTILINE
)
_BRACES = re.compile(r"[{}]")
_WORDS = re.compile(r"\b(?:and|or|not|if|else|in|is|lambda|True|False|None)\b")
_BINARY: dict[type[ast.AST], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


def template_directory() -> Path:
    """Templates inside the installed package, or at the top of a source checkout."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "templates"
    return packaged if packaged.is_dir() else here.parents[3] / "templates"


def read_part(path: str, generated: Callable[[str], str]) -> str:
    """Text of a part below templates/, with the parts that it includes; ``generated`` returns the generated ones."""
    text, *included = _pieces(path)
    for include, following in zip(included[::2], included[1::2], strict=True):
        inner = generated(include) if include.startswith("generated/") else read_part(include, generated)
        text += inner.rstrip("\n") + "\n" + following
    return text


@cache
def _pieces(path: str) -> tuple[str, ...]:
    """Text of a file below templates/, the path of the part that follows, text after it, and so on."""
    return tuple(_INCLUDE.split((template_directory() / path).read_text(encoding="utf-8").rstrip("\n") + "\n"))


def needed(text: str, names: Collection[str]) -> str:
    """The paragraphs of a text that define these names, or names in such paragraphs, in the order of the text."""
    paragraphs = [p for p in text.strip("\n").split("\n\n") if p]
    defined = {name: i for i, p in enumerate(paragraphs) for name in _defined(p)}
    kept: set[int] = set()
    found = {defined[name] for name in names if name in defined}
    while found:
        kept |= found
        words = {word for i in found for word in _WORD.findall(blanked(paragraphs[i]))}
        found = {defined[word] for word in words if word in defined} - kept
    return "\n\n".join(paragraphs[i].strip("\n") for i in sorted(kept))


@lru_cache(maxsize=4096)
def _defined(paragraph: str) -> tuple[str, ...]:
    """Names of the macros, types, tables and functions that a paragraph defines."""
    return tuple(next(filter(None, found)) for found in _DEFINITION.findall(paragraph))


class _Line(NamedTuple):
    """A line, what of it is a directive ("" if none is), and its braces of code."""

    text: str
    directive: str
    braces: tuple[str, ...]


@dataclass
class _Open:
    """An open `#if`: is its present branch kept, was one kept, did `#else` occur; depth of the braces around it."""

    counts: bool
    done: bool
    last: bool
    depth: int


def resolve(text: str, sizes: Mapping[str, int]) -> str:
    """The text with every `#if` resolved: the directives and all lines that a compiler would skip are removed.

    Raises:
        ValueError: a condition is not an integer expression; a name has no value; conditional directives other than
            `#if`, `#elif`, `#else`, `#endif` occur or do not match; a branch opens a brace without closing it or closes
            one that it has not opened.
    """
    kept: list[str] = []
    stack: list[_Open] = []
    depth = 0
    for number, line in enumerate(_scanned(text), 1):
        try:
            if line.directive:
                _decide(line.directive, stack, depth, sizes)
                continue
            for brace in line.braces:
                depth += 1 if brace == "{" else -1
                if stack and depth < stack[-1].depth:
                    raise ValueError("a branch of an #if closes a brace that it has not opened")
        except ValueError as error:
            raise ValueError(f"line {number}, {line.text.strip()!r}: {error}") from error
        if not stack or stack[-1].counts:  # a branch counts only if those around it do
            kept.append(line.text)
    if stack:
        raise ValueError("#if without #endif")
    return "\n".join(kept) + "\n"


@lru_cache
def _scanned(text: str) -> tuple[_Line, ...]:
    """The lines of a part; most parts are the same in every package."""
    pairs = zip(text.splitlines(), blanked(text).splitlines(), strict=True)
    return tuple(
        _Line(line, code if _ANY_DIRECTIVE.match(code) else "", tuple(_BRACES.findall(code))) for line, code in pairs
    )


def _decide(line: str, stack: list[_Open], depth: int, sizes: Mapping[str, int]) -> None:
    """Open a branch, or end one and begin the next."""
    directive = _DIRECTIVE.match(line)
    if directive is None:
        raise ValueError("expected #if, #elif, #else or #endif at the start of a line")
    word, condition = directive.groups()
    if word in ("else", "endif") and condition.strip():
        raise ValueError(f"expected nothing after #{word}")
    if word == "if":
        holds = all(branch.counts for branch in stack) and evaluate(condition, sizes)
        stack.append(_Open(holds, holds, False, depth))
        return
    if not stack:
        raise ValueError(f"#{word} without #if")
    branch = stack.pop()
    if depth != branch.depth:
        raise ValueError("the branch of an #if that ends here opens a brace without closing it")
    if word == "endif":
        return
    if branch.last:
        raise ValueError(f"#{word} after #else")
    open_ = not branch.done and all(outer.counts for outer in stack)
    holds = open_ and (word == "else" or evaluate(condition, sizes))
    stack.append(_Open(holds, branch.done or holds, word == "else", depth))


def evaluate(condition: str, sizes: Mapping[str, int]) -> bool:
    """Value of an integer expression of C with the operators + - * == != < <= > >= ! && || and parentheses.

    Python parses it, with `!` replaced by `~`, which binds as tightly; C's own `~` is not allowed here.
    """
    return bool(_value(_expression(condition), sizes))


@lru_cache(maxsize=1024)
def _expression(condition: str) -> ast.expr:
    """The condition as Python reads it; most conditions are the same in every package."""
    text = re.sub(r"/\*.*?\*/", "", condition).strip()
    if "~" in text or _WORDS.search(text):
        raise ValueError(f"#if {condition}: not an integer expression")
    text = re.sub(r"!(?!=)", "~", text).replace("&&", " and ").replace("||", " or ")
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError as error:
        raise ValueError(f"#if {condition}: not an integer expression") from error


def _value(node: ast.AST, sizes: Mapping[str, int]) -> int:
    match node:
        case ast.Constant(value=int(number)):
            return number
        case ast.Name(id=name):
            if name not in sizes:
                raise ValueError(f"#if: {name} has no value in this package")
            return sizes[name]
        case ast.UnaryOp(op=ast.Invert(), operand=operand):
            return int(not _value(operand, sizes))
        case ast.BoolOp(op=ast.And(), values=values):
            return int(all(_value(v, sizes) for v in values))
        case ast.BoolOp(op=ast.Or(), values=values):
            return int(any(_value(v, sizes) for v in values))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _BINARY[type(op)](_value(left, sizes), _value(right, sizes))
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _BINARY:
            return int(_BINARY[type(op)](_value(left, sizes), _value(right, sizes)))
    raise ValueError(f"#if: {ast.unparse(node)} is not supported")


# -- parts that are generated ------------------------------------------------------------------------------------------


def products(module: CModule, style: CStyle) -> str:
    """The products with a vector that the package calls, after the tables that the loops of all products read."""
    routines = module.products.called_vectors(module.features).values()
    heading = (
        "/* Products with the stage matrices S = [A B] and Q (lower triangle): "
        + ("written out over the structural nonzeros." if module.products.written_out else "dense loops.")
        + " */"
    )
    called = [print_routine(r, style) for r in routines]
    read = {name: of for name, of in module.products.tables.items() if any(f"{name}[" in text for text in called)}
    tables = _tables(read)
    if tables:
        tables = "/* Structural nonzeros (row, column) of the lower triangles Q and Q_N. */\n" + tables
    return _paragraphs(heading, tables, *called)


def product_columns(module: CModule, style: CStyle) -> str:
    """The products with a panel of columns of G_k."""
    routines = (print_routine(r, style) for r in module.products.panels.values())
    return _paragraphs("/* Products with a panel of columns of G_k. */", *routines)


def hessian_blocks(module: CModule, style: CStyle) -> str:
    """Irreducible blocks of Q and Q_N: a table of the rows of all blocks, and of where each block begins in it."""
    blocks = {"Q": module.products.Q_blocks, "Q_N": module.products.Q_N_blocks}
    numbers = ", ".join(f"{name}_BLOCKS = {len(found)}" for name, found in blocks.items())
    tables: dict[str, Iterable[int]] = {}
    for name, found in blocks.items():
        tables[f"{name}_block_row"] = [i for block in found for i in block]
        tables[f"{name}_block_first"] = [0, *accumulate(map(len, found))]
    heading = "/* Irreducible blocks of Q and Q_N: the rows of all blocks, and where each block begins among them. */"
    return "\n".join([heading, f"enum {{ {numbers} }};", _tables(tables)])


#: Path of an include -> its text.
GENERATED: Mapping[str, Callable[[CModule, CStyle], str]] = {
    "generated/products.c": products,
    "generated/product_columns.c": product_columns,
    "generated/hessian_blocks.c": hessian_blocks,
}


#: The elementary functions of a package, and those of them that lanes have too.
MATH, MATH_IN_LANES = "math/own.c", "math/functions.c"
_FUNCTION = re.compile(r"^static (?:inline )?real_t own_(\w+)\(", re.MULTILINE)
_HEADING = f"/* ==== elementary functions {'=' * 79} */"


def own_text(part: str, sizes: Mapping[str, int]) -> str:
    """A part of the elementary functions with what it includes."""
    return resolve(read_part(part, lambda path: ""), sizes)


@cache
def own_names(part: str = MATH) -> frozenset[str]:
    """Functions of math.h that have a text of their own."""
    in_math_h = {operation.function for operation in OPERATIONS.values()}
    return frozenset(_FUNCTION.findall(read_part(part, lambda path: ""))) & in_math_h


def own_math(module: CModule, names: Collection[str]) -> str:
    """The elementary functions that a unit with these identifiers calls; lanes need some of them as well."""
    if not (module.features.own_math or module.sizes["LANE_NODES"]):
        return ""
    text = needed(own_text(MATH, module.sizes), names)
    return f"{_HEADING}\n\n{text}\n" if text else ""


def _tables(tables: Mapping[str, Iterable[int]]) -> str:
    texts = {name: list(map(str, values)) for name, values in tables.items()}
    return "\n".join(f"static const int {name}[{len(v)}] = {{ {', '.join(v)} }};" for name, v in texts.items())


def _paragraphs(*texts: str) -> str:
    return "\n\n".join(text for text in texts if text) + "\n"


# -- names of the unit -------------------------------------------------------------------------------------------------

_INNER = re.compile(r"\bAPI\(\w+\)|[A-Za-z_]\w*")

#: Types of <stdint.h> in the header, which are not the package's even if it is called "int32".
STANDARD = frozenset({"int32_t"})


def names_in(*texts: str) -> set[str]:
    """The identifiers of C texts."""
    return {name for text in texts for name in _WORD.findall(text)}


def renamed_words(words: Collection[str], header: str, name: str, members: Collection[str] = ()) -> Mapping[str, str]:
    """Inner name -> new name, for those of ``words`` that the header of the package ``name`` declares.

    ``members``: words of the header that belong to its structs alone.
    """
    prefixes = (f"{name}_", f"{name.upper()}_")
    declared = {w for w in names_in(blanked(header)) if w.startswith(prefixes)} - set(members) - STANDARD
    found: dict[str, str] = {}
    for word in sorted(declared.intersection(words)):
        inner = f"{word}_"
        while inner in words or inner in declared:
            inner += "_"
        found[word] = inner
    return found


def rename(text: str, words: Mapping[str, str]) -> str:
    """The text of a unit with new inner names; API(f), the name of a function of the header, stays."""
    return _INNER.sub(lambda found: words.get(found[0], found[0]), text) if words else text
