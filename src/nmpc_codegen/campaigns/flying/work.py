"""A campaign is flown in parts, by this process or by the workers of an executor; lost parts are flown again."""

from __future__ import annotations

import os
import pickle
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.campaigns.flying.fly import Flyer, Job, fly_elsewhere
from nmpc_codegen.errors import ControllerError, NmpcError
from nmpc_codegen.runtime.loops.flown import Flown

#: Number of flights of the first part; largest number of flights of a part; intended time (s) of a part.
FIRST, MOST, SECONDS = 32, 8192, 1.0
#: The campaign stops if, without any result in between, each waiting part has been lost this many times on average.
ATTEMPTS = 3
#: Number of submitted parts for each worker.
AHEAD = 3
#: Seconds after which a waiting process checks for an interrupt.
LOOK = 0.2


@dataclass(frozen=True)
class FlightPart:
    """A part has the flights first .. first + count - 1."""

    first: int
    count: int
    attempt: int = 0


def fly_all(job: Job, done: NDArray[np.bool_], executor: Any) -> Iterator[Flown]:
    """Yield the results of the flights that are not done, in parts, in the order in which they finish.

    Raises:
        ControllerError: data are refused, or workers are lost again and again.
    """
    if executor is None:
        yield from _fly_here(job, _Parts(done))
    else:
        yield from _Elsewhere(job, _Parts(done), executor).fly()


class _Parts:
    """Divides the flights that are not done into parts that take about a second."""

    def __init__(self, done: NDArray[np.bool_]) -> None:
        edges = np.flatnonzero(np.diff(np.concatenate([[True], done, [True]]).astype(np.int8)))
        self._gaps = deque((int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True))
        self._size = FIRST

    def take(self) -> FlightPart | None:
        """Return the next part; None if there is no more."""
        if not self._gaps:
            return None
        begin, end = self._gaps.popleft()
        count = min(self._size, end - begin)
        if begin + count < end:
            self._gaps.appendleft((begin + count, end))
        return FlightPart(begin, count)

    def learn(self, flights: int, seconds: float) -> None:
        """Adapt the size of the next parts to the time that a part has taken."""
        wanted = flights * SECONDS / max(seconds, 1e-6)
        self._size = int(max(1, min(MOST, wanted, 4 * self._size)))


def _fly_here(job: Job, parts: _Parts) -> Iterator[Flown]:
    """Fly the parts on all cores of this process."""
    flyer = Flyer(job, None)
    while (part := parts.take()) is not None:
        begin = time.monotonic()
        own = job.statement.given_for(part.first, part.count)
        flown = flyer.fly(part.first, part.count, own)
        parts.learn(part.count, time.monotonic() - begin)
        yield flown


class _Elsewhere:
    """The workers of an executor fly the parts, each with one thread at a time."""

    def __init__(self, job: Job, parts: _Parts, executor: Any) -> None:
        if not callable(getattr(executor, "submit", None)):
            raise ControllerError(
                f"executor is {executor!r:.60}; expected an object with submit(), as those of concurrent.futures or "
                "Dask's Client"
            )
        self._job, self._parts, self._executor = job, parts, executor
        self._blob = pickle.dumps(replace(job, statement=job.statement.common))
        self._ready: SimpleQueue[Any] = SimpleQueue()
        self._pending: dict[Any, FlightPart] = {}
        self._again: deque[FlightPart] = deque()
        self._own: ProcessPoolExecutor | None = None
        self._fruitless = 0  # number of losses since the last result

    def fly(self) -> Iterator[Flown]:
        """Yield the results of the parts in the order in which they finish."""
        most = AHEAD * _count_workers(self._executor)
        try:
            while True:
                while len(self._pending) < most and (part := self._next()) is not None:
                    self._submit(part)
                if not self._pending:
                    return
                yield from self._collect()
        finally:
            for future in list(self._pending):
                future.cancel()
            if self._own is not None:
                self._own.shutdown(wait=False, cancel_futures=True)

    def _next(self) -> FlightPart | None:
        return self._again.popleft() if self._again else self._parts.take()

    def _submit(self, part: FlightPart) -> None:
        own = self._job.statement.given_for(part.first, part.count)
        arguments = (fly_elsewhere, self._blob, part.first, part.count, own, part.attempt)
        try:
            future = self._executor.submit(*arguments)
        except BrokenExecutor as error:
            self._replace_pool(error)
            future = self._executor.submit(*arguments)
        except RuntimeError as error:  # the executor is shut down
            raise ControllerError(f"executor: {error}") from error
        self._pending[future] = part
        future.add_done_callback(self._ready.put)

    def _collect(self) -> Iterable[Flown]:
        """Collect the flights of finished parts; return none after ``LOOK`` seconds."""
        try:
            future = self._ready.get(timeout=LOOK)
        except Empty:
            return
        part = self._pending.pop(future, None)
        if part is None:
            return
        try:
            flown = future.result()
        except NmpcError:
            raise
        except Exception as error:
            self._lose(part, error)
            return
        self._fruitless = 0
        spent = float(np.sum(flown.seconds[:, 0])) * self._job.statement.steps
        self._parts.learn(part.count, spent if np.isfinite(spent) else SECONDS)
        yield flown

    def _lose(self, part: FlightPart, error: Exception) -> None:
        """Queue a part again whose worker is lost."""
        self._again.append(replace(part, attempt=part.attempt + 1))
        self._fruitless += 1
        if self._fruitless >= ATTEMPTS * (len(self._pending) + len(self._again)):
            last = part.first + part.count - 1
            raise ControllerError(
                f"flights {part.first} to {last} lose their workers again and again: {type(error).__name__}: {error}"
            ) from error

    def _replace_pool(self, error: BrokenExecutor) -> None:
        """Replace a pool of processes, one of which has died, by a new pool of the same size."""
        if not isinstance(error, BrokenProcessPool):
            raise ControllerError(f"executor: {error}") from error
        if self._own is not None:
            self._own.shutdown(wait=False, cancel_futures=True)
        known: Callable[[str], Any] = lambda name: getattr(self._executor, name, None)  # noqa: E731
        self._own = ProcessPoolExecutor(known("_max_workers"), known("_mp_context"))
        self._executor = self._own


def _count_workers(executor: Any) -> int:
    """Return the number of workers of an executor, as far as it tells."""
    threads = getattr(executor, "nthreads", None)  # Dask returns {worker: threads}
    if callable(threads):
        return max(1, int(sum(threads().values())))
    return int(getattr(executor, "_max_workers", None) or os.cpu_count() or 1)
