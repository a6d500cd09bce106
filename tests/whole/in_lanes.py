"""lane_error: linearisation of targets with lanes against that of portable C, normwise per block and node."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nmpc_codegen import Controller

#: In multiples of the rounding unit of the precision: 1e-13 in double.
LIMIT = 1e-13
ROUNDING = {"double": 2.0**-52, "single": 2.0**-23}


def errors(one: Controller, other: Controller, random: np.random.Generator) -> Iterator[tuple[str, float]]:
    """(block, largest difference over largest magnitude) after prepare() at a random plan; b relative to the states."""
    x = one.x + 1e-2 * random.uniform(-1, 1, one.x.shape) * np.maximum(1, np.abs(one.x))
    u = one.u + 1e-2 * random.uniform(-1, 1, one.u.shape) * np.maximum(1, np.abs(one.u))
    lam = random.uniform(-1, 1, one.x.shape)
    for controller in (one, other):
        controller.x[:], controller.u[:] = x, u
        if hasattr(controller, "lam"):
            controller.lam[:] = lam
        controller.prepare()
    unit = ROUNDING[_precision(one)] / ROUNDING["double"]
    theirs = dict(blocks(other))
    for name, block in blocks(one):
        size = max(np.abs(block).max(), np.abs(x).max() if name.endswith(".b") else 0.0)
        if size > 0:
            yield name, float(np.abs(block - theirs[name]).max() / size / unit)


def _precision(controller: Controller) -> str:
    return "single" if controller.x.dtype == np.float32 else "double"


def blocks(controller: Controller) -> Iterator[tuple[str, np.ndarray]]:
    """Results of the linearisation of the path nodes."""
    state = controller._struct
    names = state.dtype.names or ()
    if "node" in names:
        for member in state["node"].dtype.names or ():
            yield f"node.{member}", np.asarray(state["node"][member], dtype=float)
    if "hessian" in names and "Q" in (state["hessian"].dtype.names or ()):
        yield "hessian.Q", np.asarray(state["hessian"]["Q"], dtype=float)
