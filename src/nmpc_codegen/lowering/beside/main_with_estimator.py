"""A controller and its estimator share a folder with one main.c that runs both."""

from __future__ import annotations

import re
from collections.abc import Mapping

from nmpc_codegen.errors import OptionError
from nmpc_codegen.ir.printing.c_style import unit_style
from nmpc_codegen.lowering.render import tidy
from nmpc_codegen.lowering.templates import environment
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.seal import seal_beside, without_seal
from nmpc_codegen.package.signals import c_constants
from nmpc_codegen.package.sources import Sources

#: The optimisation level, which is that of the certificate.
_LEVEL = re.compile(r" -O\w ")
#: The text before the example in CMakeLists.txt, and before the library.
_EXAMPLE, _LIBRARY = "\n# The example", "option("


def with_estimator(controller: Mapping[str, str], ours: PackageDescription, estimator: Sources) -> dict[str, str]:
    """Return the files of the estimator, and those of the controller that change: main.c, CMakeLists.txt.

    Raises:
        OptionError: machines, precisions or plants of the two differ.
    """
    theirs = estimator.description
    _check(ours, theirs)
    own = {path: estimator[path] for path in (f"{theirs.name}.{ending}" for ending in ("h", "c", "json"))}
    files = {"main.c": _main(ours, theirs), "CMakeLists.txt": _lists(controller, estimator)}
    return {**own, **seal_beside(files, controller)}


def _check(ours: PackageDescription, theirs: PackageDescription) -> None:
    """Raise OptionError unless the estimator serves this controller."""
    assert theirs.estimation is not None
    for word in ("target", "precision"):
        if getattr(ours, word) != getattr(theirs, word):
            raise OptionError(f"{word}: {ours.name} has {getattr(ours, word)}, {theirs.name} {getattr(theirs, word)}")
    if theirs.names.states[: len(ours.names.states)] != ours.names.states:
        raise OptionError(f"{theirs.name} estimates {theirs.names.states}; expected the states {ours.names.states}")


def _main(ours: PackageDescription, theirs: PackageDescription) -> str:
    """Return the main.c that runs both."""
    assert theirs.estimation is not None
    p, q = ours.name, theirs.name
    style, found = unit_style(ours.precision), []
    places = c_constants(theirs.names.states)
    constants = dict(zip((s.name for s in ours.parameters), ours.parameter_constants, strict=True))
    for signal in (s for s in ours.parameters if s.name in theirs.estimation.unknown):
        if ours.online["parameter"] != "fixed":
            call = f"{p}_set_parameter(&controller, {p.upper()}_PARAM_{constants[signal.name]}, {p.upper()}_ALL"
            first = places[theirs.names.states.index(signal.elements[0])]
            found.append(f"(void){call}, &xhat[{q.upper()}_X_{first}]);")
    names = {
        "p": p,
        "q": q,
        "P": p.upper(),
        "Q": q.upper(),
        "found": found,
        "noise": ", ".join(style.literal(v) for v in theirs.estimation.noise_std),
        "initial": ", ".join(style.literal(v) for s in theirs.states for v in s.value),
    }
    return tidy(environment().get_template("package/main_with_estimator.c.jinja").render(names))


def _lists(controller: Mapping[str, str], estimator: Sources) -> str:
    """Return the CMakeLists.txt with both libraries, and the example that is linked with both."""
    ours, theirs = (without_seal(files["CMakeLists.txt"]) for files in (controller, estimator))
    level = _LEVEL.findall(ours)
    theirs = _LEVEL.sub(level[0] if level else " -O2 ", theirs)
    head, example, rest = ours.partition(_EXAMPLE)
    library = theirs[theirs.index(_LIBRARY) :].partition(_EXAMPLE)[0]
    name = estimator.description.name
    return f"{head}\n{library}{example}{rest}".replace("_main PRIVATE ", f"_main PRIVATE {name}::{name} ")
