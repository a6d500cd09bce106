"""A compiled C package: its functions, and its solver struct as a NumPy type.

The description is compared with the compiled code before it determines the layout of any memory.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.errors import ControllerError
from nmpc_codegen.runtime.package_description import Kind, PackageDescription, Struct, c_constants
from nmpc_codegen.runtime.status import KKT_PARTS, Status

ALIGNMENT = 64  # bytes: a cache line, and the widest vector register
C_REAL = {"double": "double", "single": "float"}
#: The status values that every package has; later versions added some.
EARLIEST = 12
COUNTERS = (
    *("qp_iterations", "active_set_changes", "dropped_rows", "relaxed_rows", "sqp_iterations"),
    *("violated_row", "violated_node"),
)
#: Counters of an algorithm without a QP; one that has the first has the second, too, and no counters of a QP.
NEWTON = ("newton_iterations", "accepted", "cg_iterations", "faces", "shifts", "negative_curvature", "simulations")


@dataclass(frozen=True, eq=False)
class CompiledPackage:
    """A compiled package: its texts, their description, its cffi module, and a function to load it again (pickle)."""

    name: str
    files: Mapping[str, str]
    description: PackageDescription
    profile: Any  # nmpc_codegen.runtime.build.Profile
    ffi: Any
    lib: Any
    reload: Callable[[Mapping[str, str], str, Any], Any]

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """NumPy type of the solver struct; ControllerError unless the description agrees with the compiled code."""
        try:
            self._check_names()
            self._check_sizes()
            self._check_enumerations()
            self._check_entry_points()
            for struct in self.description.structs:
                self._check_members(struct)
        except self.ffi.error as error:
            raise ControllerError(f"{self.name}: the compiled code lacks what is described: {error}") from error
        self._check_roles()
        for struct in self.description.structs:
            self._check_layout(struct.name, self.description.dtype(struct.name))
        return self.description.dtype()

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the C texts: two controllers with the same one can exchange their state."""
        texts = (self.files[f"{self.name}.{ext}"] for ext in ("h", "c"))
        return hashlib.sha256("\0".join(texts).encode()).hexdigest()

    def function(self, name: str) -> Any:
        """The C function <prefix>_<name>."""
        try:
            return self._functions[name]
        except KeyError:
            raise ControllerError(f"{self.name} was exported without {name}()") from None

    @cached_property
    def _functions(self) -> dict[str, Any]:
        """The C functions by their names without the prefix: looked up once, as they are called at every sample."""
        prefix = f"{self.name}_"
        return {n.removeprefix(prefix): getattr(self.lib, n) for n in dir(self.lib) if n.startswith(prefix)}

    def _type(self, word: str) -> Any:
        """cffi's type <prefix>_<word>_t."""
        name = f"{self.name}_{word}_t"
        return self._types.get(name) or self.ffi.typeof(name)

    @cached_property
    def _types(self) -> dict[str, Any]:
        """Types that the arguments and results of functions contain, by name: cffi parses C for a name, but not for a
        member."""
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

    # -- does the description fit the compiled code? ----------------------------------------------------------------

    def _refuse(self, what: str) -> NoReturn:
        raise ControllerError(f"{self.name}: {what}: export the package again")

    def _same(self, what: str, ours: object, theirs: object) -> None:
        """Raise ControllerError if description and compiled code differ."""
        if ours != theirs:
            self._refuse(f"{what} is {ours} in the description, {theirs} in the compiled code")

    def _constant(self, name: str) -> int | None:
        """Value of <PREFIX>_<name>, a macro or an enumeration constant; None if there is none."""
        value = getattr(self.lib, f"{self.name.upper()}_{name}", None)
        return value if type(value) is int else None

    def _check_names(self) -> None:
        if self.description.name != self.name:
            self._refuse(f"the description is that of {self.description.name!r}")
        real = self.ffi.typeof(f"{self.name}_real")
        self._same("the type of real numbers", C_REAL[self.description.precision], real.cname)

    def _check_sizes(self) -> None:
        """Compare the macros, and the lengths of all parameters, which no array shape shows."""
        for name, value in self.description.sizes.items():
            self._same(f"the size {name}", value, self._constant(name))
        parameters = self.description.parameters
        for name, parameter in zip(c_constants([p.name for p in parameters]), parameters, strict=True):
            found = self._constant(f"SIZE_{name}")
            self._same(f"the size of the parameter {parameter.name!r}", parameter.size, found)

    def _check_enumerations(self) -> None:
        """Compare the numbers of statuses, rows and parameters."""
        known = tuple(Status.__members__)
        statuses = known[: max(len(self.description.statuses), EARLIEST)]
        if self.description.statuses != statuses:
            self._refuse(f"its status values are {self.description.statuses}, those of this version {statuses}")
        described = {f"{self.name.upper()}_{status}": i for i, status in enumerate(statuses)}
        self._same("the status type", described, dict(self._type("status").relements))
        self._check_numbers("ROW", "row", [row.name for row in self.description.rows])
        self._check_numbers("PARAM", "parameter", [p.name for p in self.description.parameters])

    def _check_numbers(self, stem: str, kind: str, names: Sequence[str]) -> None:
        for number, (name, constant) in enumerate(zip(names, c_constants(names), strict=True)):
            self._same(f"the number of the {kind} {name!r}", number, self._constant(f"{stem}_{constant}"))

    def _check_entry_points(self) -> None:
        """Check that every entry point exists, with arguments of the described types."""
        words = {"real": C_REAL[self.description.precision], "int": "int"}
        for entry in self.description.entry_points:
            arguments = [f"{self._type('solver').cname} *"]
            arguments += [words[a.ctype] + (" *" if a.shape else "") for a in (*entry.inputs, *entry.outputs)]
            compiled = self.ffi.typeof(self.function(entry.name))
            self._same(f"{entry.name}(): the arguments", arguments, [a.cname for a in compiled.args])

    def _check_members(self, struct: Struct) -> None:
        """Compare names, element types and shapes of all members."""
        compiled = self._type(struct.name)
        self._same(f"{struct.name}: the kind", "union" if struct.union else "struct", compiled.kind)
        fields = dict(compiled.fields or ())
        differing = sorted(set(fields) ^ {member.name for member in struct.fields})
        if differing:
            self._refuse(f"struct {struct.name} and its description differ in the members {', '.join(differing)}")
        for member in struct.fields:
            shape, ctype = [], fields[member.name].type
            while ctype.kind == "array":
                shape.append(ctype.length)
                ctype = ctype.item
            where = f"struct {struct.name}: {member.name}"
            self._same(f"{where}: the shape", list(member.padded), shape)
            self._same(f"{where}: the type", self._c_type(member.ctype), ctype.cname)

    def _c_type(self, word: str) -> str:
        if word == "real":
            return C_REAL[self.description.precision]
        if any(word == struct.name for struct in self.description.structs):
            return str(self._type(word).cname)
        return str(self.ffi.typeof(f"{word}_t").cname)

    def _check_roles(self) -> None:
        """Check that all members that the Controller reads exist, with the shapes that sizes and layouts imply."""
        for name, allowed in self._roles().items():
            member = self.description.members("solver").get(name)
            found = None if member is None else (member.ctype, member.values)
            if found not in allowed:
                expected = " or ".join("none" if entry is None else f"{entry[0]} {list(entry[1])}" for entry in allowed)
                shown = "none" if found is None else f"{found[0]} {list(found[1])}"
                self._refuse(f"the member {name} of the solver is {shown} in the description; expected {expected}")
        stats = self.description.members("stats")
        newton = tuple(name for name in (*NEWTON, "sqp_iterations") if name in (*stats, NEWTON[1]))
        counters = newton if NEWTON[0] in stats else COUNTERS
        results = {"stats": {**dict.fromkeys(counters, "int32"), "violation": "real"}}
        results["kkt"] = dict.fromkeys(KKT_PARTS, "real")
        for struct, scalars in results.items():
            members = self.description.members(struct)
            for name, ctype in scalars.items() if members else ():
                if name not in members or (members[name].ctype, members[name].values) != (ctype, ()):
                    self._refuse(f"struct {struct} lacks the {ctype} {name}")

    def _roles(self) -> dict[str, tuple[tuple[str, tuple[int, ...]] | None, ...]]:
        """Member of the solver -> (type, shape) that it may have; None: it may be absent."""
        d = self.description.dims
        nodes, coupled = d.N + 1, sum(row.kind == "coupled" for row in self.description.rows)
        required = {"x": (nodes, d.nx), "u": (d.N, d.nu)}
        path = {"mu_u": (d.N, d.nu), "mu": (d.N, d.nh)}
        optional = {"lam": (nodes, d.nx), "mu_x": (nodes, d.nx), **path, "mu_N": (d.nh_N,), "eta": (coupled,)}
        return {
            "status": (("int32", ()),),
            "stats": (("stats", ()), None),
            "kkt": (("kkt", ()),) if self.description.offers("solve") else (None,),
            **{name: (("real", shape),) for name, shape in required.items()},
            **{name: (("real", shape), None) for name, shape in optional.items()},
            **self._settings(),
        }

    @property
    def empty(self) -> dict[str, tuple[int, ...]]:
        """Members of the solver that the package lacks because their size is 0 -> their shape."""
        d = self.description.dims
        shapes = {"mu": (d.N, d.nh), "mu_N": (d.nh_N,), "eta": (0,), "p": (d.N + 1, d.np)}
        shapes |= {"yref": (d.N, d.ny), "yref_N": (d.ny_N,), "W": (d.N, d.ny), "W_N": (d.ny_N,)}
        shapes |= {"lower": (d.N + 1, d.nr), "upper": (d.N + 1, d.nr)}
        return {name: shape for name, shape in shapes.items() if not all(shape)}

    def _settings(self) -> dict[str, tuple[tuple[str, tuple[int, ...]] | None, ...]]:
        """The same for settings: a member is absent if its data are fixed, else its layout implies its shape."""
        d, layouts = self.description.dims, self.description.online
        path, every = {"shared": 1, "node": d.N}, {"shared": 2, "node": d.N + 1}

        def members(kind: Kind, shapes: Mapping[str, tuple[tuple[int, ...], ...]]) -> dict[str, Any]:
            fixed = layouts[kind] == "fixed"
            none: tuple[None, ...] = (None,)
            return {
                n: none if fixed else (*(("real", s) for s in allowed), *(() if all(allowed[0]) else none))
                for n, allowed in shapes.items()
            }

        W, p = path.get(layouts["weight"], 0), every.get(layouts["parameter"], 0)
        y, bounds = path.get(layouts["reference"], 0), ((every.get(layouts["bounds"], 0), d.nr),)
        return {
            **members("reference", {"yref": ((y, d.ny),), "yref_N": ((d.ny_N,),)}),
            **members("weight", {"W": ((W, d.ny), (W, d.ny, d.ny)), "W_N": ((d.ny_N,), (d.ny_N, d.ny_N))}),
            **members("bounds", {"lower": bounds, "upper": bounds}),
            **members("parameter", {"p": ((p, d.np),)}),
        }

    def _check_layout(self, struct: str, expected: np.dtype[Any]) -> None:
        """Compare size and offset of every member with the compiled struct."""
        ctype = self._type(struct)
        layout: Mapping[str, Any] = expected.fields or {}
        for member, entry in layout.items():
            place = self.ffi.offsetof(ctype, member)
            self._same(f"struct {struct}: the offset of {member}", entry[1], place)
        self._same(f"struct {struct}: the number of bytes", expected.itemsize, self.ffi.sizeof(ctype))


def restored(reload: Callable[..., Any], files: Mapping[str, str], name: str, profile: Any, state: bytes) -> Any:
    """Unpickle: load the package again, from the cache if possible, and restore the state."""
    controller = reload(files, name, profile)
    controller._memory[:] = np.frombuffer(state, dtype=np.uint8)
    return controller


def aligned(size: int) -> NDArray[np.uint8]:
    """A zeroed byte array whose first byte is aligned."""
    raw = np.zeros(size + ALIGNMENT, dtype=np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size]
