"""Contracts are registered here, with the rule which samples are held to them.

A sample is held to a contract unless the contract excuses its components. The excuse states the reason, and is a cell
of the table.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from nmpc_codegen.components.base import SEAMS
from nmpc_codegen.options import REGISTRIES
from verification.contracts import bits, data, numbers, plans, solutions, text
from verification.contracts.subject import Subject
from verification.problems import CASES, options_of
from verification.rendered import model
from verification.samples import SAMPLES
from verification.timed import Sample

#: All samples that are held to contracts: those of the compiler's output, and small problems, some with other data.
HELD = (*SAMPLES, *(Sample(f"case {name}", c.make, options_of(c), c.x0, c.data) for name, c in CASES.items()))

#: The components of every sample, as the compiler chooses them; test_samples.py compares it with what is lowered.
FILE = Path(__file__).with_name("components.json")
#: These samples come first in `make test`, because several contracts share their packages.
FIRST = (
    *("crane", "controls riccati", "soft rows interior", "stiff everything", "discrete rows riccati", "tuned dense"),
    *("states augmented", "path shooting", "reactor window", "battery filter", "map window", "controls OSQP"),
    *("everything dense", "algebraic riccati", "arrival augmented", "economic quasi-Newton", "vehicle window"),
    *("reactor filter", "path OSQP", "tuned end", "ring interior", "counted dense"),
)


#: Name that replaces the seam in rows of the table for features of problems.
PROBLEM = "problem"


@dataclass(frozen=True)
class Components:
    """Components describe a sample: names of its components by seam, precision, and the features of its problem.

    ``solves``: the package has solve(); ``uses``: what the problem has beyond controls, bounds and least squares;
    ``sets``: data can be set at run time.
    """

    seams: dict[str, str]
    precision: str
    solves: bool
    uses: tuple[str, ...]
    sets: bool

    @property
    def estimates(self) -> bool:
        """Return True for an estimator."""
        return self.seams["algorithm"] in ("moving_horizon", "kalman_filter")

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Yield the rows of the table: (seam, component), the precision, and (PROBLEM, feature)."""
        return iter([*self.seams.items(), ("precision", self.precision), *((PROBLEM, use) for use in self.uses)])


#: The reason why components are excused from a contract, or "".
Excuse = Callable[[Components], str]


@dataclass(frozen=True)
class Contract:
    """``hold`` raises AssertionError for a Subject that breaks the contract.

    ``excuse`` tells which components are excused.

    ``each``: number of samples of every component that `make test` holds to it, besides one of every feature of
    problems if ``each`` exceeds one; `make test-all` takes all samples. ``tools``: programs that it runs.
    """

    hold: Callable[[Subject], None]
    excuse: Excuse
    each: int = 2
    tools: tuple[str, ...] = ("cc",)

    @property
    def name(self) -> str:
        """Return the name in words."""
        return self.hold.__name__.replace("_", " ")


def _controls(sample: Components) -> str:
    return "estimators return no control" if sample.estimates else ""


def _solves(sample: Components) -> str:
    return _controls(sample) or ("" if sample.solves else "without solve()")


def _sets(sample: Components) -> str:
    return _solves(sample) or ("" if sample.sets else "all data are fixed")


def _phases(sample: Components) -> str:
    shooting = sample.seams["algorithm"] == "adjoint_shooting"
    return _controls(sample) or ("single shooting has no phases, and keeps no [A B]" if shooting else "")


def _copies(sample: Components) -> str:
    return _controls(sample) or ("copies share OSQP's workspace" if sample.seams["qp"] == "osqp" else "")


def _own(sample: Components) -> str:
    return "OSQP calls what it needs" if sample.seams["qp"] == "osqp" else ""


def _precisions(sample: Components) -> str:
    return _controls(sample) or ("OSQP's code is in double precision" if sample.seams["qp"] == "osqp" else "")


def _counts(sample: Components) -> str:
    if sample.estimates or sample.seams["algorithm"] == "adjoint_shooting" or sample.seams["qp"] == "osqp":
        return "only functions of packages with a preparation of their own are counted"
    return "Newton's method is not counted" if "nonlinear algebraic equations" in sample.uses else ""


def _estimates(sample: Components) -> str:
    return "" if sample.estimates else "controllers do not estimate"


def _all(sample: Components) -> str:
    return ""


