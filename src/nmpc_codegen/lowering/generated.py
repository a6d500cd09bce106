"""Text that parts include as ``generated/<name>.c``: products with the stage matrices, tables of their structure.

Also the elementary functions that a package contains, of which a unit has those that it calls.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from itertools import accumulate

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.ir.print_c import CStyle
from nmpc_codegen.ir.print_sweep import print_routine
from nmpc_codegen.lowering.parts import needed, read_part, resolve


def products(module: CModule, style: CStyle) -> str:
    """The products with a vector that the package calls, after the tables that the loops of all products read."""
    routines = module.products.called_vectors(module.switches).values()
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


def of_host(module: CModule, style: CStyle) -> str:
    """Nothing: only units for a host have this part, and replace it (host/unit.py)."""
    return ""


#: Path of an include -> its text.
GENERATED: Mapping[str, Callable[[CModule, CStyle], str]] = {
    "generated/lane_transpose.c": of_host,
    "generated/lane_functions.c": of_host,
    "generated/lane_kernels.c": of_host,
    "generated/lane_nodes.c": of_host,
    "generated/products.c": products,
    "generated/product_columns.c": product_columns,
    "generated/hessian_blocks.c": hessian_blocks,
}


#: The elementary functions of a package, and those of them that lanes have too.
MATH, MATH_IN_LANES = "math/own.c", "math/functions.c"
_FUNCTION = re.compile(r"^static (?:inline )?real_t own_(\w+)\(", re.MULTILINE)
_HEADING = f"/* ==== elementary functions {'=' * 79} */"


def own_text(part: str, sizes: Mapping[str, int], resolved: bool = True) -> str:
    """A part of the elementary functions with what it includes."""
    text = read_part(part, lambda path: "")
    return resolve(text, sizes) if resolved else text


@cache
def own_names(part: str = MATH) -> frozenset[str]:
    """Functions of math.h that have a text of their own."""
    in_math_h = {operation.function for operation in OPERATIONS.values()}
    return frozenset(_FUNCTION.findall(own_text(part, {}, resolved=False))) & in_math_h


def own_math(module: CModule, names: Collection[str], resolved: bool = True) -> str:
    """The elementary functions that a unit with these identifiers calls; lanes need some of them as well."""
    if not (module.switches["OWN_MATH"] or module.switches["LANE_NODES"]):
        return ""
    text = needed(own_text(MATH, module.sizes, resolved), names)
    return f"{_HEADING}\n\n{text}\n" if text else ""


def _tables(tables: Mapping[str, Iterable[int]]) -> str:
    texts = {name: list(map(str, values)) for name, values in tables.items()}
    return "\n".join(f"static const int {name}[{len(v)}] = {{ {', '.join(v)} }};" for name, v in texts.items())


def _paragraphs(*texts: str) -> str:
    return "\n\n".join(text for text in texts if text) + "\n"
