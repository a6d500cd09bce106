"""assemble() returns the items of a unit in order: short names, tables, elementary functions, kernels, parts.

It includes everything that some package may need; the passes remove what this package does not need.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate

from nmpc_codegen.ir.cmodule import CModule, Table
from nmpc_codegen.ir.kernel import called_lookups
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.lookups import print_lookups
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.directives import resolve
from nmpc_codegen.lowering.lanes.nodes import GENERATED as IN_LANES
from nmpc_codegen.lowering.rows import row_functions, row_ranges
from nmpc_codegen.lowering.templates import context, environment
from nmpc_codegen.lowering.unit.hooks import call_hooks, check_hooks, hook_prototypes
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.macros import definitions
from nmpc_codegen.lowering.unit.names import rename
from nmpc_codegen.lowering.unit.read import MATH, items_of, read_part
from nmpc_codegen.package.signals import Layout

#: The part with the stages of implicit schemes, and with the functions of an interval that call them.
INTERVALS = "integrators/implicit/intervals.c"
#: The part with the search of look-up tables.
SEARCH = "core/lookup.c"


def assemble(module: CModule) -> tuple[Item, ...]:
    """Return the items of a package."""
    style = module.style
    return (
        *definitions(module),
        *table_items(module.tables, style),
        *_elementary(module),
        section("kernels"),
        *kernel_items(module.routines, style),
        *_items_of_parts(module),
    )


def section(title: str) -> Item:
    """Return the heading of a part of the unit."""
    return Item("", "section", f"/* ==== {title} {'=' * (100 - len(title))} */")


def kernel_items(routines: Sequence[Routine], style: CStyle) -> list[Item]:
    """Return the functions of look-up tables that routines call, and the routines that call no part."""
    lookups = print_lookups(called_lookups(routines))
    texts = {"find_interval": read_part(SEARCH).rstrip()} if lookups else {}
    alone = (r for r in routines if not (isinstance(r, LoopedRoutine) and r.calls_parts))
    texts |= lookups | {routine.name: print_routine(routine, style) for routine in alone}
    return [Item(name, "function", text, state="ready") for name, text in texts.items()]


def table_items(tables: Iterable[Table], style: CStyle) -> list[Item]:
    """Return tables of numbers."""
    return [Item(t.name, "table", _table(t, style), apart=False) for t in tables]


def _table(table: Table, style: CStyle) -> str:
    if table.ctype == "real":
        text = _definition("real_t", table.name, [_value(v, style) for v in table.values])
    else:
        text = _definition("int", table.name, list(map(str, table.values)))
    return f"/* {table.doc} */\n{text}"


def _definition(ctype: str, name: str, values: Sequence[str]) -> str:
    return f"static const {ctype} {name}[{len(values)}] = {{ {', '.join(values)} }};"


def _value(value: float, style: CStyle) -> str:
    if math.isinf(value):
        return f"{'-' if value < 0 else ''}({style.real})INFINITY"
    return style.literal(value)


def _elementary(module: CModule) -> list[Item]:
    """Return the elementary functions, if the package has its own; lanes need some of them as well."""
    if not (module.features.own_math or module.sizes["LANE_NODES"]):
        return []
    items = items_of(read_part(MATH, sizes=module.sizes))
    return [section("elementary functions"), *(replace(item, state="ready") for item in items)]


def _items_of_parts(module: CModule) -> Iterator[Item]:
    """Yield the items of the parts and of their includes, with the calls of hooks."""
    hooked_parts = module.hooked_parts

    def generate(path: str) -> str:
        return GENERATED[path](module)

    def part(path: str) -> Iterator[Item]:
        for item in _items(read_part(path, generate, module.decided), module):
            yield _with_states(call_hooks(item, hooked_parts), module)

    yield from part("core/sizes.c")
    for title in module.stage_parts:
        yield section(title)
        yield from part(INTERVALS)
    for path in ("core/rows.c", "core/cost.c", "core/augmented.c"):
        yield from part(path)
    if module.features.products:
        yield section("stage products")
        yield from _items(products(module), module)
    for found in module.sections:
        yield section(found.title)
        yield from part(found.template)
    check_hooks(read_part(module.sections[-1].template, lambda include: ""), hooked_parts)
    yield from part("core/algebraic.c")
    yield section("settings and results")
    yield from _items(_interface(module), module)


def _items(text: str, module: CModule) -> tuple[Item, ...]:
    """Return the items of a text; a whole package is one item, because the compiler resolves its `#if`."""
    return (Item("", "directive", text.rstrip("\n")),) if module.whole else items_of(text)


def _interface(module: CModule) -> str:
    """Return the functions that the application calls besides those of the algorithm."""
    layouts = module.layouts
    names = context(module.name, module.style) | {
        "m": module,
        "copies": lambda option: _copies(layouts[option], option in ("reference", "weight")),
    }
    text = environment().get_template("package/api.c.jinja").render(names)
    return resolve(text, module.decided)


def _copies(layout: Layout, path_only: bool) -> str:
    """Return lowest and highest node with its own copy, and the number of copies, as C text."""
    if layout == "node":
        return "0, N - 1, N" if path_only else "0, N, N + 1"
    return "0, -1, 1" if path_only else "N, N, 2"


def _with_states(item: Item, module: CModule) -> Item:
    """Replace NXHAT by NX if the user's states are all states."""
    if module.features.augmented or "NXHAT" not in item.words:
        return item
    return replace(item, text=rename(item.text, {"NXHAT": "NX"}))


