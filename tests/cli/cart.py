"""The problem file that most tests of the command line state."""

from __future__ import annotations

from pathlib import Path

CART = """\
import numpy as np
from nmpc_codegen import OCP, Options

def cart(name="cart", initial=1.0):
    ocp = OCP(name, T=1.0, N=5)
    p = ocp.state("p", unit="m", initial=initial)
    v = ocp.state("v", unit="m/s")
    a = ocp.control("a", unit="m/s^2")
    ocp.dynamics({p: v, v: a - 0.1 * v**3})
    ocp.least_squares(ocp.x, weight=np.diag([4.0, 1.0]))
    ocp.least_squares(a, weight=0.1 * np.eye(1), names=["effort"])
    ocp.terminal_least_squares(ocp.x, weight=10 * np.eye(2))
    ocp.subject_to(-2, a, 2)
    return ocp
"""


def write_problem(folder: Path, text: str) -> str:
    """Write a file with the cart and this text behind it; return its path."""
    path = folder / "problem.py"
    path.write_text(CART + text + "\n", encoding="utf-8")
    return str(path)
