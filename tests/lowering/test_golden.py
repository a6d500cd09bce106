"""The functions of a header, which firmware is written against, byte for byte. ``--update-golden`` rewrites them."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import pytest

from nmpc_codegen import OCP, DenseActiveSet, FullCondensing, Options, generate

GOLDEN = Path(__file__).parents[1] / "golden" / "header.h"


def test_header(request: pytest.FixtureRequest) -> None:
    """x' = u - p x; one control bound, one state bound, one path row, one terminal row."""
    ocp = OCP("golden", T=1.0, N=2)
    x, u, p = ocp.state("x", unit="m", initial=1.0), ocp.control("u"), ocp.parameter("p", value=0.5)
    ocp.dynamics({x: u - p * x})
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 2.0])
    ocp.terminal_least_squares(x, weight=[3.0])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-2, x, 2)
    ocp.subject_to(-3, x * u, 3, name="product")
    ocp.subject_to(-4, x * x, 4, at="end", name="square")
    header = generate(ocp, Options(condensing=FullCondensing(), qp=DenseActiveSet()))["golden.h"]
    text = header[header.index("typedef struct golden_solver") : header.index("/* ---- memory")]
    if request.config.getoption("--update-golden"):
        GOLDEN.write_text(text, encoding="utf-8")
    assert text == GOLDEN.read_text(encoding="utf-8"), "run pytest --update-golden and look at the difference"
