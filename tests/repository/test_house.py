"""The benchmark of the code base detects faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import require_tool

from benchmarks.lib.closed_loop import member_path
from benchmarks.lib.house import commits, disagreement, lint, sizes, suite
from benchmarks.lib.house.samples import SAMPLES
from benchmarks.lib.house.timed import TIMED
from benchmarks.lib.house.unresolved import texts
from benchmarks.lib.report import Report
from examples import crane
from nmpc_codegen import Options, build

SAMPLE = next(s for s in SAMPLES if s.name == "controls dense")


def test_code_without_comments_indentation_and_printed_kernels() -> None:
    """The count is less than the file size, and grows by exactly the bytes of an added line."""
    module = texts(SAMPLES[0])["crane.c"]
    found = sizes.code_bytes(crane.build_ocp(), Options())
    assert 20_000 < found < len(module) / 1.3
    assert found != sizes.code_bytes(crane.build_ocp(False), Options())


def test_ram_is_what_a_controller_takes() -> None:
    require_tool("cc")
    assert sizes.ram_bytes(crane.build_ocp(), Options()) == build(crane.build_ocp()).nbytes


#: Tool -> a fault that it detects.
FAULTS = {
    "clang-tidy": "int f(int a);\nint f(int a)\n{\n    if (a) return 1;\n    return 0;\n}\n",
    "clang": "double f(float a);\ndouble f(float a)\n{\n    return a;\n}\n",
    "gcc": "#include <stdlib.h>\nint f(void);\nint f(void)\n{\n    int *p = malloc(4);\n    return *p;\n}\n",
    "cppcheck": "int f(void);\nint f(void)\n{\n    int a[2] = { 0, 0 };\n    return a[3];\n}\n",
}


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


def test_lint_names_the_part() -> None:
    """A line that one part has belongs to it; one that is nowhere, to the file."""
    line = "static void evaluate_rows(const solver_t *s, real_t *value)"
    assert line in (lint.template_directory() / "rows.c").read_text().splitlines()
    assert lint._origin(line, "a.c") == "rows.c"
    assert lint._origin("static void no_such_function(void)", "a.c") == "a.c"


def test_builds_disagree_where_one_of_them_is_wrong() -> None:
    """Two builds of one package agree up to rounding; one without the bounds does not; NaN is no agreement."""
    require_tool("gcc")
    sources = texts(SAMPLE)
    x = np.random.default_rng(1).uniform(-1, 1, (6, 2))
    builds = [("gcc", "-O0"), ("gcc", "-O1")]
    u, status = disagreement.replays(sources, x, builds)
    assert u.shape == (2, 6, 1)
    assert status.shape == (2, 6)
    assert disagreement.disagreement(u) <= 1e-5  # single precision
    unbounded = texts(next(s for s in SAMPLES if s.name == "bare dense"))
    other, _ = disagreement.replays(unbounded, x, builds[:1])
    assert disagreement.disagreement(np.concatenate([u[:1], other])) > 1e-3
    assert np.isnan(disagreement.disagreement(np.array([[[1.0]], [[np.nan]]])))


def test_packages_of_a_commit() -> None:
    """The last commit can generate the packages of this tree; an unknown one is an error, not an empty comparison."""
    if not commits.has_commit("HEAD"):
        pytest.skip("this tree is no clone")
    found = commits.packages_of("HEAD", ["controls dense"])
    assert found["controls dense"]["controls.c"].startswith("/* controls:")
    with pytest.raises(ValueError, match="no-such-commit"):
        commits.packages_of("no-such-commit", ["controls dense"])
    assert not commits.has_commit("no-such-commit")


def test_timed_problems_have_scenarios() -> None:
    from benchmarks.lib.house.ratios import scenario_of

    for sample in TIMED:
        assert len(scenario_of(sample).x0) == sample.make().x.numel(), sample.name


def test_member_is_found_where_a_package_has_it() -> None:
    header = texts(SAMPLE)["controls.h"]
    assert member_path(header, "qp_iterations").endswith("qp_iterations")
    moved = "typedef struct {\n    int32_t n; /* */\n} a_info_t;\ntypedef struct {\n    a_info_t info;\n} a_solver_t;\n"
    assert member_path(moved, "n") == "info.n"
    with pytest.raises(ValueError):
        member_path(moved, "m")


def test_cpu_time_of_children_counts(tmp_path: Path) -> None:
    report = Report("test")
    suite.measure(report, ("-c", "import time\nwhile time.process_time() < 0.5: pass"))
    found = {r.key: r.value for r in report.records}
    assert 0.4 < found["test_suite_cpu_seconds"] < 5
    assert found["test_suite_failed"] == 0
    suite.measure(report, ("-c", "raise SystemExit(1)"))
    assert report.worst()["test_suite_failed"].value == 1
