"""nmpc-export: from a Python file that states a problem to a folder of C99.

Exit status: 0 done; 1 the problem, the options or the check failed, the message says where; 2 wrong usage.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import runpy
import sys
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmpc_codegen.errors import NmpcError, OptionError, ProblemError

if TYPE_CHECKING:
    from rich.console import Console

    from nmpc_codegen.controller import Solution
    from nmpc_codegen.ocp import OCP
    from nmpc_codegen.options import Options

#: Variation points, in the order in which --list-options shows them.
SEAMS = ("integrator", "hessian", "condensing", "qp", "algorithm")

#: --check: largest |a - b| / max(1, max|b|) of controls and states per component, and of the cost relatively.
LIMITS = {"double": {"u": 1e-6, "x": 1e-6, "cost": 1e-8}, "single": {"u": 1e-3, "x": 1e-3, "cost": 1e-4}}
CHECK_TOLERANCE = {"double": 1e-9, "single": 1e-3}
CHECK_ITERATIONS = 1000
SHOWN_FUNCTIONS = 8
COST_FLOOR = 1e-6  # a smaller cost counts as this much, or a problem that starts at its goal could not pass


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = _parser()
    try:
        arguments = parser.parse_args(argv)
        _refuse_nonsense(parser, arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    from rich.console import Console

    console, errors = Console(highlight=False), Console(stderr=True, highlight=False)
    try:
        if arguments.list_options:
            list_options(console)
            return 0
        return _run(arguments, console)
    except KeyboardInterrupt:
        errors.print("interrupted", style="red")
        return 1
    except (Exception, SystemExit) as error:
        if arguments.verbose:
            traceback.print_exc()
        errors.print(_message(error, arguments.problem), style="red", markup=False, soft_wrap=True)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nmpc-export",
        description="Write a self-contained C99 package that solves the optimal control problem of a Python file.",
        epilog="The file defines `ocp` (and optionally `options`), or a function problem() that returns them.",
    )
    add = parser.add_argument
    add("problem", nargs="?", metavar="problem.py", help="file that states the problem")
    add("-o", "--output", metavar="DIR", help="folder to write (default: out/<name>)")
    add("--name", help="name of the package, prefix of every C name (default: the problem's)")
    add("--hessian", metavar="WORD", help="Hessian of the QP, see --list-options")
    add("--qp", metavar="WORD", help="QP solver, see --list-options")
    add("--allow-foreign", action="store_true", help="let OSQP's own generated code stand beside the package")
    add("--force", action="store_true", help="replace files that are not unchanged ones of an earlier export")
    add("--precision", choices=("double", "single"), help="working precision")
    add(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="settings",
        help="any option by its dotted name, e.g. integrator.steps=3; may be repeated",
    )
    add("--check", action="store_true", help="compile with warnings as errors, solve, compare with IPOPT")
    add("--simulate", type=int, metavar="STEPS", help="closed loop from the declared initial state")
    add("--plot", metavar="FILE", help="picture of the simulation (.png, .pdf, .svg)")
    add("--list-options", action="store_true", help="print every component with its options, and exit")
    add("-v", "--verbose", action="store_true", help="the whole report; tracebacks")
    return parser


def _refuse_nonsense(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Usage errors that argparse does not see by itself; error() leaves with status 2."""
    if arguments.problem is None and not arguments.list_options:
        parser.error("the file that states the problem is missing")
    if arguments.plot is not None and arguments.simulate is None:
        parser.error("--plot needs --simulate STEPS")
    if arguments.simulate is not None and arguments.simulate < 1:
        parser.error(f"--simulate {arguments.simulate}: expected at least one step")
    for setting in arguments.settings:
        if not setting.partition("=")[0].strip() or "=" not in setting:
            parser.error(f"--set {setting}: expected KEY=VALUE, e.g. integrator.steps=3")


def _message(error: BaseException, problem: str | None) -> str:
    """One message without traceback; an error raised inside the problem's file carries its line."""
    if isinstance(error, SystemExit):
        return f"{problem} ended the program (exit status {error.code}) instead of stating a problem"
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if problem and _same(f.filename, problem)]
    place = f"{problem}, line {lines[-1]}: " if lines else ""
    if isinstance(error, SyntaxError) and error.filename and problem and _same(error.filename, problem):
        place = f"{problem}, line {error.lineno}: "
        return f"{place}{type(error).__name__}: {error.msg}"
    if isinstance(error, NmpcError):
        return f"{place}{type(error).__name__}: {error}"
    return f"{place}{type(error).__name__}: {error}" + ("" if lines else "  (-v shows where)")


