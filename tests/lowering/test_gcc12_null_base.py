"""GCC 12 at -O2 removes calls of functions whose stores it mistakes for stores to NULL: a reproducer, and the remedy.

Its loop optimiser may split an address into a null base and an index that holds the rest. The analysis of side effects
then finds only stores to NULL, which cannot happen, and concludes that the function has no effects. The behaviour of
the program is well-defined.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from nmpc_codegen import NoCondensing, Options, RiccatiActiveSet, generate
from nmpc_codegen.lowering.render import GCC_12
from nmpc_codegen.package.sources import Sources
from tests.conftest import require_tool
from verification import problems

PROGRAM = """
#include <stdio.h>

enum { NODES = 24, FIRST = 9, INPUTS = 3, WIDTH = FIRST + INPUTS };

typedef struct {
    double unrelated[10];
    double table[NODES][WIDTH];
    double price[NODES * INPUTS];
    double offset[WIDTH];
} plant_t;

static plant_t plant;

/* The last columns of the table: price + offset. */
__attribute__((noinline)) static void update_table(plant_t *p)
{
    for (int n = 0; n < NODES; ++n) {
        for (int i = 0; i < INPUTS; ++i) {
            p->table[n][FIRST + i] = p->offset[FIRST + i] + p->price[n * INPUTS + i];
        }
    }
}

__attribute__((noinline)) static void set_price(plant_t *p, double price)
{
    for (int i = 0; i < NODES * INPUTS; ++i) {
        p->price[i] = price;
    }
    update_table(p);
}

int main(void)
{
    set_price(&plant, 7.0);
    printf("%g\\n", plant.table[3][FIRST + 1]);
    return 0;
}
"""

OPTIONS = tuple(f"-f{option}" for option in GCC_12)
PRAGMA = re.compile(r"^#pragma GCC optimize.*$", re.MULTILINE)


@pytest.fixture(scope="module")
def gcc() -> str:
    return require_tool("gcc")


def output(gcc: str, files: Sources, flags: Sequence[str], folder: Path) -> str:
    """Output of the program."""
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    units = [name for name in files if name.endswith(".c")]
    subprocess.run([gcc, "-std=c99", *flags, *units, "-lm", "-o", "program"], cwd=folder, check=True)
    return subprocess.run([folder / "program"], capture_output=True, text=True, check=True).stdout


def major(gcc: str) -> int:
    """Version of GCC; 0 for another compiler with that name."""
    macros = subprocess.run(
        [gcc, "-dM", "-E", "-x", "c", "/dev/null"], capture_output=True, text=True, check=True
    ).stdout
    found = re.search(r"#define __GNUC__ (\d+)", macros)
    return int(found[1]) if found and "__clang__" not in macros else 0


def test_only_gcc_12_drops_the_call(gcc: str, tmp_path: Path, record_property: pytest.RecordProperty) -> None:
    """The pragma is for version 12 only: this test fails for any other version with the bug. 12.2 prints 0."""
    printed = output(gcc, {"main.c": PROGRAM}, ["-O2"], tmp_path).strip()
    record_property("gcc_major", major(gcc))
    record_property("drops_the_call", printed == "0")
    assert printed in (("0", "7") if major(gcc) == 12 else ("7",))
    assert output(gcc, {"main.c": PROGRAM}, ["-O0"], tmp_path).strip() == "7"


@pytest.mark.parametrize("level", ["-O1", "-O2", "-O3", "-Os"])
def test_the_option_heals_it(gcc: str, level: str, tmp_path: Path) -> None:
    assert "-fno-delete-null-pointer-checks" in OPTIONS
    assert output(gcc, {"main.c": PROGRAM}, [level, "-fno-delete-null-pointer-checks"], tmp_path).strip() == "7"
    assert output(gcc, {"main.c": PROGRAM}, [level, *OPTIONS], tmp_path).strip() == "7"


def test_the_pragma_of_the_package_heals_it(gcc: str, tmp_path: Path) -> None:
    """The pragma with its condition, as in the .c."""
    text = problems.sources("tiny")["tiny.c"]
    (block,) = re.findall(r"^#if defined\(__OPTIMIZE__\).*?^#endif$", text, re.MULTILINE | re.DOTALL)
    assert "__GNUC__ == 12" in block
    assert PRAGMA.search(block)
    assert output(gcc, {"main.c": block + PROGRAM}, ["-O2"], tmp_path).strip() == "7"


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "riccati"), [("crane", False), ("path_rows", True)])
def test_controls_with_the_options_instead_of_the_pragma(gcc: str, name: str, riccati: bool, tmp_path: Path) -> None:
    """Thirty samples of main.c agree in all printed digits, at -O2 and, without pragma and options, at -O0.

    test_solve.py compares the dense solver, with the pragma at -O2, with IPOPT.
    """
    on_stages = Options(qp=RiccatiActiveSet(), condensing=NoCondensing(), solve=False)
    options = on_stages if riccati else Options(solve=False)
    package = generate(problems.CASES[name].make(), options)
    files = {path: text for path, text in package.items() if path.endswith((".c", ".h"))}
    unit = next(path for path in files if path.endswith(".c") and path != "main.c")
    assert len(PRAGMA.findall(files[unit])) == 1
    bare = {**files, unit: PRAGMA.sub("", files[unit])}
    with_options = output(gcc, bare, ["-O2", *OPTIONS], tmp_path)
    assert sum(line.split()[1] == "ok" for line in with_options.splitlines()) == 30
    if riccati:
        assert output(gcc, files, ["-O2"], tmp_path) == with_options
    assert output(gcc, bare, ["-O0"], tmp_path) == with_options


def test_readme_and_cmake_have_the_options() -> None:
    package = problems.sources("tiny")
    assert " ".join(OPTIONS) in package["README.md"]
    assert f"target_compile_options(tiny PRIVATE {' '.join(OPTIONS)})" in package["CMakeLists.txt"]
