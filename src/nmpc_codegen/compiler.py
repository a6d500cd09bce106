"""The compiler on one screen.

    OCP --analyse--> Problem --linearize--> Linearization --lower--> CModule --render--> Sources --build--> Controller
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

from nmpc_codegen.analyse import analyse
from nmpc_codegen.build import load
from nmpc_codegen.controller import Controller
from nmpc_codegen.errors import OptionError
from nmpc_codegen.linearize import linearize
from nmpc_codegen.lower import lower
from nmpc_codegen.ocp import OCP
from nmpc_codegen.options import Options
from nmpc_codegen.render import Sources, render


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
    problem = analyse(ocp)
    linearization = linearize(problem, options or Options())
    module = lower(linearization, name)
    return render(module)


def export(ocp: OCP, options: Options | None = None, directory: str | Path = ".", name: str | None = None) -> Package:
    """Write the C package of the problem into a folder, which is created if needed.

    Raises:
        ProblemError, OptionError: see generate().
    """
    sources = generate(ocp, options, name)
    folder = Path(directory).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in sources.items():
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
