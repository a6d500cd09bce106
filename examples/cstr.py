"""Continuous stirred tank reactor with its jacket (Klatt and Engell), three set points in a row.

Houska, Ferreau and Diehl, Automatica 47 (2011), section 4.2 and figure 6. Time in seconds; the rates are per hour.
"""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np

from nmpc_codegen import OCP, Controller, Options, build, simulate

K10, K20, K30 = 1.287e12, 1.287e12, 9.043e9
E1, E2, E3 = -9758.3, -9758.3, -8560.0
H1, H2, H3 = 4.2, -11.0, -41.85
RHO, CP, KW, AR, VR, MK, CPK, CA0, TH0 = 0.9342, 3.01, 4032.0, 0.215, 10.0, 5.0, 2.0, 5.1, 104.9

# (cA, cB, th, thK, u1, u2); the second is out of reach because of th >= 98 and thK >= 92
SET_POINTS = (
    np.array([2.1402105, 1.0903044, 114.1910844, 112.9065929, 14.19, -1113.5]),
    np.array([3.51744722, 0.74003328, 87.00164887, 79.8045743, 8.256, -6239.0]),
    np.array([1.67416, 1.03579, 113.378, 112.094, 8.6133, -1113.5]),
)
START = np.array([1.0, 0.5, 100.0, 100.0])
SAMPLING = 5.0


def build_ocp(set_point: int = 0, N: int = 10, state_bounds: bool = True) -> OCP:
    """T = 1500 s in N intervals, two RK4 steps each; reference: one of the set points."""
    ocp = OCP("cstr", T=1500.0, N=N)
    cA = ocp.state("cA", unit="mol/l", initial=START[0])
    cB = ocp.state("cB", unit="mol/l", initial=START[1])
    th = ocp.state("th", unit="degC", initial=START[2])
    thK = ocp.state("thK", unit="degC", initial=START[3])
    u1 = ocp.control("u1", unit="1/h")
    u2 = ocp.control("u2", unit="kJ/h")

    k1, k2, k3 = (k * ca.exp(E / (273.15 + th)) for k, E in ((K10, E1), (K20, E2), (K30, E3)))
    heat = (k1 * cA * H1 + k2 * cB * H2 + k3 * cA**2 * H3) / (RHO * CP)
    ocp.dynamics(
        {
            cA: (u1 * (CA0 - cA) - k1 * cA - k3 * cA**2) / 3600,
            cB: (-u1 * cB + k1 * cA - k2 * cB) / 3600,
            th: (u1 * (TH0 - th) + KW * AR / (RHO * CP * VR) * (thK - th) - heat) / 3600,
            thK: (u2 + KW * AR * (th - thK)) / (MK * CPK) / 3600,
        }
    )
    reference = SET_POINTS[set_point]
    Q = [0.2, 1.0, 0.5, 0.2]
    ocp.least_squares(ca.vertcat(ocp.x, u1, u2), weight=[*Q, 0.5, 5e-7], reference=reference)
    ocp.terminal_least_squares(ocp.x, weight=10 * np.array(Q), reference=reference[:4])
    ocp.subject_to(3, u1, 35)
    ocp.subject_to(-9000, u2, 0)
    if state_bounds:
        ocp.subject_to(98, th, np.inf)
        ocp.subject_to(92, thK, np.inf)
    return ocp


def set_point(controller: Controller, index: int) -> None:
    """Hand a set point to the controller."""
    controller.set_reference(SET_POINTS[index])
    controller.set_terminal_reference(SET_POINTS[index][:4])


def main(picture: str = "out/cstr.png") -> None:
    """Figure 6: three set points over 3000 s each, sampled every 5 s."""
    controller = build(build_ocp(), Options())

    def schedule(k: int, ctrl: Controller) -> None:
        if k % 600 == 0:
            set_point(ctrl, k // 600)

    log = simulate(controller, START, steps=1800, dt=SAMPLING, reference=schedule)
    print(log.summary())
    log.plot(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
