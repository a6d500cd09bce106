"""Recordings of real loops: the same log, whatever happens to the program, its disk and its deadlines."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import Controller, ControllerError, Log, Recorder, Status, build, export, open_recording, simulate
from nmpc_codegen.runtime.records import recorder, stream
from tests.runtime.test_log import change, tank

STEPS = 60


@pytest.fixture(scope="module")
def ctrl() -> Controller:
    return build(tank(), profile="test")


def fly(r: Recorder, c: Controller, steps: int = STEPS) -> None:
    """The loop of simulate(), by hand."""
    x = np.array([1.0])
    for k in range(steps):
        change(k, c)
        u = r.step(x)
        x = c.integrate(x, u, 0.2)


@pytest.mark.parametrize("file", [None, "run.rec"])
def test_the_same_log_as_of_a_simulation(ctrl: Controller, tmp_path: Path, file: str | None) -> None:
    """With plans, bounds, rows, parameters and reasons; x after the last sample is not known."""
    expected = simulate(ctrl.copy(), [1.0], STEPS, before=change)
    c = ctrl.copy()
    with Recorder(c, file=None if file is None else tmp_path / file) as r:
        fly(r, c)
        found = r.log()
    if file is not None:
        found = open_recording(tmp_path / file, ctrl)
    for name, value in vars(expected).items():
        if name in ("x", "time_ns", "plans", "began_ns"):
            continue
        other = getattr(found, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_allclose(other, value, rtol=1e-14, err_msg=name)
        elif name == "reasons":
            assert list(other) == list(value)
        else:
            assert other == value
    np.testing.assert_array_equal(found.x[:-1], expected.x[:-1])
    assert np.isnan(found.x[-1]).all()
    assert found.plans is not None
    assert expected.plans is not None
    for name, value in vars(expected.plans).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_allclose(getattr(found.plans, name), value, rtol=1e-12, atol=1e-12, err_msg=name)
    assert (np.diff(found.began_ns) > 0).all()
    assert (found.time_ns > 0).all()
    assert "period" in found.summary()
    found.plot(tmp_path / "loop.png")
    found.plot_times(file=tmp_path / "times.png")
    found.save(tmp_path / "log.npz")
    np.testing.assert_array_equal(Log.load(tmp_path / "log.npz").began_ns, found.began_ns)


def test_the_controls_are_those_of_the_controller(ctrl: Controller) -> None:
    """A recorded step returns what step() returns; phases are recorded, too."""
    one, two = ctrl.copy(), ctrl.copy()
    with Recorder(one) as r:
        for k in range(5):
            np.testing.assert_array_equal(r.step([1.0 + 0.1 * k]), two.step([1.0 + 0.1 * k]))
        one.prepare()
        np.testing.assert_array_equal(r.feedback([1.5]), two.step([1.5]))
        assert r.log().x[:-1, 0].tolist() == pytest.approx([1.0, 1.1, 1.2, 1.3, 1.4, 1.5])


def test_memory_holds_the_last_samples(ctrl: Controller) -> None:
    c = ctrl.copy()
    with Recorder(c, keep=16) as r:
        fly(r, c, 50)
        log = r.log()
    assert len(log.u) == 16
    expected = simulate(ctrl.copy(), [1.0], 50, before=change)
    np.testing.assert_array_equal(log.u, expected.u[-16:])
    assert log.t[0] == pytest.approx(34 * 0.2)
    assert "missing" not in log.summary()


def test_few_plans(ctrl: Controller, tmp_path: Path) -> None:
    """Of every twentieth sample, and of those that are not OK; the file is smaller, costs elsewhere are not known."""
    sizes = []
    for plans in (1, 20):
        c = ctrl.copy()
        with Recorder(c, file=tmp_path / f"{plans}.rec", plans=plans) as r:
            fly(r, c)
        sizes.append((tmp_path / f"{plans}.rec").stat().st_size)
    log = open_recording(tmp_path / "20.rec", ctrl)
    bad = np.flatnonzero(log.status != Status.OK)
    wanted = sorted({0, 20, 40, *bad.tolist()})
    assert log.plans is not None
    assert log.plans.sample.tolist() == wanted
    assert np.flatnonzero(np.isfinite(log.cost)).tolist() == wanted
    assert sizes[1] < sizes[0]


CHILD = """
import sys, time
import numpy as np
from nmpc_codegen import Recorder, open_package
c = open_package(sys.argv[1], "test")
r = Recorder(c, file=sys.argv[2])
k = 0
while True:
    r.step([1.0 + 0.001 * k])
    k += 1
    print(k, flush=True)
    time.sleep(0.002)
