"""Times, sizes and counts of nine closed loops are compared, in several forms of their C."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from examples import chain
from nmpc_codegen import Options
from nmpc_codegen.compiler import text_of
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.package.sources import Sources
from nmpc_codegen.runtime.native import native
from nmpc_codegen.targets import NATIVE
from verification import c_harness
from verification.robustness.work import Loop
from verification.scenarios import EXAMPLES, of_sample
from verification.timed import TIMED


def _loops() -> tuple[Loop, ...]:
    timed = {s.name.removeprefix("timed "): s for s in TIMED}
    examples = {e.name: e for e in EXAMPLES}

    def known(name: str) -> Loop:
        sample = timed[name]
        return Loop(name, sample.make, sample.options, of_sample(sample))

    def example(name: str) -> Loop:
        found = examples[name]
        return Loop(name, found.make, found.options, found.scenario(), found.steps)

    long = Loop("chain5_N160", lambda: chain.build_ocp(5, N=160), Options(), examples["chain5"].scenario(), 400)
    names = ("crane", "cstr", "bioreactor", "quadrotor")
    return (*map(known, names), *map(example, ("cart_pole", "chain3", "chain5", "chain7")), long)


LOOPS = _loops()


def for_target(loop: Loop, target: str) -> Loop:
    """Return the loop with its package for a target, "native" for this machine's."""
    return replace(loop, options=replace(loop.options, target=target))


@cache
def module_of(loop: Loop) -> CModule:
    """Return the package of a loop."""
    return c_harness.module_of(loop.make(), loop.options)


@cache
def package_of(loop: Loop) -> Sources:
    """Return the files of a loop's package."""
    return text_of(module_of(loop))


def without_avx512(loop: Loop) -> Loop:
    """Return the loop for this machine without AVX-512, which valgrind does not know."""
    return for_target(loop, "x86-64-v3" if native().avx512 else NATIVE)
