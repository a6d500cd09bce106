"""The contracts of texts see what stands in a unit for nothing, and functions that are too long."""

from __future__ import annotations

import pytest

from verification.contracts.text import (
    LONGEST,
    foreign_names,
    foreign_words,
    idle_arguments,
    idle_members,
    idle_statements,
    too_long,
)
from verification.rendered import lowered, texts
from verification.samples import SAMPLES


@pytest.mark.parametrize(
    "fault",
    [
        "#define ROW(s, k) (s)->x",
        "static int idle(int n)\n{\n    (void)n;\n    return 1;\n}",
        "static void nothing(void)\n{\n}",
        "static void leave(solver_t *s)\n{\n    s->x = 1;\n    return;\n}",
        "    memcpy(s->x, s->x, sizeof s->x);",
        "    s->x[0] = s->x[0];",
        "    const int k = N;",
        "    const int n = (N < N) ? NZ : NX;",
        "    if (0) {",
        "    s->x[NX + 0] = R(1);",
        "    if (s->x[0] > R(1) && !1) {",
        "    for (int i = 0; i < NX; i++) {\n        s->x[i] = R(1);\n        continue;\n    }",
        "    for (int i = 0; i < 1; i++) {",
        "/* The slack variables\n * of soft rows. */",
        "/* A coupled row. */",
        "/* In solve(). */",
        "/* See riccati_backward(). */",
    ],
)
def test_faults_are_seen(fault: str) -> None:
    sample = next(sample for sample in SAMPLES if sample.name == "crane without solve")
    module = lowered(sample)
    unit = f"{texts(sample)[f'{module.name}.c']}\n{fault}\n"
    assert [*idle_arguments(unit), *idle_statements(unit), *foreign_words(module, unit), *foreign_names(unit)]


def test_members_are_seen() -> None:
    header = "typedef struct crane_qp_s {\n    double H[2][2]; /* H */\n    double spare[3];\n} crane_qp_t;\n"
    assert idle_members(header, "q->H[0][0] = 1;", set()) == ["crane_qp_t.spare"]


def test_a_long_function_is_found() -> None:
    short = "".join(f"static void f_{n}(int a)\n{{\n    use(a);\n}}\n\n" for n in range(51))
    body = "    use(a);\n" * LONGEST
    assert too_long(f"{short}static void g(int a)\n{{\n{body}}}\n") == {"g": LONGEST + 3}
    assert too_long(f"{short}static void path_cost(int a)\n{{\n{body}}}\n") == {}
