"""Noise is added at the end of an interval: x_i+ = Phi_i(x, u, p) + u_j for pairs (i, j) of the problem.

The sweeps of an integrator ignore it. Calls after a sweep complete its results at the end of the interval:

    x_next_i += u_j;   S_ij = 1;   dx_next_i += du_j;   B_ij = 1;   (B' lam)_j += lam_i;   second derivatives are 0
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import casadi as ca

from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.casadi_types import Function
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.ir.sweep import Affine, Call, Slice, Sweep

#: Note on the calls that add noise.
NOTE = "noise at the end of the interval"


def with_noise(sweep: Sweep, problem: Problem) -> Sweep:
    """Return the sweep of an interval with the calls that add noise to its results."""
    if not problem.noise:
        return sweep
    inputs, outputs = ({port.name for port in ports} for ports in (sweep.inputs, sweep.outputs))
    calls = (call for pair in problem.noise for call in _results(problem, *pair, inputs, outputs))
    return replace(sweep, body=(*sweep.body, *calls))


def noise_tables(problem: Problem) -> tuple[Table, ...]:
    """Return the tables of the pairs (i, j)."""
    states, controls = zip(*problem.noise, strict=True) if problem.noise else ((), ())
    return (
        Table("noise_state", "int", states, "states with process noise at the end of an interval"),
        Table("noise_control", "int", controls, "controls that are this noise"),
    )


def _results(problem: Problem, i: int, j: int, inputs: set[str], outputs: set[str]) -> Iterable[Call]:
    """Yield the calls for state i and control j."""
    nu, nz, column = problem.nu, problem.nx + problem.nu, problem.nx + j
    if "x_next" in outputs:
        yield _add("x_next", i, "u", j)
    if "S" in outputs:
        yield _one("S", i * nz + column)
    if "dx_next" in outputs:
        yield _add("dx_next", i, "du", j)
    if "S_next" in outputs and "S" not in inputs:
        yield _one("S_next", i * nu + j)
    if "lam_u" in outputs:
        yield _add("lam_u", j, "lam", i)
    elif "g" in outputs and "adj" in inputs:
        yield _add("g", column, "adj", i)


def _add(target: str, at: int, source: str, of: int) -> Call:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    here = Slice(target, 1, Affine(at))
    return Call(Function("add_noise", [a, b], [a + b]), (here, Slice(source, 1, Affine(of))), (here,), note=NOTE)


def _one(target: str, at: int) -> Call:
    return Call(Function("slope_of_noise", [], [ca.SX(1)]), (), (Slice(target, 1, Affine(at)),), note=NOTE)
