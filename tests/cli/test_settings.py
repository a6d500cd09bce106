"""--set KEY=VALUE: options by their dotted names."""

from __future__ import annotations

import pytest

from nmpc_codegen import OptionError, Options
from nmpc_codegen.cli import settings
from nmpc_codegen.cli.settings import apply_settings
from nmpc_codegen.components.hessians import Mirror
from nmpc_codegen.components.integrators import RK4, SDIRK2, ExplicitRungeKutta, Heun, ImplicitRungeKutta


def test_settings() -> None:
    options = apply_settings(Options(), [("integrator.steps", "4")])
    options = apply_settings(options, [("integrator.tableau", "Heun")])
    options = apply_settings(options, [("algorithm.tolerance", "1e-3")])
    options = apply_settings(options, [("qp", "dense-active-set")])
    options = apply_settings(options, [("qp.max_iterations", "50")])
    options = apply_settings(options, [("precision", "single")])
    assert options.integrator == ExplicitRungeKutta(Heun, steps=4)
    assert options.algorithm.tolerance == 1e-3
    assert (options.qp.name, options.qp.max_iterations) == ("dense_active_set", 50)
    assert options.precision == "single"
    assert apply_settings(options, [("qp", "None")]).qp is None
    shift = [("algorithm.shift", "resample"), ("algorithm.sampling_time", "0.1")]
    assert apply_settings(Options(), shift) == apply_settings(Options(), shift[::-1])
    mirror = apply_settings(
        Options(),
        [("hessian", "exact"), ("hessian.regularization", "mirror"), ("hessian.regularization.level", "stage")],
    )
    assert mirror.hessian.regularization == Mirror(level="stage")
    assert Options().integrator is None
    assert ExplicitRungeKutta().tableau is RK4


@pytest.mark.parametrize(
    ("key", "text", "message"),
    [
        ("speed", "1", "no option 'speed'; there is integrator, hessian"),
        ("integrator", "leapfrog", "there is explicit_runge_kutta, implicit_runge_kutta, discrete"),
        ("integrator.steps.more", "1", "integrator.steps has no option 'more'; it has none"),
        ("hessian.scale", "1", "hessian has no option 'scale'; it has none"),
        ("online.speed", "1", "online has no option 'speed'; there is reference"),
        ("precision", "half", "half"),
        ("integrator.tableau", "RK77", "RK77"),
    ],
)
def test_settings_that_are_refused(key: str, text: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        apply_settings(Options(), [(key, text)])


def test_a_field_that_several_components_have(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one that takes the values, else explicit Runge-Kutta; of other seams none is meant."""
    found = apply_settings(Options(), [("integrator.steps", "3"), ("integrator.tableau", "SDIRK2")])
    assert found.integrator == ImplicitRungeKutta(SDIRK2, steps=3)
    assert apply_settings(Options(), [("integrator.newton", "4")]).integrator == ImplicitRungeKutta(newton=4)
    assert apply_settings(Options(), [("integrator.steps", "3")]).integrator == ExplicitRungeKutta(steps=3)
    registry = {"first": ExplicitRungeKutta, "second": ExplicitRungeKutta}
    monkeypatch.setattr(settings, "registry", lambda seam: registry)
    with pytest.raises(OptionError, match="also give --set integrator=WORD, with one of first, second"):
        apply_settings(Options(), [("integrator.steps", "3")])
