"""Problems that fall into parts, or are at rest: all terms of one part may be the rounding errors of another one."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, NoCondensing, Options, build
from verification.routes import PURE, ROUTES

PRECISIONS = ("double", "single")
SOLVERS = {name: ROUTES[name][1] for name in ("dense", "riccati", "interior")}


def _thrusters() -> OCP:
    """A body in the plane with two pairs of thrusters that push against each other, and a first guess far from rest."""
    ocp = OCP("thrusters", T=2.0, N=12)
    p, v = [ocp.state(name, initial=0.5) for name in ("px", "py")], [ocp.state(name) for name in ("vx", "vy")]
    u = [ocp.control(f"u{j}") for j in range(4)]
    angle = ocp.state("angle", initial=0.2)
    ocp.dynamics({p[0]: v[0], p[1]: v[1], angle: -angle})
    ocp.dynamics({v[0]: ca.cos(angle) * (u[0] - u[2]), v[1]: ca.cos(angle) * (u[1] - u[3])})
    ocp.least_squares(ca.vertcat(ocp.x, *u), weight=[10.0] * 2 + [1.0] * 3 + [0.1] * 4, reference=[0.0] * 5 + [1.2] * 4)
    ocp.terminal_least_squares(ocp.x, weight=[100.0] * 2 + [10.0] * 3)
    ocp.subject_to(0.0, ca.vertcat(*u), 2.5)
    return ocp


ROWS: dict[str, Callable[[OCP], None]] = {
    "bounds": lambda ocp: None,
    "terminal equality": lambda ocp: ocp.subject_to(0.0, ocp.x[:4], 0.0, at="end"),
    "soft": lambda ocp: ocp.subject_to(-0.05, ocp.x[2:4], 0.05, soft=(5.0, 1.0)),
}
CASES = [
    *((name, "bounds", precision) for name, precision in itertools.product(SOLVERS, PRECISIONS)),
    ("dense", "terminal equality", "double"),
    ("riccati", "terminal equality", "double"),
    ("interior", "soft", "double"),
]


@pytest.mark.few(5)
@pytest.mark.parametrize(("name", "rows", "precision"), CASES)
def test_one_part_moves_and_the_others_rest(name: str, rows: str, precision: Any) -> None:
    ocp = _thrusters()
    ROWS[rows](ocp)
    condensing = {} if name == "dense" else {"condensing": NoCondensing()}
    ctrl = build(ocp, Options(qp=SOLVERS[name], precision=precision, algorithm=PURE, **condensing), profile="test")
    for component, size, sign in itertools.product(range(5), (1e-12, 1e-6, 1e-3, 0.1), (1, -1)):
        x = np.zeros(5)
        x[component] = sign * size
        ctrl.reset()
        found = [(ctrl.step(x), ctrl.status.name)[1] for _ in range(3)]
        assert set(found) <= {"OK", "RELAXED"}, (component, sign * size, found)


@pytest.mark.parametrize("name", ["dense", "interior"])
def test_numbers_whose_squares_underflow(name: str) -> None:
    """A plan at rest ends among the smallest numbers of single precision, where costs and products vanish."""
    ocp = OCP("settled", T=1.0, N=2)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -(x**3) + u})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    ocp.terminal_least_squares(x, weight=[1.0])
    ocp.subject_to(-1, u, 1)
    condensing = {} if name == "dense" else {"condensing": NoCondensing()}
    ctrl = build(ocp, Options(qp=SOLVERS[name], precision="single", algorithm=PURE, **condensing), profile="test")
    lengths = (1e-8, 1e-12, 1e-20, 1e-42, 2e-43, 3e-44)
    for length, sign in itertools.product(lengths, (1, -1)):
        found = [(ctrl.step([sign * length]), ctrl.status.name)[1] for _ in range(3)]
        assert set(found) == {"OK"}, (sign * length, found)
