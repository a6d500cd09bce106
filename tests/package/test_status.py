"""Printed texts, and a status remains the integer that it is."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from nmpc_codegen.package.status import Kkt, Status
from nmpc_codegen.runtime.controller import Controller


@pytest.mark.parametrize("status", Status)
def test_a_status_prints_its_meaning_and_is_an_integer(status: Status) -> None:
    assert str(status) == f"{status}" == f"{status.name}: {status.meaning}"
    assert f"{status:>90}" == str(status).rjust(90)
    assert f"{status:d}" == f"{int(status)}"
    assert f"{status:3d}" == f"{int(status):3d}"
    assert "%d" % status == json.dumps(status) == str(int(status))  # noqa: UP031
    assert status == status.value == np.array([status])[0]
    assert repr(status) == f"<Status.{status.name}: {status.value}>"


def test_every_status_has_a_meaning_of_its_own() -> None:
    assert len(Status) == 14
    assert len({s.meaning for s in Status}) == 14


def test_kkt() -> None:
    text = "stationarity 1.0e-09, equality 0.0e+00, inequality 2.5e-01, complementarity 3.0e+00"
    assert str(Kkt(1e-9, 0.0, 0.25, 3.0)) == text


def test_a_solution_is_readable(toy: Controller) -> None:
    solution = toy.solve([1.0, 0.0])
    lines = str(solution).splitlines()
    assert lines[0] == str(solution.status)
    assert lines[1].startswith(f"cost {solution.cost:.8g} after {solution.iterations} iterations, ")
    assert lines[2] == f"KKT: {solution.kkt}"
    assert lines[3] == f"first control: a = {solution.u[0, 0]:.6g}"
    assert lines[4] == "x (5, 2), u (4, 1)"
    assert len(repr(solution)) < 100
    assert repr(solution).startswith(f"<Solution {solution.status.name}: cost ")


def test_stats_are_readable(toy: Controller) -> None:
    toy.step([1.0, 0.0])
    toy.step([-1.0, 0.0])
    lines = str(toy.stats).splitlines()
    counts = toy.stats.qp_iterations, toy.stats.active_set_changes
    assert lines[0] == f"QP: {counts[0]} iterations, {counts[1]} changes of the active set"
    assert min(counts) >= 1
    assert (
        lines[2] == f"rows: {toy.stats.dropped_rows} redundant, {toy.stats.relaxed_rows} soft or relaxed and violated"
    )
    assert lines[-1].startswith("time: prepare ")
    assert "violated: " not in str(toy.stats)
    worse = dataclasses.replace(toy.stats, violated_row="box[1]", violated_node=4, violation=0.125)
    assert "\nviolated: box[1] at node 4 by 0.125\n" in str(worse)
