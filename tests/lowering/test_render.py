"""CModule to text: deterministic, with strict checks and tidy output."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from pathlib import Path

import jinja2
import pytest

from nmpc_codegen import Options, generate
from nmpc_codegen.ir.printing.c_style import unit_style
from nmpc_codegen.lowering.render import tidy
from nmpc_codegen.lowering.templates import context, environment, template_directory
from nmpc_codegen.lowering.unit.macros import arithmetic
from nmpc_codegen.package.sources import Sources
from verification import problems

ROOT = Path(__file__).parents[2]
CASES = ("crane", "path_rows", "parameters", "dense_weight", "tiny", "crane_looped")


def digest(sources: Sources) -> str:
    parts = [f"{path}\n{text}" for path, text in sources.items()]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@pytest.mark.few(3)
@pytest.mark.parametrize("case", CASES)
def test_generated_twice_is_the_same(case: str) -> None:
    c = problems.CASES[case]
    assert generate(c.make(), c.options) == generate(c.make(), c.options)


PROGRAM = """
import sys
sys.path[:0] = [{source!r}, {root!r}]
from verification import problems
from tests.lowering.test_render import digest
from nmpc_codegen import generate
for name in {cases!r}:
    print(digest(generate(problems.CASES[name].make(), problems.CASES[name].options)))
"""


@pytest.mark.slow
def test_hash_seeds_do_not_matter() -> None:
    """A new interpreter with another order of sets, in another directory."""
    program = PROGRAM.format(source=str(ROOT / "src"), root=str(ROOT), cases=CASES)
    environment = {**os.environ, "PYTHONHASHSEED": "4321"}
    run = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True, cwd="/"
    )
    here = [digest(generate(problems.CASES[n].make(), problems.CASES[n].options)) for n in CASES]
    assert run.stdout.split() == here


@pytest.mark.parametrize("case", CASES)
def test_texts_aretidy_and_tell_neither_time_nor_place(case: str) -> None:
    sources = problems.sources(case)
    name = problems.problem(case).name
    assert set(sources) == {f"{name}.h", f"{name}.c", "main.c", "CMakeLists.txt", "README.md", f"{name}.json"}
    for path, text in sources.items():
        assert text.endswith("\n"), path
        assert not text.endswith("\n\n"), path
        assert not re.search(r"[ \t]+$", text, re.M), path
        assert "\n\n\n" not in text, path
        assert "\r" not in text, path
        assert str(ROOT) not in text, path
        assert not re.search(r"\b20\d\d-\d\d|\d\d:\d\d:\d\d", text), path
        assert "{{" not in re.sub(r"= \{\{", "", text) or path.endswith(".c"), path
        assert not re.search(r"\{%|%\}|\{#", text), path


def test_a_name_that_a_template_misspells_is_an_error() -> None:
    assert environment().undefined is jinja2.StrictUndefined
    with pytest.raises(jinja2.UndefinedError, match="misspelt"):
        environment().from_string("{{ misspelt }}").render(context("p", unit_style("double")))
    with pytest.raises(jinja2.UndefinedError):
        environment().from_string("{% for i in misspelt %}{% endfor %}").render(context("p", unit_style("double")))


def test_precision_is_spelled_in_one_place() -> None:
    """No literal, function or type of double in the single-precision package."""
    sources = problems.sources("crane", "single")
    code = re.sub(r"/\*.*?\*/", "", sources["crane.c"], flags=re.S)
    assert "double" not in code
    assert "typedef float crane_real;" in sources["crane.h"]
    body = re.sub(r"\bR\([^)]*\)|\"[^\"]*\"", "", code)
    assert not re.findall(r"(?<![\w.])\d+\.\d*(?:e[+-]?\d+)?(?![\w.])", body)
    assert not re.findall(r"\b(?:sin|cos|sqrt|fabs|ceil)\(", body)


def test_templates_hold_no_decision() -> None:
    """House rule 4: names, loops and inclusions; an expression in {{ }} may choose a word, never a block."""
    for path in template_directory().rglob("*.jinja"):
        blocks = re.findall(r"\{%-?\s*(\w+)", path.read_text(encoding="utf-8"))
        allowed = {"for", "endfor", "include", "else", "with", "endwith"}
        assert set(blocks) <= allowed, path.name


def test_tidy() -> None:
    assert tidy("\n\na  \n\n\n\nb\t\n\n") == "a\n\nb\n"


def test_context() -> None:
    names = context("crane", unit_style("single"))
    assert (names["p"], names["P"], names["real"]) == ("crane", "CRANE", "crane_real")
    assert names["lit"](2) == "2.0F"


def test_arithmetic_of_the_working_precision() -> None:
    macros = {macro.name: macro.text for macro in arithmetic("single")}
    assert macros["SQRT"] == "sqrtf"
    assert float(macros["TOL_UNIT"].rstrip("F")) == 2.0**-23
    assert macros["TOL_QP_PIVOT"] == "(32.0F * TOL_UNIT)"


def test_names_of_the_package() -> None:
    ocp = problems.tiny()
    assert set(generate(ocp, Options(), "other")) >= {"other.h", "other.c", "other.json"}
