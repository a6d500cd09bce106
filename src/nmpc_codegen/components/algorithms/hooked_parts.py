"""The hooked parts of the algorithms: what runs at their hooks in templates/hooked/."""

from __future__ import annotations

from nmpc_codegen.components.base import Dims, HookedPart
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Size, Struct


def watch_fields(dims: Dims) -> tuple[Field, ...]:
    """What the watch on plans counts, templates/algorithms/shared/watch.c."""
    nodes = Size("N + 1", dims.N.value + 1)
    return (
        Field("failures", (), "failures in a row, at most 3", "keep", "int32"),
        Field("probation", (), "successes that a plan which has failed twice still has to show", "keep", "int32"),
        Field(
            *("unconverged", (), "samples on end that were NOT_CONVERGED", "keep", "int32"),
            only=lambda f: f.repair or f.iterates or not f.has_qp,
        ),
        Field("first_control", (dims.nu,), "of the plan before its shift", "keep", only=lambda f: f.shifts_back),
        Field(
            *("unsettled", (), "samples on end in which lam changed by half its size", "keep", "int32"),
            only=_has_settling_multipliers,
        ),
        Field("lam_before", (nodes, dims.nx), "lam after the sample before", "keep", only=_has_settling_multipliers),
    )


def _has_settling_multipliers(features: Features) -> bool:
    return features.lagrangian and features.has_qp


def law_structs(dims: Dims) -> tuple[Struct, ...]:
    """The law of the first control."""
    struct = Struct(
        "first",
        "law of the first control on the predicted working set",
        (
            Field("gain", (dims.nu, dims.nx), "du_0 / dx_0", "scratch"),
            Field("feed", (dims.nu,), "du_0 at dx_0 = 0", "scratch"),
            Field("control", (dims.nu,), "control that feedback_first() has returned", "scratch"),
            Field("valid", (), "1: the law belongs to the last preparation", "scratch", "int32"),
            Field("status", (), "of the whole feedback, where feedback_first() has run it", "scratch", "int32"),
            Field("call", (), "what the last feedback_first() has done", "scratch", "int32"),
        ),
        only=lambda f: f.first,
    )
    return (struct,)


def level_structs(dims: Dims) -> tuple[Struct, ...]:
    """What the levels of an iteration keep besides the linearisation."""
    nodes = Size("N + 1", dims.N.value + 1)
    struct = Struct(
        "levels",
        "levels of an iteration",
        (
            Field("x", (nodes, dims.nx), "states of the plan at the last evaluation", "scratch"),
            Field("u", (dims.N, dims.nu), "its controls", "scratch"),
            Field("valid", (), "1: there are derivatives and factors to keep", "keep", "int32"),
            Field("last", (), "level of the last evaluation", "keep", "int32"),
            Field("asked", (), "level of the next one", "keep", "int32"),
        ),
    )
    return (struct,)


def _left(dims: Dims) -> tuple[Struct, ...]:
    """What steps leave of the model and of optimality."""
    members = (
        Field("length", (), "length of the last step, in the scales of its variables", "keep"),
        Field("longest", (), "longest one of the recent steps", "keep"),
        Field("left", (), "largest residual after one of the recent steps", "keep"),
        Field("slope", (), "slope of the cost along the last step", "keep", only=lambda f: f.iterates),
        Field("before", (), "relative KKT residual before the last step", "keep", only=lambda f: f.iterates),
        Field("doubted", (), "1: the plan before the last step was not optimal", "keep", "int32"),
        Field("trusted", (), "1: the last step leaves a small residual, by all that is known", "keep", "int32"),
    )
    return (Struct("near", "lengths and residuals of the recent steps, to judge how near the plan is", members),)


def _price(dims: Dims) -> tuple[Struct, ...]:
    """What the time outside of hard rows makes of their price."""
    outside = "violation at node 1 of the sample before, in its scale, if that was RELAXED"
    rises = "1: the price rises again while the violation does not fall"
    members = (
        Field("outside", (), outside, "keep", only=lambda f: f.priced_rows),
        Field("rises", (), rises, "keep", "int32", only=lambda f: f.priced_rows),
    )
    return (Struct("solver", "", members),)


SHIFT = HookedPart("shift")
PLAIN = HookedPart("plain")
SIMULATE = HookedPart("simulate")
LEVELS = HookedPart("levels")
NEARNESS = HookedPart("nearness", _left)
ITERATIONS = HookedPart("iterations")
REFERENCES = HookedPart("references")
RELAXATION = HookedPart("relaxation", _price)
VIOLATION = HookedPart("violation")
BENT_ROWS = HookedPart("bent_rows")
FIRST_SAMPLE = HookedPart("first_sample")
FIRST_CONTROL = HookedPart("first")

#: Samples of which one checks the optimality of its plan, however short its steps are.
CHECKED = 5

#: Failed, unconverged or unsettled samples in a row after which a plan starts anew.
RESTART_SAMPLES = 10

#: Rows as terms of single shooting, by the option ``rows``.
ROWS = {
    "augmented_lagrangian": HookedPart("dual_rows"),
    "smooth_l1": HookedPart("smooth_rows"),
    "lumped": HookedPart("smooth_rows"),
    "barrier": HookedPart("barrier_rows"),
}
