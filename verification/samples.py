"""The samples of the compiler's output are examples with various options, and small problems of unusual structure.

Together they use every C part and make every `#if` of a part true once and false once (coverage.py, test_samples.py).
For every part or condition that no sample reaches, a sample has to be added here.
"""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np

from examples import bioreactor, cart_pole, chain, crane, cstr, quadrotor, rope_crane
from nmpc_codegen import (
    ESDIRK3,
    OCP,
    RK4,
    SDIRK2,
    AdjointShooting,
    AugmentedLagrangian,
    DenseActiveSet,
    EconomicGaussNewton,
    Estimator,
    ExactHessian,
    ExplicitRungeKutta,
    ForwardOverAdjoint,
    FullCondensing,
    GaussLegendre2,
    GaussNewton,
    ImplicitMidpoint,
    ImplicitRungeKutta,
    Mirror,
    NoCondensing,
    Online,
    Options,
    Osqp,
    ProblemWarning,
    Project,
    RadauIIA2,
    RealTimeIteration,
    RiccatiActiveSet,
    RiccatiInteriorPoint,
    Soft,
    lookup_table,
)
from verification.algebraic import neutralisation
from verification.estimation import PLANTS
from verification.problems import tiny
from verification.routes import PURE
from verification.saddles import delayed, rated_heater, rated_heater_at_the_end, rated_heater_in_steps
from verification.timed import Sample
from verification.tuned import blocked_crane, dead_time, graded_tank, slewed_crane, timed_vessel


def walk() -> Estimator:
    """Return the estimator of a discrete map without controls."""
    ocp = OCP("walk", N=3)
    x = ocp.state("x")
    ocp.dynamics({x: 0.9 * x}, discrete=True)
    return Estimator(ocp, N=3, measure={"x": x}, noise_std={"x": 0.1}, process_std={x: 0.2})


def _pendulum(name: str, **grid: Any) -> tuple[OCP, Any, Any, Any]:
    """Create a damped pendulum with a torque and a quadratic cost; return (ocp, angle, rate, torque)."""
    ocp = OCP(name, **(grid or {"T": 1.0, "N": 5}))
    q, w, u = ocp.state("q", initial=0.5), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) - 0.1 * w + u})
    ocp.least_squares(ca.vertcat(q, w, u), weight=[2.0, 0.1, 0.1])
    return ocp, q, w, u


def bare() -> OCP:
    """Return an OCP with neither rows nor parameters nor a terminal cost."""
    return _pendulum("bare")[0]


def controls() -> OCP:
    """Return an OCP with control bounds only."""
    ocp, _, _, u = _pendulum("controls")
    ocp.subject_to(-1, u, 1)
    return ocp


def states() -> OCP:
    """Return an OCP with bounds on states, one of them at the end, and none on controls."""
    ocp, q, w, _ = _pendulum("states")
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[10.0, 1.0])
    ocp.subject_to(-0.6, w, 0.6)
    ocp.subject_to(-1, q, 1, at="end")
    return ocp


def path() -> OCP:
    """Return an OCP with general path rows with and without controls, one with a parameter, and none at the end."""
    ocp, q, w, u = _pendulum("walls")
    p = ocp.parameter("p", value=0.5)
    ocp.subject_to(-0.8, u + p * w * w, 0.9, name="effort")
    ocp.subject_to(-0.3, w + 0.2 * u * q, np.inf, name="slow")
    return ocp


def circle() -> OCP:
    """Return the OCP of a point mass without a terminal cost, whose controls have to stay inside a circle."""
    ocp = OCP("circle", T=1.0, N=5)
    x, u = ocp.state("x", size=2), ocp.control("u", size=2)
    ocp.dynamics({x: u - 0.3 * x})
    ocp.least_squares(ca.vertcat(x - ca.DM([3, 0]), u), weight=[1, 1, 0.01, 0.01])
    ocp.subject_to(-np.inf, ca.sumsqr(u), 1, name="circle")
    return ocp


