"""The largest caps on iterations whose worst case fits a limit on the operations of a sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

from nmpc_codegen.analysis import worst_case
from nmpc_codegen.components.base import Parts
from nmpc_codegen.components.qp.dense_active_set import CAUTION
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.lowering.linearize import Model, linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import render
from nmpc_codegen.options import Options
from nmpc_codegen.targets import PORTABLE

#: Sizes of a package that are caps on iterations of a sample.
CAPS = ("QP_MAX_ITERATIONS", "IPM_MAX_ITERATIONS", "ITERATIONS", "MAX_PRODUCTS")

#: What a sample can do without, in the order in which it is given up: flag, seam, option, its value without it.
REMEDIES = (
    ("--set qp.fallback=None", "qp", "fallback", None),
    ("--set algorithm.repair=0", "algorithm", "repair", 0),
    ("--set algorithm.relaxation=None", "algorithm", "relaxation", None),
)


@dataclass(frozen=True)
class Fit:
    """``options`` with every cap on iterations at most ``most``; the ``worst`` case of a sample that results.

    If the caps are lower than before, the options state condensing and QP solver, for which there are ``reasons``.
    ``warning``: they are lower than what closed loops need, "" if they are not.
    """

    options: Options
    most: int
    worst: int
    reasons: tuple[str, ...] = ()
    warning: str = ""


def fitting(ocp: OCP, options: Options, limit: int, name: str | None = None) -> Fit:
    """The largest caps on iterations for which a sample takes ``limit`` operations at most.

    Raises:
        OptionError: no caps are low enough; the message says what else to change, which has been tried. Or the worst
            case of the package is unknown.
        ProblemError: the problem is stated wrongly.
    """
    model = linearize(classify(ocp), options)
    sizes = lower(model, name).description.sizes
    high = highest = max((sizes[cap] for cap in CAPS if cap in sizes), default=1)
    try:
        if (worst := _worst(model, high, name)) <= limit:
            return Fit(options, high, worst)
        if (least := _worst(model, 1, name)) > limit:
            raise OptionError(_refusal(ocp, options, model.parts, limit, least, name))
    except OptionError as error:
        raise OptionError(f"--max-operations {limit}: {error}") from error
    low, found = 1, least
    while high - low > 1:
        middle = (low + high) // 2
        worst = _worst(model, middle, name)
        low, high, found = (middle, high, worst) if worst <= limit else (low, middle, found)
    reasons = () if model.choice is None else model.choice.reasons
    return Fit(_given(model, options, low), low, found, reasons, _warning(model.parts, low, highest))


def _warning(parts: Parts, most: int, highest: int) -> str:
    """The default caps are up to CAUTION times what closed loops need."""
    if CAUTION * most >= highest:
        return ""
    repair = "; --set algorithm.repair=0 allows larger ones" if getattr(parts.algorithm, "repair", 0) else ""
    what = f"caps of {most} instead of {highest} may end samples with ITERATION_LIMIT"
    return f"{what}: simulate the loop with disturbances, or take a larger limit{repair}"


def _worst(model: Model, most: int, name: str | None) -> int:
    """Worst case of a sample with these caps, in portable C if the target computes several nodes at once."""
    options = model.options if model.target.lanes == 1 else replace(model.options, target=PORTABLE.name)
    return worst_case(render(lower(replace(model, parts=_capped(model, most), options=options), name)))["sample"]


def _capped(model: Model, most: int) -> Parts:
    """The components with these caps."""
    capped: dict[str, Any] = {part.seam: part.capped(most, model.dims) for part in model.parts.components}
    return Parts(**capped)


def _given(model: Model, options: Options, most: int) -> Options:
    """The options of the user with these caps; a QP solver that was chosen is stated with its condensing."""
    capped = _capped(model, most)
    stated: Any = options.algorithm
    algorithm = replace(stated, **_changes(model.parts.algorithm, capped.algorithm))
    if capped.qp is None:
        return replace(options, algorithm=algorithm)
    return replace(options, algorithm=algorithm, qp=capped.qp, condensing=options.condensing or capped.condensing)


def _changes(old: Any, new: Any) -> dict[str, Any]:
    """The options in which two components of a kind differ."""
    values = ((f.name, getattr(old, f.name), getattr(new, f.name)) for f in fields(new))
    return {name: value for name, before, value in values if value != before}


def _refusal(ocp: OCP, options: Options, parts: Parts, limit: int, least: int, name: str | None) -> str:
    """Why no caps are low enough, and which options make it fit."""
    what = f"{name or ocp.name} takes {least:,} operations of a sample at most even if every cap on iterations is 1"
    flags: list[str] = []
    for flag, changed in _remedied(options, parts):
        flags.append(flag)
        options = changed
        least = _worst(linearize(classify(ocp), options), 1, name)
        if least <= limit:
            return f"{what}; try {' '.join(flags)}"
    with_flags = f"; {least:,} with {' '.join(flags)}" if flags else ""
    return f"{what}{with_flags}; try fewer intervals, fewer rows or another qp"


def _remedied(options: Options, parts: Parts) -> Iterator[tuple[str, Options]]:
    """Flag by flag, the options with all remedies so far that change the components of the package."""
    for flag, seam, name, value in REMEDIES:
        chosen = getattr(parts, seam)
        if chosen is not None and getattr(chosen, name, value) != value:
            stated: Any = getattr(options, seam) or chosen
            options = replace(options, **{seam: replace(stated, **{name: value})})
            yield flag, options
