"""How far a campaign has come: a bar on a terminal and in a notebook, a line now and then in a log."""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from types import TracebackType
from typing import Any, TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

#: Seconds between the lines of a log.
PERIOD = 10.0


class Report:
    """Says how many flights are flown and lost; ``shown``: None, on a terminal, in a notebook, or in the log of a long
    campaign; False: never."""

    def __init__(self, name: str, flights: int, flown: int, shown: bool | None, stream: TextIO | None = None) -> None:
        self._name, self._flights, self._flown, self._before = name, flights, flown, flown
        self._lost, self._begin, self._said = 0, time.monotonic(), time.monotonic()
        self._stream = stream or sys.stderr
        self._shown = shown is not False
        console = Console(file=self._stream, stderr=stream is None)
        self._bar: Any = None
        if self._shown and (console.is_terminal or (console.is_jupyter and find_spec("ipywidgets") is not None)):
            columns = ("{task.description}", "{task.fields[rate]}", "{task.fields[lost]} lost")
            bar = Progress(
                *(TextColumn(columns[0]), BarColumn(), MofNCompleteColumn(), TextColumn(columns[1])),
                *(TextColumn(columns[2]), TimeRemainingColumn()),
                console=console,
                transient=True,
            )
            self._bar, self._task = bar, bar.add_task(name, total=flights, completed=flown, rate="", lost=0)

    def __enter__(self) -> Report:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def add(self, flown: int, lost: int) -> None:
        """So many flights more."""
        self._flown, self._lost = self._flown + flown, self._lost + lost
        now = time.monotonic()
        rate = (self._flown - self._before) / max(1e-9, now - self._begin)
        if self._bar is not None:
            self._bar.update(self._task, completed=self._flown, rate=f"{rate:,.0f}/s", lost=self._lost)
        elif self._shown and now - self._said >= PERIOD:
            self._said = now
            left = (self._flights - self._flown) / max(1e-9, rate)
            text = f"{self._flown:,} of {self._flights:,} flights, {rate:,.0f}/s, {self._lost} lost, {left:.0f} s left"
            print(f"{self._name}: {text}", file=self._stream, flush=True)
