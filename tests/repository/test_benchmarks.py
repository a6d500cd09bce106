"""The harness of the benchmarks on the crane, with few steps: it measures and writes the stated quantities."""

from __future__ import annotations

import importlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import problems
import pytest
from conftest import require_tool

from benchmarks import tracking
from benchmarks.lib import scenarios
from benchmarks.lib.closed_loop import Scenario, closed_loop, compile_driver, run_driver
from benchmarks.lib.hessian import bioreactor
from benchmarks.lib.peers import SqpMethod, available, time_sqpmethod
from benchmarks.lib.report import Report
from benchmarks.lib.scenarios import Case, cases
from examples import crane
from nmpc_codegen import ExactHessian, Options

X0 = (2.0, 0.0, 0.0, 0.0)
SCENARIO = Scenario(X0, 0.3, 4, amplitude=0.01)


def crane_case() -> Case:
    return Case("crane", "plain", crane.build_ocp, Options(), np.array(X0))


def test_closed_loop_in_c() -> None:
    require_tool("cc")
    t = closed_loop(problems.sources("crane"), "crane", SCENARIO, runs=2, steps=8)
    assert t.samples == 16
    assert t.failed == 0
    assert 0 < t.feedback < t.total <= t.total_median
    assert t.feedback < t.worst
    assert 0 < t.qp_iterations <= t.qp_iterations_max


def test_scenario_reaches_the_c_program(tmp_path: Path) -> None:
    """At rest at the origin no QP iteration is needed; a push or a far set point causes some at its time."""
    require_tool("cc")
    program = compile_driver(problems.sources("crane_weight"), "crane", tmp_path)
    origin, far, near = (0.0, 0.0, 0.0, 0.0), ((5.0, 0, 0, 0, 0), (5.0, 0, 0, 0)), ((0.0,) * 5, (0.0,) * 4)

    def iterations(period: int, **events: Any) -> int:
        return run_driver(program, Scenario(origin, 0.3, period, **events), runs=1, steps=3).qp_iterations_max

    assert iterations(9) == 0
    assert iterations(9, push=(1.0,), pushes=5) > 0
    assert iterations(9, set_points=(near, far)) == 0
    assert iterations(2, set_points=(near, far)) > 0


@pytest.mark.parametrize("plugin", ["qpoases", "daqp", "hpipm"])
def test_peer_takes_the_same_steps(plugin: str) -> None:
    """One full Gauss-Newton step per sample from the same start gives the controls of the generated code."""
    if not available(plugin):
        pytest.skip(f"this CasADi has no {plugin}")
    problem, c = problems.problem("crane_weight"), problems.controller("crane_weight")
    peer = time_sqpmethod(problem, c.integrate, Scenario(X0, 0.3, 1000), qpsol=plugin, seconds=0.005, runs=1)
    assert peer.total > 0
    assert peer.steps == len(peer.u) >= 1
    other, x = SqpMethod(problem, qpsol=plugin), np.array(X0)
    c.x[:] = x
    for _ in range(4):
        u = c.step(x)
        np.testing.assert_allclose(other.step(x), u, rtol=0, atol=1e-6)
        x = c.integrate(x, u, 0.3)


def test_peer_refuses_what_it_cannot_solve() -> None:
    with pytest.raises(ValueError, match="neither general rows nor parameters"):
        SqpMethod(problems.problem("path_rows"))


def test_comparison_of_a_case() -> None:
    report = Report("test")
    tracking.report_case(report, crane_case(), tracking.compare(crane_case()))
    found = {r.key: r.value for r in report.records}
    assert found["crane_u_error"] <= 1e-6
    assert found["crane_cost_error"] <= 1e-8
    assert found["crane_lam_error"] <= 1e-5
    assert found["crane_not_ok"] == 0
    assert found["crane_active_rows"] == 6 + 4


def test_comparison_sees_an_error() -> None:
    """A solution that is not optimal fails, and a multiplier that is not unique is not compared."""
    report, case = Report("test"), crane_case()
    tracking.report_case(report, case, tracking.compare(case, tol=0.5))
    assert {r.key: r.value for r in report.records}["crane_u_error"] > 1e-6
    gradients = np.array([[1.0, 0.0], [1.0, 1.0]])
    assert tracking.is_regular(gradients, np.array([0.3, np.inf]))
    assert not tracking.is_regular(gradients, np.array([0.3, 0.0]))
    assert not tracking.is_regular(np.array([[1.0, 2.0], [0.5, 1.0]]), np.array([0.3, 0.2]))
    assert not tracking.is_regular(np.ones((3, 2)), np.ones(3))


def test_every_example_has_its_variants() -> None:
    wanted = (
        "plain",
        "general rows active",
        "non-uniform grid",
        "references, weights at run time",
        "parameter per node",
    )
    for example in scenarios.EXAMPLES[:3]:
        found = [case.variant for case in cases(example)]
        assert set(wanted) <= set(found), example.name
    assert "state bounds active" in [case.variant for case in cases(scenarios.CSTR)]


def test_report_writes_the_worst_of_every_key(tmp_path: Path) -> None:
    report = Report("test")
    report.add("a_us", 1.0, "us", case="one", limit=2.0, n=10)
    report.add("a_us", 3.0, "us", case="two", limit=2.0, n=20)
    report.add("rows", 4, limit=1, at_least=True)
    report.add("rows", 2, limit=1, at_least=True)
    report.add("broken", 0.0)
    report.add("broken", math.nan)
    report.write(tmp_path / "new" / "f.json")
    found = json.loads((tmp_path / "new" / "f.json").read_text())
    assert found["a_us"] == {"value": 3.0, "unit": "us", "profile": "fast", "lanes": 1, "n": 20}
    assert found["rows"]["value"] == 2
    assert math.isnan(found["broken"]["value"])


BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.parametrize("topic", sorted(path.stem for path in BENCHMARKS.glob("[a-z]*.py")))
def test_every_topic_can_be_imported(topic: str) -> None:
    """A renamed module of the package is found here, not by the next person who measures."""
    assert callable(importlib.import_module(f"benchmarks.{topic}").main)


@pytest.mark.parametrize("hessian", [bioreactor.MIRROR, bioreactor.PROJECT])
def test_phases_of_a_sample_are_timed(hessian: ExactHessian) -> None:
    require_tool("cc")
    times = bioreactor.phases(bioreactor.condensed(hessian, unroll="none"), runs=1, steps=3)
    assert len(times) == len(bioreactor.PHASES)
    assert min(times) >= 0
    assert max(times[:-1]) <= times[-1]
