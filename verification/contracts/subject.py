"""A subject is a sample with its model, its compiled package, measured states, and IPOPT."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen import Controller, Options, ProblemWarning
from nmpc_codegen.compiler import model_of, read, text_of
from nmpc_codegen.economic.stage import tableau
from nmpc_codegen.lowering.explain import explain
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.oracle.reference import Reference
from nmpc_codegen.oracle.trajectory import Data, Tableau, node_data
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.build import load_any
from nmpc_codegen.runtime.estimation.observer import Observer
from verification.problems import apply
from verification.rendered import texts
from verification.timed import Sample

Array = NDArray[np.float64]

#: The tolerance of solve() in each precision, and its iterations at most; barriers and lumped rows need many.
TOLERANCE = {"double": 1e-9, "single": 1e-3}
MOST_ITERATIONS = 1000


@dataclass(frozen=True, eq=False)
class Subject:
    """A subject is a sample under contracts, compiled for this machine."""

    sample: Sample
    _packages: dict[str, Controller | Observer] = field(default_factory=dict)

    @cached_property
    def options(self) -> Options:
        """Return the options of the sample, with a portable target."""
        return replace(self.sample.options, target="portable")

    @cached_property
    def model(self) -> Model:
        """Return the functions of the package, and its components."""
        return self._model(self.options)

    @cached_property
    def text(self) -> Sources:
        """Return the package for the target of the sample, without third-party code."""
        return texts(self.sample)

    def _model(self, options: Options) -> Model:
        with quiet():
            return model_of(*read(self.sample.make(), options))

    def _package(self, precision: Any) -> Controller | Observer:
        chosen = precision or self.options.precision
        if chosen not in self._packages:
            own = chosen == self.options.precision
            model = self.model if own else self._model(replace(self.options, precision=chosen))
            module = explain(lower(model), model)
            self._packages[chosen] = load_any(text_of(module), module.name, "test")
        return self._packages[chosen]

    def controller(self, precision: Any = None) -> Controller:
        """Return a fresh controller, in the given or its own precision."""
        found = self._package(precision)
        assert isinstance(found, Controller)
        fresh = found.copy()
        if self.sample.data:
            apply(fresh, self.sample.data)
            fresh.reset()
        return fresh

    def observer(self, precision: Any = None) -> Observer:
        """Return a fresh estimator, in the given or its own precision."""
        found = self._package(precision)
        assert isinstance(found, Observer)
        return found.copy()

    @cached_property
    def scheme(self) -> Tableau:
        """Return the integrator of the package as plain numbers."""
        return tableau(self.model.problem, self.options)

    @cached_property
    def oracle(self) -> Reference:
        """Return the nonlinear program, built from the completed problem only."""
        return Reference(self.model.problem, self.scheme)

    def measured(self, number: int = 0, spread: float = 0.05) -> Array:
        """Return measured state ``number``, which differs from the declared one by up to ``spread`` of its size.

        If the sample states a first state, it is number 0.
        """
        x = self.model.problem.x_initial[: self.model.problem.measured]
        if self.sample.x0:
            x = np.array(self.sample.x0, dtype=float)
            if number == 0:
                return x
        random = np.random.default_rng([2, number])
        return np.asarray(x + spread * np.where(x != 0, np.abs(x), 0.2) * random.uniform(-1, 1, x.size))

    def data(self, x0: Array) -> Data:
        """Return the data of the nonlinear program: those of the sample, and x0."""
        whole = self.model.problem.x_initial.copy()
        whole[: x0.size] = x0
        return node_data(self.model.problem, x0=whole, **self.sample.data)


@contextmanager
def quiet() -> Iterator[None]:
    """Ignore warnings, which some samples exist to cause."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        yield


def relative(a: Any, b: Any) -> float:
    """Return the largest difference per component, relative to max(1, largest |b| of the component)."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    return float(np.max(np.abs(a - b) / np.maximum(1.0, np.max(np.abs(b), axis=0, initial=0.0)), initial=0.0))
