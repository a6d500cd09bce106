"""Linearisation of several shooting nodes at once, one node per lane of GNU C vectors.

The kernels of a package are printed a second time with vectors in the place of numbers. Their inputs are gathered from
the nodes; their results are transposed, so that every node receives whole rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.ir.kernel import OPERATIONS, Kernel, Port, called_functions, called_lookups
from nmpc_codegen.ir.printing.c_style import CStyle, spell
from nmpc_codegen.ir.printing.routines import print_routine
from nmpc_codegen.ir.sweep import LoopedRoutine, Routine
from nmpc_codegen.lowering.lanes import lane_steps
from nmpc_codegen.lowering.unit.macros import PLACES
from nmpc_codegen.lowering.unit.reach import reach
from nmpc_codegen.lowering.unit.read import MATH_IN_LANES, items_of, own_names, read_part
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.signals import Kind

SUFFIX = "_lanes"

#: The function that reduces any angle.
REDUCTION = "lanes_reduce"

#: Functions of math.h that call it, and those that take square roots, in lanes.
ANGLES = frozenset({"sin", "cos", "tan"})
ROOTS = frozenset({"sqrt", "acos", "acosh", "asin", "asinh", "hypot"})

#: Fewer stored elements of a row of VECTOR_LANES ones are stored one by one.
LEAST_IN_BLOCK = 3

#: Output port -> member of a node that receives it.
MEMBERS = {"x_next": "b", "S": "S", "g": "g", "h": "h", "J": "J"}

#: Input port -> the option that decides whether every node has data of its own.
OPTIONS: Mapping[str, Kind] = {"p": "parameter", "yref": "reference", "W": "weight"}


@dataclass(frozen=True)
class LaneRoutines:
    """The routines that linearise a path node. ``one_step`` replaces the loops of the interval, if it has any.

    ``jump``: what follows its last step. ``shift``: the integration step with which the plan is resampled, if it is.
    """

    routines: tuple[Routine, ...]
    one_step: Kernel | None = None
    shift: Routine | None = None
    jump: Kernel | None = None

    @property
    def of_nodes(self) -> tuple[Routine, ...]:
        """Those of a node that are printed in lanes."""
        return (*(r for r in (self.one_step, self.jump) if r is not None), *self.called)

    @property
    def printed(self) -> tuple[Routine, ...]:
        """All that are printed in lanes."""
        return (*self.of_nodes, *(() if self.shift is None else (self.shift,)))

    @property
    def called(self) -> tuple[Routine, ...]:
        """Those that are called once."""
        return self.routines if self.one_step is None else self.routines[1:]


def lane_routines(module: CModule) -> LaneRoutines | None:
    """None if nodes are linearised one by one.

    That is for one lane, for an interval with stages that are solved or loops that cannot be expanded, for a Hessian
    that does not promise (NODE_KERNELS) that expand_node() is no more than its printed kernels.
    """
    if module.sizes["VECTOR_LANES"] == 1 or module.features.node_memory or not module.features.node_kernels:
        return None
    first = ("path_exact",) if module.features.lagrangian else ("integrator_interval", "path_gradient")
    known = {r.name: r for r in module.routines}
    routines = tuple(known[name] for name in (*first, "path_rows") if name in known)
    if any(isinstance(r, LoopedRoutine) and r.calls_parts for r in routines):
        return None
    shift = known.get("integrator_step") if module.features.shift_resample else None
    if routines[0].name != "integrator_interval" or isinstance(routines[0], Kernel):
        return LaneRoutines(routines, shift=shift)
    return None if module.one_step is None else LaneRoutines(routines, module.one_step, shift, module.jump_rows)


def has_conditions(routines: Iterable[Routine]) -> bool:
    """Whether the kernels of the routines compare or choose."""
    return any(i.opcode in CStyle.CONDITIONS for r in routines for kernel in r.kernels for i in kernel.instructions)


def in_lanes(names: Iterable[str], sizes: Mapping[str, int], style: CStyle) -> str:
    """Return the functions of math.h with these names, and everything that they call, on vectors."""
    items = items_of(spell(read_part(MATH_IN_LANES, sizes=sizes), style.on_vectors))
    roots = [n for n, item in enumerate(items) if item.name.removeprefix("lanes_") in names]
    found = reach(items, roots)
    if any(REDUCTION in item.calls for item in found.values()):  # whose part calls the function for moderate angles
        found |= reach(items, [n for n, item in enumerate(items) if item.name == f"{REDUCTION}_moderate"])
    return "\n\n".join(found[n].text for n in sorted(found))


def with_lanes(module: CModule) -> CModule:
    """Return the module with the number of lanes of its target, its register tiles, and the features that follow.

    A lane holds one shooting node. There are at most as many lanes as intervals, rounded down to a power of two; with
    goal="size" there is one. Tiles change the order of sums, so that a package with math="own" has none.
    """
    target, features = module.target, module.features
    lanes = 1 if features.small else min(target.lanes, 1 << (module.value("N").bit_length() - 1))
    tiles = 0 if features.small or features.own_math else target.tiles
    module = replace(module, features=replace(features, vector_lanes=lanes, pack_width=tiles, tiles=tiles > 0))
    return replace(module, features=_lane_features(module))


def _lane_features(module: CModule) -> Features:
    """Whether nodes are linearised in lanes, and which parts that needs."""
    found = lane_routines(module)
    if found is None:
        return module.features
    called = called_functions(found.printed)
    return replace(
        module.features,
        lane_nodes=True,
        lane_shift=found.shift is not None,
        lane_conditions=has_conditions(found.printed),
        lane_angles=bool(called & ANGLES),
        lane_sqrt=bool(called & ROOTS),
    )


def lane_functions(module: CModule) -> str:
    """Return the elementary functions that the kernels call."""
    found = lane_routines(module)
    return "" if found is None else in_lanes(called_functions(found.printed), module.sizes, module.style)


def lane_kernels(module: CModule) -> str:
    """Functions of math.h lane by lane, and the kernels in lanes."""
    style, found = module.style, lane_routines(module)
    if found is None:
        return ""
    arity = {o.function: 2 if "{1}" in o.c else 1 for o in OPERATIONS.values() if o.function}
    others = sorted(called_functions(found.printed) - own_names(MATH_IN_LANES) - {"sqrt"})
    texts = [_one_by_one(name, arity[name], style) for name in others]
    texts += [_one_by_one(lookup.function, 1, style) for lookup in called_lookups(found.printed)]
    texts += [print_routine(_rename_routine(r), style.on_vectors) for r in found.printed]
    if found.one_step is not None:
        texts.append(lane_steps.product(found.one_step))
    return "\n\n".join(texts)


def lane_nodes(module: CModule) -> str:
    """linearize_group(s, k): the nodes k .. k + VECTOR_LANES - 1.

    Results are collected in the order of the members of a node, so that blocks of several members are stored at once.
    """
    found = lane_routines(module)
    if found is None:
        return ""
    inputs = {p.name: p for r in found.of_nodes for p in r.reads}
    offsets, total = _node_layout(module)
    width = module.features.vector_lanes
    written = [(r, p) for r in found.routines for p in r.writes]
    stored = {offsets[p.name] + e for r, p in written if p.name in offsets for e in _stored_elements(r, p)}
    places = {p.name: lane_steps.offset("node", offsets[p.name]) for _, p in written if p.name in offsets}
    zeros, stores = _scatter("node", stored, total, width, "&s->node[k]", "NODE_STRIDE")
    declared = [*(f"{p.name}[{p.size}]" for p in inputs.values()), f"node[{total}]"]
    for r, p in ((r, p) for r, p in written if p.name not in offsets):
        declared.append(f"{p.name}[{p.size}]")
        more = _scatter(p.name, _stored_elements(r, p), p.size, width, "&s->hessian.Q[k][0][0]", str(p.size))
        zeros, stores = [*zeros, *more[0]], [*stores, *more[1]]
    calls: list[str] = []
    if found.one_step is not None:
        arrays, calls = lane_steps.calls(found.one_step, SUFFIX, places["x_next"], places["S"])
        declared += arrays
    calls += [
        f"{r.name}{SUFFIX}({', '.join(passed_lanes(p, places.get(p.name, p.name)) for p in (*r.reads, *r.writes))});"
        for r in (*(() if found.jump is None else (found.jump,)), *found.called)
    ]
    lines = [line for port in inputs.values() for line in _gather(port, module)]
    lines = [*(_MULTIPLIERS if "mu" in inputs else ()), *lines]
    lines = [f"lanes_t {', '.join(declared)};", *lines, *zeros, *calls, *stores]
    if zeros:
        lines.insert(0, "const lanes_t zero = {0};")
    held = ", ".join(f"{MEMBERS[name]} at {offset}" for name, offset in offsets.items())
    head = (
        "/* Linearises the nodes k .. k + VECTOR_LANES - 1; x_{k+1} is not yet subtracted from the gaps. node: the\n"
        f" * numbers of a node_t in the order of its members: {held}. */"
    )
    return "\n".join([head, "static void linearize_group(solver_t *s, int k)", "{", *(f"    {n}" for n in lines), "}"])


def lane_shift(module: CModule) -> str:
    """integrate_lanes(s, k, n, last): the nodes k .. k + VECTOR_LANES - 1 of the resampled plan."""
    found = lane_routines(module)
    if found is None or found.shift is None:
        return ""
    inputs = {p.name: p for p in found.shift.reads}
    places = {"x": "from", "u": "s->u[n]", "p": "PARAM(s, n)"}
    gathers = []
    for name, place in places.items():
        if name in inputs:
            whole = name == "p" and module.layouts["parameter"] != "node"
            value = f"{place}[i]"
            gathers += [
                f"        for (int i = 0; i < {inputs[name].size}; i++) {{",
                f"            {name}[i]{'' if whole else '[l]'} = {f'lanes_all({value})' if whole else value};",
                "        }",
            ]
    arguments = ", ".join(p.name for p in (*found.shift.reads, *found.shift.writes))
    declared = ", ".join(f"{name}[{port.size}]" for name, port in inputs.items())
    lines = [
        "/* The nodes k .. k + VECTOR_LANES - 1 of the resampled plan. Lanes behind the last node repeat it; a lane",
        " * keeps the state after its last step. n: the interval of node k or an earlier one. Returns the last one. */",
        "static int integrate_lanes(solver_t *s, int k, int n, const real_t *last)",
        "{",
        f"    lanes_t {declared}, x_next[NX];",
        "    int steps[VECTOR_LANES], most = 0;",
        "    for (int l = 0; l < VECTOR_LANES; l++) {",
        "        const real_t t = node_time[(k + l < N) ? k + l : N] + sampling_time[0];",
        "        n = interval_at(t, n);",
        "        const real_t *from = (n < N - 1) ? s->x[n] : last;",
        "        steps[l] = plan_steps(t - node_time[n]);",
        "        h[0][l] = (t - node_time[n]) / (real_t)steps[l];",
        "        most = (steps[l] > most) ? steps[l] : most;",
        *gathers,
        "    }",
        "    for (int step = 0; step < most; step++) { /* at most PLAN_STEPS passes */",
        "        mask_t steps_on;",
        "        for (int l = 0; l < VECTOR_LANES; l++) {",
        "            steps_on[l] = (step < steps[l]) ? -1 : 0;",
        "        }",
        f"        {found.shift.name}{SUFFIX}({arguments});",
        "        for (int i = 0; i < NX; i++) {",
        "            x[i] = lanes_select(steps_on, x_next[i], x[i]);",
        "        }",
        "    }",
        "    for (int l = 0; l < VECTOR_LANES && k + l <= N; l++) {",
        "        for (int i = 0; i < NX; i++) {",
        "            s->x[k + l][i] = x[i][l];",
        "        }",
        "    }",
        "    return n;",
        "}",
    ]
    return "\n".join(lines)


def lane_transpose(module: CModule) -> str:
    """Transposition of a block."""
    return transpose(module.features.vector_lanes)


def transpose(width: int) -> str:
    """lanes_store_block(v, to, stride): VECTOR_LANES elements of every lane to the rows to, to + stride, ...

    The first round makes pairs, which stay where registers of 128 bits end; every other one merges vectors, of each its
    even or its odd pairs. That rotates the bits of the index of the vector and of the pair.
    """
    pairs = [(f"{2 * i}, {2 * i + width}", f"{2 * i + 1}, {2 * i + 1 + width}") for i in range(width // 2)]
    first = tuple(", ".join(pair[odd] for pair in pairs) for odd in (0, 1))
    chunks = [[f"{2 * i}, {2 * i + 1}" for i in range(odd, width, 2)] for odd in (0, 1)]
    merged = tuple(", ".join(half) for half in chunks)
    lines = [
        "/* Stores VECTOR_LANES elements of every lane to the rows to, to + stride, ...: a transposition. */",
        "LANES_INLINE void lanes_store_block(const lanes_t *v, real_t *to, int stride)",
        "{",
    ]
    before = [f"v[{i}]" for i in range(width)]
    for n in range(width.bit_length() - 1):
        after = [f"{'abcd'[n]}{i}" for i in range(width)]
        for i in range(width // 2):
            pair = f"{before[2 * i]}, {before[2 * i + 1]}"
            for odd, chosen in enumerate(merged if n else first):
                name = after[i + odd * width // 2]
                lines.append(f"    const lanes_t {name} = __builtin_shufflevector({pair}, {chosen});")
        before = after
    for lane, row in enumerate(before):
        lines.append(f"    (void)memcpy(to{f' + {lane} * stride' if lane else ''}, &{row}, sizeof {row});")
    return "\n".join([*lines, "}"])


#: Path of an include -> its text.
GENERATED: Mapping[str, Callable[[CModule], str]] = {
    "generated/lane_transpose.c": lane_transpose,
    "generated/lane_functions.c": lane_functions,
    "generated/lane_kernels.c": lane_kernels,
    "generated/lane_nodes.c": lane_nodes,
    "generated/lane_shift.c": lane_shift,
}


def passed_lanes(port: Port, place: str) -> str:
    """Return the argument for a port whose elements are contiguous."""
    return f"(lanes_t(*)[{port.cols}])({place})" if port.cols else place


def _node_layout(module: CModule) -> tuple[dict[str, int], int]:
    """Where a node stores every output port, and the numbers of a node."""
    (struct,) = (s for s in module.structs if s.name == "node")
    offsets: dict[str, int] = {}
    total = 0
    for member in struct.fields:
        offsets |= {port: total for port, name in MEMBERS.items() if name == member.name}
        total += math.prod(member.padded)
    return offsets, total


#: The multipliers of the general rows of all nodes of a group.
_MULTIPLIERS = (
    "real_t rows[VECTOR_LANES][NH];",
    "for (int l = 0; l < VECTOR_LANES; l++) {",
    "    path_multipliers(s, k + l, rows[l]);",
    "}",
)


def _gather(port: Port, module: CModule) -> Iterator[str]:
    place = "rows[0]" if port.name == "mu" else PLACES[port.name]
    option = OPTIONS.get(port.name)
    stride = 1 if port.name == "dt" else port.size
    yield f"for (int i = 0; i < {port.size}; i++) {{"
    if option is not None and module.layouts[option] != "node":
        yield f"    {port.name}[i] = lanes_all(({place})[i]);"
    else:
        yield f"    {port.name}[i] = lanes_gather(({place}) + i, {stride});"
    yield "}"


def _scatter(
    name: str, stored: set[int], size: int, width: int, target: str, stride: str
) -> tuple[list[str], list[str]]:
    """Statements that set zeros in the blocks of an array, and those that store its elements to the nodes."""
    zeros: dict[str, None] = {}
    stores: list[str] = []
    element = 0
    while element < size:
        first = min(element, size - width)
        block = range(first, first + width)
        if first >= 0 and sum(e in stored for e in block if e >= element) >= LEAST_IN_BLOCK:
            zeros |= {f"{name}[{e}] = zero;": None for e in block if e not in stored}
            place, row = lane_steps.offset(name, first), lane_steps.offset(f"(real_t *){target}", first)
            stores.append(f"lanes_store_block({place}, {row}, {stride});")
            element = first + width
        else:
            if element in stored:
                row = lane_steps.offset(f"(real_t *){target}", element)
                stores.append(f"lanes_store({name}[{element}], {row}, {stride});")
            element += 1
    return list(zeros), stores


def _stored_elements(routine: Routine, port: Port) -> set[int]:
    """Elements of an output port that the routine stores; loops store all."""
    if isinstance(routine, LoopedRoutine):
        return set(range(port.size))
    index = routine.outputs.index(port)
    return {e for o, e, _ in routine.stores if o == index}


def _rename_routine(routine: Routine) -> Routine:
    """Return the routine, and the leaves of its loops, with a suffix to their names."""
    if isinstance(routine, Kernel):
        return replace(routine, name=routine.name + SUFFIX)
    leaves = {name: replace(kernel, name=kernel.name + SUFFIX) for name, kernel in routine.leaves.items()}
    return LoopedRoutine(replace(routine.sweep, name=routine.sweep.name + SUFFIX), leaves)


def _one_by_one(name: str, arity: int, style: CStyle) -> str:
    """Return a function that calls one of math.h for every lane."""
    operands = ("x", "y")[:arity]
    declared = ", ".join(f"lanes_t {o}" for o in operands)
    passed = ", ".join(f"{o}[l]" for o in operands)
    return "\n".join(
        [
            f"LANES_INLINE lanes_t lanes_{name}({declared})",
            "{",
            "    lanes_t value;",
            "    for (int l = 0; l < VECTOR_LANES; l++) {",
            f"        value[l] = {style.function(name)}({passed});",
            "    }",
            "    return value;",
            "}",
        ]
    )
