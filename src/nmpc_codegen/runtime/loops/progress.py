"""The progress of a long run is shown by a bar on a terminal and in a notebook, else by lines now and then."""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from types import TracebackType
from typing import Any, TextIO

#: Seconds between lines, where no bar can be shown.
PERIOD = 10.0

#: Number of samples or flights from which a bar is shown.
LONG_RUN = 200


class Progress:
    """A display shows how many of ``total`` samples or flights are done; ``done`` were finished before this run.

    With ``shown=None`` it is a bar, if there are many and the stream is a terminal or a notebook with ipywidgets;
    otherwise it is a line every ten seconds. With ``shown=False`` nothing is shown.
    """

    def __init__(
        self, name: str, total: int, what: str, done: int = 0, shown: bool | None = None, stream: TextIO | None = None
    ) -> None:
        self._name, self._total, self._what, self._done, self._before = name, total, what, done, done
        self._begin = self._said = time.monotonic()
        self._stream = stream or sys.stderr
        self._shown = shown is not False
        self._bar: Any = None
        if self._shown and total >= LONG_RUN and find_spec("rich") is not None:
            self._open_bar(stream is None)

    def _open_bar(self, to_errors: bool) -> None:
        """Open a bar if the stream is a terminal or a notebook that can show one."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        console = Console(file=self._stream, stderr=to_errors)
        if console.is_terminal or (console.is_jupyter and find_spec("ipywidgets") is not None):
            columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
            texts = TextColumn("{task.fields[rate]}"), TextColumn("{task.fields[more]}")
            self._bar = Bar(*columns, *texts, TimeRemainingColumn(), console=console, transient=True)
            self._task = self._bar.add_task(self._name, total=self._total, completed=self._done, rate="", more="")

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def add(self, count: int = 1, more: str = "") -> None:
        """Add ``count`` finished samples or flights; ``more`` is text shown beside them."""
        self._done += count
        now = time.monotonic()
        if now - self._said < (PERIOD if self._bar is None else 0.1) or not self._shown:
            return
        self._said = now
        rate = (self._done - self._before) / max(1e-9, now - self._begin)
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, rate=f"{rate:,.0f}/s", more=more)
        else:
            words = [f"{self._done:,} of {self._total:,} {self._what}", f"{rate:,.0f}/s", *([more] if more else [])]
            left = f"{(self._total - self._done) / max(1e-9, rate):.0f} s left"
            print(f"{self._name}: {', '.join([*words, left])}", file=self._stream, flush=True)
