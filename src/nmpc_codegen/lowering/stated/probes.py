"""At saddles, idle controls are probed; this needs slopes at which a variable is idle, and a copy of the plan."""

from __future__ import annotations

from nmpc_codegen.components.base import Dims
from nmpc_codegen.frontend.completion.saddles import PROBE_PARTS, PROBE_SIZES, Saddles
from nmpc_codegen.frontend.completion.scales import round_scales
from nmpc_codegen.ir.cmodule import Macro, Table
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Struct


def macros(saddles: Saddles) -> tuple[Macro, ...]:
    """Return the sizes of probes of idle controls."""
    partners = any(partner >= 0 for partner in saddles.partners)
    return (
        Macro("PROBES", len(PROBE_SIZES), "sizes of a move of an idle control that are tried"),
        Macro("PROBE_PARTS", PROBE_PARTS, "halvings of a probe, at most"),
        Macro("PARTNERS", int(partners), "1: some controls act by a product"),
    )


def tables(saddles: Saddles) -> tuple[Table, ...]:
    """Return tables of idle variables, and of the moves of a probe."""
    slopes, partners = tuple(round_scales(saddles.slopes)), saddles.partners
    return (
        Table("idle_slope", "real", slopes, "|d Phi_l / d z_i| with which z_i is idle; < 0: never"),
        Table("drives_idle", "int", tuple(map(int, saddles.drivers)), "1: control that drives an idle state"),
        Table("idle_partner", "int", partners, "control with which control j acts by a product, or -1"),
        Table("probe_size", "real", PROBE_SIZES, "moves of an idle control that are tried, in its scale"),
    )


def plan_at_saddle(dims: Dims) -> Struct:
    """Return the struct for the plan before a probe of idle controls."""
    nodes = dims.nodes
    return Struct(
        "saddle",
        "plan at a saddle, before idle controls move",
        (
            Field("x", (nodes, dims.nx), "its states", "scratch"),
            Field("u", (dims.N, dims.nu), "its controls", "scratch"),
            Field("lam", (nodes, dims.nx), "its multipliers of the dynamics", "scratch", only=_departs),
            Field("mu_u", (dims.N, dims.nu), "its multipliers of the control bounds", "scratch", only=_departs),
            Field("mult", (dims.ng,), "its multipliers of the other rows", "scratch", only=_departs),
            Field("cost", (), "of the best plan", "scratch"),
            Field("violation", (), "of its hard rows, in their scales", "scratch", only=lambda f: f.hard_rows),
            Field("departed", (), "iterations of a departure from it that are left", "scratch", "int32", only=_departs),
            Field(
                "asked", (), "1: an idle state asks for another value", "scratch", "int32", only=lambda f: f.idle_states
            ),
            Field("saved", (), "part of its cost by which the last probe has lowered that of the plan", "scratch"),
        ),
        only=lambda f: f.saddles,
    )


def _departs(features: Features) -> bool:
    """Return True if solve() may return to this plan."""
    return features.solve and features.search
