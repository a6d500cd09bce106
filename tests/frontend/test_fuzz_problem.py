"""Any sequence of calls, with good and bad arguments, either gives a consistent problem or raises ProblemError.

Any problem file, through the command line, leads to a package or to a message about the file, never to an unintended
exception of the library.
"""

from __future__ import annotations

import io
import random
import re
import tokenize
import traceback
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import nmpc_codegen
from nmpc_codegen import cli
from nmpc_codegen.cli import command
from nmpc_codegen.errors import NmpcError, ProblemError, ProblemWarning
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.ocp import OCP
from nmpc_codegen.frontend.problem import Problem

NAMES = ["x", "r", "u", "w", "q", "X", "r_0", "r[0]", "int", "1a", "", "ü", None, 3]
NUMBERS = [
    0,
    1,
    -1,
    2.5,
    1e300,
    np.inf,
    -np.inf,
    np.nan,
    None,
    "1",
    True,
    1j,
    [],
    [1, 2],
    [[1, 2], [3, 4]],
    np.eye(2),
    np.eye(3),
    np.ones((2, 1)),
    ca.DM([1, 2]),
    ca.SX(1),
    ca.MX(1),
    object(),
    {},
    [None],
    np.array([None]),
]
NODES = ["path", "start", "end", "middle", 3, None, [], [0], [1, 2], range(4), range(9), [-1], [1.5], "", {1}, object()]
SOFT = [None, (1, 0), (0, 1), (0, 0), (-1, 1), 1.0, "ab", [1, 2], (1, None), (1, 2, 3), np.array([1.0, 2.0])]
FLAGS = [True, False, True, False, None, 1]
SIZES = [None, None, 1, 2, 0, -1, 2.0, "2"]

FOREIGN = ca.SX.sym("foreign")


def expressions(ocp: OCP) -> list[Any]:
    """Expressions in the declared symbols, and objects that are no expressions."""
    symbols = [s for s in (ocp.x, ocp.u, ocp.p, ocp.x_start, ocp.x_end) if s.numel()]
    elements = [s[i] for s in symbols for i in range(s.numel())]
    made = [
        f(e) for e in elements for f in (ca.sin, ca.floor, lambda e: e * e, lambda e: e / 0, lambda e: 0 * e, ca.erfinv)
    ]
    pairs = [a * b for a, b in pairwise(elements)]
    mx = [ca.MX.sym("x"), ca.MX.sym("x", 2) * 2, ca.MX.sym("r", 2), ca.inv_node(ca.MX.eye(2))]
    return [*symbols, *elements, *made, *pairs, *mx, FOREIGN, ca.horzcat(*elements), list(elements), 0, 1, *NUMBERS[5:]]


def call(ocp: OCP, draw: Any) -> None:
    """One call with arguments of any quality."""

    def one(values: list[Any]) -> Any:
        return values[draw(st.integers(0, len(values) - 1))]

    def expr() -> Any:
        return one(expressions(ocp))

    def number() -> Any:
        return one(NUMBERS)

    def a_mapping() -> Any:
        keys = [k for k in (*NAMES, *(ocp.x[i] for i in range(ocp.x.numel())), 2 * FOREIGN) if k is not None]
        return {one(keys): expr() for _ in range(draw(st.integers(0, 3)))}

    def periodic(e: Any) -> None:
        ocp.boundary(0, ocp.at_start(e) - ocp.at_end(e), 1)

    calls = [
        lambda: ocp.state(one(NAMES), size=one(SIZES), initial=number()),
        lambda: ocp.control(one(NAMES), size=one(SIZES)),
        lambda: ocp.parameter(one(NAMES), size=one(SIZES), value=number(), unit=one(["", "m", 1])),
        lambda: ocp.dynamics(one([a_mapping(), expr()]), discrete=one(FLAGS)),
        lambda: ocp.dynamics({ocp.x[i]: ca.cos(ocp.x[i]) for i in range(ocp.x.numel())}),
        lambda: ocp.least_squares(expr(), number(), reference=number(), names=one([*NAMES, ["a", "b"], ["a", "a"]])),
        lambda: ocp.least_squares(expr(), 1, scale_with_dt=one(FLAGS)),
        lambda: ocp.terminal_least_squares(expr(), one([1, number()])),
        lambda: ocp.stage_cost(expr(), integrate=one(FLAGS), scale_with_dt=one(FLAGS)),
        lambda: ocp.terminal_cost(expr()),
        lambda: ocp.start_cost(expr()),
        lambda: ocp.start_least_squares(expr(), one([1, number()]), names=one([None, *NAMES])),
        lambda: ocp.subject_to(number(), expr(), number(), at=one(NODES), soft=one(SOFT), name=one([None, *NAMES])),
        lambda: ocp.subject_to(-1, expr(), 1, at=one(NODES)),
        lambda: ocp.boundary(0, expr(), number(), soft=one(SOFT)),
        lambda: periodic(expr()),
        lambda: ocp.free_initial(one([*NAMES, expr()])),
        lambda: ocp.accumulator(expr()),
        lambda: ocp.cyclic(*ocp.states),
    ]
    one(calls)()


