"""The command writes digests of everything that samples and examples export: python -m verification.digests FILE.

The file of a commit is compared with that of another one: a change that means to change no text changes none of them.
"""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path

import examples
from examples import crane
from nmpc_codegen import Options, ProblemWarning, derivatives, generate
from verification.samples import IMPLICIT, IN_LANES, LOOPED, SAMPLES


def digests() -> Iterator[str]:
    """Yield SHA-256 and name of every file that the samples, the examples and derivatives of the crane export."""
    modules = [importlib.import_module(f"examples.{found.name}") for found in pkgutil.iter_modules(examples.__path__)]
    stated = [(m.__name__, m.build_ocp, getattr(m, "options", Options)()) for m in modules if hasattr(m, "build_ocp")]
    stated += [(sample.name, sample.make, sample.options) for sample in (*SAMPLES, *IN_LANES)]
    packages: dict[str, Mapping[str, str]] = {name: generate(make(), options) for name, make, options in stated}
    for integrator in (LOOPED, IMPLICIT):
        name = f"derivatives, {integrator.name}"
        packages[name] = derivatives.generate(crane.build_ocp(), None, Options(integrator), second_order=True)
    for name, files in packages.items():
        yield from (f"{hashlib.sha256(text.encode()).hexdigest()}  {name}: {path}" for path, text in files.items())


if __name__ == "__main__":
    warnings.simplefilter("ignore", ProblemWarning)
    Path(sys.argv[1]).write_text("\n".join([*digests(), ""]), encoding="utf-8")
