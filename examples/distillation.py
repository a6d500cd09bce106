"""Benzene and toluene in a column: reflux and boil-up hold the purity of both products.

What it shows: algebraic equations. The temperature of a tray is the bubble point of its liquid, 0 = g(x, T), which no
formula gives. The equations are stated as they are; the compiler solves them at the stages of an implicit scheme and at
the nodes, where temperatures stand in cost and rows like states. ``controller.z`` has them.

Equal molar overflow, constant holdups, Raoult's law with Antoine's vapour pressures at 760 mmHg (Skogestad, Trans.
IChemE 75 (1997), 539-562). Time in minutes, flows in mol/min.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

TRAYS, FEED_TRAY, HOLDUP = 8, 4, 5.0  # reboiler 0 and condenser among them; of both in units of that of a tray
TOP, BOTTOM, WARM = 0.9, 0.1, 104.0  # mole fractions of benzene; degC on tray 1
SAMPLES = 40


def vapour_pressure(a: float, b: float, c: float, T: ca.SX) -> ca.SX:
    """Antoine's equation, mmHg."""
    return ca.exp(np.log(10) * (a - b / (T + c)))


def build_ocp(N: int = 20) -> OCP:
    """60 min in N intervals."""
    ocp = OCP("distillation", T=60.0, N=N, time_unit="min")
    x = ocp.state("x", size=TRAYS, initial=np.linspace(BOTTOM, TOP, TRAYS))
    T = ocp.algebraic("T", size=TRAYS, initial=np.linspace(105, 83, TRAYS), unit="degC")
    L, V = ocp.control("L", unit="mol/min"), ocp.control("V", unit="mol/min")
    feed, fraction = ocp.parameter("feed", value=1.0, unit="mol/min"), ocp.parameter("fraction", value=0.5)

    benzene = vapour_pressure(6.90565, 1211.033, 220.79, T)
    toluene = vapour_pressure(6.95464, 1344.8, 219.482, T)
    ocp.algebraic_equation(x * benzene + (1 - x) * toluene - 760, name="bubble_point")
    y = x * benzene / 760

    liquid = [L + (i <= FEED_TRAY) * feed for i in range(TRAYS)]  # that leaves tray i downwards
    rates = [(liquid[1] * (x[1] - x[0]) - V * (y[0] - x[0])) / HOLDUP]
    for i in range(1, TRAYS - 1):
        entering = (L if i + 1 == TRAYS - 1 else liquid[i + 1]) * x[i + 1] + (i == FEED_TRAY) * feed * fraction
        rates.append(entering - liquid[i] * x[i] + V * (y[i - 1] - y[i]))
    rates.append(V * (y[TRAYS - 2] - x[TRAYS - 1]) / HOLDUP)
    ocp.dynamics({x: ca.vertcat(*rates)})

    ocp.least_squares(ca.vertcat(x[TRAYS - 1], x[0]), weight=1e3, reference=[TOP, BOTTOM])
    ocp.least_squares(ca.vertcat(L, V), weight=0.1, reference=[1.3, 1.8])
    ocp.terminal_least_squares(ca.vertcat(T[1], T[TRAYS - 2]), weight=0.1, reference=[103.0, 85.0])
    ocp.subject_to([0.5, 1.0], ca.vertcat(L, V), [4.0, 4.5])
    ocp.subject_to(-ca.inf, T[1], WARM, soft=(1.0, 1.0))
    return ocp


def draw(log: Log, path: Path) -> None:
    """Products, flows, and the temperatures of all trays."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2)
    axes[0, 0].plot(log.t, log.x[:, TRAYS - 1], label="top")
    axes[0, 0].plot(log.t, log.x[:, 0], label="bottom")
    axes[0, 0].set(ylabel="benzene (mole fraction)")
    axes[0, 0].legend(frameon=False)
    for j, name in enumerate(("reflux L", "boil-up V")):
        axes[1, 0].step(log.t[:-1], log.u[:, j], where="post", label=name)
    axes[1, 0].set(xlabel="time (min)", ylabel="flow (mol/min)")
    axes[1, 0].legend(frameon=False)
    for i in range(TRAYS):
        axes[0, 1].plot(log.t[:-1], log.z[:, i], color=f"C{i}")
    axes[0, 1].axhline(WARM, color="0.5", linestyle=":")
    axes[0, 1].set(xlabel="time (min)", ylabel="temperature of trays (degC)")
    for k in (0, 2, 5, len(log.u) - 1):
        axes[1, 1].plot(log.z[k], np.arange(TRAYS), ".-", label=f"{log.t[k]:.0f} min")
    axes[1, 1].set(xlabel="temperature (degC)", ylabel="tray")
    axes[1, 1].legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(picture: str = "out/distillation.png") -> Log:
    """From a column that separates badly, with richer feed after an hour."""
    controller = build(build_ocp())
    print(controller.description.report.choices[0])
    later = np.where(np.arange(SAMPLES) < SAMPLES // 2, 0.5, 0.6)
    log = simulate(controller, np.linspace(0.3, 0.7, TRAYS), SAMPLES, parameters={"fraction": later})
    print(log.summary())
    draw(log, Path(picture))
    return log


if __name__ == "__main__":
    main(*sys.argv[1:])
