"""Poles of the model that the explicit scheme does not damp are found by differences of simulated steps.

A step of length t from node k has the Jacobian J(t) = dPhi_t / dx. For a t far below all time constants, ln(mu) / t are
the poles of the model, for the eigenvalues mu of J(t); over a step of the scheme, an eigenvalue beyond the unit circle
that no growing pole explains is a damped mode that the scheme makes grow.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nmpc_codegen.package.program import Array
from nmpc_codegen.runtime.memory import Memory

#: Length of a short step, relative to a step of the scheme; finite difference, relative to the scale of a state.
SHORT, DIFFERENCE = 1e-3, 1e-5
#: Poles with a decay rate above DAMPED times their magnitude count as damped; growth below SLACK counts as rounding.
DAMPED, SLACK = 1e-3, 1e-3
#: Bound on |lambda| h up to which every scheme in use is stable; largest number of steps that is proposed.
SAFE, MOST_STEPS = 1.5, 1000
#: Number of steps above which an implicit scheme costs less.
STIFF = 6


def unstable_poles(ctrl: Memory) -> Iterator[str]:
    """Yield the node of the plan whose fastest damped pole the scheme does not damp, and the steps it would take."""
    options = ctrl.description.options
    if options["integrator"] != "ExplicitRungeKutta" or not np.all(np.isfinite(ctrl.x)):
        return
    scheme, steps, found = options["integrator.tableau.name"], int(options["integrator.steps"]), []
    with np.errstate(all="ignore"):
        for k, dt in enumerate(ctrl.description.dt):
            damped = _damp(_poles(ctrl, k, SHORT * dt / steps))
            if damped.size and np.max(np.abs(damped)) * dt / steps > SAFE and _grows(ctrl, k, dt / steps):
                found.append((float(np.max(np.abs(damped))), k))
    if not found:
        return
    _, k = max(found)
    dt = ctrl.description.dt[k]
    damped = _damp(_poles(ctrl, k, SHORT * dt / steps))
    pole = damped[np.argmax(np.abs(damped))]
    text = f"{pole.real:.3g}" if abs(pole.imag) < DAMPED * abs(pole) else f"{pole:.3g}"
    enough = next((n for n in range(steps + 1, MOST_STEPS) if not _grows(ctrl, k, dt / n)), None)
    many = f"; {enough} steps are enough: ExplicitRungeKutta({scheme}, steps={enough})" if enough else ""
    if enough is None or enough > STIFF:
        many += "; an implicit scheme takes few: ImplicitRungeKutta() (--set integrator=implicit_runge_kutta)"
    yield (
        f"{scheme} with {steps} steps is unstable at node {k} of the plan: pole {text} "
        f"1/{ctrl.description.time_unit}{many}"
    )


def _jacobian(ctrl: Memory, k: int, t: float) -> Array:
    """Return dPhi_t / dx at node k, (nx, nx)."""
    x, u = np.asarray(ctrl.x[k], dtype=np.float64), ctrl.u[k]
    columns = []
    for i, scale in enumerate(ctrl.description.scales[: x.size]):
        e = np.zeros(x.size)
        e[i] = DIFFERENCE * max(abs(float(x[i])), scale)
        ends = [np.asarray(ctrl.integrate(x + side * e, u, t), dtype=np.float64) for side in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * e[i]))
    return np.array(columns).T


def _poles(ctrl: Memory, k: int, t: float) -> Array:
    J = _jacobian(ctrl, k, t)
    return np.log(np.linalg.eigvals(J).astype(complex)) / t if np.all(np.isfinite(J)) else np.zeros(0, complex)


def _damp(poles: Array) -> Array:
    return poles[poles.real < -DAMPED * np.abs(poles)]


def _grows(ctrl: Memory, k: int, h: float) -> bool:
    """Return True if a step of length h makes more modes grow than the model does."""
    J = _jacobian(ctrl, k, h)
    if not np.all(np.isfinite(J)):
        return True
    poles = _poles(ctrl, k, SHORT * h)
    growing = np.abs(np.linalg.eigvals(J)) > 1 + SLACK
    return int(np.sum(growing)) > poles.size - _damp(poles).size
