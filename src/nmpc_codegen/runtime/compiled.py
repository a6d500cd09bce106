"""A compiled C package has functions, and a solver struct that is described as a NumPy type.

The description is compared with the compiled code before it determines the layout of any memory.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.package.description import INTERFACE_SIZES, PackageDescription
from nmpc_codegen.package.program import EDGES
from nmpc_codegen.runtime.records.log_file import BROKEN, write_arrays

ALIGNMENT = 64  # bytes: a cache line, and the widest vector register
COUNTERS = (
    *("qp_iterations", "active_set_changes", "dropped_rows", "relaxed_rows", "sqp_iterations"),
    *("violated_row", "violated_node"),
)
#: Counters of an algorithm without a QP. A package that has the first one has all of them, and no counters of a QP.
NEWTON = ("newton_iterations", "accepted", "cg_iterations", "faces", "shifts", "negative_curvature", "simulations")


@dataclass(frozen=True, eq=False)
class CompiledPackage:
    """A compiled package has its texts, their description, its cffi module, and a function that loads it for pickle."""

    name: str
    files: Mapping[str, str]
    description: PackageDescription
    profile: Any  # nmpc_codegen.runtime.build.Profile
    ffi: Any
    lib: Any
    reload: Callable[[Mapping[str, str], str, Any], Any]

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Return the NumPy type of the solver struct.

        Raise ControllerError unless its layout matches the compiled code.
        """
        self._same("the name", self.description.name, self.name)
        for size, value in self.description.interface.items():
            stated = getattr(self.lib, f"{self.name.upper()}_{size}", None)
            if stated is not None or size in INTERFACE_SIZES:  # other sizes are checked with the layout of the structs
                self._same(f"the size {size}", value, stated)
        unknown = self.ffi.error if isinstance(self.ffi.error, tuple) else (self.ffi.error,)
        try:
            dims = self.description.dims
            sizes = self.description.sizes
            solved = sizes["NALG"] * (1 + sizes["NALG"])  # results of Newton's method, stored after the parameters
            self.description.program.check([sizes["NX"], sizes["NU"], sizes["NP"] + solved], dims.nr, EDGES)
            layouts = {struct.name: self.description.dtype(struct.name) for struct in self.description.structs}
            for name, layout in layouts.items():
                self._check_layout(name, layout)
            return layouts["solver"]
        except ControllerError:
            raise
        except (*unknown, KeyError, TypeError, ValueError, RecursionError, MemoryError) as error:
            raise ControllerError(f"{self.name}: the compiled code lacks what is described: {error}") from error

    @cached_property
    def fingerprint(self) -> str:
        """Return the SHA-256 of the C texts; controllers with the same one can exchange their states."""
        texts = (self.files[f"{self.name}.{ext}"] for ext in ("h", "c"))
        return hashlib.sha256("\0".join(texts).encode()).hexdigest()

    def function(self, name: str) -> Any:
        """Return the C function <prefix>_<name>."""
        try:
            return self._functions[name]
        except KeyError:
            raise ControllerError(f"{self.name} was exported without {name}()") from None

    @cached_property
    def _functions(self) -> dict[str, Any]:
        """Return all C functions by name, without the prefix.

        The lookup is done once, as samples need it every time.
        """
        prefix = f"{self.name}_"
        return {n.removeprefix(prefix): getattr(self.lib, n) for n in dir(self.lib) if n.startswith(prefix)}

    def _type(self, word: str) -> Any:
        """Return cffi's type <prefix>_<word>_t."""
        name = f"{self.name}_{word}_t"
        return self._types.get(name) or self.ffi.typeof(name)

    @cached_property
    def _types(self) -> dict[str, Any]:
        """Return the types in arguments and results of functions, by name.

        cffi parses C to find a type by its name, but not to find the type of a member.
        """
        found: dict[str, Any] = {}
        waiting = [self.ffi.typeof(function) for function in self._functions.values() if callable(function)]
        while waiting:
            ctype = waiting.pop()
            if ctype.kind == "function":
                waiting += [ctype.result, *ctype.args]
            elif ctype.kind in ("pointer", "array"):
                waiting.append(ctype.item)
            elif ctype.cname not in found:
                found[ctype.cname] = ctype
                members = (ctype.fields or ()) if ctype.kind in ("struct", "union") else ()
                waiting += [member.type for _, member in members]
        return found

    @cached_property
    def empty(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the solver members that the package lacks because their size is 0."""
        d = self.description.dims
        shapes: dict[str, tuple[int, ...]] = {"p": (d.N + 1, d.np)}
        shapes |= {"yref": (d.N, d.ny), "yref_N": (d.ny_N,), "W": (d.N, d.ny), "W_N": (d.ny_N,)}
        shapes |= {"lower": (d.N + 1, d.nr), "upper": (d.N + 1, d.nr)}
        return {name: shape for name, shape in shapes.items() if not all(shape)}

    def _same(self, what: str, ours: object, theirs: object) -> None:
        """Raise ControllerError if description and compiled code differ."""
        if ours != theirs:
            raise ControllerError(
                f"{self.name}: {what} is {ours} in the description, {theirs} in the compiled code: export it again"
            )

    def _check_layout(self, struct: str, expected: np.dtype[Any]) -> None:
        """Compare size and offset of every member with the compiled struct."""
        ctype = self._type(struct)
        layout: Mapping[str, Any] = expected.fields or {}
        for member, entry in layout.items():
            place = self.ffi.offsetof(ctype, member)
            self._same(f"struct {struct}: the offset of {member}", entry[1], place)
        self._same(f"struct {struct}: the number of bytes", expected.itemsize, self.ffi.sizeof(ctype))


def restore(reload: Callable[..., Any], files: Mapping[str, str], name: str, profile: Any, state: bytes) -> Any:
    """Load a pickled package again, from the cache if possible, and restore its state."""
    controller = reload(files, name, profile)
    controller._memory[:] = np.frombuffer(state, dtype=np.uint8)
    return controller


def allocate(size: int) -> NDArray[np.uint8]:
    """Return a zeroed byte array whose first byte is aligned."""
    raw = np.zeros(size + ALIGNMENT, dtype=np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size]


def write_state(file: str | os.PathLike[str] | IO[bytes], fingerprint: str, memory: NDArray[np.uint8]) -> None:
    """Write the bytes of a struct and the fingerprint of its package as an .npz archive."""
    content = {"package": np.array(fingerprint), "state": np.asarray(memory)}
    write_arrays(file, np.savez, content)


def read_state(
    file: str | os.PathLike[str] | IO[bytes], package: CompiledPackage, shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    """Return the bytes that write_state() has written; raise ControllerError if they belong to another package."""
    try:
        with np.load(file, allow_pickle=False) as archive:
            fingerprint, state = str(archive["package"]), np.asarray(archive["state"])
    except (ValueError, KeyError, TypeError, AttributeError, *BROKEN) as error:
        raise ControllerError(f"{file} is not a state that Controller.save() wrote") from error
    if fingerprint != package.fingerprint or state.shape != shape:
        raise ControllerError(f"{file} holds the state of another package than this {package.name}")
    return state
