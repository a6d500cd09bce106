"""Candidates are a few sets of options that differ in what most often decides a closed loop."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from nmpc_codegen.campaigns.coach.spelling import spell_options
from nmpc_codegen.compiler import compile
from nmpc_codegen.components.algorithms import RealTimeIteration
from nmpc_codegen.components.hessians import ExactHessian
from nmpc_codegen.components.integrators import ExplicitRungeKutta
from nmpc_codegen.decisions.integrator import integrator_of
from nmpc_codegen.errors import NmpcError, OptionError, ProblemWarning
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.horizon import with_horizon
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.options import Options
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.controller import Controller

#: Factors of the horizon and of the integration steps, and the number of iterations, that are tried.
HORIZONS, STEPS, ITERATIONS = (0.5, 2.0), (0.5, 2.0), 30
#: Least number of intervals of a horizon; integration steps of the plant for each step of the finest candidate.
LEAST, FINER = 2, 2


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate consists of options, a horizon, the change against the base, and the controller."""

    change: str
    options: Options
    intervals: int
    controller: Controller

    @property
    def line(self) -> str:
        """Return the options as a line of Python."""
        return spell_options(self.options)


def propose(ocp: OCP, base: Options) -> Iterator[tuple[str, Options, int]]:
    """Yield the base and its variants: (change, options, intervals)."""
    algorithm = base.algorithm
    yield "default" if base == Options() else "as given", base, ocp.N
    if base.hessian is None:
        yield "hessian=ExactHessian()", replace(base, hessian=ExactHessian()), ocp.N
    if isinstance(algorithm, RealTimeIteration):
        changes: dict[str, Any] = {"shift": None, "iterations": ITERATIONS}
        for name, value in changes.items():
            if getattr(algorithm, name) != value:
                yield f"{name}={value}", replace(base, algorithm=replace(algorithm, **{name: value})), ocp.N
    scheme = scheme_of(ocp, base)
    if scheme is not None:
        for steps in _multiples(scheme.steps, STEPS, 1):
            yield f"steps={steps}", replace(base, integrator=replace(scheme, steps=steps)), ocp.N
    for N in _multiples(ocp.N, HORIZONS, LEAST):
        yield f"N = {N}", base, N


def _multiples(value: int, factors: tuple[float, ...], least: int) -> list[int]:
    found = [max(least, round(factor * value)) for factor in factors]
    return [n for n in dict.fromkeys(found) if n != value]


def scheme_of(ocp: OCP, options: Options) -> ExplicitRungeKutta | None:
    """Return the explicit scheme of the controller, or None if its number of steps cannot be varied.

    It cannot be varied if time or previous controls occur, because a plant from another package does not receive them.
    """
    problem = classify(ocp)
    if problem.discrete or problem.augmentation.count or problem.jump is not None:
        return None
    chosen = integrator_of(problem, options)
    return chosen if isinstance(chosen, ExplicitRungeKutta) else None


def build_candidates(ocp: OCP, stated: Iterator[tuple[str, Options, int]], given: bool = False) -> list[Candidate]:
    """Build the candidates that the problem allows, except those with the same code as an earlier one.

    The first candidate must build. If the user has ``given`` the options, all of them must build.

    Raises:
        NmpcError: a candidate that must build cannot be built.
    """
    found: list[Candidate] = []
    known: set[str] = set()
    for change, options, N in stated:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore" if found else "default", ProblemWarning)
                sources = compile(ocp if ocp.N == N else with_horizon(ocp, N), options)
        except NmpcError as error:
            if given:
                raise type(error)(f"{change}: {error}") from error
            if not found:
                raise
            continue
        code = sources[f"{sources.description.name}.c"]
        if code in known and not given:
            continue
        known.add(code)
        found.append(Candidate(change, options, N, load(sources, sources.description.name, "fast")))
    return found


def build_plant(ocp: OCP, candidates: list[Candidate]) -> Controller | None:
    """Build one plant for all candidates, finer than each of them, if their integrators differ; else return None.

    Raises:
        OptionError: no plant that is fine enough can be chosen.
    """
    problem = classify(ocp)
    schemes = [integrator_of(problem, c.options) for c in candidates]
    precisions = {c.options.precision for c in candidates}
    if problem.discrete or all(scheme == schemes[0] for scheme in schemes):
        return None
    explicit = [scheme for scheme in schemes if isinstance(scheme, ExplicitRungeKutta)]
    if len(explicit) < len(schemes) or len(precisions) > 1 or scheme_of(ocp, candidates[0].options) is None:
        raise OptionError(
            "options integrate differently, and no plant serves all of them: compare those of one integrator and one "
            "precision, or give plant=build(ocp, ...)"
        )
    finest = max(explicit, key=lambda scheme: (scheme.tableau.order, scheme.steps))
    steps = FINER * max(scheme.steps for scheme in explicit)
    options = replace(candidates[0].options, integrator=replace(finest, steps=steps))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        sources = compile(ocp, options, f"{ocp.name}_plant")
    return load(sources, sources.description.name, "fast")
