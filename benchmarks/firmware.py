"""Packages on emulated Cortex-M boards: agreement with the host, certificates, sizes, single precision.

    python -m benchmarks.firmware [--json FILE] [--only boards,...] [--scale S]

It needs arm-none-eabi-gcc with newlib, qemu-system-arm, riscv64-unknown-elf-gcc with picolibc; keys of tools that are
missing are absent. At scale 1 every
loop has 200 samples. Instructions are emulated (QEMU, -icount shift=6), not cycles.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping

from benchmarks.lib import command
from benchmarks.lib.firmware import emulated, riscv, single, sizes
from benchmarks.lib.report import Report

PARTS: Mapping[str, Callable[[Report, float], None]] = {
    "boards": emulated.boards,
    "bits": emulated.bits,
    "sizes": sizes.sizes,
    "counts": emulated.counts,
    "single": single.single,
    "riscv": riscv.cores,
}

#: Part -> programs without which it is left out.
NEEDS = {
    "boards": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "bits": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "sizes": ("arm-none-eabi-gcc",),
    "riscv": ("riscv64-unknown-elf-gcc",),
}


def missing(part: str) -> list[str]:
    """Programs that a part needs and that are not on the path."""
    return [program for program in NEEDS.get(part, ()) if shutil.which(program) is None]


def main() -> None:
    """All parts, or some."""
    parser = command.parser(__doc__, PARTS)
    command.add_scale(parser)
    options = parser.parse_args()
    names = command.chosen(parser, options, PARTS)
    for name in names:
        if absent := missing(name):
            print(f"{name} is left out: there is no {' and no '.join(absent)}")
    report, there = Report("firmware"), [name for name in names if not missing(name)]
    command.measure(report, there, lambda name: PARTS[name](report, options.scale), options.json)


if __name__ == "__main__":
    main()
