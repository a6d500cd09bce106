"""A certificate states memory, stack and operations of a package on a target, and how it was compiled.

It holds what a firmware engineer must know before the code runs: bytes of the solver struct; bytes of flash memory with
and without solve(); the worst-case stack of every entry point; the worst case of operations; the functions of the C
library that are used; a digest of the C code that was measured.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from nmpc_codegen.analysis import worst_case
from nmpc_codegen.errors import BuildError
from nmpc_codegen.firmware import stack
from nmpc_codegen.firmware.machine_code import machine_code
from nmpc_codegen.firmware.toolchain import LEVELS, Level, compile_flags, cross, in_hardware, version
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.targets import Target

#: Entry points that a controller with a real-time iteration calls.
REAL_TIME = ("init", "prepare", "feedback", "step", "estimate", "shift", "reset")
SOLVE = "solve"

#: Functions of libgcc in double precision, which a package in single precision must not call.
_DOUBLE = re.compile(r"__aeabi_(?:d\w+|f2d|i2d|ui2d|l2d|ul2d|cd\w+)$|__(?!aeabi)\w*df\w*$")
#: Functions that the compiler calls by itself: copying, and arithmetic that the core lacks.
_COMPILER = re.compile(r"__aeabi_\w+$|mem(?:cpy|set|move|cmp)$|__\w+[sdt][if]\d*$")


@dataclass(frozen=True)
class Certificate:
    """A certificate states properties of a package on a target; sizes are in bytes.

    ``stack_bytes`` holds the worst case of every entry point, libraries included.
    """

    name: str
    target: str
    core: str
    precision: str
    arithmetic: str  # "hardware" or "software"
    compiler: str
    level: str
    flags: tuple[str, ...]
    struct_bytes: int
    flash_bytes: int  # code and constants of the package, every entry point
    flash_bytes_without_solve: int
    flash_bytes_real_time: int  # only init, prepare, feedback, step, shift, reset
    library_bytes: int  # code and constants of libm, libc and libgcc that all entry points need
    library_ram_bytes: int  # variables of the libraries, e.g. errno
    stack_bytes: Mapping[str, int]
    stack_bytes_package: Mapping[str, int]  # without functions of the libraries
    stack_chain: tuple[str, ...]  # the deepest chain of calls
    worst_operations: Mapping[str, int]
    math_functions: tuple[str, ...]
    compiler_functions: tuple[str, ...]
    double_functions: tuple[str, ...]
    sha256: Mapping[str, str]  # of <name>.h and <name>.c
    object_sha256: str  # of the code and constants that the compiler made of them

    @property
    def stack_worst(self) -> int:
        """Return the largest stack of an entry point."""
        return max(self.stack_bytes.values())

    def as_dict(self) -> dict[str, object]:
        """Return the certificate as a JSON object."""
        return asdict(self) | {"stack_bytes_worst": self.stack_worst}

    def to_json(self) -> str:
        return json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n"


def certify(package: Mapping[str, str], name: str, target: Target, level: Level = "O2") -> Certificate:
    """Compile the package for the target, measure it, and bound the operations of a sample.

    Raises:
        BuildError: a tool is missing, the compiler refuses the code, or the stack is not bounded.
    """
    return replace(measure(package, name, target, level), worst_operations=worst_case(package))


def measure(package: Mapping[str, str], name: str, target: Target, level: Level) -> Certificate:
    """Return the certificate without operations, from the compiled package."""
    description = PackageDescription.from_json(package[f"{name}.json"])
    with TemporaryDirectory() as folder:
        return _certify(package, description, target, level, Path(folder))


def _certify(
    package: Mapping[str, str], description: PackageDescription, target: Target, level: Level, folder: Path
) -> Certificate:
    name, flags = description.name, compile_flags(target, level)
    for ext in ("h", "c"):
        (folder / f"{name}.{ext}").write_text(package[f"{name}.{ext}"], encoding="utf-8")
    cross(target, "gcc", folder, *flags, "-fcallgraph-info=su", "-c", f"{name}.c", "-o", "package.o")
    functions = external_functions(target, folder, name)
    undefined = tuple(line.split()[-1] for line in cross(target, "nm", folder, "-u", "package.o").splitlines())
    _link(target, functions, "all.elf", folder)
    graph, symbols = (folder / "package.ci").read_text(encoding="utf-8"), cross(target, "nm", folder, "all.elf")
    frames = stack.with_folded_names(stack.of_package(graph), symbols, f"{name}.c")
    roots = {f.removeprefix(f"{name}_"): f for f in functions}
    depths = stack.depths(_library(target, folder, symbols) | frames, roots)
    alone = stack.depths({f: stack.StackFunction() for f in undefined} | frames, roots)
    deepest = max(depths.values(), key=lambda d: d.bytes)
    flash, library = flash_bytes(target, folder, functions), _sizes(cross(target, "size", folder, "all.elf"))
    return Certificate(
        name=name,
        target=target.name,
        core=target.machine,
        precision=description.precision,
        arithmetic="hardware" if in_hardware(target, description.precision) else "software",
        compiler=version(f"{target.compiler}gcc"),
        level=level,
        flags=flags,
        struct_bytes=_struct_bytes(name, target, folder),
        flash_bytes=flash,
        flash_bytes_without_solve=flash_bytes(target, folder, [f for f in functions if f != f"{name}_{SOLVE}"]),
        flash_bytes_real_time=flash_bytes(
            target, folder, [f for f in functions if f.removeprefix(f"{name}_") in REAL_TIME]
        ),
        library_bytes=library[0] - flash,
        library_ram_bytes=library[1],
        stack_bytes={label: d.bytes for label, d in depths.items()},
        stack_bytes_package={label: d.bytes for label, d in alone.items()},
        stack_chain=tuple(f.removeprefix(f"{name}.c:") for f in deepest.chain),
        worst_operations={},
        math_functions=tuple(f for f in undefined if not _COMPILER.match(f)),
        compiler_functions=tuple(f for f in undefined if _COMPILER.match(f)),
        double_functions=tuple(f for f in undefined if _DOUBLE.match(f)),
        sha256={path: _digest(package[path]) for path in (f"{name}.h", f"{name}.c")},
        object_sha256=_object_digest(target, folder),
    )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def external_functions(target: Target, folder: Path, name: str) -> list[str]:
    """Return the external functions of package.o."""
    lines = (line.split() for line in cross(target, "nm", folder, "--defined-only", "-g", "package.o").splitlines())
    return sorted(symbol for _, kind, symbol in lines if kind == "T" and symbol.startswith(f"{name}_"))


def flash_bytes(target: Target, folder: Path, functions: Iterable[str]) -> int:
    """Return the bytes of code and constants of package.o that these functions reach, without libraries."""
    roots = [f"-Wl,--undefined={f}" for f in functions]
    core = (
        flag for flag in target.flags if not flag.startswith("--specs")
    )  # specs name linker scripts of whole programs
    options = (*core, "-nostdlib", "-r", "-Wl,--gc-sections")
    cross(target, "gcc", folder, *options, *roots, "package.o", "-o", "part.o")
    flash, ram = _sizes(cross(target, "size", folder, "part.o"))
    if ram:
        raise BuildError(f"the package has {ram} bytes of variables outside its struct")
    return flash


def _sizes(listing: str) -> tuple[int, int]:
    """Return the bytes of flash (code, constants, initial values) and of variables from the output of ``size``."""
    text, data, bss = map(int, listing.splitlines()[1].split()[:3])
    return text + data, data + bss


def _link(target: Target, functions: Iterable[str], output: str, folder: Path) -> None:
    """Link a program of these functions and the library functions that they need."""
    roots = [f"-Wl,--undefined={f}" for f in functions]
    options = ("-nostartfiles", "-Wl,--gc-sections", "-Wl,--entry=0", *target.libraries)
    cross(target, "gcc", folder, *target.flags, *options, *roots, "package.o", "-lm", "-o", output)


def _library(target: Target, folder: Path, symbols: str) -> dict[str, stack.StackFunction]:
    """Return the functions of the libraries with their frames, from the linked program."""
    listing = cross(target, "objdump", folder, "-d", "--no-show-raw-insn", "all.elf")
    return stack.with_aliases(stack.of_program(listing, machine_code(target)), symbols)


def _struct_bytes(name: str, target: Target, folder: Path) -> int:
    """Return sizeof(<name>_solver_t) on the target.

    It is read as the size of a char array of this length.
    """
    text = f'#include "{name}.h"\nchar struct_bytes[sizeof({name}_solver_t)] = {{1}};\n'
    (folder / "size.c").write_text(text, encoding="utf-8")
    cross(target, "gcc", folder, *target.flags, "-c", "size.c", "-o", "size.o")
    (line,) = (
        part.split() for part in cross(target, "nm", folder, "-S", "size.o").splitlines() if "struct_bytes" in part
    )
    return int(line[1], 16)


def _object_digest(target: Target, folder: Path) -> str:
    """Return the SHA-256 of the contents of all sections of package.o that are loaded."""
    return _digest(cross(target, "objdump", folder, "-s", "package.o"))


# -- sizes for every goal and optimisation level -----------------------------------------------------------------------


@dataclass(frozen=True)
class Form:
    """A form has the sizes of a package for one goal and optimisation level, in bytes: solver struct, code, stack.

    The stack is that of the entry point with the largest one.
    """

    goal: str
    level: Level
    struct_bytes: int
    flash_bytes: int
    stack_bytes: int

    def as_dict(self) -> dict[str, object]:
        """Return the sizes as a JSON object."""
        return asdict(self)


def forms_of(packages: Mapping[str, Mapping[str, str]], name: str, target: Target) -> tuple[Form, ...]:
    """Measure a package for every goal and optimisation level; ``packages`` holds its files for every goal.

    Raises:
        BuildError: a tool is missing or refuses the code.
    """
    return tuple(_measure(packages, name, target))


def _measure(packages: Mapping[str, Mapping[str, str]], name: str, target: Target) -> Iterator[Form]:
    for goal, package in packages.items():
        for level in LEVELS:
            found = measure(package, name, target, level)
            yield Form(goal, level, found.struct_bytes, found.flash_bytes, found.stack_worst)
