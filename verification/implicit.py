"""The interval functions of implicit schemes are in a shared library of their own, called with NumPy vectors."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmpc_codegen.components.integrators.implicit.stage_kernels import StageKernels
from nmpc_codegen.components.integrators.implicit_runge_kutta import NEWTON_LIMIT, ImplicitRungeKutta
from nmpc_codegen.decisions.dimensions import dimensions
from nmpc_codegen.frontend.completion.complete import complete
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.printing.c_style import unit_style
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.lowering.unit.macros import REAL_CONSTANT, arithmetic, kernel_call, print_macro
from nmpc_codegen.lowering.unit.read import read_part
from nmpc_codegen.options import Options
from nmpc_codegen.package.struct_layout import Precision
from verification.c_harness import SCALARS, shared_library

Array = NDArray[Any]

#: Function -> its inputs after x, u, p, dt and the Newton steps, and its outputs; numbers in terms of nx, nu, nz.
FUNCTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "value": ((), ("nx", "nx")),
    "failure": ((), ("3",)),
    "interval": ((), ("nx", "nx * nz", "nx")),
    "forced": ((), ("nx", "nx * nu")),
    "free": (("nx * nu",), ("nx", "nx * nu")),
    "forward": (("nx", "nu"), ("nx",)),
    "adjoint": (("nx",), ("nx", "nu")),
    "symmetric": (("nx",), ("nx", "nx * nz", "nx", "nz", "nz * nz")),
    "forward_over_adjoint": (("nx",), ("nx", "nx * nz", "nx", "nz", "nz * nz")),
    "integral": ((), ("1",)),
    "integral_gradient": ((), ("nz",)),
    "integral_product": (("nz",), ("nz",)),
    "node_data": ((), ("data",)),
}

#: Kernels that a problem may lack.
OPTIONAL = ("stage_rate", "stage_rate_gradient", "stage_rate_product", "stage_curvature")


class Interval:
    """The compiled interval functions belong to one problem and integrator; ``scale``: scale of the states (nx,)."""

    def __init__(
        self, problem: Problem, integrator: ImplicitRungeKutta, precision: Precision = "double", scale: Any = None
    ) -> None:
        self.problem, self.scalar = problem, SCALARS[precision]
        self.sizes = {"nx": problem.nx, "nu": problem.nu, "nz": problem.nx + problem.nu}
        self.sizes["data"] = problem.np + problem.solved
        scales = np.ones(problem.nx) if scale is None else np.asarray(scale, dtype=float)
        self.library = shared_library({"unit.c": _unit(problem, integrator, precision, scales)}, "unit.c", ("-w",))

    def __call__(
        self, function: str, x: Any, u: Any, p: Any, dt: float, *more: Any, newton: int = NEWTON_LIMIT
    ) -> list[Array]:
        """Return the results of a function; arrays that it adds to start at 0."""
        inputs, outputs = FUNCTIONS[function]
        arrays = [np.ascontiguousarray(v, dtype=self.scalar).ravel() for v in (x, u, p, [dt])]
        given = [np.ascontiguousarray(v, dtype=self.scalar).ravel() for v in more]
        assert [v.size for v in given] == [eval(n, {}, self.sizes) for n in inputs], function
        results = [np.zeros(eval(n, {}, self.sizes), self.scalar) for n in outputs]
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*arrays, *given, *results)]
        getattr(self.library, f"call_{function}")(*pointers[:4], newton, *pointers[4:])
        return results


def _unit(problem: Problem, integrator: ImplicitRungeKutta, precision: Precision, scales: Array) -> str:
    """Return sizes, tables, kernels, the part, and the exported functions as text."""
    style, kernels = unit_style(precision), StageKernels(problem)
    there = {kernel.name for kernel in kernels.all}
    nx, nu = problem.nx, problem.nu
    sizes = {name: value for name, value, _ in integrator.sizes(dimensions(problem, None, True))}
    sizes |= {"NX": nx, "NU": nu, "NZ": nx + nu, "NP": problem.np, "NALG": len(problem.newton_names)}
    lines = ["#include <math.h>", "#include <stddef.h>", "#include <string.h>"]
    lines.append(f"typedef {'double' if precision == 'double' else 'float'} real_t;")
    lines += [f"#define {name} {value}" for name, value in sizes.items()]
    lines += [f"#define HAS_{name.upper()} {int(name in there)}" for name in OPTIONAL]
    lines += [print_macro(item, {}) for item in arithmetic(precision)]
    lines += [f"#define {kernel.upper()}(...) ((void)0)" for kernel in OPTIONAL if kernel not in there]
    lines += [print_routine(kernel, style) for kernel in kernels.all]
    lines += [print_macro(item, {}) for item in (REAL_CONSTANT, *map(kernel_call, kernels.all))]
    for table in integrator.tables(complete(problem, Options())):
        ctype = "real_t" if table.ctype == "real" else "int"
        units = [*(1 / scales), *(1 / value for value in (problem.algebra.scale if problem.algebra else ()))]
        values = units * integrator.tableau.block if table.name == "state_unit" else table.values or (0,)
        lines.append(f"static const {ctype} {table.name}[] = {{ {', '.join(map(str, values))} }};")
    lines.append(f"static const real_t z_scale[] = {{ {', '.join(map(str, scales.tolist()))} }};")
    lines.append(read_part("integrators/implicit/intervals.c", lambda path: ""))
    for function, (inputs, outputs) in FUNCTIONS.items():
        more = [f"i{n}" for n in range(len(inputs))] + [f"o{n}" for n in range(len(outputs))]
        lacks = {"integral": "stage_rate", "node_data": "stage_equation"}
        if any(function.startswith(name) and kernel not in there for name, kernel in lacks.items()):
            continue
        head = ", ".join(["real_t *x, real_t *u, real_t *p, real_t *dt, int newton", *(f"real_t *{n}" for n in more)])
        arguments = ", ".join(["x, x + NX, u, p", *(() if function == "node_data" else ("dt, newton",)), *more])
        lines.append(f"void call_{function}({head}) {{ implicit_{function}({arguments}); }}")
    return "\n".join(lines) + "\n"
