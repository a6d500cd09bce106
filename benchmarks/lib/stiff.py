"""Implicit schemes: orders, derivatives, stiff solutions, optima against IPOPT, closed loops, and what they cost."""

from __future__ import annotations

import subprocess
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.lib import callgrind
from benchmarks.lib.report import Report
from benchmarks.lib.run import Run
from examples import chain, crane, quadrotor
from nmpc_codegen import OCP, RK4, SDIRK3, Controller, ExplicitRungeKutta, ImplicitRungeKutta, Options, build, generate
from nmpc_codegen.components.integrators.implicit.trial import Trial
from nmpc_codegen.components.integrators.tableau import IMPLICIT, ButcherTableau
from nmpc_codegen.frontend.classify import classify
from nmpc_codegen.frontend.problem import Array
from nmpc_codegen.oracle.reference import Tableau, interval_map
from nmpc_codegen.package.sources import Sources
from verification import stiff
from verification.implicit import Interval
from verification.quality import compile_c, package_name, written
from verification.stiff import Moving, Stiff

#: Distance of a measured order from that of the theory; error of derivatives; error of stiff solutions; of optima.
ORDER, DERIVATIVES, SOLUTION, OPTIMUM = 0.1, 1e-9, 0.05, 1e-8
#: Loops of a problem; explicit over implicit time; bytes of code.
LOOPS, FASTER, CODE = 20, 50.0, 100_000
#: Calls of a step that are timed.
CALLS = 400


def measure(report: Report, asked: Run) -> None:
    """All figures; a line per scheme and per problem."""
    for name, tableau in IMPLICIT.items():
        _schemes(report, name, tableau)
    for name in asked.cases(stiff.PROBLEMS):
        case = stiff.PROBLEMS[name]
        optimum(report, name, case)
        loops(report, name, case, stiff.Plant(case.make()), asked.share(LOOPS, 3))
    _reactor(report, asked.share(CALLS, 20))
    ocps: dict[str, Callable[[], OCP]] = {
        "crane": crane.build_ocp,
        "chain3": lambda: chain.build_ocp(3),
        "quadrotor": quadrotor.build_ocp,
    }
    for name in asked.cases(ocps):
        _beside_rk4(report, name, ocps[name])


# -- schemes ----------------------------------------------------------------------------------------------------------


def known() -> OCP:
    """y' = s'(t) + s(t)^2 - y^2 with the solution s = sin t + 1 / (1 + t)."""
    ocp = OCP("known", T=1.0, N=1)
    t, y, u = ocp.state("t"), ocp.state("y", initial=1.0), ocp.control("u")
    solution, slope = ca.sin(t) + 1 / (1 + t), ca.cos(t) - 1 / (1 + t) ** 2
    ocp.dynamics({t: 1 + 0 * u, y: slope + solution**2 - y**2})
    ocp.least_squares(y, weight=1.0)
    return ocp


def van_der_pol() -> OCP:
    """y'' = mu (1 - y^2) y' - y + u, mu = 1,000."""
    ocp = OCP("van_der_pol", T=1.0, N=1)
    y, v, u = ocp.state("y", initial=2.0), ocp.state("v", initial=-0.66), ocp.control("u")
    ocp.dynamics({y: v, v: 1e3 * (1 - y**2) * v - y + u})
    ocp.least_squares(y, weight=1.0)
    return ocp


def prothero_robinson() -> OCP:
    """y' = -1e6 (y - cos t) - sin t."""
    ocp = OCP("prothero", T=1.0, N=1)
    t, y, u = ocp.state("t"), ocp.state("y", initial=1.0), ocp.control("u")
    ocp.dynamics({t: 1 + 0 * u, y: -1e6 * (y - ca.cos(t)) - ca.sin(t)})
    ocp.least_squares(y, weight=1.0)
    return ocp


