"""CModule -> the text that build() compiles for several lanes."""

from __future__ import annotations

from dataclasses import replace

from nmpc_codegen.host.lanes import lane_functions, lane_kernels, lane_nodes, lane_switches, lane_transpose
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.render import Generators, render_c

#: Generated parts besides those of every package.
GENERATED: Generators = {
    "generated/lane_transpose.c": lane_transpose,
    "generated/lane_functions.c": lane_functions,
    "generated/lane_kernels.c": lane_kernels,
    "generated/lane_nodes.c": lane_nodes,
}


def hosted(module: CModule, lanes: int, avx512: bool, tiles: bool = True) -> CModule:
    """The package as a unit that evaluates ``lanes`` shooting nodes at once, or the next power of 2 that it has.

    Four and more lanes may also hold register ``tiles`` of the stage matrices, which a package with the goal "size"
    does not pad; their sums have another order. A host has a vector unit, whatever processor the exported C is for.
    """
    small = module.switches["SMALL"]
    lanes = min(lanes, 1 << (module.value("N").bit_length() - 1), 2 if small else lanes)
    at_hand = {"HOST_LANES": lanes, "HOST_AVX512": int(avx512), "TILES": int(tiles and lanes > 2), "SCALAR": small}
    host = replace(module, switches={**module.switches, **at_hand})
    return replace(host, switches={**host.switches, **lane_switches(host)})


def host_unit(module: CModule, lanes: int, avx512: bool, tiles: bool = True) -> str:
    """The .c of the package with ``lanes`` shooting nodes at once, in GNU C; its header is that of the package."""
    return render_c(hosted(module, lanes, avx512, tiles), GENERATED)