def consistent(problem: Problem) -> None:
    """Properties on which every later stage relies."""
    nx, nu, N = problem.nx, problem.nu, problem.N
    assert len(problem.dt) == N
    assert problem.dynamics.size1_out(0) == nx
    assert (problem.path.nu, problem.terminal.nu) == (nu, 0)
    for stage in (problem.path, problem.terminal):
        assert stage.weight.shape == (stage.ny, stage.ny)
        assert np.isfinite(stage.weight).all()
        assert len(stage.y_names) == len(stage.scale_with_dt) == len(stage.reference) == stage.ny
        assert len(stage.h_names) == stage.nh
    assert len({row.name for row in problem.rows}) == len(problem.rows)
    for row in problem.rows:
        assert row.lower <= row.upper
        sizes = {"control": nu, "state": nx, "general": problem.path.nh}
        if row.kind in sizes:
            assert row.index < sizes[row.kind]
        if row.kind == "general":
            assert (row.index >= 0) == (row.nodes[0] < N)
            assert (row.index_terminal >= 0) == (row.nodes[-1] == N)


def speaks(error: ProblemError) -> None:
    """An error message is a sentence."""
    assert len(str(error)) > 20


def random_ocp(draw: Any) -> OCP:
    T = draw(st.sampled_from([1.0, None, 0.0, np.nan, "1", [1]]))
    count = draw(st.sampled_from([3, 1, 3, 0, None, 2.0]))
    return OCP(draw(st.sampled_from(["a", "time", "a b"])), T=T, N=count)


