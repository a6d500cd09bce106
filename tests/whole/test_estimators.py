"""Estimators: against the Kalman filter, IPOPT on the same window, and where data are missing, late or wrong."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from nmpc_codegen import (
    OCP,
    ControllerError,
    DenseActiveSet,
    FullCondensing,
    ImplicitRungeKutta,
    Log,
    MovingHorizon,
    NoCondensing,
    Observer,
    OptionError,
    Options,
    ProblemError,
    RadauIIA2,
    RealTimeIteration,
    RiccatiActiveSet,
    Status,
    build,
    export,
    open_estimator,
    open_package,
    simulate,
)
from nmpc_codegen.frontend.estimator.window import estimation_problem
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import node_data
from verification.estimation import PLANTS, Linear, Plant, believing, estimate, run, window_data

SAMPLES = 60
ROUTES = {
    "chosen": Options(),
    "dense": Options(condensing=FullCondensing(), qp=DenseActiveSet()),
    "stages": Options(condensing=NoCondensing(), qp=RiccatiActiveSet()),
    "native": Options(target="native"),
}


def cart(discrete: bool = True) -> tuple[OCP, dict[str, Any]]:
    """A cart on an unknown slope d, of which the position and a sum are measured."""
    ocp = OCP("cart", N=20) if discrete else OCP("cart", T=2.0, N=20)
    p, v, F = ocp.state("p", initial=0.3), ocp.state("v"), ocp.control("F")
    d = ocp.parameter("d", value=0.2)
    if discrete:
        ocp.dynamics({p: p + 0.1 * v, v: 0.9 * v + 0.1 * F + 0.1 * d}, discrete=True)
    else:
        ocp.dynamics({p: v, v: F - 0.3 * v + d})
    noise = {"measure": {"p": p, "s": p + v}, "noise_std": {"p": 0.01, "s": 0.05}}
    spread = {"process_std": {p: 0.001, v: 0.02, d: 0.05}, "initial_std": {p: 0.5, v: 0.7, d: 0.3}}
    return ocp, noise | spread


def linear(discrete: bool, options: Options | None) -> Linear:
    """The same in matrices: the map itself, or what the integrator makes of the model."""
    if discrete:
        A, B = np.array([[1, 0.1, 0], [0, 0.9, 0.1], [0, 0, 1]]), np.array([[0], [0.1], [0]])
    else:
        ocp = OCP("model", T=2.0, N=20)
        x, F = ocp.state("x", size=3), ocp.control("F")
        ocp.dynamics({x: ca.vertcat(x[1], F - 0.3 * x[1] + x[2], 0)})
        ocp.least_squares(F, weight=1.0)
        ctrl = build(ocp, Options(integrator=None if options is None else options.integrator), "test")
        A = np.array([ctrl.integrate(unit, [0], 0.1) for unit in np.eye(3)]).T
        B = ctrl.integrate(np.zeros(3), [1], 0.1)[:, None]
    H = np.array([[1.0, 0, 0], [1, 1, 0]])
    return Linear(A, B, H, np.diag([0.001, 0.02, 0.05]) ** 2, np.diag([0.01, 0.05]) ** 2)


def data(model: Linear | None = None, seed: int = 0) -> tuple[Any, Any]:
    """Measurements, 30 % of which are missing, and controls."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(SAMPLES, 1))
    y = (model or linear(True, None)).run(np.array([0.5, 0.3, 0.1]), u, rng)
    y[rng.uniform(size=y.shape) < 0.3] = np.nan
    return y, u


def steps(observer: Observer, y: Any, u: Any) -> Any:
    return np.array([observer.step(y[k], u[k - 1] if k else None) for k in range(len(y))])


# -- the Kalman filter ------------------------------------------------------------------------------------------------

