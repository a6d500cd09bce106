"""A Python file states the problem and the options."""

from __future__ import annotations

import inspect
import sys
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.frontend.estimator.declaration import Estimator
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.options import Options

#: Name of the module as which a problem file runs.
MODULE = "nmpc_problem"


class FoundProblem(NamedTuple):
    """A problem file states a problem, its options, and further objects.

    These are the outputs of --derivatives, an estimator or None, and arguments of campaign().
    """

    ocp: OCP
    options: Options
    outputs: Any
    estimator: Estimator | None
    campaign: Mapping[str, Any]


def load_problem(path: Path) -> FoundProblem:
    """Run a problem file and return what it states.

    The problem is the result of ``problem()``, else ``ocp``, else the result of ``build_ocp()``, else the only OCP in
    the file. The options are those that ``problem()`` returns, else ``options`` or the result of ``options()``, else
    the defaults. The outputs of the impulse response for --derivatives are ``outputs`` or None. The estimator is
    ``estimator``, else the result of ``build_estimator()`` or ``build_estimator(ocp)``, else None. The arguments of
    campaign() are the dictionary ``campaign``, or the result of a function with that name.

    Raises:
        ProblemError: the file does not exist, or contains no problem, or several problems of which none is called
            ``ocp``.
        BaseException: any exception that the file raises.
    """
    if not path.is_file():
        found = "it is a folder" if path.is_dir() else "there is no such file"
        raise ProblemError(f"{path}: {found}; expected a Python file that states a problem")
    module = types.ModuleType(MODULE)
    module.__file__ = str(path.absolute())
    search, before = sys.path, sys.path[:]
    sys.path.insert(0, str(path.resolve().parent))
    sys.modules[MODULE] = module
    try:
        exec(compile(path.read_bytes(), module.__file__, "exec"), module.__dict__)
        ocp, options = _find_statement(module.__dict__, path)
        names = module.__dict__
        estimator, campaign = _find_estimator(names, ocp, path), _find_campaign(names, path)
        return FoundProblem(ocp, options, names.get("outputs"), estimator, campaign)
    finally:
        sys.modules.pop(MODULE, None)
        sys.path = search
        search[:] = before


def _find_statement(names: Mapping[str, Any], path: Path) -> tuple[OCP, Options]:
    """Return the problem and the options that the file states."""
    found = _problem(names, path)
    ocp, given = found if isinstance(found, tuple) else (found, names.get("options"))
    if callable(given):
        given = _call("options", given, path)
    if given is None:
        return ocp, Options()
    if not isinstance(given, Options):
        raise ProblemError(
            f"{path}: options is a {type(given).__name__}; expected Options(...), or a function that returns them"
        )
    return ocp, given


def _problem(names: Mapping[str, Any], path: Path) -> Any:
    """Return an OCP, or the pair (OCP, Options) that problem() returns."""
    if callable(names.get("problem")):
        return _check_ocp("problem", _call("problem", names["problem"], path), path)
    if "ocp" in names:
        if not isinstance(names["ocp"], OCP):
            raise ProblemError(f"{path}: ocp is a {type(names['ocp']).__name__}; expected OCP")
        return names["ocp"]
    if callable(names.get("build_ocp")):
        return _check_ocp("build_ocp", _call("build_ocp", names["build_ocp"], path), path)
    several = {name: value for name, value in names.items() if isinstance(value, OCP)}
    if len({id(value) for value in several.values()}) == 1:
        return next(iter(several.values()))
    if several:
        raise ProblemError(f"{path} defines several problems ({', '.join(several)}); call the one to export `ocp`")
    raise ProblemError(
        f"{path} defines no problem: expected an OCP called `ocp`, or a function problem() or build_ocp() that "
        "returns one"
    )


def _find_estimator(names: Mapping[str, Any], ocp: OCP, path: Path) -> Estimator | None:
    """Return the estimator of the problem, if the file states one."""
    found = names.get("estimator", names.get("build_estimator"))
    if found is None:
        return None
    if callable(found):
        takes = [p for p in inspect.signature(found).parameters.values() if p.default is p.empty]
        found = found(ocp) if len(takes) == 1 else _call("build_estimator", found, path)
    if not isinstance(found, Estimator):
        raise ProblemError(f"{path}: estimator is a {type(found).__name__}; expected ocp.estimator(...)")
    return found


def _find_campaign(names: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    """Return the arguments of campaign(), if the file states some."""
    found = names.get("campaign", {})
    if found is getattr(sys.modules.get("nmpc_codegen.campaigns"), "campaign", None):  # it was imported
        return {}
    found = _call("campaign", found, path) if callable(found) else found
    if not isinstance(found, Mapping):
        raise ProblemError(f"{path}: campaign is a {type(found).__name__}; expected a dictionary of its arguments")
    return found


def _call(name: str, function: Any, path: Path) -> Any:
    """Call a function of the file, which must not require arguments."""
    try:
        inspect.signature(function).bind()
    except TypeError as error:
        raise ProblemError(f"{path}: {name}() cannot be called without arguments: {error}") from None
    except ValueError:  # a callable without a signature
        pass
    return function()


def _check_ocp(name: str, result: Any, path: Path) -> Any:
    first = result[0] if isinstance(result, tuple) and len(result) == 2 else result
    if not isinstance(first, OCP):
        raise ProblemError(f"{path}: {name}() returns {type(result).__name__}; expected OCP or (OCP, Options)")
    return result
