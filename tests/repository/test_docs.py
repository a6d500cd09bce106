"""Tests of the documents: their code is extracted and run, and their links and claims are checked."""

from __future__ import annotations

import inspect
import re
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from examples.crane import build_ocp
from nmpc_codegen import (
    OCP,
    Controller,
    GaussNewton,
    Log,
    Observer,
    OptionError,
    Options,
    Recorder,
    Status,
    build,
    generate,
)
from nmpc_codegen.campaigns import Campaign, Choice
from nmpc_codegen.cli import main
from nmpc_codegen.runtime.build import WARNINGS
from nmpc_codegen.runtime.solving import Solution
from tests.snippets import ROOT, blocks, changed, copy_tree, documents, entries, install_command, run

DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])

# README --------------------------------------------------------------------------------------------------------------


def test_readme_runs(tmp_path: Path, compiler: tuple[str, ...]) -> None:
    """Its program, which states the crane of the examples."""
    assert compiler
    (program,) = blocks("README.md")
    run([sys.executable, "-c", program.text], tmp_path, (ROOT / "src",))
    excerpt = (tmp_path / "out" / "crane" / "crane.c").read_text(encoding="utf-8")
    assert excerpt == generate(build_ocp())["crane.c"], "the README shows another crane than examples/crane.py"
    assert (tmp_path / "out" / "crane.png").stat().st_size > 10_000


def walk(page: str, folder: Path, without: str = "never") -> list[str]:
    """All blocks of a page in order, in one folder, those of Python in one program; what commands and it print."""
    install_command(folder)
    search = (ROOT / "src", folder)
    outputs, program = [], ""
    for block in blocks(page):
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "python":
            program += block.text + "\n"
        elif without not in block.text:
            assert block.language == "sh"
            outputs.append(run(["sh", "-ec", block.text], folder, search))
    return [*outputs, run([sys.executable, "-c", program], folder, search)]


def test_five_minutes(tmp_path: Path, compiler: tuple[str, ...]) -> None:
    """Problem file, command line, Python, firmware; the table of files is that of the folder."""
    exported, stepped = walk("docs/start.md", tmp_path)
    assert "check passed" in exported
    assert "status: OK 60" in exported
    assert "OK" in stepped
    assert "status: OK 60" in stepped
    assert (tmp_path / "cart.png").stat().st_size > 10_000
    text = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"`([\w.]+)`", "".join(re.findall(r"^\| (`.*?) \|", text, re.MULTILINE))))
    assert {p.name for p in (tmp_path / "cart").iterdir()} == {name for name in listed if "." in name}
    firmware(tmp_path, compiler)


def test_tutorial(tmp_path: Path, compiler: tuple[str, ...]) -> None:
    """The servo: problem file, check, loops that assert what the page says."""
    assert compiler
    checked, printed = walk("docs/tutorial.md", tmp_path, without="--target")
    assert "check passed" in checked
    assert "RK4" in checked
    assert "dense_active_set" in checked
    assert "lost: 0, 0 %; of all such flights 0 to 1.22 %" in printed
    (excess,) = re.findall(r"row 'shaft': largest violation ([\d.]+)", printed)
    assert float(excess) < 0.02


@pytest.mark.slow
def test_board_of_the_tutorial(tmp_path: Path, need: Callable[[str], str]) -> None:
    """The package for the board passes on the emulated one, and the firmware compiles without warnings."""
    need("qemu")
    install_command(tmp_path)
    found = blocks("docs/tutorial.md")
    for block in found:
        if block.file:
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
    (command,) = (b.text for b in found if "--target" in b.text)
    assert "All 200 samples agree with the host" in run(["sh", "-ec", command], tmp_path, (ROOT / "src",))
    run([need("arm"), "-std=c99", *WARNINGS, "-c", "-Iboard", "firmware.c", "-o", "firmware.o"], tmp_path, ())


