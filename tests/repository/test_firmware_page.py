"""docs/firmware.md: its programs compile, and the bare-metal one controls the plant on the emulated board."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import pytest
from conftest import missing, require_tool

from examples import crane, quadrotor
from nmpc_codegen import OCP, Options, generate
from nmpc_codegen.cli import main
from nmpc_codegen.package.deviations import DEVIATIONS
from tests.repository.misra import findings
from tests.snippets import ROOT, blocks

PAGE = "docs/firmware.md"
PRECISIONS = ("double", "single")

#: What thread.c uses of Zephyr.
KERNEL = """
#include <stddef.h>
struct k_timer { int unused; };
#define K_MSEC(ms) (ms)
#define K_FP_REGS 2
#define K_TIMER_DEFINE(name, expiry, stop) static struct k_timer name
void k_timer_start(struct k_timer *timer, int first, int period);
unsigned k_timer_status_sync(struct k_timer *timer);
#define K_THREAD_DEFINE(name, stack, entry, a, b, c, priority, options, delay) \\
    void (*const name)(void *, void *, void *) = entry
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cart of the first page, exported for a target, and the programs of the page beside it."""
    for tool in ("cc", "arm", "qemu", "make"):
        require_tool(tool)
    place = tmp_path_factory.mktemp("page")
    for document in ("docs/start.md", PAGE):
        for block in blocks(document):
            if block.file:
                (place / block.file).write_text(block.text, encoding="utf-8")
    command = [str(place / "cart.py"), "-o", str(place / "cart"), "--set", "precision=single", "--set", "solve=False"]
    assert main([*command, "--target", "cortex-m4f", "--level", "Os"]) == 0
    return place


@pytest.mark.slow
def test_bare_metal_program(folder: Path) -> None:
    """The commands of the page build it; on the board it brings the cart to rest, and no preparation is late."""
    text = (ROOT / PAGE).read_text(encoding="utf-8").replace("\\\n", " ")
    commands = [shlex.split(line) for line in re.findall(r"^    ((?:make|arm|qemu).*)$", text, re.MULTILINE)]
    assert [command[0] for command in commands] == ["make", "arm-none-eabi-gcc", "qemu-system-arm"]
    for command in commands:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, done.stderr + done.stdout


@pytest.mark.slow
def test_thread(folder: Path) -> None:
    (folder / "zephyr").mkdir()
    (folder / "zephyr" / "kernel.h").write_text(KERNEL)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-fsyntax-only", "-I.", "-Icart"]
    done = subprocess.run([require_tool("arm"), *flags, "thread.c"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_names_of_the_page(folder: Path) -> None:
    """Every function and constant of the package that the page names exists."""
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    headers = (folder / "cart" / "cart.h").read_text() + (folder / "cart" / "firmware" / "selftest.h").read_text()
    used = {word for word in re.findall(r"\b(?:cart|CART)_\w+", text) if word != "cart_solve"}
    assert len(used) > 15
    assert used <= set(re.findall(r"\w+", headers))


def tank() -> OCP:
    """A tank with a parameter, a limit on the rate of its pump and a soft row on its level."""
    ocp = OCP("tank", T=2.0, N=10)
    level, flow, width = ocp.state("level", initial=1.0), ocp.control("flow"), ocp.parameter("width", value=0.5)
    ocp.dynamics({level: flow - width * ca.sqrt(level + 0.1)})
    ocp.least_squares(ca.vertcat(level - 1, flow), weight=[1.0, 0.1])
    ocp.subject_to(0, flow, 2)
    ocp.subject_to(-1, ocp.rate(flow), 1)
    ocp.subject_to(0.5, level, 1.5, soft=(10.0, 1.0))
    return ocp


@pytest.mark.parametrize(
    ("make", "precision"),
    [
        (tank, "single"),
        *(
            pytest.param(m, p, marks=pytest.mark.slow)
            for m in (crane.build_ocp, quadrotor.build_ocp)
            for p in PRECISIONS
        ),
        pytest.param(tank, "double", marks=pytest.mark.slow),
    ],
)
def test_deviations_are_documented(make: Callable[[], OCP], precision: str) -> None:
    """Every rule of which the addon reports a finding in a package has a reason."""
    require_tool("cppcheck")
    ocp = make()
    found = findings(generate(ocp, Options(precision=precision)), ocp.name)
    if found is None:
        missing("this cppcheck has no MISRA addon", "misra")
    assert found, "the addon reports nothing: is the test blind?"
    assert not set(found) - set(DEVIATIONS)
    assert all(re.fullmatch(r"\d+\.\d+", rule) and len(reason) > 20 for rule, reason in DEVIATIONS.items())


def test_deviations_stand_in_the_package_of_a_target() -> None:
    text = generate(tank(), Options(target="cortex-m4f", precision="single", solve=False))["tank.c"]
    head = text[: text.index("*/")]
    assert all(f" {rule} " in head and reason in head for rule, reason in DEVIATIONS.items())
