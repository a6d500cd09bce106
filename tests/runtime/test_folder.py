"""folder.py, seal.py, naming.py: an export replaces only files that it wrote, all or none, in its folder."""

from __future__ import annotations

import errno
import multiprocessing
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.lib.doors import doors_faults, doors_files
from benchmarks.lib.doors.doors_files import NAMES, Case, Ways, outcome, tiny, tree
from nmpc_codegen import BuildError, ExportError, NmpcError, OptionError, ProblemError, export, generate, open_package
from nmpc_codegen.ir.cmodule import check_prefix
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.runtime.folder import STAGING, write
from nmpc_codegen.runtime.seal import has_seal, intact, package_of, sealed


def texts(version: str) -> dict[str, str]:
    """A package in miniature."""
    plain = {"a.h": f"int {version};\n", "a.c": f"int {version};\n", "a.json": f'{{\n "v": "{version}"\n}}\n'}
    return sealed({**plain, "main.c": "int main;\n", "README.md": "# a\n", "CMakeLists.txt": "x()\n"}, "a")


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


def test_seals_are_those_of_generate() -> None:
    assert all(intact(text.encode()) for text in generate(tiny()).values())


# -- the cases of the benchmark, by Python ----------------------------------------------------------------------------

CASES = {case.name: case for group in (doors_files.overwrites, doors_files.links) for case in group()}


@pytest.fixture(autouse=True, scope="module")
def generated_once() -> object:
    with doors_faults.generated_once():
        yield


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_user_files(case: Case, tmp_path: Path) -> None:
    assert outcome(case, Ways(tmp_path / "problem.py").python, tmp_path) == ""


@pytest.mark.parametrize("name", ["user's main.c", "user's main.c, force", "main.c -> file", "new folder"])
def test_user_files_by_the_command_line(name: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    problem = tmp_path_factory.mktemp("problem") / "problem.py"
    problem.write_text(doors_files.PROBLEM, encoding="utf-8")
    assert outcome(CASES[name], Ways(problem).command, tmp_path) == ""


def test_the_refusal_names_every_file_and_the_way_out(tmp_path: Path) -> None:
    write(tmp_path, OLD)
    (tmp_path / "main.c").write_text("mine", encoding="utf-8")
    (tmp_path / "a.c").write_text(OLD["a.c"] + "\n", encoding="utf-8")
    with pytest.raises(ExportError, match=r"a\.c \(edited .*main\.c \(not written .*--force") as caught:
        write(tmp_path, NEW)
    assert "a.h" not in str(caught.value)
    assert isinstance(caught.value, NmpcError)
    write(tmp_path, NEW, force=True)
    assert contents(tmp_path) == NEW


def test_unchanged_files_are_not_touched_and_permissions_stay(tmp_path: Path) -> None:
    write(tmp_path, OLD)
    (tmp_path / "a.c").chmod(0o640)
    before = (tmp_path / "README.md").stat()
    write(tmp_path, {**NEW, "README.md": OLD["README.md"]})
    after = (tmp_path / "README.md").stat()
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns)
    assert (tmp_path / "a.c").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("path", ["../x.c", "/x.c", "osqp/../../x.c", "", "a\0.c"])
def test_components_stay_in_the_folder(path: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(ExportError, match="outside of the folder"):
        write(tmp_path / "out", {path: "x"}, force=True)
    assert tree(tmp_path).keys() == {"out"}


@pytest.mark.parametrize("place", ["osqp", "osqp/src"])
def test_a_link_in_the_place_of_a_sub_folder(place: str, tmp_path: Path) -> None:
    home, folder = tmp_path / "home", tmp_path / "out"
    home.mkdir()
    (folder / place).parent.mkdir(parents=True)
    (folder / place).symlink_to(home)
    with pytest.raises(ExportError, match=f"{place}: is a link"):
        write(folder, {**NEW, "osqp/src/x.c": "x"}, force=True)
    assert not any(home.iterdir())
    assert not (folder / "a.c").exists()


@pytest.mark.parametrize(("directory", "force"), [(3, False), (b"x", False), (None, False), ("", False), (".", "no")])
def test_arguments_of_wrong_types(directory: object, force: object) -> None:
    with pytest.raises(OptionError, match=r"directory|force"):
        write(directory, {}, force=force)  # type: ignore[arg-type]


# -- all or none ------------------------------------------------------------------------------------------------------


CALLS = 60  # calls of a second export that change the disk, with a margin


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, 0])
@pytest.mark.parametrize("start", ["new", "old"])
def test_a_failure_anywhere(number: int, start: str, tmp_path: Path) -> None:
    failures = 0
    for at in range(CALLS):
        folder = tmp_path / str(at)
        if start == "old":
            write(folder, {**OLD, "osqp/x.c": OLD["a.c"]})
        before = contents(folder)
        fault = doors_faults.Fault(at, doors_faults.failing(number))
        try:
            with doors_faults.injected(fault):
                write(folder, {**NEW, "osqp/x.c": NEW["a.c"]})
        except (ExportError, KeyboardInterrupt) as error:
            failures += 1
            left = {path: text for path, text in contents(folder).items() if STAGING not in path}
            assert left in (before, {**NEW, "osqp/x.c": NEW["a.c"]}), (at, fault.seen)
            said = str(error) or STAGING  # KeyboardInterrupt has no message
            assert STAGING in said or not (folder / STAGING).exists()  # present if the removal failed
            assert start == "old" or left or not folder.exists()
    assert failures > 20


def test_what_could_not_be_put_back_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, OLD)
    replace, seen = os.replace, []

    def failing(source: Path, target: Path) -> None:
        seen.append(target)
        if len(seen) > 2:
            raise OSError(errno.EIO, "the disk has gone")
        replace(source, target)

    monkeypatch.setattr(os, "replace", failing)
    with pytest.raises(ExportError, match=r"a\.json: .*put back: a\.h, a\.c are new"):
        write(tmp_path, NEW)
    assert (tmp_path / STAGING / "a.h.old").read_text(encoding="utf-8") == OLD["a.h"]


@pytest.mark.parametrize("at", [8, 25, 31])
def test_killed(at: int, tmp_path: Path) -> None:
    wanted = tmp_path / "wanted"
    export(tiny(), None, wanted / "out")
    export(tiny(), None, wanted / "out")
    (wanted / "out" / "notes.txt").write_text("mine\n", encoding="utf-8")
    fault = doors_faults.Fault(at, lambda: os.kill(os.getpid(), 9))
    assert doors_faults.after_kill("old", tiny, tmp_path / "root", tree, fault, tree(wanted)) == ""


@pytest.mark.parametrize("limit", [0, 700, 14_000])
def test_no_space(limit: int, tmp_path: Path) -> None:
    assert doors_faults.full_disk("old", tiny, tmp_path, tree, limit) == ""


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


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name[:20]))
@pytest.mark.parametrize(
    "door", [tiny, check_prefix, lambda name: generate(tiny(), name=name)], ids=("OCP", "prefix", "name")
)
def test_names_that_hide_files(name: str, door: Callable[[str], object]) -> None:
    with pytest.raises(ProblemError, match="name"):
        door(name)


@pytest.mark.parametrize(
    "name", ["a", "crane", "crane_f32", "math_mpc", "main_loop", "printf", "x" * 60, "com", "com10"]
)
def test_names_that_are_fine(name: str) -> None:
    check_package_name(name, "name")
    check_prefix(name)
