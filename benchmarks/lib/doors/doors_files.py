"""Effects of export() on the files of a user: overwritten files, writes outside the folder, incomplete packages.

    python -m benchmarks.lib.doors.doors_files --json FILE

Every case is an export of a tiny problem, by Python or by the command line, into a folder of its own; the whole tree
around it (kinds, bytes, permissions, targets of links) is compared before and after.
"""

from __future__ import annotations

import contextlib
import io
import os
import socket
import stat
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.lib.doors import doors_faults
from benchmarks.lib.report import Report, arguments
from nmpc_codegen import OCP, NmpcError, Options, Osqp, export, generate
from nmpc_codegen.cli import main
from nmpc_codegen.runtime.folder import STAGING

PROBLEM = """\
from nmpc_codegen import OCP
ocp = OCP("tiny", T=1.0, N=1)
x, u = ocp.state("x", initial=1.0), ocp.control("u")
ocp.dynamics({x: u - x})
ocp.least_squares(ocp.x, weight=[1.0])
ocp.least_squares(u, weight=[0.5])
"""
FILES = ("tiny.h", "tiny.c", "tiny.json", "main.c", "CMakeLists.txt", "README.md")

Tree = dict[str, tuple[int, bytes]]


def tiny(name: str = "tiny", rate: float = 1.0) -> OCP:
    """x' = u - rate x; a different rate gives a different package."""
    ocp = OCP(name, T=1.0, N=1)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u - rate * x})
    ocp.least_squares(ocp.x, weight=[1.0])
    ocp.least_squares(u, weight=[0.5])
    return ocp


def tree(root: Path) -> Tree:
    """All entries below a folder: relative path -> kind and permissions, bytes of files and targets of links."""
    found: Tree = {}
    for path in root.rglob("*"):
        mode = path.lstat().st_mode
        data = b""
        if stat.S_ISREG(mode):
            data = path.read_bytes()
        elif stat.S_ISLNK(mode):
            data = os.readlink(path).encode()
        found[str(path.relative_to(root))] = (mode, data)
    return found


#: Message of the command line for a folder that is recognised as unusable before any work is done.
UNUSABLE = "error: --output "


@dataclass(frozen=True)
class Ways:
    """Export by Python and by the command line; each returns None, or the message of a refusal."""

    problem: Path

    def python(self, folder: str, name: str | None, force: bool) -> str | None:
        """export(); errors of other classes propagate."""
        try:
            export(tiny(), None, folder, name, force=force)
        except NmpcError as error:
            return str(error)
        return None

    def command(self, folder: str, name: str | None, force: bool) -> str | None:
        """nmpc-export in this process."""
        given = [str(self.problem), "-o", folder, *([] if name is None else ["--name", name])]
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main([*given, *(["--force"] if force else [])])
        text = err.getvalue()
        if status not in (0, 1, 2) or "Traceback" in text or "(-v shows where)" in text:
            raise AssertionError(f"exit status {status}: {text}")
        return text if status else None


@dataclass(frozen=True)
class Case:
    """``prepare(root)`` creates root/out and its surroundings. ``word``: part of the refusal's message; "": it works.

    If it works, only the files of the package in ``written`` may have changed.
    """

    name: str
    prepare: Callable[[Path], None]
    word: str
    force: bool = False
    package: str | None = None
    directory: str = "out"
    written: str = "out"


