"""firmware/stack.py: frames and calls from gcc's graph and from machine code, and the deepest chain."""

from __future__ import annotations

import pytest

from nmpc_codegen.errors import BuildError
from nmpc_codegen.firmware.stack import Function, decrement, depths, of_package, of_program, with_aliases, with_folded

GRAPH = """graph: { title: "a.c"
node: { title: "a.c:inner" label: "inner\\na.c:1:1\\n24 bytes (static)" }
node: { title: "outer" label: "outer\\na.c:2:1\\n16 bytes (static)" }
node: { title: "sinf" label: "sinf\\n<built-in>" shape : ellipse }
edge: { sourcename: "outer" targetname: "a.c:inner" label: "a.c:3:3" }
edge: { sourcename: "a.c:inner" targetname: "sinf" label: "a.c:4:3" }
}
"""

PROGRAM = """
00008000 <sinf>:
    8000:\tpush\t{r4, r5, lr}
    8002:\tvpush\t{d8-d9}
    8006:\tsub\tsp, #20
    8008:\tbl\t8100 <reduce>
    800a:\tadd\tsp, #20
    800c:\tbeq.n\t8010 <sinf+0x10>
    8010:\tpop\t{r4, r5, pc}
    8012:\tnop.w
    8016:\t.word\t0x3fe921fb

00008100 <reduce>:
    8100:\tstr.w\tlr, [sp, #-4]!
    8104:\tsub.w\tsp, sp, #400\t@ 0x190
    8108:\tb.w\t8200 <scale>

00008200 <scale>:
    8200:\tcmp\tr0, #1

00008204 <rest>:
    8204:\tstmdb\tsp!, {r4, r5, r6, r7, lr}
    8208:\tbx\tlr
"""


def test_frames_and_calls_of_the_package() -> None:
    found = of_package(GRAPH)
    assert {name: f.frame for name, f in found.items()} == {"a.c:inner": 24, "outer": 16}
    assert found["a.c:inner"].calls == {"sinf"}


def test_frames_and_calls_of_machine_code() -> None:
    found = of_program(PROGRAM)
    assert {name: f.frame for name, f in found.items()} == {"sinf": 12 + 16 + 20, "reduce": 404, "scale": 0, "rest": 20}
    assert found["sinf"].calls == {"reduce"}
    assert found["reduce"].calls == {"scale"}
    assert found["scale"].calls == {"rest"}, "a function that does not return goes on in the next one"


def test_deepest_chain() -> None:
    functions = of_program(PROGRAM) | of_package(GRAPH)
    depth = depths(functions, {"start": "outer"})["start"]
    assert depth.bytes == 16 + 24 + 48 + 404 + 20
    assert depth.chain == ("outer", "a.c:inner", "sinf", "reduce", "scale", "rest")


def test_other_names_of_a_function() -> None:
    found = with_aliases(of_program(PROGRAM), "00008101 T reduce\n00008101 T __reduce\n         U nowhere\n")
    assert found["__reduce"] is found["reduce"]


def test_a_folded_function() -> None:
    graph = GRAPH + 'edge: { sourcename: "outer" targetname: "a.c:twin" }'
    symbols = "00009001 t inner\n00009001 t twin\n00008001 T sinf\n"
    with pytest.raises(BuildError, match=r"a\.c:twin is unknown"):
        depths(of_program(PROGRAM) | of_package(graph), {"start": "outer"})
    functions = with_folded(of_package(graph), symbols, "a.c")
    assert functions["a.c:twin"].frame == 24
    assert depths(of_program(PROGRAM) | functions, {"start": "outer"})["start"].bytes == 16 + 24 + 48 + 404 + 20


@pytest.mark.parametrize(
    ("graph", "what"),
    [
        (GRAPH.replace("24 bytes (static)", "24 bytes (dynamic)"), "variable size"),
        (GRAPH + 'node: { title: "__indirect_call" label: "Indirect Call Placeholder" shape : ellipse }', "pointer"),
    ],
)
def test_a_stack_that_gcc_does_not_bound(graph: str, what: str) -> None:
    with pytest.raises(BuildError, match=what):
        of_package(graph)


def test_what_is_not_bounded() -> None:
    with pytest.raises(BuildError, match="recursion: a -> b -> a"):
        depths({"a": Function(8, {"b"}), "b": Function(8, {"a"})}, {"a": "a"})
    with pytest.raises(BuildError, match="unknown"):
        depths({"a": Function(8, {"b"})}, {"a": "a"})
    with pytest.raises(BuildError, match="by a register"):
        decrement("sub.w", "sp, sp, r3", "f")
    with pytest.raises(BuildError, match="through r4"):
        of_program("00008000 <f>:\n    8000:\tblx\tr4\n")