CONTRACTS = (
    Contract(solutions.solve_equals_ipopt, _solves),
    Contract(solutions.residuals_and_cost_equal_numpy, _solves),
    Contract(plans.a_sample_keeps_the_solution, _solves),
    Contract(plans.a_preparation_serves_one_feedback, _phases),
    Contract(data.controls_are_safe, _controls),
    Contract(data.data_that_are_set_are_data_that_are_declared, _sets),
    Contract(data.estimates_are_finite, _estimates),
    Contract(bits.copies_have_the_same_bits, _copies),
    Contract(bits.a_batch_has_the_bits_of_its_controllers, _copies),
    Contract(bits.a_recording_replays, _copies),
    Contract(bits.the_package_does_what_the_whole_text_does, _all, each=1, tools=("gcc",)),
    Contract(text.what_stands_in_a_unit_is_there, _all, each=1),
    Contract(text.functions_fit_a_screen, _all, each=1),
    Contract(text.front_ends_find_nothing, _all, each=1, tools=("gcc", "cxx")),
    Contract(text.symbols_are_its_own, _own, each=1, tools=("gcc",)),
    Contract(numbers.linearisation_equals_casadi, _phases),
    Contract(numbers.stated_operations_are_counted, _counts, each=1, tools=("cxx",)),
    Contract(numbers.single_is_close_to_double, _precisions),
)


@cache
def components() -> dict[str, Components]:
    """Return {sample: its components}, from the file."""
    found = json.loads(FILE.read_text(encoding="utf-8"))
    return {name: Components(**(of | {"uses": tuple(of["uses"])})) for name, of in found.items()}


def chosen_by_the_compiler(sample: Sample) -> dict[str, object]:
    """Return the entry of a sample in the file."""
    found, parts = model(sample), {}
    for seam in SEAMS:
        part = getattr(found.parts, seam, None)
        parts[seam] = "none" if part is None else part.name
    kind = {"mhe": "moving_horizon", "ekf": "kalman_filter"}.get(getattr(found.problem.estimation, "kind", ""), "")
    parts["algorithm"] = kind or parts["algorithm"]
    solves = sample.options.solves and not kind
    uses = sorted(found.problem.uses)
    online = sample.options.online
    sets = any(kind != "fixed" for kind in (online.reference, online.weight, online.parameter))
    return {"seams": parts, "precision": sample.options.precision, "solves": solves, "uses": uses, "sets": sets}


def rows() -> tuple[tuple[str, str], ...]:
    """Return the rows of the table as pairs: (seam, component), ("precision", name), (PROBLEM, feature)."""
    registered = ((seam, name) for seam in SEAMS for name in REGISTRIES[seam])
    uses = sorted({use for found in components().values() for use in found.uses})
    return (*registered, ("precision", "double"), ("precision", "single"), *((PROBLEM, use) for use in uses))


def under(contract: Contract) -> list[Sample]:
    """Return the samples that are held to a contract, first those that share their packages."""
    order = {name: number for number, name in enumerate(FIRST)}
    known = components()
    found = [sample for sample in HELD if not contract.excuse(known[sample.name])]
    return sorted(found, key=lambda sample: order.get(sample.name, len(order)))


def in_make_test(contract: Contract) -> list[Sample]:
    """Return the samples that `make test` holds to a contract, a few of every component."""
    counts: dict[tuple[str, str], int] = {}
    taken = []
    for sample in under(contract):
        parts = list(components()[sample.name])
        asked = (part for part in parts if part[0] != PROBLEM or contract.each > 1)
        if any(counts.get(part, 0) < (1 if part[0] == PROBLEM else contract.each) for part in asked):
            taken.append(sample)
            counts |= {part: counts.get(part, 0) + 1 for part in parts}
    return taken


def reason(contract: Contract, part: tuple[str, str]) -> str:
    """Return the reason why no sample with a component is held to a contract."""
    excuses = {contract.excuse(sample) for sample in components().values() if part in set(sample)} - {""}
    return ", ".join(sorted(excuses)) or "no sample"


def table() -> tuple[Sequence[str], Sequence[Sequence[str]], dict[str, str]]:
    """Return titles, lines and reasons: for every component the samples in `make test` and in all, by contract."""
    reasons: dict[str, str] = {}
    lines = []
    for part in rows():
        cells = []
        for contract in CONTRACTS:
            few, every = (
                sum(part in set(components()[sample.name]) for sample in samples)
                for samples in (in_make_test(contract), under(contract))
            )
            if not every:
                mark = reasons.setdefault(reason(contract, part), chr(ord("a") + len(reasons)))
            cells.append(f"{few}/{every}" if every else mark)
        lines.append([": ".join(part), *cells])
    return ["", *(str(number) for number in range(1, len(CONTRACTS) + 1))], lines, reasons
