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
        Macro("PROBES", len(PROBE_SIZES), "number of sizes of a probe"),
        Macro("PROBE_PARTS", PROBE_PARTS, "most halvings of a probe"),
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
            Field("x", (nodes, dims.nx), "states of the plan at the saddle", "scratch"),
            Field("u", (dims.N, dims.nu), "controls of that plan", "scratch"),
            Field("lam", (nodes, dims.nx), "multipliers of the dynamics", "scratch", only=_departs),
            Field("mu_u", (dims.N, dims.nu), "multipliers of the control bounds", "scratch", only=_departs),
            Field("mult", (dims.ng,), "multipliers of the other rows", "scratch", only=_departs),
            Field("cost", (), "cost of the best plan", "scratch"),
            Field("violation", (), "violation of its hard rows, scaled", "scratch", only=lambda f: f.hard_rows),
            Field("departed", (), "remaining iterations of a departure", "scratch", "int32", only=_departs),
            Field(
                "asked", (), "1: another idle state would cost less", "scratch", "int32", only=lambda f: f.idle_states
            ),
            Field("saved", (), "fraction by which the last probe has lowered the cost of the plan", "scratch"),
        ),
        only=lambda f: f.saddles,
    )


def _departs(features: Features) -> bool:
    """Return True if solve() may return to this plan."""
    return features.solve and features.search
