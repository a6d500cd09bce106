"""The house rules that can be checked automatically: imports, mirrored folders, sizes."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import nmpc_codegen
from nmpc_codegen.components.base import SEAMS
from nmpc_codegen.options import REGISTRIES

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "nmpc_codegen"
TEMPLATES = ROOT / "templates"
MODULES = sorted(SOURCE.rglob("*.py"))

#: A room imports only the rooms before it; the modules of the package itself are checked one by one.
ORDER = (
    *(
        "errors",
        "exclusive",
        "package",
        "targets",
        "runtime",
        "ir",
        "frontend",
        "components",
        "options",
        "decisions",
        "lowering",
        "analysis",
    ),
    *("oracle", "economic", "compiler", "derivatives", "firmware", "campaigns", "pictures", "cli"),
)
RANK = {room: rank for rank, room in enumerate(ORDER)}

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
    "frontend/completion/complete": {"frontend.ocp", "frontend.checks", "frontend.classify"},
    "decisions/decide": {"frontend.ocp", "frontend.checks", "frontend.classify"},
    "lowering/linearize": {"frontend.ocp", "frontend.checks", "frontend.classify"},
    "lowering/lower": {"frontend.ocp", "frontend.checks", "frontend.classify", "oracle"},
    "lowering/render": {"frontend", "options", "oracle", "decisions", "lowering.linearize", "lowering.lower"},
}

#: Foreign package -> rooms and modules that may import it.
ONLY_IN = {
    "casadi": {
        "frontend",
        "ir",
        "economic",
        "oracle",
        "derivatives/derivative_model",
        "components/integrators",
        "components/hessians",
        "components/algorithms/row_scales",
        "components/stage_cost",
        "decisions",
        "lowering/linearize",
        "lowering/warnings",
    },
    "jinja2": {"lowering/templates"},
    "cffi": {"runtime/build"},
    "cvxpy": {"economic/semidefinite"},
    "matplotlib": {"pictures", "cli/arguments"},
    "optuna": {"campaigns/coach/weights"},
    "pyarrow": {"runtime/records/frames", "campaigns/flying/archive"},
    "pandas": {"runtime/records/frames"},
    "xarray": {"runtime/records/frames"},
    "scipy": {
        *("economic", "components/qp/osqp", "frontend/functions/lookup_table"),
        *("campaigns/stated/distributions", "campaigns/judging/verdict", "campaigns/coach/choice"),
    },
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
    for folder in ("src", "verification", "tests", "examples", "benchmarks", "site")
    for path in (ROOT / folder).rglob("*.py")
)
COMPONENTS = [cls for registry in REGISTRIES.values() for cls in registry.values()]


def place(path: Path) -> str:
    """Path of a module below nmpc_codegen without its suffix: "runtime/build"."""
    return path.relative_to(SOURCE).with_suffix("").as_posix()


def room(name: str) -> str:
    """First part of a place or of a dotted name below nmpc_codegen."""
    return re.split(r"[./]", name)[0]


def imports(text: str) -> Iterator[str]:
    """Dotted names of all modules that a text imports, inside functions, for type checking and by extra() too."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "extra" and isinstance(node.args[0], ast.Constant):
            yield str(node.args[0].value)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            if node.module == "nmpc_codegen":
                yield from (f"nmpc_codegen.{alias.name}" for alias in node.names)
            elif node.module:
                yield node.module


def without_pictures(text: str) -> str:
    """A text without the imports of pictures inside functions, which only draw when they are called."""
    return re.sub(r"^ +from nmpc_codegen\.pictures[. ].*\n", "", text, flags=re.MULTILINE)


def own_imports(path: Path) -> set[str]:
    """Dotted names below nmpc_codegen that a source file imports, of pictures only those at its top."""
    names = imports(without_pictures(path.read_text(encoding="utf-8")))
    return {name.removeprefix("nmpc_codegen.") for name in names if name.startswith("nmpc_codegen.")}


