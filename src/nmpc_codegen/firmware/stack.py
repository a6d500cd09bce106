"""The worst-case stack of every entry point follows from the deepest chain of calls.

    depth(f) = frame(f) + max over callees g of depth(g)

Frames and calls of the package are those that gcc states (-fcallgraph-info=su). It states none for functions of the C
library and of libgcc; their frames are read from the linked program. Such a frame is the sum of all decrements of the
stack pointer in the function, an upper bound, since no decrement is inside a loop. A frame of variable size, a call
through a pointer, and recursion are errors.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from nmpc_codegen.errors import BuildError
from nmpc_codegen.firmware.machine_code import MachineCode

_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(?:(\d+) bytes \(([a-z, ]+)\))?" ?(?:shape : \w+ )?\}')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')

_FUNCTION = re.compile(r"^([0-9a-f]+) <([^>]+)>:$")
_INSTRUCTION = re.compile(r"^\s*([0-9a-f]+):\t([\w.]+)(?:\t(.*))?$")


@dataclass
class StackFunction:
    """A function has a frame in bytes, and the names of the functions that it calls."""

    frame: int = 0
    calls: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class Depth:
    """The depth of an entry point is its stack in bytes, with the chain of calls that needs it."""

    bytes: int
    chain: tuple[str, ...]


def of_package(graph: str) -> dict[str, StackFunction]:
    """Return the functions of gcc's call graph; functions of other units have no frame and are left out.

    Raises:
        BuildError: a frame has a variable size, or a function is called through a pointer.
    """
    functions: dict[str, StackFunction] = {}
    for title, size, kind in _NODE.findall(graph):
        if title == "__indirect_call":
            raise BuildError("a function is called through a pointer: its stack is unknown")
        if not size:
            continue
        if kind not in ("static", "dynamic,bounded"):
            raise BuildError(f"the frame of {title} has a variable size: its stack is unknown")
        functions[title] = StackFunction(int(size))
    for source, callee in _EDGE.findall(graph):
        functions[source].calls.add(callee)
    return functions


def of_program(disassembly: str, read: MachineCode) -> dict[str, StackFunction]:
    """Return the functions of a linked program, from ``objdump -d --no-show-raw-insn``."""
    functions: dict[str, StackFunction] = {}
    name, last = "", ("", "")
    for line in disassembly.splitlines():
        if begin := _FUNCTION.match(line):
            if last[0] and name and not read.ends(*last):
                functions[name].calls.add(begin[2])
            name, last = begin[2], ("", "")
            functions[name] = StackFunction()
        elif name and (found := _INSTRUCTION.match(line)):
            operation, operands = found[2], read.operands(found[3] or "")
            if operation.startswith((".", "nop")):  # constants, and padding before them
                continue
            last = operation, operands
            functions[name].frame += read.decrement(operation, operands, name)
            callee = read.callee(operation, operands, name)
            if callee not in (None, name):
                functions[name].calls.add(str(callee))
    return functions


def with_aliases(functions: Mapping[str, StackFunction], symbols: str) -> dict[str, StackFunction]:
    """Return the functions under all their names, from ``nm``; the disassembly shows one name per address."""
    found = dict(functions)
    for group in _names_of_addresses(symbols):
        shown = next((name for name in group if name in functions), None)
        found |= {name: functions[shown] for name in group if shown is not None and name not in functions}
    return found


def with_folded_names(functions: Mapping[str, StackFunction], symbols: str, unit: str) -> dict[str, StackFunction]:
    """Return the functions of a package with the names of equal functions that the compiler has merged.

    gcc's graph contains calls of a merged function, but no node for it; in the linked program both names have one
    address.
    """
    found = dict(functions)
    for group in _names_of_addresses(symbols):
        titles = [title for name in group for title in (name, f"{unit}:{name}")]
        shown = next((title for title in titles if title in functions), None)
        found |= {title: functions[shown] for title in titles if shown is not None and title not in functions}
    return found


def _names_of_addresses(symbols: str) -> list[list[str]]:
    """Return lists of the functions that have the same address, from ``nm``."""
    names: dict[int, list[str]] = {}
    for line in symbols.splitlines():
        address, kind, name = line.split()[-3:] if len(line.split()) == 3 else ("", "", "")
        if kind in ("T", "t", "W", "w"):
            names.setdefault(int(address, 16) & ~1, []).append(name)
    return list(names.values())


def depths(functions: Mapping[str, StackFunction], roots: Mapping[str, str]) -> dict[str, Depth]:
    """Return the depth of every root; ``roots`` maps a label to the name of a function.

    Raises:
        BuildError: a function calls itself, or its frame is unknown.
    """
    known: dict[str, Depth] = {}

    def depth(name: str, path: tuple[str, ...]) -> Depth:
        if name in path:
            raise BuildError(f"recursion: {' -> '.join((*path[path.index(name) :], name))}")
        if name not in known:
            if name not in functions:
                raise BuildError(f"the stack of {name} is unknown: it is not in the linked program")
            below = [depth(callee, (*path, name)) for callee in sorted(functions[name].calls)]
            deepest = max(below, key=lambda d: d.bytes, default=Depth(0, ()))
            known[name] = Depth(functions[name].frame + deepest.bytes, (name, *deepest.chain))
        return known[name]

    return {label: depth(name, ()) for label, name in roots.items()}
