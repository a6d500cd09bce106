"""The pipeline of a unit runs once for the same items: its result is kept beside the compiled controllers.

Half of the time to generate a package goes into the passes, and tests state the same packages again and again. What the
passes make of items follows from the items, what the package decides, and the code of the passes, which are the key.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import time
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from nmpc_codegen import lowering
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.unit.item import Item
from nmpc_codegen.lowering.unit.pipeline import run
from nmpc_codegen.runtime.cache import cache_directory

#: Seconds after which a result that nobody has read goes.
KEPT = 3 * 86400.0
#: What an item is made of.
FIELDS = tuple(Item.__dataclass_fields__)


@cache
def _passes() -> bytes:
    """The digest of the code of the passes."""
    files = sorted(Path(lowering.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).digest()


def key_of(items: Sequence[Item], known: Constants) -> str:
    """What the result follows from."""
    facts = [sorted(vars(known)[name].items()) for name in ("sizes", "ranges", "types")]
    facts += [sorted(vars(known)[name]) for name in ("absent", "kernels", "calling", "pure")]
    texts = [tuple(getattr(item, name) for name in FIELDS) for item in items]
    return hashlib.sha256(_passes() + repr((facts, texts)).encode()).hexdigest()[:32]


def kept_run(items: Sequence[Item], known: Constants) -> tuple[Item, ...]:
    """run(), or what it gave before."""
    file = _folder() / f"{key_of(items, known)}.unit"
    if file.is_file():
        os.utime(file)
        return tuple(Item(*fields) for fields in pickle.loads(zlib.decompress(file.read_bytes())))
    unit = run(items, known)
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = file.with_suffix(f".{os.getpid()}")
    part.write_bytes(zlib.compress(pickle.dumps([tuple(getattr(item, name) for name in FIELDS) for item in unit]), 1))
    part.replace(file)
    return unit


def sweep() -> None:
    """Remove what nobody has read for days."""
    for file in _folder().glob("*"):
        if file.stat().st_mtime < time.time() - KEPT:
            file.unlink(missing_ok=True)


def _folder() -> Path:
    return cache_directory() / "units"
