"""Kernels are straight-line programs lifted from CasADi SX Functions, with exact operation counts.

lift() is the only way from CasADi to C. One table gives the C spelling and the count class of every CasADi opcode; an
opcode that is not in the table raises an error that names it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import casadi as ca

from nmpc_codegen.errors import ProblemError
from nmpc_codegen.ir.casadi_types import Function, Sparsity
from nmpc_codegen.ir.lookup_calls import called_lookup, known_lookup
from nmpc_codegen.package.lookup import Lookup
from nmpc_codegen.package.opcount import OpCount as OpCount


@dataclass(frozen=True)
class Operation:
    """An operation is the C spelling ``c`` of a CasADi opcode, with operands {0} and {1}, and its count class.

    ``function`` names the function of math.h that the operation calls, if any.
    """

    c: str
    count: str
    function: str = ""
    commutative: bool = False


def _call(name: str, arity: int = 1, count: str = "call") -> Operation:
    arguments = ", ".join(f"{{{i}}}" for i in range(arity))
    return Operation(f"{{fn}}({arguments})", count, name)


OPERATIONS: dict[int, Operation] = {
    ca.OP_ADD: Operation("{0} + {1}", "add", commutative=True),
    ca.OP_SUB: Operation("{0} - {1}", "add"),
    ca.OP_MUL: Operation("{0} * {1}", "mul", commutative=True),
    ca.OP_DIV: Operation("{0} / {1}", "div"),
    ca.OP_NEG: Operation("-{0}", "other"),
    ca.OP_SQ: Operation("{0} * {0}", "mul"),
    ca.OP_TWICE: Operation("{0} + {0}", "add"),
    ca.OP_INV: Operation("{one} / {0}", "div"),
    ca.OP_SQRT: _call("sqrt", count="sqrt"),
    ca.OP_EXP: _call("exp"),
    ca.OP_EXPM1: _call("expm1"),
    ca.OP_LOG: _call("log"),
    ca.OP_LOG1P: _call("log1p"),
    ca.OP_POW: _call("pow", 2),
    ca.OP_CONSTPOW: _call("pow", 2),
    ca.OP_SIN: _call("sin"),
    ca.OP_COS: _call("cos"),
    ca.OP_TAN: _call("tan"),
    ca.OP_ASIN: _call("asin"),
    ca.OP_ACOS: _call("acos"),
    ca.OP_ATAN: _call("atan"),
    ca.OP_ATAN2: _call("atan2", 2),
    ca.OP_SINH: _call("sinh"),
    ca.OP_COSH: _call("cosh"),
    ca.OP_TANH: _call("tanh"),
    ca.OP_ASINH: _call("asinh"),
    ca.OP_ACOSH: _call("acosh"),
    ca.OP_ATANH: _call("atanh"),
    ca.OP_ERF: _call("erf"),
    ca.OP_HYPOT: _call("hypot", 2),
    ca.OP_FABS: _call("fabs", count="other"),
    ca.OP_FMIN: _call("fmin", 2, count="other"),
    ca.OP_FMAX: _call("fmax", 2, count="other"),
    ca.OP_FLOOR: _call("floor", count="other"),
    ca.OP_CEIL: _call("ceil", count="other"),
    ca.OP_FMOD: _call("fmod", 2),
    ca.OP_REMAINDER: _call("remainder", 2),
    ca.OP_COPYSIGN: _call("copysign", 2, count="other"),
    ca.OP_SIGN: Operation("({0} > {zero}) ? {one} : (({0} < {zero}) ? -{one} : {zero})", "other"),
    ca.OP_LT: Operation("({0} < {1}) ? {one} : {zero}", "other"),
    ca.OP_LE: Operation("({0} <= {1}) ? {one} : {zero}", "other"),
    ca.OP_EQ: Operation("({0} == {1}) ? {one} : {zero}", "other", commutative=True),
    ca.OP_NE: Operation("({0} != {1}) ? {one} : {zero}", "other", commutative=True),
    ca.OP_NOT: Operation("({0} == {zero}) ? {one} : {zero}", "other"),
    ca.OP_AND: Operation("(({0} != {zero}) && ({1} != {zero})) ? {one} : {zero}", "other"),
    ca.OP_OR: Operation("(({0} != {zero}) || ({1} != {zero})) ? {one} : {zero}", "other"),
    ca.OP_IF_ELSE_ZERO: Operation("({0} != {zero}) ? {1} : {zero}", "other"),
    ca.OP_CALL: Operation("{fn}({0})", "other", "lookup"),  # of the look-up table whose key is the constant
}

# Operations of one argument that are zero at zero.
_ZERO_AT_ZERO = (
    *(ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_SQRT, ca.OP_SIN, ca.OP_TAN, ca.OP_ASIN, ca.OP_ATAN),
    *(ca.OP_SINH, ca.OP_TANH, ca.OP_ASINH, ca.OP_ATANH, ca.OP_EXPM1, ca.OP_LOG1P, ca.OP_FABS, ca.OP_ERF),
)


def function_of(instruction: Instruction) -> str:
    """Return the C function that an instruction calls, of math.h or of a look-up table; "" if it calls none."""
    if instruction.opcode == ca.OP_CALL:
        return known_lookup(instruction.constant).function
    return OPERATIONS[instruction.opcode].function


_UNARY_ARITY = {op for op, o in OPERATIONS.items() if "{1}" not in o.c}
_OPCODE_NAMES = {v: k for k, v in vars(ca).items() if k.startswith("OP_")}


def opcode_name(opcode: int) -> str:
    """Return the name of a CasADi opcode, e.g. ``OP_CALL``."""
    return _OPCODE_NAMES.get(opcode, f"opcode {opcode}")


@dataclass(frozen=True)
class Port:
    """A port is a named vector or row-major matrix that a routine reads or writes; ``cols`` is 0 for a vector.

    If ``flat``, C calls pass a pointer to its first number, which may lie in a matrix. If ``whole``, it is an int
    passed by value, which no expression reads.
    """

    name: str
    rows: int
    cols: int = 0
    doc: str = ""
    flat: bool = False
    whole: bool = False

    @property
    def size(self) -> int:
        return self.rows * self.cols if self.cols else self.rows


class Instruction(NamedTuple):
    """The instruction computes value[i] = op(value[args]).

    OP_CONST has ``constant``, OP_INPUT has ``args`` = (port, element).
    """

    opcode: int
    args: tuple[int, ...]
    constant: float = 0.0


class Watched(NamedTuple):
    """A watched element of a buffer is computed by a sweep; it has a comment on its stage, and a suffix for names."""

    note: str
    buffer: str
    element: int
    mark: str


@dataclass(frozen=True)
class Part:
    """A part has values of a kernel that belong together: the comment above them, and the elements of buffers."""

    note: str
    values: frozenset[int]
    named: Mapping[int, Watched]


@dataclass(frozen=True, eq=False)
class Kernel:
    """A kernel is a straight-line C function that loads all inputs before the first store; outputs may alias inputs.

    ``stores`` lists (output port, row-major element, value index) of the structural nonzeros. Structurally zero
    elements are never written, so the memory of an output must hold zeros there. ``parts`` holds the values in printing
    order; values of a part do not depend on later parts.
    """

    name: str
    doc: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    instructions: tuple[Instruction, ...]
    stores: tuple[tuple[int, int, int], ...]
    parts: tuple[Part, ...] = ()

    @cached_property
    def count(self) -> OpCount:
        """Return the operations of one evaluation."""
        tally: dict[str, int] = {}
        for ins in self.instructions:
            if ins.opcode in OPERATIONS:
                cls = OPERATIONS[ins.opcode].count
                times = known_lookup(ins.constant).passes if ins.opcode == ca.OP_CALL else 1
                tally[cls] = tally.get(cls, 0) + times
        return OpCount(**tally)

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """Return the straight-line functions of the kernel, which is only itself."""
        return (self,)

    def is_zero(self, value: int) -> bool:
        """Return True if a value is the constant 0."""
        return self.instructions[value] == Instruction(ca.OP_CONST, ())

    def operands(self, value: int) -> tuple[int, ...]:
        """Return the values from which a value is computed."""
        ins = self.instructions[value]
        return ins.args if ins.opcode in OPERATIONS else ()

    @property
    def reads(self) -> tuple[Port, ...]:
        """Return the inputs that the kernel loads; only these are parameters of its C function."""
        used = {ins.args[0] for ins in self.instructions if ins.opcode == ca.OP_INPUT}
        return tuple(p for i, p in enumerate(self.inputs) if i in used)

    @property
    def writes(self) -> tuple[Port, ...]:
        """Return the outputs that the kernel stores; a kernel without outputs computes nothing and is not printed."""
        stored = {o for o, _, _ in self.stores}
        return tuple(p for o, p in enumerate(self.outputs) if o in stored)

    def nonzero_values(self, inputs: Sequence[Sequence[bool]]) -> list[bool]:
        """Return for every value False if it is structurally zero.

        ``inputs`` holds these flags for all input elements.
        """
        marks: list[bool] = []
        for ins in self.instructions:
            if ins.opcode == ca.OP_INPUT:
                marks.append(inputs[ins.args[0]][ins.args[1]])
            elif ins.opcode == ca.OP_CONST:
                marks.append(ins.constant != 0)
            elif ins.opcode == ca.OP_MUL:
                marks.append(all(marks[a] for a in ins.args))
            elif ins.opcode in (ca.OP_DIV, *_ZERO_AT_ZERO):
                marks.append(marks[ins.args[0]])
            else:
                marks.append(ins.opcode not in (ca.OP_ADD, ca.OP_SUB) or any(marks[a] for a in ins.args))
        return marks

    def with_zeros(self, port: str, entries: Sequence[tuple[int, int]]) -> Kernel:
        """Return this kernel with stores of zero to (row, column) ``entries`` of an output that it did not store."""
        output = next(i for i, p in enumerate(self.outputs) if p.name == port)
        written = {e for o, e, _ in self.stores if o == output}
        missing = [r * self.outputs[output].cols + c for r, c in entries]
        missing = [e for e in missing if e not in written]
        if not missing:
            return self
        zero = len(self.instructions)
        instructions = (*self.instructions, Instruction(ca.OP_CONST, ()))
        stores = (*self.stores, *((output, e, zero) for e in missing))
        return replace(self, instructions=instructions, stores=stores)


class _HasKernels(Protocol):
    """A routine is straight-line or has loops."""

    @property
    def kernels(self) -> tuple[Kernel, ...]: ...


def called_functions(routines: Iterable[_HasKernels]) -> set[str]:
    """Return the functions of math.h that routines call."""
    opcodes = {i.opcode for r in routines for kernel in r.kernels for i in kernel.instructions}
    return {OPERATIONS[o].function for o in opcodes if o in OPERATIONS and o != ca.OP_CALL} - {""}


def called_lookups(routines: Iterable[_HasKernels]) -> list[Lookup]:
    """Return the parts of look-up tables that routines read, sorted by name."""
    called = (i for r in routines for kernel in r.kernels for i in kernel.instructions if i.opcode == ca.OP_CALL)
    return sorted({known_lookup(i.constant) for i in called}, key=lambda lookup: lookup.function)


class _ValueNumbering:
    """Equal expressions get the same number; commutative operands are sorted first."""

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self._known: dict[Instruction, int] = {}

    def number(self, ins: Instruction) -> int:
        if ins.opcode in OPERATIONS and OPERATIONS[ins.opcode].commutative:
            ins = Instruction(ins.opcode, tuple(sorted(ins.args)), ins.constant)
        if ins not in self._known:
            self._known[ins] = len(self.instructions)
            self.instructions.append(ins)
        return self._known[ins]


def lift(
    function: Function,
    name: str,
    doc: str,
    inputs: Sequence[Port],
    outputs: Sequence[Port],
    watched: Sequence[Watched] = (),
) -> Kernel:
    """Lift a CasADi SX Function into a Kernel.

    The function takes one dense vector per input port and returns one vector or matrix per output port, of the port's
    rows x cols (cols = 0: a column). ``watched`` describes the elements of an additional output in the order of
    computation; that output is not stored.

    Raises:
        ProblemError: an operation has no C spelling, or a constant is not finite.
    """
    for number, port in enumerate(inputs):
        assert not port.cols, f"{name}: input {port.name} is a matrix"
        assert function.size_in(number) == (port.rows, 1), f"{name}: input {port.name}"
    numbered, stores, seen = _number_values(function, name, outputs)
    instructions, new = live(numbered, [v for _, _, v in stores])
    for ins in instructions:
        if not math.isfinite(ins.constant):
            raise ProblemError(f"{name}: the expressions contain the constant {ins.constant}; expected finite numbers")
    if any(ins.opcode in (ca.OP_DIV, ca.OP_INV) for ins in instructions):
        multiplied, after = _reciprocals(instructions)
        instructions, last = live(multiplied, [after[new[v]] for _, _, v in stores])
        new = {v: last[after[n]] for v, n in new.items() if after[n] in last}
    stored = tuple((o, e, new[v]) for o, e, v in stores)
    values = [(what, new.get(seen[e], -1)) for e, what in enumerate(watched)]
    return Kernel(name, doc, tuple(inputs), tuple(outputs), instructions, stored, _parts(instructions, values))


def _number_values(
    function: Function, name: str, outputs: Sequence[Port]
) -> tuple[list[Instruction], list[tuple[int, int, int]], dict[int, int]]:
    """Return the instructions of a function, each value once, its stores (output, element, value), and watched values.

    The latter belong to the additional output.
    """
    numbering = _ValueNumbering()
    work: dict[int, int] = {}
    stores: list[tuple[int, int, int]] = []
    seen: dict[int, int] = {}
    folds = False  # derivatives of look-up tables are 0
    patterns = [_row_major(function.sparsity_out(number), port) for number, port in enumerate(outputs)]
    for k in range(function.n_instructions()):
        opcode, o, i = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if opcode == ca.OP_OUTPUT and o[0] == len(outputs):
            seen[o[1]] = work[i[0]]
        elif opcode == ca.OP_OUTPUT:
            stores.append((o[0], patterns[o[0]][o[1]], work[i[0]]))
        elif opcode == ca.OP_INPUT:
            work[o[0]] = numbering.number(Instruction(opcode, (i[0], i[1])))
        elif opcode == ca.OP_CONST:
            constant = float(function.instruction_constant(k))
            work[o[0]] = numbering.number(Instruction(opcode, (), constant))
        elif opcode == ca.OP_CALL:
            value = _call_of_lookup([work[a] for a in i], numbering, name)
            work |= dict.fromkeys((place for place in o if place >= 0), value)
            folds = True
        elif opcode in OPERATIONS:
            args = i[:1] if opcode in _UNARY_ARITY else i[:2]
            ins = Instruction(opcode, tuple(work[a] for a in args))
            work[o[0]] = _fold(ins, numbering) if folds else numbering.number(ins)
        else:
            raise ProblemError(f"{name}: {opcode_name(opcode)} has no C code; use elementary operations only")
    return numbering.instructions, stores, seen


def _call_of_lookup(arguments: Sequence[int], numbering: _ValueNumbering, name: str) -> int:
    """Return the value of a look-up table, or 0 for a derivative of one."""
    first = numbering.instructions[arguments[0]]
    try:
        lookup = called_lookup(first.constant if first.opcode == ca.OP_CONST else None, len(arguments))
    except KeyError:
        raise ProblemError(
            f"{name}: OP_CALL has no C code: a call of an interpolant, a callback or an external function; use "
            "elementary operations, or lookup_table(x, grid, values)"
        ) from None
    if lookup is None:
        return numbering.number(Instruction(ca.OP_CONST, ()))
    return numbering.number(Instruction(ca.OP_CALL, (arguments[1],), first.constant))


def _fold(ins: Instruction, numbering: _ValueNumbering) -> int:
    """Return the value of an instruction, which needs no operation if an operand is 0."""
    zero = [numbering.instructions[a] == Instruction(ca.OP_CONST, ()) for a in ins.args]
    first, last = ins.args[0], ins.args[-1]
    if ins.opcode == ca.OP_MUL and any(zero):
        return first if zero[0] else last
    if ins.opcode in (ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE) and zero[0]:
        return first
    if ins.opcode == ca.OP_DIV and zero[0]:
        return first
    if ins.opcode == ca.OP_ADD and any(zero):
        return last if zero[0] else first
    if ins.opcode == ca.OP_SUB and any(zero):
        return first if zero[-1] else numbering.number(Instruction(ca.OP_NEG, (last,)))
    return numbering.number(ins)


def _parts(instructions: Sequence[Instruction], watched: Iterable[tuple[Watched, int]]) -> tuple[Part, ...]:
    """Return the parts of a program: a value belongs to the first watched value that needs it; a note begins a part."""
    parts: list[tuple[str, set[int], dict[int, Watched]]] = [("", set(), {})]
    known: set[int] = set()
    for what, value in watched:
        if what.note and what.note != parts[-1][0]:
            parts.append((what.note, set(), {}))
        _, values, named = parts[-1]
        waiting = [value] if value >= 0 else []
        while waiting:
            v = waiting.pop()
            if v not in known:
                known.add(v)
                values.add(v)
                waiting += instructions[v].args if instructions[v].opcode in OPERATIONS else ()
        if value in values and instructions[value].opcode in OPERATIONS:
            named.setdefault(value, what)
    return tuple(Part(note, frozenset(values), named) for note, values, named in parts if values)


def _row_major(sparsity: Sparsity, port: Port) -> list[int]:
    """Return the row-major element of every (column-major) nonzero of an output."""
    shape = (port.rows, port.cols or 1)
    assert sparsity.shape == shape or sparsity.nnz() == 0, f"output {port.name}: {sparsity.shape}, expected {shape}"
    rows, cols = sparsity.get_triplet()
    return [r * shape[1] + c for r, c in zip(rows, cols, strict=True)]


def _reciprocals(instructions: Sequence[Instruction]) -> tuple[list[Instruction], list[int]]:
    """Turn divisions whose divisor is constant or used repeatedly into multiplications by its reciprocal.

    A division takes as long as ten products; derivatives of a quotient contain several divisions by the same
    denominator. The second result is the new number of every value.
    """
    divisors: dict[int, int] = {}
    for ins in instructions:
        if ins.opcode in (ca.OP_DIV, ca.OP_INV):
            divisors[ins.args[-1]] = divisors.get(ins.args[-1], 0) + 1
    numbering = _ValueNumbering()
    new: list[int] = []
    for ins in instructions:
        args = tuple(new[a] for a in ins.args) if ins.opcode in OPERATIONS else ins.args
        if ins.opcode == ca.OP_DIV:
            divisor = numbering.instructions[args[1]]
            inverse = None
            if divisor.opcode == ca.OP_CONST and divisor.constant and math.isfinite(1 / divisor.constant):
                inverse = numbering.number(Instruction(ca.OP_CONST, (), 1 / divisor.constant))
            elif divisors[ins.args[1]] > 1:
                inverse = numbering.number(Instruction(ca.OP_INV, (args[1],)))
            if inverse is not None:
                new.append(numbering.number(Instruction(ca.OP_MUL, (args[0], inverse))))
                continue
        new.append(numbering.number(Instruction(ins.opcode, args, ins.constant)))
    return numbering.instructions, new


def live(instructions: Sequence[Instruction], results: Iterable[int]) -> tuple[tuple[Instruction, ...], dict[int, int]]:
    """Return the values that the results need, and the new number of each of them."""
    live = set(results)
    for index in range(len(instructions) - 1, -1, -1):
        if index in live and instructions[index].opcode in OPERATIONS:
            live.update(instructions[index].args)
    new: dict[int, int] = {}
    kept: list[Instruction] = []
    for index in sorted(live):
        ins = instructions[index]
        new[index] = len(kept)
        args = tuple(new[a] for a in ins.args) if ins.opcode in OPERATIONS else ins.args
        kept.append(Instruction(ins.opcode, args, ins.constant))
    return tuple(kept), new
