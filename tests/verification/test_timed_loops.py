"""Closed loops timed in C: the program does what its scenario says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from conftest import require_tool

from verification import problems
from verification.closed_loop import Scenario, closed_loop, compile_driver, member_path, run_driver


def test_closed_loop_in_c() -> None:
    require_tool("cc")
    scenario = Scenario((2.0, 0.0, 0.0, 0.0), 0.3, 4, amplitude=0.01)
    t = closed_loop(problems.sources("crane"), "crane", scenario, runs=2, steps=8)
    assert t.samples == 16
    assert t.failed == 0
    assert 0 < t.feedback < t.total <= t.total_median
    assert t.feedback < t.worst
    assert 0 < t.qp_iterations <= t.qp_iterations_max


def test_scenario_reaches_the_c_program(tmp_path: Path) -> None:
    """At rest at the origin no QP iteration is needed; a push or a far set point causes some at its time."""
    require_tool("cc")
    program = compile_driver(problems.sources("crane_weight"), "crane", tmp_path)
    origin, far, near = (0.0, 0.0, 0.0, 0.0), ((5.0, 0, 0, 0, 0), (5.0, 0, 0, 0)), ((0.0,) * 5, (0.0,) * 4)

    def iterations(period: int, **events: Any) -> int:
        return run_driver(program, Scenario(origin, 0.3, period, **events), runs=1, steps=3).qp_iterations_max

    assert iterations(9) == 0
    assert iterations(9, push=(1.0,), pushes=5) > 0
    assert iterations(9, set_points=(near, far)) == 0
    assert iterations(2, set_points=(near, far)) > 0


def test_member_is_found_where_a_package_has_it() -> None:
    header = problems.sources("crane")["crane.h"]
    assert member_path(header, "qp_iterations").endswith("qp_iterations")
    moved = "typedef struct {\n    int32_t n; /* */\n} a_info_t;\ntypedef struct {\n    a_info_t info;\n} a_solver_t;\n"
    assert member_path(moved, "n") == "info.n"
    with pytest.raises(ValueError):
        member_path(moved, "m")
