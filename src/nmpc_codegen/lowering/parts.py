"""Plain C parts: `#include "part.c"` is inlined, `#if` over sizes is resolved (pruning/directives.py).

A part compiles as it stands after the preamble of a whole package (lower(whole=True)), so that linters check the code
that is shipped. A condition is an integer expression of C in the sizes and features of the package (0: absent).

What parts include as ``generated/<name>.c`` is written here: products with the stage matrices, tables of their
structure. So are the elementary functions that a package contains, of which a unit has those that it calls.

Names inside the unit differ from all names of its header. The header declares <name>_..., where <name> is the user's;
names inside the unit are short and the same in every package. Both can be one word: the package "ny" declares NY_N, the
number of its intervals, and NY_N is also the short name of the number of terminal residuals. The inner name, of a
macro, function, variable or member, then ends in "_".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache, lru_cache
from itertools import accumulate
from pathlib import Path

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.lowering.pruning.directives import resolve
from nmpc_codegen.lowering.pruning.scopes import blank

_WORD = re.compile(r"[A-Za-z_]\w*")
_INCLUDE = re.compile(r'^#include "([\w/]+\.c)".*\n', re.MULTILINE)
_ENUMERATION = re.compile(r"\benum \{([^}]*)\}")
_DEFINITION = re.compile(
    r"^#define (\w+)|^typedef \w+ (\w+);|^(?:static|LANES_INLINE) [\w *]*?\b(\w+)[(\[]", re.MULTILINE
)


def template_directory() -> Path:
    """Templates inside the installed package, or at the top of a source checkout."""
    here = Path(__file__).resolve()
    packaged = here.parents[1] / "templates"
    return packaged if packaged.is_dir() else here.parents[3] / "templates"


def read_part(path: str, generated: Callable[[str], str], sizes: Mapping[str, int] | None = None) -> str:
    """Text of a part below templates/, with the parts that it includes; ``generated`` returns the generated ones.

    ``sizes``: `#if` is resolved; None: it is left to the compiler.
    """
    whole = _file(path)
    text, *included = _INCLUDE.split(whole if sizes is None else resolve(whole, sizes))
    for include, following in zip(included[::2], included[1::2], strict=True):
        inner = generated(include) if include.startswith("generated/") else read_part(include, generated, sizes)
        text += inner.rstrip("\n") + "\n" + following
    return text


@cache
def _file(path: str) -> str:
    """Text of a file below templates/."""
    return (template_directory() / path).read_text(encoding="utf-8").rstrip("\n") + "\n"


def needed_paragraphs(text: str, names: Collection[str]) -> str:
    """The paragraphs of a text that define these names, or names in such paragraphs, in the order of the text."""
    paragraphs = [p for p in text.strip("\n").split("\n\n") if p]
    defined = {name: i for i, p in enumerate(paragraphs) for name in _defined_names(p)}
    kept: set[int] = set()
    found = {defined[name] for name in names if name in defined}
    while found:
        kept |= found
        words = {word for i in found for word in _WORD.findall(blank(paragraphs[i]))}
        found = {defined[word] for word in words if word in defined} - kept
    return "\n\n".join(paragraphs[i].strip("\n") for i in sorted(kept))


def defined_names(text: str) -> set[str]:
    """Names of the macros, types, tables, functions and constants that a text defines."""
    code = blank(text)
    constants = {word for body in _ENUMERATION.findall(code) for word in _WORD.findall(re.sub(r"=[^,]*", "", body))}
    return {name for paragraph in code.split("\n\n") for name in _defined_names(paragraph)} | constants


@lru_cache(maxsize=4096)
def _defined_names(paragraph: str) -> tuple[str, ...]:
    """Names of the macros, types, tables and functions that a paragraph defines."""
    return tuple(next(filter(None, found)) for found in _DEFINITION.findall(paragraph))


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


def intervals(module: CModule, style: CStyle) -> str:
    """The routines that call functions of parts."""
    return print_intervals(module.routines, style)


def print_intervals(routines: Iterable[Routine], style: CStyle) -> str:
    """Those of the routines that call functions of parts, and therefore follow them."""
    called = (r for r in routines if isinstance(r, LoopedRoutine) and r.calls_parts)
    return _paragraphs(*(print_routine(r, style) for r in called))


#: Path of an include -> its text.
GENERATED: Mapping[str, Callable[[CModule, CStyle], str]] = {
    "generated/intervals.c": intervals,
    "generated/products.c": products,
    "generated/product_columns.c": product_columns,
    "generated/hessian_blocks.c": hessian_blocks,
}


#: The elementary functions of a package, and those of them that lanes have too.
MATH, MATH_IN_LANES = "math/own.c", "math/functions.c"

#: The stages of implicit schemes, with the functions of an interval that call them.
INTERVALS = "integrators/implicit/intervals.c"

#: The search of look-up tables.
SEARCH = "core/lookup.c"
_FUNCTION = re.compile(r"^static (?:inline )?real_t own_(\w+)\(", re.MULTILINE)
_HEADING = f"/* ==== elementary functions {'=' * 79} */"


def own_text(part: str, sizes: Mapping[str, int]) -> str:
    """A part of the elementary functions with what it includes."""
    return read_part(part, lambda path: "", sizes)


@cache
def own_names(part: str = MATH) -> frozenset[str]:
    """Functions of math.h that have a text of their own."""
    in_math_h = {operation.function for operation in OPERATIONS.values()}
    return frozenset(_FUNCTION.findall(read_part(part, lambda path: ""))) & in_math_h


def own_math(module: CModule, names: Collection[str]) -> str:
    """The elementary functions that a unit with these identifiers calls; lanes need some of them as well."""
    if not (module.features.own_math or module.sizes["LANE_NODES"]):
        return ""
    text = needed_paragraphs(own_text(MATH, module.sizes), names)
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
    declared = {w for w in names_in(blank(header)) if w.startswith(prefixes)} - set(members) - STANDARD
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
