"""Bytes of code and of RAM of the crane and the quadrotor, complete and for real-time iterations only (solve=False)."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks.lib.report import Report
from examples import crane, quadrotor
from nmpc_codegen import OCP, Options, RiccatiActiveSet, generate
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.ir.print_sweep import print_routine
from nmpc_codegen.lowering.linearize import linearize
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.lowering.preamble import unit_style
from nmpc_codegen.lowering.render import render
from nmpc_codegen.runtime.build import find_compiler

CODE_LIMITS = {"": 71_300, "_rti": 55_200}
RAM_LIMITS = {"crane": {"": 16_500, "_rti": 13_750}, "quadrotor": {"": 154_000, "_rti": 126_500}}
MAKE: dict[str, Callable[[], OCP]] = {"crane": crane.build_ocp, "quadrotor": quadrotor.build_ocp}
#: Suffix of the keys -> options of every problem: the defaults; a controller for real-time operation only.
_DEFAULTS, _RTI = Options(), Options(solve=False)
VARIANTS = {
    "": {"crane": _DEFAULTS, "quadrotor": _DEFAULTS},
    "_rti": {"crane": _RTI, "quadrotor": replace(_RTI, qp=RiccatiActiveSet(fallback=None))},
}

_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.S)


def measure(report: Report) -> None:
    """<problem>_code_bytes, <problem>_ram_bytes, and the same for real-time operation only."""
    for suffix, options in VARIANTS.items():
        code = code_bytes(MAKE["crane"](), options["crane"])
        report.add(f"crane_code_bytes{suffix}", code, "bytes", limit=CODE_LIMITS[suffix])
        with_products = code_bytes(MAKE["crane"](), options["crane"], products=True)
        report.add(f"crane_code_bytes{suffix}_with_products", with_products, "bytes")
        for name, limits in RAM_LIMITS.items():
            ram = ram_bytes(MAKE[name](), options[name])
            report.add(f"{name}_ram_bytes{suffix}", ram, "bytes", case="double", limit=limits[suffix])


def code_bytes(ocp: OCP, options: Options, products: bool = False) -> int:
    """Bytes of the .c without comments, indentation, empty lines, and code printed from kernels and sweeps.

    ``products``: those with the stage matrices, which are printed likewise, count nevertheless.
    """
    module = lower(linearize(classify(ocp), options))
    text = render(module)[f"{module.name}.c"]
    printed_routines = module.routines if products else (*module.routines, *module.called_products)
    for routine in printed_routines:
        printed = print_routine(routine, unit_style(module.precision))
        if printed not in text:
            raise ValueError(f"{routine.name} is not in {module.name}.c as it is printed")
        text = text.replace(printed, "")
    lines = (line.strip() for line in _COMMENT.sub("", text).splitlines())
    return sum(len(line.encode()) + 1 for line in lines if line)


def ram_bytes(ocp: OCP, options: Options) -> int:
    """sizeof the solver struct, according to the C compiler."""
    name = ocp.name
    program = f'#include <stdio.h>\n#include "{name}.h"\nint main(void) {{ printf("%zu", sizeof({name}_solver_t)); }}\n'
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, f"{name}.h").write_text(generate(ocp, options)[f"{name}.h"], encoding="utf-8")
        Path(folder, "size.c").write_text(program, encoding="utf-8")
        subprocess.run([*find_compiler(), "-std=c99", "size.c", "-o", "size"], cwd=folder, check=True)
        return int(subprocess.run(["./size"], cwd=folder, capture_output=True, check=True).stdout)
