"""Results are written during the campaign to a folder of Parquet files, each with the flights of one part.

    campaign.json    the data that determine the flights
    flights-<first>-<last>.parquet

A file is either complete or absent, so that a killed campaign can continue.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.extras import extra
from nmpc_codegen.runtime.loops.flown import Flown, Labels, heads, layout
from nmpc_codegen.runtime.records import frames

FORMAT = 2
HEAD = "campaign.json"


class Archive:
    """An archive is the folder of a campaign; only one process at a time can open it."""

    def __init__(self, folder: str | os.PathLike[str], labels: Labels, identity: Mapping[str, Any]) -> None:
        self.folder, self._labels = Path(folder), labels
        self._identity = {"format": FORMAT, **identity}
        self._parquet = extra("pyarrow.parquet", "campaign(folder=)")
        self._arrow = extra("pyarrow", "campaign(folder=)")
        self._lock: FileLock | None = None

    def __enter__(self) -> Archive:
        """Create the folder, or check that it holds this campaign.

        Raises:
            ControllerError: another campaign is there, or another process writes to it.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = FileLock(self.folder / ".lock")
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise ControllerError(f"folder: another process flies the campaign in {self.folder}") from None
        try:
            self._check()
        except BaseException:
            self._lock.release()
            raise
        return self

    def _check(self) -> None:
        head = self.folder / HEAD
        if head.exists():
            try:
                known = json.loads(head.read_text(encoding="utf-8"))
            except ValueError:
                raise ControllerError(f"folder: {head} is no JSON; expected what campaign() wrote") from None
            found = known if isinstance(known, dict) else {}
            other = [name for name, value in self._identity.items() if found.get(name) != value]
            if other:
                raise ControllerError(
                    f"folder: {self.folder} holds another campaign, which differs in {', '.join(other)}; "
                    "expected a new folder, or the same arguments"
                )
        else:
            self._write(head, json.dumps(self._identity, indent=1).encode())
        for rest in self.folder.glob(".*.part"):  # left by a process that was killed while writing
            rest.unlink()

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            self._lock.release()

    def add(self, part: Flown) -> None:
        """Write a part, whose flights have consecutive numbers."""
        sink = self._arrow.BufferOutputStream()
        frames.to_parquet(part.table, sink, "campaign(folder=)")
        name = f"flights-{part.number[0]:010d}-{part.number[-1]:010d}.parquet"
        self._write(self.folder / name, sink.getvalue().to_pybytes())

    def _write(self, path: Path, data: bytes) -> None:
        """Write a file so that it appears complete or not at all."""
        part = path.with_name(f".{path.name}.part")
        with open(part, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)

    def read(self, into: Flown, done: NDArray[np.bool_]) -> None:
        """Read all flights whose numbers occur in ``into``, and mark them as ``done``."""
        for path in sorted(self.folder.glob("flights-*.parquet")):
            try:
                part = self._part(path)
            except (OSError, KeyError, self._arrow.ArrowException) as error:
                raise ControllerError(f"folder: {path} is not what campaign() wrote: {error}") from None
            part = part.of_some(part.number < len(done))
            into.put(part, part.number)
            done[part.number] = True

    def _part(self, path: Path) -> Flown:
        table = self._parquet.read_table(path)
        named, found = heads(self._labels), list[NDArray[Any]]()
        for name, (kind, shape) in layout(self._labels).items():
            if name in named:
                every = [np.asarray(table[head]) for head in named[name]]
                found.append(np.array(every, kind).reshape(*shape, len(table)).T)
            else:
                found.append(np.asarray(table[name], kind))
        return Flown(self._labels, *found)
