"""A batch on a device runs one thread for each controller: this module writes its kernel and launches it.

The text of the package is compiled unchanged, with every function as a device function. The structs stay on the device
between calls; their 32-bit words are interleaved over the controllers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nmpc_codegen.errors import ControllerError, warn
from nmpc_codegen.runtime import given
from nmpc_codegen.runtime.batch.driver import REAL, Driver, declarations_of, part
from nmpc_codegen.runtime.batch.many import Batch, check
from nmpc_codegen.runtime.batch.struct_block import Into, Statuses, Structs, reserve, stride_of
from nmpc_codegen.runtime.batch.told import Told
from nmpc_codegen.runtime.compiled import CompiledPackage
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.targets import TARGETS

Array = Any  # of the device

WORD = 4  # bytes

#: Largest number of bytes that the samples of one launch may take.
BYTES = 2**31

#: Functions with at least this number of lines are not inlined: the compiler then takes a tenth of the time.
LARGE = 8

#: QP solvers whose threads diverge.
SLOW = ("RiccatiInteriorPoint",)

#: Functions that only some packages have.
OPTIONAL = (
    *("algebraic", "prepare", "shift", "solve"),
    *("set_parameter", "set_parameter_range", "set_reference", "set_reference_range", "set_terminal_reference"),
    *("set_bounds", "set_bounds_range"),
)

_SIZES = """
typedef {real} real_t;
enum {{ NX = {NX}, NU = {NU}, NALG = {NALG}, ALL = -1, ROWS = {ROWS} }};
#define PACKAGE(name) {name}_##name
"""


class Engine(Protocol):
    """A device has arrays with the interface of NumPy, and kernels."""

    xp: Any  # a module with NumPy's functions
    begin: str  # the first lines of a kernel

    def load(self, text: str, exact: bool) -> None:
        """Compile the kernel; with ``exact``, a * b + c is not contracted."""

    def launch(self, argument: Array, threads: int) -> None:
        """Run the kernel with ``threads`` threads; ``argument`` holds the bytes of batch_launch_t on the device."""

    def address(self, array: Array) -> int:
        """Return the address of an array on the device."""

    def fetch(self, array: Array) -> NDArray[Any]:
        """Copy an array from the device to a NumPy array."""

    def largest(self, bytes_of_flight: int) -> int:
        """Return the number of flights that fit into the free memory in one launch."""


def kernel_text(package: CompiledPackage, begin: str) -> str:
    """Return the kernel of a package for the compiler of a device, in one text without #include."""
    name, files = package.name, package.files
    described, d = package.description, package.description.dims
    widest = max(2, d.ny, d.ny_N, *(signal.size for signal in described.parameters))
    sizes = {name: described.interface[name] for name in ("NX", "NU")}
    sizes |= {"NALG": max(1, len(described.names.algebraic)), "ROWS": (d.N + 2) * widest}
    has = "".join(f"#define HAS_{f.upper()} {int(f in package._functions)}\n" for f in OPTIONAL)
    text = [begin, files[f"{name}.h"], declarations_of("driver.h", "device.h")]
    text += [
        _SIZES.format(**sizes, real=REAL[described.precision], name=name),
        has,
        part("device.c"),
        files[f"{name}.c"],
    ]
    lines = [line for line in "\n".join(text).split("\n") if not line.startswith("#include")]
    return "\n".join(mark_noinline(lines)) + "\n"


def mark_noinline(lines: list[str]) -> list[str]:
    """Mark the large functions of a text, which begin and end in the first column, as not to be inlined."""
    found = list(lines)
    begin = 0
    for i, line in enumerate(lines):
        if line == "{":
            begin = i
        elif line == "}" and i - begin > LARGE:
            first = next((j for j in range(begin - 1, -1, -1) if lines[j][:1].isalpha()), begin)
            words = lines[first]
            if words.startswith(("static inline", "TARGET", "KERNEL", "typedef", "enum", "struct")) or "(" not in words:
                continue
            static, rest = ("static ", words[7:]) if words.startswith("static ") else ("", words)
            found[first] = f"{static}__noinline__ {rest}"
    return found


