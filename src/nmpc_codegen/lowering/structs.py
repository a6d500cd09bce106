"""The structs of a package have the members that components state and this package needs, and data set at run time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from nmpc_codegen.components.base import Dims, HookedPart
from nmpc_codegen.components.core import core_structs, structs_of_others
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.stated import augmented_state
from nmpc_codegen.lowering.stated.data import penalties_in_use, settings
from nmpc_codegen.lowering.stated.probes import plan_at_saddle
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Struct


def lowered_structs(model: Model, dims: Dims, features: Features, whole: bool) -> tuple[Struct, ...]:
    nodes = dims.nodes
    more = augmented_state.problem_names(model.problem)
    found = settings(model, dims, whole)
    common = [
        Field("x", (nodes, dims.nx), f"states of the plan{more}", "iterate"),
        Field("u", (dims.N, dims.nu), "controls of the plan", "iterate"),
        *augmented_state.members(dims),
        *(setting.field for setting in found),
        *penalties_in_use(found),
    ]
    results = [
        Field("status", (), "status of the last call", "result", "int32"),
        Field("magic", (), "set by init", "keep", "int32"),
    ]
    stated = _stated_structs(model, dims, features)
    if whole:
        owned = [replace(s, fields=tuple(replace(f, only=None) for f in s.fields), only=None) for s in stated]
    else:
        owned = [_existing(s, features) for s in stated if s.only is None or s.only(features)]
    merged = _merge(s for s in owned if s.fields)
    own_members = merged.pop("solver", Struct("solver", "", ())).fields
    inner = _after_members(merged)
    held = {f.ctype for s in inner for f in s.fields} | {f.ctype for f in own_members}
    members = [Field(s.name, s.shape, s.doc, "data", s.name) for s in inner if s.name not in held and s.name != "kkt"]
    fields = (*common, *own_members, *members, *results)
    solver = Struct("solver", f"the whole {model.problem.kind.noun}: no pointers, copy it with '='", fields)
    return (*inner, solver if whole else _existing(solver, features))


def _existing(struct: Struct, features: Features) -> Struct:
    """Return the struct without members of size 0 and of features that the package lacks."""
    fields = (replace(f, only=None) for f in struct.fields if all(f.values) and (f.only is None or f.only(features)))
    return replace(struct, fields=tuple(fields), only=None)


def _merge(owned: Iterable[Struct]) -> dict[str, Struct]:
    """Return {name: struct} with the members from all components."""
    found: dict[str, Struct] = {}
    for struct in owned:
        first = found.setdefault(struct.name, struct)
        members = {f.name: f for f in reversed((*first.fields, *struct.fields))}
        found[struct.name] = replace(first, fields=tuple(members.values())[::-1])
    return found


def _after_members(stated: Mapping[str, Struct]) -> list[Struct]:
    """Return the structs that the solver contains, each one after its members."""
    order: dict[str, Struct] = {}

    def place(struct: Struct) -> None:
        for member in struct.fields:
            if member.ctype in stated:
                place(stated[member.ctype])
        order.setdefault(struct.name, struct)

    for struct in stated.values():
        place(struct)
    return list(order.values())


def _stated_structs(model: Model, dims: Dims, features: Features) -> list[Struct]:
    """Return the structs of the core and of the components, with members that this package may lack."""
    core = core_structs(model.parts.algorithm.core, dims)
    more = [s for hooked in hooked_parts(model, features) for s in hooked.structs(dims)]
    owned = (s for c in model.parts.components for s in c.structs(dims))
    return [*core, plan_at_saddle(dims), *owned, *more, *structs_of_others(dims)]


def hooked_parts(model: Model, features: Features) -> tuple[HookedPart, ...]:
    """Return the parts that run at hooks: those of the other components, then those of the algorithm."""
    return tuple(part for component in model.parts.components for part in component.hooked_parts(features))


def absent_members(
    model: Model, dims: Dims, features: Features, structs: tuple[Struct, ...]
) -> frozenset[tuple[str, str]]:
    """Return (struct, member) of everything that components state and no struct of the package has."""
    stated = _stated_structs(model, dims, features)
    members = {(s.name, f.name) for s in stated for f in s.fields} | {("solver", s.name) for s in stated}
    return frozenset(members - {(s.name, f.name) for s in structs for f in s.fields})
