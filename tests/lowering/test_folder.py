"""folder.py, seal.py, naming.py: an export replaces only files that it wrote, and every file is old or new."""

from __future__ import annotations

import errno
import multiprocessing
import os
import resource
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from nmpc_codegen import (
    OCP,
    BuildError,
    ExportError,
    NmpcError,
    OptionError,
    ProblemError,
    export,
    generate,
    open_package,
)
from nmpc_codegen.cli import main
from nmpc_codegen.ir.cmodule import check_prefix
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.lowering.beside.folder import TEMPORARY, write
from nmpc_codegen.package.seal import has_seal, intact, package_of, seal


def tiny(name: str = "tiny", rate: float = 1.0) -> OCP:
    """x' = u - rate x; a different rate gives a different package."""
    ocp = OCP(name, T=1.0, N=1)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u - rate * x})
    ocp.least_squares(ocp.x, weight=[1.0])
    ocp.least_squares(u, weight=[0.5])
    return ocp


def texts(version: str) -> dict[str, str]:
    """A package in miniature."""
    plain = {"a.h": f"int {version};\n", "a.c": f"int {version};\n", "a.json": f'{{\n "v": "{version}"\n}}\n'}
    plain |= {"main.c": f"int main_{version};\n", "README.md": f"# {version}\n", "CMakeLists.txt": f"x({version})\n"}
    return seal({**plain, "osqp/x.c": f"int x_{version};\n"}, "a")


OLD, NEW = texts("old"), texts("new")


def contents(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): p.read_text(encoding="utf-8") for p in folder.rglob("*") if p.is_file()}


# -- seals ------------------------------------------------------------------------------------------------------------


def test_every_file_is_sealed_and_every_byte_counts() -> None:
    for path, text in NEW.items():
        data = text.encode()
        assert intact(data), path
        for i in range(len(data)):
            assert not intact(data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :]), (path, i)
        assert not intact(data[:-1])
        assert not intact(data + b"\n")
        assert not intact(data * 2)
        assert has_seal(data * 2)
    assert len({package_of(text) for text in NEW.values()}) == 1
    assert package_of(OLD["a.h"]) != package_of(NEW["a.h"])
    assert package_of("int a;") is None
    assert all(intact(text.encode()) for text in generate(tiny()).values())


# -- files of the user ------------------------------------------------------------------------------------------------


