"""Fast charge of a lithium-ion cell: as much current as voltage and temperature allow.

What it shows: a stiff model. The double layer settles in tens of milliseconds, the particle and the housing in minutes,
and an interval of the plan lasts 20 s. Nothing is said of integration: at export the compiler finds that RK4 would need
hundreds of steps per interval and chooses an implicit scheme; the report says why.

The electrode is one sphere, in which lithium diffuses (single particle model, Santhanagopalan, Guo, Ramadass and White,
J. Power Sources 156 (2006), 620-628), here in finite volumes; Butler and Volmer's law connects the overpotential with
the current, and two masses take up the heat. Time in seconds.
"""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from nmpc_codegen import OCP, build, simulate
from nmpc_codegen.runtime.loops.simulate import Log

SHELLS, CAPACITY = 6, 3.0  # Ah
CEILING, WARM = 4.15, 40.0  # V, degC
AMBIENT, TARGET = 25.0, 0.8  # degC, mean filling
SAMPLES = 45


def build_ocp(N: int = 30) -> OCP:
    """600 s in N intervals."""
    ocp = OCP("fast_charge", T=600.0, N=N)
    c = ocp.state("c", size=SHELLS, initial=np.full(SHELLS, 0.3))  # filling, from the centre to the surface
    eta = ocp.state("eta", unit="V")
    core, skin = (ocp.state(name, initial=AMBIENT, unit="degC") for name in ("core", "skin"))
    current = ocp.control("I", unit="A")
    R = ocp.parameter("R", value=0.03, bounds=(0.02, 0.05), unit="Ohm")

    edges = np.linspace(0, 1, SHELLS + 1)
    volume, area = np.diff(edges**3) / 3, edges**2
    diffusion = 2e-3 * ca.exp(0.02 * (core - AMBIENT))
    inner = [diffusion * area[j] * (c[j] - c[j - 1]) * SHELLS for j in range(1, SHELLS)]
    flux = [0, *inner, current / CAPACITY / 3600]
    surface = c[SHELLS - 1]
    exchange = 4 * ca.exp(0.03 * (core - AMBIENT)) * ca.sqrt((surface * (1 - surface)) ** 2 + 1e-2)
    transfer = exchange * ca.sinh(20 * eta)
    heat = current**2 * R + eta * transfer
    ocp.dynamics(
        {
            c: ca.vertcat(*((flux[j + 1] - flux[j]) / volume[j] for j in range(SHELLS))),
            eta: (current - transfer) / 0.2,
            core: (heat - (core - skin) / 2.0) / 60.0,
            skin: ((core - skin) / 2.0 - (skin - AMBIENT) / 3.0) / 10.0,
        }
    )
    mean = sum(float(v) * c[j] for j, v in enumerate(volume)) * 3
    ocp.least_squares(ca.vertcat(mean, current), weight=[100, 0.01], reference=[TARGET, 0])
    ocp.subject_to(-5, current, 10)
    ocp.subject_to(-ca.inf, 3.4 + 0.8 * surface + eta + R * current, CEILING, name="voltage")
    ocp.subject_to(-ca.inf, core, WARM, soft=(50, 10))
    return ocp


def voltage(log: Log) -> np.ndarray:
    """Of the terminals, at every sample."""
    found: np.ndarray = 3.4 + 0.8 * log.x[:-1, SHELLS - 1] + log.x[:-1, SHELLS] + 0.03 * log.u[:, 0]
    return found


def draw(log: Log, path: Path) -> None:
    """Current and voltage, temperatures, and the filling of the shells over the radius."""
    t = log.t[: len(log.u)] / 60
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2)
    axes[0, 0].step(t, log.u[:, 0], where="post")
    axes[0, 0].set(ylabel="current (A)")
    axes[0, 1].plot(t, voltage(log))
    axes[0, 1].axhline(CEILING, color="0.5", linestyle=":")
    axes[0, 1].set(ylabel="voltage (V)")
    for i, name in ((SHELLS + 1, "core"), (SHELLS + 2, "skin")):
        axes[1, 0].plot(t, log.x[:-1, i], label=name)
    axes[1, 0].set(xlabel="time (min)", ylabel="temperature (degC)")
    axes[1, 0].legend(frameon=False)
    for k in (0, 1, 5, 15, len(log.u)):
        axes[1, 1].plot((np.arange(SHELLS) + 0.5) / SHELLS, log.x[k, :SHELLS], ".-", label=f"{log.t[k] / 60:.2g} min")
    axes[1, 1].set(xlabel="radius", ylabel="filling")
    axes[1, 1].legend(frameon=False, fontsize="small", loc="upper left", bbox_to_anchor=(1, 1))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(picture: str = "out/fast_charge.png") -> Log:
    """Charge from 30 % and draw it."""
    controller = build(build_ocp())
    print(controller.description.report.choices[0])
    start = np.array([*[0.3] * SHELLS, 0.0, AMBIENT, AMBIENT])
    log = simulate(controller, start, SAMPLES, warm_start=True)
    print(log.summary())
    draw(log, Path(picture))
    return log


if __name__ == "__main__":
    main(*sys.argv[1:])
