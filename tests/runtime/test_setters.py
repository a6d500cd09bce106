"""What a controller is told while it runs: every setter, by value, array, name and node; what is refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, Batch, Online, Options, build
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.controller import Controller


def test_reference_of_every_node_by_array_trajectory_and_name(toy: Controller) -> None:
    toy.set_reference([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(toy.view("yref"), np.tile([1.0, 2.0, 3.0], (4, 1)))
    trajectory = np.arange(12.0).reshape(4, 3)
    toy.set_reference(trajectory)
    np.testing.assert_array_equal(toy.view("yref"), trajectory)
    toy.set_reference({"a": -1.0, "p": 0.5})
    trajectory[:, 2], trajectory[:, 0] = -1.0, 0.5
    np.testing.assert_array_equal(toy.view("yref"), trajectory)
    np.testing.assert_array_equal(toy.view("yref_N"), [0.5, 0.0])
    toy.set_reference({"v": 9.0}, node=2)
    trajectory[2, 1] = 9.0
    np.testing.assert_array_equal(toy.view("yref"), trajectory)
    toy.set_terminal_reference({"v": 0.25})
    np.testing.assert_array_equal(toy.view("yref_N"), [0.5, 0.25])


def test_parameters(toy: Controller) -> None:
    toy.set_parameter("m", [2.0], node=4)
    toy.set_parameter("d", np.arange(10.0).reshape(5, 2))
    np.testing.assert_array_equal(toy.view("p")[:, 0], [1.0, 1.0, 1.0, 1.0, 2.0])
    np.testing.assert_array_equal(toy.view("p")[:, 1:], np.arange(10.0).reshape(5, 2))


def test_setters_take_names_arrays_by_node_and_base_names() -> None:
    """Every setter: a number, an array with or without the end, a base name; the other entries stay."""
    ocp = OCP("alike", T=1.0, N=3)
    r, u = ocp.state("r", size=2), ocp.control("u")
    m, k = ocp.parameter("m", value=1.0), ocp.parameter("k", size=2)
    ocp.dynamics({r: ca.vertcat(r[1], u * m + k[0] + k[1])})
    ocp.least_squares(ca.vertcat(r, u), weight=[1.0, 2.0, 3.0])
    ocp.terminal_least_squares(r, weight=[4.0, 5.0])
    ocp.subject_to(-5, r, 5)
    ocp.subject_to(-1, u, 1)
    c = build(ocp, Options(online=Online("node", "node", "node", "node")), "test")
    c.set_reference({"r": [1.0, 2.0]})
    np.testing.assert_array_equal(c.view("yref"), [[1.0, 2.0, 0.0]] * 3)
    np.testing.assert_array_equal(c.view("yref_N"), [1.0, 2.0])
    c.set_reference({"r": np.arange(8.0).reshape(4, 2), "u": [7.0, 8.0, 9.0]})
    np.testing.assert_array_equal(c.view("yref"), [[0, 1, 7], [2, 3, 8], [4, 5, 9]])
    np.testing.assert_array_equal(c.view("yref_N"), [6.0, 7.0])
    c.set_reference(np.arange(12.0).reshape(4, 3))
    np.testing.assert_array_equal(c.view("yref_N"), [9.0, 10.0])
    c.set_reference([3.0, 4.0], node=3)
    np.testing.assert_array_equal(c.view("yref_N"), [3.0, 4.0])
    c.set_weight({"u": 0.5, "r[0]": [1.0, 2.0, 3.0, 9.0]})
    np.testing.assert_array_equal(c.view("W"), [[1.0, 2.0, 0.5], [2.0, 2.0, 0.5], [3.0, 2.0, 0.5]])
    np.testing.assert_array_equal(c.view("W_N"), [9.0, 5.0])
    c.set_weight({"r": 0.0})
    np.testing.assert_array_equal(c.view("W")[:, :2], np.zeros((3, 2)))
    np.testing.assert_array_equal(c.view("W_N"), [9.0, 5.0])
    c.set_weight({"r": 1.0}, node=3)
    np.testing.assert_array_equal(c.view("W_N"), [1.0, 1.0])
    c.set_weight(np.ones((4, 3)))
    np.testing.assert_array_equal(c.view("W"), np.ones((3, 3)))
    c.set_parameters({"k[1]": [1.0, 2.0, 3.0]}, m=[4.0, 5.0, 6.0, 7.0], k=0.5)
    np.testing.assert_array_equal(c.view("p")[:, 0], [4.0, 5.0, 6.0, 7.0])
    np.testing.assert_array_equal(c.view("p")[:, 1:], np.full((4, 2), 0.5))
    c.set_parameter("k[1]", [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(c.view("p")[:, 2], [1.0, 2.0, 3.0, 0.5])
    c.set_parameter("k[0]", 9.0, node=1)
    np.testing.assert_array_equal(c.view("p")[:, 1], [0.5, 9.0, 0.5, 0.5])
    c.set_parameters({"k[0]": 7.0, "k[1]": 8.0})
    np.testing.assert_array_equal(c.view("p")[:, 1:], [[7.0, 8.0]] * 4)
    c.set_parameters({"k": 1.0, "k[1]": [2.0, 3.0, 4.0]})
    np.testing.assert_array_equal(c.view("p")[:, 1:], [[1.0, 2.0], [1.0, 3.0], [1.0, 4.0], [1.0, 1.0]])
    c.set_reference(np.zeros((4, 3)))
    c.set_reference({"r[0]": [1.0, 2.0, 3.0]})  # without the end
    np.testing.assert_array_equal(c.view("yref_N"), [0.0, 0.0])
    c.set_bounds({"r[0]": ([np.nan, -1.0, -2.0, -3.0], 4.0), "u": ([0.1, 0.2, 0.3], [1.0, 2.0, 3.0])})
    np.testing.assert_array_equal(c.view("lower")[:, 0], [-5.0, -1.0, -2.0, -3.0])
    np.testing.assert_array_equal(c.view("upper")[:3, 2], [1.0, 2.0, 3.0])
    c.set_bounds("r", -np.arange(8.0).reshape(4, 2), [8.0, 9.0])
    np.testing.assert_array_equal(c.view("lower")[1:, :2], [[-2.0, -3.0], [-4.0, -5.0], [-6.0, -7.0]])
    with pytest.raises(ControllerError, match=r"expected \(1,\), or a number, or one row per node, \(4,\)$"):
        c.set_bounds("r[0]", [0.0, 1.0, 2.0], 3.0)  # the row holds at nodes 1..3: which of four is left out?
    with pytest.raises(ControllerError, match="does not hold at node 0"):
        c.set_bounds("r", -1.0, 1.0, node=0)


@pytest.mark.parametrize("dense_end", [False, True])
def test_weights_with_the_end_where_both_are_stored_differently(dense_end: bool) -> None:
    ocp = OCP("mixed", T=1.0, N=3)
    x, v, u = ocp.state("x"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({x: v, v: u})
    full, diagonal = np.eye(2) + 0.1, np.eye(2)
    ocp.least_squares(ca.vertcat(x, v), weight=diagonal if dense_end else full)
    ocp.terminal_least_squares(ca.vertcat(x, v), weight=full if dense_end else diagonal)
    c = build(ocp, Options(online=Online(weight="node")), "test")
    rows = np.array([[10.0, 20.0]] * 4)
    c.set_weight(rows)
    expected = np.diag(rows[0])
    np.testing.assert_array_equal(c.view("W_N"), expected if dense_end else rows[0])
    np.testing.assert_array_equal(c.view("W")[2], rows[0] if dense_end else expected)
    if not dense_end:
        before = c._memory.copy()
        with pytest.raises(ControllerError, match="terminal weight has entries off its diagonal"):
            c.set_weight(np.array([full] * 4))
        np.testing.assert_array_equal(c._memory, before)


def test_elements_of_vectors_where_nodes_share_them() -> None:
    ocp = OCP("shared", T=1.0, N=3)
    x, u, r = ocp.state("x"), ocp.control("u"), ocp.parameter("r", size=2, value=[1.0, 2.0])
    ocp.dynamics({x: u + r[0] + r[1]})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    c = build(ocp, Options(online=Online(parameter="shared")), "test")
    c.set_parameter("r", [3.0, 4.0], node=3)
    c.set_parameter("r[0]", 9.0)
    np.testing.assert_array_equal(c.view("p"), [[9.0, 2.0], [9.0, 4.0]])
    c.set_parameters({"r[0]": 5.0, "r[1]": 6.0}, node=3)
    np.testing.assert_array_equal(c.view("p"), [[9.0, 2.0], [5.0, 6.0]])


def test_bounds_of_a_row_a_vector_and_the_terminal_node(toy: Controller) -> None:
    toy.set_bounds("a", -0.25, 0.5)
    assert toy.step([1.0, 0.0]) == -0.25
    toy.set_bounds("box", [-1.0, -2.0], 3.0)
    np.testing.assert_array_equal(toy.view("lower"), [[-0.25, -1.0, -2.0]] * 2)
    np.testing.assert_array_equal(toy.view("upper"), [[0.5, 3.0, 3.0]] * 2)
    toy.set_bounds("box[1]", -np.inf, 7.0, node=4)
    np.testing.assert_array_equal(toy.view("lower")[:, 2], [-2.0, -np.inf])
    np.testing.assert_array_equal(toy.view("upper")[:, 2], [3.0, 7.0])


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        ("set_reference", ([1.0],), r"reference has shape \(1,\); expected \(3,\)"),
        (
            "set_reference",
            (np.zeros((3, 3)),),
            r"reference has shape \(3, 3\); expected \(3,\), or one row per node, \(4, 3\) or \(5, 3\)$",
        ),
        ("set_reference", ([1.0, np.nan, 0.0],), "reference holds a NaN"),
        ("set_reference", ([[1.0], [1.0, 2.0]],), "reference is no array of numbers"),
        ("set_parameter", ("m", [[1.0], [1.0, 2.0]]), "parameter 'm' is no array of numbers"),
        ("set_reference", ({"q": 1.0},), "no residual 'q'; those that exist: 'p', 'v', 'a'"),
        ("set_reference", ({"p": [1.0, 2.0]},), r"reference of 'p' has shape \(2,\)"),
        ("set_reference", ([0.0, 0.0, 0.0], 4), r"terminal reference has shape \(3,\); expected \(2,\)"),
        ("set_reference", ([0.0, 0.0, 0.0], -1), r"node is -1; expected None or an integer in 0\.\.4"),
        ("set_reference", ([0.0, 0.0, 0.0], 1.0), "node is 1.0"),
        ("set_reference", ({"p": 1.0}, 7), "node is 7"),
        ("set_terminal_reference", ([1.0, 2.0, 3.0],), r"terminal reference has shape \(3,\); expected \(2,\)"),
        ("set_terminal_reference", ({"a": 1.0},), "no residual 'a'; those that exist: 'p', 'v'"),
        ("set_weight", ([1.0, 1.0],), r"weight has shape \(2,\); expected \(3,\)"),
        ("set_weight", ([1.0, -1.0, 1.0],), "weight must be positive semidefinite, but has the eigenvalue -1"),
        ("set_weight", (np.triu(np.ones((3, 3))),), r"weight must be symmetric, but entry \[0, 1\] is 1 and"),
        ("set_weight", (np.eye(3) + 0.1,), "weight has entries off its diagonal"),
        ("set_weight", ([1.0, 1.0, 1.0], 2), r'weight cannot be set at node 2; expected node None.*weight="shared"'),
        ("set_terminal_weight", (np.eye(3),), r"terminal weight has shape \(3, 3\); expected \(2, 2\)"),
        ("set_parameter", ("M", 1.0), "no parameter 'M'; those that exist: 'm', 'd'"),
        ("set_parameter", ("d", np.zeros(3)), r"parameter 'd' has shape \(3,\); expected \(2,\), or a number"),
        (
            "set_parameter",
            ("d", np.zeros((3, 2))),
            r"parameter 'd' has shape \(3, 2\); expected .*, or one row per node, \(4, 2\) or \(5, 2\)",
        ),
        ("set_parameter", ("d[2]", 1.0), r"no parameter 'd\[2\]'; those that exist: 'd\[0\]', 'd\[1\]'"),
        ("set_parameters", ({"m": 2.0, "d": np.nan},), "parameter 'd' holds a NaN"),
        ("set_bounds", ({"box": (0.0, 1.0), "a": (1.0, 0.0)},), "bounds of 'a': lower"),
        ("set_bounds", ({"a": 1.0},), r"bounds of 'a' is 1.0; expected \(lower, upper\)"),
        ("set_bounds", ("a",), "bounds of 'a': expected a lower and an upper one"),
        ("set_weight", ({"v": -1.0},), "weight of 'v' is -1; expected numbers >= 0"),
        ("set_weight", ([1.0, 2.0, -1e-14],), "weight must be positive semidefinite"),
        ("set_bounds", ({"a": (-1.0, 1.0), "box": (np.inf, np.inf)},), "nothing is above inf"),
        ("set_bounds", ({"a": (-1.0, None)},), r"expected \(lower, upper\)"),
        ("set_bounds", ({"a": (-1.0, 1.0)}, -5.0, 5.0), "takes no further values"),
        ("set_parameter", ("m", "0.7"), "is no array of numbers"),
        ("set_parameters", ([1.0, 2.0],), "is no {name: value}"),
        ("set_weight", ({"q": 1.0},), "no residual 'q'"),
        ("set_reference", ({"p": np.zeros(5), "a": np.zeros(5)},), r"N \+ 1 rows, but 'a' is no terminal residual"),
        ("set_parameter", ("m", np.inf), "parameter 'm' holds a NaN or an infinity"),
        ("set_bounds", ("b", 0.0, 1.0), r"no row 'b'; those that exist: 'a', 'box\[0\]', 'box\[1\]'"),
        ("set_bounds", ("a", 1.0, 0.0), r"bounds of 'a': lower \[1.0\] above upper \[0.0\]"),
        ("set_bounds", ("a", np.nan, 0.0), "lower bound of 'a' is NaN"),
        ("set_bounds", ("box", [0.0] * 3, 1.0), r"lower bound of 'box' has shape \(3,\); expected \(2,\)"),
        ("set_bounds", ("box[1]", 0.0, 1.0, 2), r"bounds of 'box\[1\]' .* node 2; expected node None or 4.*shared"),
    ],
)
def test_one_clear_error_per_mistake_and_nothing_written(
    toy: Controller, call: str, arguments: tuple[object, ...], message: str
) -> None:
    before = toy._memory.copy()
    with pytest.raises(ControllerError, match=message):
        getattr(toy, call)(*arguments)
    np.testing.assert_array_equal(toy._memory, before)


def test_weights_by_name_without_an_end_or_a_path() -> None:
    ocp = OCP("tank", T=5.0, N=5)
    h, q = ocp.state("h"), ocp.control("q")
    ocp.dynamics({h: q - h})
    ocp.subject_to(0, q, 1)
    ocp.least_squares(h, weight=1)
    ctrl = build(ocp, profile="test")
    ctrl.set_weight({"h": 2.0})
    np.testing.assert_array_equal(ctrl.view("W"), 2.0)


def test_nobody_may_be_told() -> None:
    """An index that names no controller: nothing changes, in every form."""
    ocp = OCP("tank", T=5.0, N=5)
    h, q, loss = ocp.state("h"), ocp.control("q"), ocp.parameter("loss", value=0.1)
    ocp.dynamics({h: q - loss * h})
    ocp.subject_to(0, q, 1)
    ocp.least_squares(h, weight=1)
    many = Batch(build(ocp, profile="test"), 3)
    before, none = many.memory.copy(), np.zeros(3, bool)
    many.set_reference(np.zeros((0, 1)), index=none)
    many.set_reference({"h": 0.3}, index=none)
    many.set_parameter("loss", np.zeros(0), index=none)
    many.set_weight(np.zeros((0, 1)), index=none)
    many.set_weight({"h": 2.0}, index=none)
    many.set_bounds("q", 0.0, 0.5, index=none)
    np.testing.assert_array_equal(many.memory, before)
