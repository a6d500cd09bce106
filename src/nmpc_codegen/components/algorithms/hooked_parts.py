"""Hooked parts of the algorithms run at their hooks; their C text is in templates/hooked/."""

from __future__ import annotations

from nmpc_codegen.components.base import Dims, HookedPart
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.struct_layout import Field, Struct


def watch_fields(dims: Dims) -> tuple[Field, ...]:
    """Return the counters of the watch on plans, templates/algorithms/shared/watch.c."""
    nodes = dims.nodes
    return (
        Field("failures", (), "failures in a row, at most 3", "keep", "int32"),
        Field("probation", (), "successes still required of a plan that has failed twice", "keep", "int32"),
        Field(
            *("unconverged", (), "samples on end that were NOT_CONVERGED", "keep", "int32"),
            only=lambda f: f.repair or f.iterates or not f.has_qp,
        ),
        Field("first_control", (dims.nu,), "first control before the shift", "keep", only=lambda f: f.shifts_back),
        Field(
            *("unsettled", (), "samples on end in which lam changed by half its size", "keep", "int32"),
            only=_has_settling_multipliers,
        ),
        Field("lam_before", (nodes, dims.nx), "lam after the previous sample", "keep", only=_has_settling_multipliers),
    )


def _has_settling_multipliers(features: Features) -> bool:
    return features.lagrangian and features.has_qp


def _left(dims: Dims) -> tuple[Struct, ...]:
    """Return the struct for the remaining gaps and the remaining KKT residual after steps."""
    members = (
        Field("length", (), "length of the last step, in the scales of its variables", "keep"),
        Field("longest", (), "longest recent step", "keep"),
        Field("left", (), "largest residual that a recent step left", "keep"),
        Field("slope", (), "slope of the cost along the last step", "keep", only=lambda f: f.iterates),
        Field("doubted", (), "1: the plan before the last step was not optimal", "keep", "int32"),
        Field("trusted", (), "1: the last step is predicted to leave a small residual", "keep", "int32"),
    )
    return (Struct("near", "lengths and residuals of recent steps, which predict the residual of the plan", members),)


def _price(dims: Dims) -> tuple[Struct, ...]:
    """Return the struct for the price of hard rows, which depends on how long they have been violated."""
    outside = "violation at node 1 of the previous sample, in its scale, if that was RELAXED"
    rises = "1: the price rises again while the violation does not fall"
    members = (
        Field("outside", (), outside, "keep", only=lambda f: f.priced_rows),
        Field("rises", (), rises, "keep", "int32", only=lambda f: f.priced_rows),
    )
    return (Struct("solver", "", members),)


SHIFT = HookedPart("shift")
NEARNESS = HookedPart("nearness", _left)
ITERATIONS = HookedPart("iterations")
REFERENCES = HookedPart("references")
RELAXATION = HookedPart("relaxation", _price)
VIOLATION = HookedPart("violation")
BENT_ROWS = HookedPart("bent_rows")
FIRST_SAMPLE = HookedPart("first_sample")

#: One of this many samples checks the optimality of its plan even if its steps are short.
CHECKED = 5

#: Number of failed, unconverged or unsettled samples in a row after which the initial plan is used again.
RESTART_SAMPLES = 10

#: Option ``rows`` of single shooting -> part with its terms.
ROWS = {
    "augmented_lagrangian": HookedPart("dual_rows"),
    "smooth_l1": HookedPart("smooth_rows"),
    "lumped": HookedPart("smooth_rows"),
    "barrier": HookedPart("barrier_rows"),
}