IMPLICIT = Options(integrator=ImplicitRungeKutta(RadauIIA2, steps=1))
CASES = [
    *(("mhe", N, discrete, "chosen") for N in (1, 5, 20) for discrete in (True, False)),
    *(("mhe", 5, False, route) for route in ROUTES if route != "chosen"),
    *(("ekf", 1, discrete, "chosen") for discrete in (True, False)),
    *((kind, 5, False, "implicit") for kind in ("mhe", "ekf")),
]


@pytest.mark.few(5)
@pytest.mark.parametrize(("kind", "N", "discrete", "route"), CASES)
def test_a_linear_problem_has_the_estimate_of_the_kalman_filter(kind: Any, N: int, discrete: bool, route: str) -> None:
    """For every length of the window, with measurements missing; the covariance as well."""
    options = IMPLICIT if route == "implicit" else ROUTES[route]
    ocp, statement = cart(discrete)
    observer = build(ocp.estimator(N=N, kind=kind, **statement), options, "test")
    model = linear(discrete, options)
    y, u = data(model)
    reference = model.filter(np.array([0.3, 0, 0.2]), np.diag([0.25, 0.49, 0.09]), y, u)
    for k in range(SAMPLES):
        found = observer.step(y[k], u[k - 1] if k else None)
        assert observer.status is Status.OK
        np.testing.assert_allclose(found, reference[k][0], atol=1e-10)
        np.testing.assert_allclose(observer.covariance, reference[k][1], atol=1e-11)


def test_a_window_that_takes_measurements_twice_would_fail() -> None:
    """The comparison sees a wrong arrival cost: with the covariance of the estimate in its place."""
    ocp, statement = cart()
    observer, (y, u) = build(ocp.estimator(N=5, **statement), None, "test"), data()
    good = steps(observer, y, u)
    observer.reset()
    twice = []
    for k in range(SAMPLES):
        twice.append(observer.step(y[k], u[k - 1] if k else None))
        observer.view("information")[...] = np.linalg.inv(observer.covariance)
    assert np.max(np.abs(np.array(twice) - good)) > 1e-3


def test_single_precision() -> None:
    ocp, statement = cart()
    y, u = data()
    found = [
        steps(build(ocp.estimator(N=5, **statement), Options(precision=p), "test"), y, u) for p in ("single", "double")
    ]
    np.testing.assert_allclose(found[0], found[1], atol=2e-3)


# -- IPOPT on the same window -----------------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("name", PLANTS)
def test_a_window_that_has_converged_is_the_solution_of_ipopt(name: str) -> None:
    """With the arrival cost, the rows and the data that the estimator has at that sample."""
    plant, N = PLANTS[name], 8
    observer = build(plant.estimator(N=N), None, "test")
    plant.begin(observer)
    found = run(plant, np.random.default_rng(3))
    k = 21
    for at in range(k + 1):
        u = found.u[max(at - 1, 0)]
        observer.step(found.y[at], u if u.size else None)
    for _ in range(60):
        observer.correct(np.full(observer.estimation.ny, np.nan))
    problem = believing(estimation_problem(plant.estimator(N=N)), plant)
    start = problem.start.__class__(**{**vars(problem.start), "reference": np.array(observer.view("arrival.mean"))})
    start.__dict__["weight"] = np.array(observer.view("information"))
    problem.__dict__["start"] = start
    given = node_data(problem, x0=observer.window[0], p=window_data(problem, found, k - N, k))
    reference = Reference(problem).solve(given, x=observer.window, u=np.array(observer.u))
    assert reference.success
    assert observer.status is Status.OK
    np.testing.assert_allclose((observer.window - reference.x) / plant.scale, 0, atol=1e-6)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", PLANTS)
def test_a_window_knows_more_than_a_filter(name: str) -> None:
    plant = PLANTS[name]
    window, filter_ = (build(plant.estimator(kind=kind), None, "test") for kind in ("mhe", "ekf"))
    errors = []
    for observer in (window, filter_):
        plant.begin(observer)
        found = run(plant, np.random.default_rng(0))
        estimates, _, _ = estimate(observer, found)
        errors.append(np.sqrt(np.mean(((estimates - found.x)[plant.N :] / plant.scale) ** 2)))
    assert errors[0] < errors[1]


