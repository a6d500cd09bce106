"""The house rules that can be checked automatically: imports, mirrored folders, sizes."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import nmpc_codegen
from benchmarks.lib import rooms, typing_figures
from benchmarks.lib.rooms import (
    MODULES,
    RANK,
    ROOT,
    SOURCE,
    imports,
    modules_per_room,
    own_imports,
    place,
    room,
    upward_imports,
)
from nmpc_codegen.components.base import SEAMS, Component, Parts
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.linearize import Model
from nmpc_codegen.options import REGISTRIES, Options

TEMPLATES = ROOT / "templates"

#: Seam -> folder, both in src and in templates.
FOLDERS = {
    "integrator": "integrators",
    "hessian": "hessians",
    "condensing": "condensing",
    "qp": "qp",
    "algorithm": "algorithms",
}

#: A stage knows its input value and its output value, not the earlier stages.
BLIND = {
    "lowering/linearize": {"frontend.ocp", "frontend.checks", "frontend.classify"},
    "lowering/lower": {"frontend.ocp", "frontend.checks", "frontend.classify", "oracle"},
    "lowering/render": {"frontend", "options", "oracle", "lowering.linearize", "lowering.lower", "lowering.choose"},
}

#: Foreign package -> rooms and modules that may import it.
ONLY_IN = {
    "casadi": {
        "frontend",
        "ir",
        "economic",
        "oracle",
        "derivatives/model",
        "components/integrators",
        "components/hessians",
        "components/algorithms/scales",
        "components/stage_cost",
        "lowering/choose_hessian",
        "lowering/linearize",
        "lowering/stability",
        "lowering/growth",
    },
    "jinja2": {"lowering/render"},
    "pycparser": {"bounds"},
    "cffi": {"runtime/build"},
    "cvxpy": {"economic/semidefinite"},
    "scipy": {"economic", "components/qp/osqp"},
}

MODULES_PER_ROOM = 14
MAX_FILE = 600
MAX_TEMPLATE = 800
MAX_FUNCTION = 60
MAX_C_FUNCTION = 50
HEAD = 12  # lines of a template that state its contract
DRAWERS = {"util", "utils", "helper", "helpers", "manager", "managers", "misc", "common"}

PYTHON = sorted(
    path
    for folder in ("src", "verification", "tests", "examples", "benchmarks")
    for path in (ROOT / folder).rglob("*.py")
)
COMPONENTS = [cls for registry in REGISTRIES.values() for cls in registry.values()]


def test_every_module_is_in_a_room() -> None:
    assert {room(place(path)) for path in MODULES} - {"__init__"} == set(RANK)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_run_one_way(path: Path) -> None:
    here = place(path)
    assert not upward_imports(path), f"{here} stands before them"
    for blind in BLIND.get(here, set()):
        assert not {name for name in own_imports(path) if name == blind or name.startswith(f"{blind}.")}
    if here.startswith("components/") and here.count("/") > 1:
        others = {f"components.{folder}" for folder in FOLDERS.values()} - {".".join(here.split("/")[:2])}
        seen = {name for name in own_imports(path) if any(name == o or name.startswith(f"{o}.") for o in others)}
        assert not seen, "components see one another through contracts only"


def test_an_upward_import_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also imports inside functions and for type checking."""
    monkeypatch.setattr(rooms, "SOURCE", tmp_path)
    path = tmp_path / "ir" / "module.py"
    path.parent.mkdir()
    path.write_text("def f():\n    from nmpc_codegen.lowering.lower import lower\nimport nmpc_codegen.runtime.status\n")
    assert upward_imports(path) == {"lowering.lower"}


def test_verification_imports_neither_tests_nor_benchmarks() -> None:
    for path in (ROOT / "verification").rglob("*.py"):
        assert not {name for name in imports(path) if name.split(".")[0] in ("tests", "benchmarks")}, path


def test_rooms_are_small() -> None:
    assert max(modules_per_room().values()) <= MODULES_PER_ROOM


def test_seams_and_values_are_typed() -> None:
    """No Any, object or dict of strings in options, components, Model and CModule."""
    assert {Options, Component, Parts, Model, CModule} <= set(typing_figures.classes())
    assert typing_figures.untyped_options() == []


@dataclasses.dataclass(frozen=True)
class _Untyped:
    field: Any
    words: dict[str, int]
    typed: dict[int, str]

    def method(self, what: object) -> int:
        return 0

    @property
    def member(self) -> tuple[Any, ...]:
        return ()

    def _private(self) -> Any:
        return None


def test_a_missing_type_is_found() -> None:
    found = [place.split(":")[0] for place in typing_figures.untyped(_Untyped)]
    assert found == [f"_Untyped.{name}" for name in ("field", "words", "method", "member")]


@pytest.mark.parametrize("path", sorted((SOURCE / "runtime").glob("*.py")), ids=lambda p: p.name)
def test_runtime_imports_no_stage_of_the_compiler(path: Path) -> None:
    assert {room(name) for name in own_imports(path)} <= {"runtime", "errors", "exclusive"}


@pytest.mark.parametrize("package", ONLY_IN)
def test_foreign_packages_stay_in_their_modules(package: str) -> None:
    users = {place(path) for path in MODULES if any(name.split(".")[0] == package for name in imports(path))}
    assert users, f"nothing imports {package}: is the test blind?"
    allowed = ONLY_IN[package]
    assert not {user for user in users if not any(user == a or user.startswith(f"{a}/") for a in allowed)}


