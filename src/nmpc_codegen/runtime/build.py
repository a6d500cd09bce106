"""A C package is compiled and loaded here, with compiler profiles and cffi; no other module imports cffi.

    texts of <name>.h, <name>.c, <name>.json  --cffi, two compilations side by side-->  module  -->  Controller

A profile without a wrapper compiles only the package, as a shared library, and cffi calls its functions by their
declarations. That takes half the time to build and does not need Python.h, but every call takes longer.

The module or library is kept in the cache (cache.py) under a key that is computed from everything it depends on: the
texts, the flags of the profile and of the package's target, the compiler with its version, the processor that
-march=native stands for, cffi and Python. A cache that several machines share therefore holds one library for each kind
of machine.

The compiled code runs in this process with the rights of the user, so open only packages whose C you trust. The
description, <name>.json, need not be trusted: it is refused if it disagrees with the compiled code.
"""

from __future__ import annotations

import hashlib
import importlib.machinery
import importlib.util
import os
import platform
import re
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import cffi

from nmpc_codegen.errors import BuildError, ControllerError, OptionError
from nmpc_codegen.exclusive import COMPILING
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.kinds import CONTROLLER
from nmpc_codegen.runtime.cache import CACHE_VARIABLE, PRODUCT, entry, keep_failed
from nmpc_codegen.runtime.compiled import CompiledPackage
from nmpc_codegen.runtime.compilers import ask, environment, find_compiler
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.estimation.observer import Observer
from nmpc_codegen.runtime.native import check_target, flags_of_processor, macros_of
from nmpc_codegen.targets import PORTABLE, TARGETS, Target

#: A negative constant; cffi does not parse its parentheses.
_IN_PARENTHESES = re.compile(r"^(#define \w+) \((-\d+)\)", re.MULTILINE)
BEGIN, END = "/* begin declarations */", "/* end declarations */"
WARNINGS = (
    *("-std=c99", "-pedantic", "-Wall", "-Wextra"),
    *("-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror"),
)
SHOWN_LINES = 20


def warnings_for(target: Target) -> tuple[str, ...]:
    """Return the flags of all warnings of the project, as errors, in the language of a target.

    -pedantic is for ISO C.
    """
    return WARNINGS if target.lanes == 1 else (f"-std={target.standard}", *WARNINGS[2:])


@dataclass(frozen=True)
class Profile:
    """A profile names the compiler flags of the package's .c; every reported number names its profile.

    If ``wrapper`` is true, the package becomes a Python module with a compiled wrapper, else a shared library. If
    ``native`` is true, the code is compiled for the processor at hand, except for a target that names a machine.
    """

    name: str
    flags: tuple[str, ...]
    wrapper: bool = True
    native: bool = False

    def all_flags(self, target: Target = PORTABLE) -> tuple[str, ...]:
        """Return the flags for a package of this target.

        Raises:
            BuildError: there is no compiler.
        """
        return (*self.flags, *(flags_of_processor() if self.native else ()), *target.of_machine)


_FAST = ("-O2", "-fno-math-errno", "-fno-trapping-math")

PROFILES: dict[str, Profile] = {
    p.name: p
    for p in (
        Profile("test", ("-std=c99", "-O0", "-ffp-contract=off"), wrapper=False),
        Profile("fast", (*_FAST, "-ffp-contract=fast"), native=True),
        Profile("verify", (*_FAST, "-ffp-contract=off")),
    )
}


def get_profile(profile: str | Profile) -> Profile:
    """Return the profile with the given name; a Profile is returned unchanged.

    Raises:
        OptionError: there is no such profile.
    """
    if isinstance(profile, Profile):
        return profile
    if profile not in PROFILES:
        raise OptionError(f"profile is {profile!r}; allowed: {', '.join(PROFILES)}, or a Profile(name, flags)")
    return PROFILES[profile]


def load(
    files: Mapping[str, str],
    name: str,
    profile: str | Profile = "fast",
    *,
    warnings_as_errors: bool = False,
) -> Controller:
    """Compile a package (or take it from the cache) and return an initialised controller.

    Args:
        files: path -> text; <name>.h, <name>.c, <name>.json and foreign code in folders are used, others are ignored.
        name: name and C prefix of the package.
        profile: name of a profile in PROFILES, or a Profile.
        warnings_as_errors: compile the package's .c with all warnings of the project as errors.

    Raises:
        OptionError: there is no such profile.
        BuildError: there is no compiler or no Python.h, the compiler rejects the code, or this machine cannot run it.
        ControllerError: <name>.json is not the description of a controller, or it does not describe this C code.
    """
    found = load_any(files, name, profile, warnings_as_errors=warnings_as_errors)
    if not isinstance(found, Controller):
        raise ControllerError(f"{name} is {found.description.kind.opened}")
    return found


