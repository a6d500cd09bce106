"""The twin of a stranger is multiple shooting with an independent Runge-Kutta scheme, solved by IPOPT in every sample.

    python -m verification.strangers.twin --refresh

computes the closed loops of all strangers anew (ipopt.json).
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from verification.strangers.statement import Array, Limit, Stranger

RESULTS = Path(__file__).with_name("ipopt.json")
#: Loops of every stranger, and of those without a kick.
STARTS, NOMINAL = 20, 3
QUIET: dict[str, Any] = {
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-8, "max_iter": 500, "bound_relax_factor": 0.0},
}


@dataclass(frozen=True)
class Outcome:
    """An outcome has the cost of a closed loop, its violation, its distance, and its failures.

    ``violation``: largest violation of a hard row in its scale; ``distance``: of the last state from the goal;
    ``failed``: samples that were not solved; ``finite``: all states were finite.
    """

    cost: float
    violation: float
    distance: float
    failed: int
    finite: bool = True


class Twin:
    """A twin has the plant, the cost and the NLP of a stranger."""

    def __init__(self, stranger: Stranger) -> None:
        self.stranger = stranger
        x, u = ca.SX.sym("x", len(stranger.states)), ca.SX.sym("u", len(stranger.controls))
        self.step = ca.Function("step", [x, u], [_runge_kutta(stranger, x, u)])
        self.stage = ca.Function("stage", [x, u], [_stage_cost(stranger, x, u)])
        hard = [limit for limit in stranger.limits if limit.soft is None and limit.at == "path"]
        excess = [_excess(limit, limit.value(x, u)) / limit.scale for limit in hard]
        self.excess = ca.Function("excess", [x, u], [ca.mmax(ca.vertcat(0, *excess))])
        self._transcribe()

    def _transcribe(self) -> None:
        s, N = self.stranger, self.stranger.N
        nx, nu = len(s.states), len(s.controls)
        X, U = ca.SX.sym("X", nx, N + 1), ca.SX.sym("U", nu, N)
        start = ca.SX.sym("start", nx)
        slacks: list[Any] = []
        given = [i for i in range(nx) if i not in s.free]
        rows: list[tuple[Any, float, float]] = [(X[given, 0] - start[given], 0.0, 0.0)]
        rows += [(self.step(X[:, k], U[:, k]) - X[:, k + 1], 0.0, 0.0) for k in range(N)]
        cost = sum((self.stage(X[:, k], U[:, k]) for k in range(N)), ca.SX(0)) + _end_cost(s, X[:, N])
        for limit in s.limits:
            for k in _nodes(limit, nx, nu, N):
                value = limit.value(X[:, k], U[:, min(k, N - 1)])
                if limit.soft is not None:
                    slack = ca.SX.sym("slack", 2)
                    slacks.append(slack)
                    cost += limit.soft[0] * ca.sum1(slack) + 0.5 * limit.soft[1] * ca.sumsqr(slack)
                    value = value - slack[0] + slack[1]
                rows.append((value, limit.lower, limit.upper))
        lower, upper = (np.array([bound[i] for bound in s.controls.values()]) for i in (0, 1))
        free, count = np.full(nx * (N + 1), np.inf), 2 * len(slacks)
        self._bounds = {
            "lbx": np.concatenate([-free, np.tile(lower, N), np.zeros(count)]),
            "ubx": np.concatenate([free, np.tile(upper, N), np.full(count, np.inf)]),
            "lbg": np.concatenate([np.full(g.numel(), low) for g, low, _ in rows]),
            "ubg": np.concatenate([np.full(g.numel(), high) for g, _, high in rows]),
        }
        self._slacks = count
        nlp = {
            "x": ca.vertcat(ca.vec(X), ca.vec(U), *slacks),
            "p": start,
            "f": cost,
            "g": ca.vertcat(*(g for g, _, _ in rows)),
        }
        self.solver = ca.nlpsol("twin", "ipopt", nlp, QUIET)

    def solve(self, start: Array, X: Array, U: Array) -> tuple[bool, float, Array, Array]:
        """Solve by IPOPT from the plan (N+1, nx), (N, nu); return whether it succeeds, its cost and its plan."""
        guess = np.concatenate([X.ravel(), U.ravel(), np.zeros(self._slacks)])
        found = self.solver(x0=guess, p=start, **self._bounds)
        w = np.asarray(found["x"]).ravel()
        states, controls = X.size, U.size
        plan = w[:states].reshape(X.shape), w[states : states + controls].reshape(U.shape)
        return bool(self.solver.stats()["success"]), float(found["f"]), *plan

    def guess(self, start: Array) -> tuple[Array, Array]:
        """Return the plan that stays at the start, with controls at 0 or the nearest bound."""
        s = self.stranger
        rest = [float(np.clip(0.0, *bounds)) for bounds in s.controls.values()]
        return np.tile(start, (s.N + 1, 1)), np.tile(np.array(rest), (s.N, 1))

    def run(self, number: int, nominal: bool = False) -> Outcome:
        """Run the closed loop with IPOPT in every sample, from the shifted plan, or from the start if that fails."""
        s, loop = self.stranger, Loop(self, number, nominal)
        X, U = self.guess(loop.x)
        failed = 0
        for k in range(s.samples):
            good, _, Y, V = self.solve(loop.x, X, U)
            if not good:
                good, _, Y, V = self.solve(loop.x, *self.guess(loop.x))
            failed += not good
            loop.apply(k, V[0])
            X, U = np.vstack([Y[1:], Y[-1:]]), np.vstack([V[1:], V[-1:]])
        return loop.outcome(failed)


class Loop:
    """A loop simulates the plant and judges it; ``nominal``: without the kick."""

    def __init__(self, twin: Twin, number: int, nominal: bool = False) -> None:
        self._twin, self.x, self._nominal = twin, twin.stranger.initial(number), nominal
        self._cost, self._violation = 0.0, 0.0

    @property
    def finite(self) -> bool:
        """Return True if the state is finite."""
        return bool(np.all(np.isfinite(self.x)))

    def apply(self, k: int, u: Array) -> None:
        """Run sample k with the control u."""
        twin, (when, kick) = self._twin, self._twin.stranger.kick
        self._judge(k, u)
        self.x = np.asarray(twin.step(self.x, u)).ravel()
        if k == when and not self._nominal:
            self.x = self.x + np.asarray(kick, float)

    def follow(self, x: Array, u: Array) -> None:
        """Judge the samples (n + 1, nx), (n, nu) of another simulation."""
        for k, (state, control) in enumerate(zip(x, u, strict=False)):
            self.x = state
            self._judge(k, control)
        self.x = x[-1]

    def _judge(self, k: int, u: Array) -> None:
        twin, (when, _) = self._twin, self._twin.stranger.kick
        self._cost += float(twin.stage(self.x, u))
        if k != 0 and (self._nominal or k != when + 1):  # no control can change the state after a kick
            self._violation = max(self._violation, float(twin.excess(self.x, u)))

    def outcome(self, failed: int) -> Outcome:
        """Return the outcome of the loop so far."""
        distance = self._twin.stranger.distance
        there = 0.0 if distance is None else float(distance(self.x))
        return Outcome(self._cost, self._violation, there, failed, self.finite)


def _runge_kutta(s: Stranger, x: Any, u: Any) -> Any:
    h = s.dt / s.steps
    for _ in range(s.steps):
        a = s.model(x, u)
        b = s.model(x + h / 2 * a, u)
        c = s.model(x + h / 2 * b, u)
        d = s.model(x + h * c, u)
        x = x + h / 6 * (a + 2 * b + 2 * c + d)
    return x


def _squares(y: Any, weight: Any) -> Any:
    return 0.5 * ca.dot(ca.DM(list(weight)) * y, y)


def _stage_cost(s: Stranger, x: Any, u: Any) -> Any:
    cost = ca.SX(0)
    if s.residual is not None:
        cost += _squares(s.residual(x, u), s.weight)
    if s.rate is not None:
        cost += s.dt * s.rate(x, u)
    return cost


def _end_cost(s: Stranger, x: Any) -> Any:
    cost = ca.SX(0)
    if s.end_residual is not None:
        cost += _squares(s.end_residual(x), s.end_weight)
    if s.end_cost is not None:
        cost += s.end_cost(x)
    return cost


def _excess(limit: Limit, value: Any) -> Any:
    low = limit.lower - value if np.isfinite(limit.lower) else -1.0
    high = value - limit.upper if np.isfinite(limit.upper) else -1.0
    return ca.fmax(low, high)


def _nodes(limit: Limit, nx: int, nu: int, N: int) -> range:
    """Return the nodes at which a limit holds: 0..N-1 with a control, 1..N for states only."""
    if limit.at == "end":
        return range(N, N + 1)
    u = ca.SX.sym("u", nu)
    of_control = ca.depends_on(ca.SX(limit.value(ca.SX.sym("x", nx), u)), u)
    return range(N) if of_control else range(1, N + 1)


@cache
def by_ipopt() -> dict[str, list[Outcome]]:
    """Return the twins' loops, by problem and number; by "<name> nominal" those without a kick."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))
    return {name: [Outcome(**row) for row in rows] for name, rows in found.items()}


