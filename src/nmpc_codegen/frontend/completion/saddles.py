"""Controls and states may stand at a saddle, a stationary point that is no minimum, if their slope vanishes somewhere.

If the slope of the dynamics with respect to a control is 0 (u^2 at 0, a product of two at 0), no step of an iteration
moves the control. The optimality conditions may then hold at a point from which the cost decreases to both sides: a
saddle. Samples and solve() leave it by a probe, see algorithms/shared/saddle.c. This module decides which controls need
a probe, and which slopes count as almost zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from nmpc_codegen.frontend.problem import Array, Problem
from nmpc_codegen.ir.casadi_types import Expression, curved_rows

#: Slopes up to this value, relative to the largest slope of the same variable, count as almost zero.
IDLE = 1e-2
#: Steps of a control from a saddle that are tried, in its scale; number of halvings of the resulting step.
PROBE_SIZES, PROBE_PARTS = (1.0, 0.25, 0.0625), 12
#: Number of states at which slopes are compared; number of values of a variable in its range.
STATES, VALUES = 5, 41


@dataclass(frozen=True)
class Saddles:
    """The variables that may stand at a saddle: ``controls`` and ``states``, where only controls drive the states.

    slopes: (nx, nx + nu), the value of |d Phi_l / dz_i| of an interval up to which z_i has almost no effect on state l;
    infinite if it does not act directly, and on itself; -1 for variables that always have an effect. partners: (nu,),
    another control whose value decides on the slope of control j, or -1. drivers: (nu,), True for controls that drive
    one of the states.
    """

    controls: tuple[int, ...]
    states: tuple[int, ...]
    slopes: tuple[float, ...]
    partners: tuple[int, ...]
    drivers: tuple[bool, ...]


def find_saddles(problem: Problem, z: Array) -> Saddles:
    """Return the controls and states that may stand at a saddle; ``z`` (nx + nu,) holds scales."""
    nx, nu = problem.nx, problem.nu
    none = Saddles((), (), (-1.0,) * nx * (nx + nu), (-1,) * nu, (False,) * nu)
    if problem.estimation is not None:
        return none
    bends, driven = _bends(problem), _driven(problem)
    bent = np.concatenate([np.diag(bends)[:nx] & np.any(driven, axis=1), np.any(bends[nx:, nx:], axis=0)])
    if not np.any(bent):
        return none
    largest, vanishes = _compare(problem, z, bent)
    found = np.flatnonzero(vanishes)
    controls, states = tuple(int(j) for j in found[found >= nx] - nx), tuple(int(i) for i in found[found < nx])
    slopes = np.where(vanishes, np.where(largest > 0.0, IDLE * largest, np.inf), -1.0)
    others = [[m for m in range(nu) if m != j and bends[nx + m, nx + j] and j in controls] for j in range(nu)]
    partners = [next((m for m in sorted(of, key=lambda m: m not in controls)), -1) for of in others]
    drivers = np.any(driven[list(states)], axis=0)
    return Saddles(controls, states, tuple(map(float, slopes.ravel())), tuple(partners), tuple(map(bool, drivers)))


def _slopes(problem: Problem, f: Expression) -> Expression:
    """Return df/d(x, u), without the effect of a state on itself."""
    path = problem.path
    J = ca.jacobian(f, ca.vertcat(path.x, path.u))
    return ca.sparsify(J * (1 - ca.horzcat(ca.DM.eye(problem.nx), ca.DM.zeros(problem.nx, problem.nu))))


def _bends(problem: Problem) -> Array:
    """Return (nx + nu, nx + nu): True where the slope of the dynamics in variable j depends on variable i."""
    path = problem.path
    z = ca.vertcat(path.x, path.u)
    J = _slopes(problem, problem.dynamics(path.x, path.u, path.p))
    found = np.zeros((z.numel(), z.numel()), dtype=bool)
    for j in range(z.numel()):
        found[:, j] = ca.which_depends(J[:, j], z, 1)
    return found


def _driven(problem: Problem) -> Array:
    """Return (nx, nu): True where only control j drives state i, as in an actuator with a lag.

    The derivative of the state is then an affine function of the control and of itself; or the state stores the
    control.
    """
    path = problem.path
    z, f = ca.vertcat(path.x, path.u), problem.dynamics(path.x, path.u, path.p)
    found = np.array(ca.DM(ca.jacobian(f, path.u).sparsity(), 1), dtype=bool).reshape(problem.nx, problem.nu)
    on_others = ca.DM(_slopes(problem, f)[:, : problem.nx].sparsity(), 1)
    found[sorted(curved_rows(f, z))] = False
    found[np.any(np.array(on_others, dtype=bool), axis=1)] = False
    for control, place in problem.augmentation.places.items():
        found[problem.measured + place, control] = True
    return found


def _compare(problem: Problem, z: Array, bent: Array) -> tuple[Array, Array]:
    """Return the largest slopes of an interval at a typical state (nx, nx + nu), and which variables are marked.

    A variable is marked if all its slopes vanish somewhere.
    """
    path, columns = problem.path, np.flatnonzero(bent)
    f = problem.reduction(path)(problem.dynamics(path.x, path.u, path.p), 1)
    at = ca.Function("slopes", [path.x, path.u, path.p], [ca.densify(_slopes(problem, f)[:, columns.tolist()])])
    length = 1.0 if problem.discrete else min(problem.dt)
    points = [list(_values(problem, x, z, bent)) for x in _states(problem, z)]
    flat = [(x, u, problem.node_values(x, u)) for rows in points for x, u in rows]
    with np.errstate(all="ignore"):
        found = np.asarray(at.map(len(flat))(*(np.array(v).T for v in zip(*flat, strict=True))))
        slopes = length * np.nan_to_num(np.abs(found), posinf=0.0).reshape(problem.nx, len(points), -1, columns.size)
    most = np.max(slopes, axis=2, keepdims=True)
    still = np.any(np.all(slopes <= IDLE * most, axis=0), axis=1) & np.any(most > 0.0, axis=(0, 2))
    largest, vanishes = np.zeros((problem.nx, z.size)), np.zeros(z.size, dtype=bool)
    largest[:, columns], vanishes[columns] = np.median(most[:, :, 0], axis=1), np.any(still, axis=0)
    return largest, vanishes


def _states(problem: Problem, z: Array) -> Iterator[Array]:
    """Yield the initial state, and other states around it."""
    yield problem.x_initial
    random = np.random.default_rng(0)
    for _ in range(STATES - 1):
        yield problem.x_initial + z[: problem.nx] * random.uniform(-0.5, 0.5, problem.nx)


def _values(problem: Problem, x: Array, z: Array, bent: Array) -> Iterator[tuple[Array, Array]]:
    """Yield (x, u) in which one variable runs through its range.

    The other controls are at their references, at 0, or random.
    """
    nx, (lower, upper) = problem.nx, _control_range(problem, z)
    reference = np.clip(problem.reference_controls, lower, upper)
    random = np.random.default_rng(1)
    for others in (reference, np.clip(0.0, lower, upper), random.uniform(lower, upper)):
        for i in np.flatnonzero(bent):
            j = i - nx
            low, high = (lower[j], upper[j]) if j >= 0 else (-z[i], z[i])
            at = reference[j] if j >= 0 else problem.x_initial[i]
            for value in (at, np.clip(0.0, low, high), *np.linspace(low, high, VALUES)):
                point = np.concatenate([x, others])
                point[i] = value
                yield point[:nx], point[nx:]


def _control_range(problem: Problem, z: Array) -> tuple[Array, Array]:
    """Return the bounds of the controls; without bounds, the reference plus or minus the scale."""
    size, at = z[problem.nx :], problem.reference_controls
    lower, upper = at - size, at + size
    for row in problem.rows:
        if row.kind == "control":
            lower[row.index] = row.lower if np.isfinite(row.lower) else min(lower[row.index], row.upper)
            upper[row.index] = row.upper if np.isfinite(row.upper) else max(upper[row.index], row.lower)
    return lower, upper
