"""Loops over nothing and conditions on constants are not in a unit."""

from __future__ import annotations

import pytest

from nmpc_codegen.lowering.pruning.fold import Constants, folded, wrapped

CONSTANTS = Constants(
    sizes={"NG": 0, "NE": 2, "N": 5, "NU": 1, "SOFT": 0, "HARD": 1},
    tables={"row_first": (0, 0), "side": (-1, -1), "offset": (0, 4), "index": (0, 3)},
    members=frozenset({("qp", "held"), ("solver", "curved"), ("solver", "held")}),
    kernels=frozenset({"COUPLED_ROWS"}),
)
TYPES = {"s": "solver", "q": "qp", "r": "riccati"}


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("NG", False),
        ("!NG", True),
        ("NG > 0 && is_held(s, m)", False),
        ("HARD && is_held(s, m)", "is_held(s, m)"),
        ("NE > 0 && (SOFT || !s->a)", "!s->a"),
        ("SOFT || HARD", True),
        ("s->a || HARD", True),
        ("next(s) && NG", "next(s) && NG"),  # the call may have effects
        ("side[m] < 0", True),
        ("index[m] >= 0", True),
        ("index[m] > 1", "index[m] > 1"),
        ("side[index[m]] < 0", "side[index[m]] < 0"),
        ("offset[k] < offset[k + 1]", "offset[k] < offset[k + 1]"),  # entries differ from each other
        ("k < N", "k < N"),
        ("x < R(0)", "x < R(0)"),
        ("(HARD && a) || (NG && b)", "a"),
    ],
)
def test_conditions(condition: str, expected: bool | str) -> None:
    assert CONSTANTS.reduced(condition) == expected


@pytest.mark.parametrize(
    ("head", "runs"),
    [
        ("int m = 0; m < NG; m++", False),
        ("m = 0; m < NG; ++m", False),
        ("int m = 0; m < NG && s->a; m++", False),
        ("int m = NG - 1; m >= 0; m--", False),
        ("int m = row_first[k]; m < row_first[k + 1]; m++", False),
        ("int i = offset[k]; i < offset[k + 1]; i++", True),
        ("int e = 0; e < NE; e++", True),
        ("int k = 1; k < NU; k++", False),
        ("int n = m + 1; n < NE; n++", True),
        ("int k = N; k >= 0; k--", True),
    ],
)
def test_loops(head: str, runs: bool) -> None:
    assert CONSTANTS.never_runs(head) is not runs
    lines = ["    a = 1;", "    /* rows */", f"    for ({head}) {{", "        b = a;", "    }", "    c = a;"]
    assert folded(lines, CONSTANTS, TYPES) == (lines if runs else [lines[0], lines[-1]])


def test_chains() -> None:
    def chain(first: str, second: str) -> list[str]:
        head = [f"    if ({first}) {{", "        a = 1;", f"    }} else if ({second}) {{", "        a = 2;"]
        return folded([*head, "    } else {", "        a = 3;", "    }", "    b = a;"], CONSTANTS, TYPES)

    assert chain("HARD", "s->b") == ["    a = 1;", "    b = a;"]
    assert chain("NG", "HARD") == ["    a = 2;", "    b = a;"]
    assert chain("NG", "SOFT") == ["    a = 3;", "    b = a;"]
    assert chain("NG", "s->b")[0] == "    if (s->b) {"
    assert chain("s->b", "HARD")[2:4] == ["    } else {", "        a = 2;"]


def test_nothing_follows_a_return() -> None:
    lines = ["    if (HARD) { /* always */", "        return 1;", "    }", "    return s->held[0];"]
    assert folded(lines, CONSTANTS, TYPES) == ["        return 1;".removeprefix("    ")]


def test_statements_on_what_is_absent() -> None:
    lines = [
        "    s->qp.held[m] = R(0);",
        "    memset(s->curved, 0, sizeof s->curved);",
        "    COUPLED_ROWS(s, s->coupled.r,",
        "        s->coupled.J);",
        "    s->held[m] = next(s);",  # the call may have effects
        "    s->held[n++] = R(0);",
        "    COUPLED_ROWS(s, n++);",
        "    s->weight = s->other;",
        "    r->held[m] = R(0);",  # of another struct
    ]
    assert folded([*lines, "    q->held[m] = R(0);"], CONSTANTS, TYPES) == lines[4:]


def test_a_part_is_c_before_it_is_folded() -> None:
    """A variable does not outlive the block that declares it, although the block loses its braces."""
    block = ["    if (HARD) {", "        const int n = s->a;", "        s->b = n;", "    }"]
    assert folded([*block, "    for (int n = 0; n < NE; n++) {", "        s->b += n;", "    }"], CONSTANTS, TYPES)
    for use in ("    s->c = n;", "    if (n > 0) {"):
        with pytest.raises(ValueError, match="n: declared in a block and used after it"):
            folded([*block, use, *(["        s->c = 1;", "    }"] if use.endswith("{") else [])], CONSTANTS, TYPES)
    assert folded([*block, "    s->n = 1;"], CONSTANTS, TYPES)
    rows = [
        "    if (HARD) {",
        "        real_t(*Q)[NE] = s->Q;",
        "        s->b = Q[0][0];",
        "    }",
        "    s->c = Q[0][0];",
    ]
    with pytest.raises(ValueError, match="Q: declared in a block and used after it"):
        folded(rows, CONSTANTS, TYPES)


def test_long_lines_are_broken() -> None:
    line = f"    if ({' && '.join(['condition'] * 15)}) {{"
    assert all(len(part) <= 120 for part in wrapped(line))
    assert " ".join(part.strip() for part in wrapped(line)) == line.strip()
