"""The stage products, written out and as loops: run on SX against NumPy, and their text against the expected one."""

from __future__ import annotations

import numpy as np
import pytest

from nmpc_codegen.ir import stage_products
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.stage_products import Pattern, Products
from nmpc_codegen.ir.sweep import unroll
from nmpc_codegen.ir.tuning import COLUMNS
from nmpc_codegen.package.opcount import OpCount

WRITTEN_OUT = {"nonzeros": 10**9, "loops": -1}
SIZES = ((1, 1), (2, 1), (4, 2), (5, 3), (9, 1))


def random_products(nx: int, nu: int, seed: int) -> tuple[Products, dict[str, np.ndarray]]:
    """Random patterns with one third nonzeros, numbers on them, and all operands."""
    random = np.random.default_rng(seed)
    nz = nx + nu

    def matrix(rows: int, cols: int, lower: bool) -> np.ndarray:
        full = random.uniform(-1, 1, (rows, cols)) * (random.uniform(size=(rows, cols)) < 0.4)
        return np.tril(full) if lower else full

    data = {"S": matrix(nx, nz, False), "Q": matrix(nz, nz, True), "Q_N": matrix(nx, nx, True)}
    S, Q, Q_N = (_nonzeros(data[name]) for name in ("S", "Q", "Q_N"))
    for name, size in (("b", nx), ("g", nz), ("dx", nx), ("du", nu), ("w", nz)):
        data[name] = random.uniform(-1, 1, size)
    for name in ("G", "W"):
        data[name] = random.uniform(-1, 1, (nx, COLUMNS))
    return Products(nx, nu, S, Q, Q_N), data


def _nonzeros(matrix: np.ndarray) -> Pattern:
    return frozenset((int(r), int(c)) for r, c in np.argwhere(matrix))


def expected(nx: int, d: dict[str, np.ndarray]) -> dict[str, list[np.ndarray]]:
    """The same products with full matrices."""
    S, A = d["S"], d["S"][:, :nx]
    Q, Q_N = (d[n] + np.tril(d[n], -1).T for n in ("Q", "Q_N"))
    z = np.concatenate([d["dx"], d["du"]])
    back = S.T @ d["W"] + Q[:, :nx] @ d["G"]
    return {
        "state_step": [d["b"] + S @ z],
        "adjoint_step": [d["g"] + Q @ z + S.T @ d["w"][:nx]],
        "cost_gradient": [d["g"] + Q @ z],
        "terminal_adjoint": [d["g"][:nx] + Q_N @ d["dx"]],
        "condense_forward_panel": [A @ d["G"]],
        "condense_terminal_panel": [Q_N @ d["G"]],
        "condense_backward_panel": [back[:nx], back[nx:]],
    }


@pytest.mark.few(5)
@pytest.mark.parametrize("spelling", WRITTEN_OUT)
@pytest.mark.parametrize(("nx", "nu"), SIZES)
def test_products_against_numpy(nx: int, nu: int, spelling: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stage_products, "WRITTEN_OUT", WRITTEN_OUT[spelling])
    for seed in range(5):
        products, data = random_products(nx, nu, seed)
        results = expected(nx, data)
        routines = {**products.vectors, **products.panels}
        assert set(results) - set(routines) <= ({"condense_terminal_panel"} if not products.Q_N else set())
        for name, routine in routines.items():
            terminal = name in ("terminal_adjoint", "condense_terminal_panel")
            operands = {**data, "g": data["g"][:nx], "Q": data["Q_N"]} if terminal else data
            found = unroll(routine.sweep).call([operands[p.name].ravel() for p in routine.inputs])
            for value, result in zip(found, results[name], strict=True):
                full = np.array(value).ravel()
                np.testing.assert_allclose(full, result.ravel(), rtol=1e-13, atol=1e-14, err_msg=f"{name}, seed {seed}")


def test_dense_loops_stop_at_sizes_and_skip_what_is_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    """No nonzero of Q is in a column of the states: its rows of the controls have no effect and are not passed."""
    monkeypatch.setattr(stage_products, "WRITTEN_OUT", -1)
    S = frozenset((i, j) for i in range(5) for j in range(6))
    products = Products(5, 1, S, frozenset({(5, 5)}), frozenset())
    text = print_routine(products.panels["condense_backward_panel"], CStyle("real_t", False))
    assert "Q_row" not in text
    assert "(*Q)" not in text
    assert "int k" not in text.split("{")[0]
    count = products.panels["condense_backward_panel"].count
    assert count == OpCount(add=5 * 6, mul=5 * 6) * COLUMNS
    assert products.vectors["adjoint_step"].count == OpCount(add=31, mul=31)


def test_printed_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes by name, a scalar declared at its first use, matrices by row and column."""
    monkeypatch.setattr(stage_products, "WRITTEN_OUT", -1)
    products = Products(2, 1, frozenset({(0, 0)}), frozenset({(0, 0), (2, 0)}), frozenset())
    style = CStyle("real_t", False)
    expected = """\
/* y = b + A dx + B du: 6 add, 6 mul */
static void state_step(const node_t *node, const real_t *dx, const real_t *du, real_t *y)
{
    for (int i = 0; i < NX; ++i) {
        real_t sum = node->b[i];
        for (int j = 0; j < NX; ++j) {
            sum += node->S[i][j] * dx[j];
        }
        for (int j = 0; j < NU; ++j) {
            sum += node->S[i][j + NX] * du[j];
        }
        y[i] = sum;
    }
}"""
    assert print_routine(products.vectors["state_step"], style) == expected
    backward = print_routine(products.panels["condense_backward_panel"], style)
    mixed = """\
    for (int n = 1; n < 2; ++n) {
        const int a = Q_row[n], b = Q_column[n];
        if (b < NX) {
            const real_t Q_0 = Q[a][b];
            for (int l = 0; l < COLUMNS; ++l) {
                p->T[a - 2][l] += Q_0 * p->G[k][b][l];
            }
        }
    }
}"""
    assert backward.endswith(mixed)


def test_long_sums_are_broken_in_front_of_a_plus() -> None:
    n = 30
    row = frozenset((0, j) for j in range(n))
    products = Products(n, 1, row, frozenset(), frozenset())
    lines = print_routine(products.vectors["state_step"], CStyle("real_t", False)).splitlines()
    assert max(map(len, lines)) <= 120
    assert sum(line.startswith("        + node->S[0]") for line in lines) >= 5
    assert "y_0 = node->b[0] + node->S[0][0] * dx[0]" in lines[3]
