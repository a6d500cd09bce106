"""Rows of one name on one bare state or control are one bound: the intersection of all statements."""

from __future__ import annotations

import copy

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP


class Plant:
    """x, r[2] and u."""

    def __init__(self) -> None:
        self.ocp = OCP("plant", T=2.0, N=4)
        self.x = self.ocp.state("x")
        self.r = self.ocp.state("r", size=2)
        self.u = self.ocp.control("u")

    def complete(self) -> OCP:
        """Complete a problem with the missing statements."""
        self.ocp.dynamics({self.x: self.u, self.r: self.r})
        self.ocp.least_squares(self.u, 1)
        return self.ocp


def test_a_copied_ocp_states_the_same_problem() -> None:
    g = Plant()
    twin = copy.deepcopy(g.complete())
    twin.subject_to(0, g.u, 1)
    assert [r.name for r in classify(twin).rows] == ["u"]
    assert classify(g.ocp).rows == ()


@given(
    st.lists(st.tuples(st.floats(-9, 0) | st.just(-np.inf), st.floats(0, 9) | st.just(np.inf)), min_size=1, max_size=4)
)
def test_rows_of_one_name_are_one_bound(intervals: list[tuple[float, float]]) -> None:
    """The intersection does not depend on the order, and no other rows remain."""
    g = Plant()
    for lower, upper in intervals:
        g.ocp.subject_to(lower, g.u, upper)
        g.ocp.subject_to([lower, -9], g.r, [9, upper], soft=(1, 0))
    rows = {r.name: r for r in classify(g.complete()).rows}
    least, most = max(lower for lower, _ in intervals), min(upper for _, upper in intervals)
    assert list(rows) == ["u", "r[0]", "r[1]"]
    assert (rows["u"].kind, rows["u"].lower, rows["u"].upper) == ("control", least, most)
    assert rows["r[0]"].soft == rows["r[1]"].soft == (1, 0)
    assert (rows["r[0]"].lower, rows["r[0]"].upper) == (least, 9)
    assert (rows["r[1]"].lower, rows["r[1]"].upper) == (-9, most)


def test_a_merged_element_leaves_the_others() -> None:
    g = Plant()
    g.ocp.subject_to(-1, g.r, np.inf, name="box")
    g.ocp.subject_to(-np.inf, g.r, 1, name="box")
    g.ocp.subject_to(-3, ca.vertcat(g.u, g.x * g.u), 3)
    g.ocp.subject_to(-2, ca.vertcat(g.x, g.u, g.x * g.u), 4)
    rows = classify(g.complete()).rows
    assert [(r.name, r.kind, r.lower, r.upper) for r in rows] == [
        ("box[0]", "state", -1, 1),
        ("box[1]", "state", -1, 1),
        ("u", "control", -2, 3),
        ("row_0", "general", -3, 3),
        ("x", "state", -2, 4),
        ("row_1", "general", -2, 4),
    ]


def test_a_refused_merge_changes_nothing() -> None:
    g = Plant()
    g.ocp.subject_to(-1, g.r, 1)
    with pytest.raises(ProblemError, match=r"the row 'r\[1\]' in \[2, 3\] contradicts the row 'r\[1\]' stated"):
        g.ocp.subject_to([0, 2], g.r, [0.5, 3])
    assert [(r.lower, r.upper) for r in classify(g.complete()).rows] == [(-1, 1), (-1, 1)]
