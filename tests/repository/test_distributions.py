"""What pip installs: both wheels, public names, types for editors, times of start-up commands."""

from __future__ import annotations

import email
import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy
import pytest
import yaml
from mypy import api

import nmpc_codegen
from nmpc_codegen.runtime.extras import EXTRAS

ROOT = Path(__file__).parents[2]
FOLDERS = {"nmpc_codegen": ROOT, "nmpc_codegen_runtime": ROOT / "packaging" / "runtime"}

#: What the runtime must not need.
HEAVY = ("casadi", "jinja2", "scipy", "osqp", "matplotlib", "pandas", "rich", "cvxpy")


def project(name: str) -> dict[str, Any]:
    """The table [project] of a distribution."""
    found: dict[str, Any] = tomllib.loads((FOLDERS[name] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return found


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, zipfile.ZipFile]:
    """Both wheels, built from the tree."""
    place = tmp_path_factory.mktemp("wheels")
    for folder in FOLDERS.values():
        hatch([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(place)], folder)
    return {path.name.split("-")[0]: zipfile.ZipFile(path) for path in place.glob("*.whl")}


def test_source_distribution(wheels: dict[str, zipfile.ZipFile], tmp_path: Path) -> None:
    """That of the whole builds the same wheels, both; the runtime has none, and says so."""
    build = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path), "-t"]
    hatch([*build, "sdist"], ROOT)
    (archive,) = tmp_path.glob("nmpc_codegen-*.tar.gz")
    with tarfile.open(archive) as found:
        found.extractall(tmp_path, filter="data")
    tree = archive.with_name(archive.name.removesuffix(".tar.gz"))
    for name, folder in FOLDERS.items():
        hatch([*build, "wheel"], tree / folder.relative_to(ROOT))
        (again,) = tmp_path.glob(f"{name}-*.whl")
        with zipfile.ZipFile(again) as other:
            assert {i.filename: i.CRC for i in other.infolist()} == {i.filename: i.CRC for i in wheels[name].infolist()}
    runtime = FOLDERS["nmpc_codegen_runtime"]
    refused = subprocess.run([*build, "sdist"], cwd=runtime, capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "there is no source distribution" in refused.stdout + refused.stderr


def hatch(command: list[str], folder: Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", FOLDERS)
def test_wheel(wheels: dict[str, zipfile.ZipFile], name: str) -> None:
    """Types, licence, version and description are in it; bytecode, tests and examples are not."""
    inside = set(wheels[name].namelist())
    info = f"{name}-{nmpc_codegen.__version__}.dist-info"
    assert {"nmpc_codegen/py.typed", f"{info}/licenses/LICENSE"} <= inside
    assert not [path for path in inside if "__pycache__" in path or not path.startswith(("nmpc_codegen/", info))]
    said = email.message_from_bytes(wheels[name].read(f"{info}/METADATA"))
    assert said["Version"] == nmpc_codegen.__version__
    assert said["Description-Content-Type"] == "text/markdown"
    assert said["Keywords"]
    assert said["Project-URL"]
    assert "Typing :: Typed" in said.get_all("Classifier", [])


def test_the_runtime_is_a_part_of_the_whole(wheels: dict[str, zipfile.ZipFile]) -> None:
    """Same version, same files; its requirements are among those of the whole."""
    both = {name: {p for p in wheel.namelist() if p.startswith("nmpc_codegen/")} for name, wheel in wheels.items()}
    assert both["nmpc_codegen_runtime"] < both["nmpc_codegen"]
    for path in both["nmpc_codegen_runtime"]:
        assert wheels["nmpc_codegen_runtime"].read(path) == wheels["nmpc_codegen"].read(path)
    runtime, whole = project("nmpc_codegen_runtime"), project("nmpc_codegen")
    assert set(runtime["dependencies"]) < set(whole["dependencies"])
    for extra in ("plot", "compiler"):
        assert runtime["optional-dependencies"][extra] == whole["optional-dependencies"][extra]


def test_the_runtime_runs_alone(
    wheels: dict[str, zipfile.ZipFile], toy_files: dict[str, str], compiler: tuple[str, ...], tmp_path: Path
) -> None:
    """open_package, step, solve, simulate, save and load; a name that needs the compiler says what to install."""
    assert compiler
    wheels["nmpc_codegen_runtime"].extractall(tmp_path / "site")
    (tmp_path / "toy").mkdir()
    for name, text in toy_files.items():
        (tmp_path / "toy" / name).write_text(text, encoding="utf-8")
    program = f"""
import json, sys
sys.path.insert(0, "site")
for name in {HEAVY!r}:
    sys.modules[name] = None
import nmpc_codegen
from nmpc_codegen import Log, open_package, simulate
controller = open_package("toy", profile="test")
log = simulate(controller, [0.1, 0.0], steps=300)
log.save("log.npz")
assert Log.load("log.npz").summary() == log.summary()
said = []
for use in (lambda: nmpc_codegen.OCP, lambda: nmpc_codegen.build, lambda: log.plot("log.png")):
    try:
        use()
    except ImportError as error:
        said.append(str(error))
from nmpc_codegen import *
missing = [name for name in dir(nmpc_codegen) if not hasattr(nmpc_codegen, name)]
print(json.dumps([nmpc_codegen.__file__, missing, log.ok, controller.solve([0.1, 0.0]).status.name, *said]))
"""
    run = subprocess.run(
        [sys.executable, "-I", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    file, missing, ok, status, ocp, build, plot = json.loads(run.stdout)
    assert missing == []
    assert Path(file) == tmp_path / "site" / "nmpc_codegen" / "__init__.py"
    assert (ok, status) == (True, "OK")
    assert ocp.startswith("OCP needs the compiler, which nmpc-codegen-runtime lacks: pip uninstall")
    assert build.startswith("build needs the compiler")
    assert "'nmpc-codegen-runtime[plot]'" in plot


def environment(folder: Path, wheel: Path) -> dict[str, Path]:
    """A virtual environment into which pip has installed a wheel; its requirements are those of this one."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-index", "--no-deps", str(wheel)]
    hatch(pip, folder)
    (place,) = folder.glob("lib/*/site-packages")
    (place / "requirements.pth").write_text(str(Path(numpy.__file__).parents[1]), encoding="utf-8")
    return {"python": python, "nmpc-export": folder / "bin" / "nmpc-export"}


def test_wheels_are_installed(wheels: dict[str, zipfile.ZipFile], compiler: tuple[str, ...], tmp_path: Path) -> None:
    """The whole exports a package in one environment, by its command; the runtime runs it in another one."""
    assert compiler
    whole, robot = (environment(tmp_path / name, Path(str(wheels[name].filename))) for name in FOLDERS)
    problem = str(ROOT / "examples" / "crane.py")
    for command in (
        [str(whole["nmpc-export"]), "--version"],
        [str(whole["nmpc-export"]), problem, "-o", "crane", "--check", "--simulate", "20"],
    ):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    program = (
        "from nmpc_codegen import *; print(simulate(open_package('crane'), [2.0, 0, 0, 0], 20).ok, 'OCP' in dir())"
    )
    command = [str(robot["python"]), "-I", "-c", program]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("True False\n", 0), done.stderr
    assert not robot["nmpc-export"].exists()


def test_extras_hold_what_functions_ask_for() -> None:
    """extra() names an extra that brings the package; ``all`` brings every one that needs no GPU; the base, none."""
    found = project("nmpc_codegen")["optional-dependencies"]

    def brought(extra: str) -> set[str]:
        names: set[str] = set()
        for need in found[extra]:
            inner = re.match(r"nmpc-codegen\[(.*)\]", need)
            names |= set().union(*map(brought, inner[1].split(","))) if inner else {re.split(r"[<>=;]", need)[0]}
        return names

    for package, extra in EXTRAS.items():
        assert any(name.startswith(package) for name in brought(extra))
        assert package in brought("all") & brought("dev") or extra == "cuda"
        assert not [need for need in project("nmpc_codegen")["dependencies"] if need.startswith(package)]


# Names ---------------------------------------------------------------------------------------------------------------


def test_completion_lists_the_public_names() -> None:
    program = """
import sys, json, nmpc_codegen, rlcompleter
loaded = "casadi" in sys.modules
complete = rlcompleter.Completer({"nmpc_codegen": nmpc_codegen}).attr_matches("nmpc_codegen.")
print(json.dumps([dir(nmpc_codegen), sorted(nmpc_codegen.__all__), loaded, complete]))
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    offered, public, loaded, completed = json.loads(run.stdout)
    assert set(public) <= set(offered)
    assert {"OCP", "Options", "build", "export", "simulate", "open_package", "Log"} <= set(public)
    assert {f"nmpc_codegen.{name}" for name in public} <= {text.rstrip("()") for text in completed}
    assert not loaded


PUBLIC = [name for name in nmpc_codegen.__all__ if callable(getattr(nmpc_codegen, name))]


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_have_help(name: str) -> None:
    """Real text: not the signature of a data class, and no reference to another module."""
    text = getattr(nmpc_codegen, name).__doc__ or ""
    assert text
    assert not text.startswith(f"{name}(")
    assert "see nmpc_codegen" not in text


USER = """
from nmpc_codegen import OCP, Options, build, simulate
ocp = OCP("cart", T=1.0, N=5)
x = ocp.state("x")
ocp.subjectto(-1, x, 1)
ctrl = build(ocp, Options(precison="single"))
ctrl.stepp([1.0])
log = simulate(ctrl, [1.0], stesp=3)
log.summry()
from nmpc_codegen import Optons
"""


def test_a_type_checker_finds_misspelt_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "user.py").write_text(USER, encoding="utf-8")
    monkeypatch.setenv("MYPYPATH", str(ROOT / "src"))
    monkeypatch.chdir(tmp_path)
    said, _, _ = api.run(["--config-file=", "--follow-imports=silent", "user.py"])
    for word in ("subject_to", "precision", "step", "steps", "summary", "Options"):
        assert f'"{word}"?' in said, said
    assert "Found 6 errors in 1 file" in said


def test_release_data_agree() -> None:
    """One version, one list of Pythons, in every file that names them; the workflow runs targets that exist."""
    version = nmpc_codegen.__version__
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: {re.escape(version)}$", citation, re.MULTILINE)
    assert f'url: "{project("nmpc_codegen")["urls"]["Homepage"]}"' in citation
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d$", changes, re.MULTILINE)
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    release = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    (matrix,) = re.findall(r"python: \[(.*)\]", workflow)
    classified = re.findall(r"Python :: (3\.\d+)", " ".join(project("nmpc_codegen")["classifiers"]))
    assert [word.strip('" ') for word in matrix.split(",")] == classified
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {"docs", "test-all", "mutants"} <= set(re.findall(r"make ([a-z-]+)", workflow + release)) <= targets
    paths = re.findall(r"(?:examples|tests|packaging|src)/[\w/.]+", workflow + release)
    assert not [path for path in paths if not (ROOT / path).exists()]


def test_the_release_publishes_the_version_of_its_tag() -> None:
    """The workflow of a tag: its check of the version, run here; nothing is published before all tests have passed."""
    release = yaml.load((ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8"), yaml.BaseLoader)
    assert release["on"] == {"push": {"tags": ["v*"]}}
    jobs = release["jobs"]
    assert {name: job.get("needs") for name, job in jobs.items() if name.startswith("publish")} == {
        "publish-site": ["distributions", "site"],
        "publish-distributions": ["distributions", "publish-site"],
    }
    kept = [step["with"]["name"] for step in jobs["distributions"]["steps"] if "upload" in step.get("uses", "")]
    assert kept == jobs["publish-distributions"]["strategy"]["matrix"]["project"]
    (check,) = (step["run"] for step in jobs["distributions"]["steps"] if step.get("name") == "The tag is the version")
    for tag, passes in ((f"v{nmpc_codegen.__version__}", True), ("v0.0.0", False)):
        environ = {**os.environ, "GITHUB_REF_NAME": tag}
        done = subprocess.run(["sh", "-ec", check], cwd=ROOT, env=environ, check=False)
        assert (done.returncode == 0) == passes


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    from nmpc_codegen.cli import main

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"nmpc-export {nmpc_codegen.__version__}\n"