def check_package(package: CompiledPackage) -> None:
    """Raise ControllerError if a device cannot run the package; warn (RuntimeWarning) of what runs slowly there."""
    described = package.description
    if TARGETS[described.target].lanes > 1:
        raise ControllerError(f"{package.name} has the target {described.target!r}; a device runs 'portable' ones")
    if any("/" in path for path in package.files):
        raise ControllerError(
            f"{package.name} has a QP solver of other authors, which no device runs; choose another qp"
        )
    if described.options.get("qp") in SLOW:
        text = f"{package.name}: threads of a GPU diverge in its interior point; an active-set method suits them"
        warn(text, RuntimeWarning)


class DeviceBatch(Batch):
    """A device batch is a Batch whose structs stay on a device.

    Calls take NumPy arrays, or device arrays by DLPack, and return device arrays. x, u, ... are copies on the device:
    assign to the attribute to change them. Setters copy the structs to the host and back; simulate() writes its tables
    on the device. many[i] is a copy. Closed loops run on the device; their results are judged on the host.
    """

    def __init__(self, controller: Controller, number: int, engine: Engine) -> None:
        check(controller, number)
        package = controller._package
        check_package(package)
        self._engine, self._xp = engine, engine.xp
        self.driver, self._count = Driver(package, 1), int(number)
        self.stride = stride_of(package.dtype.itemsize)
        struct: NDArray[np.void] = np.broadcast_to(np.zeros((), package.dtype), (self._count,))
        super(Structs, self).__init__(package, struct)
        engine.load(kernel_text(package, engine.begin), "-ffp-contract=off" in package.profile.flags)
        self.words = self._xp.zeros((package.dtype.itemsize // WORD, self._count), np.uint32)
        self.call("COPY", None, first=controller._memory.view(np.uint32)[None])

    # -- calls --------------------------------------------------------------------------------------------------------

    def call(self, operation: str, function: str | None, **arguments: Any) -> Statuses:
        """Launch the kernel for all controllers, or for those in ``index``; return their statuses."""
        if function is not None:
            self._package.function(function)
        index, places = arguments.get("index"), arguments.get("places", ())
        threads = self._count if index is None else len(index)
        status = self._xp.zeros(threads, np.int32)
        launch = self.driver.ffi.new("batch_launch_t *")
        launch.operation = getattr(self.driver.lib, f"BATCH_ON_{(function or operation).upper()}")
        launch.threads, launch.number = threads, arguments.get("number", 0.0)
        launch.count = places[0] if places else 0
        pointers = {name: arguments.get(name) for name in ("index", "first", "second", "out")} | {"status": status}
        self._launch(launch, pointers)
        return status  # type: ignore[no-any-return]

    def _launch(self, launch: Any, arrays: Mapping[str, Array | None]) -> None:
        """Run the kernel with these arrays as members of its argument."""
        ffi, on_device = self.driver.ffi, []
        launch.structs = self._count
        launch.words = ffi.cast("uint32_t *", self._engine.address(self.words))
        for name, array in arrays.items():
            if array is not None:
                on_device.append(self._xp.asarray(array))
                setattr(launch, name, ffi.cast(ffi.typeof(getattr(launch, name)), self._engine.address(on_device[-1])))
        argument = self._xp.asarray(np.frombuffer(ffi.buffer(launch), np.uint8).copy())
        self._engine.launch(argument, int(launch.threads))

    def _zeros(self, width: int) -> Array:
        return self._xp.zeros((self._count, width), self._real)

    def _states(self, X: Any, what: str) -> Array:
        return self._on_device(X, what, self.dims.nx)

    def _controls(self, U: Any) -> Array:
        return self._on_device(U, "U", self.dims.nu) if self.dims.nu else self._zeros(1)

    def _on_device(self, value: Any, what: str, width: int) -> Array:
        """Return states or controls (M, width) on the device, without a copy if they are there already."""
        if isinstance(value, np.ndarray | list | tuple):
            value = given.checked_array(value, what, self._real, (self._count, width), finite=False)
        elif hasattr(value, "__dlpack__"):
            value = self._xp.from_dlpack(value)
        elif not isinstance(value, self._xp.ndarray):
            raise ControllerError(f"{what} is {value!r:.60}; expected an array of shape ({self._count}, {width})")
        array = self._xp.ascontiguousarray(self._xp.asarray(value, self._real))
        if array.shape != (self._count, width):
            raise ControllerError(f"{what} has shape {array.shape}; expected ({self._count}, {width})")
        return array

    # -- structs ------------------------------------------------------------------------------------------------------

    def host(self) -> Structs:
        """Copy the structs to memory of the host."""
        memory = reserve(self._count * self.stride)
        bytes_of = self._package.dtype.itemsize
        rows = memory.reshape(self._count, self.stride)
        rows[:, bytes_of:] = 0
        rows[:, :bytes_of] = np.ascontiguousarray(self._engine.fetch(self.words).T).view(np.uint8)
        return Structs(self.driver, memory, self._count, self.stride)

    def shares(self, other: Structs) -> bool:
        return other is self

    def twin(self) -> Structs:
        return self.host()

    def copy(self) -> Batch:
        twin = DeviceBatch(self[0], self._count, self._engine)
        twin.words[...] = self.words
        return twin

    __copy__ = copy

    def __reduce__(self) -> tuple[Any, ...]:
        raise ControllerError("a batch on a device cannot be pickled; many[i] can")

    def _tell(self, index: ArrayLike | None, tell: Callable[[Told], None]) -> None:
        host = self.host()
        tell(Told(host, index))
        self.words[...] = self._xp.asarray(self._interleave(host))

    def _interleave(self, structs: Structs) -> NDArray[np.uint32]:
        """Return the words of the structs as an array (words of a struct, structs)."""
        bytes_of = self._package.dtype.itemsize
        rows = structs.memory.reshape(len(structs), structs.stride)[:, :bytes_of]
        return np.ascontiguousarray(np.ascontiguousarray(rows).view(np.uint32).T)

    def __getitem__(self, i: int) -> Controller:
        """Return a copy of controller number ``i``."""
        memory = reserve(self._package.dtype.itemsize)
        memory[:] = np.ascontiguousarray(self._engine.fetch(self.words[:, self._number(i)])).view(np.uint8)
        return Controller(self._package, memory)

    def _view(self, path: str) -> Array:
        begin, layout = self._find(path)
        if layout is None:
            return self._xp.zeros((self._count, *self._package.empty[path]), self._real)
        if begin < 0 or (layout.base.fields is not None and layout.shape):
            return self.host().view(path)
        if layout.base.fields is not None:
            host = self._engine.fetch(self._words_of(begin, layout))
            return np.ascontiguousarray(host.T).view(layout.base).reshape(self._count)
        words = self._xp.ascontiguousarray(self._words_of(begin, layout).T)
        return words.view(layout.base).reshape(self._count, *layout.shape)

    def _assign(self, view: Array, name: str, value: ArrayLike) -> None:
        whole = self._view(name)
        on_host = isinstance(value, np.ndarray | list | tuple | float | int)
        whole[..., : view.shape[-1]] = self._xp.asarray(self._array(name, value, view.shape) if on_host else value)
        self._put(name, whole)

    def _put(self, name: str, whole: Array) -> None:
        """Write a member of all structs."""
        words = self._xp.ascontiguousarray(whole).reshape(self._count, -1).view(np.uint32).T
        self._words_of(*self._find(name))[...] = words

    def _every_multiplier(self, name: str) -> NDArray[Any]:
        return self._engine.fetch(super()._every_multiplier(name))

    def _set_multipliers(self, name: str, value: ArrayLike) -> None:
        every, shape = self._every_multiplier(name).copy(), (self._count, *self._row_multipliers.shapes[name])
        on_host = value if isinstance(value, np.ndarray | list) else self._engine.fetch(value)
        self._row_multipliers.write(name, self._array(name, on_host, shape), every)
        self._put("mult", self._xp.asarray(every))

    def _find(self, path: str) -> tuple[int, Any]:
        """Return the first byte and the type of a member.

        The type is None if the package lacks the member because its size is 0. The first byte is < 0 if the member is
        inside an array of structs.
        """
        begin, layout = 0, self._package.dtype
        for name in path.split("."):
            fields: Any = layout.base.fields or {}
            if name not in fields and path in self._package.empty:
                return 0, None
            if name not in fields:
                raise AttributeError(f"the algorithm of {self._package.name} has no {path!r}")
            begin, layout = -1 if layout.shape or begin < 0 else begin + fields[name][1], fields[name][0]
        return begin, layout

    def _words_of(self, begin: int, layout: Any) -> Array:
        return self.words[begin // WORD : (begin + layout.itemsize) // WORD]

    @property
    def nbytes(self) -> int:
        return int(self.words.nbytes)

    def __repr__(self) -> str:
        return f"<Batch {self._count} of {self.description.name}, {self.nbytes / 2**20:.3g} MiB on a device>"

    # -- closed loops -------------------------------------------------------------------------------------------------

    def structs_of(self, plant: Controller | Batch) -> Structs:
        structs = plant.host() if isinstance(plant, DeviceBatch) else super().structs_of(plant)
        if structs._package.fingerprint != self._package.fingerprint:
            raise ControllerError("plant: on a device it is a controller of the same package")
        return structs

    def fetch(self, member: str) -> NDArray[Any]:
        found = self.member(member)
        return found if isinstance(found, np.ndarray) else self._engine.fetch(found)

    @property
    def stop(self) -> Any:
        return self.driver.ffi.NULL  # a launch is not interrupted

    def address_of(self, structs: Structs, keep: list[Any]) -> Any:
        if structs is not self:
            return self.reach(self._interleave(structs), keep)
        return self.driver.ffi.cast("void *", self._engine.address(self.words))

    def reach(self, array: NDArray[Any], keep: list[Any]) -> Any:
        keep.append(self._xp.asarray(array))
        return self.driver.ffi.cast("void *", self._engine.address(keep[-1]))

    def reach_structs(self, structs: Any, keep: list[Any]) -> Any:
        ffi = self.driver.ffi
        address = self.reach(np.frombuffer(ffi.buffer(structs), np.uint8).copy(), keep)
        return ffi.cast(ffi.getctype(ffi.typeof(structs).item, "*"), address)

    def block_size(self, flights: int, bytes_of: int) -> int:
        return max(1, min(flights, self._engine.largest(bytes_of), BYTES // bytes_of))

    def fly(self, shared: Any, block: slice, into: Into, rows: int) -> int:
        ffi = self.driver.ffi
        launch = ffi.new("batch_launch_t *")
        launch.operation = self.driver.lib.BATCH_ON_FLY
        launch.flights, launch.threads = shared[0], block.stop - block.start
        setattr(launch, "from", block.start)
        written = {}
        for name, array in vars(into).items():
            written[name] = self._xp.full(array.shape, np.nan if array.dtype.kind == "f" else -1, array.dtype)
            address = ffi.cast(ffi.typeof(getattr(launch.flights, name)), self._engine.address(written[name]))
            setattr(launch.flights, name, address)
        refused = self._xp.zeros(int(launch.threads), np.int32)
        self._launch(launch, {"status": refused})
        for name, array in vars(into).items():
            array[...] = self._engine.fetch(written[name])
        return int(refused.max())