def outcome(case: Case, way: Callable[[str, str | None, bool], str | None], root: Path) -> str:
    """Description of the fault; "" if there is none."""
    case.prepare(root)
    before = tree(root)
    folder = case.directory if case.directory.startswith(("/", "\0")) else str(root / case.directory)
    try:
        message = way(folder, case.package, case.force)
    except (Exception, SystemExit) as error:
        return f"{type(error).__name__}: {error}"
    after = tree(root)
    if case.word:
        if message is None:
            return "not refused"
        told = " ".join(message.split())
        known = case.word in told or UNUSABLE in told
        return "changed" if before != after else "" if known else f"says {message}"
    if message is not None:
        return f"refused: {message}"
    stem = case.package or "tiny"
    ours = {f"{case.written}/{name.replace('tiny', stem)}" for name in FILES}
    folders = {case.written, *(str(path) for path in Path(case.written).parents)}
    others = [{p: f for p, f in found.items() if p not in ours | folders} for found in (before, after)]
    return "" if others[0] == others[1] and ours <= set(after) else "changed"


# -- files of the user ------------------------------------------------------------------------------------------------


def place(name: str, data: bytes = b"mine\n") -> Callable[[Path], None]:
    """A user's file root/out/<name>."""

    def prepare(root: Path) -> None:
        (root / "out").mkdir(exist_ok=True)
        (root / "out" / name).write_bytes(data)

    return prepare


def exported(change: Callable[[Path], None] = lambda folder: None, name: str = "tiny") -> Callable[[Path], None]:
    """An earlier package with another rate in root/out, then a change, next to unrelated files."""

    def prepare(root: Path) -> None:
        export(tiny(rate=2.0), None, root / "out", name)
        (root / "out" / "notes.txt").write_text("mine\n", encoding="utf-8")
        (root / "out" / "tiny_main.c").write_text("mine\n", encoding="utf-8")
        change(root / "out")

    return prepare


