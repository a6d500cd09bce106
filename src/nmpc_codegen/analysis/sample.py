"""The worst case of a sample bounds the operations of its phases from the C text only."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from nmpc_codegen.analysis.interpret import UnboundedError, WorstCase
from nmpc_codegen.analysis.source import Type, Unit, constants, defined_macros, functions, struct_members, tables
from nmpc_codegen.errors import OptionError
from nmpc_codegen.package.description import PackageDescription

# The comment over a printed kernel states its operations, e.g. "159 add, 160 mul, 16 call */".
_COUNT = r"\d+ (?:add|mul|div|sqrt|call|other)"
_KERNEL = re.compile(rf"[ :]((?:{_COUNT}, )*{_COUNT}|no operations) \*/\nstatic \w+ (\w+)\(")
#: Folder of the code of another generator.
FOREIGN = "osqp/"
#: Text that declares a vector of GNU C.
VECTORS = "vector_size("

_NUMBER = re.compile(r"\d+")


def bound(package: Mapping[str, str]) -> dict[str, int]:
    """Compute the bounds; see analysis.worst_case()."""
    description = _description(package)
    if any(path.startswith(FOREIGN) for path in package):
        raise OptionError(f"{description.name} contains foreign code, whose worst case is unknown; choose another qp")
    if VECTORS in package[f"{description.name}.c"]:
        raise OptionError(
            f"{description.name} is written in GNU C for {description.target}, whose vectors compute several nodes at "
            'once; the worst case is known of portable C: generate it with Options(target="portable")'
        )
    unit = unit_of(package, description)
    try:
        worst = _bound(unit, description)
        if "most_iterations" in description.members("solver"):
            ranges = {**description.ranges, "most_iterations": (1, 1), "in_solve": (0, 0)}
            worst["one iteration"] = _bound(replace(unit, ranges=ranges), description)["sample"]
    except UnboundedError as error:
        raise OptionError(f"{description.name}: the worst case of a sample is unknown: {error}") from error
    return worst


def _bound(unit: Unit, description: PackageDescription) -> dict[str, int]:
    found = WorstCase(unit)
    if not description.has_phases:
        return {"sample": found.operations(f"api_{description.kind.law}")}
    worst = {phase: found.operations(f"api_{phase}") for phase in ("prepare", "feedback")}
    return worst | {"sample": sum(worst.values())}


def _description(package: Mapping[str, str]) -> PackageDescription:
    """Return the description of the only package among these files."""
    stems = (path[:-2] for path in package if path.endswith(".h"))
    names = [stem for stem in stems if {f"{stem}.c", f"{stem}.json"} <= set(package)]
    if len(names) != 1:
        found = ", ".join(names) or "none"
        raise OptionError(f"worst_case(): expected the .h, .c and .json of one package, found those of {found}")
    return PackageDescription.from_json(package[f"{names[0]}.json"])


def unit_of(package: Mapping[str, str], description: PackageDescription) -> Unit:
    """Return the facts on names in the text of a package."""
    header, source = (package[f"{description.name}.{ext}"] for ext in ("h", "c"))
    members: dict[str, list[Type]] = {}
    for text in (header, source):
        for name, types in struct_members(text).items():
            members.setdefault(name, []).extend(types)
    return Unit(
        functions=functions(source),
        macros=defined_macros(header) | defined_macros(source),
        counts={name: sum(map(int, _NUMBER.findall(count))) for count, name in _KERNEL.findall(source)},
        sizes=constants(header) | constants(source),
        tables=tables(source),
        ranges=description.ranges,
        members=members,
    )
