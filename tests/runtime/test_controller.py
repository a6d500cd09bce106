"""controller.py, on a small package. Oracle: the same optimal control problem as dense least squares."""

from __future__ import annotations

import copy
import io
import pickle
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from nmpc_codegen import OCP, build, generate
from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.compiled import ALIGNMENT
from nmpc_codegen.runtime.controller import Controller, Status
from verification import problems

Array = NDArray[np.float64]
DT = 0.1
FIRST = np.array([0.1, -0.05])  # no bound is active from here


def oracle(ctrl: Controller, xhat: Array) -> tuple[Array, Array, float]:
    """x, u and cost of the unconstrained problem with the controller's data, by dense least squares over all u."""
    N = ctrl.dims.N
    m, d = ctrl.view("p")[:, 0], ctrl.view("p")[:, 1:]
    x, X = np.array(xhat), np.zeros((2, N))  # x_k = x + X u
    rows, target, xs, Xs = [], [], [x], [X]
    w, w_N = np.sqrt(ctrl.view("W")[0]), np.sqrt(ctrl.view("W_N"))
    A = np.array([[1.0, DT], [0.0, 1.0]])
    for k in range(N):
        e = np.eye(N)[k]
        rows += [w[:2, None] * X, w[2] * e[None]]
        target += [w[:2] * (ctrl.view("yref")[k, :2] - x), w[2:] * ctrl.view("yref")[k, 2:]]
        x, X = A @ x + d[k], A @ X + np.outer([DT**2 / 2 / m[k], DT / m[k]], e)
        xs.append(x)
        Xs.append(X)
    rows.append(w_N[:, None] * X)
    target.append(w_N * (ctrl.view("yref_N") - x))
    M, b = np.vstack(rows), np.concatenate(target)
    u = np.linalg.lstsq(M, b, rcond=None)[0]
    return np.array([x + X @ u for x, X in zip(xs, Xs, strict=True)]), u[:, None], 0.5 * float(np.sum((M @ u - b) ** 2))


