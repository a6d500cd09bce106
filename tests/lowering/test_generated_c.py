"""The emitted C itself: warnings, symbols, sanitizers, stack, several controllers in one program, two languages."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from conftest import require_tool

from nmpc_codegen import OCP, Options, RealTimeIteration, generate
from nmpc_codegen.errors import BuildError
from nmpc_codegen.package.status import Status
from nmpc_codegen.runtime.build import load
from nmpc_codegen.runtime.cache import CACHE_VARIABLE
from verification import problems, quality


@pytest.fixture(scope="session", autouse=True)
def _compilers() -> None:
    require_tool("cc")


@pytest.mark.parametrize("kind", ["mhe", "ekf"])
@pytest.mark.parametrize("sensed", ["x", "x and known", "x and unknown", "x and u"])
def test_no_warning_of_an_estimator(kind: str, sensed: str) -> None:
    """Whatever sensors see of the parameters and controls that the model has."""
    ocp = OCP("plant", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    known, unknown = ocp.parameter("known", value=1.0), ocp.parameter("unknown")
    ocp.dynamics({x: u - known * x + unknown})
    seen = {"x": x, "x and known": known * x, "x and unknown": x + unknown, "x and u": x + u}[sensed]
    estimator = ocp.estimator(
        N=4, kind=kind, measure={"y": seen}, noise_std={"y": 0.1}, process_std={"x": 0.1, "unknown": 0.1}
    )
    assert quality.warnings_of(generate(estimator), ("-fsyntax-only",), ("C99",)) == ""


def test_warnings_are_seen() -> None:
    """A narrowing conversion, a double in single precision and an unused constant are counted in both languages."""
    sources = dict(problems.sources("tiny", "single"))
    sources["tiny.c"] += (
        "int tiny_narrow(double x);\nint tiny_narrow(double x) { float y = x; return (int)(y * 2.0); }\n"
    )
    found = quality.warnings_of(sources, levels=("-O0",))
    assert "-Wfloat-conversion" in found
    assert "-Wdouble-promotion" in found
    assert quality.count_warnings(found) >= 4


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
def test_fast_math_is_refused(flag: str) -> None:
    with quality.written(problems.sources("tiny")) as folder:
        done = quality.compile_c(folder, "-std=c99", "-O2", flag, "-c", "tiny.c")
    assert done.returncode != 0
    assert "-ffast-math" in done.stderr


def test_api_symbols_are_those_of_the_header() -> None:
    sources = problems.sources("crane")
    with quality.written(sources) as folder:
        quality.compile_c(folder, *quality.RELEASE, "-O0", "-c", "crane.c").check_returncode()
        listing = subprocess.run(["nm", "crane.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
    defined = {line.split()[-1] for line in listing.splitlines() if line.split()[-2] == "T"}
    assert defined == set(re.findall(r"\b(crane_\w+)\(", sources["crane.h"]))
    assert len(defined) == 15  # no terminal cost and no parameter to set


def test_foreign_symbols_are_seen() -> None:
    sources = dict(problems.sources("tiny"))
    sources["tiny.c"] += (
        "int counter;\nstatic int hidden;\nvoid leak(void);\nvoid *malloc(unsigned long);\n"
        "int *tiny_more(void);\nint *tiny_more(void) { leak(); hidden++; return malloc(4); }\n"
    )
    assert {s.split()[1] for s in quality.foreign_symbols(sources)} == {"counter", "hidden", "leak", "malloc"}


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["crane", "single_nodes", "parameters", "scaled", "discrete", "tiny"])
def test_whole_api_under_sanitizers(name: str) -> None:
    """Every function with good and bad arguments; AddressSanitizer and UndefinedBehaviorSanitizer find nothing."""
    assert quality.exercise(problems.sources(name), problems.CASES[name].x0) == ""


@pytest.mark.slow
def test_shift_under_sanitizers_in_single_precision() -> None:
    options = Options(algorithm=RealTimeIteration(shift="repeat"), precision="single")
    assert quality.exercise(generate(problems.path_rows(), options), problems.CASES["path_rows"].x0) == ""


@pytest.mark.parametrize(
    ("old", "new", "flags"),
    [
        ("memcpy(s->yref[n], yref,", "memcpy(s->yref[n + 1], yref,", quality.SANITIZERS),  # past the last node
        ("isfinite(u) ? u : reference_of_control", "1 ? u : reference_of_control", ()),  # a NaN is accepted
        ("lower < INF && upper", "upper", ()),  # no number is between infinity and itself
    ],
)
def test_exercise_finds_defects(old: str, new: str, flags: tuple[str, ...]) -> None:
    """A sanitizer finds the first defect, exercise.c itself finds the others."""
    sources = dict(problems.sources("crane"))
    assert sources["crane.c"].count(old) == 1
    sources["crane.c"] = sources["crane.c"].replace(old, new)
    assert quality.exercise(sources, problems.CASES["crane"].x0, flags) != ""


def test_stack(record_property: pytest.RecordProperty) -> None:
    """No recursion, bounded stack: less than 2.625 kB for the crane, which solve() takes for second derivatives: all
    buffers of their three sweeps are one struct."""
    stack = quality.stack_use(problems.sources("crane"), "-O2")
    record_property("stack -O2", f"{stack.total} bytes, largest frame {stack.frame}")
    assert 0 < stack.frame < stack.total < 2688


def test_two_controllers_in_one_program() -> None:
    """Crane, crane under another name and in single precision, interleaved: bit for bit as alone."""
    runs = quality.run_together(quality.crane_packages(), problems.CASES["crane"].x0, flags=("-std=c99", "-O0"))
    assert set(runs) == {"crane", "crane_b", "crane_f32"}
    for alone, together in runs.values():
        assert len(alone) == 30
        assert alone == together
    double, twin, single = ([line.split()[1:] for line in alone] for alone, _ in runs.values())
    assert double == twin
    assert all(line[1] == "0" for line in double + single)
    for a, b in zip(double, single, strict=True):
        assert float.fromhex(a[3]) == pytest.approx(float.fromhex(b[3]), abs=1e-4)
        assert float.fromhex(a[3]) != float.fromhex(b[3])


def test_copy_by_assignment_goes_on_alike() -> None:
    """A struct copied with '=' during operation continues bit for bit like the original, which is not affected."""
    program = """
