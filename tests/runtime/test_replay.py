"""Dumps of a target, here of C programs on this machine, replayed to the bit."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from nmpc_codegen import Controller, ControllerError, OptionError, Options, Status, export, generate, replay
from nmpc_codegen.lowering.beside.dumps import ring_bytes
from nmpc_codegen.runtime.build import WARNINGS
from nmpc_codegen.runtime.compilers import find_compiler
from tests.runtime.test_log import tank

PROGRAM = """
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include "tank_dumps.h"

static tank_solver_t s;
static tank_dumps_t d;

static void save(int number)
{
    FILE *f = fopen("dumps.bin", "wb");
    (void)fwrite(&d, sizeof d, 1, f);
    (void)fclose(f);
    f = fopen("solver.bin", "wb");
    (void)fwrite(&s, sizeof s, 1, f);
    (void)fclose(f);
    _Exit(number ? 7 : 0);
}

int main(void)
{
    tank_real x[TANK_NX] = {1}, u[TANK_NU];
    (void)signal(SIGSEGV, save);
    (void)tank_init(&s);
    tank_dumps_init(&d);
    for (int k = 0; k < 10; k++) {
        if (k == 6) {
            (void)tank_set_bounds(&s, TANK_ROW_POWER, TANK_ALL, (tank_real)1.5, (tank_real)2);
        }
        if (tank_dumps_step(&d, &s, k == NO_X ? NULL : x, k == NO_U ? NULL : u) == TANK_RELAXED && k == HOLD) {
            d.hold = 1U;
        }
        tank_integrate(&s, x, u, (tank_real)0.2, x);
    }
    save(0);
    return 0;
}
"""


def run(folder: Path, status: int = 0, **at: int) -> None:
    """Compile the program as the package says, with all warnings, and run it; ``at``: samples where something is done:
    HOLD, NO_X and NO_U, null pointers."""
    (folder / "program.c").write_text(PROGRAM)
    flags = [*WARNINGS, "-O2", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off"]
    flags += [f"-D{word}={at.get(word, -1)}" for word in ("HOLD", "NO_X", "NO_U")]
    command = [*find_compiler(), *flags, "program.c", "tank.c", "-o", "program", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    assert subprocess.run([str(folder / "program")], cwd=folder, check=False).returncode == status


@pytest.fixture(scope="module", params=["double", "single"])
def target(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp(request.param)
    export(tank(), Options(precision=request.param), folder, dumps=4)
    run(folder)
    return folder


def test_a_ring_is_replayed_to_the_bit(target: Path, tmp_path: Path) -> None:
    """The last four samples, their status and row, the plan that the last one left."""
    found = replay(target / "dumps.bin", target)
    assert [s.number for s in found.samples] == [7, 8, 9, 10]
    assert found.same
    assert all(s.again == s.status and s.difference == 0.0 for s in found.samples)
    assert found.status == Status.RELAXED
    assert (found.sample.number, found.row, found.node) == (7, "power", 0)
    text = str(found)
    assert "sample 7: RELAXED, row 'power' at node 0" in text
    assert "replayed to the bit" in text
    assert "of sample 7: RELAXED" in text
    figure = found.plot(file=tmp_path / "plan.png")
    assert [axis.get_ylabel() for axis in figure.axes] == ["level [m]", "flow [m³/h]", "power"]
    assert "plan of sample 7, RELAXED" in figure.get_suptitle()
    assert "plan of sample 9" in found.plot(9, tmp_path / "plan.png").get_suptitle()
    with pytest.raises(ControllerError, match="there is no sample 3; expected one of 7, 8, 9, 10"):
        found.plot(3)


def test_a_copy_of_the_solver(target: Path) -> None:
    """It says what the last sample said; from there the loop goes on as the target's would."""
    found = replay((target / "solver.bin").read_bytes(), target)
    assert bytes(found.controller) == (target / "solver.bin").read_bytes()
    ring = replay(target / "dumps.bin", target)
    assert (found.status, found.row) == (Status.OK, None)
    np.testing.assert_array_equal(found.controller.x, ring.samples[-1].controller.x)
    again = replay(target / "solver.bin", target, xhat=[1.2])
    np.testing.assert_array_equal(again.samples[0].u, ring.samples[-1].controller.copy().step([1.2]))


def test_a_target_that_differs_is_seen(target: Path) -> None:
    data = bytearray((target / "dumps.bin").read_bytes())
    ctrl = replay(target / "dumps.bin", target).controller
    slot = (len(data) - 40) // 4
    place = 40 + 2 * slot - 16  # u of the second slot: behind it status and number, in single precision 8 bytes nearer
    place += 4 if ctrl.description.precision == "single" else 0
    data[place] ^= 1
    found = replay(bytes(data), target)
    assert [s.same for s in found.samples].count(False) == 1
    assert not found.same
    assert "the replay differs: OK, controls by" in str(found)


def test_hold_keeps_what_led_to_a_fault(tmp_path: Path) -> None:
    export(tank(), None, tmp_path, dumps=3)
    run(tmp_path, HOLD=6)
    assert [s.number for s in replay(tmp_path / "dumps.bin", tmp_path).samples] == [5, 6, 7]


