"""The augmented state has sizes, tables, members and entry points for the states added to the user's."""

from __future__ import annotations

import math

import numpy as np

from nmpc_codegen.components.algorithms.shifts import sampling_period
from nmpc_codegen.components.base import Dims
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import Macro, Table
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.package.signals import Argument, EntryPoint
from nmpc_codegen.package.struct_layout import Field, Size

SET_PREVIOUS = EntryPoint(
    "set_previous",
    "Set the control that the actuator applied last, if it differs from the one that was returned. It holds for the "
    "next sample, or for the present one between prepare and feedback.",
    (Argument("u", "real", ("NU",)),),
)
SET_TIME = EntryPoint(
    "set_time",
    "Set the time of the next sample, to which every sample adds DT.",
    (Argument("time", "real"),),
)


def entries(problem: Problem) -> tuple[EntryPoint, ...]:
    """Return the functions that set added states."""
    added = problem.augmentation
    return (*((SET_PREVIOUS,) if added.previous else ()), *((SET_TIME,) if added.time else ()))


def macros(model: Model) -> tuple[Macro, ...]:
    """Return the sizes of added states and parameters."""
    added = model.problem.augmentation
    return (
        Macro("NBAND", model.products.banded, "number of the last states, which act on no other state"),
        Macro("NMEM", len(added.previous), "controls of the node before that a node remembers"),
        Macro("NHELD", len(added.held), "controls that are held over blocks of nodes"),
        Macro("NDATA", added.data, "parameters added to those of the user"),
    )


def in_header(size: Size, problem: Problem) -> int | None:
    """Return the number of states or parameters in the header if states or parameters are added to the user's."""
    hidden = {"NX": problem.augmentation.count, "NP": problem.data_behind}.get(size.text, 0)
    return size - hidden if hidden else None


def members(dims: Dims) -> list[Field]:
    """Return the members that keep data of the previous sample."""
    return [
        Field("previous", (dims.nu,), "controls that were applied last", "keep", only=lambda f: f.previous),
        Field("time", (), "time of the next sample", "keep", only=lambda f: f.timed),
        Field("time_rest", (), "rounding error of that time", "keep", only=lambda f: f.timed),
    ]


def problem_names(problem: Problem) -> str:
    """Return a comment on the added states."""
    names = problem.state_names[problem.measured :]
    return f"; behind those of the user {', '.join(names)}" if names else ""


def tables(model: Model) -> tuple[Table, ...]:
    """Return tables of previous controls, blocks of controls, added parameters, and times of nodes and samples."""
    p, algorithm = model.problem, model.parts.algorithm
    added, data = p.augmentation, p.node_data
    starts = tuple(map(int, data[:, : len(added.held)].ravel()))
    period = sampling_period(algorithm.shift, algorithm.sampling_time, p) or p.dt[0]
    times = tuple(math.fsum(p.dt[:k]) for k in range(p.N + 1))
    return (
        Table("remembered", "int", added.previous, "controls of the node before that a node remembers"),
        Table("held_control", "int", added.held, "controls that are held over blocks of nodes"),
        Table("block_start", "int", starts, "1: a block begins at node k"),
        Table("block_node", "int", _block_nodes(p), "first node of the block of control j at node k"),
        Table("node_data", "real", tuple(map(float, data.ravel())), "parameters added to those of the user"),
        Table("node_time", "real", times, "t_k"),
        Table("sampling_time", "real", (float(period),), "time between samples"),
    )


def _block_nodes(p: Problem) -> tuple[int, ...]:
    """Return (N nu,) the first node of the block to which a control of a node belongs."""
    first = np.tile(np.arange(p.N)[:, None], (1, p.nu))
    for i, j in enumerate(p.augmentation.held):
        first[:, j] = np.maximum.accumulate(np.where(p.node_data[: p.N, i] > 0, np.arange(p.N), 0))
    return tuple(map(int, first.ravel()))