def test_a_new_version_replaces_the_old_one_beside_other_files(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    write(folder, OLD)
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    (folder / "a.c").chmod(0o640)
    unchanged = (folder / "README.md").stat()
    write(folder, {**NEW, "README.md": OLD["README.md"]})
    assert contents(folder) == {**NEW, "README.md": OLD["README.md"], "notes.txt": "mine"}
    assert (folder / "README.md").stat().st_mtime_ns == unchanged.st_mtime_ns
    assert (folder / "a.c").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("text", ["mine\n", "", OLD["main.c"] + "\n"], ids=["own", "empty", "edited"])
def test_a_main_of_the_user_stays(text: str, tmp_path: Path) -> None:
    write(tmp_path, OLD)
    (tmp_path / "main.c").write_text(text, encoding="utf-8")
    with pytest.warns(UserWarning, match=r"main\.c: (edited|not written).*left as it is.*--force"):
        write(tmp_path, NEW)
    assert contents(tmp_path) == {**NEW, "main.c": text}


def test_other_files_are_refused_by_name_and_force_keeps_copies(tmp_path: Path) -> None:
    write(tmp_path, OLD)
    edited = OLD["a.c"].replace("old", "01d")
    (tmp_path / "a.c").write_text(edited, encoding="utf-8")
    (tmp_path / "README.md").write_text("mine", encoding="utf-8")
    (tmp_path / "a.h").chmod(0o444)
    before = contents(tmp_path)
    with pytest.raises(
        ExportError, match=r"a\.h \(read-only\), a\.c \(edited .*README\.md \(not written .*--force"
    ) as caught:
        write(tmp_path, NEW)
    assert isinstance(caught.value, NmpcError)
    assert contents(tmp_path) == before
    write(tmp_path, NEW, force=True)
    copies = {"a.c.bak": edited, "README.md.bak": "mine", "a.h.bak": OLD["a.h"]}
    assert contents(tmp_path) == {**NEW, **copies}
    (tmp_path / "a.c").write_text("again", encoding="utf-8")
    (tmp_path / "a.c.bak1").symlink_to(tmp_path.parent / "nowhere")
    write(tmp_path, NEW, force=True)
    assert contents(tmp_path) == {**NEW, **copies, "a.c.bak2": "again"}
    assert not (tmp_path.parent / "nowhere").exists()


@pytest.mark.parametrize("name", ["a.c", "main.c"])
def test_an_edit_during_the_export_is_not_lost(name: str, tmp_path: Path) -> None:
    write(tmp_path, OLD)
    with pytest.MonkeyPatch.context() as patch:
        failing(patch, 0, lambda: (tmp_path / name).write_text("mine", encoding="utf-8") and None)
        with pytest.raises(ExportError, match=f"{name}: has changed during the export"):
            write(tmp_path, NEW)
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"
    assert not [path for path in contents(tmp_path) if path.endswith(TEMPORARY)]


def test_by_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = tmp_path / "problem.py"
    problem.write_text(
        'from nmpc_codegen import OCP\nocp = OCP("tiny", T=1.0, N=1)\nx, u = ocp.state("x"), ocp.control("u")\n'
        "ocp.dynamics({x: u - x})\nocp.least_squares(ocp.x, weight=[1.0])\n",
        encoding="utf-8",
    )
    arguments = [str(problem), "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    for name in ("main.c", "tiny.c"):
        (tmp_path / "out" / name).write_text("mine", encoding="utf-8")
    capsys.readouterr()
    assert main(arguments) == 1
    assert "tiny.c (not written by export())" in capsys.readouterr().err
    (tmp_path / "out" / "tiny.c").unlink()
    assert main(arguments) == 0
    assert "main.c: not written by export(); left as it is" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "out" / "main.c").read_text(encoding="utf-8") == "mine"
    assert main([*arguments, "--force"]) == 0
    assert (tmp_path / "out" / "main.c.bak").read_text(encoding="utf-8") == "mine"


# -- ways out of the folder -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("name", ["a.c", "main.c", "osqp"])
@pytest.mark.parametrize("kind", ["link", "link to nothing", "folder", "pipe"])
def test_what_is_no_plain_file_is_refused(kind: str, name: str, force: bool, tmp_path: Path) -> None:
    """Nothing is written through a link, and nothing else is written either."""
    home, folder = tmp_path / "home", tmp_path / "out"
    (home / "folder").mkdir(parents=True)
    (home / "file").write_text("mine", encoding="utf-8")
    folder.mkdir()
    place = folder / name
    if kind == "folder" and name == "osqp":
        place /= "x.c"
        place.parent.mkdir()
    match kind:
        case "link":
            place.symlink_to(home / ("folder" if name == "osqp" else "file"))
        case "link to nothing":
            place.symlink_to(home / "nothing")
        case "folder":
            place.mkdir()
        case "pipe":
            os.mkfifo(place)
    with pytest.raises(ExportError, match=f"{place.name}: is a {kind.split()[0]}"):
        write(folder, NEW, force=force)
    assert contents(home) == {"file": "mine"}
    assert not (folder / "a.h").exists()


@pytest.mark.parametrize("path", ["../x.c", "/x.c", "osqp/../../x.c", "", "a\0.c"])
def test_components_stay_in_the_folder(path: str, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="outside of the folder"):
        write(tmp_path / "out", {path: "x"}, force=True)
    assert not contents(tmp_path)


@pytest.mark.parametrize(
    ("directory", "force"), [(3, False), (b"x", False), (None, False), ("", False), (".", "no"), ("\0", False)]
)
def test_arguments_of_wrong_types(directory: object, force: object) -> None:
    with pytest.raises(OptionError, match=r"directory|force"):
        write(directory, {}, force=force)  # type: ignore[arg-type]


@pytest.mark.parametrize("directory", ["/dev/null", "/dev/full/out", "x" * 300, "/proc/nmpc_codegen"])
def test_folders_that_cannot_be(directory: str) -> None:
    with pytest.raises(ExportError, match=directory[:20]):
        write(directory, NEW)


# -- failures ---------------------------------------------------------------------------------------------------------


def failing(patch: pytest.MonkeyPatch, at: int, act: Callable[[], None]) -> None:
    """The at-th call that writes or renames a file acts instead."""
    count = iter(range(10**6))
    for name in ("fsync", "replace"):
        real = getattr(os, name)

        def call(*arguments: object, real: Callable[..., object] = real) -> object:
            if next(count) == at:
                act()
            return real(*arguments)

        patch.setattr(os, name, call)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO, 0])
@pytest.mark.parametrize("start", ["new", "old"])
def test_a_failure_anywhere(error: int, start: str, tmp_path: Path) -> None:
    """While files are written the folder is unchanged; while they are renamed each of them is old or new."""

    def act() -> None:
        if error == 0:
            raise KeyboardInterrupt
        raise OSError(error, os.strerror(error))

    for at in range(2 * len(NEW)):
        folder = tmp_path / str(at)
        if start == "old":
            write(folder, OLD)
        before = contents(folder)
        with pytest.MonkeyPatch.context() as patch:
            failing(patch, at, act)
            with pytest.raises((ExportError, KeyboardInterrupt)):
                write(folder, NEW)
        after = contents(folder)
        assert after == before or at >= len(NEW)
        assert all(text in (before.get(path), NEW[path]) for path, text in after.items())
        write(folder, NEW)
        assert contents(folder) == NEW