"""


def test_a_killed_recording_opens(ctrl: Controller, tmp_path: Path) -> None:
    """After kill -9 all samples are there but those of the last second."""
    export(tank(), None, tmp_path / "tank")
    command = [sys.executable, "-c", CHILD, str(tmp_path / "tank"), str(tmp_path / "run.rec")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        lines = [(int(child.stdout.readline()), time.monotonic())]
        while lines[-1][1] < lines[0][1] + 2.0:
            lines.append((int(child.stdout.readline()), time.monotonic()))
        child.send_signal(signal.SIGKILL)
        lines += [(int(line), time.monotonic()) for line in child.stdout if line.endswith("\n")]
    log = open_recording(tmp_path / "run.rec", tmp_path / "tank")
    assert log.remarks == ("the recording was not closed: the program was killed, or the disk was full",)
    second_before = max(k for k, at in lines if at <= lines[-1][1] - 1.0)
    assert second_before <= len(log.u) <= lines[-1][0] + 1
    np.testing.assert_allclose(log.x[:-1, 0], 1.0 + 0.001 * np.arange(len(log.u)))


def test_every_cut_opens(ctrl: Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part is there as a whole, or not at all; a flipped bit costs the samples of its part."""
    c = ctrl.copy()
    with Recorder(c, file=tmp_path / "run.rec") as r:
        ends = []
        for _ in range(4):
            fly(r, c, 5)
            r.log()
            ends.append((tmp_path / "run.rec").stat().st_size)
    data = (tmp_path / "run.rec").read_bytes()
    counts = []
    (tmp_path / "cut.rec").write_bytes(data[: ends[0] - 1])
    with pytest.raises(
        ControllerError, match=f"has no whole sample: it is cut off, or damaged, after {ends[0] - 1} bytes"
    ):
        open_recording(tmp_path / "cut.rec", ctrl)
    for size in (ends[0], ends[1] - 1, ends[1], ends[1] + 7, ends[3]):
        (tmp_path / "cut.rec").write_bytes(data[:size])
        counts.append(len(open_recording(tmp_path / "cut.rec", ctrl).u))
    assert counts == [5, 5, 10, 10, 20]
    flipped = bytearray(data)
    flipped[ends[1] + 40] ^= 1
    (tmp_path / "cut.rec").write_bytes(flipped)
    log = open_recording(tmp_path / "cut.rec", ctrl)
    np.testing.assert_allclose(log.t[:-1], 0.2 * np.array([*range(10), *range(15, 20)]))
    assert "5 samples are missing in the recording" in log.summary()
    assert "bytes of the recording are damaged" in log.summary()
    assert "was not closed" not in log.summary()
    again = tmp_path / "log.npz"
    log.save(again)
    assert Log.load(again).remarks == log.remarks