def load_estimator(files: Mapping[str, str], name: str, profile: str | Profile = "fast") -> Observer:
    """Compile and load the package of an estimator; see load()."""
    found = load_any(files, name, profile)
    if not isinstance(found, Observer):
        raise ControllerError(f"{name} is {found.description.kind.opened}")
    return found


def load_any(
    files: Mapping[str, str], name: str, profile: str | Profile = "fast", *, warnings_as_errors: bool = False
) -> Controller | Observer:
    """Compile and load a package of any kind; see load()."""
    found = compile_package(files, name, profile, warnings_as_errors)
    return Controller(found) if found.description.kind is CONTROLLER else Observer(found)


def compile_package(
    files: Mapping[str, str], name: str, profile: str | Profile, warnings_as_errors: bool = False
) -> CompiledPackage:
    """Return the compiled package; see load()."""
    chosen = get_profile(profile)
    missing = [f"{name}.{ext}" for ext in ("h", "c", "json") if f"{name}.{ext}" not in files]
    if missing:
        raise BuildError(f"the package {name!r} lacks {', '.join(missing)}")
    _check_names(name, files)
    sources = {path: files[path] for path in (f"{name}.h", f"{name}.c", f"{name}.json")}
    sources |= {path: text for path, text in files.items() if "/" in path}
    with COMPILING:  # msgspec leaves what it knows of a class with the class; a fork would copy half of it
        description = PackageDescription.from_json(sources[f"{name}.json"])
    if description.target not in TARGETS:
        raise ControllerError(f"{name} is for the target {description.target!r}; known: {', '.join(TARGETS)}")
    target = TARGETS[description.target]
    check_target(name, target)
    flags = (*chosen.all_flags(target), *(warnings_for(target) if warnings_as_errors else ()))
    path = compile_module(sources, name, flags, chosen.wrapper)
    ffi, lib = _import(name, path) if chosen.wrapper else _open(declarations(sources[f"{name}.h"], name), name, path)
    return CompiledPackage(name, sources, description, chosen, ffi, lib, load_any)


def load_library(
    files: Mapping[str, str], name: str, profile: str | Profile = "fast", *, warnings_as_errors: bool = False
) -> tuple[Any, Any]:
    """Compile <name>.c and <name>.h (or take them from the cache); return cffi's ffi and lib.

    Raises:
        OptionError: there is no such profile.
        BuildError: there is no compiler or no Python.h, or the compiler rejects the code.
    """
    chosen = get_profile(profile)
    _check_names(name, files)
    sources = {path: files[path] for path in (f"{name}.h", f"{name}.c")}
    extra = WARNINGS if warnings_as_errors else ()
    path = compile_module(sources, name, (*chosen.all_flags(), *extra), chosen.wrapper)
    return _import(name, path) if chosen.wrapper else _open(declarations(sources[f"{name}.h"], name), name, path)


def _check_names(name: str, files: Mapping[str, str]) -> None:
    """Refuse names that the compiler could take for an option, and paths that lead out of the folder."""
    if not (name.isascii() and name.isidentifier()):
        raise BuildError(f"the package is named {name!r}; expected a C identifier")
    for path in files:
        if Path(path).is_absolute() or ".." in Path(path).parts:
            raise BuildError(f"{name}: the file {path!r} is outside the package")


def compile_module(files: Mapping[str, str], name: str, flags: Sequence[str], wrapper: bool = True) -> Path:
    """Return the path of the extension module, or of the library; compile it unless it is in the cache."""
    compiler = find_compiler()
    module = f"_nmpc_{name}_{_key(files, name, flags, compiler, wrapper)}"
    wrapped = module if wrapper else None
    return entry(f"{module}{_suffix()}", lambda folder: _compile(files, name, flags, compiler, wrapped, folder))


def _key(
    files: Mapping[str, str], name: str, flags: Sequence[str], compiler: tuple[str, ...], wrapper: bool = True
) -> str:
    """Return the first 32 hex digits of the SHA-256 of everything that the module depends on."""
    digest = hashlib.sha256()
    parts = [name, *(text for path in sorted(files) if not path.endswith(".json") for text in (path, files[path]))]
    parts += [*compiler, *flags, _identity(compiler, tuple(flags), os.environ.get("PATH", ""))]
    parts += [cffi.__version__, sys.version, platform.machine(), _suffix(), str(wrapper)]
    for part in parts:
        data = part.encode()
        digest.update(b"%d:" % len(data) + data)
    return digest.hexdigest()[:32]


