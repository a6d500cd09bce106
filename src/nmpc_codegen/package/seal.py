"""The seal is a comment in every generated file that shows whether the file has been edited.

It contains a digest of the file, and a digest of the package's C, which all files of one export share:

    nmpc_codegen package <16 hex digits>, sha256 <64 hex digits>

The digest of the file is computed with zeros in its place. Sealing needs no key: the seal protects against mistakes,
not against malice.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import PurePosixPath

LARGEST = 1 << 26  # bytes; a larger file cannot be a generated one, and is not read
_LINE = "nmpc_codegen package {}, sha256 {}"
_SEAL = re.compile(rb"nmpc_codegen package ([0-9a-f]{16}), sha256 ([0-9a-f]{64})")
_BLANK = "0" * 64
_COMMENTS = {
    **dict.fromkeys((".c", ".h", ".ld", ".ino"), "/* {} */"),
    **dict.fromkeys((".txt", ".yml", ".properties", ".cmake", ""), "# {}"),
    ".md": "<!-- {} -->",
}


def seal(sources: Mapping[str, str], name: str) -> dict[str, str]:
    """Return the files of the package ``name`` with seals: the last line, or the first entry of a JSON object."""
    code = "\0".join(sources[f"{name}.{ext}"] for ext in ("h", "c"))
    package = hashlib.sha256(code.encode()).hexdigest()[:16]
    return {path: _seal(path, text, package) for path, text in sources.items()}


def seal_beside(files: Mapping[str, str], package_files: Mapping[str, str]) -> dict[str, str]:
    """Return further files of a package with seals; ``package_files`` are already sealed."""
    package = next(filter(None, map(package_of, package_files.values())))
    return {path: _seal(path, text, package) for path, text in files.items()}


def _seal(path: str, text: str, package: str) -> str:
    blank = _LINE.format(package, _BLANK)
    suffix = PurePosixPath(path).suffix
    if suffix == ".json":
        marked = text.replace("{\n", f'{{\n "seal": "{blank}",\n', 1)
    else:
        marked = f"{text}{_COMMENTS[suffix].format(blank)}\n"
    return marked.replace(blank, _LINE.format(package, hashlib.sha256(marked.encode()).hexdigest()))


def without_seal(text: str) -> str:
    """Return a text without its last line, which is the seal."""
    return text[: text.rindex("\n", 0, -1) + 1]


def has_seal(data: bytes) -> bool:
    """Return True if the bytes contain a seal, intact or not."""
    return _SEAL.search(data) is not None


def intact(data: bytes) -> bool:
    """Return True if the bytes are an unchanged generated file, of any package and version."""
    found = list(_SEAL.finditer(data))
    if len(found) != 1:
        return False
    begin, end = found[0].span(2)
    blank = data[:begin] + _BLANK.encode() + data[end:]
    return hashlib.sha256(blank).hexdigest().encode() == data[begin:end]


def package_of(text: str) -> str | None:
    """Return the digest of the package's C in the seal of a file.

    None without a seal. Edits of the file preserve it.
    """
    found = _SEAL.search(text.encode(errors="replace"))
    return found.group(1).decode() if found else None
