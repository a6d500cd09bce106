"""The compiler on one screen.

    OCP --classify--> Problem --linearize--> Model --lower--> CModule --render--> Sources --build--> Controller
    (user, mutable)  (frozen: what)  (frozen: functions, counts)  (frozen: C names)  (path -> text)  (NumPy views)

settled() lowers the model, derives the worst case of a sample from the text of its functions and, where QP solvers are
close, decides between them by it. Every stage is a pure function from frozen values to a frozen value; only OCP and
Controller, at the ends, are mutable.
CasADi is used up to linearize, jinja2 only in render, and cffi only in build.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nmpc_codegen.bounds.package import settled
from nmpc_codegen.errors import OptionError, warn
from nmpc_codegen.exclusive import COMPILING
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.host.unit import host_unit
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.render import Sources, render
from nmpc_codegen.options import GOALS, Options
from nmpc_codegen.runtime.build import host, load
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.folder import write
from nmpc_codegen.runtime.seal import sealed, sealed_beside


@dataclass(frozen=True)
class Package:
    """An exported folder, the absolute paths of its files, and the compiler's report.

    report: ram_bytes, ram_bytes_by_struct, operations per function, choices (with reasons), warnings, looped routines.
    """

    directory: Path
    name: str
    files: tuple[Path, ...]
    report: Mapping[str, Any]


def generate(ocp: OCP, options: Options | None = None, name: str | None = None) -> Sources:
    """Run the pipeline up to text; return path -> contents of every file of the package.

    A ProblemWarning says what is likely to give poor results, here and in export() and build(): an unstable integrator,
    lost digits, derivatives that are not finite at the first plan, a control without influence there.

    Raises:
        ProblemError: the problem is stated wrongly.
        OptionError: options clash, or a component does not support the problem.
    """
    module, sources = _rendered(ocp, options, name)
    _warn(module)
    return sources


def _rendered(ocp: OCP, options: Options | None, name: str | None) -> tuple[CModule, Sources]:
    """The last value before text, and the sealed text."""
    with COMPILING:
        module = compiled(ocp, options, name)
        return module, sealed(render(module), module.name)


def _warn(module: CModule) -> None:
    """Issue what the compiler warns of as Python warnings."""
    for text in module.description.report.warnings:
        warn(f"{module.name}: {text}")


def for_every_goal(ocp: OCP, options: Options, name: str | None = None) -> dict[str, Sources]:
    """Goal -> the files of the package with this goal, for a processor without a vector unit."""
    return {goal: _rendered(ocp, replace(options, goal=goal, processor="scalar"), name)[1] for goal in GOALS}


def compiled(ocp: OCP, options: Options | None = None, name: str | None = None) -> CModule:
    """Run the pipeline up to the CModule, the last value before text. It raises the errors of generate()."""
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    with COMPILING:
        return settled(linearize(stated(ocp, options), options or Options()), name)


def stated(ocp: OCP, options: Options | None = None) -> Problem:
    """The problem of the OCP, with the terminal cost of lqr_terminal_cost(), which depends on the integrator.

    Raises:
        ProblemError: the problem is stated wrongly, or that terminal cost does not exist.
    """
    problem = classify(ocp)
    if problem.terminal_lqr is None:
        return problem
    # SciPy is loaded only for those who need it.
    from nmpc_codegen.economic.terminal import with_terminal_cost

    return with_terminal_cost(problem, options)


def export(
    ocp: OCP,
    options: Options | None = None,
    directory: str | Path = ".",
    name: str | None = None,
    *,
    allow_foreign: bool = False,
    force: bool = False,
    more: Callable[[Sources], Sources] | None = None,
) -> Package:
    """Write the C package of the problem into a folder, which is created if needed.

    Files that export() wrote and that have not been edited since are replaced; the seal at their end identifies them.
    So exporting again is safe, and several packages can share a folder: its main.c, CMakeLists.txt and README.md are
    those of the last export. A main.c that you have edited stays, and a warning says so. Any other file that is edited,
    read-only or of other origin is replaced only with ``force=True``, which keeps copies (.bak). Links, folders and
    devices in the place of a file are never replaced or followed; ``directory`` itself may be a link to a folder.

    ``more``: called with the files before any is written; it returns further ones, or raises an error to refuse all.

    ``allow_foreign``: code of another generator (OSQP) may be written, to a folder of its own beside the files.

    Raises:
        ProblemError, OptionError: see generate(); OptionError also for foreign code that is not allowed.
        ExportError: a file must not be replaced, and nothing is written; or a file cannot be written.
    """
    module = compiled(ocp, options, name)
    foreign = module.folders
    if foreign and not allow_foreign:
        raise OptionError(
            f"qp {foreign[0]!r} adds foreign code with globals, which export() refuses; "
            "choose another solver, or export(..., allow_foreign=True) (--allow-foreign)"
        )
    with COMPILING:
        sources = sealed(render(module), module.name)
    _warn(module)
    if more is not None:
        sources |= sealed_beside(more(sources), sources[f"{module.name}.c"])
    folder = write(directory, sources, force=force)
    files = tuple(folder / path for path in sources)
    return Package(folder, module.name, files, module.description.report.as_dict())


def build(
    ocp: OCP, options: Options | None = None, profile: str = "fast", lanes: int | None = None, name: str | None = None
) -> Controller:
    """Generate, compile and load the code that export() writes, as a Python controller; builds are cached by content.

    Args:
        ocp: the problem; it may be changed and built again.
        options: Options(...); what is not given is chosen, and ``controller.description.report.choices`` says why.
        profile: flags of the compiler: "fast" for this processor, "verify" without contraction of a * b + c, "test" to
            compile quickly.
        lanes: shooting nodes whose dynamics, costs and rows are evaluated at once in vector registers (1, 2, 4, 8);
            None: as many as the processor has room for if the profile is compiled for it. With 1 the code is that of
            export(); with more it is GNU C with the same header, and exp, log, sin, cos of its own: results differ by
            rounding.
        name: prefix of the C names; by default that of the problem.

    Returns:
        The controller, ready to step(); see help(Controller).

    Raises:
        ProblemError, OptionError: see generate(); OptionError also for another number of lanes.
        BuildError: there is no compiler, or it rejected the code.
    """
    target = host(lanes, profile)
    with COMPILING:
        module, sources = _rendered(ocp, options, name)
        if target.lanes > 1:
            sources[f"{module.name}_host.c"] = host_unit(module, target.lanes, target.avx512, target.tiles)
    _warn(module)
    return load(sources, module.name, profile, lanes=target.lanes)
