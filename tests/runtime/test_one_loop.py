"""One statement of a closed loop: simulate() in compiled code and in Python, and a flight of a batch."""

from __future__ import annotations

import importlib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import OCP, Controller, ControllerError, Normal, Options, ProblemWarning, Uniform, build
from nmpc_codegen.runtime.batch.many import Batch
from nmpc_codegen.runtime.build import PROFILES
from nmpc_codegen.runtime.loops.simulate import simulate
from nmpc_codegen.runtime.records.log import Log

STEPS = 12
VERIFY = replace(PROFILES["verify"], wrapper=False)
EXAMPLES = sorted(
    path.stem
    for path in (Path(__file__).parents[2] / "examples").glob("*.py")
    if "def build_ocp(" in path.read_text(encoding="utf-8")
)


def in_python(k: int, ctrl: Controller) -> None:
    """What makes simulate() take its samples in Python."""


def assert_same_bits(one: Log, other: Log) -> None:
    """In everything but times."""
    for name in ("t", "x", "u", "z", "h", "p", "y", "status", "cost", "lower", "upper", "residual"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert one.reasons == other.reasons
    assert one.plans is not None
    assert other.plans is not None
    for name in ("x", "u", "distance", "multiplier", "active"):
        assert getattr(one.plans, name).tobytes() == getattr(other.plans, name).tobytes(), name


@pytest.mark.few(6)
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "heat_rod")) for n in EXAMPLES])
def test_the_same_bits_in_compiled_code_in_python_and_in_a_batch(name: str) -> None:
    """Every example, with noise, random and given disturbances, and tables of a parameter and of a reference."""
    module = importlib.import_module(f"examples.{name}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        ctrl = build(module.build_ocp(), getattr(module, "options", Options)(), VERIFY)  # type: ignore[call-overload]
    described, scales = ctrl.description, np.array(ctrl.description.scales[: ctrl.dims.nx])
    stated: dict[str, Any] = {"noise": Normal(1e-3 * scales), "disturbance": Uniform(1e-4 * scales), "seed": 7}
    stated["added"] = 1e-4 * scales * np.sin(np.arange(STEPS))[:, None]
    factors = np.linspace(1.0, 1.001, STEPS)
    if described.online["parameter"] != "fixed":
        stated["parameters"] = {
            signal.name: np.clip(np.outer(factors, signal.value), signal.low or -np.inf, signal.high or np.inf)
            for signal in described.parameters[:1]
        }
    if described.online["reference"] != "fixed" and described.residuals:
        residual = described.residuals[0]
        stated["references"] = {residual.name: factors * residual.reference}
    x0 = np.array(described.x_initial)
    twins = [ctrl.copy() for _ in range(3)]
    compiled = simulate(twins[0], x0, STEPS, plans=1, **stated)
    assert_same_bits(compiled, simulate(twins[1], x0, STEPS, before=in_python, plans=1, **stated))
    many = Batch(twins[2], 1)
    flight = many.simulate(x0[None], STEPS, record=True, **stated)
    assert flight.x is not None
    assert flight.u is not None
    assert flight.status is not None
    for array, own in ((compiled.x, flight.x[0]), (compiled.u, flight.u[0]), (compiled.status, flight.status[0])):
        np.testing.assert_array_equal(array, own)
    assert bytes(twins[0]) == bytes(twins[1])
    assert twins[0].time_ns > 0


def tank() -> OCP:
    """A tank whose inflow and level are bounded."""
    ocp = OCP("tank", T=5.0, N=5)
    h, q, loss = ocp.state("h"), ocp.control("q"), ocp.parameter("loss", value=0.1)
    ocp.dynamics({h: q - loss * h})
    ocp.least_squares(h, weight=1, reference=0.5)
    ocp.subject_to(0, q, 0.2, name="inflow")
    ocp.subject_to(0, h, 0.6, name="level", soft=10.0)
    return ocp


@pytest.fixture(scope="module")
def controller() -> Controller:
    return build(tank(), profile="test")


def test_bounds_over_the_samples(controller: Controller) -> None:
    """The same in simulate(), by hand, and in a batch, whose flights are judged by the bounds of each sample."""
    most = np.array([0.2] * 4 + [0.05] * 4 + [0.01])
    log = simulate(controller.copy(), [0.3], 9, bounds={"inflow": (0.0, most)})

    def tell(k: int, ctrl: Controller) -> None:
        ctrl.set_bounds("inflow", 0.0, most[min(k, 8)])

    by_hand = simulate(controller.copy(), [0.3], 9, before=tell)
    np.testing.assert_array_equal(log.u, by_hand.u)
    assert (log.u[:, 0] <= most + 1e-9).all()
    assert log.u[0, 0] > 0.05
    per_flight = np.array([most, np.full(9, 0.2)])
    flights = Batch(controller, 1).simulate(
        np.full((2, 1), 0.3), 9, bounds={"inflow": (0.0, per_flight), "level": (0.0, [0.6, 0.35])}, record=True
    )
    assert flights.x is not None
    assert flights.u is not None
    violation = flights.violation[:, flights.rows.index("level")]
    np.testing.assert_allclose(violation, np.maximum(flights.x[:, 1:, 0] - 0.35, 0.0).max(axis=1), rtol=1e-12)
    assert violation.min() > 0.0
    assert (flights.violation[:, flights.rows.index("inflow")] <= flights.rounding[flights.rows.index("inflow")]).all()


def test_a_plant_that_is_a_controller(controller: Controller) -> None:
    """Its parameters are its own; it is copied; compiled code and Python have the same bits."""
    plant = controller.copy()
    plant.set_parameter("loss", 0.3)
    before = bytes(plant)
    log = simulate(controller.copy(), [0.3], 6, plant=plant)
    same = simulate(controller.copy(), [0.3], 6, plant_parameters={"loss": 0.3})
    slow = simulate(controller.copy(), [0.3], 6, plant=plant, before=in_python)
    np.testing.assert_array_equal(log.x, same.x)
    np.testing.assert_array_equal(log.x, slow.x)
    assert bytes(plant) == before
    assert log.p.max() == 0.1
    assert log.x[1, 0] < simulate(controller.copy(), [0.3], 1).x[1, 0]


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"plant": lambda x, u, dt: x, "plant_parameters": {"loss": 1.0}}, "plant_parameters belong to a plant"),
        ({"plant": "car"}, "plant is 'car'; expected a function"),
        ({"noise": Normal(-1.0)}, "noise is .* expected sizes >= 0"),
        ({"noise": [0.1, 0.2], "seed": None}, "seed is None"),
        ({"noise": Normal(1.0), "seed": None}, "seed is None; expected an integer"),
        ({"added": np.zeros((2, 1))}, r"added has shape \(2, 1\)"),
        ({"bounds": {"inflow": (1.0, [0.0, 2.0])}}, "lower .* above upper"),
        ({"bounds": {"inflow": (0.0, 1.0), "inflow[0]": (0.0, 1.0)}}, "no row 'inflow\\[0\\]'"),
        ({"law": "guess"}, "law is .guess."),
        ({"law": ["step"]}, "law is"),
    ],
)
def test_what_is_refused(controller: Controller, stated: dict[str, Any], message: str) -> None:
    twin = controller.copy()
    with pytest.raises(ControllerError, match=message):
        simulate(twin, [0.3], 3, **stated)
    assert bytes(twin) == bytes(controller)