def _loops(name: str) -> list[Outcome]:
    from verification.strangers.problems import known

    stated, _, nominal = name.partition(" ")
    twin = Twin(known(stated))
    return [twin.run(number, bool(nominal)) for number in range(NOMINAL if nominal else STARTS)]


def refresh(names: list[str]) -> None:
    """Compute the loops of these strangers again."""
    found: dict[str, list[Any]] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    with ProcessPoolExecutor(2) as pool:
        for name, outcomes in zip(names, pool.map(_loops, names), strict=True):
            print(name, sum(o.failed for o in outcomes), "samples failed", flush=True)
            found[name] = [{key: _short(value) for key, value in asdict(o).items()} for o in outcomes]
    lines = (f"{json.dumps(name)}: [\n" + ",\n".join(map(json.dumps, rows)) + "]" for name, rows in found.items())
    RESULTS.write_text("{\n" + ",\n".join(lines) + "}\n", encoding="utf-8")


def _short(value: Any) -> Any:
    return float(f"{value:.9g}") if isinstance(value, float) else value


def main() -> None:
    """Run the command."""
    from verification.strangers.problems import STRANGERS

    command = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    command.add_argument("--refresh", action="store_true", help="compute ipopt.json anew")
    command.add_argument("--only", help="names, separated by commas")
    options = command.parse_args()
    every = [name for s in STRANGERS for name in (s.name, f"{s.name} nominal")]
    names = options.only.split(",") if options.only else every
    if options.refresh:
        refresh(names)
    else:
        command.print_help()


if __name__ == "__main__":
    main()
