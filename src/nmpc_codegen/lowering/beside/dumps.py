"""A ring buffer beside a controller stores samples for replays on a computer."""

from __future__ import annotations

from collections.abc import Mapping

from nmpc_codegen.errors import OptionError
from nmpc_codegen.lowering.render import tidy
from nmpc_codegen.lowering.templates import environment
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.seal import package_of, seal_beside, without_seal

MOST = 1000  # slots
HEAD = 40  # bytes of a ring before its slots


def with_dumps(package: Mapping[str, str], description: PackageDescription, slots: int) -> dict[str, str]:
    """Return <name>_dumps.h with its number of slots, and the README that describes it.

    Raises:
        OptionError: the number is wrong, or the package is no controller.
    """
    name = description.name
    if not isinstance(slots, int) or isinstance(slots, bool) or not 1 <= slots <= MOST:
        raise OptionError(f"dumps is {slots!r}; expected the number of samples that are kept, 1 to {MOST}")
    if description.estimation is not None or not description.dims.nu:
        raise OptionError(f"dumps: {name} is no controller with controls")
    names = {"p": name, "P": name.upper(), "slots": slots, "digest": package_of(package[f"{name}.c"])}
    header = tidy(environment().get_template("package/dumps.h.jinja").render(names))
    words = (
        f"`{name}_dumps.h` keeps the last {slots} samples in a `{name}_dumps_t`, {ring_bytes(description, slots):,} "
        f"bytes beside the solver struct: call "
        f"`{name}_dumps_step()` in the place of `{name}_step()`. Save its bytes after a fault; "
        '`nmpc_codegen.replay("dumps.bin", "this folder")` takes the samples again on a computer, and says which '
        "status, row and node each had."
    )
    readme = f"{without_seal(package['README.md']).rstrip()}\n\n## Dumps\n\n{words}\n"
    return seal_beside({f"{name}_dumps.h": header, "README.md": readme}, package)


def obsolete_dumps(name: str) -> dict[str, str]:
    """Return the path of the header that an earlier export may have left, and the header's first words."""
    return {f"{name}_dumps.h": f"/* {name}_dumps: the last "}


def ring_bytes(description: PackageDescription, slots: int) -> int:
    """Return the size of a ring with this number of samples."""
    real, d = description.real.itemsize, description.dims
    used = description.report.ram_bytes + real * (d.nx + d.nu) + 8
    return HEAD + slots * -(-used // real) * real
