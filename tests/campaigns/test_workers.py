"""Campaigns that are interrupted, killed, resumed, and shared by workers that die: nothing is lost or counted twice."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import ControllerError
from nmpc_codegen.campaigns import Campaign, campaign
from nmpc_codegen.campaigns.flying import work
from nmpc_codegen.runtime.loops.progress import PERIOD, Progress
from tests.campaigns.problems import cart
from tests.campaigns.test_campaigns import equal

ROOT = Path(__file__).parents[2]
WORDS: dict[str, Any] = {"noise": 0.01, "steps": 400}
FLIGHTS = 2000


@pytest.fixture(scope="module")
def whole() -> Campaign:
    return campaign(cart(), FLIGHTS, **WORDS)


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "FIRST", 20)
    monkeypatch.setattr(work, "MOST", 20)


def rows_of(folder: Path) -> int:
    parts = (path.stem.split("-")[1:] for path in folder.glob("flights-*.parquet"))
    return sum(int(last) - int(first) + 1 for first, last in parts)


def start(folder: Path, *more: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tests.campaigns.flying", str(folder), str(FLIGHTS), *more]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, start_new_session=True)


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[bytes] | None = None) -> bool:
    for _ in range(4000):
        if condition() or (process is not None and process.poll() is not None):
            return condition()
        time.sleep(0.01)
    raise AssertionError("it takes too long")


def test_a_campaign_that_is_killed_goes_on(whole: Campaign, tmp_path: Path) -> None:
    """Five times, after a random number of flights; a part that was half written is none."""
    folder, killed = tmp_path / "there", 0
    for more in np.random.default_rng(1).integers(20, 350, 5):
        before = rows_of(folder)
        process = start(folder)
        wait_for(lambda before=before, more=more: rows_of(folder) >= before + more, process)  # type: ignore[misc]
        killed += process.poll() is None
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        (folder / ".flights-0000000000-0000000019.parquet.part").write_bytes(b"PAR1")
    assert killed == 5
    assert 0 < rows_of(folder) < FLIGHTS
    result = campaign(cart(), FLIGHTS, folder=folder, **WORDS)
    equal(whole, result)
    assert rows_of(folder) == FLIGHTS
    assert not list(folder.glob(".*.part"))
    again = campaign(cart(), FLIGHTS, folder=folder, **WORDS)
    np.testing.assert_array_equal(again.flown.seconds, result.flown.seconds)  # nothing was flown


def test_what_is_kept_is_read_by_others(whole: Campaign, tmp_path: Path) -> None:
    """Columns with names; more flights begin with those that are there, fewer are some of them."""
    pandas = pytest.importorskip("pandas")
    campaign(cart(), 300, folder=tmp_path, **WORDS)
    more = campaign(cart(), FLIGHTS, folder=tmp_path, **WORDS)
    equal(whole, more)
    frame = pandas.concat(map(pandas.read_parquet, tmp_path.glob("*.parquet"))).sort_values("number")
    assert frame["number"].tolist() == list(range(FLIGHTS))
    np.testing.assert_array_equal(frame["last.p"], whole.flown.final("p"))
    np.testing.assert_array_equal(frame["plant.m"], whole.flown.drawn[:, 0])
    assert {"start.v", "samples.OK", "violation.wall", "cost", "seconds.longest"} <= set(frame.columns)
    few = campaign(cart(), 100, folder=tmp_path, **WORDS)
    np.testing.assert_array_equal(few.flown.last, whole.flown.last[:100])


def test_equal_campaigns_are_equal(tmp_path: Path) -> None:
    """However their numbers are written; and a constant start is that of any number of flights."""
    words: dict[str, Any] = {"starts": {"v": 0.1}, "steps": 5, "folder": tmp_path}
    for flights, noise in ((10, 0.01), (10, np.float64(0.01)), (20, [0.01, 0.01])):
        assert len(campaign(cart(), flights, noise=noise, **words)) == flights


@pytest.mark.parametrize(
    ("words", "differs"),
    [
        ({"seed": 1}, "seed"),
        ({"steps": 30}, "steps"),
        ({"noise": 0.02}, "noise"),
        ({"parameters": {}}, "data"),
        ({"starts": {}}, "starts"),
        ({"disturbance": 0.1}, "disturbance"),
    ],
)
def test_a_folder_of_another_campaign(tmp_path: Path, words: dict[str, Any], differs: str) -> None:
    campaign(cart(), 10, folder=tmp_path, noise=0.01, steps=20)
    with pytest.raises(ControllerError, match=f"another campaign, which differs in .*{differs}"):
        campaign(cart(), 10, folder=tmp_path, **{"noise": 0.01, "steps": 20, **words})


def test_folders_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "campaign.json").write_text("[")
    with pytest.raises(ControllerError, match="is no JSON"):
        campaign(cart(), 10, folder=tmp_path)
    (tmp_path / "campaign.json").unlink()
    campaign(cart(), 10, folder=tmp_path)
    part = next(tmp_path.glob("flights-*.parquet"))
    part.write_bytes(b"PAR1")
    with pytest.raises(ControllerError, match="is not what campaign"):
        campaign(cart(), 10, folder=tmp_path)
    assert json.loads((tmp_path / "campaign.json").read_text())["controller"] == "cart"


def test_one_process_at_a_time(tmp_path: Path) -> None:
    process = start(tmp_path)
    assert wait_for(lambda: rows_of(tmp_path) > 0, process)
    with pytest.raises(ControllerError, match="another process"):
        campaign(cart(), FLIGHTS, folder=tmp_path, **WORDS)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@pytest.mark.usefixtures("small_parts")
def test_threads_and_processes(whole: Campaign) -> None:
    with ThreadPoolExecutor(3) as threads:
        equal(whole, campaign(cart(), FLIGHTS, executor=threads, **WORDS))
    with ProcessPoolExecutor(2) as processes:
        equal(whole, campaign(cart(), FLIGHTS, executor=processes, **WORDS))


@pytest.mark.usefixtures("small_parts")
def test_workers_that_are_killed(whole: Campaign, tmp_path: Path) -> None:
    """A pool of processes, of which one is killed now and then: it is replaced, and all are flown."""
    killed, stop = [], threading.Event()

    def kill() -> None:
        for goal in (100, 400, 700):
            while rows_of(tmp_path) < goal and not stop.is_set():
                time.sleep(0.002)
            for child in children() if not stop.is_set() else []:
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
                    killed.append(child)
                    break

    killer = threading.Thread(target=kill)
    with ProcessPoolExecutor(2) as pool:
        killer.start()
        result = campaign(cart(), FLIGHTS, executor=pool, folder=tmp_path, **WORDS)
        stop.set()
        killer.join()
    assert len(killed) >= 2
    equal(whole, result)
    assert rows_of(tmp_path) == FLIGHTS


def children() -> Iterator[int]:
    """Processes that this one has forked, and that have not ended."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                words = (entry / "stat").read_text().rpartition(")")[2].split()
                if int(words[1]) == os.getpid() and words[0] != "Z":
                    yield int(entry.name)


