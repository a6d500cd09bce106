"""build.py: profiles, cache, loading, and failures of a build."""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import pickle
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from conftest import missing, require_tool

from nmpc_codegen.errors import BuildError, ControllerError, OptionError
from nmpc_codegen.runtime import cache, compilers, native
from nmpc_codegen.runtime.build import PROFILES, WARNINGS, Profile, compile_module, load
from nmpc_codegen.runtime.cache import cache_directory
from nmpc_codegen.runtime.native import runs
from nmpc_codegen.targets import TARGETS
from verification.problems import toy_sources

Files = dict[str, str]
build = sys.modules["nmpc_codegen.runtime.build"]  # the name nmpc_codegen.runtime.build is the function
SOURCE = Path(str(build.__file__)).parents[2]

pytestmark = pytest.mark.usefixtures("compiler")


@pytest.fixture
def cold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache directory."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("NMPC_CODEGEN_CACHE", str(folder))
    return folder


def modules(folder: Path) -> list[Path]:
    return sorted(folder.glob("_nmpc_*" + sysconfig.get_config_var("EXT_SUFFIX")))


def test_profiles_are_those_of_the_architecture() -> None:
    assert {name: " ".join(p.flags) for name, p in PROFILES.items()} == {
        "test": "-std=c99 -O0 -ffp-contract=off",
        "fast": "-O2 -fno-math-errno -fno-trapping-math -ffp-contract=fast",
        "verify": "-O2 -fno-math-errno -fno-trapping-math -ffp-contract=off",
    }
    assert [p.name for p in PROFILES.values() if p.native] == ["fast"]
    assert PROFILES["fast"].all_flags()[-1] in ("-march=native", "-mcpu=native", "-ffp-contract=fast")
    assert PROFILES["fast"].all_flags(TARGETS["x86-64-v3"])[-1] == "-march=x86-64-v3"
    assert PROFILES["verify"].all_flags() == PROFILES["verify"].flags


@pytest.mark.few(1)
@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_every_profile_without_a_warning(toy_files: Files, profile: str) -> None:
    ctrl = load(toy_files, "toy", profile, warnings_as_errors=True)
    assert ctrl.profile == profile
    np.testing.assert_allclose(ctrl.step([0.1, 0.0]), load(toy_files, "toy", "test").step([0.1, 0.0]), rtol=1e-12)


def test_own_profile(toy_files: Files) -> None:
    assert load(toy_files, "toy", Profile("size", ("-Os",))).profile == "size"


def test_packages_of_other_machines_are_refused(toy_files: Files) -> None:
    """By what the compiler says of this machine, before it compiles anything."""
    target = next(name for name in ("aarch64", "x86-64-v3") if not runs(TARGETS[name]))
    other = {**toy_files, "toy.json": toy_files["toy.json"].replace('"portable"', f'"{target}"')}
    with pytest.raises(BuildError, match=rf"toy is written for {target} .*this machine runs .*--verify .*portable"):
        load(other, "toy")


def test_targets_that_are_unknown_are_refused(toy_files: Files) -> None:
    other = {**toy_files, "toy.json": toy_files["toy.json"].replace('"portable"', '"vax"')}
    with pytest.raises(ControllerError, match=r"toy is for the target 'vax'; known: portable, x86-64-v3"):
        load(other, "toy")


def test_unknown_profile_lists_the_good_ones(toy_files: Files) -> None:
    with pytest.raises(OptionError, match="'quick'; allowed: test, fast, verify"):
        load(toy_files, "toy", "quick")


# -- cache ------------------------------------------------------------------------------------------------------------


