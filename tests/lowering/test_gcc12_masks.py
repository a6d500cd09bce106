"""GCC 12 with AVX loads two registers with the mask of the first one in loops y[k][j] = flag[k][j] ? 0 : x[k][j].

The flags are 32 bits wide, x is double, and the inner loop has two passes. No package may contain such a loop where the
vectoriser uses masks.
"""

import platform
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import require_tool

from nmpc_codegen import generate
from verification.samples import SAMPLES
from verification.timed import TIMED, Sample

FLAGS = ("-std=c99", "-O2", "-fno-math-errno", "-fno-trapping-math", "-march=x86-64-v3", "-ffp-contract=fast", "-w")
#: Every family of solvers and algorithms once.
NAMES = ("timed crane", "timed cstr", "timed bioreactor", "soft rows dense", "everything at stages")
LOOP = """
#include <stdint.h>
typedef struct {
    double x[20][2], y[20][2];
    int32_t flag[20][2];
} data_t;
void mask(data_t *a)
{
    for (int k = 0; k < 20; k++) {
        for (int j = 0; j < 2; j++) {
            a->y[k][j] = a->flag[k][j] ? 0.0 : a->x[k][j];
        }
    }
}
"""


@pytest.fixture(scope="module")
def shared_masks(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], list[str]]:
    """(name, C text) -> masks that loads from successive registers share; skipped unless GCC 12 builds for AVX2."""
    gcc = require_tool("gcc")
    version = subprocess.run([gcc, "-dumpversion"], capture_output=True, text=True, check=True).stdout
    if not version.startswith("12") or platform.machine() != "x86_64":
        pytest.skip("no GCC 12 for x86-64")

    def found(name: str, text: str) -> list[str]:
        folder = tmp_path_factory.mktemp("masks")
        (folder / f"{name}.c").write_text(text, encoding="utf-8")
        subprocess.run([gcc, *FLAGS, "-c", "-fdump-tree-vect", f"{name}.c"], cwd=folder, check=True)
        (dump,) = folder.glob("*.vect")
        return shared(dump)

    return found


def shared(dump: Path) -> list[str]:
    """Masks of loads whose address is that of an earlier load with the same mask plus the size of a register."""
    wrong, loads, moved = list[str](), set[tuple[str, str]](), dict[str, str]()
    for line in dump.read_text(encoding="utf-8").splitlines():
        if line.startswith(";; Function"):
            loads, moved = set(), {}
        elif step := re.match(r"\s*(\S+) = (\S+) \+ (?:16|32);", line):
            moved[step[1]] = step[2]
        elif load := re.search(r"\.MASK_LOAD \((\S+), \S+, (\S+?)\)", line):
            if (moved.get(load[1], ""), load[2]) in loads:
                wrong.append(load[2])
            loads.add((load[1], load[2]))
    return wrong


def test_the_fault_is_seen(shared_masks: Callable[[str, str], list[str]]) -> None:
    """The scan recognises the loop that GCC 12.2 compiles wrongly; other versions 12 may not have the fault."""
    full = subprocess.run(["gcc", "-dumpfullversion"], capture_output=True, text=True, check=True).stdout
    assert len(shared_masks("loop", LOOP)) in ((1,) if full.startswith("12.2") else (0, 1))


@pytest.mark.few(1)
@pytest.mark.parametrize("sample", [s for s in (*TIMED, *SAMPLES) if s.name in NAMES], ids=lambda s: s.name)
def test_packages_without_shared_masks(shared_masks: Callable[[str, str], list[str]], sample: Sample) -> None:
    files = generate(sample.make(), sample.options)
    name = sample.make().name
    text = files[f"{name}.c"].replace(f'#include "{name}.h"', files[f"{name}.h"])
    assert shared_masks(name, text) == []
