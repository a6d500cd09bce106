"""Data that can be changed at run time have members that hold them, setters, and sizes of parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from nmpc_codegen.components.base import Dims
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Macro, Setter, Setting
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.package.signals import Kind, Layout, c_constants
from nmpc_codegen.package.struct_layout import Field, Size

#: Description of the node k of a setter, for every kind of data.
_NONE = "must be {all}, as all nodes share one value"
_PATH = "is 0 .. N - 1, or {all}"
_END = "is N if the row holds there, or {all} for all of its nodes"
_ROW = "is a node of the row, or {all} for all of them"
_NODES: Mapping[Kind, Mapping[Layout, str]] = {
    "reference": {"shared": _NONE, "node": _PATH},
    "weight": {"shared": _NONE, "node": _PATH},
    "parameter": {"shared": "is N for the terminal node only, or {all} for all nodes", "node": "is 0 .. N, or {all}"},
    "bounds": {"shared": _END, "node": _ROW},
    "soft": {"shared": _END, "node": _ROW},
}


def setters(model: Model) -> tuple[Setter, ...]:
    """Return the setters of all data that exist in the problem and can be changed."""
    layouts = model.options.online.layouts
    estimates = model.problem.estimation is not None
    return tuple(
        Setter(n, _NONE if estimates and n == "parameter" else nodes[layouts[n]])
        for n, nodes in _NODES.items()
        if is_set(model, n)
    )


def is_set(model: Model, kind: Kind) -> bool:
    """Return True if data of this kind exist and can be changed at run time."""
    p = model.problem
    residuals = p.path.ny + p.terminal.ny
    sizes: dict[Kind, int] = {
        "reference": residuals,
        "weight": residuals,
        "parameter": len(p.own_parameters),
        "bounds": len(p.rows),
        "soft": sum(row.soft is not None for row in p.rows),
    }
    return model.options.online.layouts[kind] != "fixed" and sizes[kind] > 0


def macros(problem: Problem) -> tuple[Macro, ...]:
    """Return the sizes of penalties, noise and bounds of parameters."""
    soft = [row for row in problem.rows if row.soft is not None]
    scaled, bounded = any(row.scaled for row in soft), any(s.low for s in problem.own_parameters)
    return (
        Macro("SOFT_ROWS", len(soft), "soft rows, which have a penalty"),
        Macro("NOISES", len(problem.noise), "controls that are process noise at the end of an interval"),
        Macro("SCALED_PENALTIES", int(scaled), "1: penalties of a row are multiplied by dt_k"),
        Macro("BOUNDED_PARAMETERS", int(bounded), "1: some parameters have bounds"),
    )


def parameter_macros(problem: Problem) -> tuple[Macro, ...]:
    """Return the number of named parameters, and their sizes."""
    parameters = problem.own_parameters
    names = c_constants([s.name for s in parameters])
    sizes = (Macro(f"SIZE_{c}", s.size, f"elements of {s.name}") for c, s in zip(names, parameters, strict=True))
    return (Macro("PARAMS", len(parameters), "number of named parameters"), *sizes)


def settings(model: Model, dims: Dims, whole: bool) -> tuple[Setting, ...]:
    """Return members for the data that can be changed at run time; fixed data have none."""
    p, layouts = model.problem, model.options.online.layouts
    weight = (dims.ny,) if p.path.diagonal_weight else (dims.ny, dims.ny)
    weight_N = (dims.ny_N,) if p.terminal.diagonal_weight else (dims.ny_N, dims.ny_N)
    one, soft = Size("1", 1), Size("SOFT_ROWS", sum(row.soft is not None for row in p.rows))
    path: Mapping[Layout, Size] = {"shared": one, "node": dims.N}
    every: Mapping[Layout, Size] = {"shared": Size("2", 2), "node": dims.nodes}
    which = {"shared": "path, terminal", "node": "every node"}

    def setting(
        option: Kind, name: str, table: str, shape: tuple[Size, ...], copies: Mapping[Layout, Size] | None, doc: str
    ) -> list[Setting]:
        entries = {"W": dims.nw, "W_N": dims.nw_N}.get(name, shape[0])
        layout = "shared" if whole and layouts[option] == "fixed" else layouts[option]
        if layout == "fixed" or not (entries or whole):
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
    """Return the member for the next parameters of an estimator, whose window keeps earlier ones."""
    if p.estimation is None or not (p.own_parameters or whole):
        return []
    member = Field("next", (dims.np,), "parameters from the next sample on", "setting")
    return [Setting(member, "default_parameter", Size("1", 1), dims.np)]


def _scaling_note(p: Problem) -> str:
    """Return a comment on the weights that are multiplied by the length of the interval."""
    names = [name for name, scaled in zip(p.path.y_names, p.path.scale_with_dt, strict=True) if scaled]
    if not names:
        return ""
    which = "" if len(names) == p.path.ny else f" of {', '.join(names)}"
    return f"; that{which} is multiplied by dt_k where it is used"


def penalties_in_use(found: Iterable[Setting]) -> list[Field]:
    """Return the members for penalties that the last preparation has copied from the set ones."""
    return [
        Field(
            f"penalty_{name}",
            setting.field.shape,
            "penalty in the prepared QP",
            "keep",
            only=lambda f: f.takes_penalties,
        )
        for name in ("l1", "l2")
        for setting in found
        if setting.field.name == f"soft_{name}"
    ]
