"""Estimators: python -m benchmarks.estimation [--scale S] [--json FILE]

Moving horizon estimators beside the Kalman filter on linear plants, beside the extended Kalman filter and the estimate
from all measurements by IPOPT on three nonlinear ones, with bad sensors, and in closed loops. It ends with an exit
status of 1 if a figure is beyond its limit.
"""

from __future__ import annotations

from benchmarks.lib.alone import main

if __name__ == "__main__":
    raise SystemExit(main("estimation", __doc__, "estimation"))
