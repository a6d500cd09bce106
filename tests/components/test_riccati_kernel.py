"""The Riccati recursion against one dense KKT system."""

from __future__ import annotations

import ctypes
import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.components.riccati_harness import Shape, compiled, drawn_rows, memory_layout, source
from tests.components.riccati_oracle import StageProblem, equality_solution, random_problem

SHAPES = {
    "smallest": Shape(1, 1, 1),
    "one stage": Shape(1, 3, 2),
    "one control": Shape(8, 4, 1),
    "rows": Shape(5, 3, 2, tuple((k, i) for k in range(1, 6) for i in (-1, 0, 2, -1)[: 2 + k % 3])),
    "many rows": Shape(3, 5, 4, tuple((k, -1) for k in range(4) for _ in range(7))),
    "free": Shape(4, 5, 2, ((0, 1), (0, -1), (4, -1)), (1, 3, 4)),
    "all free": Shape(3, 2, 1, (), (0, 1)),
    "blocks of eight": Shape(3, 12, 4),
    "remainders": Shape(3, 21, 3),
    "rows of 17": Shape(2, 13, 4, ((0, 2), (1, -1))),
    "more than one tile": Shape(2, 29, 5, ((1, 3), (2, -1))),
    "many controls": Shape(3, 6, 13, ((2, -1), (2, 5))),
}
SHAPES |= {
    f"{name}, {form}": dataclasses.replace(SHAPES[name], form=form)
    for name in ("smallest", "rows", "many rows", "free", "blocks of eight", "remainders", "many controls")
    for form in ("scalar", "small")
}
seeds = st.integers(0, 2**32 - 1)
every_lanes = pytest.mark.parametrize("lanes", [1, 4, 8])
some = settings(max_examples=25, deadline=None)


@functools.cache
def built(shape: Shape, precision: str, lanes: int) -> tuple[ctypes.CDLL, np.dtype[Any]]:
    """The library of the recursion and the type of its struct, once per session."""
    library = compiled(source(shape, precision=precision, lanes=lanes))
    library.test_gradient.restype = ctypes.c_float if precision == "single" else ctypes.c_double
    return library, memory_layout(shape, precision=precision)


