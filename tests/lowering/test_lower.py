"""Sizes, names and memory: the decisions of lower() agree with those of the compiler."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

from nmpc_codegen import Options
from nmpc_codegen.compiler import model_of, text_of
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Problem
from nmpc_codegen.ir.cmodule import CModule
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.package.description import PackageDescription
from nmpc_codegen.package.struct_layout import Field, Size, Struct, struct_layout
from verification import problems
from verification.c_harness import memory_layout, shared_library

CASES = ("crane", "path_rows", "parameters", "dense_weight", "discrete", "tiny", "single_nodes")


def module(case: str, precision: str = "double", name: str | None = None) -> CModule:
    options = dataclasses.replace(problems.CASES[case].options, precision=precision)
    return lower(model_of(problems.problem(case), options), name)


def sizes_in_c(m: CModule) -> dict[str, int]:
    """sizeof for every struct and for every member of the solver, according to the compiler."""
    expressions = {s.name: f"sizeof({m.name}_{s.name}_t)" for s in m.structs}
    expressions |= {f"offset {f.name}": f"offsetof({m.name}_solver_t, {f.name})" for f in m.structs[-1].fields}
    lines = [f'#include "{m.name}.h"', "#include <stddef.h>", "int value(int i);", "int value(int i)", "{"]
    lines += ["    static const int v[] = {", ",\n".join(f"        (int){e}" for e in expressions.values())]
    lines += ["    };", "    return v[i];", "}", ""]
    library = shared_library({**text_of(m), "main.c": "\n".join(lines)}, "main.c")
    return {name: int(library.value(i)) for i, name in enumerate(expressions)}


@pytest.mark.few(6)
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("case", CASES)
def test_layout_equals_that_of_the_compiler(case: str, precision: str) -> None:
    m = module(case, precision)
    found, layout = sizes_in_c(m), struct_layout(m.structs, precision)
    dtype = memory_layout(m)
    assert dtype.fields is not None
    for struct in m.structs:
        assert found[struct.name] == layout[struct.name][0], struct.name
    for field in m.structs[-1].fields:
        assert found[f"offset {field.name}"] == dtype.fields[field.name][1], field.name
    assert m.bytes == found["solver"] == m.description.report.ram_bytes
    assert f"one {m.name}_solver_t is {m.bytes} bytes" in text_of(m)[f"{m.name}.h"]


def test_layout_pads_by_the_rules_of_c() -> None:
    """char-free structs with an int between doubles, a nested struct and an array of size zero (GNU C)."""

    def field(name: str, *sizes: int, ctype: str = "real") -> Field:
        return Field(name, tuple(Size(str(n), n) for n in sizes), "", "data", ctype)

    inner = Struct("inner", "", (field("a", ctype="int32"), field("b", 3)))
    outer = Struct("outer", "", (field("c", ctype="int32"), field("d", 0, ctype="inner"), field("e", ctype="int32")))
    assert struct_layout((inner, outer), "double") == {"inner": (32, 8), "outer": (16, 8)}
    assert struct_layout((inner, outer), "single") == {"inner": (16, 4), "outer": (8, 4)}


@pytest.mark.parametrize("case", CASES)
def test_sizes(case: str) -> None:
    """Macros against the problem, each counted independently."""
    m, p = module(case), problems.problem(case)
    rows = sum(len(r.nodes) for r in p.rows if r.kind in ("state", "general"))
    expected = {
        "N": len(p.dt),
        "NX": len(p.state_names),
        "NU": len(p.control_names),
        "NP": len(p.parameter_names),
        "NZ": len(p.state_names) + len(p.control_names),
        "NY": len(p.path.y_names),
        "NY_N": len(p.terminal.y_names),
        "NW": np.size(p.path.weight) if not p.path.diagonal_weight else len(p.path.y_names),
        "NH": len(p.path.h_names),
        "NH_N": len(p.terminal.h_names),
        "NR": len(p.rows),
        "NV": len(p.dt) * len(p.control_names),
        "NG": rows,
        "PARAMS": len(p.parameters),
    }
    assert {name: m.value(name) for name in expected} == expected
    assert m.value("LDV") % m.value("PANEL") == 0
    assert 0 <= m.value("LDV") - m.value("NV") < m.value("PANEL")
    if any(s.template == "condensing/full.c" for s in m.sections):
        assert m.value("LDG") % m.value("COLUMNS") == 0
        assert 0 <= m.value("LDG") - m.value("NV") - m.value("NX") < m.value("COLUMNS")
    assert m.value("NQ") in (1, m.value("N"))
    with pytest.raises(KeyError):
        m.value("NOTHING")


@pytest.mark.parametrize("case", CASES)
def test_rows_of_the_qp(case: str) -> None:
    """Rows are sorted by node; every declared row is present at every node at which it is imposed; tables agree."""
    p: Problem = problems.problem(case)
    rows = p.qp_rows
    assert list(rows) == sorted(rows)
    expected = {(k, i) for i, r in enumerate(p.rows) if r.kind in ("state", "general") for k in r.nodes}
    assert {(k, identity) for k, _, _, identity in rows} == expected
    assert len(rows) == len(expected)
    for k, kind, index, identity in rows:
        row = p.rows[identity]
        assert kind == ("state", "general").index(row.kind)
        assert index == (row.index_terminal if kind == 1 and k == p.N else row.index)
        assert index >= 0
    assert module(case).rows == rows
    first = module(case).table("row_first").values
    assert len(first) == p.N + 2
    for k in range(p.N + 1):
        assert [r[0] for r in rows[int(first[k]) : int(first[k + 1])]] == [k] * int(first[k + 1] - first[k])


def test_tables_hold_what_the_user_stated() -> None:
    tables = {t.name: t.values for t in module("references").tables}
    assert tables["default_reference"] == (0.2, 0.0, 0.1)
    assert tables["default_weight"] == (3.0, 0.1, 0.1)
    assert tables["default_lower"] == (-0.9,)
    assert tables["default_upper"] == (0.9,)
    assert tables["control_reference"] == (2,)
    assert tables["control_row"] == (0,)
    assert tables["initial_state"] == (1.0, 0.0)
    assert tables["interval_length"] == (0.25,) * 8
    assert tables["step_length"] == (0.125,)
    assert {t.name: t.values for t in module("nonuniform").tables}["step_length"] == (0.25,)
    assert {t.name: t.values for t in module("parameters").tables}["parameter_offset"] == (0, 1, 3)


def test_every_name_carries_the_prefix() -> None:
    """Macros, enum constants, types and functions of the header."""
    m = module("parameters", name="other")
    header = text_of(m)["other.h"]
    body = header[header.index("/* begin declarations") : header.index("/* end declarations")]
    assert all(name.startswith("OTHER_") for name in re.findall(r"#define (\w+)", body))
    assert all(name.startswith("OTHER_") for name in re.findall(r"^    (\w+) = ", body, re.M))
    assert all(name.startswith("other_") for name in re.findall(r"^(?:[\w* ]+[ *])(\w+)\(", body, re.M))
    assert "parameters" not in set(re.findall(r"\b(\w+?)_\w+\(", body))
    assert m.description.name == "other"


def test_sizes_in_c() -> None:
    assert Size("N + 1", 11).c("CRANE") == "CRANE_N + 1"
    assert Size("2", 2).c("CRANE") == "2"
    assert Field("f", (Size("NH", 0), Size("NX", 4)), "", "data").padded == (1, 4)


def test_description_is_json_and_agrees_with_the_structs() -> None:
    for case in CASES:
        m = module(case)
        data = json.loads(text_of(m)[f"{m.name}.json"])
        assert PackageDescription.from_json(text_of(m)[f"{m.name}.json"]) == m.description
        assert data["sizes"] == {macro.name: macro.value for macro in m.macros}
        described = {s["name"]: [f["name"] for f in s["fields"]] for s in data["structs"]}
        assert described == {s.name: [f.name for f in s.fields] for s in m.structs}


def test_lowering_is_pure() -> None:
    lin = model_of(classify(problems.path_rows()), Options())
    assert text_of(lower(lin)) == text_of(lower(lin))
