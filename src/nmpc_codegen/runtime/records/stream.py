"""A recording is a file to which samples are added while the loop runs.

    line "nmpc_codegen recording 1", length and text of a description (JSON, zlib)
    then parts: "PART", number of samples, bytes, CRC-32 (little endian, 32 bits each), and the samples (zlib)
    at the end, if the recorder was closed: "DONE"

A part is complete or missing: if the program is killed, all earlier parts remain readable. The package determines the
layout of a sample, see recorder.Layout.
"""

from __future__ import annotations

import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError

MAGIC = b"nmpc_codegen recording 1\n"
PART = struct.Struct("<4sIII")
LENGTH = struct.Struct("<I")
WORD, END = b"PART", b"DONE"

#: Seconds from one part to the next.
PERIOD = 0.25


class Ring:
    """The ring is memory for ``slots`` samples of ``size`` bytes.

    ``head`` is the number of samples so far, ``tail`` the number of those that are written.
    """

    def __init__(self, slots: int, size: int) -> None:
        self.slots, self.size, self.head, self.tail = slots, size, 0, 0
        self.buffer = bytearray(slots * size)

    def bytes_of(self, first: int, last: int) -> bytes:
        """Return the bytes of samples first .. last - 1, which must still be in the ring."""
        begin, end = first % self.slots, (last - 1) % self.slots + 1
        view = memoryview(self.buffer)
        if begin < end:
            return bytes(view[begin * self.size : end * self.size])
        return bytes(view[begin * self.size :]) + bytes(view[: end * self.size])


class Writer:
    """A thread that writes the samples in a ring to a file: four times a second, on demand, and at the end.

    ``error`` is that of the last attempt; its samples stay in the ring, and the next attempt writes to the same place.
    """

    def __init__(self, file: str | os.PathLike[str], ring: Ring, description: Mapping[str, Any]) -> None:
        self._ring, self._process = ring, os.getpid()
        self._wanted, self._stop, self._tried = threading.Event(), threading.Event(), threading.Condition()
        self._attempts = 0
        self.error: Exception | None = None
        text = zlib.compress(json.dumps(description).encode())
        try:
            self._file = Path(file).open("xb", buffering=0)  # noqa: SIM115 - it stays open
            self._write(MAGIC + LENGTH.pack(len(text)) + text)
        except FileExistsError as error:
            raise ControllerError(f"{file} exists; expected a new file for the recording") from error
        except OSError as error:
            raise ControllerError(f"{file} cannot be written: {error.strerror or error}") from error
        self._end = self._file.tell()
        self._thread = threading.Thread(target=self._run, name=f"recording {file}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        stops = False
        while not stops:
            self._wanted.wait(PERIOD)
            self._wanted.clear()
            stops = self._stop.is_set()
            try:
                self._add()
                self.error = None
            except Exception as error:
                self.error = error
            with self._tried:
                self._attempts += 1
                self._tried.notify_all()
        if self.error is None:
            self._file.write(END)
        self._file.close()

    def _add(self) -> None:
        """Write the samples that are in the ring as a part, after the last complete part."""
        ring, last = self._ring, self._ring.head
        if last == ring.tail:
            return
        data = zlib.compress(ring.bytes_of(ring.tail, last), 1)
        if self._file.tell() != self._end:  # an attempt has failed
            self._file.seek(self._end)
            self._file.truncate()
        self._write(PART.pack(WORD, last - ring.tail, len(data), zlib.crc32(data)) + data)
        self._end, ring.tail = self._file.tell(), last

    def _write(self, data: bytes) -> None:
        """Write all data; a file may accept only a part of them in one call."""
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]

    @property
    def is_ours(self) -> bool:
        """Return False in a forked process: the file belongs to its parent, and its locks may be held for ever."""
        return os.getpid() == self._process

    def flush(self) -> None:
        """Wait for an attempt to write all samples that are in the ring."""
        if not self.is_ours:
            return
        with self._tried:
            until = self._attempts + 2  # the present attempt may have begun before this call
            while self._thread.is_alive() and self._attempts < until and self._ring.tail < self._ring.head:
                self._wanted.set()
                self._tried.wait(PERIOD)

    def close(self) -> None:
        """Write the remaining samples and close the file; after an interrupt it can be called again."""
        if not self.is_ours:
            return
        self._stop.set()
        self._wanted.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()


def is_recording(file: str | os.PathLike[str]) -> bool:
    """Return True if the file begins as a recording."""
    with Path(file).open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def read(file: str | os.PathLike[str]) -> tuple[dict[str, Any], NDArray[np.uint8], tuple[str, ...]]:
    """Return the description and samples (n, size) of a recording, and remarks on the file.

    Incomplete and damaged parts are skipped.

    Raises:
        ControllerError: the file is no recording, or it contains no complete sample.
    """
    data = Path(file).read_bytes()
    try:
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError("it begins with other words")
        (length,) = LENGTH.unpack_from(data, len(MAGIC))
        start = len(MAGIC) + LENGTH.size
        description = json.loads(zlib.decompress(data[start : start + length]))
        size = int(description["size"])
        if size < 1 or float(description["dt"]) <= 0.0:
            raise ValueError(f"its samples have {size} bytes and come every {description['dt']}")
        parts = list(_parts(data, start + length))
        found = np.empty((sum(count for _, count, _ in parts), size), np.uint8)
        place = 0
        for _, count, part in parts:
            samples = zlib.decompressobj().decompress(part, count * size + 1)
            found[place : place + count] = np.frombuffer(samples, np.uint8).reshape(count, size)
            place += count
    except (ValueError, KeyError, TypeError, struct.error, zlib.error) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        what = "its description is cut off or damaged" if isinstance(error, (zlib.error, struct.error)) else what
        raise ControllerError(f"{file} is no recording: {what}") from error
    if not parts and data[start + length :] not in (b"", END):
        raise ControllerError(f"{file} has no whole sample: it is cut off, or damaged, after {len(data)} bytes")
    return description, found, tuple(_remarks(data, start + length, parts))


def _parts(data: bytes, place: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield place, number of samples and compressed bytes of every part; a damaged part is skipped."""
    while (place := data.find(WORD, place)) >= 0 and place + PART.size <= len(data):
        _, count, length, check = PART.unpack_from(data, place)
        part = data[place + PART.size : place + PART.size + length]
        if len(part) == length and zlib.crc32(part) == check:
            yield place, count, part
            place += PART.size + length
        else:
            place += 1


def _remarks(data: bytes, place: int, parts: Sequence[tuple[int, int, bytes]]) -> Iterator[str]:
    """Yield remarks: bytes between parts that are damaged, and a recording that was not closed."""
    for begin, _, part in parts:
        if begin != place:
            yield f"{begin - place} bytes of the recording are damaged"
        place = begin + PART.size + len(part)
    if data[place:] != END:
        yield "the recording was not closed: the program was killed, or the disk was full"