def firmware(folder: Path, compiler: tuple[str, ...]) -> None:
    """The C of the page has no warnings, links, and drives the cart to the origin."""
    loop = """
#include <stdio.h>
#include "cart.h"
int controller_start(void);
cart_real controller_sample(const cart_real measured[CART_NX]);
int main(void)
{
    static cart_solver_t plant;
    cart_real x[CART_NX] = {1.0, 0.0};
    cart_real u[CART_NU];
    int k;
    cart_init(&plant);
    if (controller_start() != 0) {
        return 1;
    }
    for (k = 0; k < 100; k++) {
        u[0] = controller_sample(x);
        cart_integrate(&plant, x, u, 0.1, x);
    }
    printf("%.9f %.9f", x[0], x[1]);
    return 0;
}
"""
    (folder / "loop.c").write_text(loop, encoding="utf-8")
    run([*compiler, *WARNINGS, "-Icart", "cart/cart.c", "firmware.c", "loop.c", "-lm", "-o", "loop"], folder, ())
    position, speed = map(float, run([str(folder / "loop")], folder, ()).split())
    assert abs(position) < 1e-3
    assert abs(speed) < 1e-3


def _ocp() -> tuple[OCP, ca.SX]:
    ocp = OCP("refused", T=1.0, N=4)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    return ocp, x


@pytest.mark.parametrize(
    ("feature", "state"),
    [
        ("general cost", lambda ocp, x: ocp.stage_cost(x**4)),
        ("general cost", lambda ocp, x: ocp.terminal_cost(x**4)),
        ("integrated cost", lambda ocp, x: ocp.stage_cost(x**4, integrate=True)),
    ],
)
def test_what_is_refused_is_refused_by_name(feature: str, state: Callable[[OCP, ca.SX], None]) -> None:
    ocp, x = _ocp()
    assert generate(ocp)
    state(ocp, x)
    assert generate(ocp)
    with pytest.raises(OptionError, match=feature):
        generate(ocp, Options(hessian=GaussNewton()))


# Economic NMPC -------------------------------------------------------------------------------------------------------


def test_economic_page(tmp_path: Path, compiler: tuple[str, ...]) -> None:
    """Both programs, which assert that their loops end where they should."""
    pytest.importorskip("clarabel")
    constant, periodic = (
        run([sys.executable, "-c", b.text], tmp_path, (ROOT / "src",)) for b in blocks("docs/economic.md")
    )
    assert "strictly dissipative" in constant
    assert "OK 160" in constant
    assert "EUR per hour" in periodic


# How to add a component ----------------------------------------------------------------------------------------------


def follow(page: str, tmp_path: Path) -> tuple[Path, Path]:
    """Apply the edits of a page to a copy of the compiler and run its programs; the folders to import from."""
    copy_tree(tmp_path)
    program = []
    for block in blocks(page):
        path = tmp_path / block.file
        if block.language == "diff":
            path.write_text(changed(path.read_text(encoding="utf-8"), block.text), encoding="utf-8")
        elif block.file:
            assert not path.exists(), f"{block.file} exists by now: the page needs another example"
            path.write_text(block.text, encoding="utf-8")
        else:
            program.append(block.text)
    search = (tmp_path / "src", tmp_path)
    run([sys.executable, "-c", "\n".join(program)], tmp_path, search)
    return search


def test_feature_page(tmp_path: Path, compiler: tuple[str, ...]) -> None:
    """A feature of the real-time iteration and an integrator with memory per node, as the page adds them."""
    assert compiler
    follow("docs/add-a-hooked-part.md", tmp_path)


@pytest.mark.slow
def test_component_page(tmp_path: Path, compiler: tuple[str, ...]) -> None:
    """The edits of the page, applied to a copy of the compiler, give a component that passes the test of the page."""
    assert compiler
    search = follow("docs/add-a-component.md", tmp_path)
    options = run([sys.executable, "-m", "nmpc_codegen.cli", "--list-options"], tmp_path, search)
    assert "hessian=scaled_identity" in options
    export = ["examples/crane.py", "-o", "crane", "--set", "hessian=scaled_identity", "--set", "hessian.scale=2"]
    assert "hessian.scale" in options
    run([sys.executable, "-m", "nmpc_codegen.cli", *export], tmp_path, search)
    assert "Q = scale I" in (tmp_path / "crane" / "crane.c").read_text(encoding="utf-8")


