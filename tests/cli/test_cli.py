"""cli/: the command line from a problem file to C, and incorrect uses."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nmpc_codegen import derivatives
from nmpc_codegen.cli import check, main
from nmpc_codegen.cli.check import compare
from nmpc_codegen.cli.problem_file import load_problem
from nmpc_codegen.cli.settings import apply_settings
from nmpc_codegen.components.allowed import rules
from nmpc_codegen.components.integrators import RK4, ExplicitRungeKutta
from nmpc_codegen.errors import ProblemError
from nmpc_codegen.options import REGISTRIES, Options
from tests.cli.cart import CART, write_problem


def said(capsys: pytest.CaptureFixture[str]) -> tuple[str, str]:
    """Output and errors, each joined to one line."""
    captured = capsys.readouterr()
    return " ".join(captured.out.split()), " ".join(captured.err.split())


# -- the whole way ----------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_export_check_simulate_plot(state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, picture = tmp_path / "c", tmp_path / "cart.png"
    command = [state_problem("ocp = cart()"), "-o", str(folder), "--check", "--simulate", "20", "--plot", str(picture)]
    assert main(command) == 0
    out, err = said(capsys)
    assert err == ""
    assert {"cart.h", "cart.c", "cart.json"} <= {p.name for p in folder.iterdir()}
    assert f"{sum(path.stat().st_size for path in folder.iterdir()):,} bytes" in out
    assert "bytes of solver struct" in out
    assert "check passed" in out
    assert "20 samples" in out
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("example", ["crane", "fermentation"])
def test_check_of_the_augmented_lagrangian(example: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its gaps are polished until the cost is that of IPOPT."""
    file = Path(__file__).parents[2] / "examples" / f"{example}.py"
    command = [str(file), "-o", str(tmp_path / "c"), "--set", "algorithm=augmented_lagrangian", "--check"]
    assert main(command) == 0
    assert "check passed" in said(capsys)[0]


@pytest.mark.usefixtures("compiler")
def test_check_with_another_integrator_in_single_precision(
    state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        state_problem("ocp = cart()"),
        "-o",
        str(tmp_path / "c"),
        "--name",
        "cart_f32",
        "--set",
        "precision=single",
    ]
    assert main([*command, "--set", "integrator.tableau=Heun", "--set", "integrator.steps=3", "--check"]) == 0
    out, _ = said(capsys)
    assert "check passed" in out
    description = json.loads((tmp_path / "c" / "cart_f32.json").read_text())
    assert (description["name"], description["precision"]) == ("cart_f32", "single")
    assert description["options"]["integrator.tableau.name"] == "Heun"


@pytest.mark.usefixtures("compiler")
def test_a_check_at_the_goal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where nothing costs anything, soft rows included, IPOPT's barrier is no error of the code."""
    more = "ocp = cart(initial=0.0)\nocp.subject_to(-0.5, ocp.x, 0.5, soft=1000.0, name='soft')"
    passed = main([write_problem(tmp_path, more), "-o", str(tmp_path / "c"), "--check"]) == 0
    out, _ = said(capsys)
    assert passed, out
    assert "cost 0 " in out


