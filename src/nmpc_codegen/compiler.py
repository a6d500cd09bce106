"""The compiler on one screen.

    OCP --classify--> Problem --linearize--> Model --lower--> CModule --render--> Sources --build--> Controller
    (user, mutable)  (frozen: what)  (frozen: functions, counts)  (frozen: C nouns)  (path -> text)  (NumPy views)

Every stage is a pure function from frozen values to a frozen value; only OCP (before) and Controller (after) mutate.
CasADi ends in linearize, jinja2 lives in render, cffi in build.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import Sources, render
from nmpc_codegen.options import Options
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.folder import write
from nmpc_codegen.runtime.seal import sealed


@dataclass(frozen=True)
class Package:
    """An exported folder: absolute paths of its files, and the compiler's report.

    report: ram_bytes, ram_bytes_by_struct, operations per function, choices (what was chosen and why), looped.
    """

    directory: Path
    name: str
    files: tuple[Path, ...]
    report: Mapping[str, Any]


def generate(ocp: OCP, options: Options | None = None, name: str | None = None) -> Sources:
    """The whole pipeline up to text: path -> contents of every file of the package.

    Raises:
        ProblemError: the problem is stated wrongly.
        OptionError: options clash, or a component does not support the problem.
    """
    module = compiled(ocp, options, name)
    return sealed(render(module), module.name)


def compiled(ocp: OCP, options: Options | None = None, name: str | None = None) -> CModule:
    """The pipeline up to the last value before text. Raises as generate() does."""
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    return lower(linearize(classify(ocp), options or Options()), name)


def export(
    ocp: OCP,
    options: Options | None = None,
    directory: str | Path = ".",
    name: str | None = None,
    *,
    allow_foreign: bool = False,
    force: bool = False,
) -> Package:
    """Write the C package of the problem into a folder, which is created if needed: all files of it, or none.

    Files that export() wrote and nobody has edited are replaced (the seal at their end tells), so that exporting again
    is safe, and so are several packages in one folder: main.c, CMakeLists.txt and README.md are those of the last one.
    A file that is somebody else's, has been edited or is read-only is replaced only with ``force=True``. Links, folders
    and devices in the place of a file are never replaced or followed; ``directory`` itself may be a link to a folder.

    ``allow_foreign``: code of another generator (OSQP) may stand in a folder of its own beside the package's files.

    Raises:
        ProblemError, OptionError: see generate(); foreign code that is not allowed.
        ExportError: a file must not be replaced, or the system refuses to write; the folder is as before.
    """
    module = compiled(ocp, options, name)
    foreign = module.folders
    if foreign and not allow_foreign:
        raise OptionError(
            f"qp {foreign[0]!r} brings foreign code with globals, which export() refuses; "
            "choose another solver, or export(..., allow_foreign=True) (--allow-foreign)"
        )
    sources = sealed(render(module), module.name)
    folder = write(directory, sources, force=force)
    files = tuple(folder / path for path in sources)
    return Package(folder, module.name, files, module.description.report.as_dict())


def build(
    ocp: OCP, options: Options | None = None, profile: str = "fast", lanes: int | None = None, name: str | None = None
) -> Controller:
    """Generate, compile and load: the same code as export(), as a Python controller, cached by content.

    Raises:
        ProblemError, OptionError: see generate().
        BuildError: no compiler, or it refused the code.
    """
    sources = generate(ocp, options, name)
    return load(sources, ocp.name if name is None else name, profile, lanes=lanes)
