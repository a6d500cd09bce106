"""The structs of a package: members that components state, as far as the package has them, and data set at run time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from nmpc_codegen.components.base import Dims, Extra
from nmpc_codegen.components.core import core_structs, structs_of_others
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Setting
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.memory import Field, Size, Struct
from nmpc_codegen.package.signals import Kind, Layout


def lowered_structs(model: Model, dims: Dims, features: Features, whole: bool) -> tuple[Struct, ...]:
    nodes = Size("N + 1", dims.N.value + 1)
    more = problem_names(model.problem)
    common = [
        Field("x", (nodes, dims.nx), f"states of the plan{more}", "iterate"),
        Field("u", (dims.N, dims.nu), "controls of the plan", "iterate"),
        *_inner_fields(dims),
        *(setting.field for setting in settings(model, dims, whole)),
        *_penalties_in_use(settings(model, dims, whole)),
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
    what = "controller" if dims.estimation is None else "estimator"
    solver = Struct("solver", f"the whole {what}: no pointers, copy it with '='", fields)
    return (*inner, solver if whole else _existing(solver, features))


def _penalties_in_use(found: Iterable[Setting]) -> list[Field]:
    """Penalties that the last preparation has taken over from those that were set."""
    return [
        Field(
            f"penalty_{name}",
            setting.field.shape,
            "the same in the prepared QP",
            "keep",
            only=lambda f: f.takes_penalties,
        )
        for name in ("l1", "l2")
        for setting in found
        if setting.field.name == f"soft_{name}"
    ]


def problem_names(problem: Problem) -> str:
    """What stands behind the states of the user, for a comment."""
    names = problem.state_names[problem.measured :]
    return f"; behind those of the user {', '.join(names)}" if names else ""


def _inner_fields(dims: Dims) -> list[Field]:
    """What is known of the sample before."""
    return [
        Field("previous", (dims.nu,), "controls applied last", "keep", only=lambda f: f.previous),
        Field("time", (), "time of the next sample", "keep", only=lambda f: f.timed),
        Field("time_rest", (), "its rounding error", "keep", only=lambda f: f.timed),
    ]


def _existing(struct: Struct, features: Features) -> Struct:
    """The struct without members that the package lacks: those of size 0, and of features that it does not have."""
    fields = (replace(f, only=None) for f in struct.fields if all(f.values) and (f.only is None or f.only(features)))
    return replace(struct, fields=tuple(fields), only=None)


def _merge(owned: Iterable[Struct]) -> dict[str, Struct]:
    """Name -> struct with the members that all components give it."""
    found: dict[str, Struct] = {}
    for struct in owned:
        first = found.setdefault(struct.name, struct)
        members = {f.name: f for f in reversed((*first.fields, *struct.fields))}
        found[struct.name] = replace(first, fields=tuple(members.values())[::-1])
    return found


def _after_members(stated: Mapping[str, Struct]) -> list[Struct]:
    """The structs that the solver contains, each one after its members."""
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
    """The structs of the core and of the components, with members that this package may lack."""
    core = core_structs(model.parts.algorithm.core, dims)
    more = [s for extra in extras(model, features) for s in extra.structs(dims)]
    owned = (s for c in model.parts.components for s in c.structs(dims))
    return [*core, *owned, *more, *structs_of_others(dims)]


def extras(model: Model, features: Features) -> tuple[Extra, ...]:
    """What runs at hooks: for the other components, and then for the algorithm."""
    return tuple(extra for component in model.parts.components for extra in component.extras(features))


def absent_members(
    model: Model, dims: Dims, features: Features, structs: tuple[Struct, ...]
) -> frozenset[tuple[str, str]]:
    """(struct, member) of what components state and no struct of the package has."""
    stated = _stated_structs(model, dims, features)
    members = {(s.name, f.name) for s in stated for f in s.fields} | {("solver", s.name) for s in stated}
    return frozenset(members - {(s.name, f.name) for s in structs for f in s.fields})


def settings(model: Model, dims: Dims, whole: bool) -> tuple[Setting, ...]:
    """Members for the data that can be changed at run time; fixed data have none."""
    p, layouts = model.problem, model.options.online.layouts
    weight = (dims.ny,) if p.path.diagonal_weight else (dims.ny, dims.ny)
    weight_N = (dims.ny_N,) if p.terminal.diagonal_weight else (dims.ny_N, dims.ny_N)
    one, soft = Size("1", 1), Size("SOFT_ROWS", sum(row.soft is not None for row in p.rows))
    path: Mapping[Layout, Size] = {"shared": one, "node": dims.N}
    every: Mapping[Layout, Size] = {"shared": Size("2", 2), "node": Size("N + 1", dims.N.value + 1)}
    which = {"shared": "path, terminal", "node": "every node"}

    def setting(
        option: Kind, name: str, table: str, shape: tuple[Size, ...], copies: Mapping[Layout, Size] | None, doc: str
    ) -> list[Setting]:
        entries = {"W": dims.nw, "W_N": dims.nw_N}.get(name, shape[0])
        layout = "shared" if whole and layouts[option] == "fixed" else layouts[option]
        if layout == "fixed" or not (entries.value or whole):
            return []
        count = copies[layout] if copies else one
        leading = (count,) if copies else ()
        suffix = f": {which[layout]}" if option in ("bounds", "soft") else ""
        return [Setting(Field(name, (*leading, *shape), doc + suffix, "setting"), table, count, entries)]

    return (
        *setting("parameter", "p", "default_parameter", (dims.np,), every, "parameters"),
        *_parameters_to_come(p, dims, whole),
        *setting("reference", "yref", "default_reference", (dims.ny,), path, "references of the path residual"),
        *setting(
            "reference",
            "yref_N",
            "default_terminal_reference",
            (dims.ny_N,),
            None,
            "reference of the terminal residual",
        ),
        *setting("weight", "W", "default_weight", weight, path, f"weight of the path residual{_scaling_note(p)}"),
        *setting("weight", "W_N", "default_terminal_weight", weight_N, None, "weight of the terminal residual"),
        *setting("bounds", "lower", "default_lower", (dims.nr,), every, "lower bounds of the rows"),
        *setting("bounds", "upper", "default_upper", (dims.nr,), every, "upper bounds of the rows"),
        *setting("soft", "soft_l1", "default_soft_l1", (soft,), every, "penalties l1 v of the soft rows"),
        *setting("soft", "soft_l2", "default_soft_l2", (soft,), every, "penalties l2/2 v^2 of the soft rows"),
    )


def _parameters_to_come(p: Problem, dims: Dims, whole: bool) -> list[Setting]:
    """Of an estimator, whose window keeps those that held before."""
    if p.estimation is None or not (p.own_parameters or whole):
        return []
    member = Field("next", (dims.np,), "parameters from the next sample on", "setting")
    return [Setting(member, "default_parameter", Size("1", 1), dims.np)]


def _scaling_note(p: Problem) -> str:
    """Which weights are multiplied by the length of the interval where they are used, for a comment."""
    names = [name for name, scaled in zip(p.path.y_names, p.path.scale_with_dt, strict=True) if scaled]
    if not names:
        return ""
    which = "" if len(names) == p.path.ny else f" of {', '.join(names)}"
    return f"; that{which} is multiplied by dt_k in use"