def upward(here: str, names: set[str]) -> set[str]:
    """Imported names of rooms after the room of the file; the package itself re-exports names of all rooms."""
    return set() if here == "__init__" else {name for name in names if RANK[room(name)] > RANK[room(here)]}


def test_every_module_is_in_a_room_and_rooms_are_small() -> None:
    assert {room(place(path)) for path in MODULES} - {"__init__"} == set(RANK)
    counts = Counter(path.parent for path in MODULES if path.name != "__init__.py")
    assert max(counts.values()) <= MODULES_PER_ROOM


def test_imports_run_one_way() -> None:
    """Between rooms, stages and components; runtime knows no stage of the compiler."""
    found = []
    for path in MODULES:
        here, names = place(path), own_imports(path)
        found += [f"{here} imports {name}" for name in upward(here, names)]
        blind = BLIND.get(here, set())
        if here.startswith("components/") and here.count("/") > 1:
            blind = {f"components.{folder}" for folder in FOLDERS.values()} - {".".join(here.split("/")[:2])}
        found += [f"{here} imports {n}" for n in names if any(n == b or n.startswith(f"{b}.") for b in blind)]
    assert not found
    assert rooms_below("package") <= {"package", "errors"}
    assert rooms_below("targets") <= {"package"}
    assert rooms_below("runtime") <= {"runtime", "targets", "package", "errors", "exclusive"}
    assert rooms_below("analysis") <= {"analysis", "lowering", "package", "errors"}
    read = {name for path in (SOURCE / "analysis").rglob("*.py") for name in own_imports(path) if "lowering" in name}
    assert all(name.startswith("lowering.dialect.") for name in read), "the worst case needs no stage of the compiler"


def rooms_below(here: str) -> set[str]:
    """The rooms from which the files of a room import."""
    return {room(name) for path in (SOURCE / here).rglob("*.py") for name in own_imports(path)}


def test_no_circle_of_imports() -> None:
    """No file reaches itself, through imports inside functions and for type checking neither."""
    files = {place(path).removesuffix("/__init__").replace("/", "."): own_imports(path) for path in MODULES}
    below = {
        name: {n for n in names if n in files and n != name} for name, names in files.items() if name != "__init__"
    }
    while free := [name for name, names in below.items() if not names & set(below)]:
        for name in free:
            del below[name]
    assert not below, f"in circles, or above one: {sorted(below)}"


def test_an_upward_import_is_found() -> None:
    """Also imports inside functions and for type checking."""
    text = "def f():\n    from nmpc_codegen.lowering.lower import lower\nimport nmpc_codegen.package.status\n"
    names = {name.removeprefix("nmpc_codegen.") for name in imports(text)}
    assert upward("ir/module", names) == {"lowering.lower"}


def test_tests_and_benchmarks_meet_in_verification_only() -> None:
    """verification imports neither of them, and they never import each other."""
    seen: dict[str, set[str]] = {top: set() for top in ("tests", "benchmarks", "verification")}
    for top, names in seen.items():
        for path in (ROOT / top).rglob("*.py"):
            names |= {name.split(".")[0] for name in imports(path.read_text(encoding="utf-8"))}
    assert "benchmarks" not in seen["tests"]
    assert "tests" not in seen["benchmarks"]
    assert not {"tests", "benchmarks", "conftest"} & seen["verification"]


def test_foreign_packages_stay_in_their_modules() -> None:
    tops = {place(path): {n.split(".")[0] for n in imports(path.read_text(encoding="utf-8"))} for path in MODULES}
    for package, allowed in ONLY_IN.items():
        users = {user for user, names in tops.items() if package in names}
        assert users, f"nothing imports {package}: is the test blind?"
        assert not {user for user in users if not any(user == a or user.startswith(f"{a}/") for a in allowed)}, package


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
    for document in ("docs/algorithms.md", "CHANGELOG.md"):
        assert f"`{cls.__name__}`" in (ROOT / document).read_text(encoding="utf-8"), f"{document} does not name it"


