"""The C compiler is $CC, else one on the path, else that of the extra ``compiler``."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from platformdirs import user_cache_dir

from nmpc_codegen.errors import BuildError
from nmpc_codegen.exclusive import COMPILING
from nmpc_codegen.runtime.cache import temporary_directory
from nmpc_codegen.runtime.extras import DISTRIBUTION
from nmpc_codegen.targets import UNALIGNED_MOVES

#: The compiler of the package ziglang, which is clang with a C library. Without the option it inserts traps at -O0.
ZIG = (sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined")
#: The environment variable that names zig's folder for parts of its C library.
ZIG_CACHE = "ZIG_GLOBAL_CACHE_DIR"

_PROBE = """#if !defined(__GNUC__) || defined(__clang__) || defined(__TINYC__)
#error "another compiler, which does not need the option and may accept it without knowing it"
#endif
typedef int probe;
"""


def find_compiler() -> tuple[str, ...]:
    """Return the command of the C compiler with required options: $CC, else gcc, cc or clang on the path, else zig.

    Raises:
        BuildError: there is none; the message says what to install.
    """
    command = _compiler_on_path()
    return command if command == ZIG else with_required_options(command)


def with_required_options(command: tuple[str, ...]) -> tuple[str, ...]:
    """Return the command with UNALIGNED_MOVES, if it is a gcc whose assembler knows this option.

    This runs under the lock COMPILING: the first temporary folder of a process takes a lock of Python, which a fork
    would copy in its locked state.
    """
    with COMPILING:
        return _with_required_options(command, os.environ.get("PATH", ""))


@lru_cache
def _with_required_options(command: tuple[str, ...], path: str) -> tuple[str, ...]:
    """Test with a small file whether the compiler accepts UNALIGNED_MOVES; ``path`` is only a key of lru_cache."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "probe.c").write_text(_PROBE)
        asked = [*command, UNALIGNED_MOVES, "-c", "probe.c", "-o", "probe.o"]
        known = subprocess.run(asked, cwd=folder, capture_output=True, check=False).returncode == 0
    return (*command, UNALIGNED_MOVES) if known else command


def _compiler_on_path() -> tuple[str, ...]:
    given = os.environ.get("CC", "")
    try:
        wanted = shlex.split(given)
    except ValueError as error:
        raise BuildError(f"CC is {given!r}, which is no command: {error}") from error
    if wanted:
        if shutil.which(wanted[0]) is None:
            raise BuildError(f"CC is {given!r}, but there is no program {wanted[0]!r} on the path")
        return tuple(wanted)
    for command in ("gcc", "cc", "clang"):
        if shutil.which(command):
            return (command,)
    if find_spec("ziglang") is not None:
        return ZIG
    raise BuildError(
        "no C compiler (gcc, cc or clang) on the path: install one with 'apt install gcc', 'dnf install gcc' or "
        "'xcode-select --install' ('brew install gcc'), or name one in the environment variable CC; without the rights "
        f"to do so, pip install '{DISTRIBUTION}[compiler]' brings one (package ziglang)"
    )


def environment(command: Sequence[str], folder: Path | None = None) -> dict[str, str]:
    """Return the environment of a compiler command.

    Temporary files go to the build folder, which is removed after killed builds. zig's cache goes to a temporary folder
    if zig could not write it anywhere else.
    """
    found = dict(os.environ)
    if folder is not None:
        found["TMPDIR"] = str(folder)
    if tuple(command[: len(ZIG)]) == ZIG and ZIG_CACHE not in found and not _zig_can_write():
        found[ZIG_CACHE] = str(temporary_directory() / "zig")
    return found


def ask(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a compiler with an option that makes it print facts about itself."""
    return subprocess.run(command, env=environment(command), capture_output=True, text=True, check=False)


def _zig_can_write() -> bool:
    """Return True if zig's folder in the user's cache can be created and written to."""
    try:
        folder = Path(user_cache_dir("zig"))
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: there is no home directory
        return False
    return os.access(folder, os.W_OK | os.X_OK)