def assert_optimal(ctrl: Controller, xhat: Array = FIRST) -> None:
    u0 = ctrl.step(xhat, on_failure="raise")
    x, u, cost = oracle(ctrl, xhat)
    np.testing.assert_allclose(ctrl.u, u, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(ctrl.x, x, rtol=1e-11, atol=1e-12)
    np.testing.assert_array_equal(u0, ctrl.u[0])
    assert ctrl.cost == pytest.approx(cost, rel=1e-12)


# -- calls ------------------------------------------------------------------------------------------------------------


def test_step_is_optimal(toy: Controller) -> None:
    assert_optimal(toy)


def test_step_is_the_c_function_step(toy: Controller) -> None:
    twin = toy.copy()
    ffi = twin._package.ffi
    u0 = ffi.new("toy_real[1]")
    assert twin._call("step", twin._s, ffi.new("toy_real[2]", FIRST.tolist()), u0) == 0
    assert toy.step(FIRST)[0] == u0[0]
    np.testing.assert_array_equal(toy._memory, twin._memory)


def test_step_is_prepare_and_feedback(toy: Controller) -> None:
    toy.step(FIRST)  # the first sample prepares for the measured state
    twin = toy.copy()
    assert twin.prepare() is Status.OK
    np.testing.assert_array_equal(twin.feedback(FIRST), toy.step(FIRST))
    np.testing.assert_array_equal(toy._memory, twin._memory)
    assert twin.stats.prepare_ns > 0
    assert twin.stats.feedback_ns > 0


def test_control_is_a_fresh_array(toy: Controller) -> None:
    twin = toy.copy()
    first = toy.step(FIRST)
    first[:] = 99.0
    twin.step(FIRST)
    np.testing.assert_array_equal(toy.step(FIRST), twin.step(FIRST))


def test_multipliers_have_the_signs_of_the_lagrangian(toy: Controller) -> None:
    """lam_0 = dV/dxhat, by central differences of the quadratic value function; mu_u < 0 at the lower bound."""
    value = lambda x: (toy.step(x), toy.cost)[1]  # noqa: E731
    h = 1e-3
    gradient = [(value(FIRST + h * e) - value(FIRST - h * e)) / (2 * h) for e in np.eye(2)]
    toy.step(FIRST)
    np.testing.assert_allclose(toy.lam[0], gradient, rtol=1e-8)
    toy.step([1.0, 0.0])
    assert toy.u[0, 0] == -5.0
    assert toy.mu_u[0, 0] < 0.0


def test_solve(toy: Controller) -> None:
    solution = toy.solve(FIRST, tol=1e-9, max_iterations=3)
    x, u, cost = oracle(toy, FIRST)
    assert solution.status is Status.OK
    np.testing.assert_allclose(solution.u, u, rtol=1e-11)
    np.testing.assert_allclose(solution.x, x, rtol=1e-11)
    assert solution.cost == pytest.approx(cost, rel=1e-12)
    assert (solution.lam.shape, solution.mu_x.shape, solution.mu_u.shape) == ((5, 2), (5, 2), (4, 1))
    assert (solution.mu.shape, solution.mu_N.shape, solution.eta.shape) == ((4, 0), (0,), (0,))
    assert solution.iterations == 1
    assert solution.kkt == toy.kkt()
    assert solution.time_ns > 0
    toy.u[:] = 7.0
    np.testing.assert_allclose(solution.u, u, rtol=1e-11)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tol": 0.0}, "tol is 0.0; expected a positive number"),
        ({"tol": float("nan")}, "tol is nan"),
        ({"tol": "fine"}, "tol is 'fine'"),
        ({"max_iterations": 0}, "max_iterations is 0; expected an integer >= 1"),
        ({"max_iterations": 2.5}, "max_iterations is 2.5"),
    ],
)
def test_solve_refuses(toy: Controller, arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        toy.solve(FIRST, **arguments)  # type: ignore[arg-type]


def test_feedback_without_prepare_is_safe(toy: Controller) -> None:
    np.testing.assert_array_equal(toy.feedback(FIRST), [0.0])
    assert toy.status is Status.NOT_PREPARED
    with pytest.raises(ControllerError, match=r"toy\.feedback: NOT_PREPARED: .*without prepare"):
        toy.feedback(FIRST, on_failure="raise")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_state_that_is_not_finite(toy: Controller, bad: float) -> None:
    u0 = toy.step([bad, 0.0])
    assert toy.status is Status.NOT_FINITE
    assert np.isfinite(u0).all()
    with pytest.raises(ControllerError, match=r"toy\.step: NOT_FINITE"):
        toy.step([0.0, bad], on_failure="raise")
    assert_optimal(toy)


def test_failed_preparation_is_the_status_of_the_step(toy: Controller) -> None:
    toy.view("W")[0, 2] = -1e6
    assert np.isfinite(toy.step(FIRST)).all()
    assert toy.status is Status.NUMERICAL_FAILURE
    assert toy.prepare() is Status.NUMERICAL_FAILURE
    with pytest.raises(ControllerError, match="NUMERICAL_FAILURE"):
        toy.prepare(on_failure="raise")


@pytest.mark.parametrize(
    ("xhat", "message"),
    [
        ([0.0], r"xhat has shape \(1,\); expected \(2,\)"),
        ([[0.0, 0.0]], r"xhat has shape \(1, 2\); expected \(2,\)"),
        (0.0, r"xhat has shape \(\); expected \(2,\)"),
        (["a", "b"], "xhat is no array of numbers"),
        ([0.0, 1j], "xhat is complex"),
        (None, r"xhat"),
        ([[0.0], [0.0, 1.0]], "xhat is no array of numbers"),
    ],
)
def test_states_of_the_wrong_kind(toy: Controller, xhat: object, message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        toy.step(xhat)  # type: ignore[arg-type]


def test_unknown_on_failure(toy: Controller) -> None:
    with pytest.raises(ControllerError, match="on_failure is 'ignore'; allowed: 'status', 'raise'"):
        toy.step(FIRST, on_failure="ignore")  # type: ignore[arg-type]


def test_any_layout_of_the_input(toy: Controller) -> None:
    expected, fresh = toy.copy().step(FIRST), toy
    strided = np.zeros((2, 3))
    strided[:, 1] = FIRST
    for xhat in (FIRST.tolist(), tuple(FIRST), strided[:, 1], FIRST.astype(">f8"), np.asfortranarray(FIRST)):
        np.testing.assert_array_equal(fresh.copy().step(xhat), expected)


def test_reset_and_shift(toy: Controller) -> None:
    toy.step(FIRST)
    x, u = toy.x.copy(), toy.u.copy()
    toy.shift()
    np.testing.assert_array_equal(toy.x[:-1], x[1:])
    np.testing.assert_array_equal(toy.u[:, 0], [*u[1:, 0], u[-1, 0]])
    toy.set_reference([1.0, 0.0, 0.0])
    toy.reset()
    np.testing.assert_array_equal(toy.x, np.tile([1.0, 0.0], (5, 1)))
    assert not toy.u.any()
    np.testing.assert_array_equal(toy.view("yref")[:, 0], 1.0)


@pytest.mark.parametrize("dt", [-1.0, np.nan, np.inf, "soon", None])
def test_integrate_takes_times(toy: Controller, dt: float) -> None:
    with pytest.raises(ControllerError, match=r"dt is .*; expected a finite number >= 0"):
        toy.integrate(np.zeros(toy.dims.nx), np.zeros(toy.dims.nu), dt)


def test_integrate(toy: Controller) -> None:
    toy.set_parameter("m", 2.0)
    np.testing.assert_allclose(toy.integrate([1.0, 3.0], [4.0], 0.5), [1.0 + 1.5 + 0.25, 4.0], rtol=1e-15)
    with pytest.raises(ControllerError, match=r"u has shape \(2,\); expected \(1,\)"):
        toy.integrate([1.0, 3.0], [4.0, 0.0], 0.5)


def test_the_solution_follows_the_data(toy: Controller) -> None:
    toy.set_bounds("a", -np.inf, np.inf)
    for k in range(4):
        toy.set_reference([0.1 * k, 0.2, 0.3], node=k)
        toy.set_parameter("m", 1.0 + 0.1 * k, node=k)
    toy.set_terminal_reference([0.3, 0.1])
    toy.set_weight(np.diag([3.0, 2.0, 1.0]))
    toy.set_terminal_weight([4.0, 5.0])
    toy.set_parameter("d", [0.01, -0.02])
    assert_optimal(toy)
    np.testing.assert_array_equal(toy.view("p")[:, 0], [1.0, 1.1, 1.2, 1.3, 1.0])
    np.testing.assert_array_equal(toy.view("W"), [[3.0, 2.0, 1.0]])


# -- views ------------------------------------------------------------------------------------------------------------


def test_views_are_the_memory_of_the_struct(toy: Controller) -> None:
    assert toy._memory.ctypes.data % ALIGNMENT == 0
    toy.x[2, 1] = 42.0
    assert toy._s.x[2][1] == 42.0
    toy.u = np.full((4, 1), 3.0)
    assert [toy._s.u[k][0] for k in range(4)] == [3.0] * 4
    toy.lam = np.ones((5, 2))
    toy.x = np.ones((5, 2))
    assert toy.cost == pytest.approx(4 * 0.5 * (10 + 1 + 0.1 * 9) + 0.5 * 110)
    with pytest.raises(ControllerError, match=r"u has shape \(4,\); expected \(4, 1\)"):
        toy.u = np.zeros(4)


def test_empty_dimensions_have_their_true_shape(toy: Controller) -> None:
    assert (toy.mu.shape, toy.mu_N.shape, toy.eta.shape) == ((4, 0), (0,), (0,))


def test_multipliers_of_rows_by_name() -> None:
    """They are copies that cannot be written by accident; an assignment reaches the vector of the C code."""
    ocp = OCP("rows", T=0.3, N=3)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares([x, u], [1.0, 1.0])
    ocp.subject_to(-1, x, 1)
    ocp.subject_to(-2, x + u, 2, at=[0, 2])
    ocp.subject_to(-3, x**2, 3, at="end")
    ocp.boundary(-4, ocp.at_start(x) + ocp.at_end(x), 4)
    c = build(ocp, profile="test")
    c.view("mult")[...] = np.arange(1.0, 8.0)  # x + u at node 0; x at 1; x, x + u at 2; x, x^2 at 3; coupled
    np.testing.assert_array_equal(c.mu_x, [[0], [2], [3], [5]])
    np.testing.assert_array_equal(c.mu, [[1], [0], [4]])
    assert (c.mu_N.tolist(), c.eta.tolist()) == ([6.0], [7.0])
    for name in ("mu_x", "mu", "mu_N", "eta"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(c, name)[...] = 0.0
        setattr(c, name, -getattr(c, name))
    np.testing.assert_array_equal(c.view("mult"), -np.arange(1.0, 8.0))
    with pytest.raises(ControllerError, match=r"mu\[1, 0\] is 2; expected 0, as no row is imposed there"):
        c.mu = np.full((3, 1), 2.0)
    with pytest.raises(ControllerError, match="mu_N has shape"):
        c.mu_N = np.zeros(3)


def test_inner_structs(toy: Controller) -> None:
    toy.step(FIRST)
    assert toy.view("node.S").shape == (4, 2, 3)
    np.testing.assert_allclose(toy.view("node.S")[0], [[1.0, 0.1, 0.005], [0.0, 1.0, 0.1]], rtol=1e-14)
    assert int(toy.view("prepared")) == 0


@pytest.mark.parametrize("path", ["sigma", "riccati.sigma", "x.sigma"])
def test_a_field_the_algorithm_does_not_have(toy: Controller, path: str) -> None:
    with pytest.raises(AttributeError, match=f"the algorithm of toy has no '{path}'"):
        toy.view(path)


def test_names_sizes_stats(toy: Controller) -> None:
    assert toy.names.parameters == ("m", "d[0]", "d[1]")
    assert toy.names.rows == ("a", "box[0]", "box[1]")
    assert (toy.names.states, toy.names.controls, toy.names.y, toy.names.y_N) == (
        ("p", "v"), ("a",), ("p", "v", "a"), ("p", "v"),
    )  # fmt: skip
    assert (toy.dims.N, toy.dims.nx, toy.dims.nu, toy.dims.np, toy.dims.nh_N) == (4, 2, 1, 3, 0)
    toy.step([1.0, 0.0])
    toy.step([-1.0, 0.0])
    assert toy.stats.active_set_changes >= 2
    assert toy.stats.qp_iterations >= 1
    assert toy.nbytes == toy._package.ffi.sizeof("toy_solver_t")
    assert repr(toy).startswith("<Controller toy: N=4, nx=2, nu=1, np=3, 3 rows; double, portable, profile test, ")


# -- copies -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "duplicate", [Controller.copy, copy.copy, copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))]
)
def test_a_copy_is_independent_and_continues_alike(toy: Controller, duplicate: object) -> None:
    toy.set_parameter("m", 1.5)
    toy.step(FIRST)
    twin = duplicate(toy)  # type: ignore[operator]
    np.testing.assert_array_equal(twin._memory, toy._memory)
    assert twin.profile == toy.profile
    np.testing.assert_array_equal(twin.step([0.02, 0.1]), toy.step([0.02, 0.1]))
    twin.reset()
    assert toy.x.any()


def test_save_and_load(toy: Controller, tmp_path: Path, toy_files: dict[str, str]) -> None:
    toy.set_reference([0.5, 0.0, 0.0])
    toy.step(FIRST)
    toy.save(tmp_path / "state")
    other = load(toy_files, "toy", "verify")
    other.load(tmp_path / "state")
    np.testing.assert_array_equal(other._memory, toy._memory)
    stream = io.BytesIO()
    toy.save(stream)
    stream.seek(0)
    toy.reset()
    toy.load(stream)
    np.testing.assert_array_equal(other._memory, toy._memory)


def test_load_refuses_another_package(toy: Controller, tmp_path: Path, toy_single_files: dict[str, str]) -> None:
    load(toy_single_files, "toy", "test").save(tmp_path / "single.npz")
    before = toy._memory.copy()
    with pytest.raises(ControllerError, match=r"single\.npz holds the state of another package"):
        toy.load(tmp_path / "single.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ControllerError, match=r"other\.npz is not a state"):
        toy.load(tmp_path / "other.npz")
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "junk.npz").write_bytes(b"no archive")
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "single.npz").read_bytes()[:200])
    for name in ("array.npy", "junk.npz", "empty.npz", "cut.npz"):
        with pytest.raises(ControllerError, match=f"{name} is not a state that"):
            toy.load(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        toy.load(tmp_path / "missing.npz")
    np.testing.assert_array_equal(toy._memory, before)


def test_two_controllers_in_two_threads(toy: Controller) -> None:
    from concurrent.futures import ThreadPoolExecutor

    twin = toy.copy()
    states = np.random.default_rng(1).normal(scale=0.1, size=(2000, 2))
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda c: np.array([c.step(x) for x in states]), (toy, twin))
    np.testing.assert_array_equal(first, second)