# Claims and links ----------------------------------------------------------------------------------------------------


def test_problem_class_scaling_and_signs() -> None:
    """docs/problem-class.md: the factor 1/2, no dt, no term at N, lam_0 = gradient of the optimal cost in xhat.

    x+ = x + dt u, N = 1: cost = (x^2 + u^2)/2 + w (x + dt u)^2/2 by hand.
    """
    dt, w, x0 = 0.5, 3.0, 2.0
    ocp = OCP("signs", T=dt, N=1)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: u})
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    ocp.terminal_least_squares(x, weight=w)
    ocp.subject_to(-1, u, 1)
    controller = build(ocp, profile="test")
    solution = controller.solve(np.array([x0]), tol=1e-12)
    # Free optimum u = -w dt x / (1 + w dt^2) = -12/7 < -1: the lower bound is active.
    x1 = x0 - dt
    np.testing.assert_allclose(solution.u, [[-1.0]], rtol=1e-14)
    np.testing.assert_allclose(solution.cost, (x0**2 + 1) / 2 + w * x1**2 / 2, rtol=1e-14)
    np.testing.assert_allclose(solution.lam, [[x0 + w * x1], [w * x1]], rtol=1e-13)
    np.testing.assert_allclose(solution.mu_u, [[1 - w * x1 * dt]], rtol=1e-13)
    assert solution.mu_u[0, 0] < 0


#: Pages whose blocks run one by one, or, if they go on from each other, as one program.
APART, TOGETHER = ("algebraic", "estimation", "formulations", "samples"), ("campaigns", "logs", "many")
#: Pages with tests of their own, in other modules and here; the block of papers is an excerpt of generated C, which the
#: program of that page writes.
APART_FROM_HERE = ("README", "derivatives", "firmware", "papers")
BY_NAME = (
    *(
        "add-a-component",
        "add-a-hooked-part",
        "economic",
        "how-it-works",
        "integrators",
        "start",
        "statuses",
        "tutorial",
    ),
    *("coming-from-acado", "coming-from-acados", "coming-from-casadi-opti", "coming-from-do-mpc", "which-options"),
)


def test_every_block_is_run() -> None:
    found = {Path(page).stem for page in documents()}
    assert found == {*APART, *TOGETHER, *BY_NAME, *APART_FROM_HERE}


@pytest.mark.usefixtures("compiler")
@pytest.mark.few(4)
@pytest.mark.parametrize("page", [*APART, *TOGETHER])
def test_programs_of_the_reference_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = blocks(f"docs/{page}.md")
    assert found
    shared: dict[str, Any] = {}
    for block in found:
        if block.language != "text":
            exec(block.text, shared if page in TOGETHER else {})


# Those who come from other tools --------------------------------------------------------------------------------------