def test_second_build_comes_from_the_cache(toy_files: Files, cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load(toy_files, "toy", "test")
    assert len(modules(cold)) == 1
    monkeypatch.setattr(build, "_compile", lambda *_: pytest.fail("compiled again"))
    load({**toy_files, "README.md": "not part of the key"}, "toy", "test")
    assert len(modules(cold)) == 1


def test_nothing_but_module_checksum_and_locks_remains(toy_files: Files, cold: Path) -> None:
    load(toy_files, "toy", "test")
    assert sorted(path.suffix or path.name for path in cold.iterdir()) == [".sha256", ".so", "locks"]


def test_key_holds_everything_the_module_depends_on(toy_files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    gcc = ("gcc",)
    monkeypatch.setattr(build, "_identity", lambda *_: "gcc 12, x86-64")
    edited = {**toy_files, "toy.c": toy_files["toy.c"] + "\n"}
    keys = [
        build._key(toy_files, "toy", ("-O2",), gcc),
        build._key(toy_files, "toy2", ("-O2",), gcc),
        build._key(toy_files, "toy", ("-O1",), gcc),
        build._key(toy_files, "toy", ("-O2",), ("clang",)),
        build._key(edited, "toy", ("-O2",), gcc),
    ]
    monkeypatch.setattr(build, "_identity", lambda *_: "gcc 12, x86-64, another processor")
    keys.append(build._key(toy_files, "toy", ("-O2",), gcc))
    monkeypatch.setattr(build.cffi, "__version__", "0.0")
    keys.append(build._key(toy_files, "toy", ("-O2",), gcc))
    monkeypatch.setattr(sys, "version", "0.0")
    keys.append(build._key(toy_files, "toy", ("-O2",), gcc))
    assert len(set(keys)) == len(keys)


def test_moves_may_be_unaligned_where_the_assembler_can_encode_them(tmp_path: Path) -> None:
    """A 32-byte move that gcc assumes to be aligned; on other processors than x86 the option is unknown."""
    gcc = ("gcc",)
    required = compilers.with_required_options(gcc)
    if platform.machine() in ("x86_64", "AMD64"):
        assert required == ("gcc", compilers.UNALIGNED_MOVES)
        text = "typedef double four __attribute__((vector_size(32)));\nvoid f(four *p, four *q);\n"
        (tmp_path / "move.c").write_text(text + "void f(four *p, four *q)\n{\n    *p = *q;\n}\n")
        objects = []
        for command in (gcc, required):
            subprocess.run([*command, "-O2", "-mavx2", "-c", "move.c", "-o", "move.o"], cwd=tmp_path, check=True)
            objects.append((tmp_path / "move.o").read_bytes())
        assert objects[0] != objects[1]
    else:
        assert required == gcc
    for other in ("clang", "tcc"):
        if shutil.which(other):
            assert compilers.with_required_options((other,)) == (other,)


def test_native_target_is_resolved(compiler: tuple[str, ...]) -> None:
    known = build._identity(compiler, ("-march=native",), os.environ["PATH"])
    assert known != build._identity(compiler, (), os.environ["PATH"])
    assert build._identity.__wrapped__(compiler, ("-march=native",), "") == known


#: A compiler on another processor: what -march=native stands for there.
ELSEWHERE = """#!/bin/sh
for argument; do
    shift
    if [ "$argument" = -march=native ]; then argument=-march={processor}; fi
    set -- "$@" "$argument"
done
exec gcc "$@"
"""


def test_library_of_another_processor_is_built_anew(
    toy_files: Files, cold: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Machines may share a cache: each finds its own library, and none that has instructions of another one."""
    require_tool("gcc")
    if platform.machine() != "x86_64":
        pytest.skip("the processors are those of x86")
    script = tmp_path / "cc"
    monkeypatch.setenv("CC", str(script))
    for kept, processor in enumerate(("x86-64", "x86-64-v2", "x86-64", "x86-64-v2")):
        script.write_text(ELSEWHERE.format(processor=processor))
        script.chmod(0o755)
        for known in (build._identity, native._macros):
            known.cache_clear()
        load(toy_files, "toy", "fast")
        assert len(modules(cold)) == min(kept + 1, 2)


def test_compiler_without_flags_for_its_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    known: dict[tuple[str, ...], dict[str, str]] = {("-mcpu=native",): {"__ARM": "1"}}
    monkeypatch.setattr(native, "macros_of", lambda compiler, flags=(): known.get(flags, {}))
    assert native.flags_of_processor() == ("-mcpu=native",)
    known.clear()
    assert native.flags_of_processor() == ()


def test_processor_that_cc_names_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    for named in ("-march=x86-64-v2", "-mcpu=cortex-a72"):
        monkeypatch.setattr(native, "find_compiler", lambda named=named: ("gcc", named))
        assert native.flags_of_processor() == ()


def test_cache_directory_that_cannot_be_written(
    toy_files: Files, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A temporary folder takes its place, with one warning, and keeps what is built."""
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("NMPC_CODEGEN_CACHE", str(tmp_path / "file"))
    with pytest.warns(RuntimeWarning, match=r"cannot write to the cache .*NMPC_CODEGEN_CACHE") as said:
        first = load(toy_files, "toy", "test")
    assert [warning.filename for warning in said] == [__file__]
    assert first.step([0.1, 0.0]).shape == (1,)
    place = cache._SUBSTITUTES[tmp_path / "file"]
    assert place.stat().st_mode & 0o077 == 0
    monkeypatch.setattr(build, "_compile", None)
    assert load(toy_files, "toy", "test").step([0.1, 0.0]).shape == (1,)


def test_without_a_home_directory(toy_files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user without HOME and without an entry in the system's list."""

    def homeless(_: str) -> str:
        raise RuntimeError("could not determine the home directory")

    monkeypatch.delenv("NMPC_CODEGEN_CACHE", raising=False)
    monkeypatch.setattr(cache, "user_cache_dir", homeless)
    with pytest.warns(RuntimeWarning, match="cannot write to the cache .*no-home-directory"):
        assert load(toy_files, "toy", "test").step([0.1, 0.0]).shape == (1,)


@pytest.mark.parametrize("profile", ["test", "verify"])
def test_a_cache_from_which_nothing_may_be_loaded(
    toy_files: Files, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, profile: str
) -> None:
    """Mounted noexec."""
    path = tmp_path / f"_nmpc_toy_{profile}.so"
    path.write_bytes(b"not loadable")

    class Mount:
        f_flag = os.ST_NOEXEC

    monkeypatch.setattr(build, "compile_module", lambda *_: path)
    with pytest.raises(BuildError, match="cannot load the compiled package toy"):
        load(toy_files, "toy", profile)
    monkeypatch.setattr(os, "statvfs", lambda _: Mount)
    with pytest.raises(BuildError, match=r"is mounted noexec, .*name another folder in NMPC_CODEGEN_CACHE"):
        load(toy_files, "toy", profile)


def test_cache_directory_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NMPC_CODEGEN_CACHE", raising=False)
    assert cache_directory().name == "nmpc_codegen"


def test_simultaneous_builds_in_one_directory(toy_files: Files, cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[int] = []
    original = build._compile

    def counting(*arguments: object) -> None:
        compiled.append(1)
        original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(build, "_compile", counting)
    texts = {path: toy_files[path] for path in ("toy.h", "toy.c")}
    with ThreadPoolExecutor(4) as pool:
        paths = list(pool.map(lambda _: compile_module(texts, "toy", ("-O0",)), range(4)))
    assert len(set(paths)) == 1
    assert len(compiled) == 1
    assert modules(cold) == [paths[0]]


def test_different_builds_live_in_one_process(toy_files: Files) -> None:
    first, second = load(toy_files, "toy", "test"), load(toy_sources(T=0.8), "toy", "test")
    first.step([0.1, 0.0]), second.step([0.1, 0.0])
    for ctrl, dt in ((first, 0.1), (second, 0.2)):
        np.testing.assert_allclose(np.diff(ctrl.x[:, 1]), dt * ctrl.u[:, 0], rtol=1e-9, atol=1e-15)


def test_single_precision(toy_files: Files, toy_single_files: Files) -> None:
    single, double = load(toy_single_files, "toy", "test"), load(toy_files, "toy", "test")
    u0 = single.step(np.array([0.1, 0.0]))
    assert u0.dtype == np.float32
    assert single.nbytes < double.nbytes
    np.testing.assert_allclose(u0, double.step([0.1, 0.0]), rtol=100 * np.finfo(np.float32).eps)


def test_the_runtime_needs_no_casadi(toy_files: Files, tmp_path: Path) -> None:
    """A package is compiled, loaded and simulated without CasADi and jinja2."""
    (tmp_path / "toy.json").write_text(json.dumps(toy_files))
    program = (
        "import json, sys; sys.modules['casadi'] = None; sys.modules['jinja2'] = None\n"
        "from nmpc_codegen.runtime.build import load\n"
        "from nmpc_codegen.runtime.loops.simulate import simulate\n"
        "log = simulate(load(json.load(open('toy.json')), 'toy', 'test'), [0.1, 0.0], 3)\n"
        "assert log.x.shape == (4, 2)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(SOURCE)}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


# -- failures ---------------------------------------------------------------------------------------------------------


def test_no_compiler(toy_files: Files, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compilers, "find_spec", lambda _: None)
    message = r"apt install gcc.*dnf install gcc.*brew install gcc.*pip install 'nmpc-codegen\[compiler\]'"
    with pytest.raises(BuildError, match=message):
        load(toy_files, "toy")


def test_the_compiler_of_the_extra(
    toy_files: Files, cold: Path, tmp_path: Path, compiler: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no other is on the path, `python -m ziglang cc` compiles; here that calls gcc and keeps a record."""
    package, record = tmp_path / "site" / "ziglang", tmp_path / "calls"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "__main__.py").write_text(
        f"""import os, sys
tool, *words = sys.argv[1:]
open({str(record)!r}, "a").write(tool + " " + os.environ["ZIG_GLOBAL_CACHE_DIR"] + chr(10))
os.environ["PATH"] = {os.environ["PATH"]!r}
os.execv({shutil.which(compiler[0])!r}, ["cc", *(w for w in words if w != "-fno-sanitize=undefined")])
"""
    )
    monkeypatch.syspath_prepend(package.parent)
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(tmp_path / "zig"))
    assert compilers.find_compiler()[:4] == (sys.executable, "-m", "ziglang", "cc")
    assert load(toy_files, "toy").step([0.1, 0.0]).shape == (1,)
    assert load(toy_files, "toy", "test").step([0.1, 0.0]).shape == (1,)
    assert set(record.read_text().splitlines()) == {f"cc {tmp_path / 'zig'}"}
    monkeypatch.delenv("ZIG_GLOBAL_CACHE_DIR")
    monkeypatch.setattr(compilers, "user_cache_dir", lambda _: str(record / "zig"))
    assert Path(compilers.environment(compilers.ZIG)["ZIG_GLOBAL_CACHE_DIR"]).parent == cache.temporary_directory()
    assert "ZIG_GLOBAL_CACHE_DIR" not in compilers.environment(compiler)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "target", ["x86_64-windows-gnu", "aarch64-macos", "aarch64-linux-gnu", "arm-linux-gnueabihf", "riscv64-linux-gnu"]
)
def test_zig_builds_for_other_systems(toy_files: Files, tmp_path: Path, target: str) -> None:
    """Without a warning."""
    if importlib.util.find_spec("ziglang") is None:
        missing("the package ziglang is not installed", "zig")
    for name, text in toy_files.items():
        (tmp_path / name).write_text(text)
    command = [*compilers.ZIG, "-target", target, *WARNINGS, "-O2", "toy.c", "main.c", "-o", "toy"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_named_compiler_does_not_exist(toy_files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-cc -m64")
    with pytest.raises(BuildError, match="no program 'no-such-cc'"):
        load(toy_files, "toy")


def test_named_compiler_is_no_command(toy_files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc 'x")
    with pytest.raises(BuildError, match=r"CC is \"gcc 'x\", which is no command: No closing quotation"):
        load(toy_files, "toy")


def test_compiler_that_fails_on_its_flags(toy_files: Files) -> None:
    with pytest.raises(BuildError, match="no-such-flag"):
        load(toy_files, "toy", Profile("odd", ("-fno-such-flag",)))


def test_compiler_that_cannot_show_its_commands(
    toy_files: Files, tmp_path: Path, compiler: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its version identifies it."""
    plain = tmp_path / "plain"
    plain.write_text(
        f'#!/bin/sh\nfor word; do [ "$word" = "-###" ] && exit 1; done\nexec {shlex.join(compiler)} "$@"\n'
    )
    plain.chmod(0o755)
    monkeypatch.setenv("CC", str(plain))
    assert load(toy_files, "toy", "test").step([0.1, 0.0]).shape == (1,)
    assert "version" in build._identity((str(plain),), ("-O0",), "")
    with pytest.raises(BuildError, match="failed"):
        build._identity((str(plain),), ("-O0", "-no-such-option"), "")


def test_no_python_headers(toy_files: Files, cold: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build.sysconfig, "get_path", lambda _: str(tmp_path))
    with pytest.raises(BuildError, match=r"apt install python3-dev.*dnf install python3-devel.*brew install python"):
        load(toy_files, "toy")


def test_a_library_needs_no_python_headers(
    toy_files: Files, cold: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build.sysconfig, "get_path", lambda _: str(tmp_path))
    assert load(toy_files, "toy", "test").step([0.1, 0.0]).shape == (1,)


def test_a_library_and_a_module_are_the_same_controller(toy_files: Files) -> None:
    """The same object code, once called by declarations, once by a wrapper: the same memory after the same samples."""
    flags = PROFILES["test"].flags
    library, module = (load(toy_files, "toy", Profile("plain", flags, wrapper)) for wrapper in (False, True))
    for x in ([0.1, 0.0], [np.nan, 0.0], [-0.2, 0.3]):
        np.testing.assert_array_equal(library.step(x), module.step(x))
        assert library.status is module.status
    assert library._memory.tobytes() == module._memory.tobytes()
    assert pickle.loads(pickle.dumps(library))._memory.tobytes() == module._memory.tobytes()


def test_functions_of_a_library_outlive_their_package(toy_files: Files, cold: Path) -> None:
    """The library stays loaded though nobody holds it and its file is gone."""
    ctrl = load(toy_files, "toy", "test")
    ffi, function = ctrl._package.ffi, ctrl._package.function("status_string")
    del ctrl
    gc.collect()
    for path in modules(cold):
        path.unlink()
    assert ffi.string(function(0)).lower() == b"ok"


def test_refused_code_shows_the_first_lines_and_keeps_the_source(toy_files: Files, cold: Path) -> None:
    broken = {**toy_files, "toy.c": toy_files["toy.c"] + "\nint broken(void) { return undeclared; }\n" * 30}
    with pytest.raises(BuildError, match="undeclared") as caught:
        load(broken, "toy", "test")
    message = str(caught.value)
    assert "more lines" in message
    assert len(message.splitlines()) == build.SHOWN_LINES + 2
    kept = Path(message.partition("sources kept in ")[2].partition(")")[0])
    assert (kept / "toy.c").read_text() == broken["toy.c"]
    assert not modules(cold)


def test_warning_as_error(toy_files: Files, cold: Path) -> None:
    cut = "\nint toy_cut(double v);\nint toy_cut(double v) { return v; }\n"
    narrowing = {**toy_files, "toy.c": toy_files["toy.c"] + cut}
    load(narrowing, "toy", "test")
    with pytest.raises(BuildError, match=r"-Werror=.*conversion"):
        load(narrowing, "toy", "test", warnings_as_errors=True)


def test_undefined_function(toy_files: Files, cold: Path) -> None:
    header = toy_files["toy.h"].replace("toy_real toy_cost(", "int toy_missing(void);\ntoy_real toy_cost(")
    with pytest.raises(BuildError, match="toy_missing"):
        load({**toy_files, "toy.h": header}, "toy", "test")


def test_header_without_markers(toy_files: Files, cold: Path) -> None:
    with pytest.raises(BuildError, match="begin declarations"):
        load({**toy_files, "toy.h": toy_files["toy.h"].replace("begin decl", "decl")}, "toy", "test")


def test_header_that_cffi_cannot_parse(toy_files: Files, cold: Path) -> None:
    header = toy_files["toy.h"].replace("typedef double toy_real;", "typedef double toy_real, ;")
    with pytest.raises(BuildError, match=r"toy\.h"):
        load({**toy_files, "toy.h": header}, "toy", "test")


def test_incomplete_package(toy_files: Files) -> None:
    with pytest.raises(BuildError, match=r"'toy' lacks toy\.c, toy\.json"):
        load({"toy.h": toy_files["toy.h"]}, "toy")


# -- layout -----------------------------------------------------------------------------------------------------------


def edited(files: Files, member: str, **changes: object) -> Files:
    description = json.loads(files["toy.json"])
    fields = next(s for s in description["structs"] if s["name"] == "solver")["fields"]
    next(f for f in fields if f["name"] == member).update(changes)
    return {**files, "toy.json": json.dumps(description)}