def test_other_bytes_are_refused(target: Path) -> None:
    ctrl: Controller = replay(target / "solver.bin", target).controller
    ring = (target / "dumps.bin").read_bytes()
    for data, message in (
        (b"", "0 bytes are no dump; a tank_solver_t has"),
        (bytes(ctrl.nbytes), "are no initialised tank_solver_t of this package"),
        (ring[:-1], "the dump is cut or damaged"),
        (b"0123456789abcdef" + ring[16:], "are no tank_dumps_t of this package"),
        (ring[:40] + bytes(len(ring) - 40), "the dump holds no sample"),
    ):
        with pytest.raises(ControllerError, match=message):
            replay(data, ctrl)
    with pytest.raises(ControllerError, match="xhat belongs to the copy of a solver"):
        replay(ring, ctrl, xhat=[1.0])


@pytest.mark.parametrize("slots", [-1, 1001, 2.0, True])
def test_numbers_of_slots(tmp_path: Path, slots: object) -> None:
    with pytest.raises(OptionError, match=r"dumps is .*; expected the number of samples that are kept, 1 to 1000"):
        export(tank(), None, tmp_path, dumps=slots)  # type: ignore[arg-type]


def test_without_dumps_there_is_no_header(tmp_path: Path) -> None:
    assert set(generate(tank())) == {path.name for path in export(tank(), None, tmp_path).files}


def slots_of(data: bytes) -> tuple[int, int]:
    """Begin and size of the slots of a ring of four."""
    return 40, (len(data) - 40) // 4


def test_a_sample_that_the_target_did_not_end(target: Path) -> None:
    """As a fault inside the step leaves it: it is taken here, and it is the sample that is shown."""
    data = bytearray((target / "dumps.bin").read_bytes())
    begin, size = slots_of(data)
    last = begin + 2 * size  # ten samples: the third slot holds the last one
    real = 4 if replay(bytes(data), target).controller.description.precision == "single" else 8
    assert int.from_bytes(data[last - 4 : last], "little") == 10
    data[last - 8 : last - 4] = (-1).to_bytes(4, "little", signed=True)
    data[last - 8 - real : last - 8] = bytes(real)
    found = replay(bytes(data), target)
    assert (found.sample.number, found.status, found.sample.u) == (10, None, None)
    assert found.same
    assert "sample 10: the target did not end it, replayed: OK" in str(found)
    assert "of sample 10: here it ends, OK; on the target look at the pointers" in str(found)
    data[last - 8 : last - 4] = (-2).to_bytes(4, "little", signed=True)
    unread = replay(bytes(data), target)
    assert unread.sample.x is None
    assert "sample 10: the target did not end it, nor read its state" in str(unread)


@pytest.mark.parametrize(("word", "said"), [("NO_X", "nor read its state"), ("NO_U", "replayed: OK")])
def test_a_fault_inside_a_sample(tmp_path: Path, word: str, said: str) -> None:
    """A null pointer in the fifth call, in optimised code; the handler of the signal saves the ring."""
    export(tank(), None, tmp_path, dumps=3)
    run(tmp_path, 7, **{word: 4})
    found = replay(tmp_path / "dumps.bin", tmp_path)
    assert [s.number for s in found.samples] == [3, 4, 5]
    assert [s.same for s in found.samples] == [True, True, None]
    assert f"sample 5: the target did not end it, {said}" in str(found)


def test_a_solver_that_was_not_initialised_is_shown(target: Path) -> None:
    """The other samples are replayed."""
    data = bytearray((target / "dumps.bin").read_bytes())
    begin, _ = slots_of(data)
    solver = replay(bytes(data), target).controller.nbytes
    data[begin : begin + solver] = bytes(solver)
    found = replay(bytes(data), target)
    assert [s.same for s in found.samples].count(None) == 1
    assert [s.same for s in found.samples].count(True) == 3


def test_numbers_of_samples_start_again(target: Path) -> None:
    """After 2^32 samples; the order is that of the slots."""
    data = bytearray((target / "dumps.bin").read_bytes())
    begin, size = slots_of(data)
    for slot, number in enumerate((2**32 - 1, 1, 2, 2**32 - 2)):
        place = begin + (slot + 1) * size - 4
        data[place : place + 4] = number.to_bytes(4, "little")
    data[36:40] = (3).to_bytes(4, "little")
    found = replay(bytes(data), target)
    assert [s.number for s in found.samples] == [2**32 - 2, 2**32 - 1, 1, 2]


def test_a_header_of_an_earlier_export_is_removed(tmp_path: Path) -> None:
    """Unless it was edited: it belongs to another package."""
    export(tank(), None, tmp_path, dumps=4)
    assert (tmp_path / "tank_dumps.h").exists()
    export(tank(), Options(precision="single"), tmp_path)
    assert not (tmp_path / "tank_dumps.h").exists()
    export(tank(), None, tmp_path, name="tank_dumps")
    export(tank(), None, tmp_path)
    assert (tmp_path / "tank_dumps.h").exists()  # of another package
    (tmp_path / "tank_dumps.h").write_text("mine")
    export(tank(), None, tmp_path)
    assert (tmp_path / "tank_dumps.h").read_text() == "mine"


def test_the_bytes_of_a_ring_are_those_of_the_compiler(target: Path) -> None:
    described = replay(target / "solver.bin", target).controller.description
    assert ring_bytes(described, 4) == (target / "dumps.bin").stat().st_size
    assert f"{ring_bytes(described, 4):,} bytes" in (target / "README.md").read_text()