def edit(name: str, how: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Change the bytes of a file of the package."""
    return lambda folder: (folder / name).write_bytes(how((folder / name).read_bytes())) and None


def without_seals(folder: Path) -> None:
    """Remove the seals, as in packages written by versions without them."""
    for path in (folder / name for name in FILES):
        lines = path.read_bytes().splitlines(keepends=True)
        path.write_bytes(b"".join(line for line in lines if b"nmpc_codegen package" not in line))


EDITS: dict[str, Callable[[bytes], bytes]] = {
    "a line more": lambda data: data + b"\n",
    "one byte": lambda data: data.replace(b"tiny", b"tinY", 1),
    "line ends": lambda data: data.replace(b"\n", b"\r\n"),
    "emptied": lambda data: b"",
    "seal removed": lambda data: data[: data.rindex(b"sha256 ")],
    "sealed twice": lambda data: data + data,
}


def overwrites() -> Iterator[Case]:
    """User files in the folder, and exports that must still work next to them."""
    for name in FILES:
        yield Case(f"user's {name}", place(name), "not written by export()")
        yield Case(f"user's empty {name}", place(name, b""), "not written by export()")
        yield Case(f"user's binary {name}", place(name, bytes(range(256))), "not written by export()")
        yield Case(f"user's {name}, force", place(name), "", force=True)
        yield Case(f"read-only {name}", exported(lambda f, n=name: (f / n).chmod(0o444)), "read-only")  # type: ignore[misc]
        for what, how in EDITS.items():
            yield Case(f"{name}: {what}", exported(edit(name, how)), name)
    yield Case("package without seals", exported(without_seals), "older version")
    yield Case("package without seals, force", exported(without_seals), "", force=True)
    yield Case("new folder", lambda root: None, "")
    yield Case("new folder, parents missing", lambda root: (root / "a").mkdir(), "", directory="a/b/c", written="a/b/c")
    yield Case("again, another problem", exported(), "")
    yield Case("second package", exported(), "", package="tiny_b")
    yield Case("second package, main.c edited", exported(edit("main.c", EDITS["one byte"])), "main.c", package="tiny_b")
    yield Case("beside a user's other files", place("mine.c"), "")


# -- ways out of the folder -------------------------------------------------------------------------------------------


def outside(root: Path) -> Path:
    """A file and a folder of the user next to root/out."""
    (root / "out").mkdir(exist_ok=True)
    (root / "home" / "folder").mkdir(parents=True)
    (root / "home" / "file").write_text("mine\n", encoding="utf-8")
    return root / "home"


def link(name: str, target: str) -> Callable[[Path], None]:
    """root/out/<name> links to a path relative to root/home."""
    return lambda root: (root / "out" / name).symlink_to(outside(root) / target)


def hard_link(name: str, sealed_one: bool) -> Callable[[Path], None]:
    """root/out/<name> and root/home/file are the same file."""

    def prepare(root: Path) -> None:
        home = outside(root)
        if sealed_one:
            (home / "file").write_text(generate(tiny(rate=2.0))[name], encoding="utf-8")
        os.link(home / "file", root / "out" / name)

    return prepare


def strange(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    """An entry that is not a regular file in the place of a file."""

    def prepare(root: Path) -> None:
        (root / "out").mkdir()
        make(root / "out" / name)

    return prepare


def bound_socket(path: Path) -> None:
    """A socket in the file system; its name is relative because sockets do not allow long names."""
    here = os.getcwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(path.name)
    finally:
        os.chdir(here)


def links() -> Iterator[Case]:
    """Links and other entries in the place of a file or of the folder."""
    for name in FILES:
        yield Case(f"{name} -> file", link(name, "file"), "is a link")
        yield Case(f"{name} -> file, force", link(name, "file"), "is a link", force=True)
        yield Case(f"{name} -> nothing", link(name, "nothing"), "is a link", force=True)
        yield Case(f"{name} hard link, sealed", hard_link(name, True), "")
        yield Case(f"{name} hard link, force", hard_link(name, False), "", force=True)
        yield Case(f"{name} is a folder", strange(name, os.mkdir), "is a folder", force=True)
        yield Case(f"{name} is a pipe", strange(name, os.mkfifo), "is a pipe", force=True)
        yield Case(f"{name} is a socket", strange(name, bound_socket), "device or socket", force=True)
    yield Case("main.c -> folder", link("main.c", "folder"), "is a link", force=True)
    yield Case("main.c -> itself", lambda root: (root / "out").mkdir() or (root / "out/main.c").symlink_to("main.c"), "is a link")  # type: ignore[func-returns-value]  # fmt: skip  # noqa: E501
    yield Case("staging -> folder", link(STAGING, "folder"), "in the way", force=True)
    yield Case("staging is the user's", strange(f"{STAGING}/mine", lambda p: os.makedirs(p)), "did not write")
    yield Case("folder -> folder", lambda root: (root / "out").symlink_to(outside_folder(root)), "", written="home/folder")  # fmt: skip  # noqa: E501
    yield Case("folder -> nothing", lambda root: (root / "out").symlink_to(root / "nothing"), "link to nothing")
    yield Case("folder -> itself", lambda root: (root / "out").symlink_to("out"), "link to nothing")
    yield Case("folder is a file", lambda root: (root / "out").write_text("mine\n") and None, "is no folder")
    yield Case("parent is a file", lambda root: (root / "up").write_text("mine\n") and None, "cannot be created", directory="up/out")  # fmt: skip  # noqa: E501
    for text, word in (
        ("\0", "expected the path"),
        ("/dev/null", "is no folder"),
        ("/dev/full/out", "cannot be created"),
    ):
        yield Case(f"folder {text!r}", lambda root: None, word, directory=text)
    yield Case("folder of 300 letters", lambda root: None, "too long", directory="x" * 300)
    yield Case("folder in /proc", lambda root: None, "/proc/nmpc_codegen", directory="/proc/nmpc_codegen")


def outside_folder(root: Path) -> Path:
    """home/folder, without root/out."""
    home = outside(root)
    (root / "out").rmdir()
    return home / "folder"


NAMES = (
    *("../x", "a/b", "/etc/x", "a\\b", "a\0b", "a\nb", "a\n", "", " ", ".", "..", "a.b", "a-b", "a b", "~", "$HOME"),
    *("\u0430bc", "kran\u00fc", "\uff41bc", "a\u200b", "1st", "_x", "-o", "x" * 61, "x" * 5000),
    *("main", "Main", "MAIN", "readme", "README", "cmakelists", "CMakeLists", "osqp", "OSQP", "wrapper", "makefile"),
    *("math", "Math", "string", "stdint", "stdio", "stdlib", "errno", "assert", "complex", "float", "limits", "time"),
    *("con", "CON", "nul", "aux", "prn", "com1", "LPT9", "p", "P", "lc", "sig", "clean"),
    *("x", "X", "r", "statx"),
)


def names() -> Iterator[Case]:
    """Package names that must be refused. The message names them, or their length."""
    for name in NAMES:
        yield Case(f"name {name[:12]!r}", lambda root: (root / "out").mkdir(), "name", package=name)


def refused_names() -> list[str]:
    """Names that OCP() does not refuse by itself."""
    wrong = []
    for name in NAMES:
        try:
            tiny(name)
        except NmpcError:
            continue
        wrong.append(name)
    return wrong


def folder_of_foreign_code(root: Path, kind: str) -> str:
    """The code of OSQP needs a sub-folder, which is a link or contains one; "" if refused without changes."""
    home = outside(root)
    if kind == "osqp":
        (root / "out" / "osqp").symlink_to(home / "folder")
    else:
        (root / "out" / "osqp").mkdir()
        (root / "out" / "osqp" / "src").symlink_to(home / "folder")
    before = tree(root)
    try:
        export(tiny(), Options(qp=Osqp()), root / "out", allow_foreign=True, force=True)
    except NmpcError as error:
        return "" if "is a link" in str(error) and tree(root) == before else "changed"
    return "not refused"


# -- the figures ------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def fresh() -> Iterator[Path]:
    """A folder for one case."""
    with tempfile.TemporaryDirectory(prefix="doors-") as root:
        yield Path(root)


def run(cases: Iterator[Case], ways: Ways) -> tuple[int, dict[str, str]]:
    """Number of cases, and the faults of the cases that misbehave."""
    wrong, count = {}, 0
    for case in cases:
        for way in (ways.python, ways.command):
            if way == ways.command and case.package is not None and "\0" in case.package:
                continue  # no program can receive such an argument
            count += 1
            with fresh() as root:
                found = outcome(case, way, root)
            if found:
                wrong[f"{case.name} ({way.__name__})"] = found
    return count, wrong


def add(report: Report, key: str, count: int, wrong: dict[str, str]) -> None:
    """A line with the count, and one for every case that misbehaves."""
    report.add(key, len(wrong), "cases", case="all", n=count, limit=0)
    for case, found in wrong.items():
        report.add(key, 1, "case", case=f"{case}: {' '.join(found.split())[:80]}", n=1, limit=0)


def measure(report: Report) -> None:
    """overwrites, escapes, half_written: cases in which a user file or the folder was damaged."""
    with fresh() as place_of_problem:
        problem = place_of_problem / "problem.py"
        problem.write_text(PROBLEM, encoding="utf-8")
        ways = Ways(problem)
        add(report, "overwrites", *run(overwrites(), ways))
        count, wrong = run((case for group in (links(), names()) for case in group), ways)
    wrong |= {f"OCP({name[:12]!r})": "not refused" for name in refused_names()}
    for kind in ("osqp", "osqp/src"):
        with fresh() as root:
            found = folder_of_foreign_code(root, kind)
        wrong |= {f"{kind} -> folder": found} if found else {}
    add(report, "escapes", count + len(NAMES) + 2, wrong)
    with doors_faults.generated_once():
        add(report, "half_written", *doors_faults.run(tiny, tree, fresh))


if __name__ == "__main__":
    options = arguments(__doc__ or "")
    figures = Report("Files of the user")
    measure(figures)
    figures.print()
    if options.json:
        figures.write(options.json)
