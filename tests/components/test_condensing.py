"""Condensing in C with random stage data, against dense elimination by a linear solver.

Both code styles of the stage products run on the same problems and the same data.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples import crane
from nmpc_codegen import OCP, DenseActiveSet, Options
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir import stage_products as products
from nmpc_codegen.ir.tuning import COLUMNS
from nmpc_codegen.package.opcount import OpCount
from tests.components.condensing_oracle import Condensed, StageData, condense, condense_row, multipliers
from verification.c_harness import Package, module_of

FUNCTIONS = (
    "condense_matrices",
    "condense_gradient",
    "condense_rows",
    "condense_embed",
    "condense_expand",
    "recover_multipliers",
)
SPELLINGS = {"nonzeros": 10**9, "loops": -1}

#: The orders of summation differ; data are of order 1, and states grow with N.
TOLERANCE = 1e-12


def chain(name: str, nx: int, nu: int, N: int, uniform: bool = True) -> OCP:
    """A coupled nonlinear model of any size with a residual that depends on all variables."""
    grid: dict[str, Any] = {"T": 0.2 * N, "N": N} if uniform else {"intervals": [0.1 + 0.05 * k for k in range(N)]}
    ocp = OCP(name, **grid)
    x, u = ocp.state("x", size=nx), ocp.control("u", size=nu)
    rate = [ca.sin(x[(i + 1) % nx]) - x[i] + u[i % nu] * (1 + x[0]) for i in range(nx)]
    ocp.dynamics(ca.vertcat(*rate))
    y = ca.vertcat(ca.sin(x) + ca.sum1(u), u)
    ocp.least_squares(y, weight=np.diag(np.arange(1.0, nx + nu + 1)) + 0.1)
    ocp.terminal_least_squares(ca.vertcat(x[0] * x[-1], x), weight=np.ones(nx + 1))
    return ocp


def bare() -> OCP:
    """No rows, N = 1."""
    return chain("bare", 2, 1, 1)


def bounded() -> OCP:
    """Control and state bounds."""
    ocp = chain("bounded", 3, 2, 4)
    ocp.subject_to(-1, ocp.u, 1)
    ocp.subject_to(-1, ocp.x[1], np.inf)
    return ocp


def general() -> OCP:
    """Path rows with and without a control, terminal rows, an equality at the end; nonuniform grid."""
    ocp = chain("general", 2, 2, 5, uniform=False)
    x, u = ocp.x, ocp.u
    ocp.subject_to(-1, x[0] * u[1] + u[0], 1, name="mixed")
    ocp.subject_to(-1, x[0] ** 2 + x[1], np.inf, name="curve")
    ocp.subject_to(0, ca.vertcat(x[0] - x[1], x[0] * x[1]), 0.5, at="end", name="gate")
    ocp.subject_to(0.1, x[1], 0.1, at="end")
    return ocp


def sparse() -> OCP:
    """A double integrator whose cost contains one state only: columns of A, rows of S and states without nonzeros."""
    ocp = OCP("sparse", N=3)
    x, u = ocp.state("x", size=4), ocp.control("u", size=2)
    ocp.dynamics(ca.vertcat(x[0] + x[1], x[1] + u[0], 0 * x[2], u[1]), discrete=True)
    ocp.least_squares(ca.vertcat(x[0], u[0]), weight=[1.0, 2.0])
    ocp.subject_to(-1, x[3] + u[1], 1, name="row")
    return ocp


def wide() -> OCP:
    """More than one panel of columns at every node, one control."""
    return chain("wide", 5, 1, 9)


PROBLEMS: dict[str, Callable[[], OCP]] = {f.__name__: f for f in (bare, bounded, general, sparse, wide)}
PROBLEMS["crane"] = crane.build_ocp


@functools.cache
def package(name: str, spelling: str) -> Package:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(products, "WRITTEN_OUT", SPELLINGS[spelling])
        module = module_of(PROBLEMS[name](), Options(qp=DenseActiveSet()))
        assert module.products.spelling == spelling
        return Package(module, FUNCTIONS)


@functools.cache
def problem(name: str) -> Problem:
    return classify(PROBLEMS[name]())


def existing(struct: np.ndarray, *fields: str) -> list[str]:
    """The data of the members that the package has."""
    return [field for field in fields if field in (struct.dtype.names or ())]


def fill(p: Package, name: str, seed: int) -> StageData:
    """Random data on the structural nonzeros; the rest of the matrices is zero, as the C code guarantees."""
    random = np.random.default_rng(seed)
    stated = problem(name)
    N, nx, nu = stated.N, stated.nx, stated.nu
    pattern = p.module.products

    def on(nonzeros: frozenset[tuple[int, int]], shape: tuple[int, ...]) -> np.ndarray:
        mask = np.zeros(shape[-2:])
        for r, c in nonzeros:
            mask[r, c] = 1
        return random.uniform(-1, 1, shape) * mask

    nodes = p["node"]
    nodes["S"] = on(pattern.S, (N, nx, nx + nu))
    for field in ("b", "g", *existing(nodes, "h", "J")):
        nodes[field] = random.uniform(-1, 1, nodes[field].shape)
    p["terminal"]["g"][...] = random.uniform(-1, 1, nx)
    for field in existing(p["terminal"], "h", "J"):
        p["terminal"][field][...] = random.uniform(-1, 1, p["terminal"][field].shape)
    Q = p["hessian"]["Q"]
    Q_N = p["hessian"]["Q_N"] if existing(p["hessian"], "Q_N") else np.zeros((nx, nx))
    Q[...] = np.tril(on(pattern.Q, Q.shape))
    Q_N[...] = np.tril(on(pattern.Q_N, Q_N.shape))
    for field in existing(p.memory, "x", "u", "lower", "upper", "mu_u", "mult"):
        p[field][...] = random.uniform(-1, 1, p[field].shape)
    symmetric = np.broadcast_to(Q + np.tril(Q, -1).transpose(0, 2, 1), (N, nx + nu, nx + nu))
    return StageData(
        S=nodes["S"].copy(),
        b=nodes["b"].copy(),
        Q=symmetric,
        g=nodes["g"].copy(),
        Q_N=Q_N + np.tril(Q_N, -1).T,
        g_N=p["terminal"]["g"].copy(),
    )


def prepared(name: str, spelling: str, seed: int) -> tuple[Package, StageData, Condensed]:
    p = package(name, spelling)
    d = fill(p, name, seed)
    for function in FUNCTIONS[:3]:
        p.call(function)
    return p, d, condense(d)


CASES = [(name, spelling, seed) for name in PROBLEMS for spelling in SPELLINGS for seed in (0, 1)]
every_case = pytest.mark.parametrize(("name", "spelling", "seed"), CASES)


def close(value: np.ndarray, expected: np.ndarray) -> None:
    scale = max(1.0, float(np.max(np.abs(expected), initial=0)))
    np.testing.assert_allclose(value, expected, rtol=0, atol=TOLERANCE * scale)


@every_case
def test_hessian_and_gradient(name: str, spelling: str, seed: int) -> None:
    p, d, expected = prepared(name, spelling, seed)
    nv = d.N * d.nu
    close(np.tril(p["qp"]["H"][:nv, :nv]), np.tril(expected.H))
    close(p["condensed"]["Hx"], expected.Hx)
    close(p["condensed"]["g"], expected.g)
    close(p["condensed"]["c"].ravel(), expected.c)


@every_case
def test_rows(name: str, spelling: str, seed: int) -> None:
    p, d, condensed = prepared(name, spelling, seed)
    rows = problem(name).qp_rows
    assert p.module.value("NG") == len(rows)
    for m, (k, is_general, index, _) in enumerate(rows):
        J = np.zeros(d.nx + d.nu)
        if not is_general:
            J[index], value = 1, p["x"][k, index]
        elif k == d.N:
            J[: d.nx], value = p["terminal"]["J"][index], p["terminal"]["h"][index]
        else:
            J, value = p["node"]["J"][k, index], p["node"]["h"][k, index]
        a, ax, v = condense_row(condensed, d, k, J, value)
        close(p["qp"]["A"][m, : d.N * d.nu], a)
        close(p["condensed"]["Ax"][m], ax)
        close(p["condensed"]["v"][m], v)
        assert not p["qp"]["A"][m, d.N * d.nu :].any(), "the padding belongs to the QP solver's contract"


@every_case
def test_embedding_and_expansion(name: str, spelling: str, seed: int) -> None:
    """Gradient and bounds of the QP for a measured state, then the states for a given du."""
    p, d, condensed = prepared(name, spelling, seed)
    stated, N, nv = problem(name), d.N, d.N * d.nu
    random = np.random.default_rng(seed + 100)
    dx0, du = random.uniform(-1, 1, d.nx), random.uniform(-1, 1, nv)
    p["step"]["dx"][0] = dx0
    p.call("condense_embed")
    close(p["qp"]["g"][:nv], condensed.g + condensed.Hx @ dx0)
    bounds = {r.index: i for i, r in enumerate(stated.rows) if r.kind == "control"}
    for which, infinite in (("lower", -np.inf), ("upper", np.inf)):
        expected = [
            (p[which][0, bounds[j]] if j in bounds else infinite) - p["u"][k, j] for k in range(N) for j in range(d.nu)
        ]
        np.testing.assert_array_equal(p["qp"][which][:nv], expected)
        for m, (k, _, _, identity) in enumerate(stated.qp_rows):
            value = p["condensed"]["v"][m] + p["condensed"]["Ax"][m] @ dx0
            close(p["qp"][which][nv + m], p[which][int(k == N), identity] - value)
    p["qp"]["z"][...] = du
    p.call("condense_expand")
    close(p["step"]["dx"].ravel(), condensed.X0 @ dx0 + condensed.U @ du + condensed.c)


@every_case
def test_multipliers(name: str, spelling: str, seed: int) -> None:
    """lam makes the Lagrangian of the stage QP stationary in every state, for any values of the other multipliers."""
    p, d, condensed = prepared(name, spelling, seed)
    stated, N = problem(name), d.N
    random = np.random.default_rng(seed + 200)
    dx0, du = random.uniform(-1, 1, d.nx), random.uniform(-1, 1, N * d.nu)
    p["step"]["dx"][0], p["qp"]["z"][...] = dx0, du
    p.call("condense_expand")
    p.call("recover_multipliers")
    extra = np.zeros((N + 1, d.nx))
    for m, (k, _, _, row) in enumerate(stated.qp_rows):
        J = p["terminal"]["J"] if k == N and stated.terminal.nh else p["node"]["J"][k % N] if stated.path.nh else None
        extra[k] += p["step"]["mult"][m] * stated.rows[row].value(np.eye(d.nx), None, J, None, k == N)[: d.nx]
    dx = (condensed.X0 @ dx0 + condensed.U @ du + condensed.c).reshape(N + 1, d.nx)
    close(p["lam"], multipliers(d, dx, du.reshape(N, d.nu), extra))


@pytest.mark.parametrize("name", PROBLEMS)
def test_both_spellings_agree(name: str) -> None:
    """Equality on the same data, up to rounding."""
    found = [prepared(name, spelling, 3)[0] for spelling in SPELLINGS]
    for struct, field in (
        ("condensed", "Hx"),
        ("condensed", "g"),
        ("condensed", "Ax"),
        ("condensed", "v"),
        ("qp", "A"),
    ):
        if field not in found[0][struct].dtype.names:  # a problem without rows
            continue
        close(found[0][struct][field], found[1][struct][field])


def test_patterns_are_not_all_dense() -> None:
    """The sparse problem has the structure stated in its docstring; else empty rows and columns are not tested."""
    p = package("sparse", "nonzeros").module.products
    assert sorted(p.S) == [(0, 0), (0, 1), (1, 1), (1, 4), (3, 5)]
    assert p.panels["condense_forward_panel"].count == OpCount(add=COLUMNS, mul=3 * COLUMNS)
    assert sorted(p.Q) == [(0, 0), (4, 4)]
    assert not p.Q_N


def test_small_models_are_written_out_and_large_ones_looped() -> None:
    assert module_of(crane.build_ocp()).products.spelling == "nonzeros"
    big = chain("big", 12, 2, 2)
    assert module_of(big).products.spelling == "loops"
