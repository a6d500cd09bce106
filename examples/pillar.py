"""A thousand flights past a pillar before the first real one: mass and lift differ, gusts push, sensors are noisy.

What it shows: a campaign, a verdict on every flight with an interval, the worst flight replayed, what a margin buys.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca

from nmpc_codegen import OCP
from nmpc_codegen.campaigns import Box, Campaign, Normal, Uniform, campaign

FLIGHTS = 1000
G, ARM = 9.81, 0.2


def build_ocp(margin: float = 0.0) -> OCP:
    """A planar drone that flies from the left of a pillar of 0.5 m to its right. ``margin``: how much wider the
    controller believes the pillar (m)."""
    ocp = OCP("pillar", T=2.0, N=20)
    x, z = ocp.state("x", unit="m", initial=-2.0), ocp.state("z", unit="m", initial=1.0)
    theta = ocp.state("theta", unit="rad")
    vx, vz = ocp.state("vx", unit="m/s"), ocp.state("vz", unit="m/s")
    omega = ocp.state("omega", unit="rad/s")
    left, right = ocp.control("left", unit="N"), ocp.control("right", unit="N")
    m = ocp.parameter("m", value=0.5, unit="kg", bounds=(0.35, 0.65))
    lift = ocp.parameter("lift", value=1.0, bounds=(0.9, 1.1))
    wide = ocp.parameter("wide", value=margin, unit="m")
    push = lift * (left + right) / m
    turn = lift * (left - right) * ARM / (0.02 * m)
    ocp.dynamics({x: vx, z: vz, theta: omega, vx: -push * ca.sin(theta), vz: push * ca.cos(theta) - G, omega: turn})
    hover = 0.5 * G / 2
    ocp.least_squares(
        ca.vertcat(x, z, theta, vx, vz, omega, left, right),
        weight=[10, 10, 1, 1, 1, 0.1, 0.1, 0.1],
        reference=[2, 1, 0, 0, 0, 0, hover, hover],
    )
    ocp.subject_to(0, left, 6)
    ocp.subject_to(0, right, 6)
    ocp.subject_to(0.5, ca.sqrt(x**2 + (z - 1.2) ** 2) - wide, ca.inf, name="pillar")
    return ocp


def fly(margin: float, flights: int = FLIGHTS) -> Campaign:
    """The campaign: plants have the pillar as it is, and other masses and motors than the controller knows."""
    return campaign(
        build_ocp(margin),
        flights,
        starts={"x": Box(-2.5, -1.5), "z": Box(0.5, 1.5), "theta": Normal(0.05)},
        parameters={"m": Box(0.4, 0.6), "lift": Box(0.95, 1.05), "wide": 0.0},
        disturbance={"vx": 0.03, "vz": 0.03, "omega": 0.05},
        noise=Uniform({"x": 0.01, "z": 0.01, "theta": 0.01}),
        success={"x": Box(1.6, 2.4), "z": Box(0.4, 1.6)},
        tolerance={"pillar": 0.01},
    )


def main(picture: str = "out/pillar.png") -> Campaign:
    """Fly without a margin and with one; draw which of the first flights are lost, and replay the worst of them."""
    bare = fly(0.0)
    print(bare.summary())
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    bare.plot_lost(picture)
    log = bare.replay(bare.worst(1)[0])
    nearest = min((x**2 + (z - 1.2) ** 2) ** 0.5 for x, z in log.x[:, :2])
    print(f"the worst flight again: {nearest:.3f} m from the middle of the pillar, of which 0.5 m are allowed\n")
    print("with a margin of 0.1 m:")
    wide = fly(0.1)
    print(wide.summary())
    return wide


if __name__ == "__main__":
    main(*sys.argv[1:])