#include <stdio.h>
#include "crane.h"
static crane_solver_t a, b;
static void run(crane_solver_t *s, double *x, int steps, const char *name)
{
    double u[CRANE_NU];
    int n;
    for (n = 0; n < steps; n++) {
        const int status = (int)crane_step(s, x, u);
        crane_integrate(s, x, u, 0.3, x);
        printf("%s %d %a %a %a\\n", name, status, u[0], x[0], x[2]);
    }
}
int main(void)
{
    double x[CRANE_NX] = { 2, 0, 0, 0 }, y[CRANE_NX];
    int i;
    crane_init(&a);
    run(&a, x, 5, "start");
    b = a;
    for (i = 0; i < CRANE_NX; i++) {
        y[i] = x[i];
    }
    run(&a, x, 10, "go");
    run(&b, y, 10, "go");
    return 0;
}
"""
    with quality.written(problems.sources("crane")) as folder:
        (folder / "copy.c").write_text(program)
        quality.compile_c(folder, "-std=c99", "copy.c", "crane.c", "-o", "copy", "-lm").check_returncode()
        lines = subprocess.run(["./copy"], cwd=folder, capture_output=True, text=True, check=True).stdout.splitlines()
    assert lines[5:15] == lines[15:]
    assert len(set(lines[5:15])) == 10


def test_statuses() -> None:
    """The status values have the same order in the header and in Python, and there is a text for every value."""
    order = (
        *("OK", "ITERATION_LIMIT", "INFEASIBLE", "RELAXED", "NUMERICAL_FAILURE", "NOT_FINITE", "NOT_PREPARED"),
        *(
            "NOT_INITIALIZED",
            "BAD_INDEX",
            "BAD_BOUNDS",
            "BAD_ARGUMENT",
            "STALLED",
            "SUBPROBLEM_FAILED",
            "NOT_CONVERGED",
        ),
    )
    sources = problems.sources("crane")
    assert tuple(s.name for s in Status) == order
    enum = sources["crane.h"].partition("typedef enum {")[2].partition("}")[0]
    assert re.findall(r"CRANE_(\w+) = (\d+),? /\*", enum) == [(n, str(i)) for i, n in enumerate(order)]
    program = '#include <stdio.h>\n#include "crane.h"\nint main(void) { int i; for (i = -1; i <= 14; i++) { '
    program += "puts(crane_status_string((crane_status_t)i)); } return 0; }\n"
    with quality.written(sources) as folder:
        (folder / "texts.c").write_text(program)
        quality.compile_c(
            folder, *quality.RELEASE, "-O0", "texts.c", "crane.c", "-o", "texts", "-lm"
        ).check_returncode()
        texts = subprocess.run(["./texts"], cwd=folder, capture_output=True, text=True, check=True).stdout.splitlines()
    assert texts[0] == texts[-1] == "unknown status"
    assert len(set(texts[1:-1])) == len(order)
    comments = re.findall(r"CRANE_\w+ = \d+,? /\* (.*?) \*/", enum)
    assert texts[1:-1] == comments


def test_sources_are_deterministic() -> None:
    for name in ("path_rows", "crane_looped"):
        case = problems.CASES[name]
        assert generate(case.make(), problems.options_of(case)) == problems.sources(name)


def test_no_machine_or_date_in_the_sources() -> None:
    text = "".join(problems.sources("parameters").values())
    assert str(Path.home()) not in text
    assert not re.search(r"/(tmp|usr|work|home)/|20[2-9]\d-\d\d", text)


def test_sizes_in_the_header_are_those_of_the_compiler() -> None:
    sources = problems.sources("crane")
    stated = re.search(r"one crane_solver_t is (\d+) bytes", sources["crane.h"])
    assert stated is not None
    assert f"/* {stated[1]} bytes */" in sources["README.md"]
    check = f'#include "crane.h"\ntypedef char size[sizeof(crane_solver_t) == {stated[1]} ? 1 : -1];\n'
    with quality.written(sources) as folder:
        (folder / "size.c").write_text(check)
        assert quality.compile_c(folder, "-std=c99", "-fsyntax-only", "size.c").returncode == 0


def test_failed_build_can_be_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lock of the cache is released although the exception, and with it the frame of build(), still exists."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    sources = dict(problems.sources("tiny"))
    sources["tiny.c"] += "this is no C\n"
    with pytest.raises(BuildError) as first:
        load(sources, "tiny", "test")
    with pytest.raises(BuildError) as second:
        load(sources, "tiny", "test")
    assert "tiny.c" in str(first.value)
    assert "tiny.c" in str(second.value)
