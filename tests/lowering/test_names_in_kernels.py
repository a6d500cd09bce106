"""Names of the user in the C text: constants in kernels, places in the header, what only solve() calls."""

from __future__ import annotations

import re
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from examples import crane, quadrotor
from nmpc_codegen import OCP, Options, generate
from nmpc_codegen.ir.printing.c_style import CStyle
from nmpc_codegen.lowering.unit.pipeline import LAST_HEADING
from verification import quality
from verification.whole import closed_loop

#: Macros, functions, ports, buffers and constants of the unit, keywords, and names of the C library.
TAKEN = ("N", "R", "S", "NX", "t1", "cost", "clip", "gamma", "y1", "phi_12", "cos_q", "OK", "k", "s", "h", "linux")


def named(states: tuple[str, ...]) -> OCP:
    """A chain of integrators with a pendulum at its end."""
    ocp = OCP("taken", T=0.5, N=3)
    x = [ocp.state(name, initial=0.1) for name in states]
    u = ocp.control("u" if "u" not in states else "force")
    last = -ca.sin(x[0]) + u * ca.cos(x[0])
    ocp.dynamics(dict(zip(x, [*x[1:], last], strict=True)))
    ocp.least_squares(ca.vertcat(*x, u), weight=1.0)
    ocp.subject_to(-2, u, 2)
    return ocp


def test_names_that_the_unit_uses_itself() -> None:
    """The package compiles in silence and does the same as one with plain names, to the bit."""
    plain = generate(named(tuple(f"a{i}" for i in range(len(TAKEN)))))
    taken = generate(named(TAKEN))
    assert quality.warnings_of(taken, ("-O1",), ("C99",), "gcc") == ""
    assert closed_loop(taken) == closed_loop(plain)


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("value", [1 / 3, 1 / 6, -2 / 3, 0.15 / 3, np.pi, 5 / 7, 1e-300, 0.1])
def test_a_quotient_is_the_same_number(value: float, single: bool) -> None:
    real = np.float32 if single else np.float64
    p, _, q = CStyle("real", single).number(value).replace("F", "").partition(" / ")
    assert real(p) / real(q or "1") == real(value)


def test_quotients_are_for_the_tableau() -> None:
    assert CStyle("real", False).number(1 / 6) == "1.0 / 6.0"
    assert CStyle("real", False).number(0.15 / 6) == "0.3 / 12.0"
    assert CStyle("real", False).number(0.1234567890123456) == "0.1234567890123456"
    assert CStyle("real", False).number(0.1) == "0.1"


@pytest.mark.parametrize(("make", "late"), [(crane.build_ocp, "take_over"), (quadrotor.build_ocp, "take_over")])
def test_nothing_before_the_last_part_calls_it(make: Callable[[], OCP], late: str) -> None:
    sources = generate(make())
    first, _, last = sources[f"{quality.package_name(sources)}.c"].partition(LAST_HEADING)
    found = set(re.findall(r"^static [\w *]*?\b(\w+)\(", last, re.MULTILINE))
    code = re.sub(r"/\*.*?\*/|^#define (?:\\\n|[^\n])*", "", first, flags=re.DOTALL | re.MULTILINE)
    assert late in found
    assert "condense" in code or "riccati" in code
    assert not found & set(re.findall(r"\w+", code))


def test_every_target_has_solve_unless_it_is_left_out() -> None:
    for target in ("portable", "cortex-m7"):
        assert "crane_solve(" in generate(crane.build_ocp(), Options(target=target))["crane.h"]
        assert "crane_solve(" not in generate(crane.build_ocp(), Options(target=target, solve=False))["crane.h"]


def test_places_in_the_header() -> None:
    header = generate(crane.build_ocp())["crane.h"]
    assert re.search(r"#define CRANE_X_PHI 2 /\* rad, scale [\d.]+ \*/", header)
    assert re.search(r"#define CRANE_U_A 0 /\* m/s\^2, -1 \.\. 1, scale 1 \*/", header)
    assert "#define CRANE_Y_A 4" in header
    assert "#define CRANE_ROW_P_END 1 /* 0 .. 0 at node 10 */" in header


def test_a_caller_reads_what_he_needs_first() -> None:
    """Sizes, places, statuses, results, calls; then the memory of the solver."""
    header = generate(crane.build_ocp())["crane.h"]
    words = ("CRANE_NX 4", "CRANE_X_P 0", "CRANE_OK = 0", "} crane_stats_t;", "crane_init(", "crane_set_bounds(")
    words = (*words, "memory of the solver", "} crane_qp_t;", "struct crane_solver {")
    places = [header.index(word) for word in words]
    assert places == sorted(places)
