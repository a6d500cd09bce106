"""shift="resample": the stated number of integration steps, and a worst case that contains it."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmpc_codegen import OCP, RK4, ExplicitRungeKutta, Options, RealTimeIteration, generate, worst_case
from verification.c_harness import module_of

INTERVALS = st.sampled_from([0.01, 0.1, 0.3, 1 / 3, 0.7])


def _ocp(dt: list[float]) -> OCP:
    ocp = OCP("resampled", intervals=dt)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u - x})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 0.1])
    ocp.subject_to(-1, u, 1)
    return ocp


def _steps(dt: list[float], sampling_time: float, step: float, real: type) -> int:
    """What the C code counts for the plan, in its precision."""
    node_time = [real(math.fsum(dt[:k])) for k in range(len(dt) + 1)]
    tolerance = real(1e-3 if real is np.float32 else 1e-9)
    most = n = 0
    for time in node_time:
        t = real(time + real(sampling_time))
        while n + 1 < len(dt) and node_time[n + 1] <= t:
            n += 1
        most = max(most, math.ceil(real(t - node_time[n]) / real(step) - tolerance))
    return most


@settings(max_examples=15, deadline=None)
@given(dt=st.lists(INTERVALS, min_size=1, max_size=6), sampling_time=st.floats(1e-3, 3.0), steps=st.integers(1, 3))
def test_no_new_node_needs_more_steps_than_stated(dt: list[float], sampling_time: float, steps: int) -> None:
    algorithm = RealTimeIteration(shift="resample", sampling_time=sampling_time)
    module = module_of(_ocp(dt), Options(integrator=ExplicitRungeKutta(RK4, steps), algorithm=algorithm))
    needed = max(_steps(dt, sampling_time, max(dt) / steps, real) for real in (np.float32, np.float64))
    assert needed <= module.sizes["PLAN_STEPS"] <= needed + 1 + steps


@pytest.mark.parametrize("sampling_time", [0.1, 0.25])
def test_the_worst_case_counts_the_steps_of_the_shift(sampling_time: float) -> None:
    def worst(**more: object) -> dict[str, int]:
        options = Options(algorithm=RealTimeIteration(**more))  # type: ignore[arg-type]
        return worst_case(generate(_ocp([0.1] * 5), options))

    resampled, kept = worst(shift="resample", sampling_time=sampling_time), worst()
    assert resampled["feedback"] == kept["feedback"]
    assert resampled["prepare"] > kept["prepare"]
    assert resampled["prepare"] > worst(shift="resample", sampling_time=sampling_time / 10)["prepare"]