def test_a_disk_that_stalls(ctrl: Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop in real time leaves samples out and says how many; one that runs faster waits, and loses none."""
    monkeypatch.setattr(stream, "PERIOD", 1000.0)
    for name, seconds, kept in (("real.rec", 720.0, 256), ("fast.rec", 1e-3, 300)):
        now = [0]
        monkeypatch.setattr(recorder, "perf_counter_ns", lambda now=now: now[0])
        c = ctrl.copy()
        with Recorder(c, file=tmp_path / name) as r:
            for k in range(300):
                now[0] = int(k * seconds * 1e9)
                r.step([1.0])
            assert r.dropped == 300 - kept
        assert len(open_recording(tmp_path / name, ctrl).u) == kept


def test_samples_that_were_left_out_leave_a_gap(ctrl: Controller, tmp_path: Path, monkeypatch: Any) -> None:
    c = ctrl.copy()
    with Recorder(c, file=tmp_path / "gap.rec") as r:
        fly(r, c, 5)
        monkeypatch.setattr(recorder, "make_room", lambda *_: False)
        r._ring.tail -= r._ring.slots
        r.step([1.0])
        r.step([1.0])
        r._ring.tail += r._ring.slots
        fly(r, c, 3)
    log = open_recording(tmp_path / "gap.rec", ctrl)
    np.testing.assert_allclose(log.t, 0.2 * np.array([0, 1, 2, 3, 4, 7, 8, 9, 10]))
    assert "2 samples are missing in the recording" in log.summary()


def test_a_disk_that_is_full(ctrl: Controller, tmp_path: Path) -> None:
    """The loop goes on; the end of it says how many samples are lost, and what was written before opens."""
    c = ctrl.copy()
    r = Recorder(c, file=tmp_path / "full.rec")
    fly(r, c, 5)
    r.log()
    assert r._writer is not None

    def refuse(data: bytes) -> None:
        raise OSError(28, os.strerror(28))

    r._writer._write = refuse  # type: ignore[method-assign]
    fly(r, c, 7)
    assert len(r.log().u) == 12  # those that are not written are in memory
    with pytest.raises(ControllerError, match=r"full.rec: 7 samples could not be written: .*No space left"):
        r.close()
    assert len(open_recording(tmp_path / "full.rec", ctrl).u) == 5


def test_a_call_that_is_refused_is_no_sample(ctrl: Controller) -> None:
    c = ctrl.copy()
    with Recorder(c) as r:
        r.step([1.0])
        for call in (lambda: r.step([1.0, 2.0]), lambda: r.step("abc"), lambda: r.feedback([1.0, 2.0])):
            with pytest.raises(ControllerError):
                call()
        assert r.samples == len(r.log().u) == 1


def test_a_closed_recorder_says_so(ctrl: Controller, tmp_path: Path) -> None:
    """Before the sample is taken, so that nothing vanishes."""
    c = ctrl.copy()
    r = Recorder(c, file=tmp_path / "run.rec")
    r.step([1.0])
    r.close()
    r.close()
    with pytest.raises(ControllerError, match="the recorder is closed; go on with the controller"):
        r.step([1.0])
    assert len(open_recording(tmp_path / "run.rec", ctrl).u) == r.samples == 1


def test_an_interrupt_while_it_closes(ctrl: Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """close() can be called again, and everything is written."""
    c = ctrl.copy()
    r = Recorder(c, file=tmp_path / "run.rec")
    fly(r, c, 5)
    assert r._writer is not None
    join = r._writer._thread.join

    def interrupt() -> None:
        monkeypatch.setattr(r._writer._thread, "join", join)  # type: ignore[union-attr]
        raise KeyboardInterrupt

    monkeypatch.setattr(r._writer._thread, "join", interrupt)
    with pytest.raises(KeyboardInterrupt):
        r.close()
    r.close()
    assert len(open_recording(tmp_path / "run.rec", ctrl).u) == 5


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), MemoryError(), ValueError("strange")])
def test_a_write_that_fails_once(ctrl: Controller, tmp_path: Path, error: Exception) -> None:
    """Half of a part is taken back, and the samples are written at the next attempt."""
    c = ctrl.copy()
    with Recorder(c, file=tmp_path / "run.rec") as r:
        fly(r, c, 5)
        r.log()
        writer = r._writer
        assert writer is not None
        write = writer._write

        def fail(data: bytes) -> None:
            write(data[: len(data) // 2])
            writer._write = write  # type: ignore[method-assign]
            raise error

        writer._write = fail  # type: ignore[method-assign]
        fly(r, c, 5)
        assert len(r.log().u) == 10
    assert len(open_recording(tmp_path / "run.rec", ctrl).u) == 10


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_leaves_the_recording_alone(ctrl: Controller, tmp_path: Path) -> None:
    c = ctrl.copy()
    r = Recorder(c, file=tmp_path / "run.rec")
    fly(r, c, 5)
    if (child := os.fork()) == 0:
        fly(r, c, 3)
        try:
            r.close()
        except ControllerError as error:
            os._exit("it belongs to another process" not in str(error))
        os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    fly(r, c, 2)
    r.close()
    assert open_recording(tmp_path / "run.rec", ctrl).t[:-1].tolist() == pytest.approx([0.2 * k for k in range(7)])


def test_a_recorder_that_is_forgotten_is_closed(ctrl: Controller, tmp_path: Path) -> None:
    """Also if the garbage is collected in the thread that writes."""
    for name, in_thread in (("one.rec", False), ("two.rec", True)):
        c = ctrl.copy()
        r = Recorder(c, file=tmp_path / name)
        fly(r, c, 5)
        writer, finalize = r._writer, r._finalize
        assert writer is not None
        if in_thread:
            add = writer._add

            def collect(add: Any = add, finalize: Any = finalize) -> None:
                finalize()
                add()

            writer._add = collect  # type: ignore[method-assign]
            writer._thread.join(10.0)
        del r
        writer._thread.join(10.0)
        assert not writer._thread.is_alive()
        assert len(open_recording(tmp_path / name, ctrl).u) == 5


def test_late_samples_are_counted(ctrl: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    c = ctrl.copy()
    c_step = c.step

    def step(x: Any, on_failure: Any = "status") -> Any:
        u = c_step(x, on_failure)
        c._feedback_ns = int(800e9)  # the interval is 720 s
        return u

    monkeypatch.setattr(c, "step", step)
    with Recorder(c) as r:
        r.step([1.0])
        assert (r.samples, r.missed) == (1, 1)
        assert "1 took too long, 0 began late" in repr(r)
        assert "1 of 1 samples took more than 12 min" in r.log().summary()


def test_a_sample_that_begins_late(ctrl: Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is counted, named in the summary, and marked in the pictures; the failing sample has the recorder's number."""
    now = [0]
    monkeypatch.setattr(recorder, "perf_counter_ns", lambda: now[0])
    c = ctrl.copy()
    with Recorder(c, keep=12) as r:
        for k in range(20):
            now[0] += int(720e9 * (3 if k == 15 else 1))
            r.step([np.nan if k == 17 else 1.0])
        assert (r.late, r.missed) == (1, 0)
        log = r.log()
    assert "longest 36 min before sample 15; began late: 1" in log.summary()
    assert "first NOT_FINITE: sample 17, t = 3.4 h" in log.summary()
    marks = {line.get_marker(): line for line in log.plot(tmp_path / "late.png").axes[0].lines}
    np.testing.assert_allclose(marks["x"].get_xdata(), [15 * 0.2])


def test_an_exception_of_the_loop_is_not_replaced(ctrl: Controller, tmp_path: Path) -> None:
    """What the recorder has to say is a note of it."""
    c = ctrl.copy()

    def refuse(data: bytes) -> None:
        raise OSError(28, os.strerror(28))

    def loop() -> None:
        with Recorder(c, file=tmp_path / "run.rec") as r:
            assert r._writer is not None
            r._writer._write = refuse  # type: ignore[method-assign]
            r.step([1.0])
            r._writer.flush()
            assert "No space left" in r.error
            assert "which cannot be written" in repr(r)
            raise KeyError("mine")

    with pytest.raises(KeyError) as raised:
        loop()
    assert "1 samples could not be written" in raised.value.__notes__[0]


def test_a_log_while_another_thread_steps(ctrl: Controller, tmp_path: Path) -> None:
    """It has no gap, whatever is written meanwhile."""
    c, stop = ctrl.copy(), threading.Event()

    def loop(r: Recorder) -> None:
        while not stop.is_set():
            r.step([1.0])

    with Recorder(c, file=tmp_path / "run.rec") as r:
        thread = threading.Thread(target=loop, args=(r,))
        thread.start()
        for _ in range(5):
            log = r.log()
            np.testing.assert_allclose(np.diff(log.t), 0.2)
        stop.set()
        thread.join()


def test_a_raised_failure_is_recorded(ctrl: Controller) -> None:
    c = ctrl.copy()
    with Recorder(c) as r:
        with pytest.raises(ControllerError, match="NOT_FINITE"):
            r.step([np.nan], on_failure="raise")
        log = r.log()
    assert log.status.tolist() == [Status.NOT_FINITE]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dt": -1.0}, "dt is -1.0; expected a positive number"),
        ({"plans": -1}, "plans is -1; expected an integer >= 0"),
        ({"keep": 0}, "keep is 0; expected an integer >= 1"),
        ({"file": "/nowhere/run.rec"}, "/nowhere/run.rec cannot be written: No such file"),
        ({"controller": 3}, "3 is no controller"),
        ({"file": 3}, "file is 3; expected the path of a new file"),
        ({"file": ""}, "file is ''; expected the path of a new file"),
        ({"keep": 5, "file": "run.rec"}, "keep=5 belongs to a recorder without a file"),
        ({"keep": 10**14}, "100000000000000 samples take .* bytes; expected fewer in keep="),
    ],
)
def test_mistakes(ctrl: Controller, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        Recorder(**{"controller": ctrl, **arguments})


def test_other_files(ctrl: Controller, tmp_path: Path) -> None:
    """An existing file is not replaced; a text, or a recording of another package, is refused."""
    (tmp_path / "run.rec").write_text("mine")
    with pytest.raises(ControllerError, match=r"run.rec exists; expected a new file"):
        Recorder(ctrl, file=tmp_path / "run.rec")
    assert (tmp_path / "run.rec").read_text() == "mine"
    with pytest.raises(ControllerError, match=r"run.rec is no recording: it begins with other words"):
        open_recording(tmp_path / "run.rec", ctrl)
    for text in (b"", stream.MAGIC, stream.MAGIC + stream.LENGTH.pack(9) + b"no zlib !"):
        (tmp_path / "bad.rec").write_bytes(text)
        with pytest.raises(ControllerError, match=r"bad.rec is no recording"):
            open_recording(tmp_path / "bad.rec", ctrl)
    with Recorder(ctrl.copy(), file=tmp_path / "good.rec") as r:
        r.step([1.0])
    whole = (tmp_path / "good.rec").read_bytes()
    for last, message in ((40, r"its description is cut off or damaged"), (len(whole) - 40, r"has no whole sample")):
        (tmp_path / "cut.rec").write_bytes(whole[:last])
        with pytest.raises(ControllerError, match=message):
            open_recording(tmp_path / "cut.rec", ctrl)
    with pytest.raises(ControllerError, match=r"good.rec is a recording; open_recording\(\) opens it"):
        Log.load(tmp_path / "good.rec")
    other = build(tank(), profile="test", name="other")
    with Recorder(other, file=tmp_path / "other.rec") as r:
        r.step([1.0])
    with pytest.raises(ControllerError, match="a recording of 'other', of another package than this tank"):
        open_recording(tmp_path / "other.rec", ctrl)