@lru_cache
def _identity(compiler: tuple[str, ...], flags: tuple[str, ...], path: str) -> str:
    """Return the version of the compiler, and its flags with those that it adds itself.

    ``-###`` makes gcc and clang print the command that they would run: cc1 with all its flags. Of any other compiler
    that compiles an empty file, the version and the predefined macros are read. ``path`` is only a key of lru_cache.
    """
    command = [*compiler, *flags, "-###", "-E", "-x", "c", os.devnull]
    result = ask(command)
    if result.returncode == 0 and "cc1" in result.stderr:
        return result.stderr
    plain, version = ask([*compiler, *flags, "-E", "-x", "c", os.devnull]), ask([*compiler, "-v"])
    if plain.returncode == 0 and version.returncode == 0:
        return f"{version.stdout}{version.stderr}{sorted(macros_of(compiler, flags).items())}"
    said = _head(result.stderr) or "it prints nothing"
    raise BuildError(f"'{' '.join(command)}' failed with status {result.returncode}:\n{said}")


def _suffix() -> str:
    return str(sysconfig.get_config_var("EXT_SUFFIX") or ".so")


def _compile(
    files: Mapping[str, str],
    name: str,
    flags: Sequence[str],
    compiler: tuple[str, ...],
    module: str | None,
    folder: Path,
) -> None:
    """Write the files to an empty folder and make PRODUCT there: the Python module called ``module``, or a library."""
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    if module is None:
        _compile_library(files, name, flags, compiler, folder)
    else:
        _compile_module(files, name, flags, compiler, module, folder)


def _compile_library(
    files: Mapping[str, str], name: str, flags: Sequence[str], compiler: tuple[str, ...], folder: Path
) -> None:
    """Compile the package to a shared library, with one call of the compiler."""
    foreign = _compile_foreign(files, flags, compiler, folder)
    command = [*compiler, *_link_flags(), "-fPIC", *flags, f"{name}.c", *foreign, "-o", PRODUCT, "-lm"]
    made = _run(command, folder)
    if made.returncode != 0:
        raise BuildError(_keep_refused(compiler, f"{name}.c", made.stderr, folder))


def _compile_module(
    files: Mapping[str, str], name: str, flags: Sequence[str], compiler: tuple[str, ...], module: str, folder: Path
) -> None:
    """Compile the package and its wrapper at the same time, and link them."""
    includes = _python_includes()
    common = [*compiler, "-c", "-fPIC", "-fvisibility=hidden"]
    command = [*common, *flags, f"{name}.c", "-o", "package.o"]
    package = subprocess.Popen(
        command,
        cwd=folder,
        env=environment(command, folder),
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )
    try:
        _write_wrapper(files[f"{name}.h"], name, module, folder / "wrapper.c")
        level = "-O0" if "-O0" in flags else "-O1"
        wrapper = _run([*common, level, "-w", *includes, "wrapper.c", "-o", "wrapper.o"], folder)
    finally:
        _, errors = package.communicate()
    if package.returncode != 0:
        raise BuildError(_keep_refused(compiler, f"{name}.c", errors, folder))
    if wrapper.returncode != 0:
        raise BuildError(_keep_refused(compiler, f"the wrapper of {name}", wrapper.stderr, folder))
    foreign = _compile_foreign(files, flags, compiler, folder)
    linked = _run([*compiler, *_link_flags(), "package.o", "wrapper.o", *foreign, "-o", PRODUCT, "-lm"], folder)
    if linked.returncode != 0:
        raise BuildError(_keep_refused(compiler, f"linking {name}", linked.stderr, folder))


def _run(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=folder,
        env=environment(command, folder),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )


def _compile_foreign(
    files: Mapping[str, str], flags: Sequence[str], compiler: tuple[str, ...], folder: Path
) -> list[str]:
    """Compile the code in subfolders without the project's warnings; return the object files."""
    includes = sorted({f"-I{Path(path).parent}" for path in files if "/" in path})
    allowed = [flag for flag in flags if not flag.startswith(("-W", "-pedantic", "-std"))]
    objects = []
    for path in sorted(p for p in files if "/" in p and p.endswith(".c")):
        objects.append(f"{path[:-2].replace('/', '_')}.o")
        command = [*compiler, "-c", "-fPIC", "-fvisibility=hidden", *allowed, "-w", *includes, path, "-o", objects[-1]]
        run = _run(command, folder)
        if run.returncode != 0:
            raise BuildError(_keep_refused(compiler, path, run.stderr, folder))
    return objects


