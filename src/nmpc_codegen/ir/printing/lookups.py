"""Look-up tables become C functions: the search in a grid, and an entry."""

from __future__ import annotations

from collections.abc import Sequence

from nmpc_codegen.package.lookup import Lookup


def print_lookups(lookups: Sequence[Lookup]) -> dict[str, str]:
    """Return {name: text} of the functions; functions of grids call find_interval()."""
    return {lookup.function: _function(lookup) for lookup in lookups}


def _function(lookup: Lookup) -> str:
    if lookup.part == "interval":
        argument = "x"
        value = f"find_interval({lookup.table}, {len(lookup.values) - 1}, {lookup.passes}, x)"
    else:
        argument, value = "i", f"{lookup.table}[(int)i]"
    return f"static real_t {lookup.function}(real_t {argument})\n{{\n    return {value};\n}}"
