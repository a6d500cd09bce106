"""The emitted C is checked for warnings, symbols, sanitizer findings, stack, and several controllers in one program.

Every function takes the sources of a package (path -> text) and returns its findings, or a count that should be 0.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from examples.crane import build_ocp
from nmpc_codegen import Options, generate
from nmpc_codegen.lowering.dialect.scopes import signature
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.build import WARNINGS as STRICT
from nmpc_codegen.runtime.compilers import find_compiler

#: Warning options for both languages; warnings are counted, not refused.
WARNINGS = tuple(flag for flag in STRICT if flag not in ("-std=c99", "-Werror"))
#: Front ends by compiler and language.
COMPILERS = {"gcc": {"C99": "gcc", "C++17": "g++"}, "clang": {"C99": "clang", "C++17": "clang++"}}
LANGUAGES = {"C99": ("-x", "c", "-std=c99"), "C++17": ("-x", "c++", "-std=c++17")}
RELEASE = ("-std=c99", "-O2", "-fno-math-errno", "-fno-trapping-math")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer")

#: Functions of <math.h> that the printer may call, and functions by which compilers replace them and loops.
FUNCTIONS = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("exp", "expm1", "log", "log1p", "pow", "sqrt", "hypot", "fabs", "floor", "ceil", "fmod", "fmin", "fmax"),
    *("copysign", "erf", "sincos"),
)
ALLOWED = frozenset({*FUNCTIONS, *(f"{f}f" for f in FUNCTIONS), "memcpy", "memset"})

EXERCISE = Path(__file__).with_name("exercise.c")


def package_name(sources: Sources) -> str:
    """Return the prefix of a package: the stem of its only .json file."""
    return next(path for path in sources if path.endswith(".json")).removesuffix(".json")


@contextmanager
def written(*packages: Sources) -> Iterator[Path]:
    """Yield a temporary folder with the C files of the packages; main.c and similar files are those of the last one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for sources in packages:
            for path, text in sources.items():
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_text(text, encoding="utf-8")
        yield folder


