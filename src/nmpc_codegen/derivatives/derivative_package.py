"""An OCP and outputs become C text, a folder, or Python functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.derivative_model import DerivativeModel, derivative_model
from nmpc_codegen.derivatives.derivative_text import render
from nmpc_codegen.derivatives.layout import structs
from nmpc_codegen.derivatives.toolbox import Derivatives
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.ir.naming import check_package_name
from nmpc_codegen.lowering.beside.folder import write
from nmpc_codegen.options import Options
from nmpc_codegen.package.opcount import OpCount
from nmpc_codegen.package.seal import seal
from nmpc_codegen.package.struct_layout import struct_layout
from nmpc_codegen.runtime.build import load_library


@dataclass(frozen=True)
class Folder:
    """The files that export() has written.

    Attributes:
        directory: absolute path of the folder.
        name: prefix of every C name.
        files: absolute paths of the files.
        operations: operation counts by function.
        bytes: sizes by struct.
    """

    directory: Path
    name: str
    files: tuple[Path, ...]
    operations: Mapping[str, OpCount]
    bytes: Mapping[str, int]


def generate(
    ocp: OCP,
    outputs: Any = None,
    options: Options | None = None,
    name: str | None = None,
    *,
    output_names: Sequence[str] | None = None,
    second_order: bool = False,
) -> dict[str, str]:
    """Return {path: text} of every file of the package.

    Args:
        ocp: the problem with its dynamics and costs; neither its rows nor their penalties are part of J.
        outputs: z_k = g(x_k, u_k, p_k), an expression of (NOUT,) elements in symbols of the OCP; None: no impulse
            response functions.
        options: integrator (default: Discrete(), or RK4 with one step per interval) and precision; other options are
            refused.
        name: C prefix, by default the name of the OCP and "_derivatives".
        output_names: one name per output, by default z[0], z[1], ...
        second_order: True: the package also computes lam' d2 Phi of every interval, by both sweeps.

    Raises:
        ProblemError: the problem, an output or a name is stated wrongly.
        OptionError: an option does not apply to derivatives, or the integrator does not support the problem.
    """
    model = derivative_model(ocp, outputs, output_names, options, second_order)
    return _sources(model, _prefix(model, name))


def _prefix(model: DerivativeModel, name: str | None) -> str:
    prefix = f"{model.problem.name}_derivatives" if name is None else name
    check_package_name(prefix, "name")
    return prefix


def _sources(model: DerivativeModel, name: str) -> dict[str, str]:
    return seal(render(model, name), name)


def export(
    ocp: OCP,
    outputs: Any = None,
    options: Options | None = None,
    directory: str | Path = ".",
    name: str | None = None,
    *,
    output_names: Sequence[str] | None = None,
    second_order: bool = False,
    force: bool = False,
) -> Folder:
    """Write the C files into a folder, under the same rules as nmpc_codegen.export().

    Args:
        ocp: as in generate().
        outputs: as in generate().
        options: as in generate().
        directory: the folder.
        name: as in generate().
        output_names: as in generate().
        second_order: as in generate().
        force: as in nmpc_codegen.export().

    Raises:
        ProblemError, OptionError: see generate().
        ExportError: a file must not be replaced, and nothing is written; or a file cannot be written.
    """
    model = derivative_model(ocp, outputs, output_names, options, second_order)
    prefix = _prefix(model, name)
    sources = _sources(model, prefix)
    folder = write(directory, sources, force=force)
    sizes = {name: size for name, (size, _) in struct_layout(structs(model), model.precision).items()}
    return Folder(folder, prefix, tuple(folder / path for path in sources), Counts(model).all, sizes)


def operations(
    ocp: OCP, outputs: Any = None, options: Options | None = None, *, second_order: bool = False
) -> dict[str, OpCount]:
    """Return the exact operation counts of every function of the package, without writing or compiling it.

    Args:
        ocp: as in generate().
        outputs: as in generate().
        options: as in generate().
        second_order: as in generate().

    Raises:
        ProblemError, OptionError: see generate().
    """
    return Counts(derivative_model(ocp, outputs, None, options, second_order)).all


def build(
    ocp: OCP,
    outputs: Any = None,
    options: Options | None = None,
    profile: str = "fast",
    name: str | None = None,
    *,
    output_names: Sequence[str] | None = None,
    second_order: bool = False,
) -> Derivatives:
    """Generate, compile and load the functions; builds are cached by content.

    Args:
        ocp: as in generate().
        outputs: as in generate().
        options: as in generate().
        profile: as in nmpc_codegen.build().
        name: as in generate().
        output_names: as in generate().
        second_order: as in generate().

    Raises:
        ProblemError, OptionError: see generate().
        BuildError: there is no compiler, or it rejected the code.
    """
    model = derivative_model(ocp, outputs, output_names, options, second_order)
    prefix = _prefix(model, name)
    ffi, lib = load_library(_sources(model, prefix), prefix, profile)
    return Derivatives(model, prefix, ffi, lib)
