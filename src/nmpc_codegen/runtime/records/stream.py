"""Recordings as files to which samples are added while they come.

    line "nmpc_codegen recording 1", length and text of a description (JSON, zlib)
    then parts: "PART", number of samples, bytes, CRC-32 (little endian, 32 bits each), and the samples (zlib)

A part is complete or it is not there: whatever ends the program, all parts before remain readable. What the samples
consist of follows from the package, see recorder.Layout.
"""

from __future__ import annotations

import json
import os
import struct
import threading
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError

MAGIC = b"nmpc_codegen recording 1\n"
PART = struct.Struct("<4sIII")
LENGTH = struct.Struct("<I")
WORD = b"PART"

#: Seconds from one part to the next.
PERIOD = 0.25


class Ring:
    """Memory for ``slots`` samples of ``size`` bytes; ``head``: number of samples so far, ``tail``: of those that are
    written."""

    def __init__(self, slots: int, size: int) -> None:
        self.slots, self.size, self.head, self.tail = slots, size, 0, 0
        self.buffer = bytearray(slots * size)

    def bytes_of(self, first: int, last: int) -> bytes:
        """Samples first .. last - 1, which are still there."""
        begin, end = first % self.slots, (last - 1) % self.slots + 1
        view = memoryview(self.buffer)
        if begin < end:
            return bytes(view[begin * self.size : end * self.size])
        return bytes(view[begin * self.size :]) + bytes(view[: end * self.size])


class Writer:
    """Writes what is in a ring to a file, four times a second in a thread of its own, and at close()."""

    def __init__(self, file: str | os.PathLike[str], ring: Ring, description: Mapping[str, Any]) -> None:
        self._ring, self._lock, self._stop = ring, threading.Lock(), threading.Event()
        self.error: OSError | None = None
        text = zlib.compress(json.dumps(description).encode())
        try:
            self._file = Path(file).open("xb", buffering=0)  # noqa: SIM115 - it stays open
            self._write(MAGIC + LENGTH.pack(len(text)) + text)
        except FileExistsError as error:
            raise ControllerError(f"{file} exists; expected a new file for the recording") from error
        except OSError as error:
            raise ControllerError(f"{file} cannot be written: {error.strerror or error}") from error
        self._thread = threading.Thread(target=self._run, name=f"recording {file}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(PERIOD):
            self.flush()

    def _write(self, data: bytes) -> None:
        """All of the data; a file may take a part of them at once."""
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]

    def flush(self) -> None:
        """Write the samples that are in the ring; after an error nothing more is written."""
        with self._lock:
            ring, last = self._ring, self._ring.head
            if last == ring.tail or self.error is not None or self._file.closed:
                return
            data = zlib.compress(ring.bytes_of(ring.tail, last), 1)
            try:
                self._write(PART.pack(WORD, last - ring.tail, len(data), zlib.crc32(data)) + data)
                ring.tail = last
            except OSError as error:
                self.error = error

    def close(self) -> None:
        """Write the rest."""
        self._stop.set()
        self._thread.join()
        self.flush()
        self._file.close()


def read(file: str | os.PathLike[str]) -> tuple[dict[str, Any], NDArray[np.uint8]]:
    """Description and samples, (n, size), of a recording; what a killed program has left of a part is passed over.

    Raises:
        ControllerError: the file is no recording.
    """
    data = memoryview(Path(file).read_bytes())
    start = len(MAGIC) + LENGTH.size
    try:
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError("it begins with other words")
        (length,) = LENGTH.unpack_from(data, len(MAGIC))
        description = json.loads(zlib.decompress(data[start : start + length]))
        size = int(description["size"])
    except (ValueError, KeyError, TypeError, struct.error, zlib.error) as error:
        raise ControllerError(f"{file} is no recording: {error}") from error
    found, place = [np.zeros((0, size), np.uint8)], start + length
    while place + PART.size <= len(data):
        word, count, length, check = PART.unpack_from(data, place)
        part = data[place + PART.size : place + PART.size + length]
        if word != WORD or len(part) != length or zlib.crc32(part) != check:
            break
        found.append(np.frombuffer(zlib.decompress(part), np.uint8).reshape(count, size))
        place += PART.size + length
    return description, np.concatenate(found)
