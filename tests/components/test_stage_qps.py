"""Every registered QP solver on random stage QPs, judged by the constructed optimum; and tests of the judge.

There is one package per dimensions and solver, with 15 or 25 data sets each drawn by hypothesis, which shrinks kind,
active rows and digits. Every solver gets the five structures of SMALL, and the others in turn; the topic
"qps" of the benchmarks draws QPs for all solvers.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, note, settings
from hypothesis import strategies as st

from nmpc_codegen import Options
from tests.components.qp_plugins import point_of, silent, solve, stage_form, violation
from verification.oracles.stage_qp import (
    Point,
    Shape,
    condition,
    distance,
    natural_residual,
    objective_error,
    residuals,
)
from verification.oracles.stage_qp_random import INFEASIBLE, KINDS, SEMIDEFINITE, condensed_rows, kinds_of, random_qp
from verification.qp.certificate import certificate
from verification.qp.stage_solvers import StageSolver, build_all, holds, solvers

#: One of every structure, small enough for foreign solvers.
SMALL = (
    Shape(1, 1, 1),
    Shape(4, 2, 6, states=2, path=2, pure=1, end=2, soft=(1, 3)),
    Shape(3, 1, 10, end=3),
    Shape(3, 2, 5, free=2, states=3, pure=1),
    Shape(5, 3, 8, coupled=2, path=1, soft=(2,)),
)

#: Shapes for which the solvers are designed: every structure, from the smallest to nx = 30.
SHAPES = (
    *SMALL,
    Shape(1, 1, 2, states=1),
    Shape(2, 1, 1, states=1, path=1, pure=1, end=1),
    Shape(1, 1, 12, controls=0),  # no row, no bound
    Shape(2, 2, 5, controls=0),
    Shape(2, 1, 6, controls=0, states=2, path=1),  # rows only
    Shape(4, 2, 3, controls=1),
    Shape(4, 1, 10, end=4),  # the crane: more terminal equalities than controls of a stage
    Shape(6, 2, 4, end=6, states=1),
    Shape(2, 3, 4, path=3),  # rows with controls only, as many as controls
    Shape(3, 1, 8, pure=2),
    Shape(3, 3, 6, states=3),
    Shape(2, 1, 20, states=1, path=1),
    Shape(5, 2, 7, states=2, soft=(0,)),
    Shape(3, 2, 6, states=1, path=2, end=1, soft=(0, 1, 2, 3)),  # soft rows only
    Shape(4, 2, 5, end=3, soft=(0, 1)),
    Shape(3, 1, 7, path=2, coupled=1, soft=(2,)),
    Shape(3, 2, 4, coupled=3),
    Shape(4, 2, 5, states=2, end=2, free=1),
    Shape(3, 1, 4, path=1, soft=(0,), free=3),
    Shape(2, 1, 1, coupled=1, free=1),
    Shape(3, 1, 8, pure=1, coupled=3, free=3),
    Shape(5, 3, 7, states=2, path=1, coupled=3, soft=(4,), free=3),
    Shape(9, 3, 9, states=1, end=2),
    Shape(12, 4, 6, states=3, path=1),
    Shape(21, 3, 5),
    Shape(30, 2, 3, states=4, path=1, end=2),
    Shape(2, 8, 4, path=2),
)
CONVEX = tuple(kind for kind in KINDS if kind != "reduced")
ALL_KINDS = (*KINDS, SEMIDEFINITE)


# The judge ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", SMALL, ids=str)
@pytest.mark.parametrize("kind", ALL_KINDS)
def test_constructed_points_are_optimal(shape: Shape, kind: str) -> None:
    for seed in range(3):
        qp = random_qp(shape, kind, seed)
        assert qp.optimum is not None
        assert residuals(qp, qp.optimum).worst <= 1e-13
        assert distance(qp, qp.optimum) == objective_error(qp, qp.optimum) == 0


@pytest.mark.parametrize("plugin", ["qpoases", "proxqp"])
@pytest.mark.parametrize("shape", SMALL, ids=str)
def test_foreign_solvers_find_the_constructed_optimum(shape: Shape, plugin: str) -> None:
    """qpOASES to rounding accuracy also for indefinite blocks; ProxQP, which needs convex blocks, to its tolerance."""
    if not ca.has_conic(plugin):
        pytest.skip(f"this CasADi has no {plugin}")
    tolerance = {"qpoases": 1e-9, "proxqp": 1e-5}[plugin]
    for kind in (*(KINDS if plugin == "qpoases" else CONVEX), SEMIDEFINITE):
        qp = random_qp(shape, kind, 7)
        form = stage_form(qp)
        if kind == "scaled":
            continue  # in units that are unsuitable for absolute tolerances
        with silent():
            found, w = solve(plugin, form)
        p = point_of(qp, w)
        assert found, kind
        assert violation(qp, p) <= tolerance, kind
        assert (distance(qp, p) if qp.unique else objective_error(qp, p)) <= tolerance, kind


def test_scaled_problems_are_the_same_in_other_units() -> None:
    """Residuals and distances do not depend on the units; the numbers span many powers of ten."""
    qp = random_qp(SMALL[2], "scaled", 0)
    assert qp.unit_x.max() / qp.unit_x.min() > 1e3
    assert qp.optimum is not None
    off = dataclasses.replace(qp.optimum, du=qp.optimum.du + 1e-3 * qp.unit_u)
    assert 1e-4 < distance(qp, off) <= 1e-3
    assert residuals(qp, off).worst > 1e-5


@pytest.mark.parametrize("shape", SMALL, ids=str)
def test_the_judge_sees_every_error(shape: Shape) -> None:
    """Wrong steps, wrong multipliers, a multiplier of the wrong sign, a missing row."""
    rng = np.random.default_rng(0)
    for kind in ("plain", "degenerate", "redundant"):
        qp = random_qp(shape, kind, 3, active=0.8)
        p = qp.optimum
        assert p is not None
        for name in Point.__dataclass_fields__:
            value = getattr(p, name)
            if value.size == 0:
                continue
            off = value.copy()
            off.flat[rng.integers(off.size)] += 1e-3
            assert residuals(qp, dataclasses.replace(p, **{name: off})).worst > 1e-6, (kind, name)
            broken = off * np.nan
            assert not residuals(qp, dataclasses.replace(p, **{name: broken})).worst <= 1.0, (kind, name)


def test_natural_residual() -> None:
    """Zero on the graph of the subdifferential, the distance along the diagonal off it."""
    one = np.ones(1)

    def residual(value: float, mult: float, l1: float = np.inf, l2: float = 0.0) -> float:
        return float(natural_residual(value * one, mult * one, -one, one, l1 * one, l2 * one, one)[0])

    for value, mult in ((0.3, 0.0), (1.0, 0.0), (1.0, 7.0), (-1.0, -2.0)):
        assert residual(value, mult) == 0
    for value, mult in ((0.3, 0.1), (1.2, 0.0), (1.2, 5.0), (-1.0, 0.5), (1.0, -0.5)):
        assert residual(value, mult) >= 0.1
    for value, mult in ((0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (1.5, 2.0 + 3.0 * 0.5), (-1.2, -2.0 - 3.0 * 0.2)):
        assert residual(value, mult, 2.0, 3.0) == pytest.approx(0, abs=1e-15)
    for value, mult in ((1.0, 2.2), (1.5, 2.0), (1.5, 0.0), (0.5, 1.0), (-1.2, 2.6)):
        assert residual(value, mult, 2.0, 3.0) > 0.04


@pytest.mark.parametrize("shape", [s for s in SMALL if INFEASIBLE in kinds_of(s)], ids=str)
def test_infeasible_problems_have_a_proof(shape: Shape) -> None:
    """The weights combine rows and bounds to 0 <= (a negative number); HiGHS finds no feasible point either."""
    for seed in range(10):
        qp = random_qp(shape, INFEASIBLE, seed)
        assert certificate(qp) == "infeasible"
        assert qp.proof is not None
        weights = np.concatenate([qp.proof[0].ravel(), qp.proof[1]])
        A, value = condensed_rows(qp)
        rows = np.vstack([np.eye(A.shape[1]), A])
        lower = np.concatenate([(qp.lower_u - qp.u).ravel(), qp.lower - value])
        upper = np.concatenate([(qp.upper_u - qp.u).ravel(), qp.upper - value])
        bound = np.where(weights > 0, upper, lower)[weights != 0]
        np.testing.assert_allclose(weights @ rows, 0, atol=1e-12 * np.max(np.abs(rows)))
        assert weights[weights != 0] @ bound < 0


def test_feasible_problems_are_certified() -> None:
    for shape in SMALL:
        if shape.free == 0:
            assert certificate(random_qp(shape, "plain", 1)) == "feasible"


def test_condition_of_a_known_problem() -> None:
    """Nearly parallel active rows are detected; a well-posed problem is not near the limit for excused errors."""
    shape = Shape(2, 2, 4, path=2)
    qp = random_qp(shape, "plain", 0, active=0.0)
    assert condition(qp) < 1e4
    near = random_qp(shape, "redundant", 0, active=0.9)
    rows = near.rows
    C = near.C.copy()
    first = [int(np.flatnonzero((rows.node == k) & (rows.index == 0))[0]) for k in range(4)]
    second = [int(np.flatnonzero((rows.node == k) & (rows.index == 1))[0]) for k in range(4)]
    C[second] = C[first] + 1e-7 * C[second] + np.array([0, 0, 0, 1e-7])
    optimum = near.optimum
    assert optimum is not None
    active = dataclasses.replace(optimum, mult=np.ones(len(rows)), mult_u=0 * optimum.mult_u)
    assert condition(dataclasses.replace(near, C=C, optimum=active)) > 1e6


# The solvers ----------------------------------------------------------------------------------------------------------

SOLVERS = solvers()


def chosen(shape: Shape) -> dict[str, Options]:
    """Solvers of a shape: all for SMALL, else one in turn."""
    able = [name for name, options in SOLVERS.items() if holds(options, shape)]
    name = able[SHAPES.index(shape) % len(able)]
    return SOLVERS if shape in SMALL else {name: SOLVERS[name]}


@st.composite
def recipes(draw: st.DrawFn, shape: Shape) -> dict[str, Any]:
    """Arguments of random_qp(); shrinks to a plain problem with few active rows and short numbers."""
    return {
        "kind": draw(st.sampled_from(kinds_of(shape))),
        "seed": draw(st.integers(0, 2**16)),
        "radius": draw(st.sampled_from([0.9, 1.05])),
        "active": draw(st.integers(0, 10)) / 10,
        "digits": draw(st.sampled_from([1, 2, 4, None])),
    }


def recipe(
    kind: str, seed: int, radius: float = 1.05, active: float = 0.5, digits: int | None = None
) -> dict[str, Any]:
    """Arguments of random_qp()."""
    return {"kind": kind, "seed": seed, "radius": radius, "active": active, "digits": digits}


#: Pairs of QPs that are solved in any case. Weights of rows in the first crane are a 10^14th of those in the second;
#: of contradictory rows the first attempt of the dense solver takes one as satisfied up to rounding.
HARD: dict[str, tuple[tuple[dict[str, Any], dict[str, Any]], ...]] = {
    "4x1x10,end=4": ((recipe("plain", 12), recipe("scaled", 213, 0.9, 0.7, 1)),),
    "3x2x5,states=3,pure=1,free=2": ((recipe("all_active", 10438, 0.9, 0.0, 2), recipe("plain", 0)),),
    "4x2x6,states=2,path=2,pure=1,end=2,soft=(1, 3)": (
        (recipe(INFEASIBLE, 22, 1.05, 0.3, 1), recipe(INFEASIBLE, 22)),
        (recipe(INFEASIBLE, 11, 0.9, 0.3), recipe(INFEASIBLE, 4)),
        (recipe(INFEASIBLE, 27, 1.05, 0.3, 1), recipe(INFEASIBLE, 22, 1.05, 0.0)),
    ),
}


@pytest.mark.few(16)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_every_solver_finds_the_constructed_optimum(shape: Shape) -> None:
    """Cold, again from its own working set, and from that of another QP; infeasible QPs are recognised."""
    some = chosen(shape)
    build_all((shape, options) for options in some.values())

    @settings(max_examples=25 if shape in SMALL else 15, deadline=None, database=None)
    @given(first=recipes(shape), second=recipes(shape))
    def check(first: dict[str, Any], second: dict[str, Any]) -> None:
        one, other = random_qp(shape, **first), random_qp(shape, **second)
        for name, options in some.items():
            solver = StageSolver(shape, options)
            for attempt, qp in (("cold", one), ("again", one), ("after another", other)):
                note(f"{name}, {attempt}")
                assert solver.verdict(qp, solver.solve(qp)) == ""

    for one, other in HARD.get(str(shape), ()):
        check = example(first=one, second=other)(check)
    check()