def wide() -> OCP:
    """Return an OCP with more controls than lanes."""
    ocp = OCP("wide", T=1.0, N=5)
    x, u = ocp.state("x", size=2, initial=[1.0, -0.5]), ocp.control("u", size=5)
    ocp.dynamics({x: ca.vertcat(u[0] + u[1] * x[1], u[2] - u[3] * x[0] + u[4])})
    ocp.least_squares(ca.vertcat(x, u), weight=[2.0, 1.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    ocp.subject_to(-0.5, u, 0.5)
    return ocp


def flat() -> OCP:
    """Return the OCP of a heated tank whose pump efficiency falls with temperature; the cost is linear in the power."""
    ocp = OCP("flat", T=6.0, N=6, time_unit="h")
    temp, power = ocp.state("temp", initial=40.0), ocp.control("power")
    ocp.dynamics({temp: (4.5 - 0.06 * (temp - 35)) * power - 0.1 * (temp - 20)})
    ocp.stage_cost(0.3 * power)
    ocp.subject_to(0, power, 3)
    ocp.subject_to(35, temp, 50, soft=(0.5, 1.0))
    return ocp


def final() -> OCP:
    """Return an OCP with general rows only at the end."""
    ocp, q, w, u = _pendulum("final")
    ocp.subject_to(-3, u, 3)
    ocp.subject_to(-0.1, ca.vertcat(q + 0.2 * q * w, ca.sin(w) + q), [0.1, 0.5], at="end", name="gate")
    return ocp


def ends() -> OCP:
    """Return an OCP with a state, a general and a coupled row at the end."""
    ocp, q, w, u = _pendulum("ends")
    ocp.subject_to(-3, u, 3)
    ocp.subject_to(0.1, q, 0.1, at="end")
    ocp.subject_to(-0.2, w + 0.1 * q * w, 0.2, at="end", name="gate")
    ocp.boundary(-1, ocp.at_start(q) * ocp.at_end(w), 1)
    return ocp


def soft_states() -> OCP:
    """Return an OCP with soft bounds on states."""
    ocp, _, w, u = _pendulum("soft_states")
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-0.6, w, 0.6, soft=(10, 1))
    return ocp


def soft_rows() -> OCP:
    """Return an OCP with soft general rows at some nodes, and a hard general row."""
    ocp, q, w, u = _pendulum("soft_rows")
    ocp.subject_to(-0.8, u + 0.5 * w * w, 0.9, name="effort", soft=(5, 0))
    ocp.subject_to(-0.2, q * q + w, 0.7, at=(2, 4, 5), name="gate")
    return ocp


def cycle() -> OCP:
    """Return an OCP with coupled start and end with a free start and no other bounds."""
    ocp, q, w, _ = _pendulum("cycle")
    ocp.boundary(0, ocp.at_start(q) - ocp.at_end(q), 0)
    ocp.boundary(0, ocp.at_start(w) - ocp.at_end(w), 0)
    ocp.free_initial(q, w)
    return ocp


def arrival() -> OCP:
    """Return an OCP with a free start with a separate cost."""
    ocp, q, w, u = _pendulum("arrival")
    ocp.subject_to(-1, u, 1)
    ocp.free_initial(q, w)
    ocp.start_least_squares(ca.vertcat(q, q * w), weight=[3.0, 1.0], reference=[0.5, 0.1])
    ocp.start_cost(0.1 * w**4)
    return ocp


def arrival_on_path() -> OCP:
    """Return an OCP with a least-squares cost of x_0, together with a path cost of the state only."""
    ocp = OCP("arrival_on_path", T=1.0, N=5)
    q, w, u = ocp.state("q", initial=0.5), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) + u})
    ocp.least_squares(u, weight=0.1)
    ocp.terminal_least_squares(q, weight=10)
    ocp.free_initial(w)
    ocp.start_least_squares(w, weight=2.0)
    return ocp


def bioreactor_in_loop() -> OCP:
    """Return an OCP with soft coupled rows with a measured start, accumulators and an integrated cost."""
    return bioreactor.build_ocp(soft=True)


