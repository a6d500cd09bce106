"""The products with the stage matrices are C functions with names, formulas, parameters, and places of their operands.

z = (dx, du), S = [A B]; Q and Q_N are lower triangles; G, W, T are panels of columns of sensitivities and adjoints.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from nmpc_codegen.ir.kernel import Port
from nmpc_codegen.ir.sweep import Frame, LoopedRoutine, Node, Place, Sweep, lift_loops
from nmpc_codegen.ir.tuning import COLUMNS
from nmpc_codegen.package.struct_layout import Size


@dataclass(frozen=True, eq=False)
class Interface:
    """The interface of a product is a C function: its name, formula, parameters, and the places of its buffers."""

    name: str
    doc: str
    parameters: tuple[str, ...]
    places: Mapping[str, Place]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    inline: bool = False
    locals: Mapping[str, Place] = field(default_factory=dict)

    def routine(self, *body: Node) -> LoopedRoutine:
        """Return the product with ``body`` as its statements."""
        frame = Frame(self.parameters, {**self.places, **self.locals}, self.inline)
        ports = {name: Port(name, math.prod(place.shape)) for name, place in self.places.items()}
        inputs, outputs = (tuple(ports[name] for name in names) for names in (self.inputs, self.outputs))
        buffers = tuple((name, math.prod(place.shape)) for name, place in self.locals.items())
        return lift_loops(Sweep(self.name, self.doc, inputs, outputs, buffers, body, frame))


class Interfaces:
    """The interfaces of all products, for given numbers of states and controls."""

    def __init__(self, nx: int, nu: int) -> None:
        self.nx, self.nu, self.nz = Size("NX", nx), Size("NU", nu), Size("NZ", nx + nu)
        self.panel = Size("COLUMNS", COLUMNS)
        self._node = {"S": Place("node->S", (self.nx, self.nz))}
        self._matrices = {"Q": Place("Q", (self.nz, self.nz)), "Q_N": Place("Q", (self.nx, self.nx))}
        self._z = {"dx": Place("dx", (self.nx,)), "du": Place("du", (self.nu,))}

    def _columns(self, name: str, text: str, rows: int) -> dict[str, Place]:
        return {name: Place(text, (rows, self.panel))}

    @property
    def state_step(self) -> Interface:
        places = self._node | self._z | {"b": Place("node->b", (self.nx,)), "y": Place("y", (self.nx,))}
        parameters = ("const node_t *node", "const real_t *dx", "const real_t *du", "real_t *y")
        return Interface("state_step", "y = b + A dx + B du", parameters, places, ("b", "S", "dx", "du"), ("y",))

    @property
    def adjoint_step(self) -> Interface:
        places = self._node | self._z | {"g": Place("node->g", (self.nz,)), "w": Place("w", (self.nz,))}
        places["Q"] = self._matrices["Q"]
        parameters = ("const node_t *node", "real_t (*Q)[NZ]", "const real_t *dx", "const real_t *du", "real_t *w")
        doc = "w <- g + Q (dx, du) + S' w, from the first NX entries of w to all NZ"
        return Interface("adjoint_step", doc, parameters, places, ("g", "Q", "dx", "du", "S", "w"), ("w",))

    @property
    def cost_gradient(self) -> Interface:
        places = self._z | {"g": Place("node->g", (self.nz,)), "y": Place("y", (self.nz,)), "Q": self._matrices["Q"]}
        parameters = ("const node_t *node", "real_t (*Q)[NZ]", "const real_t *dx", "const real_t *du", "real_t *y")
        return Interface("cost_gradient", "y = g + Q (dx, du)", parameters, places, ("g", "Q", "dx", "du"), ("y",))

    @property
    def terminal_adjoint(self) -> Interface:
        places = {"g": Place("terminal->g", (self.nx,)), "w": Place("w", (self.nx,)), "dx": self._z["dx"]}
        places["Q"] = self._matrices["Q_N"]
        parameters = ("const terminal_t *terminal", "real_t (*Q)[NX]", "const real_t *dx", "real_t *w")
        return Interface("terminal_adjoint", "w = g_N + Q_N dx", parameters, places, ("g", "Q", "dx"), ("w",))

    @property
    def forward_panel(self) -> Interface:
        places = self._node | self._columns("G", "p->G[k]", self.nx) | self._columns("G_next", "p->G[k + 1]", self.nx)
        parameters = ("columns_t *p", "const node_t *node", "int k")
        return Interface("condense_forward_panel", "G_{k+1} = A_k G_k", parameters, places, ("S", "G"), ("G_next",))

    @property
    def terminal_panel(self) -> Interface:
        places = self._columns("G", "p->G[N]", self.nx) | self._columns("W", "p->W", self.nx)
        places["Q"] = self._matrices["Q_N"]
        parameters = ("columns_t *p", "real_t (*Q)[NX]")
        return Interface("condense_terminal_panel", "W = Q_N G_N", parameters, places, ("Q", "G"), ("W",))

    @property
    def backward_panel(self) -> Interface:
        places = self._node | {"Q": self._matrices["Q"]} | self._columns("G", "p->G[k]", self.nx)
        places |= self._columns("W", "p->W", self.nx) | self._columns("T", "p->T", self.nu)
        parameters = ("columns_t *p", "const node_t *node", "real_t (*Q)[NZ]", "int k")
        doc = "T = B_k' W + S_k G_k and, in place, W = A_k' W + Q_k G_k"
        inputs, outputs = ("S", "Q", "W", "G"), ("W", "T")
        return Interface("condense_backward_panel", doc, parameters, places, inputs, outputs)
