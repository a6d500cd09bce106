"""Budgets limit memory, stack and operations; a package that exceeds one is not exported."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from nmpc_codegen.errors import OptionError
from nmpc_codegen.firmware.certificate import Certificate
from nmpc_codegen.package.description import PackageDescription

#: Every limit is below this number.
LARGEST = 1e18

_NUMBER = re.compile(r"(\d+(?:\.\d*)?(?:e\d+)?)([km]?)$", re.IGNORECASE)
#: Factors of the suffixes k and m: for bytes, and for numbers of operations.
BYTES = {"": 1, "k": 1 << 10, "m": 1 << 20}
OPERATIONS = {"": 1, "k": 10**3, "m": 10**6}


@dataclass(frozen=True)
class Budgets:
    """Budgets limit sizes in bytes, and the worst case of a sample in operations; None: no limit.

    ``ram`` limits the solver struct, ``flash`` code and constants of the package, ``stack`` the stack of every entry
    point with its library functions.
    """

    ram: int | None = None
    flash: int | None = None
    stack: int | None = None
    operations: int | None = None


def parse_size(flag: str, text: str, units: Mapping[str, int] = BYTES) -> int:
    """Parse a positive number, e.g. "64k" (64 * 1024 bytes, or 64 * 1000 operations), "1.5M", "2e6".

    Raises:
        OptionError: the text is no such number.
    """
    found = _NUMBER.match(text.strip())
    value = float(found[1]) * units[found[2].lower()] if found else 0.0
    if not 1 <= value < LARGEST:
        raise OptionError(
            f"{flag} {text}: expected a number of at least 1 and less than {LARGEST:.0e}, "
            f"e.g. 6000, 64k (64 * {units['k']}) or 2e6"
        )
    return round(value)


def check(
    budgets: Budgets,
    description: PackageDescription,
    certificate: Certificate | None,
    worst: Callable[[], int],
    dumps: int = 0,
) -> None:
    """Compare the package with the budgets.

    ``worst`` returns the worst-case number of operations of a sample; ``dumps`` is the size of a ring of samples beside
    the struct.

    Raises:
        OptionError: the package exceeds a budget; the message says by how much, and what to change. Or flash or stack
            are limited without a target, so that there is no certificate.
    """
    exceeded = list(_find_excesses(budgets, description, certificate, dumps))
    if budgets.operations is not None:
        what = "operations of a sample at most"
        exceeded += _judge("operations", budgets.operations, worst(), what, description, _operations_advice)
    if exceeded:
        raise OptionError("; ".join(exceeded))


def _find_excesses(
    budgets: Budgets, description: PackageDescription, certificate: Certificate | None, dumps: int
) -> Iterator[str]:
    report = description.report
    if budgets.ram is not None:
        ram = report.ram_bytes if certificate is None else certificate.struct_bytes
        what = "bytes of solver struct" + (" and dumps" if dumps else "")
        yield from _judge("ram", budgets.ram, ram + dumps, what, description, _ram_advice)
    for name, advice in (("flash", _flash_advice), ("stack", _stack_advice)):
        limit = getattr(budgets, name)
        if limit is None:
            continue
        if certificate is None:
            raise OptionError(f"--max-{name} needs --target with a microcontroller: it depends on compiler and core")
        used = certificate.flash_bytes if name == "flash" else certificate.stack_worst
        what = "bytes of code and constants" if name == "flash" else f"bytes ({' > '.join(certificate.stack_chain)})"
        yield from _judge(name, limit, used, what, description, advice)


def _judge(
    name: str,
    limit: int,
    used: int,
    what: str,
    description: PackageDescription,
    advice: Callable[[PackageDescription, int], Iterator[str]],
) -> Iterator[str]:
    if used > limit:
        remedies = ", or ".join(advice(description, limit))
        excess = f"{description.name} takes {used:,} {what}, {used - limit:,} too many"
        yield f"--max-{name} {limit}: {excess}; try {remedies}"


def _common_advice(description: PackageDescription) -> Iterator[str]:
    if description.offers("solve"):
        yield "--set solve=False, which leaves out solve()"
    if description.precision == "double":
        yield "--set precision=single"


def _ram_advice(description: PackageDescription, limit: int) -> Iterator[str]:
    yield from _common_advice(description)
    if any(s.name == "condensed" for s in description.structs):
        yield "--set condensing=none, which is linear in the horizon"
    if description.online["parameter"] == "node" and description.dims.np:
        yield "--set online.parameter=shared"
    if description.online["reference"] == "node":
        yield "--set online.reference=shared"
    yield "fewer intervals"


def _flash_advice(description: PackageDescription, limit: int) -> Iterator[str]:
    yield "--level Os"
    yield from _common_advice(description)
    if not description.discrete:
        yield "--set integrator.unroll=none"


def _operations_advice(description: PackageDescription, limit: int) -> Iterator[str]:
    options = description.options
    if "qp.max_iterations" in options:
        yield "a smaller --set qp.max_iterations=..., after a simulation with disturbances"
    if options.get("algorithm.iterations", 1) != 1:
        yield "a smaller --set algorithm.iterations=..."
    if options.get("qp.fallback"):
        yield "--set qp.fallback=None"
    if options.get("algorithm.repair"):
        yield "--set algorithm.repair=0"
    yield "fewer intervals"


def _stack_advice(description: PackageDescription, limit: int) -> Iterator[str]:
    yield from _common_advice(description)
    if not description.discrete:
        yield "another --set integrator.unroll=none|all"
