"""Names inside a package and names of its header differ, whatever the package is called."""

from __future__ import annotations

import re
import subprocess
import sysconfig
from functools import cache

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool

from nmpc_codegen import OCP, ProblemError, build, generate, worst_case
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.lowering.dialect.c_expressions import words
from nmpc_codegen.lowering.dialect.scopes import blank
from nmpc_codegen.lowering.unit.names import rename, renamed_words
from nmpc_codegen.package.signals import c_constants
from nmpc_codegen.package.sources import Sources
from verification import quality
from verification.samples import SAMPLES

#: A name that no text of a package contains.
NEUTRAL = "zz"
CHOSEN = ("crane", "crane riccati single", "controls interior", "everything dense", "tuned weights", "mixed dense")


@cache
def sources(sample: str, name: str = NEUTRAL) -> Sources:
    """The package of a sample under another name."""
    found = next(s for s in SAMPLES if s.name == sample)
    return generate(found.make(), found.options, name=name)


def clashing(text: Sources) -> dict[str, str]:
    """Package name -> inner name that a package of this name would declare in its header."""
    header, unit = (blank(text[f"{NEUTRAL}.{ext}"]) for ext in ("h", "c"))
    declared = {w.partition("_")[2] for w in words(header) if w.startswith((f"{NEUTRAL}_", f"{NEUTRAL.upper()}_"))}
    found: dict[str, str] = {}
    for word in sorted(words(unit)):
        for last in declared:
            name = word.removesuffix(f"_{last}")
            if name != word and (name.islower() if last.islower() else name.isupper()) and is_allowed(name.lower()):
                found.setdefault(name.lower(), word)
    return found


def is_allowed(name: str) -> bool:
    """The name of a package that is not refused."""
    try:
        check_package_name(name, "name")
    except ProblemError:
        return False
    return True


@pytest.mark.few(2)
@pytest.mark.parametrize("part", range(8))
@pytest.mark.parametrize("sample", CHOSEN)
def test_every_name_that_meets_an_inner_name_compiles(sample: str, part: int) -> None:
    """Package "ny" declares NY_N, and so on for every pair of an inner name and an end of a name of the header."""
    require_tool("gcc")
    names = sorted(clashing(sources(sample)))
    assert len(names) > 10
    for name in names[part::8]:
        text = sources(sample, name)
        assert quality.warnings_of(text, ("-fsyntax-only",), ("C99",), "gcc") == "", name


def test_known_clashes_are_among_them() -> None:
    """Of functions, macros, local variables and members of structs."""
    found = {name: word for sample in CHOSEN for name, word in clashing(sources(sample)).items()}
    assert {"ny": "NY_N", "qp": "qp_init", "q": "Q_N", "path": "path_cost"}.items() <= found.items()


