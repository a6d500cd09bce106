"""The contracts of samples state that results can be used, whatever data a controller or an estimator receives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from nmpc_codegen import Controller, Status
from nmpc_codegen.oracle.trajectory import Data
from nmpc_codegen.runtime.estimation.observer import Observer
from verification.contracts.solutions import compare_with_ipopt
from verification.contracts.subject import Array, Subject
from verification.robustness.hostile import spoiled
from verification.robustness.returns import Assault, Outcome

#: Segments of samples with evil data, and good samples after which a controller is right again.
SEGMENTS, GOOD = 6, 60


def controls_are_safe(subject: Subject) -> None:
    """Assert that controls are finite and inside their bounds after evil data, and that good data restore samples."""
    controller, rest = subject.controller(), subject.measured()
    fresh = subject.controller()
    for _ in range(GOOD):
        fresh.step(rest)
    size, seed = np.maximum(np.abs(rest), 0.2), sum(map(ord, subject.sample.name))
    found = Outcome()
    with np.errstate(all="ignore"):
        assault = Assault(controller, rest, 0.2 * size, seed)
        for _ in range(SEGMENTS):
            assault.segment(found)
        assault.data.restore()
    if controller.description.augmentation.previous:
        controller.set_previous(np.zeros(controller.dims.nu))  # it was applied, and rates tie the next ones to it
    assert not found.violations, found.first
    assert len(found.status) > 1, "no sample failed: the data are not evil"
    statuses = []
    for _ in range(GOOD):
        controller.step(rest)
        statuses.append(controller.status)
    if fresh.status is Status.OK:
        assert Status.OK in statuses, statuses[-1]
    else:
        assert not controller.status.is_failure or fresh.status.is_failure, statuses[-1]


def estimates_are_finite(subject: Subject) -> None:
    """Assert that estimates and covariances are finite after evil measurements.

    After good ones the estimator must be OK again, if it would have been OK without the evil ones.
    """
    observer, random = subject.observer(), np.random.default_rng(3)
    fresh, nu = observer.copy(), observer.estimation.nu
    rest = np.zeros(nu)

    def sample(who: Observer, y: Array, u: Array) -> Status:
        x = who.step(y, u if nu else None)
        assert np.all(np.isfinite(x)), who.diagnose()
        assert np.all(np.isfinite(who.covariance))
        return who.status

    good = np.asarray(observer.measure(np.abs(subject.measured()), rest if nu else None))
    with np.errstate(all="ignore"):
        for k in range(GOOD):
            evil = spoiled(random, good) if k % 3 == 0 else good, spoiled(random, rest) if k % 5 == 0 and nu else rest
            sample(observer, *evil)
    least = {sample(fresh, good, rest) for _ in range(GOOD)}
    if Status.OK in least:
        assert Status.OK in {sample(observer, good, rest) for _ in range(5 * GOOD)}


def data_that_are_set_are_data_that_are_declared(subject: Subject) -> None:
    """Assert that solve() returns IPOPT's solution for new references, weights and parameters.

    They are set at every node where nodes have their own.
    """
    controller, x0 = subject.controller(), subject.measured()
    data = subject.data(x0)
    compare_with_ipopt(subject, controller, x0, replace(data, **_change(controller, data)))


def _change(controller: Controller, data: Data) -> dict[str, Array]:
    """Set numbers near the declared ones; return the arrays of ``data`` that change."""
    random, dims = np.random.default_rng(11), controller.dims
    layouts: Mapping[Any, str] = controller.description.online
    found: dict[str, Array] = {}

    def near(kind: str, values: Array) -> Array:
        """Return values (nodes, ...), multiplied by one factor, or by one for each node."""
        shape = values.shape if layouts[kind] == "node" else (1, *values.shape[1:])
        return np.asarray(values * (1 + 0.05 * random.uniform(-1, 1, shape)))

    def tell(kind: str, call: Callable[[Array, int | None], None], values: Array) -> None:
        for k in range(len(values) if layouts[kind] == "node" else 1):
            call(values[k], k if layouts[kind] == "node" else None)

    if dims.ny and layouts["reference"] != "fixed":
        found["yref"] = near("reference", data.yref + 0.02)
        tell("reference", controller.set_reference, found["yref"])
    if dims.ny and layouts["weight"] != "fixed":
        diagonal = all(np.array_equal(W, np.diag(np.diag(W))) for W in data.W)
        size = near("weight", np.ones((dims.N, 1, 1)))
        found["W"] = data.W * size
        tell(
            "weight", controller.set_weight, found["W"] if not diagonal else np.array([np.diag(W) for W in found["W"]])
        )
    if controller.description.parameters and layouts["parameter"] != "fixed":
        found["p"] = near("parameter", data.p) if layouts["parameter"] == "node" else data.p * 1.03
        for signal in controller.description.parameters:
            part = found["p"][:, signal.offset : signal.offset + signal.size]
            tell("parameter", partial(controller.set_parameter, signal.name), part)
            if layouts["parameter"] != "node":
                controller.set_parameter(signal.name, part[-1], node=dims.N)
    return found
