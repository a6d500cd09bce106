"""Routines are printed as C, in the working precision."""

from __future__ import annotations

from functools import lru_cache

from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.ir.printing.loops import print_loops
from nmpc_codegen.ir.printing.pieces import print_straight
from nmpc_codegen.ir.printing.struct_sweeps import print_frame
from nmpc_codegen.ir.sweep import Routine


@lru_cache(maxsize=256)
def print_routine(routine: Routine, style: CStyle) -> str:
    """Return the C text of a routine."""
    if isinstance(routine, Kernel):
        return print_straight(routine, style)
    return print_frame(routine, style) if routine.sweep.frame else print_loops(routine, style)
