"""A problem is written as a program that needs no CasADi: values of its rows, and operations with restricted domains.

Values or derivatives of such operations need not be finite: sqrt, hypot, atan2, pow, log, / and more. They are
collected from all parts of the problem at once, after equal expressions have been merged, and written in the user's
names. package/program.py evaluates them at the nodes of a plan.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.problem import Problem, Stage, symbols
from nmpc_codegen.ir.casadi_types import Expression, elements
from nmpc_codegen.ir.kernel import OPERATIONS, Instruction, Kernel, Port, function_of, lift, live, opcode_name
from nmpc_codegen.ir.lookup_calls import known_lookup
from nmpc_codegen.ir.printing.nested_expressions import needs_parentheses
from nmpc_codegen.package.lookup import Lookup
from nmpc_codegen.package.program import EDGES, EdgeOperation, Program, Quantity, Step

#: Longer texts of operations are cut.
LONGEST = 100

#: Names of the general costs.
GENERAL = "general cost", "integrated cost"


def program(problem: Problem) -> Program:
    """Return rows, operations with restricted domains, their operands and the parts of the problem with them."""
    x, u, p, dt = symbols(problem.nx, problem.nu, problem.np + problem.solved)
    rows = list(_general_rows(problem, x, u, p))
    parts = [*_parts(problem, x, u, p, dt), *((quantity, value) for quantity, value, _ in rows)]
    function = ca.Function("parts", [x, u, p, dt], [ca.densify(ca.vertcat(*(e for _, e in parts)))])
    ports = [Port("x", problem.nx), Port("u", problem.nu), Port("p", problem.np + problem.solved), Port("dt", 1)]
    kernel = lift(function, "parts", "", ports, [Port("value", len(parts))])
    suspects = [i for i, ins in enumerate(kernel.instructions) if _name(ins) in EDGES]
    value_of = {element: value for _, element, value in kernel.stores}
    of_rows = [value_of[len(parts) - len(rows) + i] for i in range(len(rows))]
    of_cost, weight = _costs(problem, value_of), problem.path.weight
    wanted = [*of_rows, *(value for _, value in of_cost), *(a for i in suspects for a in kernel.instructions[i].args)]
    kept, new = live(kernel.instructions, wanted)
    places = {place: new[value] for (_, _, place), value in zip(rows, of_rows, strict=True)}
    numbers = range(len(problem.rows))
    lookups = sorted({known_lookup(ins.constant) for ins in kept if ins.opcode == ca.OP_CALL}, key=lambda t: t.function)
    return Program(
        tuple(_step(ins, problem.dt[0], lookups) for ins in kept),
        tuple((places.get((i, 0), -1), places.get((i, 1), -1)) for i in numbers),
        tuple(_operations(kernel, problem, [quantity for quantity, _ in parts], suspects, new)),
        tuple(lookups),
        tuple(new[value] for name, value in of_cost if name not in GENERAL),
        tuple(problem.path.scale_with_dt),
        (_find_step(GENERAL[0], of_cost, new), _find_step(GENERAL[1], of_cost, new)),
        tuple(float(w) for w in (np.diag(weight) if problem.path.diagonal_weight else weight.ravel())),
        tuple(_resets(problem)),
    )


def _costs(problem: Problem, value_of: Mapping[int, int]) -> list[tuple[str, int]]:
    """Return names and values of the residuals and general costs of the path."""
    first = problem.nx + len(problem.maps) + len(list(_of_stage(problem.start)))
    return [(name, value_of[first + i]) for i, (name, _) in enumerate(_of_stage(problem.path))]


def _resets(problem: Problem) -> Iterator[int]:
    """Yield the numbers of the rows that contain accumulators."""
    known = ca.vertcat(*(problem.path.x[i] for i in problem.accumulators))
    for number, row in enumerate(problem.rows):
        if row.kind == "state" and row.index in problem.accumulators:
            yield number
        if row.is_general and row.index >= 0 and known.numel() and ca.depends_on(problem.path.h[row.index], known):
            yield number


def _find_step(name: str, values: Sequence[tuple[str, int]], new: Mapping[int, int]) -> int:
    """Return the step of the value with this name, -1 if there is none."""
    return next((new[value] for found, value in values if found == name), -1)


def _operations(
    kernel: Kernel, problem: Problem, quantities: Sequence[Quantity], suspects: Sequence[int], new: Mapping[int, int]
) -> Iterator[EdgeOperation]:
    texts, moved = _texts(kernel, problem), _find_moving(kernel)
    occurs = _occurrences(kernel, quantities, suspects)
    for i in suspects:
        a, b = kernel.instructions[i].args[0], kernel.instructions[i].args[-1]
        name = _name(kernel.instructions[i])
        yield EdgeOperation(name, texts[i], (texts[a], texts[b]), (new[a], new[b]), (moved[a], moved[b]), occurs[i])


def _parts(
    problem: Problem, x: Expression, u: Expression, p: Expression, dt: Expression
) -> Iterator[tuple[Quantity, Expression]]:
    """Yield dynamics, residuals and general costs, with their names and nodes."""
    last, kind = problem.N - 1, "map" if problem.discrete else "equation"
    for name, value in zip(problem.state_names, elements(ca.densify(problem.dynamics(x, u, p))), strict=True):
        yield Quantity(f"the {kind} of {name}", 0, last), value
    maps = [] if problem.jump is None else elements(ca.densify(problem.jump(x, u, p, dt)))
    for i, value in zip(problem.maps, maps, strict=True):
        yield Quantity(f"the map of {problem.state_names[i]}", 0, last), value
    for stage, words, first, end in (
        (problem.start, "start ", 0, 0),
        (problem.path, "", 0, last),
        (problem.terminal, "terminal ", problem.N, problem.N),
    ):
        for name, expression in _of_stage(stage):
            yield Quantity(f"the {words}{name}", first, end), _substitute(expression, stage, x, u, p, dt)


def _substitute(
    expression: Expression, stage: Stage, x: Expression, u: Expression, p: Expression, dt: Expression
) -> Expression:
    """Write an expression of a stage in these symbols."""
    given = ca.vertcat(x, u if stage.nu else ca.SX(0, 1), p, dt)
    return ca.substitute(expression, ca.vertcat(stage.x, stage.u, stage.p, stage.dt), given)


def _general_rows(
    problem: Problem, x: Expression, u: Expression, p: Expression
) -> Iterator[tuple[Quantity, Expression, tuple[int, int]]]:
    """Yield general rows, with their names, nodes and places: (index in rows, 1 at the end of the horizon)."""
    for number, row in enumerate(problem.rows):
        if not row.is_general:
            continue
        path = [k for k in row.nodes if k < problem.N]
        ends = (path[0], path[-1]) if path else (0, -1)
        for end, stage, index, (first, last) in (
            (0, problem.path, row.index, ends),
            (1, problem.terminal, row.index_terminal, (problem.N, problem.N)),
        ):
            if index >= 0:
                value = _substitute(stage.h[index], stage, x, u, p, stage.dt)
                squares = row.soft is None and row.lower <= 0 < row.upper
                yield Quantity(f"row '{row.name}'", first, last, squares), value, (number, end)


def _of_stage(stage: Stage) -> Iterator[tuple[str, Expression]]:
    for name, residual in zip(stage.y_names, elements(stage.y), strict=True):
        yield f"residual '{name}'", residual
    if stage.cost is not None:
        yield GENERAL[0], stage.cost
    if stage.cost_rate is not None:
        yield GENERAL[1], stage.cost_rate


def _name(ins: Instruction) -> str:
    return opcode_name(ins.opcode).removeprefix("OP_").lower()


def _find_moving(kernel: Kernel) -> list[bool]:
    """Return for every value True if it depends on states or controls."""
    marks: list[bool] = []
    for ins in kernel.instructions:
        marks.append(ins.args[0] < 2 if ins.opcode == ca.OP_INPUT else any(marks[a] for a in ins.args))
    return marks


def _occurrences(
    kernel: Kernel, quantities: Sequence[Quantity], suspects: Sequence[int]
) -> dict[int, tuple[Quantity, ...]]:
    """Return for every operation the parts whose value depends on it."""
    users: list[int] = [0] * len(kernel.instructions)  # bit j: part j
    for _, element, value in kernel.stores:
        users[value] |= 1 << element
    for i in range(len(users) - 1, -1, -1):
        if kernel.instructions[i].opcode in OPERATIONS:
            for a in kernel.instructions[i].args:
                users[a] |= users[i]
    return {i: tuple(q for j, q in enumerate(quantities) if users[i] >> j & 1) for i in suspects}


#: Operations that a user spells differently from C.
_WRITTEN = {ca.OP_SQ: "{0}**2", ca.OP_TWICE: "2 * {0}"}


def _texts(kernel: Kernel, problem: Problem) -> list[str]:
    """Return every value as a text in the user's names; long texts are cut."""
    slopes = tuple(f"d({name})" for name in problem.newton_names for _ in problem.newton_names)
    data = (*problem.parameter_names, *problem.newton_names, *slopes)
    names = (problem.state_names, problem.control_names, data, ("dt",))
    texts: list[str] = []
    for ins in kernel.instructions:
        if ins.opcode == ca.OP_INPUT:
            texts.append(names[ins.args[0]][ins.args[1]])
        elif ins.opcode == ca.OP_CONST:
            texts.append(f"{ins.constant:.6g}")
        else:
            operation, operands = OPERATIONS[ins.opcode], [texts[a] for a in ins.args]
            for n, a in enumerate(ins.args):
                inner = kernel.instructions[a].opcode
                if not operation.function and needs_parentheses(ins.opcode, n, inner, texts[a]):
                    operands[n] = f"({texts[a]})"
            form = _WRITTEN.get(ins.opcode, operation.c)
            text = form.format(*operands, fn=function_of(ins), one="1", zero="0")
            cut = f"{operation.function}(...)" if operation.function else "..."
            texts.append(text if len(text) <= LONGEST else cut)
    return texts


def _step(ins: Instruction, dt: float, lookups: Sequence[Lookup]) -> Step:
    """Return an instruction as a step, in an interval of length ``dt``."""
    if ins.opcode == ca.OP_CALL:
        return ("lookup", ins.args[0], ins.args[0], float(lookups.index(known_lookup(ins.constant))))
    if ins.opcode == ca.OP_CONST:
        return ("const", 0, 0, float(ins.constant))
    if ins.opcode == ca.OP_INPUT:
        return ("const", 0, 0, dt) if ins.args[0] == 3 else ("input", ins.args[0], ins.args[1], 0.0)
    return (_name(ins), ins.args[0], ins.args[-1], 0.0)
