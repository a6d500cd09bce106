"""A target is the machine for which the C of a package is written, and its spelling there.

    portable                            ISO C99, one shooting node at a time; runs everywhere
    x86-64-v3, x86-64-v4, aarch64       GNU C (gcc 12, clang): several shooting nodes in the lanes of vector
                                        registers, matrices in register tiles
    cortex-m3, -m4f, -m7, riscv32       ISO C99 with sums in variables, functions of its own; an emulated board

"native", the target of the machine at hand, is found in runtime/native.py. Nothing here needs a compiler.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from nmpc_codegen.package.struct_layout import Precision

#: GCC 12 and 13 may align the stack of a leaf function less than its vector stores require, which then fault (observed
#: with 12.2 on processors with AVX-512). With this option the GNU assembler encodes these moves for any alignment,
#: which costs no time on aligned addresses.
UNALIGNED_MOVES = "-Wa,-muse-unaligned-vector-move"

#: Form of a sum of products: in small arrays, which compilers keep in vector registers, or in variables.
Sums = Literal["arrays", "variables"]

#: Elementary functions of a package: those of the C library, or those that it contains.
Math = Literal["libm", "own"]
MATHS: tuple[Math, ...] = get_args(Math)

#: The target of the machine at hand.
NATIVE = "native"


@dataclass(frozen=True)
class Board:
    """A board is emulated.

    unit: precision of the floating-point unit of its core (None: none); start: start-up code in templates/firmware;
    instructions_per_tick: emulated instructions per tick of its clock; the others describe its memory.
    """

    unit: Precision | None
    start: str
    instructions_per_tick: float
    code_origin: int = 0x00000000
    ram_origin: int = 0x20000000
    code_bytes: int = 4 << 20
    ram_bytes: int = 4 << 20


@dataclass(frozen=True)
class Target:
    """A target is a machine with options of the C code for it.

    sums: form of sums; lanes: number of shooting nodes that are evaluated at once; tiles: numbers in a vector of the
    register tiles of products with stage matrices, whose sums have another order, 0 without tiles; avx512: uses
    AVX-512; math: default of Options(math); flags: compiler flags; defines: macros that its compilers define; compiler:
    prefix of the cross compiler; libraries: flags for linking; emulator: command that runs its programs, or empty;
    board: for a microcontroller.
    """

    name: str
    machine: str
    sums: Sums = "arrays"
    lanes: int = 1
    tiles: int = 0
    avx512: bool = False
    math: Math = "libm"
    flags: tuple[str, ...] = ()
    defines: tuple[str, ...] = ()
    compiler: str = ""
    libraries: tuple[str, ...] = ()
    emulator: tuple[str, ...] = ()
    board: Board | None = None

    @property
    def standard(self) -> str:
        """Return the language standard; vectors are an extension of GNU C."""
        return "gnu99" if self.lanes > 1 else "c99"

    @property
    def of_machine(self) -> tuple[str, ...]:
        """Return flags for a compiler of the machine that runs the package.

        Code for boards is compiled as portable code.
        """
        return self.flags if self.defines else ()


#: Emulated time of an instruction, and of a tick of the 25 MHz timer of the Cortex-M boards, in ns.
ICOUNT_SHIFT = 6  # QEMU's option
INSTRUCTION = 2**ICOUNT_SHIFT
TICK = 40


def _microcontroller(name: str, core: str, machine: str, unit: Precision | None, *flags: str) -> Target:
    """Return a Cortex-M target on a board of QEMU."""
    return Target(
        name,
        core,
        sums="variables",
        math="own",
        flags=(f"-mcpu={core.lower().removesuffix('f')}", "-mthumb", *flags),
        compiler="arm-none-eabi-",
        libraries=("--specs=nosys.specs",),
        emulator=("qemu-system-arm", "-M", machine),
        board=Board(unit, "start.c", TICK / INSTRUCTION),
    )


_AVX2 = ("__AVX2__", "__FMA__", "__BMI2__")
_AVX512 = ("__AVX512F__", "__AVX512DQ__", "__AVX512VL__", "__AVX512BW__", "__AVX512CD__")

TARGETS: Mapping[str, Target] = {
    target.name: target
    for target in (
        Target("portable", "any machine"),
        Target(
            "x86-64-v3",
            "x86 with AVX2",
            lanes=4,
            tiles=4,
            flags=("-march=x86-64-v3",),
            defines=_AVX2,
            compiler="x86_64-linux-gnu-",
            emulator=("qemu-x86_64", "-cpu", "max"),
        ),
        Target(
            "x86-64-v4",
            "x86 with AVX-512",
            lanes=8,
            tiles=8,
            avx512=True,
            flags=("-march=x86-64-v4",),
            defines=(*_AVX2, *_AVX512),
            compiler="x86_64-linux-gnu-",
        ),
        Target(
            "aarch64",
            "ARM64",
            lanes=2,  # with four, six closed loops take 3 to 14 % more instructions
            tiles=4,
            defines=("__aarch64__",),
            compiler="aarch64-linux-gnu-",
            emulator=("qemu-aarch64",),
        ),
        _microcontroller("cortex-m3", "Cortex-M3", "mps2-an385", None, "-mfloat-abi=soft"),
        _microcontroller("cortex-m4f", "Cortex-M4F", "mps2-an386", "single", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
        _microcontroller("cortex-m7", "Cortex-M7", "mps2-an500", "double", "-mfloat-abi=hard", "-mfpu=fpv5-d16"),
        Target(
            "riscv32",
            "RV32IMAC",
            sums="variables",
            math="own",
            flags=("-march=rv32imac", "-mabi=ilp32", "--specs=picolibc.specs"),
            compiler="riscv64-unknown-elf-",
            libraries=("-Wl,--no-relax", *(f"-Wl,--defsym=__{part}_size={4 << 20}" for part in ("flash", "ram"))),
            emulator=("qemu-system-riscv32", "-M", "virt", "-bios", "none"),
            board=Board(None, "start_riscv.c", 1 / INSTRUCTION, code_origin=0x80000000, ram_origin=0x80400000),
        ),
    )
}

PORTABLE = TARGETS["portable"]