# -- data -------------------------------------------------------------------------------------------------------------


def test_without_measurements_the_model_goes_on() -> None:
    """Infinity is missing as NaN is."""
    for kind in ("mhe", "ekf"):
        ocp, statement = cart()
        observer = build(ocp.estimator(N=4, kind=kind, **statement), None, "test")
        x = observer.step([0.3, 0.3])
        for missing in (np.nan, np.inf, -np.inf, np.nan, np.nan, np.nan):
            x = np.array([x[0] + 0.1 * x[1], 0.9 * x[1] + 0.1 * 0.7 + 0.1 * x[2], x[2]])
            np.testing.assert_allclose(observer.step([missing, np.nan], [0.7]), x, atol=1e-11)
            assert observer.status is Status.OK


def test_controls_that_are_not_finite_keep_the_last_ones() -> None:
    for kind in ("mhe", "ekf"):
        ocp, statement = cart()
        pair = [build(ocp.estimator(N=4, kind=kind, **statement), None, "test") for _ in range(2)]
        for observer, last in zip(pair, (np.nan, 0.5), strict=True):
            observer.step([0.3, 0.3])
            observer.step([0.3, 0.3], [0.5])
            observer.step([0.31, 0.3], [last])
        assert [o.status for o in pair] == [Status.NOT_FINITE, Status.OK]
        np.testing.assert_array_equal(pair[0].view("x"), pair[1].view("x"))
        assert "not finite" in pair[0].diagnose()


def test_a_measurement_that_comes_late_counts_where_it_belongs() -> None:
    ocp, statement = cart()
    late, timely = (build(ocp.estimator(N=8, **statement), None, "test") for _ in range(2))
    y, u = data(seed=1)
    for k in range(30):
        timely.step(y[k], u[k - 1] if k else None)
        late.step([y[k, 0], np.nan], u[k - 1] if k else None)
        if k >= 3:
            found = late.correct({"s": y[k - 3, 1]}, node=-3)
    for back in (-2, -1, 0):
        found = late.correct([np.nan, y[29 + back, 1]], node=back)
    np.testing.assert_allclose(found, timely.window[-1], atol=1e-10)
    np.testing.assert_allclose(late.covariance, timely.covariance, atol=1e-12)


def test_the_start_of_a_loop_can_be_told() -> None:
    ocp, statement = cart()
    observer = build(ocp.estimator(N=5, **statement), None, "test")
    rng = np.random.default_rng(2)
    y, u = data()
    for _ in range(3):
        root = rng.normal(size=(3, 3))
        P, x = root @ root.T, rng.normal(size=3)
        observer.reset(x, P)
        reference = linear(True, None).filter(x, P, y[:12], u)
        np.testing.assert_allclose(steps(observer, y[:12], u)[-1], reference[-1][0], atol=1e-9)
    observer.reset(x0=[1, 2, 3])
    np.testing.assert_allclose(observer.step([np.nan, np.nan]), [1, 2, 3])
    for wrong in (np.diag([1, -1, 1]), np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]), np.full((3, 3), 2.0) - np.eye(3)):
        with pytest.raises(ControllerError, match="P0 is not symmetric and positive semidefinite"):
            observer.reset(None, wrong)
    observer.reset(None, np.diag([1.0, 0, 1]))
    assert observer.std[1] == 0
    assert np.all(np.isfinite(steps(observer, y, u)))


def test_copies_and_files(tmp_path: Path) -> None:
    ocp, statement = cart()
    observer, (y, u) = build(ocp.estimator(N=5, **statement), None, "test"), data()
    steps(observer, y[:9], u)
    others = [
        observer.copy(),
        pickle.loads(pickle.dumps(observer)),
        build(ocp.estimator(N=5, **statement), None, "test"),
    ]
    observer.save(tmp_path / "state.npz")
    others[2].load(tmp_path / "state.npz")
    expected = observer.step(y[9], u[8])
    for other in others:
        np.testing.assert_array_equal(other.step(y[9], u[8]), expected)
    assert "cart_estimator: mhe, N=5" in repr(observer)