class Kernel:
    """The recursion on one problem."""

    def __init__(self, shape: Shape, precision: str = "double", lanes: int = 1) -> None:
        self.shape = shape
        self.library, layout = built(shape, precision, lanes)
        self.memory = np.zeros((), layout)
        self.library.test_init(self.pointer)

    @property
    def pointer(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.memory.ctypes.data)

    def load(self, problem: StageProblem, rows: np.ndarray) -> None:
        """The strict upper triangles are NaN, because they must not be read."""
        stage, hessian = self.memory["stage"], self.memory["hessian"]
        stage["S"][...], stage["b"][...] = problem.S, problem.b
        upper = np.triu(np.full(problem.Q[0].shape, np.nan), 1)
        hessian["Q"][...] = problem.Q + upper
        hessian["Q_N"][...] = problem.Q_N + upper[: problem.nx, : problem.nx]
        if len(rows):
            stage["J"][...] = rows
        self.problem = problem

    def right(self) -> None:
        """Set the right-hand sides, which a factorisation overwrites."""
        riccati, problem = self.memory["riccati"], self.problem
        g = riccati["work"]["vectors"]["rhs"]["g"]
        g[:-1], g[-1, : problem.nx] = problem.g, problem.g_N
        riccati["b"][...] = problem.b

    def factorize(self, last: int | None = None) -> int:
        return int(self.library.test_factorize(self.pointer, self.shape.ns if last is None else last))

    def substitute(self, x_0: np.ndarray, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        shape = self.shape
        self.right()
        self.library.test_backward(self.pointer, shape.ns if last is None else last)
        dtype = self.memory["stage"]["S"].dtype
        x, u = np.full((shape.ns + 1, shape.nx), np.nan, dtype), np.zeros((shape.ns, shape.nus), dtype)
        x[0] = x_0
        self.library.test_forward(self.pointer, x.ctypes.data_as(ctypes.c_void_p), u.ctypes.data_as(ctypes.c_void_p))
        return x, u

    def adjoint(self, k: int, x: np.ndarray) -> np.ndarray:
        lam = np.zeros_like(x)
        self.library.test_adjoint(
            self.pointer, k, x.ctypes.data_as(ctypes.c_void_p), lam.ctypes.data_as(ctypes.c_void_p)
        )
        return lam

    def gradient(self, k: int, j: int, x: np.ndarray, u: np.ndarray) -> float:
        pointers = (a.ctypes.data_as(ctypes.c_void_p) for a in (x, u))
        return float(self.library.test_gradient(self.pointer, k, j, *pointers))


def drawn(shape: Shape, rng: np.random.Generator) -> dict[str, Any]:
    """A problem with rows, weights, an additional diagonal and fixed controls."""
    problem = random_problem(rng, shape.ns, shape.nx, shape.nus, shape.free)
    rows = drawn_rows(rng, shape)
    weight = rng.choice([0.0, 1.0, 30.0], size=len(rows)) * rng.random(len(rows))
    diagonal, diagonal_free = rng.random((shape.ns, shape.nus)), rng.random(len(shape.free))
    fixed = rng.random((shape.ns, shape.nus)) < rng.choice([0.0, 0.3, 1.0])
    return {
        "problem": problem,
        "rows": rows,
        "weight": weight,
        "diagonal": diagonal,
        "diagonal_free": diagonal_free,
        "fixed": fixed,
        "du": rng.normal(size=fixed.shape),
    }


def loaded(kernel: Kernel, data: dict[str, Any]) -> None:
    shape = kernel.shape
    kernel.load(data["problem"], data["rows"])
    riccati = kernel.memory["riccati"]
    riccati["diagonal"][...] = data["diagonal"]
    if shape.rows:
        riccati["weight"][...] = data["weight"]
    if shape.free:
        riccati["diagonal_free"][...] = data["diagonal_free"]
    riccati["fixed"][...] = data["fixed"].ravel()
    riccati["du"][...] = data["du"].ravel()


def weighted(shape: Shape, data: dict[str, Any]) -> StageProblem:
    """The same problem with weights and diagonal included in its Hessian."""
    problem, nx = data["problem"], shape.nx
    Q, Q_N = problem.Q.copy(), problem.Q_N.copy()
    for k in range(shape.ns):
        Q[k, nx:, nx:] += np.diag(data["diagonal"][k])
    for i, more in zip(shape.free, data["diagonal_free"], strict=True):
        Q[0, i, i] += more
    for (k, _), a, w in zip(shape.rows, data["rows"], data["weight"], strict=True):
        if k < shape.ns:
            Q[k] += w * np.outer(a, a)
        else:
            Q_N += w * np.outer(a[:nx], a[:nx])
    return dataclasses.replace(problem, Q=Q, Q_N=Q_N)


def agrees(kernel: Kernel, data: dict[str, Any], x: np.ndarray, u: np.ndarray, limit: float = 1e-9) -> None:
    """x, u, adjoints and gradients of the controls are those of the dense solution."""
    shape = kernel.shape
    problem = weighted(shape, data)
    fixed = np.argwhere(data["fixed"])
    rows = np.zeros((len(fixed), problem.size))
    for row, (k, j) in zip(rows, fixed, strict=True):
        row[problem.u(k)][j] = 1
    w, lam, mult = equality_solution(problem, rows, data["du"][data["fixed"]])
    scale = np.abs(w).max() + np.abs(lam).max()
    for k in range(shape.ns + 1):
        np.testing.assert_allclose(x[k], w[problem.x(k)], atol=limit * scale)
    for k in range(shape.ns):
        np.testing.assert_allclose(u[k], w[problem.u(k)], atol=limit * scale)
        np.testing.assert_allclose(kernel.adjoint(k + 1, x[k + 1]), lam[k], atol=limit * scale)
        gradient = [kernel.gradient(k, j, x[k], u[k]) for j in range(shape.nus)]
        expected = np.zeros(shape.nus)
        expected[data["fixed"][k]] = -mult[fixed[:, 0] == k]
        np.testing.assert_allclose(gradient, expected, atol=limit * scale)


#: Register tiles, of four and eight lanes, are for matrices with padding.
TILED = [(name, lanes) for name in SHAPES for lanes in (1, 4, 8) if lanes == 1 or SHAPES[name].form != "small"]


@pytest.mark.few(12)
@pytest.mark.parametrize(("name", "lanes"), TILED)
@some
@given(seed=seeds)
def test_one_dense_kkt_system_agrees(name: str, lanes: int, seed: int) -> None:
    shape, rng = SHAPES[name], np.random.default_rng(seed)
    kernel = Kernel(shape, lanes=lanes)
    for _ in range(2):
        data = drawn(shape, rng)
        loaded(kernel, data)
        assert kernel.factorize() == 1
        agrees(kernel, data, *kernel.substitute(data["problem"].x_0))


@pytest.mark.few(6)
@every_lanes
@pytest.mark.parametrize("name", ["one control", "rows", "free", "many controls"])
@some
@given(seed=seeds)
def test_a_recursion_from_the_middle(name: str, lanes: int, seed: int) -> None:
    """Weights, fixed controls and vectors up to stage ``last`` change: later stages remain valid."""
    shape, rng = SHAPES[name], np.random.default_rng(seed)
    kernel = Kernel(shape, lanes=lanes)
    data, other = drawn(shape, rng), drawn(shape, rng)
    loaded(kernel, data)
    kernel.factorize()
    kernel.substitute(data["problem"].x_0)
    last = int(rng.integers(shape.ns))
    head = [k <= last for k, _ in shape.rows]
    data["weight"][head] = other["weight"][head]
    data["fixed"][: last + 1], data["du"][: last + 1] = other["fixed"][: last + 1], other["du"][: last + 1]
    data["problem"].g[: last + 1] = other["problem"].g[: last + 1]
    loaded(kernel, data)
    assert kernel.factorize(last) == 1
    agrees(kernel, data, *kernel.substitute(data["problem"].x_0, last))


@every_lanes
def test_a_pivot_that_is_not_positive_is_named(lanes: int) -> None:
    shape = SHAPES["one control"]
    kernel = Kernel(shape, lanes=lanes)
    data = drawn(shape, np.random.default_rng(1))
    data["fixed"][...] = False
    data["problem"].Q[5, -1, -1] = -1e3
    loaded(kernel, data)
    assert kernel.factorize() == 0
    assert kernel.memory["riccati"]["failed"] == 5
    data["fixed"][5] = True  # a fixed control needs no curvature
    loaded(kernel, data)
    assert kernel.factorize() == 1
    agrees(kernel, data, *kernel.substitute(data["problem"].x_0))


@every_lanes
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_data_that_are_not_finite_fail(bad: float, lanes: int) -> None:
    shape = SHAPES["remainders"]
    kernel = Kernel(shape, lanes=lanes)
    data = drawn(shape, np.random.default_rng(2))
    data["fixed"][...] = False
    data["problem"].S[1, 2, 20] = bad
    loaded(kernel, data)
    assert kernel.factorize() == 0


@every_lanes
def test_free_components_without_curvature_are_refused(lanes: int) -> None:
    shape = SHAPES["all free"]
    kernel = Kernel(shape, lanes=lanes)
    data = drawn(shape, np.random.default_rng(3))
    data["problem"].Q[0, 0, 0] = -1e3
    loaded(kernel, data)
    assert kernel.factorize() == 0
    assert kernel.memory["riccati"]["failed"] == -1


@every_lanes
def test_single_precision(lanes: int) -> None:
    shape = SHAPES["rows"]
    kernel = Kernel(shape, "single", lanes)
    data = drawn(shape, np.random.default_rng(4))
    loaded(kernel, data)
    assert kernel.factorize() == 1
    agrees(kernel, data, *kernel.substitute(data["problem"].x_0), limit=1e-3)
