"""clang-tidy, clang -Weverything, gcc -fanalyzer and cppcheck find nothing in the C of the samples."""

from __future__ import annotations

import pytest
from conftest import require_tool

from tests.verification import lint
from verification.conditions import covering
from verification.rendered import lowered
from verification.samples import SAMPLES

#: Tool -> a fault that it detects.
FAULTS = {
    "clang-tidy": "int f(int a);\nint f(int a)\n{\n    if (a) return 1;\n    return 0;\n}\n",
    "clang": "double f(float a);\ndouble f(float a)\n{\n    return a;\n}\n",
    "gcc": "#include <stdlib.h>\nint f(void);\nint f(void)\n{\n    int *p = malloc(4);\n    return *p;\n}\n",
    "cppcheck": "int f(void);\nint f(void)\n{\n    int a[2] = { 0, 0 };\n    return a[3];\n}\n",
}
#: Small packages, all solvers.
QUICK = ("controls dense", "path riccati", "soft rows interior")


def places(names: tuple[str, ...], tools: tuple[str, ...]) -> list[str]:
    found = lint.findings([sample for sample in SAMPLES if sample.name in names], tools)
    return sorted(f"{f.tool} {f.check}: {f.origin}: {f.line or f.message}" for f in found if not f.of_length)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", QUICK)
def test_no_findings(name: str) -> None:
    for tool in lint.TOOLS:
        require_tool(lint.TOOLS[tool][0])
    assert places((name,), ("clang-tidy", "clang", "cppcheck")) == []


@pytest.mark.slow
def test_no_findings_where_every_condition_is_true_and_false() -> None:
    chosen = covering({sample.name: lowered(sample) for sample in SAMPLES})
    assert places(tuple(chosen), tuple(lint.TOOLS)) == []


@pytest.mark.parametrize("tool", lint.TOOLS)
def test_every_tool_finds_a_planted_fault(tool: str) -> None:
    require_tool(lint.TOOLS[tool][0])
    assert lint.run(tool, {"planted.c": FAULTS[tool], "planted.json": "{}"})


def test_comparison_for_equality_needs_a_comment() -> None:
    require_tool("clang")
    text = "int f(double a, double b);\nint f(double a, double b)\n{\n    return a == b;%s\n}\n"
    bare, commented = ({"planted.c": text % c, "planted.json": "{}"} for c in ("", " /* exactly 0: not set */"))
    assert [finding.check for finding in lint.run("clang", bare)] == ["-Wfloat-equal"]
    assert lint.run("clang", commented) == set()


def test_a_tool_that_fails_is_no_clean_bill(monkeypatch: pytest.MonkeyPatch) -> None:
    require_tool("clang")
    monkeypatch.setitem(lint.TOOLS, "clang", ("clang", "--no-such-option"))
    with pytest.raises(RuntimeError, match="no-such-option"):
        lint.run("clang", {"planted.c": "", "planted.json": "{}"})
