"""Any exception becomes a message in one line: where it was raised, its type and its text."""

from __future__ import annotations

import inspect
import re
import traceback
from pathlib import Path
from pkgutil import resolve_name

from nmpc_codegen.errors import NmpcError

#: Longer messages, e.g. of other libraries, are cut.
LONGEST = 1000

_UNKNOWN = re.compile(r"([\w.]+)\(\) got an unexpected keyword argument")

PACKAGE = Path(__file__).resolve().parents[1]


def printable(text: str) -> str:
    """Return the text with control characters and other unprintable characters escaped."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def one_line(text: str) -> str:
    """Return the text without line breaks and unprintable characters; very long texts are cut."""
    joined = " ".join(text.split())
    return printable(joined if len(joined) <= LONGEST else joined[:LONGEST] + " ...")


def message(error: BaseException, file: str | None) -> str:
    """Return the line to print for an exception that ended the run.

    ``file`` is the problem file as the user named it.
    """
    try:
        return one_line(_message(error, file))
    except Exception:  # even reading an exception may fail
        return one_line(f"{file}: an exception that cannot be printed (-v shows where)")


def _message(error: BaseException, file: str | None) -> str:
    kind = type(error).__name__
    absolute = str(Path(file).absolute()) if file else None
    frames = [(frame.f_code.co_filename, line) for frame, line in traceback.walk_tb(error.__traceback__)]
    lines = [line for name, line in frames if name == absolute]
    place = f"{file}, line {lines[-1]}: " if lines else f"{file}: " if file else ""
    if isinstance(error, SyntaxError) and absolute and error.filename == absolute:
        line = "" if error.lineno is None else f", line {error.lineno}"
        return f"{file}{line}: {kind}: {error.msg}"
    if isinstance(error, SystemExit):
        status = 0 if error.code is None else _text(error)
        return f"{place}the file ended the program (exit status {status}) instead of stating a problem"
    if isinstance(error, KeyboardInterrupt):
        return f"{place if lines else ''}interrupted"
    if isinstance(error, NmpcError):
        return f"{place if lines else ''}{kind}: {_text(error)}"
    if isinstance(error, OSError) and error.strerror and not lines:
        return f"{kind}: {error.filename or file}: {error.strerror}"
    return f"{place}{kind}: {_text(error)}{_keywords(error)}" + ("" if lines else f"{_stage(frames)} (-v shows where)")


def _keywords(error: BaseException) -> str:
    """Return the keywords of a function of this package that was called with an unknown one."""
    found = _UNKNOWN.match(_text(error)) if isinstance(error, TypeError) else None
    if found is None:
        return ""
    try:
        function = resolve_name(f"nmpc_codegen:{found[1].removesuffix('.__init__')}")
    except (AttributeError, ImportError):
        return ""
    names = [name for name in inspect.signature(function).parameters if name != "self"]
    return f"; expected {', '.join(names)}"


def _text(error: BaseException) -> str:
    """Return the text of an exception, or a note that it is empty or cannot be read."""
    try:
        text = str(error)
    except Exception:
        return "its message cannot be read"
    return text if text.strip() else "no message"


def _stage(frames: list[tuple[str, int]]) -> str:
    """Return the module of this package in which the exception was raised."""
    ours = [Path(name) for name, _ in frames if PACKAGE in Path(name).parents]
    return f", in {ours[-1].relative_to(PACKAGE.parent)}" if ours else ""
