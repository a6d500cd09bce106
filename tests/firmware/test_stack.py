"""firmware/stack.py: frames and calls from gcc's graph and from machine code, and the deepest chain."""

from __future__ import annotations

import pytest

from nmpc_codegen.errors import BuildError
from nmpc_codegen.firmware.machine_code import Arm, RiscV
from nmpc_codegen.firmware.stack import StackFunction, depths, of_package, of_program, with_aliases, with_folded_names

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
    found = of_program(PROGRAM, Arm())
    assert {name: f.frame for name, f in found.items()} == {"sinf": 12 + 16 + 20, "reduce": 404, "scale": 0, "rest": 20}
    assert found["sinf"].calls == {"reduce"}
    assert found["reduce"].calls == {"scale"}
    assert found["scale"].calls == {"rest"}, "a function that does not return goes on in the next one"


def test_deepest_chain() -> None:
    functions = of_program(PROGRAM, Arm()) | of_package(GRAPH)
    depth = depths(functions, {"start": "outer"})["start"]
    assert depth.bytes == 16 + 24 + 48 + 404 + 20
    assert depth.chain == ("outer", "a.c:inner", "sinf", "reduce", "scale", "rest")


def test_other_names_of_a_function() -> None:
    found = with_aliases(of_program(PROGRAM, Arm()), "00008101 T reduce\n00008101 T __reduce\n         U nowhere\n")
    assert found["__reduce"] is found["reduce"]


def test_a_folded_function() -> None:
    graph = GRAPH + 'edge: { sourcename: "outer" targetname: "a.c:twin" }'
    symbols = "00009001 t inner\n00009001 t twin\n00008001 T sinf\n"
    with pytest.raises(BuildError, match=r"a\.c:twin is unknown"):
        depths(of_program(PROGRAM, Arm()) | of_package(graph), {"start": "outer"})
    functions = with_folded_names(of_package(graph), symbols, "a.c")
    assert functions["a.c:twin"].frame == 24
    assert depths(of_program(PROGRAM, Arm()) | functions, {"start": "outer"})["start"].bytes == 16 + 24 + 48 + 404 + 20


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


RISCV = """
1000cada <__mulsf3>:
1000cada:\tadd\tsp,sp,-32
1000cae0:\tjal\tt0,10001068 <__riscv_save_0>
1000cae2:\tauipc\tra,0x0
1000cae6:\tjalr\t100(ra) # 1000cb46 <__clzsi2>
1000caea:\tjr\ta5
1000caec:\tadd\tsp,sp,32
1000caee:\tret

1000cb46 <__clzsi2>:
1000cb46:\tadd\tsp,sp,-16 # 807ffff0 <image_stack_limit+0xff0>
1000cb48:\tj\t10001080 <__riscv_restore_0>

10001068 <__riscv_save_0>:
10001068:\tadd\tsp,sp,-16
1000106a:\tjr\tt0

10001080 <__riscv_restore_0>:
10001080:\tadd\tsp,sp,16
10001082:\tret
"""


def test_machine_code_of_risc_v() -> None:
    """A call of __riscv_save_0 lowers the stack pointer of its caller."""
    found = of_program(RISCV, RiscV())
    assert {n: f.frame for n, f in found.items() if f.frame} == {"__mulsf3": 32 + 64, "__clzsi2": 16}
    assert found["__mulsf3"].calls == {"__clzsi2"}
    assert depths(found, {"start": "__mulsf3"})["start"].bytes == 112
    with pytest.raises(BuildError, match="by a register"):
        RiscV().decrement("sub", "sp,sp,a0", "f")
    with pytest.raises(BuildError, match="through a5"):
        RiscV().callee("jalr", "a5", "f")


def test_what_is_not_bounded() -> None:
    with pytest.raises(BuildError, match="recursion: a -> b -> a"):
        depths({"a": StackFunction(8, {"b"}), "b": StackFunction(8, {"a"})}, {"a": "a"})
    with pytest.raises(BuildError, match="unknown"):
        depths({"a": StackFunction(8, {"b"})}, {"a": "a"})
    with pytest.raises(BuildError, match="by a register"):
        Arm().decrement("sub.w", "sp, sp, r3", "f")
    with pytest.raises(BuildError, match="through r4"):
        of_program("00008000 <f>:\n    8000:\tblx\tr4\n", Arm())
