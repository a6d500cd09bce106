"""Warnings of gcc and clang that need a certain option are seen; packages that once had one have none.

test_random_packages.py compiles draws from all problems and options.
"""

from __future__ import annotations

import casadi as ca
import pytest
from conftest import require_tool

from nmpc_codegen import OCP, generate
from verification import problems, quality


def soft_without_terminal_rows() -> OCP:
    """A soft general row with a control, thus none at the last node."""
    ocp, q, w, u = problems.pendulum("soft_path")
    ocp.least_squares(ca.vertcat(q, w, u), weight=[1.0, 0.1, 0.05])
    ocp.subject_to(-2, q * w + u, 2, soft=(10, 0), name="row")
    return ocp


@pytest.mark.few(1)
@pytest.mark.parametrize("compiler", list(quality.COMPILERS))
def test_most_optimised(compiler: str) -> None:
    require_tool(compiler)
    assert quality.warnings_of(generate(problems.tiny()), ("-O3",), ("C99",), compiler) == ""


def test_soft_rows_without_terminal_rows() -> None:
    """The rows of the last node are those of its states, so that no value of a general row may be read there."""
    text = dict(generate(soft_without_terminal_rows()))
    assert generate(soft_without_terminal_rows()).description.sizes["NH_N"] == 0
    assert "h_N" not in text["soft_path.c"]


def test_uninitialised_values_are_seen() -> None:
    """Found by gcc only, with its optimiser."""
    require_tool("gcc")
    text = dict(generate(problems.tiny()))
    text["tiny.c"] += "int tiny_late(int n);\nint tiny_late(int n)\n{\n    int found;\n    if (n > 3) {\n"
    text["tiny.c"] += "        found = n;\n    }\n    return found;\n}\n"
    assert quality.warnings_of(text, ("-O0",), ("C99",), "gcc") == ""
    assert "-Wmaybe-uninitialized" in quality.warnings_of(text, ("-O1",), ("C99",), "gcc")


@pytest.mark.parametrize("compiler", list(quality.COMPILERS))
def test_unused_functions_are_seen(compiler: str) -> None:
    """Found by gcc when it compiles; by the front end of clang also for functions declared inline."""
    require_tool(compiler)
    level = {"gcc": "-O0", "clang": "-fsyntax-only"}[compiler]
    text = dict(generate(problems.tiny()))
    text["tiny.c"] += "static int spare(void)\n{\n    return 1;\n}\n"
    text["tiny.c"] += "static inline int spare_inline(void)\n{\n    return 1;\n}\n"
    found = quality.warnings_of(text, (level,), ("C99",), compiler)
    assert "spare" in found
    assert ("spare_inline" in found) == (compiler == "clang")
