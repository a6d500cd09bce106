"""Flash memory, RAM and stack in single precision on the Cortex-M4F."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.lib.firmware.loops import loops, package, small, without_fallback
from benchmarks.lib.report import Report
from benchmarks.lib.robustness.work import Loop
from nmpc_codegen import Options
from nmpc_codegen.firmware.certificate import Certificate, certify
from nmpc_codegen.firmware.targets import LEVELS, TARGETS

#: Loop -> limits on bytes of flash memory and of the solver struct.
LIMITS = {"crane": (20_000, 6_500), "quadrotor": (44_000, 60_000)}
STACK = 2_500

#: Loops whose small package gives up the interior point behind the active set.
GIVES_UP = ("quadrotor",)


def forms(loop: Loop) -> dict[str, Options]:
    """Name of a form -> its options: the default, and the small real-time controller."""
    defaults = replace(loop.options, precision="single")
    chosen = without_fallback(loop.options) if loop.name in GIVES_UP else small(loop.options)
    return {"default": defaults, "small": chosen}


def sizes(report: Report, scale: float) -> None:
    """All loops in all forms, at both levels; the limits are for the small form at the better level."""
    for loop in loops():
        for form, options in forms(loop).items():
            name, sources = package(loop, options)
            found = [certify(sources, name, TARGETS["cortex-m4f"], level) for level in LEVELS]
            add(report, loop.name, form, found)


def add(report: Report, name: str, form: str, found: list[Certificate]) -> None:
    """The figures of a form."""
    flash_limit, ram_limit = LIMITS.get(name, (None, None)) if form == "small" else (None, None)
    small_form, suffix = form == "small", "" if form == "small" else f"_{form}"
    least = min(found, key=lambda c: c.flash_bytes)
    note = f"{name}, {form}, -{least.level}, M4F"
    report.add(f"{name}_flash_bytes{suffix}", least.flash_bytes, "B", case=note, limit=flash_limit, profile=least.level)
    report.add(f"{name}_ram_bytes_single_rti{suffix}", least.struct_bytes, "B", case=note, limit=ram_limit)
    for certificate in found:
        entry = max(certificate.stack_bytes, key=lambda e: certificate.stack_bytes[e])
        case = f"{name}, {form}, -{certificate.level}: {entry}, {' > '.join(certificate.stack_chain)}"
        key = f"stack_worst_bytes_{certificate.level}{suffix}"
        report.add(key, certificate.stack_worst, "B", case=case, profile=certificate.level)
    shallow = min(found, key=lambda c: c.stack_worst)
    limit = STACK if small_form else None
    key = f"stack_worst_bytes{suffix}"
    report.add(key, shallow.stack_worst, "B", case=f"{name}, {form}, -{shallow.level}", limit=limit)