class _Broken:
    """An executor whose workers always die."""

    def submit(self, function: Any, *arguments: Any) -> Any:
        from concurrent.futures import Future

        future: Future[Any] = Future()
        future.set_exception(OSError("gone"))
        return future


def test_workers_that_always_die() -> None:
    with pytest.raises(ControllerError, match="lose their workers again and again: OSError: gone"):
        campaign(cart(), 100, executor=_Broken())


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize("where", ["here", "threads"])
def test_an_interrupt_keeps_what_was_flown(whole: Campaign, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a person presses Ctrl-C once some flights are there."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    begun, add = threading.Event(), Progress.add
    monkeypatch.setattr(Progress, "add", lambda self, *counts: (begun.set(), add(self, *counts)))

    def press() -> None:
        if begun.wait(30):
            time.sleep(0.05)
            os.kill(os.getpid(), signal.SIGINT)

    finger = threading.Thread(target=press)
    pool = ThreadPoolExecutor(1) if where == "threads" else None
    try:
        finger.start()
        result = campaign(cart(), 10 * FLIGHTS, executor=pool, **WORDS)
    finally:
        finger.join()
        signal.signal(signal.SIGINT, before)
        if pool is not None:
            pool.shutdown()
    assert not result.complete
    assert 0 < len(result) < 10 * FLIGHTS
    some = result.flown.number[result.flown.number < FLIGHTS]
    np.testing.assert_array_equal(result.flown.last[: len(some)], whole.flown.last[some])
    assert "interrupted: 20,000 flights were asked for" in str(result)


def test_progress_in_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line now and then: flights, rate, lost ones, time left."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    stream = io.StringIO()
    with Progress("cart", 1000, "flights", 100, None, stream) as progress:
        progress.add(100, "3 lost")
        now[0] = 2 * PERIOD
        progress.add(100, "4 lost")
    assert stream.getvalue() == "cart: 300 of 1,000 flights, 10/s, 4 lost, 70 s left\n"
    with Progress("cart", 1000, "flights", 0, False, stream) as silent:
        now[0] *= 3
        silent.add(10)
    assert stream.getvalue().count("\n") == 1


@pytest.mark.slow
@pytest.mark.usefixtures("small_parts")
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_whose_worker_is_killed(whole: Campaign, tmp_path: Path) -> None:
    """Dask's LocalCluster with two workers; one is killed in the middle."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        workers = list(cluster.workers.values())

        def kill() -> None:
            while rows_of(tmp_path) < 300:
                time.sleep(0.01)
            os.kill(workers[0].pid, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        result = campaign(cart(), FLIGHTS, executor=client, folder=tmp_path, **WORDS)
        killer.join()
    equal(whole, result)
    assert rows_of(tmp_path) == FLIGHTS