def test_an_exported_estimator_is_opened_by_its_own_name(tmp_path: Path) -> None:
    ocp, statement = cart()
    ocp.least_squares(ca.vertcat(ocp.x, ocp.u), weight=1.0)
    export(ocp.estimator(N=5, **statement), None, tmp_path)
    with pytest.raises(ControllerError, match=r"open_estimator\(\)"):
        open_package(tmp_path, "test")
    export(ocp, None, tmp_path)
    assert open_package(tmp_path, "test").description.name == "cart"
    assert open_estimator(tmp_path, "test").step({"p": 0.3}).shape == (3,)


# -- failures ---------------------------------------------------------------------------------------------------------


def test_what_does_not_converge_falls_back_to_the_filter() -> None:
    """With one iteration and a narrow tolerance the window leaves gaps; the estimate is that of the filter."""
    plant = PLANTS["vehicle"]
    observer = build(plant.estimator(N=5), Options(algorithm=MovingHorizon(iterations=1, tolerance=1e-9)), "test")
    plant.begin(observer)
    found = run(plant, np.random.default_rng(0))
    statuses = set()
    for k in range(40):
        x = observer.step(found.y[k], found.u[max(k - 1, 0)])
        statuses.add(observer.status)
        assert np.all(np.isfinite(x))
        if observer.status is Status.NOT_CONVERGED:
            assert "filter" in observer.diagnose()
    assert Status.NOT_CONVERGED in statuses


def test_a_model_that_explodes_leaves_finite_estimates() -> None:
    ocp = OCP("explosion", T=2.0, N=4)
    x = ocp.state("x", initial=1.0)
    ocp.dynamics({x: 50 * x**3})
    for kind in ("mhe", "ekf"):
        observer = build(ocp.estimator(N=4, kind=kind, measure={"x": x}, noise_std={"x": 1.0}), None, "test")
        statuses = set()
        for k in range(12):
            assert np.all(np.isfinite(observer.step([np.nan if k % 3 else 1e3])))
            statuses.add(observer.status)
        assert statuses - {Status.OK}


# -- with a controller -----------------------------------------------------------------------------------------------


def loop(**changes: Any) -> Log:
    """A cart on a slope that the estimator finds."""
    ocp, statement = cart()
    ocp.least_squares(ca.vertcat(ocp.x, ocp.u + ocp.p), weight=[10, 1, 0.1], reference=[0.5, 0, 0])
    observer = build(ocp.estimator(N=8, **statement), None, "test")
    given = {"estimator": observer, "parameters": {"d": np.full(40, -0.1)}} | changes
    return simulate(build(ocp, None, "test"), [0.3, 0.0], 40, **given)