def pendulum(name: str) -> OCP:
    """With a terminal residual, a path row and a terminal row, so that NY_N, NH_N and NW_N exist."""
    ocp = OCP(name, T=2.0, N=10)
    x, v, u = ocp.state("x", initial=1.0), ocp.state("v"), ocp.control("u")
    ocp.dynamics({x: v, v: ca.sin(x) + u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=[1, 1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x, v), weight=5)
    ocp.subject_to(-2, u, 2)
    ocp.subject_to(-3, x + v, 3, name="row")
    ocp.subject_to(-3, x - v, 3, at="end", name="last")
    return ocp


NAMES = (
    "ny",
    "nh",
    "nw",
    "weight",
    "yref",
    "param",
    "first",
    "bend",
    "longest",
    "project",
    "qp",
    "q",
    "long",
    "goto",
    "int32",
)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", NAMES)
def test_the_name_changes_no_number(name: str) -> None:
    """Neither a control nor a size nor a bound on the operations of a sample."""
    controller, reference = build(pendulum(name), profile="test"), build(pendulum("cart"), profile="test")
    assert controller.step([1.0, 0.5]).tolist() == reference.step([1.0, 0.5]).tolist()
    assert controller.description.sizes == reference.description.sizes
    assert worst_case(generate(pendulum(name))) == worst_case(generate(pendulum("cart")))


@pytest.mark.parametrize("name", ["int", "while", "class", "operator"])
def test_a_keyword_is_only_a_prefix(name: str) -> None:
    require_tool("cxx")
    assert quality.warnings_of(generate(pendulum(name)), ("-fsyntax-only",), ("C99", "C++17"), "gcc") == ""


def test_only_inner_words_change() -> None:
    found = renamed_words(
        {"NY_N", "NX", "a", "ny_"}, "#define NY_N 3 /* NY_NX */\nstruct { int ny_w; } ny_t;", "ny", {"ny_w"}
    )
    assert found == {"NY_N": "NY_N_"}
    assert rename("x = NY_N + NY_NX; API(NY_N)(x);", found) == "x = NY_N_ + NY_NX; API(NY_N)(x);"
    assert renamed_words({"NY_N", "NY_N_"}, "#define NY_N 3", "ny") == {"NY_N": "NY_N__"}


def test_constants_of_names_that_differ_by_case() -> None:
    assert c_constants(["phi", "r[0]", "M", "m"]) == ("PHI", "R_0", "M", "m")
    assert c_constants(["ab", "AB", "aB", "abc"]) == ("ab", "AB", "aB", "ABC")


def test_parameters_and_rows_that_differ_by_case() -> None:
    ocp = OCP("masses", T=1.0, N=5)
    x, X, u = ocp.state("x", initial=1.0), ocp.state("X"), ocp.control("u")
    M, m = ocp.parameter("M", value=2.0), ocp.parameter("m", value=1.0)
    ocp.dynamics({x: X, X: u / M - m * x})
    ocp.least_squares(ca.vertcat(x, X, u), weight=1)
    ocp.subject_to(-3, ca.vertcat(x, X), 3)
    header = generate(ocp)["masses.h"]
    for constant in ("MASSES_PARAM_M ", "MASSES_PARAM_m ", "MASSES_SIZE_M ", "MASSES_SIZE_m ", "MASSES_ROW_X "):
        assert constant in header
    controller = build(ocp, profile="test")
    before = controller.step([1.0, 0.0])
    controller.set_parameter("m", 3.0)
    controller.reset()
    changed = controller.step([1.0, 0.0])
    controller.set_parameter("m", 1.0)
    controller.set_parameter("M", 9.0)
    controller.reset()
    assert len({*before, *changed, *controller.step([1.0, 0.0])}) == 3
    controller.set_bounds("X", -0.1, 0.1)
    controller.reset()
    controller.step([1.0, 0.0])
    assert np.max(np.abs(controller.x[1:, 1])) <= 0.1 + 1e-9
    assert np.max(np.abs(controller.x[1:, 0])) > 0.1


#: Headers of C99 and POSIX, and Python's.
HEADERS = (
    *("assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "limits", "locale", "math", "setjmp"),
    *("signal", "stdarg", "stdbool", "stddef", "stdint", "stdio", "stdlib", "string", "tgmath", "time", "wchar"),
    *("wctype", "unistd", "sys/types", "sys/stat", "sys/time", "sys/wait", "Python"),
)
#: Prefixes of many macros, which nobody gives to a package.
FAMILIES = re.compile(r"have_|py|pthread|_py")


def system_words() -> set[str]:
    """Macros and declared names of the headers."""
    require_tool("gcc")
    code = "#define _GNU_SOURCE\n" + "".join(f"#include <{header}.h>\n" for header in HEADERS)
    command = ["gcc", "-E", "-dD", "-x", "c", "-I", sysconfig.get_path("include"), "-"]
    run = subprocess.run(command, input=code, capture_output=True, text=True, check=True)
    return words(re.sub(r"^# .*", "", run.stdout, flags=re.MULTILINE))


def test_names_of_the_header_are_no_names_of_the_system() -> None:
    """A name with which the header would declare X_OK is refused."""
    ends: set[str] = set()
    for sample in CHOSEN:
        header = blank(sources(sample)[f"{NEUTRAL}.h"])
        ends |= {w for w in words(header) if w.startswith((f"{NEUTRAL}_", f"{NEUTRAL.upper()}_"))}
    others, found = system_words(), set[str]()
    for end in {word.partition("_")[2] for word in ends}:
        for word in others:
            name = word.removesuffix(f"_{end}")
            if name != word and (name.islower() if end.islower() else name.isupper()):
                found.add(name.lower())
    free = {name for name in found if is_allowed(name) and not FAMILIES.match(name)}
    assert free <= {"m", "tp"}  # a parameter and a member of Python's structs
    assert {"x", "lc", "p", "statx"} <= found
