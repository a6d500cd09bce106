"""Stiff models and algebraic equations: python -m benchmarks.stiff [--scale S] [--json FILE]

Orders and derivatives of the implicit schemes, stiff problems against IPOPT and in closed loops, and what implicit
schemes cost beside explicit ones; the same of algebraic equations, and what is left of them in long loops. It ends with
an exit status of 1 if a figure is beyond its limit.
"""

from __future__ import annotations

from benchmarks.lib.alone import main

if __name__ == "__main__":
    raise SystemExit(main("stiff", __doc__, "stiff", "algebraic"))