@pytest.mark.usefixtures("compiler")
def test_a_check_that_fails(
    state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(check.LIMITS, "double", {"u": 0.0, "x": 0.0, "cost": 0.0})
    assert main([state_problem("ocp = cart()"), "-o", str(tmp_path / "c"), "--check"]) == 1
    assert "check FAILED" in said(capsys)[0]


def test_default_folder_and_the_full_report(
    state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([state_problem("ocp = cart()"), "--name", "wagon"]) == 0
    short, _ = said(capsys)
    assert (tmp_path / "out" / "wagon" / "wagon.c").exists()
    assert main([state_problem("ocp = cart()"), "--name", "wagon", "-v"]) == 0
    full, _ = said(capsys)
    assert "operations per call" not in short
    assert "operations per call" in full
    assert "fewest operations of a warm-started sample ..." in short
    assert "(full + dense_active_set: " in full


def test_list_options_names_every_component_and_field(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list-options"]) == 0
    out, _ = said(capsys)
    for seam, registry in REGISTRIES.items():
        for word, component in registry.items():
            assert f"--set {seam}={word} " in out
            for field in dataclasses.fields(component):
                assert f"{seam}.{field.name} = " in out
    for words in (
        "precision = double; one of double, single",
        "integrator.tableau = RK4; one of Euler, Midpoint, Heun, SSPRK3, RK4;",
        "integrator.steps = 2; an integer >= 1",
        "integrator.unroll = auto; one of auto, all, none",
        "hessian.regularization = mirror; one of project, mirror, none;",
        "hessian.regularization.level = reduced; one of reduced, stage",
        "algorithm.shift = auto; one of auto, None, repeat, periodic, resample",
        "online.weight = shared; one of fixed, shared, node",
    ):
        assert words in out


def words_listed(out: str) -> list[tuple[str, str]]:
    """Every KEY=VALUE of the listing: words, True and False, the default of the other options."""
    found = []
    for line in (line for line in out.splitlines() if "--set" not in line):
        key, _, rest = line.strip().partition(" = ")
        default, _, allowed = rest.partition("; ")
        words = allowed.partition("one of ")[2].partition(";")[0].split(", ") if "one of" in allowed else [default]
        found += [(key, word) for word in (["True", "False"] if allowed == "True or False" else words) if rest]
    return found


def taken(cls: Any, name: str, word: str) -> bool:
    """True if an option of a class has a rule that takes a word."""
    rule = rules(cls).get(name)
    return rule is not None and rule.takes(rule.convert(word))


def test_what_is_listed_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    """--set accepts exactly the words of --list-options, whichever component has the option."""
    assert main(["--list-options"]) == 0
    listed = words_listed(capsys.readouterr().out)
    assert len(listed) > 50
    for key, word in listed:
        seam, _, rest = key.partition(".")
        makers = [cls for cls in REGISTRIES.get(seam, {}).values() if rest.split(".")[0] in cls.__dataclass_fields__]
        owners = [cls for cls in makers if word == str(getattr(cls(), rest, word))] or makers
        owners = [cls for cls in owners if taken(cls, rest, word)] or owners
        component = owners[0].name if owners and rest else ""
        first = [(seam, component)] if component else []
        first += [("algorithm.sampling_time", "0.1")] if (key, word) == ("algorithm.shift", "resample") else []
        assert apply_settings(Options(), [*first, (key, word)]), (key, word)


# -- failures and warnings --------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("allowed", "status"), [([], 1), (["--allow-failures", "19"], 1), (["--allow-failures", "20"], 0)]
)
def test_samples_that_fail(
    allowed: list[str], status: int, state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A row that no control meets at node 1: all samples are relaxed, and the first is explained."""
    file = state_problem('ocp = cart()\nocp.subject_to(9, ocp.x[1], 10, at=[1], name="fast")')
    assert main([file, "-o", str(tmp_path / "c"), "--simulate", "20", *allowed]) == status
    out, err = said(capsys)
    assert "RELAXED 20" in out
    limit = f", {' '.join(allowed)}" if allowed else ""
    failed = f"simulation FAILED: 20 of 20 samples{limit}; first RELAXED: sample 0, t = 0 s: no plan meets "
    assert (failed in err) == bool(status)
    assert ("; row 'fast' at node 1 is violated by " in err) == bool(status)


@pytest.mark.usefixtures("compiler")
def test_warnings_are_said_once(state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On the error stream, not among the choices; also where --check exports another package."""
    norm = "import casadi as ca\nocp = cart(initial=0.0)\nocp.least_squares(ca.norm_2(ocp.x), weight=1)"
    main([state_problem(norm), "-o", str(tmp_path / "c"), "--check", "--set", "solve=False"])
    out, err = said(capsys)
    assert err.count("warning: cart: the first plan has no finite derivatives: the residual 'y_3' at nodes 0..4") == 1
    assert "no finite derivatives" not in out


# -- usage ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "the file that states the problem is missing"),
        (["p.py", "--plot", "x.png"], "--plot needs --simulate"),
        (["p.py", "--allow-failures", "3"], "--allow-failures needs --simulate"),
        (["p.py", "--simulate", "3", "--allow-failures", "-1"], "--allow-failures -1: expected a number of samples"),
        (["p.py", "--simulate", "0"], "expected at least one step"),
        (["p.py", "--simulate", "many"], "invalid int value: 'many'"),
        (["p.py", "--set", "steps"], "--set steps: expected KEY=VALUE"),
        (["p.py", "--set", "=3"], "expected KEY=VALUE"),
        (["p.py", "--no-such-flag"], "unrecognized arguments"),
        (["p.py", "--set", "=="], "expected KEY=VALUE"),
        (["p.py", "--simulate", "1000000000000"], "at most 1,000,000"),
        (["p.py", "--simulate", "3", "--plot", "x.docx"], "unknown format '.docx'; expected one of"),
        (["p.py", "--simulate", "3", "--plot", "no/such/folder/x.png"], "expected a file in a folder that exists"),
        (["p.py", "-o", ""], "--output '': expected a name that is not empty"),
        (["p.py", "-o", "a\0b"], "expected a name that is not empty"),
        (["p.py", "-o", "/dev/null"], "/dev/null is not a folder"),
        (["p.py", "-o", "x" * 300], "File name too long"),
        (["p.py", "--set", "a\nb\x1b"], "--set a b\\x1b: expected KEY=VALUE"),
    ],
)
def test_wrong_usage_is_2(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert message in said(capsys)[1]


def test_derivatives(state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The integrator of the file applies, its Hessian does not; outputs are an expression or a function."""
    stated = "from nmpc_codegen import RK4, ExplicitRungeKutta, GaussNewton\nocp = cart()\n"
    stated += "options = Options(ExplicitRungeKutta(RK4, steps=3), hessian=GaussNewton())\n"
    for outputs, name in (("outputs = ocp.x[0]", "a"), ("def outputs(): return ocp.x[0]", "b"), ("", "c")):
        command = [state_problem(stated + outputs), "--derivatives", "-o", str(tmp_path / name), "--name", "tools"]
        assert main(command) == 0
        assert "hessians_symmetric" in said(capsys)[0]
    texts = [(tmp_path / name / "tools.c").read_text(encoding="utf-8") for name in "abc"]
    assert texts[0] == texts[1]
    assert ["impulse_response" in text for text in texts] == [True, True, False]
    ocp = load_problem(Path(state_problem("ocp = cart()")))[0]
    expected = derivatives.generate(ocp, None, Options(ExplicitRungeKutta(RK4, steps=3)), "tools", second_order=True)
    assert texts[2] == expected["tools.c"]
    assert main([*command, "--set", "hessian=exact"]) == 1
    assert "options.hessian does not apply to derivatives" in said(capsys)[1]
    for flag in (["--check"], ["--simulate", "3"], ["--target", "native"], ["--max-ram", "1k"]):
        assert main([*command, *flag]) == 2
        assert f"{flag[0]} belongs to a controller and clashes with --derivatives" in said(capsys)[1]


def test_help_is_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert "--list-options" in said(capsys)[0]


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        ("", [], "defines no problem: expected an OCP called `ocp`, or a function problem() or"),
        ("one, two = cart(), cart()", [], "defines several problems (one, two); call the one to export `ocp`"),
        ("ocp = 3", [], "ocp is a int; expected OCP"),
        ("def problem():\n    return 3", [], "problem() returns int; expected OCP or (OCP, Options)"),
        ("ocp, options = cart(), 'fast'", [], "options is a str; expected Options"),
        ("ocp, options = cart(), lambda: 3", [], "options is a int; expected Options"),
        ("ocp = cart()\ndef options(shift):\n    return Options()", [], "options() cannot be called without arguments"),
        ("raise ValueError", [], "problem.py, line 15: ValueError: no message"),
        ("raise ValueError('a\\n  b\\x1b[31m')", [], "line 15: ValueError: a b\\x1b[31m"),
        (
            "class E(Exception):\n    def __str__(self): return 1 / 0\nraise E",
            [],
            "line 17: E: its message cannot be read",
        ),
        ("class E(BaseException): pass\nraise E('odd')", [], "line 16: E: odd"),
        ("def f(): f()\nf()", [], "line 15: RecursionError"),
        ("raise KeyboardInterrupt", [], "line 15: interrupted"),
        ("import sys; sys.exit('no')", [], "exit status no"),
        ("import sys; sys.exit()", [], "exit status 0"),
        ("import no_such_module", [], "line 15: ModuleNotFoundError: No module named 'no_such_module'"),
        ("x = '\0'", [], "problem.py"),
        ("ocp = cart()", ["--set", "integrator.steps=1000000000"], "ExplicitRungeKutta.steps: 1000000000; expected an"),
        ("ocp = cart()", ["--set", "integrator.steps=90000", "--set", "integrator.unroll=all"], "operations in a row"),
        ("ocp = cart()", ["--set", "hessian=exact", "--set", "integrator.steps=90000"], "goes backward over all steps"),
        ("ocp = cart()", ["--set", "integrator.steps=90000", "--check"], "--check"),
        (
            "ocp = cart()",
            ["--set", "qp.max_iterations=1e400", "--set", "qp=osqp"],
            "Osqp.max_iterations: inf; expected",
        ),
        ("ocp = cart()", ["--set", "precision=" + "(" * 5000], "Options.precision: '(((("),
        ("ocp = cart()", ["--set", "integrator.tableau.a=3"], "integrator.tableau has no option 'a'; it has none"),
        (
            "ocp = cart()",
            ["--set", "condensing=full", "--set", "qp=riccati_active_set"],
            "(--set qp=riccati_active_set)",
        ),
        ("ocp = OCP('cart', T=-1.0, N=5)", [], "problem.py, line 15: ProblemError"),
        ("x = 1 / 0", [], "problem.py, line 15: ZeroDivisionError: division by zero"),
        ("x = (", [], "problem.py, line 15: SyntaxError"),
        ("import sys; sys.exit(3)", [], "ended the program (exit status 3)"),
        ("ocp = cart()", ["--set", "qp=magic"], "there is no qp 'magic'; there is dense_active_set"),
        ("ocp = cart()", ["--set", "hessian=magic"], "there is no hessian 'magic'"),
        ("ocp = cart()", ["--set", "integrator.stepz=3"], "integrator has no option 'stepz'; there is tableau, steps"),
        ("ocp = cart()", ["--set", "integrator.steps=0"], "ExplicitRungeKutta.steps: 0; expected an integer >= 1"),
        ("ocp = cart()", ["--name", "3d"], "3d"),
    ],
)
def test_failures_are_1_without_traceback(
    state_problem: Any,
    tmp_path: Path,
    text: str,
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([state_problem(text), "-o", str(tmp_path / "c"), *arguments]) == 1
    _, err = said(capsys)
    assert message in err
    assert "Traceback" not in err


def test_verbose_shows_the_traceback(state_problem: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([state_problem("x = 1 / 0"), "-v"]) == 1
    assert "Traceback" in said(capsys)[1]


# -- odd surroundings -------------------------------------------------------------------------------------------------

ROOT = Path(__file__).parents[2]


def command(*arguments: str, where: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run the command as a separate process."""
    return subprocess.run(
        [sys.executable, "-m", "nmpc_codegen.cli", *arguments],
        cwd=where,
        env={**os.environ, "PYTHONPATH": str(ROOT / "src"), **environment},
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize(
    "environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}]
)
def test_ascii_terminal(environment: dict[str, str], state_problem: Any, tmp_path: Path) -> None:
    """Names and printed texts that the terminal cannot show are escaped; markup in a path has no effect."""
    state_problem("print('\u03c0')\nocp = cart()")
    done = command("problem.py", "-o", "\u03c0 [red]x[/]", where=tmp_path, **environment)
    assert done.returncode == 0, done.stderr
    assert b"[red]x[/]" in done.stdout
    assert b"\\u03c0" in done.stdout
    assert done.stderr == b""
    assert (tmp_path / "\u03c0 [red]x[/]" / "cart.c").exists()


def test_output_that_cannot_be_written(tmp_path: Path) -> None:
    """One sentence, which does not blame the problem file."""
    command = [sys.executable, "-m", "nmpc_codegen.cli", str(ROOT / "examples" / "crane.py"), "-o", str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    assert done.returncode == 1
    assert done.stderr == "error: the output cannot be written: No space left on device\n"


def test_reader_that_leaves(tmp_path: Path) -> None:
    """nmpc-export --list-options | head -0"""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "nmpc_codegen.cli", "--list-options"],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        stdout=write,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (1, b"")


@pytest.mark.few(3)
@pytest.mark.parametrize(
    "text",
    [
        "import sys; sys.stdout.close(); sys.__stdout__.close()",
        "import sys; sys.stdout.detach(); sys.__stdout__.detach()",
        "import sys; sys.stdout = sys.stderr = sys.argv = sys.path = None",
        "import os; os.chdir('/')",
        "import os; os.close(1)",
        "import warnings; warnings.simplefilter('error')",
        "import sys; sys.excepthook = sys.unraisablehook = None",
        "import numpy; numpy.seterr(all='raise')",
    ],
)
def test_what_the_file_does_to_the_interpreter_is_undone(text: str, state_problem: Any, tmp_path: Path) -> None:
    state_problem(f"ocp = cart()\n{text}")
    done = command("problem.py", "-o", "c", where=tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"cart in c" in done.stdout
    assert (tmp_path / "c" / "cart.c").exists()


def test_noise_of_the_file_is_one_line_each(state_problem: Any, tmp_path: Path) -> None:
    """Warnings, threads, finalisers and exit handlers that fail."""
    state_problem(
        "import atexit, threading, warnings\n"
        "class D:\n    def __del__(self): 1 / 0\n"
        "D()\n"
        "atexit.register(lambda: 1 / 0)\n"
        "thread = threading.Thread(target=lambda: 1 / 0); thread.start(); thread.join()\n"
        "warnings.warn('odd\\nthing')\n"
        "ocp = cart()"
    )
    done = command("problem.py", "-o", "c", where=tmp_path)
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    lines = done.stderr.decode().splitlines()
    assert len(lines) == 4, lines
    assert sum("ZeroDivisionError" in line for line in lines) == 3
    assert "problem.py, line 21: UserWarning: odd thing" in lines


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "it is a folder"),
        (b"", "defines no problem"),
        (bytes(range(256)), "Error"),
        (b"\0\0", "null bytes"),
        (b"x = '\xff'", "SyntaxError"),
        (b"(" * 1000, "SyntaxError"),
    ],
)
def test_files_that_are_no_programs(
    content: bytes | None, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "odd.py"
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    assert main([str(path)]) == 1
    _, err = said(capsys)
    assert message in err
    assert "odd.py" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("ocp.subject_to(-1, ocp.x, 1, label='x')", "lower, expr, upper, at, soft, name"),
        ("ocp.least_squares(ocp.x, 1.0, name='x')", "expr, weight, reference, names, scale_with_dt, scale"),
        ("Options(qpsolver=None)", "integrator, hessian, condensing, qp, "),
        ("OCP('a', n=3)", "name, T, N, intervals, time_unit"),
        ("dict(1, a=2)", ""),
        ("sorted([1], order=2)", ""),
    ],
)
def test_a_wrong_keyword_names_the_right_ones(
    call: str, expected: str, state_problem: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([state_problem(f"ocp = cart()\n{call}")]) == 1
    _, err = said(capsys)
    assert "TypeError" in err
    assert (f"; expected {expected}" in err) if expected else ("expected " not in err.partition("TypeError: ")[2][60:])


def test_an_exception_of_ours_names_its_stage(
    state_problem: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even an unexpected error is reported in one line."""
    monkeypatch.setattr("nmpc_codegen.compiler.lower", lambda *_: len(None))  # type: ignore[arg-type]
    assert main([state_problem("ocp = cart()")]) == 1
    _, err = said(capsys)
    assert "TypeError: object of type 'NoneType' has no len(), in nmpc_codegen/compiler.py (-v shows where)" in err


def test_no_such_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "nothing.py")]) == 1
    assert "there is no such file" in said(capsys)[1]


# -- parts ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "name", "steps"),
    [
        ("ocp = cart()", "cart", None),
        ("only = cart('only')", "only", None),
        ("ocp, other = cart('chosen'), cart('other')", "chosen", None),
        ("def build_ocp():\n    return cart('built')", "built", None),
        ("def problem():\n    return cart('returned')", "returned", None),
        ("from nmpc_codegen import ExplicitRungeKutta\ndef build_ocp():\n    return cart('two')\n"
         "def options(steps=6):\n    return Options(integrator=ExplicitRungeKutta(steps=steps))", "two", 6),
        ("from nmpc_codegen import ExplicitRungeKutta\n"
         "ocp, options = cart(), Options(integrator=ExplicitRungeKutta(steps=7))", "cart", 7),
        ("from nmpc_codegen import ExplicitRungeKutta\n"
         "def problem():\n    return cart('both'), Options(integrator=ExplicitRungeKutta(steps=5))", "both", 5),
    ],
)  # fmt: skip
def test_where_a_file_states_its_problem(state_problem: Any, text: str, name: str, steps: int | None) -> None:
    ocp, options, *_ = load_problem(Path(state_problem(text)))
    assert ocp.name == name
    assert (None if steps is None else options.integrator.steps) == steps


def test_a_problem_may_import_its_neighbours(tmp_path: Path) -> None:
    (tmp_path / "carts.py").write_text(CART)
    (tmp_path / "problem.py").write_text("from carts import cart\nocp = cart('imported')\n")
    assert load_problem(tmp_path / "problem.py")[0].name == "imported"


@pytest.mark.parametrize(("text", "value"), [("true", True), ("True", True), ("false", False)])
def test_truth_has_two_spellings(text: str, value: bool) -> None:
    found = apply_settings(Options(), [("online.dense_weight", text)]).online
    assert found.dense_weight is value


def test_errors_are_relative_to_the_size_of_each_component() -> None:
    reference = SimpleNamespace(u=np.array([[100.0], [0.0]]), x=np.zeros((3, 2)), cost=200.0)
    solution: Any = SimpleNamespace(u=reference.u + 1e-4, x=reference.x + 1e-5, cost=200.0 - 2e-6)
    errors = compare(solution, reference)
    assert errors == pytest.approx({"u": 1e-6, "x": 1e-5, "cost": 1e-8}, rel=1e-6)
    nothing = SimpleNamespace(u=np.zeros((2, 0)), x=np.zeros((3, 2)), cost=0.0)
    assert compare(nothing, nothing) == {"u": 0.0, "x": 0.0, "cost": 0.0}  # type: ignore[arg-type]


def test_load_problem_leaves_the_path_alone(state_problem: Any) -> None:
    before = list(sys.path)
    with pytest.raises(ProblemError):
        load_problem(Path(state_problem("")))
    assert sys.path == before


def test_where_the_economic_hessian_comes_from(
    state_problem: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The word alone has no numbers; what the error advises exports."""
    pytest.importorskip("clarabel")
    stated = "ocp = cart()\n"
    command = [state_problem("ocp = cart()"), "-o", str(tmp_path / "c"), "--set", "hessian=economic_gauss_newton"]
    assert main(command) == 1
    error = said(capsys)[1]
    advice = error.split("state ")[1].split(" in the problem file")[0]
    assert advice == "options = Options(hessian=tune(ocp).hessian())"
    imports = "from nmpc_codegen import Options\nfrom nmpc_codegen.economic import tune\n"
    assert main([state_problem(f"{imports}{stated}{advice}"), "-o", str(tmp_path / "c")]) == 0