def test_runtime_loads_neither_casadi_nor_jinja2(
    toy_files: dict[str, str], compiler: tuple[str, ...], tmp_path: Path
) -> None:
    """open_package, step, solve and simulate in a new interpreter."""
    assert compiler
    for name, text in toy_files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    program = f"""
import json, sys
from nmpc_codegen import open_package, simulate
controller = open_package({str(tmp_path)!r}, profile="test")
x0 = [0.1] * controller.dims.nx
log = simulate(controller, x0, steps=2)
print(json.dumps([len(log.u), sorted(set(sys.modules) & {{"casadi", "jinja2", "nmpc_codegen.frontend.ocp"}})]))
"""
    search = f"import sys; sys.path.insert(0, {str(SOURCE.parent)!r})\n"
    run = subprocess.run([sys.executable, "-c", search + program], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == [2, []]


# Components ----------------------------------------------------------------------------------------------------------


def test_seams_are_the_registries() -> None:
    assert set(SEAMS) == set(REGISTRIES) == set(FOLDERS)


@pytest.mark.parametrize("seam", SEAMS)
def test_every_component_is_registered(seam: str) -> None:
    """Every class with a seam that is defined in the folder is in the registry under its name, and is public."""
    folder = FOLDERS[seam]
    defined = {
        cls
        for path in (SOURCE / "components" / folder).glob("*.py")
        for cls in vars(importlib.import_module(f"nmpc_codegen.components.{folder}.{path.stem}")).values()
        if inspect.isclass(cls)
        and cls.__module__ == f"nmpc_codegen.components.{folder}.{path.stem}"
        and hasattr(cls, "seam")
    }
    registry = REGISTRIES[seam]
    assert set(registry.values()) == defined
    for word, cls in registry.items():
        assert cls.name == word
        assert cls.seam == seam
        assert getattr(nmpc_codegen, cls.__name__) is cls
        assert cls.__name__ in nmpc_codegen.__all__


@pytest.mark.parametrize("cls", COMPONENTS, ids=lambda cls: cls.__name__)
def test_component_keeps_its_house(cls: Any) -> None:
    """A frozen dataclass with options as its only fields; its template has the stem of its module; docs name it."""
    module = cls.__module__.split(".")[-1]
    folder = FOLDERS[cls.seam]
    assert cls.__dataclass_params__.frozen
    assert cls.template == f"{folder}/{module}.c"
    head = (TEMPLATES / folder / f"{module}.c").read_text(encoding="utf-8").splitlines()[:HEAD]
    assert any(re.search(r"(?i)\bcontract\b", line) for line in head), "the contract stands at the top of the template"
    assert set(cls.needs) <= set(SEAMS) - {cls.seam}
    for document in ("docs/problem-class.md", "CHANGELOG.md"):
        assert f"`{cls.__name__}`" in (ROOT / document).read_text(encoding="utf-8"), f"{document} does not name it"


@pytest.mark.parametrize("seam", SEAMS)
def test_every_template_of_a_seam_is_used(seam: str) -> None:
    """The template belongs to a component, or is a part named by a template or a component."""
    folder = FOLDERS[seam]
    owned = {cls.template for cls in REGISTRIES[seam].values()}
    parts = {f"{folder}/{path.name}" for path in (TEMPLATES / folder).iterdir()} - owned
    users = [*TEMPLATES.rglob("*.c"), *TEMPLATES.rglob("*.jinja")]
    named = "".join(path.read_text(encoding="utf-8") for path in users)
    assert not {part for part in parts if f'"{part}"' not in named}


# Size and names ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", PYTHON, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_and_functions_fit(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MAX_FILE
    lengths = {
        node.name: (node.end_lineno or 0) - node.lineno + 1
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
    }
    assert not {name: length for name, length in lengths.items() if length > MAX_FUNCTION}


@pytest.mark.parametrize(
    "path",
    sorted((*TEMPLATES.rglob("*.c"), *TEMPLATES.rglob("*.c.jinja"))),
    ids=lambda p: str(p.relative_to(TEMPLATES)),
)
def test_templates_and_their_functions_fit(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_TEMPLATE
    opening = [i for i, line in enumerate(lines) if line == "{"]
    closing = [i for i, line in enumerate(lines) if line == "}"]
    assert len(opening) == len(closing)
    assert all(end - start <= MAX_C_FUNCTION for start, end in zip(opening, closing, strict=True))


def test_no_drawers() -> None:
    parts = {part.split(".")[0] for path in (*PYTHON, *TEMPLATES.rglob("*")) for part in path.relative_to(ROOT).parts}
    assert not parts & DRAWERS


def texts() -> Iterator[tuple[Path, str]]:
    """Every text of the tree but this file, which has to contain the forbidden words."""
    folders = ("src", "templates", "tests", "examples", "benchmarks", "docs", ".ci")
    files = [path for path in ROOT.iterdir() if path.is_file()]
    files += [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    for path in files:
        if (
            path.name != ".git"
            and path != Path(__file__)
            and "__pycache__" not in path.parts
            and path.suffix not in {".png", ".pyc"}
        ):
            yield path, path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("what", "pattern"),
    [
        ("a path of one machine", r"(?<![\w.<$}~)/-])/(?:home|root|work|Users|tmp|mnt)/"),
        ("a mark of unfinished work", r"\b(?:TODO|FIXME|XXX|HACK)\b"),
        ("how the text came about", r"(?i)\b(?:this session|the brief|as requested|as discussed|issue #?\d+)\b"),
        ("history in a comment", r"(?i)(?:#|/\*|//) *(?:previously|formerly|used to be|no longer|was changed)\b"),
    ],
)
def test_texts_are_free_of(what: str, pattern: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{i}: {line.strip()}"
        for path, text in texts()
        for i, line in enumerate(text.splitlines(), 1)
        if re.search(pattern, line)
    ]
    assert not found, f"{what}: {found}"
