"""Tuning.hessian(): the component of the generated code receives M, M_f and the steady state."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from examples import driving, evaporation

HOME = "nmpc_codegen.components.hessians.economic_gauss_newton"


@pytest.mark.parametrize("example", [driving, evaporation], ids=["driving", "evaporation"])
def test_component_receives_the_tuning(example: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType(HOME)
    module.EconomicGaussNewton = SimpleNamespace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, HOME, module)
    tuning = example.tuned()
    found: Any = tuning.hessian()
    np.testing.assert_array_equal(found.M, tuning.M)
    assert (found.M_f is None) == (example is evaporation)
    x_s, u_s = found.steady_state
    np.testing.assert_array_equal(x_s, tuning.x_s)
    np.testing.assert_array_equal(u_s, tuning.u_s)
    assert found.M.shape == (len(x_s) + len(u_s),) * 2
