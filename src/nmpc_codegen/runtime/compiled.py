"""A compiled C package: its functions, and its solver struct as a NumPy type."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.package_description import Description, parse
from nmpc_codegen.runtime.status import Status


@dataclass(frozen=True, eq=False)
class Library:
    """A compiled package: its texts, its cffi module, and how to make it again (for pickle)."""

    name: str
    files: Mapping[str, str]
    profile: Any  # nmpc_codegen.runtime.build.Profile
    ffi: Any
    lib: Any
    reload: Callable[[Mapping[str, str], str, Any], Any]

    @cached_property
    def description(self) -> Description:
        """Contents of <name>.json."""
        return parse(self.files[f"{self.name}.json"])

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """NumPy type of the solver struct, checked against the compiled one."""
        if self.description.statuses[: len(Status)] != tuple(Status.__members__):
            raise ControllerError(f"{self.name}: its status values are not those of this version: export it again")
        for struct in self.description.structs:
            self._check(struct, self.description.dtype(struct))
        return self.description.dtype()

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the C texts: two controllers with the same one can exchange their state."""
        texts = (self.files[f"{self.name}.{ext}"] for ext in ("h", "c"))
        return hashlib.sha256("\0".join(texts).encode()).hexdigest()

    def function(self, name: str) -> Any:
        """The C function <prefix>_<name>."""
        try:
            return getattr(self.lib, f"{self.name}_{name}")
        except AttributeError:
            raise ControllerError(f"{self.name} was exported without {name}()") from None

    def _check(self, struct: str, expected: np.dtype[Any]) -> None:
        """Compare size and offset of every member with the compiled struct."""
        ctype = self.ffi.typeof(f"{self.name}_{struct}_t")
        fields = dict(ctype.fields)
        layout: Mapping[str, Any] = expected.fields or {}
        where = f"{self.name}: struct {struct}"
        if set(fields) != set(layout):
            differing = ", ".join(sorted(set(fields) ^ set(layout)))
            raise ControllerError(f"{where} and its description differ in the members {differing}")
        for member, entry in layout.items():
            ours = (entry[1], entry[0].itemsize)
            theirs = (self.ffi.offsetof(ctype, member), self.ffi.sizeof(fields[member].type))
            if ours != theirs:
                raise ControllerError(
                    f"{where}: {member} has (offset, bytes) {ours} in the description, {theirs} in the compiled code"
                )
        if self.ffi.sizeof(ctype) != expected.itemsize:
            raise ControllerError(
                f"{where} has {expected.itemsize} bytes in the description, {self.ffi.sizeof(ctype)} in compiled code"
            )