def _schemes(report: Report, name: str, tableau: ButcherTableau) -> None:
    report.add("order", _order(tableau), case=name)
    report.add("order, distance", abs(_order(tableau) - tableau.order), case=name, limit=ORDER)
    S, H = _derivatives(tableau)
    report.add("S", S, case=name, limit=DERIVATIVES)
    report.add("H", H, case=name, limit=DERIVATIVES)
    bounded = SOLUTION if tableau.stability == "L" else None
    prothero = Interval(classify(prothero_robinson()), ImplicitRungeKutta(tableau, 10))
    end = prothero("value", [0.0, 2.0], [0.0], [], 1.0)[0][1]  # from beside the solution
    report.add("Prothero-Robinson", abs(end - np.cos(1.0)), case=name, limit=bounded)
    problem = classify(van_der_pol())
    found = Interval(problem, ImplicitRungeKutta(tableau, 20))("value", [2.0, 0.0], [0.0], [], 400.0)[0]
    exact = _by_radau(lambda t, x: [x[1], 1e3 * (1 - x[0] ** 2) * x[1] - x[0]], [2.0, 0.0], 400.0)
    report.add("van der Pol", abs(found[0] - exact[0]), case=name, limit=bounded)


def _by_radau(f: Callable[[float, Array], object], x: Array | list[float], T: float) -> Array:
    found = solve_ivp(f, (0.0, T), x, method="Radau", rtol=1e-10, atol=1e-12)
    return np.asarray(found.y[:, -1], dtype=float)


def halvings(tableau: ButcherTableau) -> list[int]:
    """Numbers of steps whose errors are above those of rounding."""
    first = 8 if tableau.order < 4 else 2 if tableau.order < 6 else 1
    return [first << n for n in range(5)]


def _order(tableau: ButcherTableau) -> float:
    """The slope of the error over the last of four halvings of the step."""
    problem = classify(known())
    trial, errors = Trial(problem, np.ones(problem.nx), tableau), []
    for steps in halvings(tableau):
        end = trial.interval(np.array([0.0, 1.0]), np.zeros(1), np.zeros(0), 1.0, steps, 30).x
        errors.append(abs(end[1] - np.sin(1) - 0.5))
    return float(np.log2(errors[-2] / errors[-1]))


def _derivatives(tableau: ButcherTableau) -> tuple[float, float]:
    """Relative errors of S, and of H by three sweeps, against CasADi's rootfinder."""
    problem, point = classify(stiff.reactor()), (np.array([1.0, 0.1, 0.5, 352.0, 341.0]), np.array([0.05, 345.0]))
    lam, z = np.array([1.0, -0.5, 2.0, 0.01, 0.02]), ca.MX.sym("z", 7)
    end = interval_map(problem, _numbers(tableau, 2))(z[:5], z[5:], problem.p_value, 2.0)[0]
    exact = ca.Function("exact", [z], [ca.jacobian(end, z), ca.hessian(ca.dot(lam, end), z)[0]])
    S, H = (np.array(value) for value in exact(np.concatenate(point)))
    interval = Interval(problem, ImplicitRungeKutta(tableau, 2), scale=[1, 1, 1, 350, 350])
    found = interval("symmetric", *point, problem.p_value, 2.0, lam)
    ours = found[1].reshape(5, 7), found[4].reshape(7, 7)
    errors = np.abs(ours[0] - S), np.abs(ours[1] - np.tril(H))
    return float(np.max(errors[0]) / np.max(np.abs(S))), float(np.max(errors[1]) / np.max(np.abs(H)))


def _numbers(tableau: ButcherTableau, steps: int) -> Tableau:
    return Tableau(tuple(tuple(map(float, row)) for row in tableau.a), tuple(map(float, tableau.b)), steps)


# -- problems ---------------------------------------------------------------------------------------------------------


def optimum(report: Report, name: str, case: Stiff, options: Options | None = None, figure: str = "optimum") -> None:
    """Distance from IPOPT's optimum of the same discretisation."""
    error, iterations = stiff.distance_from_optimum(case, options, "fast")
    report.add(figure, error, case=name, limit=OPTIMUM)
    report.add(f"{figure}, iterations", iterations, case=name)