def _same(a: str, b: str) -> bool:
    return Path(a).resolve() == Path(b).resolve()


# -- the problem ------------------------------------------------------------------------------------------------------


def load_problem(path: Path) -> tuple[OCP, Options]:
    """Run a problem file and take its problem and options.

    Looks for ``problem()``, then ``ocp``, then ``build_ocp()``, then for the only OCP among the file's names.

    Raises:
        ProblemError: there is no such file, or no problem in it, or several without one called ``ocp``.
    """
    from nmpc_codegen.options import Options

    if not path.is_file():
        raise ProblemError(f"{path}: there is no such file")
    sys.path.insert(0, str(path.resolve().parent))
    try:
        names = runpy.run_path(str(path))
        found = _stated(names, path)
    finally:
        sys.path.pop(0)
    ocp, given = found if isinstance(found, tuple) else (found, names.get("options"))
    if given is None:
        return ocp, Options()
    if not isinstance(given, Options):
        raise ProblemError(f"{path}: options is a {type(given).__name__}; expected Options")
    return ocp, given


def _stated(names: Mapping[str, Any], path: Path) -> Any:
    """What the file states: an OCP, or a pair (OCP, Options)."""
    from nmpc_codegen.ocp import OCP

    for function in ("problem", "build_ocp"):
        if function == "build_ocp" and isinstance(names.get("ocp"), OCP):
            break
        if callable(names.get(function)):
            result = names[function]()
            first = result[0] if isinstance(result, tuple) and len(result) == 2 else result
            if not isinstance(first, OCP):
                given = type(result).__name__
                raise ProblemError(f"{path}: {function}() returns {given}; expected OCP or (OCP, Options)")
            return result
    if "ocp" in names:
        if not isinstance(names["ocp"], OCP):
            raise ProblemError(f"{path}: ocp is a {type(names['ocp']).__name__}; expected OCP")
        return names["ocp"]
    several = {name: value for name, value in names.items() if isinstance(value, OCP)}
    if len({id(value) for value in several.values()}) == 1:
        return next(iter(several.values()))
    if several:
        raise ProblemError(f"{path} defines several problems ({', '.join(several)}); call the one to export `ocp`")
    raise ProblemError(f"{path} defines no problem: expected an OCP called `ocp`, or a function problem()")


# -- options ----------------------------------------------------------------------------------------------------------


def registry(seam: str) -> Mapping[str, Any]:
    """Components of a variation point: word -> class."""
    from nmpc_codegen.options import REGISTRIES

    return REGISTRIES[seam]


def apply_setting(options: Options, key: str, text: str) -> Options:
    """options with the dotted field ``key`` replaced; ``text`` is a Python literal, else a word.

    Raises:
        OptionError: no such field (lists those there are), or a value that the option refuses.
    """
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        value = text
    first, *rest = key.split(".")
    fields = _fields(options)
    if first not in fields:
        raise OptionError(f"there is no option {first!r}; there is {', '.join(fields)}")
    if first in SEAMS:
        part = _replaced(_part(options, first, rest[0]), rest, value, first) if rest else _component(first, value)
        return dataclasses.replace(options, **{first: part})
    changed: Options = _replaced(options, [first, *rest], value, "")
    return changed


def _component(seam: str, word: Any) -> Any:
    """A component with its default options, by its word; None leaves the choice to the compiler."""
    if word is None:
        return None
    words = registry(seam)
    known = str(word).replace("-", "_")
    if known not in words:
        raise OptionError(f"there is no {seam} {word!r}; there is {', '.join(words)}")
    return words[known]()


def _part(options: Options, seam: str, field: str) -> Any:
    """The chosen component of a seam; if none is chosen yet, the only one that has this field."""
    part = getattr(options, seam)
    if part is not None:
        return part
    candidates = {word: cls for word, cls in registry(seam).items() if field in _fields(cls)}
    if not candidates:
        there = ", ".join(name for cls in registry(seam).values() for name in _fields(cls))
        raise OptionError(f"{seam} has no option {field!r}; there is {there}")
    if len(candidates) > 1:
        raise OptionError(f"{seam}.{field}: say --set {seam}=WORD before it, with one of {', '.join(candidates)}")
    return next(iter(candidates.values()))()