def in_a_child(work: Callable[[], None]) -> int:
    """Exit status of a process: 0 done, 1 ExportError, 2 another error, -9 killed."""
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


@pytest.mark.few(2)
@pytest.mark.parametrize("at", [0, 3, 7, 9, 13])
def test_killed(at: int, tmp_path: Path) -> None:
    """kill -9: every file is whole, open_package() refuses a mixture, the next export is complete."""
    export(tiny(rate=2.0), None, tmp_path)
    old, new = contents(tmp_path), generate(tiny())

    def work() -> None:
        with pytest.MonkeyPatch.context() as patch:
            failing(patch, at, lambda: os.kill(os.getpid(), signal.SIGKILL))
            export(tiny(), None, tmp_path)

    assert in_a_child(work) in (-signal.SIGKILL, 0)
    after = {path: text for path, text in contents(tmp_path).items() if not path.endswith(TEMPORARY)}
    assert after.keys() == old.keys()
    assert all(text in (old[path], new[path]) for path, text in after.items())
    if len({package_of(after[f"tiny.{ext}"]) for ext in ("h", "c", "json")}) > 1:
        with pytest.raises(BuildError, match="come from different exports"):
            open_package(tmp_path)
    export(tiny(), None, tmp_path)
    assert contents(tmp_path) == new
    (tmp_path / f"tiny.h{TEMPORARY}").write_text("left", encoding="utf-8")
    export(tiny(), None, tmp_path)
    assert contents(tmp_path) == new


@pytest.mark.parametrize("limit", [0, 700, 14_000])
def test_full_disk(limit: int, tmp_path: Path) -> None:
    """The kernel refuses to make a file longer than the limit."""
    export(tiny(rate=2.0), None, tmp_path)
    before = contents(tmp_path)

    def work() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        export(tiny(), None, tmp_path)

    assert in_a_child(work) == 1
    assert contents(tmp_path) == before


def test_a_folder_of_another_user(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    (tmp_path / "out").mkdir(mode=0o555)

    def work() -> None:
        if os.getuid() == 0:
            os.setuid(65534)
        write(tmp_path / "out", NEW)

    assert in_a_child(work) == 1
    assert not contents(tmp_path)


def export_many(folder: Path, version: str) -> None:
    for _ in range(30):
        write(folder, texts(version))


def test_two_exports_at_once_do_not_mix(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    both = [context.Process(target=export_many, args=(tmp_path, version)) for version in ("old", "new")]
    for process in both:
        process.start()
    for process in both:
        process.join(30)
    assert [process.exitcode for process in both] == [0, 0]
    assert contents(tmp_path) in (OLD, NEW)


def test_open_package_refuses_a_mixture(tmp_path: Path) -> None:
    export(tiny(), None, tmp_path)
    (tmp_path / "tiny.h").write_text(generate(tiny(rate=3.0))["tiny.h"], encoding="utf-8")
    with pytest.raises(BuildError, match="come from different exports"):
        open_package(tmp_path)


def test_open_package_cannot_read(tmp_path: Path) -> None:
    export(tiny(), None, tmp_path)
    (tmp_path / "tiny.h").write_bytes(b"\xff\xfe")
    with pytest.raises(BuildError, match=r"tiny\.h is not UTF-8 text"):
        open_package(tmp_path)


# -- names ------------------------------------------------------------------------------------------------------------


#: Names that would hide files, headers, devices or each other.
NAMES = (
    *("../x", "a/b", "/etc/x", "a\\b", "a\0b", "a\nb", "a\n", "", " ", ".", "..", "a.b", "a-b", "a b", "~", "$HOME"),
    *("\u0430bc", "kran\u00fc", "\uff41bc", "a\u200b", "1st", "_x", "-o", "x" * 61, "x" * 5000),
    *("main", "Main", "MAIN", "readme", "README", "cmakelists", "CMakeLists", "osqp", "OSQP", "wrapper", "makefile"),
    *("math", "Math", "string", "stdint", "stdio", "stdlib", "errno", "assert", "complex", "float", "limits", "time"),
    *("con", "CON", "nul", "aux", "prn", "com1", "LPT9", "p", "P", "lc", "sig", "clean"),
    *("x", "X", "r", "statx"),
)


@pytest.mark.parametrize(
    "door", [tiny, check_prefix, lambda name: generate(tiny(), name=name)], ids=("OCP", "prefix", "name")
)
def test_names_that_hide_files(door: Callable[[str], object]) -> None:
    for name in NAMES:
        with pytest.raises(ProblemError, match="name"):
            door(name)


def test_names_that_are_fine() -> None:
    for name in ("a", "crane", "crane_f32", "math_mpc", "main_loop", "printf", "x" * 60, "com", "com10"):
        check_package_name(name, "name")
        check_prefix(name)