@pytest.mark.parametrize("seam", SEAMS)
def test_every_template_of_a_seam_is_used(seam: str) -> None:
    """The template belongs to a component, or is a part named by a template or a component."""
    folder = FOLDERS[seam]
    owned = {cls.template for cls in REGISTRIES[seam].values()}
    parts = {str(path.relative_to(TEMPLATES)) for path in (TEMPLATES / folder).rglob("*.c")} - owned
    users = [*TEMPLATES.rglob("*.c"), *TEMPLATES.rglob("*.jinja")]
    named = "".join(path.read_text(encoding="utf-8") for path in (*users, SOURCE / "lowering" / "unit" / "assemble.py"))
    assert not {part for part in parts if f'"{part}"' not in named}


# Size and names ------------------------------------------------------------------------------------------------------


def test_files_and_functions_fit() -> None:
    long = []
    for path in PYTHON:
        text = path.read_text(encoding="utf-8")
        long += [str(path)] if len(text.splitlines()) > MAX_FILE else []
        functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
        long += [f"{path}: {f.name}" for f in functions if (f.end_lineno or 0) - f.lineno >= MAX_FUNCTION]
    assert not long


def test_templates_and_their_functions_fit() -> None:
    long = []
    for path in (*TEMPLATES.rglob("*.c"), *TEMPLATES.rglob("*.c.jinja")):
        lines = path.read_text(encoding="utf-8").splitlines()
        long += [str(path)] if len(lines) > MAX_TEMPLATE else []
        opening, closing = ([i for i, line in enumerate(lines) if line == brace] for brace in "{}")
        long += [f"{path}:{a}" for a, b in zip(opening, closing, strict=True) if b - a > MAX_C_FUNCTION]
    assert not long


def test_parts_are_composed_and_not_interrupted() -> None:
    """At most two conditions of the preprocessor or of jinja in 100 lines of the templates, eight in the iteration."""
    condition = re.compile(r"^\s*#\s*(?:if|elif|ifdef|ifndef)\b|\{%-? *(?:if|elif)\b|\{\{[^}]* if ", re.MULTILINE)
    texts = {path: path.read_text(encoding="utf-8") for path in TEMPLATES.rglob("*") if path.is_file()}
    found = sum(len(condition.findall(text)) for text in texts.values())
    assert found <= 0.02 * sum(text.count("\n") for text in texts.values())
    assert len(condition.findall(texts[TEMPLATES / "algorithms" / "real_time_iteration.c"])) <= 8


def test_no_name_of_a_file_or_class_occurs_twice() -> None:
    """A name leads to one place; __init__ and __main__ are Python's."""
    files = Counter(path.name for path in MODULES)
    assert {name for name, count in files.items() if count > 1} <= {"__init__.py", "__main__.py"}
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in MODULES)
    classes = Counter(node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    assert not [name for name, count in classes.items() if count > 1 and not name.startswith("_")]


def test_no_drawers() -> None:
    parts = {part.split(".")[0] for path in (*PYTHON, *TEMPLATES.rglob("*")) for part in path.relative_to(ROOT).parts}
    assert not parts & DRAWERS


def texts() -> Iterator[tuple[Path, str]]:
    """Every text of the tree but this file, which has to contain the forbidden words."""
    folders = (
        "src",
        "templates",
        "verification",
        "tests",
        "examples",
        "benchmarks",
        "docs",
        "packaging",
        ".ci",
        ".github",
    )
    files = [path for path in ROOT.iterdir() if path.is_file()]
    files += [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    for path in files:
        if (
            path.name != ".git"
            and path != Path(__file__)
            and "__pycache__" not in path.parts
            and path.suffix not in {".png", ".pyc"}
        ):
            text = path.read_text(encoding="utf-8")
            yield path, re.sub(r'"image/png": ".*"', "", text) if path.suffix == ".ipynb" else text


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