def _python_includes() -> list[str]:
    """Return the -I flags for Python.h."""
    folders = {sysconfig.get_path("include"), sysconfig.get_path("platinclude")}
    if not any((Path(folder) / "Python.h").exists() for folder in folders):
        raise BuildError(
            f"Python.h is not in {' or '.join(sorted(folders))}: install the headers of Python with "
            "'apt install python3-dev', 'dnf install python3-devel' or 'brew install python'"
        )
    return [f"-I{folder}" for folder in sorted(folders)]


def _link_flags() -> list[str]:
    return ["-bundle", "-undefined", "dynamic_lookup"] if sys.platform == "darwin" else ["-shared"]


def _write_wrapper(header: str, name: str, module: str, path: Path) -> None:
    """Write the C file that makes the package a Python module, from the declarations of its header."""
    ffi = cffi.FFI()
    try:
        ffi.cdef(declarations(header, name))
    except cffi.CDefError as error:
        raise BuildError(f"cffi cannot parse the declarations of {name}.h: {error}") from error
    ffi.set_source(module, f'#include "{name}.h"', compiler_verbose=0)
    ffi.emit_c_code(str(path))


def declarations(header: str, name: str) -> str:
    """Return the part of a header that cffi parses, which is between two marker comments."""
    _, begin, rest = header.partition(BEGIN)
    inside, end, _ = rest.partition(END)
    if not begin or not end:
        raise BuildError(f"{name}.h has no lines '{BEGIN}' and '{END}'")
    return _IN_PARENTHESES.sub(r"\1 \2", inside)


def _keep_refused(compiler: tuple[str, ...], what: str, output: str, folder: Path) -> str:
    """Keep the sources of a failed compilation; return the error message, which says where they are."""
    return f"{' '.join(compiler)} refuses {what} (sources kept in {keep_failed(folder)}):\n{_head(output)}"


def _head(output: str) -> str:
    lines = output.strip().splitlines()
    more = [f"... {len(lines) - SHOWN_LINES} more lines"] if len(lines) > SHOWN_LINES else []
    return "\n".join([*lines[:SHOWN_LINES], *more])


class _Declared(cffi.FFI):  # type: ignore[misc]
    """The declarations of a library are parsed into its ffi.

    ``error`` is the exception class that the ffi of a module also has.
    """

    error = (cffi.FFIError, cffi.CDefError)


@cache
def _open(declared: str, name: str, path: Path) -> tuple[Any, Any]:
    """Load a library and return its ffi and lib; it stays loaded, as functions may outlive their package."""
    ffi = _Declared()
    try:
        ffi.cdef(declared)
        lib = ffi.dlopen(str(path))
        for known in dir(lib):
            getattr(lib, known)
    except cffi.CDefError as error:
        raise BuildError(f"cffi cannot parse the declarations of {name}.h: {error}") from error
    except (OSError, AttributeError) as error:
        raise _loading_error(name, path, error) from error
    return ffi, lib


def _loading_error(name: str, path: Path, error: Exception) -> BuildError:
    """Return the error for a module or library that the system does not load."""
    flag = getattr(os, "ST_NOEXEC", 0)
    if flag and os.statvfs(path).f_flag & flag:
        return BuildError(
            f"{path.parent} is mounted noexec, so that no compiled package can be loaded from it: name another folder "
            f"in {CACHE_VARIABLE}"
        )
    return BuildError(f"cannot load the compiled package {name} from {path}: {error}")


@cache
def _import(name: str, path: Path) -> tuple[Any, Any]:
    """Import an extension module under its unique name, once per process, and return its ffi and lib."""
    module_name = path.name.split(".")[0]
    loader = importlib.machinery.ExtensionFileLoader(module_name, str(path))
    spec = importlib.util.spec_from_file_location(module_name, path, loader=loader)
    if spec is None:
        raise BuildError(f"cannot load the compiled package {name} from {path}")
    try:
        module = importlib.util.module_from_spec(spec)
        loader.exec_module(module)
    except ImportError as error:
        raise _loading_error(name, path, error) from error
    return module.ffi, module.lib