def ring() -> OCP:
    """Return an OCP with nonlinear coupled rows and a general row."""
    ocp, q, w, u = _pendulum("ring")
    ocp.boundary(-1, ocp.at_start(q) * ocp.at_end(q) + ocp.at_end(w) ** 2 - ocp.at_start(w) ** 2, 1)
    ocp.subject_to(-2, w + u * q, 2, name="row")
    ocp.terminal_least_squares(w, weight=1.0)
    return ocp


def closing() -> OCP:
    """Return an OCP with a measured start and a coupled row only."""
    ocp, _, w, _ = _pendulum("closing")
    ocp.boundary(0, ocp.at_start(w) - ocp.at_end(w), 0)
    return ocp


def target() -> OCP:
    """Return an OCP with a cost at the end only, and bounds on the control."""
    ocp = OCP("target", T=1.0, N=5)
    q, w, u = ocp.state("q", initial=0.5), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) + u})
    ocp.terminal_least_squares(ca.vertcat(q, w), weight=[10.0, 1.0])
    ocp.subject_to(-1, u, 1)
    return ocp


def counted() -> OCP:
    """Return an OCP with a state that starts at 0 at every sample."""
    ocp = OCP("counted", T=1.0, N=4)
    q, work, u = ocp.state("q", initial=0.5), ocp.state("work"), ocp.control("u")
    ocp.dynamics({q: -q + u, work: u**2})
    ocp.least_squares(ca.vertcat(q, u), weight=[1.0, 0.1])
    ocp.accumulator(work)
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-1, work, 0.5, at="end")
    return ocp


def free() -> OCP:
    """Return an OCP with a free component of the start that no row couples to the end."""
    ocp, _, w, u = _pendulum("loose")
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-0.6, w, 0.6)
    ocp.free_initial(w)
    return ocp


def everything() -> OCP:
    """Return an OCP with every kind of row and of data, on a nonuniform grid."""
    ocp = OCP("everything", intervals=[0.1, 0.1, 0.2, 0.2])
    x, u, p = ocp.state("x", size=2), ocp.control("u", size=2), ocp.parameter("p", size=2, value=[1, 2])
    ocp.dynamics(ca.vertcat(x[1] * p[0], -x[0] + u[0] * u[1] + ca.sin(x[1]) * p[1]))
    weight = np.diag([2.0, 1.0, 1.0, 1.0, 1.0])
    weight[0, 1] = weight[1, 0] = 0.1
    ocp.least_squares(ca.vertcat(x, u, x[0] * u[0]), weight=weight)
    ocp.terminal_least_squares(ca.vertcat(x[0] ** 2 + x[1], x[0]), weight=[[3.0, 0.5], [0.5, 1.0]])
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-2, x[0] * x[1] + u[0], 2, soft=(10, 2), name="row")
    ocp.subject_to(-3, x[1], 3, soft=(5, 0))
    ocp.subject_to(-4, x[0] - u[1], 4, name="hard")
    ocp.subject_to(-1, x[0] ** 2, 1, at="end", name="fin")
    ocp.boundary(0, ocp.at_start(x[0]) - ocp.at_end(x[0]), 0)
    ocp.free_initial(x[0])
    return ocp


def economic() -> OCP:
    """Return an OCP with general costs, one integrated and one at the end, without least squares."""
    ocp = OCP("economic", T=1.0, N=4)
    q, w, u = ocp.state("q", initial=0.5), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) + u})
    ocp.stage_cost(1 - ca.cos(q) + 0.1 * w**2 + 0.1 * u**2, integrate=True)
    ocp.terminal_cost(w**2 + q**4)
    ocp.subject_to(-1, u, 1)
    return ocp


