"""Exports that fail at each of their writes and renames: the disk is full, a call fails, the process is killed."""

from __future__ import annotations

import builtins
import errno
import os
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nmpc_codegen import OCP, BuildError, ExportError, compiler, export, open_package
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.render import Sources
from nmpc_codegen.runtime.folder import STAGING
from nmpc_codegen.runtime.seal import package_of

Tree = dict[str, tuple[int, bytes]]
Make = Callable[..., OCP]

CALLS = ("replace", "link", "fsync", "mkdir", "chmod", "unlink", "rmdir")
LIMITS = (0, 1, 700, 4_000, 14_000, 30_000, 100_000)  # limit of the kernel on the size of a file, in bytes


@dataclass
class Fault:
    """Counts calls that change the disk, and acts before or after the call with number ``at``."""

    at: int
    act: Callable[[], None]
    after: bool = False
    seen: list[str] = field(default_factory=list)

    def around(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """The call, with counting."""

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            self.seen.append(name)
            hit = len(self.seen) - 1 == self.at
            if hit and not self.after:
                self.act()
            result = call(*args, **kwargs)
            if hit and self.after:
                self.act()
            return result

        return wrapped

    def opened(self, *args: Any, **kwargs: Any) -> Any:
        """open(), which itself fails, or whose write() fails after the first half of the data."""
        if len(args) < 2 or "x" not in args[1]:
            return _OPEN(*args, **kwargs)
        file = self.around("open", _OPEN)(*args, **kwargs)
        half = file.write
        return _Writer(file, self.around("write", half))


class _Writer:
    """A file with another write(); a failing write leaves half of the data."""

    def __init__(self, file: Any, write: Callable[..., Any]) -> None:
        self.file, self.counted = file, write

    def write(self, data: bytes) -> None:
        self.file.write(data[: len(data) // 2])
        self.file.flush()
        self.counted(data[len(data) // 2 :])

    def __enter__(self) -> _Writer:
        return self

    def __exit__(self, *error: object) -> None:
        self.file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)


_OPEN = builtins.open


@contextmanager
def injected(fault: Fault) -> Iterator[None]:
    """Route all calls of export() that change the disk through the fault."""
    before = {name: getattr(os, name) for name in CALLS}
    try:
        for name, call in before.items():
            setattr(os, name, fault.around(name, call))
        builtins.open = fault.opened
        yield
    finally:
        builtins.open = _OPEN
        for name, call in before.items():
            setattr(os, name, call)


def prepare(start: str, tiny: Make, folder: Path) -> None:
    """The folder before the export: missing, an older package, or user files that force replaces."""
    if start == "new":
        return
    export(tiny(rate=2.0), None, folder)
    (folder / "notes.txt").write_text("mine\n", encoding="utf-8")
    if start == "force":
        for name in ("main.c", "tiny.c"):
            (folder / name).write_text("mine\n", encoding="utf-8")


def rewrite(start: str, tiny: Make, folder: Path) -> None:
    """The export that will fail."""
    export(tiny(), None, folder, force=start == "force")


def failing(number: int) -> Callable[[], None]:
    """Raise this error of the operating system, or KeyboardInterrupt for 0."""

    def act() -> None:
        if number == 0:
            raise KeyboardInterrupt
        raise OSError(number, os.strerror(number))

    return act


def after_error(start: str, tiny: Make, root: Path, look: Callable[[Path], Tree], fault: Fault, wanted: Tree) -> str:
    """An export with one failure must change nothing or be complete; "" if so, else the fault."""
    folder = root / "out"
    prepare(start, tiny, folder)
    before = look(root)
    try:
        with injected(fault):
            rewrite(start, tiny, folder)
    except (ExportError, KeyboardInterrupt) as error:
        said = str(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    else:
        return "" if look(root) == wanted else "went on, and is not complete"
    after = look(root)
    if after in (before, wanted):
        return ""
    rest = {path: found for path, found in after.items() if STAGING not in path}
    # Only the removal of leftovers failed: the message has to name them.
    return "" if rest in (before, wanted) and (STAGING in said or not said) else "half written"


def child(work: Callable[[], None]) -> int:
    """Exit status of a process that performs the export: 0 done, 1 ExportError, 2 another error, -9 killed."""
    process = os.fork()
    if process == 0:
        status = 2
        try:
            work()
            status = 0
        except ExportError:
            status = 1
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def after_kill(start: str, tiny: Make, root: Path, look: Callable[[Path], Tree], fault: Fault, wanted: Tree) -> str:
    """kill -9: every file is whole, open_package() refuses a mixture, the next export is complete; "" if so."""
    folder = root / "out"
    prepare(start, tiny, folder)
    before = look(root)

    def work() -> None:
        with injected(fault):
            rewrite(start, tiny, folder)

    if child(work) != -signal.SIGKILL:
        return "not killed"
    after = {path: found for path, found in look(root).items() if STAGING not in path}
    if any(after[path] not in (before.get(path), wanted.get(path)) for path in after) or set(before) - set(after):
        return "a file is neither old nor new"
    texts = [after.get(f"out/tiny.{ext}", (0, b""))[1].decode() for ext in ("h", "c", "json")]
    if len({package_of(text) for text in texts}) > 1:
        try:
            open_package(folder)
        except BuildError:
            pass
        else:
            return "open_package() takes a mixture"
    export(tiny(), None, folder, force=True)
    return "" if look(root) == wanted else "the next export is not complete"


def full_disk(start: str, tiny: Make, root: Path, look: Callable[[Path], Tree], limit: int) -> str:
    """The kernel refuses to make a file longer than ``limit``; "" if the folder is unchanged."""
    prepare(start, tiny, root / "out")
    before = look(root)

    def work() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        rewrite(start, tiny, root / "out")

    status = child(work)
    return "" if status == 1 and look(root) == before else f"status {status}, or half written"


def unwritable(tiny: Make, root: Path, look: Callable[[Path], Tree]) -> str:
    """A folder of another user; root becomes nobody for this case. "" if the export is refused."""
    root.chmod(0o755)
    (root / "out").mkdir(mode=0o555)
    before = look(root)

    def work() -> None:
        if os.getuid() == 0:
            os.setuid(65534)
        rewrite("old", tiny, root / "out")

    status = child(work)
    return "" if status == 1 and look(root) == before else f"status {status}, or changed"


@contextmanager
def generated_once() -> Iterator[None]:
    """export() takes the texts of equal problems from a store: as only the writing is tested here."""
    modules: dict[str, CModule] = {}
    texts: dict[int, Sources] = {}
    compiled, render = compiler.compiled, compiler.render

    def stored(ocp: OCP, *rest: Any) -> CModule:
        key = str((ocp.derivatives, *rest))
        if key not in modules:
            modules[key] = compiled(ocp, *rest)
            texts[id(modules[key])] = render(modules[key])
        return modules[key]

    compiler.compiled, compiler.render = stored, lambda module: texts[id(module)]
    try:
        yield
    finally:
        compiler.compiled, compiler.render = compiled, render


def run(
    tiny: Make, look: Callable[[Path], Tree], fresh: Callable[[], AbstractContextManager[Path]]
) -> tuple[int, dict[str, str]]:
    """Number of injected failures, and the failures after which the folder was in a wrong state."""
    count, wrong = 0, {}

    def note(case: str, found: str) -> None:
        nonlocal count
        count += 1
        if found:
            wrong[case] = found

    for start in ("new", "old", "force"):
        with fresh() as root:
            prepare(start, tiny, root / "out")
            calls = Fault(-1, lambda: None)
            with injected(calls):
                rewrite(start, tiny, root / "out")
            wanted = look(root)
        for at, name in enumerate(calls.seen):
            for number, late in ((errno.ENOSPC, False), (errno.EIO, True), (0, True)):
                with fresh() as root:
                    found = after_error(start, tiny, root, look, Fault(at, failing(number), late), wanted)
                note(f"{start}: {errno.errorcode.get(number, 'interrupt')} at call {at} ({name})", found)
            for late in (False, True):
                with fresh() as root:
                    fault = Fault(at, lambda: os.kill(os.getpid(), signal.SIGKILL), late)
                    found = after_kill(start, tiny, root, look, fault, wanted)
                note(f"{start}: killed at call {at} ({name}, {late})", found)
        for limit in LIMITS:
            with fresh() as root:
                found = full_disk(start, tiny, root, look, limit)
            note(f"{start}: files of {limit} bytes", found)
    with fresh() as root:
        note("unwritable folder", unwritable(tiny, root, look))
    return count, wrong
