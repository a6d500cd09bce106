"""A package for a target gets builds by Makefile and CMake, Zephyr, PlatformIO and Arduino, and a self-test.

All builds compile <name>.c with the flags of the certificate; if the framework chooses the core, only with its flags of
arithmetic. Only the Arduino library needs a copy of the C, because its tools search no other folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nmpc_codegen.firmware.certificate import Certificate
from nmpc_codegen.firmware.recording import TOLERANCE, Recording, literals
from nmpc_codegen.firmware.toolchain import ARITHMETIC, SECTIONS
from nmpc_codegen.lowering.templates import environment
from nmpc_codegen.package.seal import has_seal
from nmpc_codegen.targets import ICOUNT_SHIFT, Target

#: File -> its template in templates/firmware.
CROSS = {
    "firmware/Makefile": "Makefile",
    "firmware/CMakeLists.txt": "CMakeLists.txt",
    "firmware/toolchain.cmake": "toolchain.cmake",
    "firmware/budget.c": "budget.c",
    "firmware/selftest.h": "selftest.h",
    "firmware/selftest.c": "selftest.c",
    "firmware/selftest_main.c": "selftest_main.c",
    "zephyr/module.yml": "zephyr_module.yml",
    "zephyr/CMakeLists.txt": "zephyr_CMakeLists.txt",
    "zephyr/Kconfig": "zephyr_Kconfig",
    "library.json": "library.json",
}


def layouts(
    package: Mapping[str, str], recording: Recording, target: Target, certificate: Certificate, ram: int | None
) -> dict[str, str]:
    """Return the files of all builds.

    ``ram`` is the budget that budget.c checks; None: the size of the struct.
    """
    name = certificate.name
    names = _names(recording, target, certificate, ram)

    def render_file(template: str) -> str:
        return environment().get_template(f"firmware/{template}.jinja").render(names)

    files = {path: render_file(template) for path, template in CROSS.items()}
    arduino = f"arduino/{name}"
    files[f"{arduino}/library.properties"] = render_file("library.properties")
    files[f"{arduino}/examples/{name}_loop/{name}_loop.ino"] = render_file("sketch.ino")
    return (
        files
        | {f"{arduino}/src/{name}.{ext}": without_seal(package[f"{name}.{ext}"]) for ext in ("h", "c")}
        | {f"{arduino}/src/{path}": without_seal(package[path]) for path in (f"{name}_dumps.h",) if path in package}
    )


def _names(recording: Recording, target: Target, certificate: Certificate, ram: int | None) -> dict[str, Any]:
    """Return the names that the templates may use."""
    d, portable = recording.description, (*ARITHMETIC[1:], *SECTIONS)
    tolerance = TOLERANCE[d.precision]
    return {
        "p": d.name,
        "P": d.name.upper(),
        "target": target,
        "icount": ICOUNT_SHIFT,
        "flags": " ".join(certificate.flags),
        "arithmetic": " ".join((f"-{certificate.level}", *portable)),
        "quoted": ", ".join(f'"{flag}"' for flag in portable),
        "ram": certificate.struct_bytes if ram is None else ram,
        "origin": "the size for which the package was certified" if ram is None else "--max-ram",
        "stack": certificate.stack_bytes[d.kind.law],
        "flash": certificate.flash_bytes,
        "samples": len(recording.x),
        "tolerance": f"{tolerance:g}",
        "u": [literals(row, d.precision) for row in recording.u],
        "status": ", ".join(str(int(s)) for s in recording.status),
        "accepted": literals(tolerance * recording.u_range, d.precision),
        "preparation": [f"{d.name}_prepare(&solver);"] if d.has_phases else [],
        "control": "feedback" if d.has_phases else "step",
        "milliseconds": max(1, round(1000 * d.dt[0])),
    }


def without_seal(text: str) -> str:
    """Return the text of a file without its checksum line; a copy gets a new checksum line."""
    lines = text.splitlines(keepends=True)
    return "".join(lines[:-1]) if lines and has_seal(lines[-1].encode()) else text