def shown(page: str) -> dict[str, Any]:
    """The names that the blocks of a page define, in order."""
    names: dict[str, Any] = {}
    for block in blocks(f"docs/coming-from-{page}.md"):
        exec(block.text, names)
    return names


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("page", "scale"), [("acado", 1.0), ("acados", 0.3)])
def test_pages_for_users_of_c_code(page: str, scale: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost has the scaling that the page states: nodes times 1 or dt, no factor at the end."""
    monkeypatch.chdir(tmp_path)
    names = shown(page)
    ocp, options = names["ocp"], names["options"]
    assert options.integrator.steps == 3
    solution = build(ocp, options, profile="test").solve(np.array([4.0, 0.0, 0.0, 0.0]), tol=1e-9)
    assert solution.status.name == "OK"
    assert np.abs(solution.u).max() == pytest.approx(1.0)
    path = np.sum(solution.x[:-1] ** 2) + np.sum(solution.u**2)
    assert solution.cost == pytest.approx(scale * path / 2 + 5 * np.sum(solution.x[-1] ** 2) / 2, rel=1e-12)
    assert (tmp_path / "crane" / "crane.c").exists() == (page == "acado")


@pytest.mark.usefixtures("compiler")
def test_page_for_users_of_opti() -> None:
    """IPOPT's solution of the block of Opti is that of ours."""
    names = shown("casadi-opti")
    solution, theirs = names["solution"], names["by_ipopt"]
    assert solution.status is Status.OK
    np.testing.assert_allclose(solution.u, theirs.value(names["U"]).T, atol=1e-6)
    np.testing.assert_allclose(solution.x, theirs.value(names["X"]).T, atol=1e-6)
    assert solution.cost == pytest.approx(theirs.value(names["cost"]), rel=1e-6)


#: Controls of the loop of the page by do-mpc 5.1.2.
DO_MPC = (
    *(-1.0, -1.0, *[0.0] * 18),
    *(0.000000, 0.009568, 0.202800, 0.334104, 0.359178, 0.312301, 0.238409, 0.167603, 0.112689, 0.075042),
    *(0.050981, 0.035921, 0.026220, 0.019564, 0.014691, 0.010979, 0.008126, 0.005955, 0.004333, 0.003141),
)


@pytest.mark.usefixtures("compiler")
def test_page_for_users_of_do_mpc() -> None:
    """The loop has the controls of do-mpc's, which solves every sample to convergence."""
    np.testing.assert_allclose(shown("do-mpc")["log"].u[:, 0], DO_MPC, atol=2e-6)


@pytest.mark.usefixtures("compiler")
def test_page_of_the_options() -> None:
    """Its call, of fewer flights, for the cart of the page of campaigns."""
    names: dict[str, Any] = {}
    exec(blocks("docs/campaigns.md")[0].text.partition("result =")[0], names)
    (block,) = blocks("docs/which-options.md")
    exec(block.text.replace("1000", "30"), names)
    assert names["choice"].line.startswith(("Options(", "OCP(..."))


@pytest.mark.usefixtures("compiler")
def test_status_page(tmp_path: Path) -> None:
    """Its program meets the statuses that it asserts, and the page names every status."""
    (block,) = blocks("docs/statuses.md")
    printed = run([sys.executable, "-c", block.text], tmp_path, (ROOT / "src",))
    assert "first RELAXED: sample 0, t = 0 s: no plan meets all hard rows" in printed
    text = (ROOT / "docs" / "statuses.md").read_text(encoding="utf-8")
    assert [s.name for s in Status if not re.search(rf"^\| {s.name} \|", text, re.MULTILINE)] == []


def test_page_of_the_pipeline(tmp_path: Path) -> None:
    """Its blocks in their order: every value is as it is shown."""
    run([sys.executable, "-c", "\n".join(b.text for b in blocks("docs/how-it-works.md"))], tmp_path, (ROOT / "src",))


def test_page_of_the_integrators(tmp_path: Path) -> None:
    """Its blocks in their order."""
    text = "\n".join(b.text for b in blocks("docs/integrators.md"))
    assert "SDIRK3" in run([sys.executable, "-c", text], tmp_path, (ROOT / "src",))


STATED = [(page, i) for page in documents() for i, block in enumerate(blocks(page)) if block.states_a_problem]


@pytest.mark.few(2)
@pytest.mark.parametrize(("page", "index"), STATED)
def test_problems_of_the_documents_through_the_command_line(
    page: str, index: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    (tmp_path / "problem.py").write_text(blocks(page)[index].text, encoding="utf-8")
    assert main(["problem.py", "-o", "c"]) == 0, capsys.readouterr().err
    assert len(list((tmp_path / "c").glob("*.c"))) == 2


def test_names_in_the_page_for_acado() -> None:
    """Every C name occurs in the header of such a problem."""
    text = (ROOT / "docs" / "coming-from-acado.md").read_text(encoding="utf-8")
    ocp = OCP("crane", T=1.0, N=2)
    x, a, length = ocp.state("x"), ocp.control("a"), ocp.parameter("L", value=1.0)
    ocp.dynamics({x: a * length})
    ocp.least_squares(ca.vertcat(x, a), weight=1.0)
    ocp.terminal_least_squares(x, weight=1.0)
    ocp.subject_to(-1, a, 1)
    header = set(re.findall(r"\w+", generate(ocp)["crane.h"]))
    used = set(re.findall(r"\b(?:crane|CRANE)_\w+", text))
    assert len(used) > 10
    assert used <= header


def test_page_of_the_examples_is_complete() -> None:
    """Every example has its heading and its figure there."""
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    for path in (ROOT / "examples").glob("*.py"):
        assert f"(../examples/{path.name})" in page
        assert f"({path.stem}.png)" in page


#: Variable of the pages -> what it is.
NAMED = {
    "ocp": OCP,
    "ctrl": Controller,
    "controller": Controller,
    "observer": Observer,
    "log": Log,
    "solution": Solution,
    "result": Campaign,
    "choice": Choice,
    "recorder": Recorder,
}


@pytest.mark.parametrize("document", sorted((ROOT / "docs").rglob("*.md")), ids=lambda p: p.name)
def test_attributes_on_pages_exist(document: Path) -> None:
    """What spans of code call of a problem, a controller, a log, ..."""
    text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    if document.name.startswith("coming-from"):
        text = re.sub(r"^\|.*?[^\\]\|", "", text, flags=re.MULTILINE)  # the first column has the other tool's words
    spans = " ".join(re.findall(r"`[^`]+`", text))
    for variable, name in re.findall(r"(?<![\w.])(\w+)\.(\w+)", spans):
        if variable in NAMED and name != "py":
            known = {*dir(NAMED[variable]), *stated(NAMED[variable])}
            assert name in known, f"{variable}.{name}"


def stated(cls: type) -> set[str]:
    """Names that the sections of attributes of a class and its bases explain."""
    return set().union(*(entries(inspect.getdoc(base) or "", "Attributes") for base in cls.__mro__))


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_links_lead_somewhere(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text)
    assert not [t for t in targets if "://" not in t and not (document.parent / t).exists()]


def test_times_of_the_readme_are_those_of_the_page() -> None:
    def rows(page: str) -> list[list[str]]:
        lines = re.findall(r"^\| (.*) \|$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE)
        cells = [line.split(" | ") for line in lines]
        return [[name, *(time.split(",")[0] for time in times)] for name, *times in cells]

    complete = {row[0]: [row[1], row[3], row[4]] for row in rows("docs/performance.md") if len(row) == 7}
    short = [row for row in rows("README.md")[1:] if len(row) == 4]
    assert len(short) == 4
    assert all(complete[name] == times for name, *times in short)


@pytest.mark.parametrize("page", ["README.md", "packaging/runtime/README.md"])
def test_pages_of_an_index_have_absolute_links(page: str) -> None:
    """To pages and pictures of the site that exist, at the address of the project."""
    text = (ROOT / page).read_text(encoding="utf-8")
    home = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Homepage"]
    assert f"site_url: {home}\n" in (ROOT / "site" / "mkdocs.yml").read_text(encoding="utf-8")
    targets = re.findall(r"(?:\]\(|src=\"|^\[[\w-]+\]: )([^)#\s\"]+)", text, re.MULTILINE)
    assert targets
    for target in targets:
        assert target.startswith((home, "https://pypi.org/project/nmpc-codegen"))
        name = target.removeprefix(home).replace(".html", ".md")
        assert "://" in name or name in ("", "contributing.md", "changelog.md") or (ROOT / "docs" / name).exists(), name


def test_documented_make_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    used = {t for d in DOCUMENTS for t in re.findall(r"`make ([a-z]+)|^    make ([a-z]+)", d.read_text(), re.MULTILINE)}
    names = {name for pair in used for name in pair if name}
    assert {"demo", "test"} <= names <= targets


def test_pictures_are_small() -> None:
    pictures = list((ROOT / "docs").glob("*.png"))
    assert pictures
    assert all(path.stat().st_size < 150_000 for path in pictures)
