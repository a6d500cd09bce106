"""The linearisation of complete packages, node by node, against the NumPy twins; rows against the complex step."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, ExplicitRungeKutta, GaussNewton, OptionError, Options
from nmpc_codegen.compiler import model_of
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.package.opcount import OpCount
from verification.c_harness import Package, Routines, module_of
from verification.models import GRID, LENGTH, problem_of
from verification.oracles.runge_kutta import MODELS, POINTS, Array, complex_step, integrate

TOLERANCE = 1e-12


@functools.cache
def package(model: str, unroll: str, uniform: bool) -> Package:
    options = Options(ExplicitRungeKutta(steps=2, unroll=unroll))  # type: ignore[arg-type]
    return Package(module_of(problem_of(model, uniform), options), ["linearize"])


UNROLL = ("all", "none")
#: Every model in every code style, both grids in turn.
SPELLED = [(m, unroll, (i + j) % 2 == 0) for i, m in enumerate(MODELS) for j, unroll in enumerate(UNROLL)]


@pytest.mark.parametrize(("model", "unroll", "uniform"), SPELLED)
def test_every_node(model: str, unroll: str, uniform: bool) -> None:
    """Different states, controls and parameters at every node; interval lengths from the grid."""
    p, random = package(model, unroll, uniform), np.random.default_rng(5)
    x, u, q = POINTS[model]
    p["x"][...] = x * random.uniform(0.8, 1.2, p["x"].shape)
    p["u"][...] = u * random.uniform(0.8, 1.2, p["u"].shape)
    if len(q):
        p["p"][...] = q * random.uniform(0.8, 1.2, p["p"].shape)
    p["yref"][...] = random.uniform(-1, 1, p["yref"].shape)
    p["W"][...] = random.uniform(1, 2, p["W"].shape)
    p.call("linearize")
    for k, dt in enumerate([LENGTH] * 3 if uniform else GRID):
        x_next, S = integrate(MODELS[model], "RK4", 2, dt, p["x"][k], p["u"][k], p["p"][k] if len(q) else q)
        node = p["node"][k]
        np.testing.assert_allclose(node["S"], S, rtol=0, atol=TOLERANCE * np.max(np.abs(S)))
        np.testing.assert_allclose(node["b"], x_next - p["x"][k + 1], rtol=0, atol=TOLERANCE * np.max(np.abs(x_next)))
        z = np.concatenate([p["x"][k], p["u"][k]])
        np.testing.assert_allclose(node["g"], p["W"][0] * (z - p["yref"][k]), rtol=1e-14, atol=1e-15)


def rows_problem() -> OCP:
    """Two path rows (one without a control, so at node N too) and one terminal row."""
    ocp = OCP("rows", T=1.0, N=2)
    x, u, p = ocp.state("x", size=2), ocp.control("u"), ocp.parameter("p", value=1.5)
    ocp.dynamics(ca.vertcat(x[1], u))
    ocp.least_squares(ca.vertcat(x, u), weight=np.ones(3))
    ocp.subject_to(-1, ca.sin(x[0]) * u + p * x[1], 1, name="mixed")
    ocp.subject_to(-1, ca.exp(x[0]) / (p + x[1] ** 2), 1, name="state")
    ocp.subject_to(-1, x[0] ** 3 * x[1], 1, at="end", name="gate")
    return ocp


def test_general_rows() -> None:
    problem = classify(rows_problem())
    routines = {r.name: r for r in model_of(problem, Options()).routines if r.name.endswith("_rows")}
    call = Routines(routines)
    z, p = np.array([0.4, -0.7, 0.9]), np.array([1.5])

    def mixed(z: Array) -> Array:
        return np.sin(z[0]) * z[2] + p[0] * z[1]

    def state(z: Array) -> Array:
        return np.exp(z[0]) / (p[0] + z[1] ** 2)

    def gate(z: Array) -> Array:
        return z[0] ** 3 * z[1]

    values = {"mixed": mixed, "state": state, "gate": gate}
    assert (problem.path.h_names, set(problem.terminal.h_names)) == (("mixed", "state"), {"state", "gate_end"})
    for name, stage, n in (("path_rows", problem.path, 3), ("terminal_rows", problem.terminal, 2)):
        arguments = (z[:2], z[2:], p) if n == 3 else (z[:2], p)
        h, J = call(name, *arguments)

        def stacked(z: Array, names: tuple[str, ...] = stage.h_names) -> Array:
            return np.array([values[name.removesuffix("_end")](z) for name in names])

        np.testing.assert_allclose(h, stacked(z), rtol=1e-14)
        np.testing.assert_allclose(J, complex_step(stacked, z)[:, :n], rtol=1e-13, atol=1e-15)


def test_no_rows() -> None:
    """Rows that are zero are also routines, without instructions and stores."""
    lin = model_of(classify(problem_of("crane")), Options())
    for name in ("path_rows", "terminal_rows"):
        routine = next(r for r in lin.routines if r.name == name)
        assert routine.count == OpCount()
        assert [p.size for p in routine.outputs] == [0, 0]


def test_a_feature_that_no_component_takes_is_refused() -> None:
    ocp = rows_problem()
    ocp.stage_cost(ocp.x[0] * ocp.u)
    with pytest.raises(OptionError, match="general cost"):
        model_of(classify(ocp), Options(hessian=GaussNewton()))