def test_python_runs_while_c_solves() -> None:
    """The GIL is released: another thread counts in the middle of long integrations."""
    import threading
    import time

    ctrl = problems.controller("crane")
    stamps: list[float] = []
    stop = threading.Event()

    def count() -> None:
        while not stop.wait(0.002):
            stamps.append(time.perf_counter())

    thread = threading.Thread(target=count)
    thread.start()
    start = time.perf_counter()
    for _ in range(8):
        ctrl.integrate(np.zeros(4), [0.1], 1e5)
    end = time.perf_counter()
    stop.set()
    thread.join()
    assert end - start > 0.05
    middle = [t for t in stamps if start + 0.2 * (end - start) < t < end - 0.2 * (end - start)]
    assert len(middle) >= 5


# Shapes with one number per node, names of other tools ---------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_scalars_per_node_need_no_second_dimension() -> None:
    """One number per node, with or without the end, or one for all nodes."""
    ocp = OCP("single", T=1.0, N=4)
    x, u, m = ocp.state("x"), ocp.control("u"), ocp.parameter("m", value=1.0)
    ocp.dynamics({x: u * m})
    ocp.least_squares(x, weight=1, scale_with_dt=True)
    ocp.terminal_least_squares(x, weight=1)
    ctrl = build(ocp, profile="test")
    ctrl.set_parameter("m", [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(ctrl.view("p")[:, 0], [1, 2, 3, 4, 5])
    ctrl.set_parameter("m", 7.0)
    np.testing.assert_array_equal(ctrl.view("p")[:, 0], 5 * [7.0])
    ctrl.set_parameter("m", 9.0, node=2)
    assert ctrl.view("p")[2, 0] == 9.0
    ctrl.set_reference([1, 2, 3, 4])
    np.testing.assert_array_equal(ctrl.view("yref")[:, 0], [1, 2, 3, 4])
    ctrl.set_reference(0.5)
    np.testing.assert_array_equal(ctrl.view("yref")[:, 0], 4 * [0.5])
    ctrl.set_reference([1, 2, 3, 4, 5])
    assert (ctrl.view("yref")[-1, 0], ctrl.view("yref_N")[0]) == (4.0, 5.0)
    for bad in ([1, 2, 3], np.zeros((5, 2))):
        with pytest.raises(ControllerError, match=r"\(1,\), or a number, or one row per node, \(4,\) or \(5,\)"):
            ctrl.set_reference(bad)
    with pytest.raises(ControllerError, match=r"has shape \(5,\); expected \(1,\), or a number$"):
        ctrl.set_parameter("m", [1, 2, 3, 4, 5], node=1)
    header = generate(ocp)["single.h"]
    assert "weight of the path residual; that is multiplied by dt_k where it is used" in header


def test_names_of_other_tools_are_explained(toy: Controller) -> None:
    with pytest.raises(AttributeError, match=r"'set'; here: set_reference\(\), set_parameter\(\)"):
        toy.set(0, "x", 1.0)
    with pytest.raises(AttributeError, match=r"'statuss'; did you mean 'status'\?"):
        _ = toy.statuss
    with pytest.raises(AttributeError, match=r"no attribute 'zebra'$"):
        _ = toy.zebra
    assert not hasattr(toy, "__array__")