def tuned() -> OCP:
    """Return an OCP with general costs and all data on which a constant Hessian depends, a soft row, a free start."""
    ocp, q, w, u = _pendulum("tuned")
    p = ocp.parameter("p", value=0.5)
    ocp.stage_cost(p * ca.exp(0.1 * q * u))
    ocp.terminal_least_squares(q, weight=2.0)
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-0.6, w, 0.6, soft=(1, 1))
    ocp.free_initial(w)
    ocp.start_least_squares(w, weight=2.0)
    return ocp


def tuned_end() -> OCP:
    """Return an OCP with a general cost and a fixed terminal state; the constant Hessian has no terminal block."""
    ocp = OCP("tuned_end", T=1.0, N=5)
    q, w, u = ocp.state("q", initial=0.1), ocp.state("w"), ocp.control("u")
    ocp.dynamics({q: w, w: -ca.sin(q) + u})
    ocp.stage_cost(1 - ca.cos(q) + 0.1 * u**2 + 0.1 * w * u, integrate=True)
    ocp.subject_to(0, ocp.x, 0, at="end", name="rest")
    return ocp


def mixed() -> OCP:
    """Return an OCP with least squares, a general cost that is not integrated, and a general row."""
    ocp, q, w, u = _pendulum("mixed")
    ocp.stage_cost(ca.exp(0.1 * q * u))
    ocp.subject_to(-0.5, w + q * u, 0.5, name="row")
    return ocp


def discrete() -> OCP:
    """Return the OCP of a discrete map."""
    ocp = OCP("discrete", N=6)
    x, u = ocp.state("x", initial=0.5), ocp.control("u")
    ocp.dynamics({x: 0.9 * x + u + 0.1 * x**2}, discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0])
    ocp.subject_to(-1, u, 1)
    return ocp


def rated_tank() -> OCP:
    """Return the OCP of a tank with an algebraic outflow, a rate of its inflow, a cost rate and nodal parameters."""
    ocp = OCP("rated_tank", T=2.0, N=4)
    h, q = ocp.state("h", initial=1.0), ocp.control("q")
    out, k = ocp.algebraic("out", initial=0.6), ocp.parameter("k", value=1.0)
    ocp.algebraic_equation(out + 0.5 * out**3 - k * h, name="valve")
    ocp.dynamics({h: q - out})
    ocp.least_squares(ca.vertcat(out, q, ocp.rate(q)), weight=[10.0, 0.1, 0.1], reference=[0.8, 0.8, 0.0])
    ocp.stage_cost(out**2 * q**2, integrate=True)
    ocp.subject_to(0, q, 2)
    ocp.subject_to(0, out * q, 1.5, soft=(10, 1), name="power")
    return ocp


def discrete_rows() -> OCP:
    """Return the OCP of a discrete map with bounds on its state, a general row and a parameter."""
    ocp = OCP("discrete_rows", N=3)
    x, u, p = ocp.state("x", size=2, initial=[0.5, 0.1]), ocp.control("u"), ocp.parameter("p", value=0.9)
    ocp.dynamics(ca.vertcat(p * x[0] + x[1], 0.5 * x[1] + u + 0.1 * x[0] ** 2), discrete=True)
    ocp.least_squares(ca.vertcat(x, u), weight=[1.0, 1.0, 1.0])
    ocp.terminal_least_squares(x, weight=[1.0, 2.0])
    ocp.subject_to(-1, x, 1)
    ocp.subject_to(-1, x[0] * u, 1, name="power")
    return ocp


FIXED = Online("fixed", "fixed", "fixed", "fixed", soft="fixed")
REFERENCES = Online("node", "fixed", "fixed", "fixed")
WEIGHTS = Online("fixed", "node", "fixed", "fixed")
SHARED = Online("shared", "shared", "shared", "shared")
NODE = Online("node", "node", "node", "node", dense_weight=True)
EVERY_NODE = Online("node", "node", "node", "node", soft="node")
RESAMPLE = RealTimeIteration(shift="resample", sampling_time=0.05)
RELAXED = RealTimeIteration()
REPEAT, PERIODIC = RealTimeIteration(shift="repeat"), RealTimeIteration(shift="periodic")
STAGES = NoCondensing()
QUASI_NEWTON: dict[str, Any] = {"method": "quasi_newton"}
SMOOTH: dict[str, Any] = {"rows": "smooth_l1", "penalty": 100.0}
LUMPED, BARRIER = {**SMOOTH, "rows": "lumped"}, {"rows": "barrier"}
LOOPED = ExplicitRungeKutta(unroll="none")
IMPLICIT, FORWARD = ImplicitRungeKutta(SDIRK2), ExactHessian(sweep=ForwardOverAdjoint())