@settings(max_examples=140, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_only_problem_errors(data: st.DataObject) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        try:
            ocp = random_ocp(data.draw)
        except ProblemError:
            ocp = OCP("a", T=1.0, N=3)
        if data.draw(st.booleans()):
            ocp.state("x")
            ocp.state("r", size=2)
            ocp.control("u")
            ocp.parameter("q")
        for _ in range(data.draw(st.integers(1, 12))):
            try:
                call(ocp, data.draw)
            except ProblemError as error:
                speaks(error)
        try:
            problem = classify(ocp)
        except ProblemError as error:
            speaks(error)
        else:
            consistent(problem)


@settings(max_examples=70, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_mutations_of_a_whole_problem(data: st.DataObject) -> None:
    """A valid problem, then a few random calls: still consistent, or a ProblemError."""
    ocp = OCP("a", T=1.0, N=3)
    x, r, u = ocp.state("x"), ocp.state("r", size=2), ocp.control("u")
    ocp.dynamics({x: u, "r": ca.vertcat(r[1], x)})
    ocp.least_squares(ca.vertcat(x, u), 1)
    consistent(classify(ocp))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        for _ in range(data.draw(st.integers(1, 6))):
            try:
                call(ocp, data.draw)
                consistent(classify(ocp))
            except ProblemError as error:
                speaks(error)


# Problem files, through the command line ------------------------------------------------------------------------------

FILE = """\
import casadi as ca
import numpy as np
from nmpc_codegen import OCP, ExplicitRungeKutta, GaussNewton, Heun, Online, Options, RealTimeIteration

ocp = OCP("fuzzed", intervals=[0.1, 0.1, 0.2])
q = ocp.state("q", unit="rad", initial=1.0)
r = ocp.state("r", size=2, initial=[0.5, 0.0])
u = ocp.control("u", unit="N")
k = ocp.parameter("k", value=0.3)
g = ocp.parameter("g", size=2, value=[1.0, 2.0])
ocp.dynamics({q: r[0], "r": ca.vertcat(-g[0] * ca.sin(q) + u, -k * r[1])})
ocp.least_squares(ca.vertcat(q, r), weight=[1.0, 0.1, 0.1], reference=[0.1, 0.0, 0.0], names=["q", "a", "b"])
ocp.least_squares(u, weight=0.2, scale_with_dt=True)
ocp.terminal_least_squares(ca.vertcat(ca.sin(q), r), weight=np.diag([3.0, 1.0, 1.0]))
ocp.subject_to(-1, u, 1)
ocp.subject_to([-2, -3], r, 3, name="box")
ocp.subject_to(-4, q + g[1] * r[0], np.inf, at="end", name="gate")
ocp.subject_to(0, u * r[1], 5, at=(0, 2), name="power")
options = Options(
    integrator=ExplicitRungeKutta(Heun, steps=2),
    hessian=GaussNewton(),
    algorithm=RealTimeIteration(shift=None),
    online=Online(reference="node", weight="shared", bounds="node", parameter="fixed", dense_weight=False),
    precision="double",
)
"""

REPLACEMENTS = {
    tokenize.NUMBER: ["0", "-1", "1e308", "1e-320", "100", "None", "'1'", "True", "np.nan", "np.inf", "1j", "[]"],
    tokenize.STRING: ["''", "'u'", "'q'", "'r[0]'", "'end'", "'path'", "'int'", "'node'", "'fixed'", "None", "7"],
    tokenize.NAME: ["q", "r", "u", "k", "g", "ocp", "np", "ca", "None", "ocp.x", "OCP", "Heun", "control", "size"],
    tokenize.OP: ["+", "*", "/", "-", ",", "**", "@", "==", "<"],
}


def mutated(seed: int) -> str:
    """The file with one to three mutations: a token replaced, a line dropped, doubled or moved, an argument dropped."""
    rng = random.Random(seed)
    text = FILE
    for _ in range(rng.randint(1, 3)):
        lines = text.splitlines(keepends=True)
        first = 4  # below the imports
        kind = rng.choice(["token", "token", "token", "drop", "double", "move", "argument"])
        at, to = rng.randrange(first, len(lines)), rng.randrange(first, len(lines))
        if kind == "token":
            text = "".join(lines[:first]) + with_another_token("".join(lines[first:]), rng)
        elif kind == "argument":
            lines[at] = re.sub(r", [a-z_]*=?[^,()]*(?=[,)])", "", lines[at], count=1)
            text = "".join(lines)
        else:
            line = lines[at] if kind == "double" else lines.pop(at)
            if kind != "drop":
                lines.insert(to, line)
            text = "".join(lines)
    return text


def with_another_token(text: str, rng: random.Random) -> str:
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    except (tokenize.TokenError, IndentationError):
        return text
    token = rng.choice([t for t in tokens if t.type in REPLACEMENTS])
    lines = text.splitlines(keepends=True)
    row, (start, end) = token.start[0] - 1, (token.start[1], token.end[1])
    lines[row] = lines[row][:start] + rng.choice(REPLACEMENTS[token.type]) + lines[row][end:]
    return "".join(lines)


def meant(error: BaseException, file: Path) -> bool:
    """True for an error of ours, and for one that Python raises in the file itself or in code that the file calls."""
    package = Path(nmpc_codegen.__file__).parent
    found = traceback.extract_tb(error.__traceback__)
    frames = [Path(f.filename) for f in found if f.name != "__getattr__"]  # which explains a missing attribute
    ours = [f for f in frames if f == file or package in f.parents]
    syntax = isinstance(error, SyntaxError) and error.filename == str(file)
    return isinstance(error, NmpcError) or syntax or (bool(ours) and ours[-1] == file)


@pytest.mark.few(2)
@pytest.mark.parametrize("block", range(4))
def test_mutated_files_through_the_command_line(
    block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    errors: list[BaseException] = []
    message = command.message
    monkeypatch.setattr(command, "message", lambda error, problem: (errors.append(error), message(error, problem))[1])
    outcomes = {0: 0, 1: 0}
    for seed in range(50 * block, 50 * (block + 1)):
        file = tmp_path / f"problem_{seed}.py"
        file.write_text(mutated(seed), encoding="utf-8")
        errors.clear()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            status = cli.main([str(file), "-o", str(tmp_path / f"out_{seed}")])
        outcomes[status] += 1
        said = capsys.readouterr().err
        assert "Traceback" not in said
        assert len(errors) == status
        for error in errors:
            assert meant(error, file), f"{seed}: {error!r}\n" + "".join(traceback.format_exception(error))
            assert len(said.split()) > 3
    assert min(outcomes.values()) >= 3, outcomes


def test_the_unmutated_file(tmp_path: Path) -> None:
    (tmp_path / "problem.py").write_text(FILE, encoding="utf-8")
    assert cli.main([str(tmp_path / "problem.py"), "-o", str(tmp_path / "out")]) == 0


def test_an_exception_inside_the_library_is_not_meant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Test of the judge above: it blames the library for unintended exceptions, not the file for its own mistakes."""
    file = tmp_path / "problem.py"
    errors: list[BaseException] = []
    monkeypatch.setattr(command, "message", lambda error, problem: (errors.append(error), "message")[1])
    for text in (FILE.replace("k = ocp", "k = 1 + None; ocp"), FILE.replace("N=", "M="), FILE.replace("0.2, ", "0.2(")):
        file.write_text(text, encoding="utf-8")
        cli.main([str(file), "-o", str(tmp_path / "out")])
    assert all(meant(error, file) for error in errors)
    errors.clear()
    file.write_text(FILE, encoding="utf-8")
    monkeypatch.setattr(nmpc_codegen.compiler, "classify", lambda ocp: len(None))  # type: ignore[arg-type]
    cli.main([str(file), "-o", str(tmp_path / "out")])
    assert [meant(error, file) for error in errors] == [False]
