"""Constants in the kernels of a package may have the user's names, except those that its unit uses."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from functools import cache

from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.kernel import OPERATIONS
from nmpc_codegen.ir.naming import C_KEYWORDS
from nmpc_codegen.ir.printing.constant_names import LocalNames
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.lowering.unit.macros import arithmetic
from nmpc_codegen.lowering.unit.read import defined_names
from nmpc_codegen.package.signals import c_identifier
from nmpc_codegen.package.status import Status

#: Macros of the compilers, the C library and the preamble that could be names of signals.
_MACROS = """
    NAN INFINITY HUGE HUGE_VAL HUGE_VALF MATH_ERRNO MATH_ERREXCEPT FP_NAN FP_INFINITE FP_ZERO FP_SUBNORMAL FP_NORMAL
    DOMAIN SING OVERFLOW UNDERFLOW PLOSS TLOSS EOF NULL offsetof isnan isinf isfinite isnormal signbit fpclassify
    linux unix i386 arm mips sparc sun PPC ALL API R YREF YREF_N WEIGHT WEIGHT_N PARAM PARAM_N PATH_LOWER PATH_UPPER
    HESSIAN VECTOR_LANES PACK_WIDTH MAGIC s k n"""
_MATH_CONSTANT = re.compile(r"M_[A-Z0-9_]+|FP_\w+|\w*_t")


def local_names(problem: Problem, others: Iterable[str]) -> LocalNames:
    """Return the names of a problem; ``others`` holds macros, kernels and tables of its package."""
    taken = _reserved_names().union(others)

    def free(names: Iterable[str]) -> tuple[str, ...]:
        spelled = (c_identifier(name) for name in names)
        return tuple(f"{name}_" if name in taken or _MATH_CONSTANT.fullmatch(name) else name for name in spelled)

    own = problem.state_names[: problem.measured]
    known = {
        c_identifier(name) for name in (*own, *problem.newton_names, *problem.control_names, *problem.parameter_names)
    }
    return LocalNames(
        free((*own, *_inner_names(problem, known))),
        free(problem.control_names),
        free(_names_of_parameters(name) for name in problem.parameter_names),
        free(problem.path.y_names),
        free(problem.terminal.y_names),
        taken,
        free(name.replace("(", "_").replace(")", "") for name in problem.newton_names),
    )


def _names_of_parameters(name: str) -> str:
    """Return names of added parameters: begins_F, interval_before."""
    return name.replace("block start(", "begins_").removesuffix(")").replace(" ", "_")


def _inner_names(problem: Problem, known: Collection[str]) -> Iterator[str]:
    """Yield names of added states: F_before, time."""
    for name in problem.state_names[problem.measured :]:
        inner = name.removeprefix("previous(").removesuffix(")")
        spelled = c_identifier(name if inner == name else f"{inner}_before")
        while spelled in known:
            spelled += "_"
        yield spelled


@cache
def _reserved_names() -> frozenset[str]:
    """Return keywords, names of the C library, and names that the parts define."""
    functions = {operation.function for operation in OPERATIONS.values()} - {""}
    macros = {macro.name for macro in arithmetic("double")} | {status.name for status in Status}
    parts = {name for path in template_directory().rglob("*.c*") for name in defined_names(path.read_text("utf-8"))}
    return C_KEYWORDS | set(_MACROS.split()) | functions | {f"{name}f" for name in functions} | macros | parts