def test_a_loop_with_an_estimator(tmp_path: Path) -> None:
    """The log has truth, measurements with noise, and estimates; the controller uses the parameter that is found."""
    log = loop(seed=3)
    found = log.estimates
    assert found is not None
    assert log.ok
    assert not found.status.any()
    np.testing.assert_array_equal(found.p[:, 0], -0.1)
    np.testing.assert_array_equal(log.p[:, 0], found.x[:, 2])
    noise = found.y - np.column_stack([log.x[:-1, 0], log.x[:-1].sum(axis=1)])
    assert np.std(noise, axis=0) == pytest.approx([0.01, 0.05], rel=0.4)
    assert abs(found.x[-1, 2] + 0.1) < 3 * found.std[-1, 2]
    assert abs(log.x[-1, 0] - 0.5) < 0.05
    np.testing.assert_array_equal(loop(seed=3).x, log.x)
    assert np.any(loop(seed=4).x != log.x)
    np.testing.assert_allclose(loop(seed=None).estimates.y[0], [0.3, 0.3])  # type: ignore[union-attr]
    assert "estimator: 0 samples not OK" in log.summary()
    figure = log.plot(tmp_path / "loop.png")
    assert [axis.get_ylabel() for axis in figure.axes][:4] == ["p", "v", "d", "s"]
    log.save(tmp_path / "log.npz")
    again = Log.load(tmp_path / "log.npz").estimates
    assert again is not None
    assert again.sensors == found.sensors
    for name in ("x", "std", "y", "p", "status", "time_ns"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    frame = log.to_dataframe()
    np.testing.assert_array_equal(frame["xhat", "d"].to_numpy()[:-1], found.x[:, 2])


def test_estimators_of_other_plants_are_refused() -> None:
    ocp, statement = cart()
    other = OCP("other", N=3)
    p, v, _ = other.state("p"), other.state("v"), other.control("G")
    other.dynamics({p: p, v: v}, discrete=True)
    observer = build(other.estimator(measure={"p": p}, noise_std={"p": 1.0}), None, "test")
    with pytest.raises(ControllerError, match=r"has the controls \('G',\), not \('F',\)"):
        loop(estimator=observer)
    with pytest.raises(ControllerError, match=r"expected the states \('p', 'v'\)"):
        loop(estimator=build(PLANTS["reactor"].estimator(), None, "test"))
    with pytest.raises(ControllerError, match="expected an Observer"):
        loop(estimator=ocp.estimator(N=3, **statement))


# -- statements -------------------------------------------------------------------------------------------------------


def test_algebraic_variables_can_be_measured() -> None:
    ocp = OCP("cell", T=2.0, N=20)
    q, i = ocp.state("q", initial=0.5, scale=1.0), ocp.control("i")
    v = ocp.algebraic("v", unit="V")
    ocp.dynamics({q: -i / 10})
    ocp.algebraic_equation(v - (3 + q - 0.1 * i))
    observer = build(ocp.estimator(N=4, measure={"v": v}, noise_std={"v": 0.01}, process_std={q: 1e-3}), None, "test")
    for _ in range(5):
        found = observer.step([3.3 - 0.1 * 2], [2.0])
    assert abs(found[0] - 0.3) < 0.05
    assert observer.estimation.measured[0].unit == "V"


def test_vectors_and_names() -> None:
    ocp = OCP("arm", T=1.0, N=10)
    r, v = ocp.state("r", size=2, unit="m"), ocp.state("v", size=2)
    F = ocp.control("F", size=2)
    ocp.dynamics({r: v, v: F})
    estimator = ocp.estimator(
        N=3, measure={"r": r, "first": v[0]}, noise_std={"r": [0.1, 0.2], "first": 0.1}, process_std={"v": [0.1, 0.0]}
    )
    observer = build(estimator, None, "test")
    assert observer.estimation.measurements == ("r[0]", "r[1]", "first")
    assert observer.names.controls == ("noise_v_0",)
    observer.step({"r": [1, 2]})
    found = observer.step({"r[1]": 2.0, "first": 0.1}, {"F": [0, 1]})
    assert observer.status is Status.OK
    assert found.shape == (4,)
    with pytest.raises(ControllerError, match=r"u has no 'F\[1\]'"):
        observer.step({}, {"F[0]": 1})


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"kind": "ukf"}, r"kind is 'ukf'; expected one of 'mhe', 'ekf'"),
    ({"N": 0}, "estimator: N must be an integer >= 1"),
    ({"measure": {}}, "measure is '{}'; expected"),
    ({"noise_std": {"p": 1.0}}, "measurement 's' has no standard deviation"),
    ({"noise_std": {"p": 0.0, "s": 1.0}}, "noise_std is '0.0'; expected numbers > 0"),
    ({"noise_std": {"p": 1.0, "s": 1.0, "q": 1.0}}, "noise_std of 'q', which is not measured"),
    ({"process_std": {"F": 1.0}}, "process_std of 'F', which it cannot have; declared are: p, v, d"),
    ({"process_std": {"p": -1.0}}, "process_std of 'p' is '-1.0'; expected numbers >= 0"),
    ({"process_std": {"p": 1.0}, "input_std": {"q": 1.0}}, "input_std of 'q', which it cannot have"),
    ({"process_std": {"d": 1.0}, "input_std": {"d": 1.0}}, "'d' has a process_std and an input_std"),
    ({"initial_std": {"p": 0.0}}, "initial_std of 'p' is '0.0'; expected numbers > 0"),
    ({"loss": "cauchy"}, "loss is 'cauchy'; expected 'squares' or 'huber'"),
    ({"loss": {"q": "huber"}}, "loss of 'q', which is not measured"),
    ({"rows": ["speed"]}, "rows: 'speed' is no row"),
    ({"measure": {1: 1.0}, "noise_std": {1: 1.0}}, "measurement '1': name must be a string"),
    ({"measure": {"a b": 1.0}, "noise_std": {"a b": 1.0}}, "name 'a b' is no C identifier"),
    ({"measure": {"y": 1.0}, "noise_std": {"y": 1.0}}, "measurement 'y' depends on no state"),
    ({"noise_std": {"p": 1e-200, "s": 1}}, r"noise_std is '\[1e-200\]'; expected numbers between 1e-30 and 1e\+30"),
    ({"dt": 0.1}, "dt is given, but the dynamics of 'cart' are a discrete map"),
    ({"name": "cart"}, "name 'cart' is that of the OCP"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_a_wrong_statement_is_named(change: dict[str, Any], message: str) -> None:
    ocp, statement = cart()
    with pytest.raises(ProblemError, match=message):
        ocp.estimator(**{"N": 3, **statement, **change})


def test_what_no_estimator_supports_is_named() -> None:
    ocp = OCP("clock", T=1.0, N=4)
    x = ocp.state("x")
    stated = {"N": 2, "measure": {"x": x}, "noise_std": {"x": 1.0}}
    with pytest.raises(ProblemError, match="the dynamics of x are missing"):
        build(ocp.estimator(**stated))
    ocp.dynamics({x: ocp.time})
    with pytest.raises(ProblemError, match=r"dynamics with ocp.time; expected a parameter"):
        build(ocp.estimator(**stated))
    ocp = OCP("implied", T=1.0, N=4)
    x, z = ocp.state("x"), ocp.algebraic("z", initial=1.0)
    ocp.dynamics({x: -z})
    ocp.algebraic_equation(z + z**3 - x)
    with pytest.raises(ProblemError, match="z is found by Newton's method"):
        build(ocp.estimator(N=2, measure={"x": x}, noise_std={"x": 1.0}))


def test_options_of_an_estimator() -> None:
    ocp, statement = cart()
    estimator = ocp.estimator(N=3, **statement)
    with pytest.raises(OptionError, match=r"solve: True; an estimator has no solve\(\)"):
        build(estimator, Options(solve=True))
    with pytest.raises(OptionError, match=r"measurements.*MovingHorizon"):
        build(estimator, Options(algorithm=RealTimeIteration(iterations=1)))
    with pytest.raises(OptionError, match="is that of kind='mhe'"):
        build(ocp.estimator(kind="ekf", **statement), Options(algorithm=MovingHorizon()))
    ocp.least_squares(ca.vertcat(ocp.x, ocp.u), weight=1.0)
    with pytest.raises(OptionError, match=r"expected build\(ocp.estimator"):
        build(ocp, Options(algorithm=MovingHorizon()))
    with pytest.raises(AttributeError, match=r"build\(estimator\).step runs it"):
        estimator.step([0.0, 0.0])


def test_calls_that_are_wrong_are_named() -> None:
    ocp, statement = cart()
    observer = build(ocp.estimator(N=3, **statement), None, "test")
    with pytest.raises(ControllerError, match="there is no sample yet"):
        observer.correct([0.0, 0.0], node=-1)
    observer.step([0.0, 0.0])
    with pytest.raises(ControllerError, match="expected u, the controls since the last one: F"):
        observer.step([0.0, 0.0])
    with pytest.raises(ControllerError, match="y: no 'q'"):
        observer.step({"q": 1.0}, [0.0])
    with pytest.raises(ControllerError, match=r"y has shape \(3,\); expected \(2,\)"):
        observer.step([1.0, 2.0, 3.0], [0.0])
    for node in (-1, 1, True, 0.5):
        with pytest.raises(ControllerError, match="node is"):
            observer.correct([0.0, 0.0], node=node)  # type: ignore[arg-type]
    filter_ = build(ocp.estimator(kind="ekf", **statement), None, "test")
    with pytest.raises(ControllerError, match="a filter keeps no sample"):
        filter_.correct([0.0, 0.0])


def test_rows_that_the_estimator_shares() -> None:
    """Hard rows on states; soft ones are wishes, and rows of controls alone say nothing of states."""
    ocp = OCP("rows", T=1.0, N=4)
    x, v, u = ocp.state("x"), ocp.state("v"), ocp.control("u")
    ocp.dynamics({x: v, v: u})
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(0, x, ca.inf)
    ocp.subject_to(-1, v, 1, soft=(1, 1))
    ocp.subject_to(-5, x + v, 5, name="sum")
    stated: dict[str, Any] = {"N": 2, "measure": {"x": x}, "noise_std": {"x": 1.0}, "process_std": {v: 0.1}}
    assert [r.name for r in estimation_problem(ocp.estimator(**stated)).rows] == ["x", "sum"]
    assert [r.name for r in estimation_problem(ocp.estimator(**stated, rows=["v"])).rows] == ["v"]
    assert not estimation_problem(ocp.estimator(**stated, rows=False)).rows
    observer = build(ocp.estimator(**stated), None, "test")
    for _ in range(20):
        found = observer.step([-3.0], [0.0])
    assert found[0] > -0.1
    observer.set_bounds("x", -10, np.inf)
    for _ in range(20):
        found = observer.step([-3.0], [0.0])
    assert found[0] < -2.5


def test_plant_is_a_plant() -> None:
    """The oracle's runs differ by their draws alone."""
    plant: Plant = PLANTS["reactor"]
    first, again, other = (run(plant, np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.y, again.y)
    assert np.max(np.abs(first.x - other.x)) > 1e-3


def test_parameters_of_another_plant_go_by_name() -> None:
    """The plant has its parameters in another order, and more of them; one that lacks the unknown one is refused."""

    def tank(name: str, *parameters: str) -> tuple[OCP, ca.SX]:
        ocp = OCP(name, T=5.0, N=5)
        h, q = ocp.state("h", initial=0.3), ocp.control("q")
        p = {n: ocp.parameter(n, value={"gain": 3.0, "loss": 0.1}[n]) for n in parameters}
        ocp.dynamics({h: p.get("gain", 3.0) * q - p.get("loss", 0.1) * h})
        ocp.least_squares(ca.vertcat(h, q), weight=1, reference=[0.5, 0.0])
        ocp.subject_to(0, q, 0.2)
        return ocp, h

    ocp, h = tank("tank", "loss")
    observer = build(
        ocp.estimator(N=3, measure={"h": h}, noise_std={"h": 0.01}, process_std={"h": 0.01, "loss": 0.01}), None, "test"
    )
    ctrl = build(ocp, profile="test")
    log = simulate(ctrl, [0.3], 4, plant=build(tank("rich", "gain", "loss")[0], profile="test"), estimator=observer)
    assert log.estimates is not None
    np.testing.assert_array_equal(log.estimates.p, np.full((4, 1), 0.1))
    with pytest.raises(ControllerError, match="bare lacks loss, which the estimator finds"):
        simulate(ctrl, [0.3], 4, plant=build(tank("bare")[0], profile="test"), estimator=observer)
