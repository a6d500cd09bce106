"""Do two texts of a package compile to the same object code?

The oracle compares, per compiler (gcc, clang) and level (-O0, -O2), the disassembly with its relocations and the bytes
of all read-only sections. They do not depend on layout, comments and names of variables, but on every instruction,
every constant and every function that is not inlined. A commit that changes only the text is checked in this way:
packages that the preceding commit generates against those of this tree.

Texts that the preprocessor of a compiler turns into the same tokens have the same object code without being compiled.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from itertools import product
from pathlib import Path

from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.render import render
from nmpc_codegen.package.sources import Sources
from verification.quality import package_name
from verification.timed import Sample

COMPILERS = ("gcc", "clang")
LEVELS = ("-O0", "-O2")
#: Without the name of the compiler, which is no code, and tables for unwinding, which repeat addresses.
FLAGS = ("-std=c99", "-ffp-contract=off", "-fno-ident", "-fno-asynchronous-unwind-tables", "-w")
JOBS = 2
_NAME = re.compile(r"\w+")
_TYPEDEF = re.compile(r"^typedef \w+ (\w+);$", re.MULTILINE)


@cache
def lowered(sample: Sample) -> CModule:
    """The CModule of a sample, before rendering."""
    return lower(linearize(classify(sample.make()), sample.options), None)


def texts(sample: Sample) -> Sources:
    """The package of a sample, without third-party code."""
    return render(lowered(sample))


def objects_differ(
    one: Sources, other: Sources, compilers: Sequence[str] = COMPILERS, levels: Sequence[str] = LEVELS
) -> bool:
    """True if at least one compiler produces different object code for two packages at one level or more."""
    return any(
        _tokens(one, cc, level) != _tokens(other, cc, level) and _object(one, cc, level) != _object(other, cc, level)
        for cc, level in product(compilers, levels)
    )


def differing(pairs: Sequence[tuple[str, Sources, Sources]]) -> list[str]:
    """Names of the pairs whose object code differs; several pairs are compiled at a time."""
    with ThreadPoolExecutor(JOBS) as pool:
        verdicts = pool.map(lambda pair: objects_differ(pair[1], pair[2]), pairs)
        return [name for (name, _, _), differs in zip(pairs, verdicts, strict=True) if differs]


@contextmanager
def _written(sources: Sources) -> Iterator[tuple[str, Callable[[list[str]], str]]]:
    """The .c of a package in a folder of its own, and a function that runs a command there and returns its output."""
    name = package_name(sources)
    with tempfile.TemporaryDirectory() as folder:
        for path in (f"{name}.h", f"{name}.c"):
            (Path(folder) / path).write_text(sources[path], encoding="utf-8")
        run = partial(subprocess.run, cwd=folder, check=True, capture_output=True, text=True)
        yield f"{name}.c", lambda command: str(run(command).stdout)


def _tokens(sources: Sources, compiler: str, level: str) -> list[str]:
    """The words of the .c of a package after the preprocessor, without type names that nothing uses.

    Raises an error if the compiler refuses it.
    """
    with _written(sources) as (unit, output):
        text = output([compiler, *FLAGS, level, "-E", "-P", unit])
    uses = Counter(_NAME.findall(text))
    return _TYPEDEF.sub(lambda found: "" if uses[found[1]] == 1 else found[0], text).split()


def _object(sources: Sources, compiler: str, level: str) -> str:
    """Disassembly and read-only data of the .c of a package; raises an error if the compiler refuses it."""
    with _written(sources) as (unit, output):
        output([compiler, *FLAGS, level, "-c", unit, "-o", "unit.o"])
        code = output(["objdump", "-d", "-r", "--no-show-raw-insn", "unit.o"])
        headers = output(["objdump", "-h", "unit.o"]).split()
        sections = sorted({word for word in headers if word.startswith((".rodata", ".data"))})
        data = [output(["objdump", "-s", "-j", section, "unit.o"]) for section in sections]
    return "\n".join([code, *data])
