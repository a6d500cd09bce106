"""The whole unit of a package, before pruning, does the same as the exported unit.

A whole package states every member and every size that a part may name (GNU C: arrays of size 0), keeps `#if` for the
compiler and leaves nothing out (lower(whole=True)). Its parts are the text that people edit, so it has to compile, and
its closed loops have to give the same bits as those of the package.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nmpc_codegen.compiler import text_of
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.package.sources import Sources
from verification.quality import compile_c, package_name, written
from verification.rendered import model, texts
from verification.timed import Sample

#: Flags that keep operations and their order, whatever the compiler knows about the sizes.
FLAGS = ("-std=gnu99", "-O1", "-ffp-contract=off", "-fno-tree-vectorize", "-w")
#: A whole unit declares the term of a row that a package without rows lacks, and never calls it.
LINKED = ("-lm", "-no-pie", "-Wl,--defsym=row_term=0")
#: Flags that make undeclared names and pointers to other types errors.
ERRORS = (
    "-Werror=implicit-function-declaration",
    "-Werror=incompatible-pointer-types",
    "-Werror=int-conversion",
    "-Werror=undef",
)
_GUARD = re.compile(r'^#if !defined\((?:.|\\\n)*?\n#error "\w+ is written for .*\n#endif\n', re.MULTILINE)

_DRIVER = """#include <stdio.h>
#include "{p}.h"

static {p}_solver_t s;
static {p}_real x[{P}_NX], u[{P}_NU];
static unsigned long seed = 12345;

static double next(void)
{{
    seed = (1103515245ul * seed + 12345ul) % 2147483648ul;
    return (double)seed / 1073741824.0 - 1.0;
}}

static void show(int n, int status)
{{
    printf("%d %d %a", n, status, (double){p}_cost(&s));
    for (int j = 0; j < {P}_NU; j++) {{
        printf(" %a", (double)u[j]);
    }}
    for (int i = 0; i < {P}_NX; i++) {{
        printf(" %a %a", (double)x[i], (double)s.x[{P}_N][i]);
    }}
    printf("\\n");
}}

int main(void)
{{
    {p}_init(&s);
    for (int i = 0; i < {P}_NX; i++) {{
        x[i] = s.x[0][i];
    }}
    for (int n = 0; n < {samples}; n++) {{
        for (int i = 0; i < {P}_NX; i++) {{
            x[i] += ({p}_real)((n % 8 == 3 ? 0.2 : 1e-3) * next() * (0.1 + (x[i] < 0 ? -x[i] : x[i])));
        }}
        show(n, (int){p}_step(&s, x, u));
        {p}_integrate(&s, x, u, {P}_DT, x);
    }}
    {solve}
    return 0;
}}
"""
_ESTIMATING = """#include <stdio.h>
#include "{p}.h"

static {p}_solver_t s;
static {p}_real y[{P}_NM], u[{inputs} + 1], x[{P}_NX], P[{P}_NX * {P}_NX];
static unsigned long seed = 12345;

static double next(void)
{{
    seed = (1103515245ul * seed + 12345ul) % 2147483648ul;
    return (double)seed / 1073741824.0 - 1.0;
}}

int main(void)
{{
    {p}_init(&s);
    for (int n = 0; n < {samples}; n++) {{
        for (int i = 0; i < {P}_NM; i++) {{
            y[i] = ({p}_real)((n % 8 == 3) ? 9 * next() : next());
        }}
        for (int i = 0; i < {inputs}; i++) {{
            u[i] = ({p}_real)next();
        }}
        printf("%d %d", n, (int){p}_estimate(&s, y, {u}x));
        {p}_covariance(&s, P);
        for (int i = 0; i < {P}_NX; i++) {{
            printf(" %a %a", (double)x[i], (double)P[i * {P}_NX + i]);
        }}
        printf("\\n");
        if (n == 15) {{
            printf("%d\\n", (int){p}_restart(&s, x, P));
        }}
        {late}
    }}
    return 0;
}}
"""
_LATE = 'printf("%d\\n", (int){p}_correct(&s, y, n % 4, x));'
_SOLVE = """for (int j = 0; j < {P}_NU; j++) {{
        u[j] = s.u[0][j];
    }}
    show(-1, (int){p}_solve(&s, x, ({p}_real)1e-8, 20));"""


def packages(sample: Sample) -> tuple[Sources, Sources]:
    """Return the exported package of a sample, and the whole one."""
    return texts(sample), text_of(lower(model(sample), whole=True))


def errors_of(whole: Sources, *flags: str) -> str:
    """Return the compiler's errors on a whole unit; empty: none."""
    name = package_name(whole)
    with written(whole) as folder:
        _without_guard(folder / f"{name}.c")
        done = compile_c(folder, "-std=gnu99", "-w", *ERRORS, *flags, "-fsyntax-only", f"{name}.c", program="gcc")
    return done.stderr


def closed_loop(sources: Sources, *flags: str, samples: int = 20) -> str:
    """Return status, cost, control and states of every sample, and of solve() at the end, to the bit.

    Raises:
        AssertionError: the package does not compile, or its program fails.
    """
    name = package_name(sources)
    names = {"p": name, "P": name.upper(), "samples": samples}
    solve = _SOLVE.format(**names) if f"{name}_solve(" in sources[f"{name}.h"] else ""
    with written(sources) as folder:
        _without_guard(folder / f"{name}.c")
        (folder / "loop.c").write_text(_driver(sources, names, solve), encoding="utf-8")
        foreign = sorted(str(path.relative_to(folder)) for path in folder.rglob("*/*.c"))
        include = [f"-I{path}" for path in sorted(folder.rglob("*")) if path.is_dir()]
        units = ("loop.c", f"{name}.c", *foreign)
        built = compile_c(folder, *FLAGS, *flags, *include, *units, "-o", "loop", *LINKED, program="gcc")
        assert built.returncode == 0, built.stderr
        done = subprocess.run(["./loop"], cwd=folder, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _driver(sources: Sources, names: Mapping[str, Any], solve: str) -> str:
    """Return the program of a controller, or of an estimator."""
    found = sources.description.estimation
    if found is None:
        return _DRIVER.format(**names, solve=solve)
    late = _LATE.format(**names) if found.kind == "mhe" else ""
    return _ESTIMATING.format(**names, inputs=found.nu, u="u, " if found.nu else "", late=late)


def _without_guard(file: Path) -> None:
    """Let a unit for another machine compile on this one."""
    file.write_text(_GUARD.sub("", file.read_text(encoding="utf-8")), encoding="utf-8")
