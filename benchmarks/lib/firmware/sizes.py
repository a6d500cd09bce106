"""Flash memory, RAM and stack are measured in single precision on the Cortex-M4F."""

from __future__ import annotations

from benchmarks.lib.firmware.loops import loops, package, small, smallest, with_precision
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from nmpc_codegen import Options
from nmpc_codegen.firmware.certificate import REAL_TIME, Certificate, certify
from nmpc_codegen.firmware.toolchain import LEVELS
from nmpc_codegen.targets import TARGETS
from verification.robustness.work import Loop

#: Loop -> limits on bytes of flash memory and of the solver struct.
LIMITS = {"crane": (20_000, 6_500), "quadrotor": (44_000, 60_000)}
STACK = 2_500


def forms(loop: Loop) -> dict[str, Options]:
    """Return {form: its options}: the default, the small real-time controller, and it with the goal "size"."""
    return {"default": with_precision(loop, "single").options, "small": small(loop), "size": smallest(loop)}


def sizes(report: Report, asked: Run) -> None:
    """Measure all loops in all forms, at both levels; the limits are for the small form at the better level."""
    for loop in asked.cases(loops()):
        for form, options in asked.cases(forms(loop).items()):
            name, sources = package(loop, options)
            found = [certify(sources, name, TARGETS["cortex-m4f"], level) for level in LEVELS]
            add(report, loop.name, form, found)


def add(report: Report, name: str, form: str, found: list[Certificate]) -> None:
    """Report the figures of a form."""
    flash_limit, ram_limit = LIMITS.get(name, (None, None)) if form == "small" else (None, None)
    suffix = "" if form == "small" else f"_{form}"
    least = min(found, key=lambda c: c.flash_bytes)
    note = f"{name}, {form}, -{least.level}, M4F"
    report.add(f"{name}_flash_bytes{suffix}", least.flash_bytes, "B", case=note, limit=flash_limit, profile=least.level)
    report.add(f"{name}_ram_bytes_single_rti{suffix}", least.struct_bytes, "B", case=note, limit=ram_limit)
    for certificate in found:
        entry = max(certificate.stack_bytes, key=lambda e: certificate.stack_bytes[e])
        case = f"{name}, {form}, -{certificate.level}: {entry}, {' > '.join(certificate.stack_chain)}"
        key = f"stack_all_entry_points_bytes{suffix}"
        report.add(key, certificate.stack_worst, "B", case=case, profile=certificate.level)
    shallow = min(found, key=real_time_stack)
    case, limit = f"{name}, {form}, -{shallow.level}", STACK if form == "small" else None
    report.add(f"stack_worst_bytes{suffix}", real_time_stack(shallow), "B", case=case, limit=limit)


def real_time_stack(certificate: Certificate) -> int:
    """Return the stack of the entry points that a real-time controller calls, without kkt() and other supervision."""
    return max(size for entry, size in certificate.stack_bytes.items() if entry in REAL_TIME)