def test_a_state_that_is_not_finite_ends_a_compiled_loop(controller: Controller) -> None:
    with pytest.raises(ControllerError, match=r"after sample 1 is not finite: .*it moved from h = "):
        simulate(controller.copy(), [0.3], 6, plant_parameters={"loss": [0.1, 1e200]})


def test_tables_of_flights_and_logs(controller: Controller, tmp_path: Path) -> None:
    """pandas and Parquet have the same columns; a row is a flight, or a sample."""
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    flights = Batch(controller, 1).simulate(np.linspace(0.1, 0.5, 5)[:, None], 6, first=10)
    frame = flights.to_dataframe()
    assert frame.index.tolist() == [10, 11, 12, 13, 14]
    np.testing.assert_array_equal(frame["start"]["h"], np.linspace(0.1, 0.5, 5))
    np.testing.assert_array_equal(frame["last"]["h"], flights.last[:, 0])
    np.testing.assert_array_equal(frame["samples"]["OK"], flights.status_counts[:, 0])
    np.testing.assert_array_equal(frame["violation"]["level"], flights.violation[:, flights.rows.index("level")])
    flights.to_parquet(tmp_path / "flights.parquet")
    flat = pandas.read_parquet(tmp_path / "flights.parquet")
    assert list(flat) == ["number", *(f"{a}.{b}" if b else a for a, b in frame.columns)]
    np.testing.assert_array_equal(flat["cost"], flights.cost)
    log = simulate(controller, [0.3], 6)
    log.to_parquet(tmp_path / "log.parquet")
    flat = pandas.read_parquet(tmp_path / "log.parquet")
    np.testing.assert_array_equal(flat["x.h"], log.x[:, 0])
    np.testing.assert_array_equal(flat["u.q"][:-1], log.u[:, 0])
    assert flat["u.q"].isna().tolist() == [False] * 6 + [True]
    assert flat["status"].dropna().tolist() == ["OK"] * 6
