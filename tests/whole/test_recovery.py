"""One bad datum does not outlive itself, and a feedback uses the data of one moment."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import OCP, AugmentedLagrangian, Controller, NoCondensing, Options, Status, build
from verification.routes import PURE


def oscillator(name: str = "spring", **initial: float) -> OCP:
    """x'' = -x + 0.3 x^3 + u. Far from the origin one integration step overflows."""
    ocp = OCP(name, T=2.0, N=10)
    x, v, u = ocp.state("x"), ocp.state("v", **initial), ocp.control("u")
    ocp.dynamics({x: v, v: -x + 0.3 * x**3 + u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=[10, 1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x, v), weight=[10, 10])
    return ocp


@pytest.fixture(scope="module")
def controller() -> Controller:
    return build(oscillator(), Options(algorithm=PURE), "test")


def recovered(controller: Controller, xhat: list[float], samples: int) -> np.ndarray:
    """The control after so many good samples; the last one is OK."""
    for _ in range(samples):
        u = controller.step(xhat)
    assert controller.status is Status.OK
    return u


@pytest.mark.parametrize("spike", [30.0, -1e4, 1e300, np.nan, np.inf])
def test_a_spike_in_the_measurement_costs_few_samples(controller: Controller, spike: float) -> None:
    peaceful, struck = controller.copy(), controller.copy()
    for ctrl in (peaceful, struck):
        recovered(ctrl, [0.4, 0.0], 20)
    struck.step([spike, 0.0])
    recovered(struck, [0.4, 0.0], 4)
    np.testing.assert_allclose(recovered(struck, [0.4, 0.0], 16), recovered(peaceful, [0.4, 0.0], 1), rtol=1e-8)


def reactor() -> OCP:
    ocp = OCP("reactor", T=1.0, N=5)
    x, u, w = ocp.state("x"), ocp.control("u"), ocp.parameter("w", value=1.0)
    ocp.dynamics({x: -x + u * w})
    ocp.least_squares(ca.vertcat(x, u), weight=[1, 1])
    ocp.subject_to(-3, u, 3)
    return ocp


Change = Callable[[Controller], None]
CHANGES: dict[str, Change] = {
    "weight": lambda c: c.set_weight([9, 2]),
    "parameter": lambda c: c.set_parameter("w", 3.0),
    "same reference": lambda c: c.set_reference([0, 0]),
    "reference": lambda c: c.set_reference([1, 0]),
}


@pytest.fixture(scope="module")
def linear() -> Controller:
    return build(reactor(), Options(algorithm=PURE), "test")


def between(controller: Controller, *changes: str) -> tuple[np.ndarray, np.ndarray]:
    """Controls of the feedback with these changes after its prepare, and of the next sample."""
    ctrl = controller.copy()
    ctrl.prepare()
    for change in changes:
        CHANGES[change](ctrl)
    return ctrl.feedback([0.7], "raise"), ctrl.step([0.7], "raise")


@pytest.mark.parametrize(
    ("changes", "like"),
    [
        (("weight",), ()),
        (("parameter",), ()),
        (("weight", "same reference"), ()),
        (("parameter", "same reference"), ()),
        (("weight", "reference"), ()),
        (("reference", "weight"), ("reference",)),
        (("reference", "parameter"), ("reference",)),
        (("reference", "weight", "same reference"), ("reference",)),
    ],
)
def test_a_feedback_uses_weights_and_parameters_of_its_prepare(
    linear: Controller, changes: tuple[str, ...], like: tuple[str, ...]
) -> None:
    np.testing.assert_array_equal(between(linear, *changes)[0], between(linear, *like)[0])


def test_the_next_sample_uses_all_changes(linear: Controller) -> None:
    after = between(linear, "weight", "reference")[1]
    fresh = linear.copy()
    for change in ("weight", "reference"):
        CHANGES[change](fresh)
    fresh.step([0.7])
    np.testing.assert_allclose(after, fresh.step([0.7]), rtol=1e-9)
    assert not np.allclose(after, between(linear, "reference")[1])


@pytest.mark.few(4)
@pytest.mark.parametrize(
    "options", [Options(), Options(condensing=NoCondensing()), Options(algorithm=AugmentedLagrangian())]
)
@pytest.mark.parametrize(("member", "value"), [("x", np.inf), ("x", np.nan), ("u", -np.inf), ("u", np.nan)])
def test_a_plan_that_is_spoilt_after_prepare_is_not_called_ok(options: Options, member: str, value: float) -> None:
    """The plan is finite after every OK, and the next good sample is OK."""
    ctrl = build(oscillator(), options, "test")
    recovered(ctrl, [0.4, 0.0], 5)
    ctrl.prepare()
    getattr(ctrl, member)[3, 0] = value
    u0 = ctrl.feedback([0.4, 0.0])
    assert np.all(np.isfinite(u0))
    assert ctrl.status == Status.NUMERICAL_FAILURE or (np.all(np.isfinite(ctrl.x)) and np.all(np.isfinite(ctrl.u)))
    recovered(ctrl, [0.4, 0.0], 4)


@pytest.mark.parametrize("options", [Options(), Options(algorithm=AugmentedLagrangian())])
def test_bounds_that_change_after_prepare_hold_in_the_whole_plan(options: Options) -> None:
    ocp = OCP("bounded", T=1.0, N=5)
    x, u = ocp.state("x", initial=0.5), ocp.control("u")
    ocp.dynamics({x: ca.sin(x) + u})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    ocp.subject_to(-1, u, 1)
    ctrl = build(ocp, options, "test")
    for lower, upper in ((-0.9, -0.9), (-0.2, 0.1), (-1.0, 1.0)):
        for _ in range(5):
            ctrl.step([0.5])
        ctrl.prepare()
        ctrl.set_bounds("u", lower, upper)
        u0 = ctrl.feedback([0.5])
        assert ctrl.status == Status.OK
        assert np.all((ctrl.u >= lower) & (ctrl.u <= upper))
        assert lower <= u0[0] <= upper