def _augmented(hessian: Any = None, shift: str | None = None, repair: int = 3, **options: Any) -> Options:
    sampling_time = 0.05 if shift == "resample" else None
    algorithm = AugmentedLagrangian(shift=shift, sampling_time=sampling_time, repair=repair)
    return Options(algorithm=algorithm, hessian=hessian, **options)


def _shooting(given: dict[str, Any] | None = None, **more: Any) -> Options:
    return Options(algorithm=AdjointShooting(**({"shift": None} | (given or {}))), **more)


def _dense(**more: Any) -> Options:
    return Options(qp=DenseActiveSet(), condensing=FullCondensing(), **more)


def _riccati(**more: Any) -> Options:
    return Options(qp=RiccatiActiveSet(), condensing=STAGES, **more)


def _interior(**more: Any) -> Options:
    return Options(qp=RiccatiInteriorPoint(), condensing=STAGES, **more)


def _alone(qp: Any, condensing: Any = STAGES, **more: Any) -> Options:
    """Return options with real-time iterations without any optional part."""
    return Options(qp=qp, condensing=condensing, solve=False, online=FIXED, **more)


def functions() -> OCP:
    """Return an OCP with functions and conditions that targets with vectors have in lanes."""
    ocp = OCP("functions", T=1.0, N=9)
    x, v, u = ocp.state("x", initial=0.5), ocp.state("v"), ocp.control("u")
    drag = ca.if_else(v > 0, ca.exp(-v), 1.0) + ca.fmax(v, 0.1) * ca.log(1.0 + x**2) + ca.sqrt(1.0 + v**2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)  # the sample needs the kinks
        ocp.dynamics({x: v, v: u - 0.1 * drag - ca.sin(x) * ca.cos(v) - ca.tanh(x)})
    ocp.least_squares(ca.vertcat(x, v, u), weight=[1.0, 0.1, 0.1])
    return ocp


def data() -> OCP:
    """Return an OCP with tables of one and two variables, and data of every kind.

    Rows are hard or soft, penalties differ by side and are scaled, and a parameter has bounds.
    """
    ocp, q, w, u = _pendulum("changing", intervals=[0.1, 0.1, 0.2, 0.2])
    m = ocp.parameter("m", value=1.0, bounds=(0.5, 2.0))
    grid = np.linspace(-1, 1, 9)
    spring = lookup_table((q, w), (grid, grid), np.add.outer(grid**2, grid), "cubic", name="spring")
    ocp.stage_cost(m * spring**2 + lookup_table(q, grid, np.abs(grid)))
    ocp.subject_to(-1, u, 1)
    ocp.subject_to(-0.6, w, 0.6, soft=(np.inf, 1.0))
    ocp.subject_to(-0.8, u + q, 0.8, soft=Soft((5, 0), (1, 2), scale_with_dt=True), name="effort")
    return ocp


def clocked() -> OCP:
    """Return an OCP with a cost that depends on time, and a component of x_0 that the solver chooses."""
    ocp, q, _, _ = _pendulum("clocked")
    ocp.least_squares(q - ca.sin(ocp.time), 1.0, names="follow")
    ocp.free_initial(q)
    return ocp


def rated() -> OCP:
    """Return an OCP with a rate penalty without a terminal cost."""
    ocp, _, _, u = _pendulum("rated")
    ocp.least_squares(ocp.rate(u), 0.1, names="slew")
    return ocp


