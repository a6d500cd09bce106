"""The compiler on one screen.

    OCP --classify--> Problem --linearize--> Linearization --lower--> CModule --render--> Sources --build--> Controller
    (user, mutable)  (frozen: what)         (frozen: which functions) (frozen: C nouns)  (path -> text)   (NumPy views)

Every stage is a pure function from frozen values to a frozen value; only OCP (before) and Controller (after) mutate.
CasADi ends in linearize, jinja2 lives in render, cffi in build.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import Sources, render
from nmpc_codegen.options import Options
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.controller import Controller


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
    if options is not None and not isinstance(options, Options):
        raise OptionError(f"options: {options!r}; expected Options(...) or None")
    problem = classify(ocp)
    linearization = linearize(problem, options or Options())
    module = lower(linearization, name)
    sources = render(module)
    for component in linearization.options.components:
        if component.name in module.foreign:
            sizes = module.value("NV"), module.value("NG")
            sources |= component.foreign_sources(module.name, module.precision, *sizes)  # type: ignore[attr-defined]
    return sources


def export(
    ocp: OCP,
    options: Options | None = None,
    directory: str | Path = ".",
    name: str | None = None,
    *,
    allow_foreign: bool = False,
) -> Package:
    """Write the C package of the problem into a folder, which is created if needed.

    ``allow_foreign``: code of another generator (OSQP) may stand in a folder of its own beside the package's files.

    Raises:
        ProblemError, OptionError: see generate(); foreign code that is not allowed.
    """
    sources = generate(ocp, options, name)
    foreign = sorted({path.split("/")[0] for path in sources if "/" in path})
    if foreign and not allow_foreign:
        raise OptionError(
            f"qp {foreign[0]!r} brings foreign code with globals, which export() refuses; "
            "choose another solver, or export(..., allow_foreign=True)"
        )
    folder = Path(directory).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in sources.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    prefix = name or ocp.name
    report = json.loads(sources[f"{prefix}.json"])["report"]
    return Package(folder, prefix, tuple(folder / path for path in sources), report)


def build(
    ocp: OCP, options: Options | None = None, profile: str = "fast", lanes: int | None = None, name: str | None = None
) -> Controller:
    """Generate, compile and load: the same code as export(), as a Python controller, cached by content.

    Raises:
        ProblemError, OptionError: see generate().
        BuildError: no compiler, or it refused the code.
    """
    sources = generate(ocp, options, name)
    return load(sources, name or ocp.name, profile, lanes=lanes)
