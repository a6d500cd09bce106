"""The name of a package is the stem of its files and the prefix of its C names, so that not every name is allowed."""

from __future__ import annotations

import re

from nmpc_codegen.errors import ProblemError

_KEYWORDS = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t char32_t class compl
    complex concept const consteval constexpr constinit const_cast continue co_await co_return co_yield decltype default
    delete do double dynamic_cast else enum explicit export extern false float for friend goto if imaginary inline int
    long mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public register
    reinterpret_cast requires restrict return short signed sizeof static static_assert static_cast struct switch
    template this thread_local throw true try typedef typeid typename typeof typeof_unqual union unsigned using virtual
    void volatile wchar_t while xor xor_eq"""
C_KEYWORDS = frozenset(_KEYWORDS.split())

_HEADERS = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
    stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
    alloca byteswap dirent endian features fcntl glob libintl malloc memory poll pthread regex sched search semaphore
    strings syslog termios unistd values windows intrin immintrin arm_acle arm_neon arm_math cmsis_gcc python"""

#: <name>.h would hide a header of the C library, the system or the processor.
HEADERS = frozenset(_HEADERS.split())

#: Files and folders next to <name>.c, and those that a build creates.
NEIGHBOURS = frozenset({"main", "readme", "cmakelists", "makefile", "license", "osqp", "wrapper"})

#: Targets that every CMake build has.
TARGETS = frozenset({"all", "clean", "help", "install", "preinstall", "edit_cache", "rebuild_cache"})

#: Windows opens a device instead of <name>.c.
DEVICES = frozenset({"con", "prn", "aux", "nul"} | {f"{port}{i}" for port in ("com", "lpt") for i in range(10)})

#: <unistd.h>, which Python.h includes, defines X_OK, the name that status OK of a package x would have; <locale.h>
#: defines LC_ALL, <sys/stat.h> STATX_ALL, <sys/wait.h> P_ALL, <signal.h> SIG_BLOCK.
MACROS = frozenset({"f", "r", "w", "x", "lc", "p", "sig", "statx"})

LONGEST = 60
_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def check_package_name(name: object, what: str) -> None:
    """Refuse a name whose files would hide or replace others; case is ignored, as some file systems ignore it.

    Raises:
        ProblemError: the name is not a string, not an ASCII identifier of at most 60 characters, or it is a header, a
            file next to the package's, a target of CMake, a device, or the prefix of a macro of the system.
    """
    if not isinstance(name, str):
        raise ProblemError(f"{what}: {name!r}; expected a string")
    if len(name) > LONGEST:
        raise ProblemError(f"{what} {name[:20]!r}... has {len(name)} characters; expected at most {LONGEST}")
    if not _IDENTIFIER.fullmatch(name):
        raise ProblemError(f"{what} {name!r}: expected a C identifier: an ASCII letter, then letters, digits and _")
    word = name.lower()
    reasons = (
        (HEADERS, f"a header, <{word}.h>, which {name}.h would hide"),
        (NEIGHBOURS, "taken by a file or folder beside the package's"),
        (TARGETS, "a target of every CMake build"),
        (DEVICES, "a device of Windows"),
        (MACROS, "the prefix of macros of the system (X_OK, LC_ALL)"),
    )
    for words, reason in reasons:
        if word in words:
            raise ProblemError(f"{what} {name!r} is {reason}; choose another, e.g. {f'{word}_mpc'!r}")