def loops(report: Report, name: str, case: Stiff, plant: Moving, count: int) -> None:
    """Closed loops with what a user gets who says nothing."""
    ctrl = stiff.controller(case)
    found = [stiff.run(case, ctrl, plant, seed) for seed in range(count)]
    for outcome in found:
        if outcome.lost:
            print(f"{name}: {outcome.lost}")
    samples = count * case.samples
    report.add("loops lost", sum(bool(outcome.lost) for outcome in found), case=name, n=count, limit=0)
    report.add("not OK", samples - sum(o.statuses["OK"] for o in found), case=name, n=samples)


def _reactor(report: Report, calls: int) -> None:
    """The time of a sample of the default scheme against that of RK4 with as many steps as it needs, both with a
    Gauss-Newton Hessian and the same QP solver; code of the package."""
    ocp = stiff.reactor()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        explicit = build(ocp, Options(integrator=ExplicitRungeKutta(RK4, steps=1600), solve=False), "fast")
    implicit = build(ocp, Options(solve=False), "fast")
    x = classify(ocp).x_initial
    slow, fast = _time(explicit, x, max(5, calls // 20)), _time(implicit, x, calls)
    report.add("sample", fast, "us", case="reactor", n=calls)
    report.add("explicit over implicit", slow / fast, case="reactor", limit=FASTER, at_least=True)
    report.add("code", code_bytes(generate(ocp)), "B", case="reactor", limit=CODE)


def _time(ctrl: Controller, x: Array, calls: int) -> float:
    """Median time of a step (us)."""
    found = []
    for _ in range(calls):
        start = time.perf_counter()
        ctrl.step(x)
        found.append((time.perf_counter() - start) * 1e6)
    return float(np.median(found))


def code_bytes(sources: Sources) -> float:
    """Bytes of code and constants, -O2."""
    with written(sources) as folder:
        compile_c(folder, "-std=c99", "-O2", "-c", f"{package_name(sources)}.c", "-o", "unit.o")
        text = subprocess.run(["size", str(folder / "unit.o")], capture_output=True, text=True, check=True).stdout
    return float(text.splitlines()[1].split()[0])


# -- beside RK4 -------------------------------------------------------------------------------------------------------

_DRIVER = """#include "{name}.h"
static {name}_solver_t s;
static {name}_real x[{NAME}_NX], u[{NAME}_NU];
static volatile int status;
__attribute__((noinline)) void sample(void) {{ status = {name}_step(&s, x, u); }}
int main(void)
{{
    {name}_init(&s);
    for (int i = 0; i < {NAME}_NX; i++) {{
        x[i] = s.x[0][i];
    }}
    for (int n = 0; n < 20; n++) {{
        sample();
    }}
    return 0;
}}
"""


def _beside_rk4(report: Report, name: str, make: Callable[[], OCP]) -> None:
    """Operations of an interval, code of the package and instructions of a sample, of SDIRK3 and of RK4 with a step."""
    given = Options(solve=False)
    for scheme, integrator in (("RK4", ExplicitRungeKutta(RK4, 1)), ("SDIRK3", ImplicitRungeKutta(SDIRK3, 1, 2))):
        sources = generate(make(), replace(given, integrator=integrator))
        operations = sources.description.report.operations["integrator_interval"].total
        report.add(f"interval, {scheme}", operations, "operations", case=name)
        report.add(f"code, {scheme}", code_bytes(sources), "B", case=name)
        if callgrind.available():
            with written(sources) as folder:
                count = callgrind.instructions(_driver(sources, folder), [], ["sample"])
            if count is not None:
                report.add(f"sample, {scheme}", count / 20, "instructions", case=name)


def _driver(sources: Sources, folder: Path) -> Path:
    name = package_name(sources)
    (folder / "driver.c").write_text(_DRIVER.format(name=name, NAME=name.upper()), encoding="utf-8")
    compile_c(folder, "-std=gnu99", "-O2", "driver.c", f"{name}.c", "-o", "driver", "-lm")
    return folder / "driver"
