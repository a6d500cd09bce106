"""Batches: the bits of single controllers for every number of threads, and data for all or some of them."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import Batch, ControllerError, Online, OptionError, Options, batch, build
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.batch.driver import EXACT, declarations_of, driver_text
from nmpc_codegen.runtime.build import load_library
from nmpc_codegen.runtime.controller import Controller
from tests.runtime.batch.problems import N, car, reactor

M = 23
RNG = np.random.default_rng(1)
X = np.array([1.0, 0.0, 0.0, 0.0]) + 0.3 * RNG.normal(size=(M, 4))


@pytest.fixture(scope="module")
def controller() -> Controller:
    return build(car(), Options(online=Online("node", "node", "node", "node")), "test")


@pytest.fixture(scope="module")
def shared() -> Controller:
    return build(car(), Options(online=Online("shared", "shared", "shared", "shared")), "test")


def same(many: Batch, singles: list[Controller]) -> None:
    """Every byte of every struct is that of the single controller."""
    for one, single in zip(many, singles, strict=True):
        np.testing.assert_array_equal(one._memory, single._memory)


@pytest.mark.few(2)
@pytest.mark.parametrize("threads", [1, 2, 5, None])
def test_calls_have_the_bits_of_single_controllers(controller: Controller, threads: int | None) -> None:
    many, singles, x = Batch(controller, M, threads), [controller.copy() for _ in range(M)], X.copy()
    many.driver._took |= {"step": 1.0, "integrate": 1.0}  # worth all threads
    for k in range(6):
        x[k] = np.nan if k == 3 else x[k]
        u, status = many.step(x)
        np.testing.assert_array_equal(u, [one.step(xi) for one, xi in zip(singles, x, strict=True)])
        np.testing.assert_array_equal(status, [one.status for one in singles])
        same(many, singles)
        moved = many.integrate(x, u, 0.25)
        np.testing.assert_array_equal(
            moved, [c.integrate(xi, ui, 0.25) for c, xi, ui in zip(singles, x, u, strict=True)]
        )
        assert (status[k] == Status.NOT_FINITE) == (k == 3)
        np.testing.assert_array_equal(many.stats["qp_iterations"], [one.stats.qp_iterations for one in singles])
        x = np.where(np.isfinite(moved), moved, X)
    np.testing.assert_array_equal(many.cost, [one.cost for one in singles])
    many.shift()
    many.reset(np.arange(M) % 2 == 0)
    for i, one in enumerate(singles):
        one.shift()
        if i % 2 == 0:
            one.reset()
    same(many, singles)
    np.testing.assert_array_equal(many.prepare(), [one.prepare() for one in singles])
    u, _ = many.feedback(X)
    np.testing.assert_array_equal(u, [one.feedback(xi) for one, xi in zip(singles, X, strict=True)])


def test_views_write_to_the_controllers(controller: Controller) -> None:
    many = batch(controller, 3)
    many.x[1] = 7.0
    many.u = np.full((3, N, 1), 0.5)
    many.mu_N = np.zeros_like(many.mu_N)
    one = many[-2]
    np.testing.assert_array_equal(one.x, np.full((N + 1, 4), 7.0))
    one.x[...] = 2.0
    assert (many.x[1] == 2.0).all()
    assert (many.u == 0.5).all()
    kept = one.copy()
    del many
    one.step(X[0])
    assert not np.array_equal(one.x, kept.x)
    assert len(batch(controller, 5)) == len(list(batch(controller, 5))) == 5


VALUES: dict[str, tuple[Any, Any]] = {
    "number": (0.7, lambda i: 0.7),
    "each": (np.linspace(0.5, 2, M), lambda i: np.linspace(0.5, 2, M)[i]),
    "nodes": (np.linspace(0.5, 2, N + 1)[None], lambda i: np.linspace(0.5, 2, N + 1)),
    "each and nodes": (
        np.linspace(0.5, 2, M * (N + 1)).reshape(M, N + 1),
        lambda i: np.linspace(0.5, 2, M * (N + 1)).reshape(M, N + 1)[i],
    ),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("form", VALUES)
def test_parameters(controller: Controller, shared: Controller, form: str) -> None:
    value, of = VALUES[form]
    for one in (controller,) if "nodes" in form else (controller, shared):
        many, singles = Batch(one, M), [one.copy() for _ in range(M)]
        many.set_parameter("m", value)
        many.set_parameter("k[1]", value)
        for i, single in enumerate(singles):
            single.set_parameter("m", of(i))
            single.set_parameter("k[1]", of(i))
        same(many, singles)
        u, _ = many.step(X)
        np.testing.assert_array_equal(u, [c.step(x) for c, x in zip(singles, X, strict=True)])


def test_data_for_all_and_for_some(controller: Controller) -> None:
    many, singles = batch(controller, M, threads=2), [controller.copy() for _ in range(M)]
    some = np.array([3, 20, 5])
    K, Y, v = RNG.uniform(0.1, 1, (3, 2)), RNG.normal(size=(M, N, 5)), RNG.normal(size=M)
    W, low = RNG.uniform(0.5, 2, (M, 5)), RNG.uniform(-1, -0.5, M)
    many.set_parameters({"k": K, "m": [2.0]}, index=some)
    many.set_parameter("k", [0.1, 0.9], node=2)
    many.set_reference(Y)
    many.set_reference({"p": np.full((1, N + 1), 0.3), "v": v})
    many.set_reference({"r1": 0.4}, index=np.arange(M) == 2)
    many.set_terminal_reference([[0.1, 0.2]], index=some)
    many.set_weight(W)
    many.set_weight(W[:1], node=3)
    many.set_reference({"p": Y[21:, :, 2]}, index=np.arange(M) > 20)
    many.set_terminal_weight(np.eye(2)[None] * 3)
    many.set_bounds("a", low, 1.5)
    many.set_bounds("v", np.full((1, N + 1), -0.8), 0.9, index=some)
    for i, one in enumerate(singles):
        if i in some:
            one.set_parameters({"k": K[list(some).index(i)], "m": 2.0})
        one.set_parameter("k", [0.1, 0.9], node=2)
        one.set_reference(Y[i])
        one.set_reference({"p": np.full(N + 1, 0.3), "v": v[i]})
        if i == 2:
            one.set_reference({"r1": 0.4})
        if i in some:
            one.set_terminal_reference([0.1, 0.2])
        one.set_weight(W[i])
        one.set_weight(W[0], node=3)
        if i > 20:
            one.set_reference({"p": Y[i, :, 2][:N]})
        one.set_terminal_weight(np.eye(2) * 3)
        one.set_bounds("a", low[i], 1.5)
        if i in some:
            one.set_bounds("v", np.full(N + 1, -0.8), 0.9)
    same(many, singles)
    u, _ = many.step(X)
    np.testing.assert_array_equal(u, [c.step(x) for c, x in zip(singles, X, strict=True)])


def test_weights_of_as_many_controllers_as_residuals() -> None:
    """A square array alone would be both: a diagonal for each, or a matrix for all."""
    ctrl = build(car(), Options(online=Online(dense_weight=True)), "test")
    many, W = Batch(ctrl, 5), np.diag(np.arange(1.0, 6.0)) + 0.1
    with pytest.raises(ControllerError, match=r"expected W\[None\] for a matrix, W\[:, None\] for diagonals"):
        many.set_weight(W)
    many.set_weight(W[None])
    single = ctrl.copy()
    single.set_weight(W)
    same(many, [single] * 5)
    many.set_weight(W[:, None])
    for i, one in enumerate(many):
        single.set_weight(W[i])
        np.testing.assert_array_equal(one._memory, single._memory)
    W[3, 3] = -1.0
    with pytest.raises(ControllerError, match="weight of controller 3 must be positive semidefinite"):
        many.set_weight(W[:, None])


def test_references_without_an_end() -> None:
    """The terminal residual is missing; names mean the path alone."""
    many = batch(build(reactor(), None, "test"), 3)
    many.set_reference({"x": [0.1, 0.2, 0.3]})
    np.testing.assert_array_equal(many.view("yref")[:, :, 0], np.repeat([[0.1], [0.2], [0.3]], 4, axis=1))
    with pytest.raises(ControllerError, match="has no terminal residual"):
        many.set_terminal_reference([0.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.step(X[:2]), r"X has shape \(2, 4\); expected \(23, 4\)"),
        (lambda m: m.set_parameter("m", np.ones(4)), r"parameter 'm' has shape \(4,\); expected .*\(23,\), \(1,\)"),
        (lambda m: m.set_parameter("m", np.full(M, 20.0)), "20 is outside of 0.1 .. 10"),
        (lambda m: m.set_parameter("mass", 1.0), "no parameter 'mass'"),
        (lambda m: m.set_reference(np.full(5, np.nan)), "holds a NaN"),
        (lambda m: m.set_bounds("a", np.full(M, 1.0), np.linspace(0, 2, M)), "lower .* above upper"),
        (lambda m: m.set_weight(-np.ones(5)), "positive semidefinite"),
        (lambda m: m.set_parameter("m", 1.0, index=[1, 1]), "names a controller twice"),
        (lambda m: m.set_parameter("m", 1.0, index=[M]), "names controller 23 of 23"),
        (lambda m: m.reset(np.ones(3, bool)), "expected integers, or a mask"),
        (lambda m: m.solve(X, tol=-1), "tol is -1"),
        (lambda m: m.solve(X, max_iterations=2**40), "max_iterations is"),
        (lambda m: m.integrate(X, np.zeros((M, 1)), "a"), "expected a finite number >= 0"),
        (lambda m: m.set_weight(np.eye(5)[:, None] - 2), "weight has shape"),
        (lambda m: Batch(m[0], 0), "number is 0"),
        (lambda m: Batch(m[0], 2, threads=0), "threads is 0"),
        (lambda m: Batch(m, 2), "expected an OCP or a Controller"),
    ],
)
def test_bad_input_changes_nothing(controller: Controller, call: Any, message: str) -> None:
    many = batch(controller, M)
    before = many.memory.copy()
    with pytest.raises(ControllerError, match=message):
        call(many)
    np.testing.assert_array_equal(many.memory, before)


def test_options_belong_to_problems(controller: Controller) -> None:
    with pytest.raises(OptionError, match="options belong to a problem"):
        batch(controller, 2, Options())
    with pytest.raises(IndexError, match="controller 2 of 2"):
        batch(controller, 2)[2]


@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_driver_compiles_without_a_warning(precision: str) -> None:
    header = declarations_of("driver.h", "device.h")
    load_library(
        {"batch.h": header, "batch.c": driver_text(precision)},
        "batch",
        EXACT,
        warnings_as_errors=True,
    )


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_fork_has_threads_of_its_own(controller: Controller) -> None:
    many = Batch(controller, M, 2)
    expected, _ = Batch(controller, M, 2).step(X)
    many.driver._took["step"] = 1.0  # worth a thread
    many.step(X)
    many.reset()
    assert many.driver._pool is not None
    child = os.fork()
    if child == 0:  # pragma: no cover - in another process
        u, _ = Batch(controller, M, 2).step(X)
        again, _ = many.step(X)
        os._exit(0 if np.array_equal(u, expected) and np.isfinite(again).all() else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
