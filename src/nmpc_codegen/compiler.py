"""The compiler fits on one screen.

    OCP --classify--> Problem --complete--> CompleteProblem --decide--> Choices --linearize--> Model
    (user, mutable)  (what is stated)      (what follows from it)      (components, reasons)  (functions, counts)

    Model --lower--> CModule --assemble, run--> items --render--> Sources --build--> Controller
                    (C names)                  (the translation unit)  (path -> text)  (NumPy views)

Every stage is a pure function from frozen values to a frozen value. No stage after decide() reads the options of the
user, and linearize() reuses the functions that decide() has counted. Only OCP and Controller, at the ends, are mutable.
CasADi is used up to linearize, cffi only in build. The worst case of a sample follows from the text of Sources and is
computed on request (analysis/). explain() adds warnings and the program for diagnose() to a CModule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, overload

from nmpc_codegen.decisions.decide import decide
from nmpc_codegen.errors import OptionError, warn
from nmpc_codegen.exclusive import COMPILING
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.completion.complete import complete
from nmpc_codegen.frontend.estimator.declaration import Estimator
from nmpc_codegen.frontend.estimator.window import estimation_problem
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.beside.dumps import obsolete_dumps, with_dumps
from nmpc_codegen.lowering.beside.folder import write
from nmpc_codegen.lowering.beside.main_with_estimator import with_estimator
from nmpc_codegen.lowering.explain import explain
from nmpc_codegen.lowering.linearize import Model, linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import render
from nmpc_codegen.lowering.unit.assemble import assemble, constants_of
from nmpc_codegen.lowering.unit.pipeline import run
from nmpc_codegen.options import Options, common_options, for_estimator
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.batch.choose import check_request, make
from nmpc_codegen.runtime.batch.many import Batch
from nmpc_codegen.runtime.build import load_any
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.estimation.observer import Observer


@dataclass(frozen=True)
class Package:
    """The folder that export() has written.

    Attributes:
        directory: absolute path of the folder.
        name: name of the package, which is the prefix of every C name.
        files: absolute paths of the files.
        report: ram_bytes, ram_bytes_by_struct, operations per function, choices (with reasons), warnings, looped
            routines.
    """

    directory: Path
    name: str
    files: tuple[Path, ...]
    report: Mapping[str, Any]


def compile(ocp: OCP | Estimator, options: Options | None = None, name: str | None = None) -> Sources:
    """Return the files of the C package: OCP -> Problem -> Choices -> Model -> CModule -> items -> Sources.

    It raises the same errors as generate().
    """
    with COMPILING:
        model = model_of(*read(ocp, options))
        module = explain(lower(model, name), model)
        return text_of(module)


def read(ocp: OCP | Estimator, options: Options | None) -> tuple[Problem, Options]:
    """Return the stated problem, and the options for it."""
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    asked = options or Options()
    if isinstance(ocp, Estimator):
        return estimation_problem(ocp), for_estimator(asked, ocp.kind)
    return classify(ocp, asked.algorithm.sampling_time), asked


def model_of(stated: Problem, options: Options) -> Model:
    """Complete the problem, choose components, and return the functions of its package."""
    problem = complete(stated, options)
    choices = decide(problem, options)
    return linearize(problem, choices)


def text_of(module: CModule) -> Sources:
    """Return the files of a CModule; a whole package keeps all items."""
    items = assemble(module)
    unit = items if module.whole else run(items, constants_of(module))
    return render(module, unit)


def generate(ocp: OCP | Estimator, options: Options | None = None, name: str | None = None) -> Sources:
    """Generate the text of the C package.

    Args:
        ocp: the problem, or an estimator.
        options: as in build().
        name: prefix of the C names; by default that of the problem.

    Returns:
        {path: text} of every file of the package, an immutable mapping.

    generate(), export() and build() issue a ProblemWarning for anything that is likely to give poor results: an
    unstable integrator, lost digits, derivatives that are not finite at the first plan, a control without influence
    there.

    Raises:
        ProblemError: the problem is stated wrongly.
        OptionError: options clash, or a component does not support the problem.

    Examples:
        >>> generate(ocp)["tank.h"].splitlines()[0]
        '/* tank: nonlinear model predictive controller, double precision.'
    """
    sources = compile(ocp, options, name)
    _warn(sources.description)
    return sources


def _warn(description: PackageDescription) -> None:
    """Issue the warnings of the compiler as Python warnings."""
    for text in description.report.warnings:
        warn(f"{description.name}: {text}")


def export(
    ocp: OCP | Estimator,
    options: Options | None = None,
    directory: str | Path = ".",
    name: str | None = None,
    *,
    estimator: Estimator | None = None,
    allow_foreign: bool = False,
    force: bool = False,
    dumps: int | None = None,
    more: Callable[[Mapping[str, str]], Mapping[str, str]] | None = None,
) -> Package:
    """Write the C package of the problem into a folder, which is created if needed.

    Files that export() wrote and that have not been edited since are replaced; the checksum line at the end of a file
    identifies it. Exporting again is therefore safe, and several packages can share a folder; its main.c,
    CMakeLists.txt and README.md then belong to the last export. An edited main.c is kept, with a warning. Any other
    file that is edited, read-only or of other origin is refused. Links, folders and devices with the name of a file are
    never replaced or followed; ``directory`` itself may be a link to a folder. If the disk is full, the folder stays
    unchanged.

    Args:
        ocp: the problem, or an estimator.
        options: as in build().
        directory: the folder.
        name: prefix of the C names, and name of the files; by default that of the problem.
        estimator: an estimator of the same plant; its package is written beside the controller's, for the same machine
            and precision, and main.c runs both.
        allow_foreign: True: code of another generator (OSQP) may be written, to a subfolder.
        force: True: also replace refused files, and keep copies (.bak).
        dumps: number of samples that a further header, <name>_dumps.h, records for replay(); None: no such header.
        more: function that is called with the files before any is written; it returns further files with their seals
            (package.seal), or raises an error to refuse all.

    Raises:
        ProblemError, OptionError: see generate(); OptionError also for foreign code that is not allowed.
        ExportError: a file must not be replaced, and nothing is written; or a file cannot be written.

    Examples:
        >>> package = export(ocp, directory="out/tank")
        >>> sorted(path.name for path in package.files)
        ['CMakeLists.txt', 'README.md', 'main.c', 'tank.c', 'tank.h', 'tank.json']
    """
    sources = compile(ocp, options, name)
    if sources.foreign and not allow_foreign:
        raise OptionError(
            f"qp {sources.foreign[0]!r} adds foreign code with globals, which export() refuses; "
            "choose another solver, or export(..., allow_foreign=True) (--allow-foreign)"
        )
    _warn(sources.description)
    files = dict(sources)
    if dumps is not None:
        files |= with_dumps(sources, sources.description, dumps)
    if more is not None:
        files |= more(files)
    files |= {} if estimator is None else _files_beside(files, sources.description, estimator, options)
    description = sources.description
    obsolete = {} if dumps is not None else obsolete_dumps(description.name)
    folder = write(directory, files, force=force, obsolete=obsolete)
    return Package(folder, description.name, tuple(folder / path for path in files), description.report.as_dict())


def _files_beside(
    files: Mapping[str, str], description: PackageDescription, estimator: Estimator, options: Options | None
) -> Mapping[str, str]:
    """Return the files of an estimator, and the files of the controller that it changes."""
    found = compile(estimator, common_options(options))
    _warn(found.description)
    return with_estimator(files, description, found)


@overload
def build(ocp: OCP, options: Options | None = None, profile: str = "fast", name: str | None = None) -> Controller: ...


@overload
def build(
    ocp: Estimator, options: Options | None = None, profile: str = "fast", name: str | None = None
) -> Observer: ...


def build(
    ocp: OCP | Estimator, options: Options | None = None, profile: str = "fast", name: str | None = None
) -> Controller | Observer:
    """Generate, compile and load the code that export() writes, as a Python controller; builds are cached by content.

    Args:
        ocp: the problem, or an estimator; it may be changed and built again.
        options: Options(...); options that are not given are chosen, and ``controller.description.report.choices`` has
            the reasons. Options(target="native") also writes the C text for the vector registers of this machine.
        profile: flags of the compiler besides those of the target: "fast" uses all instructions of this processor
            (-march=native, unless CC names others); "verify" uses neither these nor contraction of a * b + c, so that
            with math="own" every machine computes the same bits; "test" compiles quickly.
        name: prefix of the C names; by default that of the problem.

    Returns:
        The controller, or for an estimator the Observer, ready to step(); see help(Controller), help(Observer).

    Raises:
        ProblemError, OptionError: see generate().
        BuildError: there is no compiler, it rejected the code, or this machine does not run the target.

    Examples:
        >>> controller = build(ocp)
        >>> controller.step([0.3]).shape, controller.status.name
        ((1,), 'OK')
        >>> observer = build(ocp.estimator(N=10, measure={"h": ocp.x}, noise_std={"h": 0.01}))
    """
    sources = compile(ocp, options, name)
    _warn(sources.description)
    return load_any(sources, sources.description.name, profile)


def batch(
    ocp_or_controller: OCP | Controller,
    number: int,
    options: Options | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    threads: int | None = None,
) -> Batch:
    """Create many controllers of one package in one block of memory, whose calls all cores share; see help(Batch).

    Args:
        ocp_or_controller: a problem, which is built with ``options``; or a controller, which is copied.
        number: number of controllers, M >= 1.
        options: options for a problem.
        device: "cpu", or "cuda" for the current GPU of CuPy (extra [cuda]), whose calls take and return arrays on the
            GPU.
        threads: 1 or more; None: one for each core that this process may use. Results do not depend on it.

    Raises:
        OptionError: options are given for a controller, which is already built.
        ControllerError: a number is wrong. Further errors are those of build().
        ExtraError: CuPy is not installed.

    Examples:
        >>> many = batch(ocp, 100)
        >>> controls, statuses = many.step(np.linspace(0.1, 1.0, 100)[:, None])
        >>> controls.shape, len(statuses)
        ((100, 1), 100)
    """
    found = ocp_or_controller
    if options is not None and not isinstance(found, OCP):
        raise OptionError("batch(): options belong to a problem; a controller has been built with its own")
    check_request(number, device, threads)
    return make(build(found, options) if isinstance(found, OCP) else found, number, device, threads)