def sampled() -> OCP:
    """Return an OCP with a discrete state beside a continuous one."""
    ocp = OCP("sampled", T=1.0, N=5)
    x, n, u = ocp.state("x", initial=0.5), ocp.state("n"), ocp.control("u")
    ocp.dynamics({x: u - x + n}, discrete={n: 0.5 * n + 0.1 * x})
    ocp.least_squares(ca.vertcat(x, n, u), weight=[1.0, 0.1, 0.1])
    return ocp


#: Examples with their default options.
EXAMPLES = (
    Sample("crane", crane.build_ocp),
    Sample("cstr", cstr.build_ocp),
    Sample("cart_pole", cart_pole.build_ocp),
    Sample("quadrotor", quadrotor.build_ocp),
    Sample("chain3", lambda: chain.build_ocp(3)),
    Sample("bioreactor", bioreactor.build_ocp, Options(hessian=ExactHessian())),
)

SINGLE = Options(precision="single")
SAMPLES = (
    *EXAMPLES,
    Sample("crane riccati single", crane.build_ocp, _riccati(precision="single", online=SHARED)),
    Sample("crane without solve", crane.build_ocp, Options(solve=False, algorithm=PURE)),
    Sample("crane scalar", crane.build_ocp, Options(target="cortex-m4f", precision="single")),
    Sample("cart_pole size", cart_pole.build_ocp, Options(goal="size", precision="single")),
    Sample("data dense", data, _dense(hessian=ExactHessian(), online=EVERY_NODE)),
    Sample("data riccati", data, _riccati(hessian=ExactHessian(), precision="single")),
    Sample("bare dense", bare, _dense(online=FIXED)),
    Sample("bare exact", bare, _riccati(hessian=ExactHessian(), online=REFERENCES)),
    Sample("battery window", lambda: PLANTS["battery"].estimator(N=5, loss="huber"), _dense()),
    Sample("reactor window", lambda: PLANTS["reactor"].estimator(N=5), _riccati(precision="single")),
    Sample("vehicle window", lambda: PLANTS["vehicle"].estimator(N=4), Options(integrator=ImplicitRungeKutta(SDIRK2))),
    Sample("battery filter", lambda: PLANTS["battery"].estimator(kind="ekf")),
    Sample("map window", walk),
    Sample("reactor filter", lambda: PLANTS["reactor"].estimator(kind="ekf", loss="huber"), SINGLE),
    Sample("single dense", tiny, _dense(hessian=ExactHessian(), algorithm=PURE)),
    Sample("controls dense", controls, _dense(algorithm=RESAMPLE, precision="single", target="cortex-m3")),
    Sample("controls riccati", controls, _riccati(algorithm=RESAMPLE)),
    Sample("controls interior", controls, _interior(algorithm=RESAMPLE)),
    Sample("controls OSQP", controls, Options(qp=Osqp(), algorithm=RESAMPLE)),
    Sample("controls riccati alone", controls, _alone(RiccatiActiveSet(fallback=None))),
    Sample("controls interior alone", controls, _alone(RiccatiInteriorPoint())),
    Sample("states riccati alone", states, _alone(RiccatiActiveSet(fallback=None), algorithm=PURE)),
    Sample(
        "states riccati",
        states,
        _riccati(algorithm=RESAMPLE, target="riscv32"),
    ),
    Sample("path dense", path, _dense(hessian=GaussNewton(), integrator=LOOPED)),
    Sample("path riccati", path, _riccati(hessian=GaussNewton(), online=NODE)),
    Sample("heater", rated_heater),
    Sample("heater without solve", rated_heater, Options(solve=False)),
    Sample("heater augmented", rated_heater_in_steps, _augmented()),
    Sample("heater shooting", rated_heater_at_the_end, _shooting()),
    Sample("delayed", delayed),
    Sample("delayed shooting", delayed, _shooting()),
    Sample("flat", flat),
    Sample("heater alone", rated_heater, Options(algorithm=RealTimeIteration(iterations=1))),
    Sample("circle dense", circle, _dense()),
    Sample("path OSQP", path, Options(qp=Osqp(), hessian=ExactHessian(regularization=Mirror(level="stage")))),
    Sample("final dense", final, _dense(hessian=GaussNewton(), algorithm=REPEAT)),
    Sample("soft states dense", soft_states, _dense()),
    Sample("soft rows dense", soft_rows, _dense(hessian=ExactHessian(), online=NODE)),
    Sample("soft rows interior", soft_rows, _interior(hessian=GaussNewton())),
    Sample("free riccati", free, _riccati(hessian=ExactHessian(Project()))),
    Sample("everything dense", everything, _dense(hessian=ExactHessian(), algorithm=RESAMPLE, online=NODE)),
    Sample("everything at stages", everything, _dense(hessian=ExactHessian(regularization=Mirror(level="stage")))),
    Sample("everything looped", everything, _dense(integrator=LOOPED, online=FIXED, precision="single")),
    Sample("arrival dense", arrival, _dense(hessian=ExactHessian(), solve=False)),
    Sample("arrival riccati", arrival, _riccati(hessian=ExactHessian(), integrator=LOOPED, solve=False)),
    Sample("arrival on path dense", arrival_on_path, _dense()),
    Sample("arrival on path interior", arrival_on_path, _interior()),
    Sample("ring dense twice", ring, _dense()),
    Sample("ring dense", ring, _dense(hessian=ExactHessian(), algorithm=RELAXED)),
    Sample("cycle dense", cycle, _dense(algorithm=PERIODIC)),
    Sample("ring interior", ring, _interior(hessian=ExactHessian())),
    Sample("target dense", target, _dense(solve=False, algorithm=PURE)),
    Sample("counted dense", counted, _dense(algorithm=PERIODIC, integrator=ExplicitRungeKutta(RK4, steps=1))),
    Sample("tuned riccati", tuned, _riccati(hessian=EconomicGaussNewton(np.eye(3), np.eye(2)))),
    Sample("tuned dense", tuned, _dense(hessian=EconomicGaussNewton(np.eye(3), np.eye(2)), online=FIXED)),
    Sample("tuned weights", tuned, _riccati(hessian=EconomicGaussNewton(np.eye(3), np.eye(2)), online=WEIGHTS)),
    Sample("tuned end", tuned_end, _riccati(hessian=EconomicGaussNewton(np.eye(3)))),
    Sample("mixed dense", mixed, _dense(hessian=ExactHessian(regularization=Mirror()))),
    Sample("discrete rows riccati", discrete_rows, _riccati(hessian=ExactHessian())),
    Sample("quadrotor riccati alone", quadrotor.build_ocp, _alone(RiccatiActiveSet())),
    Sample("functions dense", functions, _dense(online=SHARED)),
    Sample("functions riccati", functions, _riccati(precision="single")),
    Sample("bare augmented", bare, _augmented(repair=0, online=FIXED, solve=False)),
    Sample("states augmented", states, _augmented(shift="repeat", precision="single")),
    Sample("final augmented", final, _augmented(online=REFERENCES)),
    Sample("soft states augmented", soft_states, _augmented(online=WEIGHTS)),
    Sample("soft rows augmented", soft_rows, _augmented(integrator=LOOPED, target="cortex-m7")),
    Sample("arrival augmented", arrival, _augmented()),
    Sample("loop augmented", bioreactor_in_loop, _augmented(shift="periodic")),
    Sample("crane shooting", crane.build_ocp, _shooting({"shift": "repeat"}, online=SHARED, solve=False)),
    Sample("bare shooting", bare, _shooting(online=FIXED)),
    Sample("controls shooting", controls, _shooting({"shift": "resample", "sampling_time": 0.1})),
    Sample("circle shooting", circle, _shooting()),
    Sample("path shooting", path, _shooting(online=NODE)),
    Sample("soft rows shooting", soft_rows, _shooting(integrator=LOOPED)),
    Sample("ends shooting", ends, _shooting()),
    Sample("closing shooting", closing, _shooting({"shift": "periodic"})),
    Sample("target shooting", target, _shooting()),
    Sample("economic quasi-Newton", economic, _shooting(QUASI_NEWTON, online=FIXED)),
    Sample("ring shooting", ring, _shooting()),
    Sample("counted quasi-Newton", counted, _shooting({**QUASI_NEWTON, **SMOOTH})),
    Sample("soft rows lumped", soft_rows, _shooting(LUMPED)),
    Sample("states lumped", states, _shooting({**QUASI_NEWTON, **LUMPED}, solve=False)),
    Sample("clocked dense", clocked, _dense()),
    Sample("sampled riccati", sampled, _riccati()),
    Sample("blocked dense", lambda: blocked_crane()[0], _dense(online=NODE)),
    Sample("blocked dense alone", lambda: blocked_crane()[0], Options(qp=DenseActiveSet(), solve=False)),
    Sample("rated dense alone", rated, _alone(DenseActiveSet(), FullCondensing())),
    Sample("slewed dense", lambda: slewed_crane()[0], _dense()),
    Sample("graded riccati", lambda: graded_tank()[0], _riccati(precision="single")),
    Sample("dead time shooting", lambda: dead_time()[0], _shooting({"shift": "repeat"})),
    Sample("vessel interior", lambda: timed_vessel()[0], _interior(integrator=LOOPED)),
    Sample("vessel augmented", lambda: timed_vessel()[0], _augmented()),
    Sample("blocked riccati", lambda: blocked_crane()[0], _riccati(target="cortex-m4f", precision="single")),
    Sample("path barrier", path, _shooting({**BARRIER, "shift": "repeat"})),
    Sample("stiff dense", data, _dense(integrator=IMPLICIT, hessian=ExactHessian())),
    Sample("stiff riccati", sampled, _riccati(integrator=ImplicitRungeKutta(ESDIRK3, newton=3), precision="single")),
    Sample("stiff everything", everything, _dense(integrator=IMPLICIT, hessian=FORWARD, algorithm=RESAMPLE)),
    Sample("stiff augmented", economic, _augmented(integrator=ImplicitRungeKutta(ESDIRK3, steps=2))),
    Sample("stiff economic", economic, _interior(integrator=ImplicitRungeKutta(ESDIRK3), hessian=FORWARD)),
    Sample("stiff shooting", economic, _shooting(integrator=IMPLICIT, target="cortex-m4f", precision="single")),
    Sample("stiff crane", crane.build_ocp, Options(integrator=ImplicitRungeKutta(ImplicitMidpoint), goal="size")),
    Sample("algebraic dense", neutralisation, _dense(algorithm=RESAMPLE)),
    Sample("algebraic riccati", rated_tank, _riccati(integrator=ImplicitRungeKutta(RadauIIA2), precision="single")),
    Sample("algebraic augmented", rated_tank, _augmented(integrator=ImplicitRungeKutta(GaussLegendre2))),
    Sample("algebraic alone", neutralisation, _alone(DenseActiveSet(), FullCondensing(), target="cortex-m4f")),
    Sample("algebraic explicit", lambda: rope_crane.build_ocp(5), Options()),
)  # fmt: skip

#: GNU C: targets with lanes and tiles. These and those before meet every condition of the parts.
IN_LANES = (
    Sample("crane aarch64", crane.build_ocp, Options(target="aarch64")),
    Sample("controls v3", controls, _dense(algorithm=RESAMPLE, online=NODE, target="x86-64-v3")),
    Sample("functions v4", functions, _riccati(precision="single", target="x86-64-v4")),
    Sample("functions aarch64", functions, _dense(math="own", target="aarch64")),
    Sample("free v3", free, _riccati(hessian=ExactHessian(), target="x86-64-v3")),
    Sample("wide v3", wide, _riccati(target="x86-64-v3")),
    Sample("chain5 v4", lambda: chain.build_ocp(5), Options(target="x86-64-v4")),
)