def constants_of(module: CModule) -> Constants:
    """Return everything that the package decides at export.

    These are sizes, features, ranges of integer tables and of row data, and missing members and kernels.
    """
    kernels = frozenset(name.upper() for name in module.absent_kernels)
    named = {s.name for s in module.structs}
    types = {(s.name, f.name): f.ctype for s in module.structs for f in s.fields if f.ctype in named}
    ranges = table_ranges(module.tables) | row_ranges(module)
    return Constants(module.sizes, ranges, module.absent_members, types, kernels)


def table_ranges(tables: Iterable[Table]) -> dict[str, tuple[int, int]]:
    """Return {table of integers: (least, greatest entry)}."""
    return {t.name: (int(min(t.values)), int(max(t.values))) for t in tables if t.ctype == "int" and t.values}


# -- parts that are generated ------------------------------------------------------------------------------------------


def products(module: CModule) -> str:
    """Return the products with a vector that the package calls, after the tables that loops of all products read."""
    routines = module.products.called_vectors(module.features).values()
    heading = (
        "/* Products with the stage matrices S = [A B] and Q (lower triangle): "
        + ("written out over the structural nonzeros." if module.products.written_out else "dense loops.")
        + " */"
    )
    called = [print_routine(r, module.style) for r in routines]
    read = {name: of for name, of in module.products.tables.items() if any(f"{name}[" in text for text in called)}
    tables = _tables(read)
    if tables:
        tables = "/* Structural nonzeros (row, column) of the lower triangles Q and Q_N. */\n" + tables
    return _paragraphs(heading, tables, *called)


def product_columns(module: CModule) -> str:
    """Return the products with a panel of columns of G_k."""
    routines = (print_routine(r, module.style) for r in module.products.panels.values())
    return _paragraphs("/* Products with a panel of columns of G_k. */", *routines)


def hessian_blocks(module: CModule) -> str:
    """Return tables of the irreducible blocks of Q and Q_N: rows of all blocks, and the beginning of each block."""
    blocks = {"Q": module.products.Q_blocks, "Q_N": module.products.Q_N_blocks}
    numbers = ", ".join(f"{name}_BLOCKS = {len(found)}" for name, found in blocks.items())
    tables: dict[str, Iterable[int]] = {}
    for name, found in blocks.items():
        tables[f"{name}_block_row"] = [i for block in found for i in block]
        tables[f"{name}_block_first"] = [0, *accumulate(map(len, found))]
    heading = "/* Irreducible blocks of Q and Q_N: the rows of all blocks, and where each block begins among them. */"
    return "\n".join([heading, f"enum {{ {numbers} }};", _tables(tables)])


def print_intervals(routines: Iterable[Routine], style: CStyle) -> str:
    """Return those of the routines that call functions of C files and therefore follow these functions."""
    called = (r for r in routines if isinstance(r, LoopedRoutine) and r.calls_parts)
    return _paragraphs(*(print_routine(r, style) for r in called))


def _tables(tables: Mapping[str, Iterable[int]]) -> str:
    return "\n".join(_definition("int", name, list(map(str, values))) for name, values in tables.items())


def _paragraphs(*texts: str) -> str:
    return "\n\n".join(text for text in texts if text) + "\n"


def _rows(module: CModule) -> str:
    return environment().get_template("core/rows.c.jinja").render(row_functions(module))


def _hooked_text(module: CModule) -> str:
    """Return the files of the hooked parts."""
    return "\n\n".join(read_part(part, sizes=module.decided).rstrip("\n") for part in module.hooked_parts) + "\n"


#: Path of an include -> function that returns its text.
GENERATED: Mapping[str, Callable[[CModule], str]] = {
    "generated/rows.c": _rows,
    "generated/intervals.c": lambda module: print_intervals(module.routines, module.style),
    "generated/products.c": products,
    "generated/product_columns.c": product_columns,
    "generated/hessian_blocks.c": hessian_blocks,
    "generated/hooks.c": lambda module: hook_prototypes(module.hooked_parts),
    "generated/hooked.c": _hooked_text,
    **IN_LANES,
}
