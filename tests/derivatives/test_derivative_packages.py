"""The folder of C: warnings, parts, sizes, bad input in C and in Python, exports."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from conftest import require_tool

from nmpc_codegen import OCP, Discrete, ExplicitRungeKutta, GaussNewton, Online, Options, RealTimeIteration, derivatives
from nmpc_codegen.derivatives.derivative_text import OF_OUTPUTS, PARTS, SECOND_ORDER
from nmpc_codegen.errors import BuildError, DerivativeError, ExportError, OptionError, ProblemError
from nmpc_codegen.lowering.templates import template_directory
from nmpc_codegen.runtime.build import WARNINGS
from tests.snippets import ROOT, blocks
from verification.adjoint import choice
from verification.models import discrete_map, pendulum_of_everything, problem_of


def trivial() -> OCP:
    """Nothing depends on anything: constant derivatives, a cost of the end alone."""
    ocp = OCP("trivial", T=1.0, N=1)
    x, _ = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: 1.0})
    ocp.terminal_cost(x)
    return ocp


CASES: dict[str, tuple[OCP, Any, Options | None]] = {
    "map": (discrete_map(), None, None),
    "trivial": (trivial(), 3.0, None),
    "loops": (problem_of("tanks"), problem_of, Options(ExplicitRungeKutta(steps=2, unroll="none"))),
    "single": (problem_of("reactor", uniform=False), problem_of, Options(precision="single")),
    "costs": (pendulum_of_everything("everything", [0.2, 0.3]), problem_of, None),
}


def sources_of(case: str) -> dict[str, str]:
    ocp, outputs, options = CASES[case]
    z = ca.vertcat(ocp.x[0] * ocp.u[0], ocp.x[1]) if outputs is problem_of else outputs
    return derivatives.generate(ocp, z, options, "tools", second_order=case != "loops")


def written(folder: Path, sources: dict[str, str]) -> None:
    for path, text in sources.items():
        (folder / path).write_text(text, encoding="utf-8")


@pytest.mark.few(2)
@pytest.mark.parametrize("case", CASES)
def test_no_warnings(case: str, tmp_path: Path) -> None:
    """C99 and C++17, gcc and clang, without and with the optimiser; clang sees unused functions of the front end."""
    written(tmp_path, sources_of(case))
    warnings = [w for w in WARNINGS if not w.startswith("-std")]
    for tool, language in (("gcc", ["-std=c99"]), ("clang", ["-std=c99"]), ("g++", ["-x", "c++", "-std=c++17"])):
        require_tool(tool)
        for file in ("tools.c", "main.c"):
            command = [tool, *language, *warnings, "-O1", "-c", file, "-o", "out.o"]
            run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
            assert run.returncode == 0, run.stderr
            assert run.stderr == ""


def test_every_part_is_used() -> None:
    folder = template_directory() / "derivatives"
    assert {path.name for path in folder.glob("*.c")} == {*PARTS, OF_OUTPUTS, SECOND_ORDER}
    assert "NOUT" in sources_of("costs")["tools.c"]
    assert "NOUT" not in sources_of("map")["tools.c"]


def test_text_is_deterministic_and_complete() -> None:
    first = sources_of("costs")
    assert first == sources_of("costs")
    assert set(first) == {"tools.c", "tools.h", "main.c", "CMakeLists.txt", "README.md"}
    for path, text in first.items():
        assert max(map(len, text.splitlines())) <= 200 or path == "README.md"
        for word in ("malloc", "stdlib", "static inline"):
            assert word not in text


def test_struct_sizes_and_program(tmp_path: Path) -> None:
    """The stated sizes are those of the compiler; main.c prints the gradient that Python returns."""
    compiler = require_tool("cc")
    ocp = problem_of("crane")
    for precision in ("double", "single"):
        folder = derivatives.export(ocp, ocp.x[0], Options(precision=precision), tmp_path / precision, "tools")
        assert {path.name for path in folder.files} == set(sources_of("map"))
        checks = [f"typedef char c_{s}[sizeof(tools_{s}_t) == {n} ? 1 : -1];" for s, n in folder.bytes.items()]
        (folder.directory / "size.c").write_text("\n".join(['#include "tools.h"', *checks]) + "\n", encoding="utf-8")
        command = [compiler, "-std=c99", "-O1", "main.c", "tools.c", "size.c", "-lm", "-o", "program"]
        subprocess.run(command, cwd=folder.directory, check=True)
        run = subprocess.run([folder.directory / "program"], capture_output=True, text=True, check=True)
        printed = [float(line.split("=")[1]) for line in run.stdout.splitlines()]
        tools = derivatives.build(ocp, ocp.x[0], Options(precision=precision), profile="test")
        rest = np.zeros(4), np.zeros((3, 1))
        np.testing.assert_allclose(printed, [tools.simulate(*rest).cost, *tools.gradient(*rest)[:, 0]], atol=1e-6)
    target = tmp_path / "double" / "tools.c"
    target.write_text(target.read_text() + "/* mine */\n")
    with pytest.raises(ExportError, match=r"tools\.c"):
        derivatives.export(ocp, ocp.x[0], None, tmp_path / "double", "tools")


def test_c_refuses_bad_input() -> None:
    """Statuses of calls that Python would not make."""
    tools = derivatives.build(problem_of("crane"), profile="test")
    ok, data = 0, tools._structs["data"]
    x0, u = np.ones(4), np.zeros((3, 1))
    tools.gradient(x0, u)
    response, trajectory = tools._structs["response"], tools._structs["trajectory"]
    g = tools._pointer(np.zeros(3))
    for k, status in ((-1, 8), (3, 8), (2, ok)):
        assert tools._function("sensitivities_alternative")(data, k, response) == status
    for step, status in ((0.0, 10), (-1e-3, 10), (np.nan, 10), (np.inf, 10), (1e-17, 10), (1e-6, ok)):
        assert tools._function("gradient_finite_differences")(data, step, trajectory, g) == status
    for name in ("x0", "u", "yref", "W"):
        for bad in (np.nan, np.inf):
            view = tools._view("data", name).reshape(-1)
            old, view[0] = view[0], bad
            for function, work in (("simulate", (trajectory,)), ("gradient_adjoint", (tools._structs["nodes"], g))):
                assert tools._function(function)(data, *work) == 5
            view[0] = old
    assert tools._function("simulate")(data, trajectory) == ok


def test_c_refuses_rows() -> None:
    ocp = problem_of("crane")
    tools = derivatives.build(ocp, ocp.x[0], profile="test")
    tools.gradient(np.ones(4), np.zeros((3, 1)))
    nodes, Xi = tools._structs["nodes"], tools._pointer(np.zeros((1, 3)))
    for row, status in ((-1, 8), (3, 8), (2, 0)):
        rows = tools._ffi.new("int[]", [row])
        assert tools._function("impulse_response_adjoint")(tools._structs["data"], rows, 1, nodes, Xi) == status


def test_overflow_is_reported() -> None:
    """A map that escapes within the horizon."""
    ocp = OCP("escape", N=12)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x**2 + u}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=1.0)
    tools = derivatives.build(ocp, x, profile="test")
    rest = np.zeros((12, 1))
    assert np.isfinite(tools.gradient([0.5], rest)).all()
    for method in derivatives.GRADIENTS:
        with pytest.raises(DerivativeError, match="not finite"):
            tools.gradient([1e3], rest, method)
        with pytest.raises(DerivativeError, match="not finite"):
            tools.impulse_response([1e3], rest, method)
    with pytest.raises(DerivativeError, match="a state or a result is not finite"):
        tools.simulate([1e3], rest)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x0": [1.0]}, r"x0 has shape \(1,\); expected \(4,\)"),
        ({"u": np.zeros(3)}, r"u has shape \(3,\); expected \(3, 1\)"),
        ({"x0": [1, 2, 3, "a"]}, "x0: "),
        ({"u": np.full((3, 1), np.nan)}, "u is not finite"),
        ({"method": "backward"}, "method: 'backward'; expected one of finite_differences, forward"),
        ({"step": 1e-6}, "step: method 'adjoint' has none"),
        ({"method": "finite_differences", "step": 0.0}, "step: 0.0; expected a finite number"),
        ({"method": "finite_differences", "step": True}, "step: True"),
    ],
)
def test_python_refuses(arguments: dict[str, Any], message: str) -> None:
    ocp = problem_of("crane")
    tools = derivatives.build(ocp, ocp.x[0], profile="test", output_names="p")
    given = {"x0": np.ones(4), "u": np.zeros((3, 1)), "method": "adjoint"} | arguments
    for function in (tools.gradient, tools.impulse_response):
        with pytest.raises(DerivativeError, match=message):
            function(**given)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([(3, 0)], "rows: node 3; expected 0 to 2"),
        ([(0, 1)], "rows: output 1; expected 0 to 0"),
        ([(0, "q")], "rows: no output 'q'; there are p"),
        ([(0.5, 0)], "rows: node 0.5; expected an integer"),
        ([4], r"rows: 4; expected pairs"),
    ],
)
def test_python_refuses_rows(rows: Any, message: str) -> None:
    ocp = problem_of("crane")
    tools = derivatives.build(ocp, ocp.x[0], profile="test", output_names="p")
    with pytest.raises(DerivativeError, match=message):
        tools.impulse_response(np.ones(4), np.zeros((3, 1)), "adjoint", rows=rows)
    with pytest.raises(DerivativeError, match="computes whole columns"):
        tools.impulse_response(np.ones(4), np.zeros((3, 1)), "forward", rows=rows)
    with pytest.raises(DerivativeError, match="k: control 3"):
        tools.responses(np.ones(4), np.zeros((3, 1)), 3)


def test_second_derivatives_are_refused() -> None:
    rest = np.ones(4), np.zeros((3, 1))
    with pytest.raises(DerivativeError, match="give second_order=True to build"):
        derivatives.build(problem_of("crane"), profile="test").hessians(*rest, np.ones((3, 4)))
    tools = derivatives.build(problem_of("crane"), profile="test", second_order=True)
    for lam, sweep, message in (
        (np.ones((4, 4)), "symmetric", r"lam has shape \(4, 4\); expected \(3, 4\)"),
        (np.full((3, 4), np.nan), "symmetric", "lam is not finite"),
        (np.ones((3, 4)), "adjoint", "sweep: 'adjoint'; expected one of symmetric, forward_over_adjoint"),
    ):
        with pytest.raises(DerivativeError, match=message):
            tools.hessians(*rest, lam, sweep)  # type: ignore[arg-type]


def test_data_that_are_not_finite_are_named() -> None:
    tools = derivatives.build(discrete_map(), profile="test")
    tools.p[2] = np.inf
    with pytest.raises(DerivativeError, match="p of the data is not finite"):
        tools.gradient(np.ones(2), np.zeros((4, 2)))
    with pytest.raises(DerivativeError, match="has no outputs"):
        tools.impulse_response(np.ones(2), np.zeros((4, 2)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (Options(Discrete()), "is an ordinary differential equation"),
        (Options(hessian=GaussNewton()), "options.hessian does not apply"),
        (Options(online=Online(parameter="shared")), "options.online does not apply"),
        (Options(algorithm=RealTimeIteration(shift="repeat")), "options.algorithm does not apply"),
        (Options(solve=False), "options.solve does not apply"),
        ("RK4", "options: 'RK4'"),
    ],
)
def test_options_are_refused(options: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        derivatives.generate(problem_of("crane"), None, options)


def test_statements_are_refused() -> None:
    ocp = problem_of("crane")
    with pytest.raises(ProblemError, match="outputs contains the unknown symbol 'w'"):
        derivatives.generate(ocp, ca.SX.sym("w"))
    with pytest.raises(ProblemError, match="outputs are empty"):
        derivatives.generate(ocp, [])
    with pytest.raises(ProblemError, match="without outputs"):
        derivatives.generate(ocp, output_names=["z"])
    with pytest.raises(ProblemError, match="must be 2 strings"):
        derivatives.generate(ocp, ocp.x[:2], output_names=["one"])
    with pytest.raises(ProblemError, match="name"):
        derivatives.generate(ocp, name="math")
    ocp.free_initial("p")
    with pytest.raises(OptionError, match="p is free_initial"):
        derivatives.generate(ocp)
    long = OCP("lengthy", N=10_000)
    x, u = long.state("x"), long.control("u")
    long.dynamics({x: 0.5 * x + u}, discrete=True)
    long.least_squares(u, weight=1.0)
    with pytest.raises(OptionError, match="3,000,000,000 entries"):
        derivatives.generate(long, [x] * 30)
    started = problem_of("tanks")
    started.start_cost(started.x[0])
    with pytest.raises(OptionError, match="start cost"):
        derivatives.generate(started)


def test_missing_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(BuildError, match="no-such-compiler"):
        derivatives.build(discrete_map(), profile="test", name="never_built")


def test_page_of_the_docs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Its program runs; its tables hold the operations that the compiler states."""
    monkeypatch.chdir(tmp_path)
    (block,) = blocks("docs/derivatives.md")
    names: dict[str, Any] = {}
    exec(block.text, names)
    np.testing.assert_allclose(names["last"], names["Xi"][-1:], rtol=0, atol=1e-12)
    assert float(capsys.readouterr().out.split()[0]) == names["run"].cost
    assert (tmp_path / "out" / "crane_derivatives" / "crane_derivatives.c").exists()
    page = (ROOT / "docs" / "derivatives.md").read_text(encoding="utf-8")
    for function in ("hessians_symmetric", "hessians_forward_over_adjoint", "sensitivities"):
        assert f"{names['tools'].operations[function].total:,}" in page
    for title, rows in choice.tables().items():
        assert f"| {title} | {' | '.join(choice.CASES)} |" in page
        for row, values in rows.items():
            assert f"| {row} | {' | '.join(f'{v:,}' for v in values)} |" in page