def _replaced(value: Any, keys: Sequence[str], new: Any, where: str) -> Any:
    """A frozen dataclass with the field at the end of ``keys`` replaced."""
    if not keys:
        return new
    fields = _fields(value)
    if keys[0] not in fields:
        there = f"there is {', '.join(fields)}" if fields else "it has none"
        raise OptionError(f"{where or 'options'} has no option {keys[0]!r}; {there}")
    path = f"{where}.{keys[0]}" if where else keys[0]
    return dataclasses.replace(value, **{keys[0]: _replaced(getattr(value, keys[0]), keys[1:], new, path)})


def _fields(value: Any) -> list[str]:
    """Names of the options of a component or of its class."""
    return [f.name for f in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []


def list_options(console: Console) -> None:
    """Print every component of every variation point with its options and their defaults, then the other options."""
    from nmpc_codegen.options import Options

    def line(text: str, style: str = "") -> None:
        console.print(text, style=style, markup=False, soft_wrap=True)

    defaults = Options()
    for seam in SEAMS:
        chosen = getattr(defaults, seam)
        line(f"{seam}: {'chosen from the problem' if chosen is None else chosen.name} unless given", "bold")
        for word, cls in registry(seam).items():
            made = cls()
            line(f"  --set {seam}={word}    {_first_line(cls)}")
            for name in _fields(cls):
                line(f"      {seam}.{name} = {_short(getattr(made, name))}")
    for name in (n for n in _fields(defaults) if n not in SEAMS):
        value = getattr(defaults, name)
        line(name if _fields(value) else f"{name} = {value!r}", "bold")
        for inner in _fields(value):
            line(f"      {name}.{inner} = {_short(getattr(value, inner))}")


def _short(value: Any) -> str:
    """The name of a named value such as a tableau, else its repr."""
    name = getattr(value, "name", None)
    return name if isinstance(name, str) else repr(value)


def _first_line(cls: Any) -> str:
    return (cls.__doc__ or "").strip().partition("\n")[0]


# -- the work ---------------------------------------------------------------------------------------------------------


def _run(arguments: argparse.Namespace, console: Console) -> int:
    from nmpc_codegen.compiler import export
    from nmpc_codegen.package import open_package

    ocp, options = load_problem(Path(arguments.problem))
    for seam in ("hessian", "qp"):
        if getattr(arguments, seam) is not None:
            options = apply_setting(options, seam, getattr(arguments, seam))
    if arguments.precision is not None:
        options = dataclasses.replace(options, precision=arguments.precision)
    for setting in arguments.settings:
        key, _, text = setting.partition("=")
        options = apply_setting(options, key.strip(), text.strip())
    name = ocp.name if arguments.name is None else arguments.name
    folder = Path(arguments.output or Path("out") / name)
    package = export(ocp, options, str(folder), name=name, allow_foreign=arguments.allow_foreign, force=arguments.force)
    _print_package(console, folder, name, package.report, arguments.verbose)
    passed = True
    if arguments.check:
        passed = check(ocp, options, folder, name, console)
    if arguments.simulate is not None:
        from nmpc_codegen.simulate import simulate

        controller = open_package(str(folder), name=name)
        log = simulate(controller, controller.description.x_initial, arguments.simulate)
        console.print(log.summary(), markup=False, soft_wrap=True)
        if arguments.plot is not None:
            log.plot(arguments.plot)
            console.print(f"picture: {arguments.plot}", markup=False)
    return 0 if passed else 1


def _print_package(console: Console, folder: Path, name: str, report: Mapping[str, Any], verbose: bool) -> None:
    """Files with their sizes; what was chosen and why; memory; operations of the largest functions, or of all."""
    from rich.table import Table

    files = Table("file", "bytes", title=f"{name} in {folder}", title_justify="left")
    files.columns[1].justify = "right"
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        files.add_row(str(path.relative_to(folder)), f"{path.stat().st_size:,}")
    console.print(files)
    for choice in report.get("choices", ()):
        console.print(f"chosen  {choice}", markup=False, soft_wrap=True)
    if "ram_bytes" in report:
        console.print(f"memory  {report['ram_bytes']:,} bytes of solver struct, all that the code needs but its stack")
    counts = {function: sum(count.values()) for function, count in report.get("operations", {}).items()}
    largest = sorted(counts, key=lambda function: -counts[function])
    shown = largest if verbose else largest[:SHOWN_FUNCTIONS]
    if shown:
        classes = list(next(iter(report["operations"].values())))
        table = Table("operations per call", *classes, "all", title_justify="left")
        for column in table.columns[1:]:
            column.justify = "right"
        for function in shown:
            numbers = [*report["operations"][function].values(), counts[function]]
            table.add_row(function, *(f"{number:,}" for number in numbers))
        console.print(table)
    if len(shown) < len(largest):
        console.print(f"and {len(largest) - len(shown)} smaller functions (-v shows all)")


def check(ocp: OCP, options: Options, folder: Path, name: str, console: Console) -> bool:
    """Compile with warnings as errors, solve from the declared initial state, compare with IPOPT.

    IPOPT starts as the generated code does; if it ends elsewhere (another local optimum) it starts once more at the
    generated code's solution, which it must then return.
    """
    from nmpc_codegen.analyse import analyse
    from nmpc_codegen.build import load
    from nmpc_codegen.reference import Reference, node_data

    files = {f"{name}.{ext}": (folder / f"{name}.{ext}").read_text(encoding="utf-8") for ext in ("h", "c", "json")}
    controller = load(files, name, "verify", warnings_as_errors=True)
    problem = analyse(ocp)
    solution = controller.solve(problem.x_initial, CHECK_TOLERANCE[options.precision], CHECK_ITERATIONS)
    nlp = Reference(problem, *_tableau(options))
    data = node_data(problem)
    reference = nlp.solve(data)
    errors = compare(solution, reference)
    limits = LIMITS[options.precision]
    if any(not errors[key] <= limits[key] for key in limits):
        nearby = nlp.solve(data, x=solution.x, u=solution.u)
        if nearby.success:
            reference, errors = nearby, compare(solution, nearby)
    solved = solution.status.name in ("OK", "STALLED")
    passed = solved and reference.success and all(errors[key] <= limits[key] for key in limits)
    _print_check(console, solution, reference, errors, limits, passed)
    return passed


def _tableau(options: Options) -> tuple[Any, ...]:
    """The integrator as plain numbers for the reference; nothing for a discrete map or the default."""
    from nmpc_codegen.reference import Tableau

    scheme = getattr(options.integrator, "tableau", None)
    if scheme is None:
        return ()
    A = tuple(tuple(float(a) for a in row) for row in scheme.a)
    return (Tableau(A, tuple(float(b) for b in scheme.b), int(getattr(options.integrator, "steps", 1))),)


def compare(solution: Solution, reference: Any) -> dict[str, float]:
    """Errors against a reference: largest |a - b| / max(1, max|b|) of u and x per component; of the cost relatively."""
    errors = {"cost": abs(solution.cost - reference.cost) / max(abs(reference.cost), COST_FLOOR)}
    for key, ours, theirs in (("u", solution.u, reference.u), ("x", solution.x, reference.x)):
        size = np.maximum(1.0, np.abs(theirs).max(axis=0, initial=0.0))
        errors[key] = float((np.abs(ours - theirs) / size).max(initial=0.0))
    return errors


def _print_check(
    console: Console,
    solution: Solution,
    reference: Any,
    errors: Mapping[str, float],
    limits: Mapping[str, float],
    passed: bool,
) -> None:
    from rich.table import Table

    table = Table("", "error", "limit", "", title="Check against IPOPT", title_justify="left")
    for key, limit in limits.items():
        verdict, style = ("ok", "") if errors[key] <= limit else ("FAILED", "red")
        table.add_row(key, f"{errors[key]:.1e}", f"{limit:.0e}", verdict, style=style)
    console.print(table)
    ours = f"{solution.status.name} ({solution.status.meaning}), {solution.iterations} iterations"
    console.print(f"generated code: {ours}, cost {solution.cost:.10g}", markup=False)
    theirs = f"{reference.status}, {reference.iterations} iterations"
    console.print(f"IPOPT: {theirs}, cost {reference.cost:.10g}", markup=False)
    for hint in _hints(solution, reference):
        console.print(hint, style="yellow", markup=False, soft_wrap=True)
    console.print("check passed" if passed else "check FAILED", style="green" if passed else "red")


def _hints(solution: Solution, reference: Any) -> list[str]:
    """What to do about outcomes that a table of errors does not explain."""
    hints = []
    if solution.status.name == "NUMERICAL_FAILURE" and reference.success:
        hints.append(
            "the condensed Hessian may not be positive definite: weight every control, "
            "or --set hessian.levenberg_marquardt=1e-8"
        )
    if solution.status.name == "OK" and solution.iterations == 0:
        hints.append("the declared initial state is optimal already, so little was checked: declare initial= elsewhere")
    if solution.status.name == "INFEASIBLE" and not reference.success:
        hints.append("both find the problem infeasible from the declared initial state: check initial= and the rows")
    return hints


if __name__ == "__main__":
    sys.exit(main())
