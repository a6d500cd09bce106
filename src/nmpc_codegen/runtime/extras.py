"""Packages that only some functions need are imported at their first use.

The error names the extra that brings them.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from nmpc_codegen.errors import ExtraError

#: True if the whole distribution is installed, false if only the part that runs exported packages.
HAS_COMPILER = find_spec("nmpc_codegen.compiler") is not None
DISTRIBUTION = "nmpc-codegen" if HAS_COMPILER else "nmpc-codegen-runtime"

#: Package -> extra of this distribution that installs it.
EXTRAS = {
    "matplotlib": "plot",
    "pandas": "notebook",
    "xarray": "notebook",
    "cvxpy": "economic",
    "clarabel": "economic",
    "cupy": "cuda",
    "nvidia": "cuda",
    "pyarrow": "campaign" if HAS_COMPILER else "notebook",
    "optuna": "campaign",
}


def extra(module: str, user: str) -> Any:
    """Import a module, or a submodule of a package of EXTRAS.

    Raises:
        ExtraError: the package is not installed; ``user`` is the function that needs it.
    """
    package = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name not in (package, module):
            raise
        raise ExtraError(
            f"{user} needs the package {package}: pip install '{DISTRIBUTION}[{EXTRAS[package]}]'"
        ) from error