def compile_c(folder: Path, *arguments: str, program: str | None = None) -> subprocess.CompletedProcess[str]:
    """Run the C compiler, or a program, in a folder, with messages in English."""
    environment = {**os.environ, "LC_ALL": "C"}
    command = [*([program] if program else find_compiler()), *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def warnings_of(
    sources: Sources,
    levels: Sequence[str] = ("-O2",),
    languages: Sequence[str] = tuple(LANGUAGES),
    compiler: str | None = None,
) -> str:
    """Return messages of the compiler on the package and its main.c, as C99 and as C++17, at every level.

    Empty: none.

    ``compiler``: a key of COMPILERS; None: the compiler of build().
    """
    name = package_name(sources)
    messages = []
    with written(sources) as folder:
        for language in languages:
            program = COMPILERS[compiler][language] if compiler else None
            for level in levels:
                flags = (*LANGUAGES[language], level, *WARNINGS)
                done = compile_c(folder, *flags, "-S", f"{name}.c", "main.c", program=program)
                messages.append(done.stderr if done.stderr or not done.returncode else "error: no message\n")
    return "".join(messages)


def count_warnings(messages: str) -> int:
    """Count warnings and errors among the messages of a compiler."""
    return len(re.findall(r"\b(?:warning|error):", messages))


def foreign_symbols(sources: Sources, *flags: str) -> list[str]:
    """Return the unexpected symbols of the object, by letter of nm and name.

    A symbol is unexpected if it is defined outside the prefix, undefined and not in ALLOWED, or writable data. The
    object has no position-independent code, where tables of addresses would be data of the loader, not of the package.
    """
    name = package_name(sources)
    with written(sources) as folder:
        compile_c(folder, *RELEASE, "-fno-pie", *flags, "-c", f"{name}.c", "-o", "package.o").check_returncode()
        listing = subprocess.run(["nm", "package.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
    found = []
    for line in listing.splitlines():
        kind, symbol = line.split()[-2:]
        undefined = kind == "U"
        foreign = symbol not in ALLOWED if undefined else kind.isupper() and not symbol.startswith(f"{name}_")
        if foreign or kind in "bBcCdDsS":
            found.append(f"{kind} {symbol}")
    return found


def parameters_of(unit: str, function: str) -> tuple[str, ...]:
    """Return the parameters of an inner function of a unit, without those that the package leaves out.

    Raises:
        ValueError: the unit has no such function.
    """
    head = re.search(rf"^static [^;{{}}#]*?\b{function}\([^;{{]*\)(?=\n\{{)", unit, re.MULTILINE)
    if head is None:
        raise ValueError(f"there is no function {function}()")
    return signature(head[0])[1]


def exercise(sources: Sources, x0: Sequence[float], flags: Sequence[str] = SANITIZERS) -> str:
    """Return findings of exercise.c, which calls the whole API, and of the sanitizers; empty: none."""
    name = package_name(sources)
    with written(sources) as folder:
        macros = [f"-DNAME={name}", f"-DMACRO={name.upper()}", f'-DPACKAGE="{name}.c"', "-I."]
        macros += [
            f"-D{bound.upper()}(j)={bound}({', '.join({'s': '&s', 'k': '0', 'j': 'j'}[p] for p in parameters)})"
            for bound in ("control_lower", "control_upper")
            for parameters in [parameters_of(sources[f"{name}.c"], bound)]
        ]
        built = compile_c(folder, "-std=c99", "-g", *flags, *macros, str(EXERCISE), "-o", "exercise", "-lm")
        if built.returncode:
            return built.stderr
        done = subprocess.run(
            ["./exercise", *(repr(float(v)) for v in x0)], cwd=folder, capture_output=True, text=True, check=False
        )
    return done.stdout + done.stderr or (f"exit code {done.returncode}\n" if done.returncode else "")


@dataclass(frozen=True)
class Stack:
    """A stack use has bytes of the deepest call chain, without library functions, and of the largest frame."""

    total: int
    frame: int


def stack_use(sources: Sources, *flags: str) -> Stack:
    """Return the stack use of the package from gcc's call graph."""
    name = package_name(sources)
    with written(sources) as folder:
        compile_c(folder, *RELEASE, *flags, "-fcallgraph-info=su", "-c", f"{name}.c").check_returncode()
        graph = (folder / f"{name}.ci").read_text(encoding="utf-8")
    frames = {t: int(b) for t, b in re.findall(r'title: "([^"]+)" label: "[^"]*?(\d+) bytes', graph)}
    calls: dict[str, set[str]] = {}
    for source, target in re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', graph):
        calls.setdefault(source, set()).add(target)

    def depth(function: str, path: tuple[str, ...] = ()) -> int:
        if function in path:
            raise RecursionError(f"{function} calls itself")
        below = (depth(callee, (*path, function)) for callee in calls.get(function, ()))
        return frames.get(function, 0) + max(below, default=0)

    return Stack(max(depth(f) for f in frames), max(frames.values()))


_TWO = """
#include <stdio.h>
#include <string.h>
{includes}
{states}
int main(int argc, char **argv)
{{
    int n;
{start}
    for (n = 0; n < {steps}; n++) {{
{loop}
    }}
    return argc > 8;
}}
"""

_STATE = """static {p}_solver_t {p}_s;
static {p}_real {p}_x[{P}_NX] = {{ {x0} }};
static void {p}_sample(int n)
{{
    {p}_real u[{P}_NU];
    const int status = (int){p}_step(&{p}_s, {p}_x, u);
    {p}_integrate(&{p}_s, {p}_x, u, ({p}_real)0.3, {p}_x);
    printf("{p} %d %d %a %a\\n", n, status, (double)u[0], (double){p}_x[0]);
}}
"""

_RUNS = 'strcmp(argv[1], "all") == 0 || strcmp(argv[1], "{p}") == 0'


def run_together(
    packages: Sequence[Sources], x0: Sequence[float], steps: int = 30, flags: Sequence[str] = RELEASE
) -> dict[str, tuple[list[str], ...]]:
    """Link the packages into one program and run their closed loops alone and interleaved with the others.

    Returns {prefix: lines of the loop alone, and interleaved}; a line holds sample, status, u_0 and x_0 in hexadecimal.
    """
    names = [package_name(sources) for sources in packages]
    start = ", ".join(repr(float(v)) + "f" for v in x0)
    text = _TWO.format(
        includes="\n".join(f'#include "{p}.h"' for p in names),
        states="\n".join(_STATE.format(p=p, P=p.upper(), x0=start) for p in names),
        start="\n".join(f"    (void){p}_init(&{p}_s);" for p in names),
        steps=steps,
        loop="\n".join(f"        if ({_RUNS.format(p=p)}) {p}_sample(n);" for p in names),
    )
    with written(*packages) as folder:
        (folder / "together.c").write_text(text, encoding="utf-8")
        files = ("together.c", *(f"{p}.c" for p in names))
        compile_c(folder, *flags, *files, "-o", "together", "-lm").check_returncode()

        def lines(which: str) -> list[str]:
            command = ["./together", which]
            return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.splitlines()

        together = lines("all")
        return {p: (lines(p), [line for line in together if line.split()[0] == p]) for p in names}


def crane_packages() -> tuple[Sources, ...]:
    """Return the crane, the crane under another name, and the crane in single precision."""
    ocp = build_ocp()
    return generate(ocp), generate(ocp, name="crane_b"), generate(ocp, Options(precision="single"), "crane_f32")
