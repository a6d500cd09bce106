"""Faults that users make or meet, and the text that each of them gives: python -m tests.runtime.faults prints them.

``says`` are the words that the text must contain: the thing, the place, the remedy; ``never`` those that do not fit.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np

from nmpc_codegen import (
    OCP,
    AugmentedLagrangian,
    Controller,
    DenseActiveSet,
    ExplicitRungeKutta,
    FullCondensing,
    GaussNewton,
    ImplicitRungeKutta,
    NmpcError,
    NoCondensing,
    Online,
    Options,
    ProblemWarning,
    RealTimeIteration,
    RiccatiInteriorPoint,
    build,
    simulate,
)
from nmpc_codegen.cli import main
from verification import problems
from verification.convergence.problems import problems as convergence_problems
from verification.strangers.problems import known


@dataclass(frozen=True)
class Fault:
    """A fault by its name, a function that commits it and returns the text, and what the text must and must not say."""

    name: str
    commit: Callable[[], str]
    says: tuple[str, ...]
    never: tuple[str, ...] = ()


FAULTS: list[Fault] = []


def fault(*says: str, never: tuple[str, ...] = ()) -> Callable[[Callable[[], str]], Callable[[], str]]:
    """Add the function to FAULTS; its docstring is the name."""

    def add(commit: Callable[[], str]) -> Callable[[], str]:
        FAULTS.append(Fault((commit.__doc__ or commit.__name__).rstrip("."), commit, says, never))
        return commit

    return add


def made(ocp: OCP, options: Options | None = None) -> Controller:
    """The controller; what build() warns of is left aside."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)
        return build(ocp, options, profile="test")


def warned(ocp: OCP, options: Options | None = None) -> str:
    """What build() warns of."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        build(ocp, options, profile="test")
    return "\n".join(str(w.message) for w in seen if issubclass(w.category, ProblemWarning))


def refused(call: Callable[[], object]) -> str:
    """The text of the error that a call raises."""
    try:
        call()
    except (NmpcError, AttributeError) as error:
        return f"{type(error).__name__}: {error}"
    return "no error"


def cart(where: str = "", f: Callable[[ca.SX, ca.SX], ca.SX] = lambda x, v: x, initial: float = 0.0) -> OCP:
    """A cart; ``where``: the part that contains f(position, speed)."""
    ocp = OCP("cart", T=2.0, N=10)
    x, v, a = ocp.state("x", initial=initial), ocp.state("v"), ocp.control("a")
    L = ocp.parameter("L", value=1.0)
    ocp.parameter("gain", value=[1, 1], size=2)
    ocp.dynamics({x: v, v: a * L + (f(x, v) if where == "equation" else 0)})
    ocp.least_squares(ca.vertcat(x - 1, v, a), weight=[1, 1, 0.1])
    ocp.terminal_least_squares(ca.vertcat(x - 1, v), weight=[10, 1])
    ocp.subject_to(-1, a, 1)
    if where == "residual":
        ocp.least_squares(f(x, v), weight=1, names=["range"])
    if where == "cost":
        ocp.stage_cost(f(x, v))
    if where in ("row", "soft row"):
        ocp.subject_to(-3, f(x, v) + 0 * a, 3, name="range", soft=(10, 1) if where == "soft row" else None)
    return ocp


def after_step(ocp: OCP, options: Options | None = None, x: tuple[float, ...] = (0.0, 0.0), samples: int = 1) -> str:
    """What diagnose() says after samples."""
    ctrl = made(ocp, options)
    for _ in range(samples):
        ctrl.step(x)
    return ctrl.diagnose()


# Numbers that are not finite -----------------------------------------------------------------------------------------


@fault(
    "row 'range' at nodes 1..9: sqrt(",
    "no finite derivative where its argument is 0",
    "bound the square",
    "sqrt(x**2 + v**2 + 1e-6)",
    never=("QP",),
)
def norm_in_a_row() -> str:
    """norm in a hard row, at 0."""
    return after_step(cart("row", lambda x, v: ca.norm_2(ca.vertcat(x, v))))


@fault("row 'range' at nodes 1..9: sqrt(", "write sqrt(x**2 + v**2 + 1e-6)", never=("bound the square",))
def norm_in_a_soft_row() -> str:
    """norm in a soft row, at 0, in solve()."""
    ctrl = made(cart("soft row", lambda x, v: ca.norm_2(ca.vertcat(x, v))))
    ctrl.solve([0.0, 0.0])
    return ctrl.diagnose()


@fault("the residual 'range' at nodes 0..9: hypot(x, v)", "write sqrt(x**2 + v**2 + 1e-6)")
def hypot_in_a_residual() -> str:
    """hypot in a residual, at 0."""
    return after_step(cart("residual", ca.hypot))


@fault("the general cost at nodes 0..9: pow(x, 0.51)", "write pow(sqrt(x**2 + 1e-6), 0.51)")
def power_in_a_cost() -> str:
    """x^0.51 in a cost, at 0."""
    return after_step(cart("cost", lambda x, v: x**0.51))


@fault("the equation of v at nodes 0..9: atan2(x, v)", "arguments are 0 and 0", "atan2(x, v + 1e-3) if v >= 0")
def angle_in_an_equation() -> str:
    """atan2 in an equation, at (0, 0)."""
    return after_step(cart("equation", lambda x, v: -0.1 * ca.atan2(x, v)))


@fault("the equation of v at node", "log(x", "is not finite where its argument is -", "log(fmax(x, 1e-3))", "bounds")
def logarithm_of_a_negative_number() -> str:
    """log outside of its domain, at a later sample."""
    ctrl = made(cart("equation", lambda x, v: -0.1 * ca.log(x), initial=1.0))
    ctrl.step([1.0, 0.0])
    ctrl.x[4:, 0] = -0.5
    ctrl.prepare()
    return ctrl.diagnose()


@fault("the equation of v at nodes 0..9: 0.001 / x", "the denominator is 0", "0.001 * x / (x**2 + 1e-6)")
def division_by_zero() -> str:
    """division by a state that is 0."""
    return after_step(cart("equation", lambda x, v: 1e-3 / x))


@fault("measured v is not finite", "last good value", never=("iterate",))
def measurement_without_a_number() -> str:
    """NaN in the measured state."""
    return after_step(cart(), x=(0.0, np.nan))


@fault("state v at node 3 of the plan is not finite", "reset()")
def plan_with_a_nan() -> str:
    """NaN in the plan, then prepare()."""
    ctrl = made(cart())
    ctrl.x[3, 1] = np.nan
    ctrl.prepare()
    return ctrl.diagnose()


@fault("state v at node 2", "restarted at the measured state", "ctrl.x")
def plan_with_a_nan_in_a_sample() -> str:
    """NaN in the plan, then step(), after which the plan restarts."""
    ctrl = made(cart())
    ctrl.step([0.0, 0.0])
    ctrl.x[3, 1] = np.nan
    ctrl.prepare()
    ctrl.feedback([0.0, 0.0])
    return ctrl.diagnose()


@fault("parameter gain[1] at node 0 is not finite", "set_parameter()")
def parameter_with_a_nan() -> str:
    """NaN in a parameter, written past the setter."""
    ctrl = made(cart())
    ctrl.view("p")[:, 2] = np.nan
    ctrl.step([0.0, 0.0])
    return ctrl.diagnose()


@fault("no finite x, v at the end of interval 0, from x = 0, v = 1000", "integration steps", "units")
def model_that_explodes() -> str:
    """a model that leaves all numbers behind."""
    ctrl = made(cart("equation", lambda x, v: 5.0 * v**3))
    ctrl.u[:] = 1.0
    ctrl.x[:] = [0.0, 1e3]
    ctrl.prepare()
    return ctrl.diagnose()


# Warnings ------------------------------------------------------------------------------------------------------------


@fault("row 'range' at nodes 1..9: sqrt(", "first plan")
def norm_at_the_first_plan() -> str:
    """build(): a norm that is 0 at the first plan."""
    return warned(cart("row", lambda x, v: ca.norm_2(ca.vertcat(x, v))))


def stiff(rate: float) -> OCP:
    """A pole at -rate."""
    ocp = OCP("stiff", T=10.0, N=10)
    x, u = ocp.state("x", initial=1.0), ocp.control("u")
    ocp.dynamics({x: -rate * x + u})
    ocp.least_squares(ca.vertcat(x, u), weight=1)
    return ocp


@fault("RK4 with steps=2 is unstable", "eigenvalue -30 1/s", "ImplicitRungeKutta(SDIRK3, steps=", "11 steps")
def unstable_steps() -> str:
    """build(): too few integration steps for a fast pole."""
    return warned(stiff(30.0), Options(integrator=ExplicitRungeKutta()))


def upright(N: int) -> OCP:
    """A pole that falls."""
    ocp = OCP("pole", T=0.1 * N, N=N)
    x, v, u = ocp.state("angle"), ocp.state("rate"), ocp.control("u")
    ocp.dynamics({x: v, v: 9.0 * x + u})
    ocp.least_squares(ca.vertcat(x, v, u), weight=1)
    return ocp


@fault("condensing full: the open loop grows by", "digits", "NoCondensing()")
def condensing_that_loses_digits() -> str:
    """build(): full condensing of an unstable plant over a long horizon."""
    return warned(upright(40), Options(condensing=FullCondensing(), qp=DenseActiveSet()))


@fault("control 'u' is 0 at the first plan", "initial=", "ctrl.u[:, 0] = 0.1", "reset()")
def control_without_influence() -> str:
    """build(): a growth rate of a population that starts at 0."""
    ocp = OCP("growth", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    ocp.dynamics({x: x * (1 + u)})
    ocp.least_squares(ca.vertcat(x - 1, u), weight=1)
    return warned(ocp)


@fault("row 'cone': its gradient vanishes", "where it is 0", "initial=", "-g v <= w and w <= g v")
def cone_at_rest() -> str:
    """build(): a cone at its tip."""
    ocp = OCP("cone", T=1.0, N=5)
    x, u, w = ocp.state("x"), ocp.control("u"), ocp.control("w")
    ocp.dynamics({x: u + w})
    ocp.least_squares(ca.vertcat(x - 1, u, w), weight=1)
    ocp.subject_to(-ca.inf, w**2 - u**2, 0, name="cone")
    return warned(ocp)


@fault("state 'end' is 0", "scales the derivatives", "ocp.state('end', initial=1.0)")
def end_time_of_zero() -> str:
    """build(): a free end time that starts at 0."""
    ocp = OCP("free", T=1.0, N=5)
    x, u, end = ocp.state("x"), ocp.control("u"), ocp.state("end")
    ocp.dynamics({x: u * end, end: 0})
    ocp.free_initial(end)
    ocp.stage_cost(end + u**2)
    ocp.subject_to(1, x, 1, at="end")
    return warned(ocp)


@fault("dynamics of 'x' contain <, if_else", "stall", "tanh(")
def dynamics_with_a_jump() -> str:
    """dynamics(): if_else."""
    ocp = OCP("jump", T=1.0, N=5)
    x, u = ocp.state("x"), ocp.control("u")
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        ocp.dynamics({x: ca.if_else(x > 0, -x, u)})
    return str(seen[0].message)


# Statuses ------------------------------------------------------------------------------------------------------------

HARD = RealTimeIteration(relaxation=None)


def stopped(options: Options) -> str:
    """A cart that cannot stop in time."""
    ocp = cart()
    ocp.subject_to(-0.1, ocp.x[1], 0.1, name="speed", at="end")
    return after_step(ocp, options, (0.0, 9.0))


@fault("INFEASIBLE", "row 'speed_end' at node 10 is violated by", "soft=(l1, l2)", 'relaxation="auto"')
def rows_that_contradict() -> str:
    """a hard row that cannot hold, without relaxation."""
    return stopped(Options(algorithm=HARD))


@fault("RELAXED", "row 'speed_end' at node 10 is violated by", "soft=(l1, l2)", never=('relaxation="auto"',))
def rows_that_are_relaxed() -> str:
    """a hard row that cannot hold, with the default options."""
    return stopped(Options())


@fault("INFEASIBLE", "row 'speed_end' at node 10 is violated by", "widen")
def solve_without_a_solution() -> str:
    """solve() of a problem whose rows contradict each other."""
    ocp = cart()
    ocp.subject_to(-0.1, ocp.x[1], 0.1, name="speed", at="end")
    ctrl = made(ocp)
    ctrl.solve([0.0, 9.0])
    return ctrl.diagnose()


@fault("ITERATION_LIMIT", "relative KKT residual", "solve(max_iterations=20)", never=("first step()", "ExactHessian"))
def too_few_iterations() -> str:
    """solve() with too few iterations."""
    ctrl = made(problems.CASES["crane"].make())
    ctrl.solve([2.0, 0.0, 0.5, 0.0], max_iterations=2)
    return ctrl.diagnose()


@fault("ITERATION_LIMIT", "row 'disc", "is violated by", "ExactHessian()", "max_iterations=30")
def gauss_newton_that_cycles() -> str:
    """solve() with an explicit GaussNewton()."""
    ctrl = made(problems.disc(), Options(hessian=GaussNewton()))
    ctrl.solve([1.0, 0.0], max_iterations=3)
    return ctrl.diagnose()


@fault("solve(tol=", "nearly a solution")
def tolerance_below_rounding() -> str:
    """solve() to a tolerance below rounding."""
    ctrl = made(problems.CASES["crane"].make(), Options(precision="single"))
    ctrl.solve([0.5, 0.0, 0.0, 0.0], tol=1e-14, max_iterations=30)
    return ctrl.diagnose()


@fault("SUBPROBLEM_FAILED", "DenseActiveSet(max_iterations=10)", "row 'upright")
def qp_solver_with_a_low_limit() -> str:
    """solve() with a QP solver that may take one iteration."""
    problem = next(p for p in convergence_problems() if p.name == "swing_up")
    ctrl = made(problem.make(), Options(condensing=FullCondensing(), qp=DenseActiveSet(max_iterations=1)))
    ctrl.solve(problem.start(1))
    return ctrl.diagnose()


@fault("QP solver stops at max_iterations=1", "RiccatiInteriorPoint(max_iterations=10)", "leave it out")
def sample_with_a_low_limit() -> str:
    """step() with a QP solver that may take one iteration."""
    qp = RiccatiInteriorPoint(max_iterations=1)
    return after_step(cart(), Options(condensing=NoCondensing(), qp=qp, algorithm=HARD), (5.0, 5.0))


def direction(algorithm: RealTimeIteration) -> Controller:
    """A drone whose thrust has a direction of length 1, which the first plan has not."""
    stranger = known("quaternion")
    return made(stranger.ocp(), replace(stranger.options(), algorithm=algorithm))


@fault("NOT_CONVERGED", "row 'unit' at node", "misses the model most in state", "iterations=10", "solve() before")
def plan_far_from_the_model() -> str:
    """a sample that leaves its plan far from the model, with one iteration."""
    ctrl = direction(RealTimeIteration(iterations=1))
    for _ in range(3):
        ctrl.step(np.zeros(6))
    return ctrl.diagnose()


@fault("NOT_CONVERGED", "RealTimeIteration()", never=("repair", "QP"))
def augmented_lagrangian_far_from_the_model() -> str:
    """a sample of the augmented Lagrangian after a jump."""
    ctrl = made(cart("equation", lambda x, v: -8 * ca.sin(3 * x)), Options(algorithm=AugmentedLagrangian(iterations=1)))
    ctrl.step([0.0, 0.0])
    ctrl.step([3.0, 4.0])
    return ctrl.diagnose()


@fault("NOT_CONVERGED", "near the model", "cut or refused", "AugmentedLagrangian(iterations=3)", never=("misses",))
def augmented_lagrangian_still_on_its_way() -> str:
    """a far set point that a trust region does not reach in the first sample."""
    ocp = OCP("tank", T=2.0, N=10)
    level, inflow = ocp.state("level", initial=1.0), ocp.control("inflow")
    ocp.dynamics({level: inflow})
    ocp.least_squares(ca.vertcat(level - 3e3, inflow), weight=[1, 0.1])
    ctrl = made(ocp, Options(algorithm=AugmentedLagrangian(iterations=1, repair=0)))
    ctrl.step([1.0])
    return ctrl.diagnose()


@fault("the Newton matrix is singular in interval 0, step 1, stage 1: state temp", never=("without prepare",))
def stage_without_a_solution() -> str:
    """an implicit scheme whose step is as long as the time in which a state doubles."""
    ocp = OCP("blow", T=1.0, N=5)
    x, temp, u = ocp.state("x"), ocp.state("temp", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u - x, temp: 10 * temp + u})
    ocp.least_squares(ca.vertcat(x, temp, u), weight=1)
    ctrl = made(ocp, Options(integrator=ImplicitRungeKutta("ImplicitMidpoint")))  # type: ignore[arg-type]
    ctrl.step([1.0, 1.0])
    return ctrl.diagnose()


@fault("Newton's method does not converge in interval 0, step 1, stage 1: state temp")
def stage_that_escapes() -> str:
    """a model that explodes within one interval."""
    ocp = OCP("escape", T=1.0, N=5)
    x, temp, u = ocp.state("x"), ocp.state("temp", initial=1.0), ocp.control("u")
    ocp.dynamics({x: u - x, temp: 5 * temp**2 + 3 + u})
    ocp.least_squares(ca.vertcat(x, temp, u), weight=1)
    ctrl = made(ocp, Options(integrator=ImplicitRungeKutta("ImplicitEuler")))  # type: ignore[arg-type]
    ctrl.solve([1.0, 3.0])
    return ctrl.diagnose()


@fault("NOT_PREPARED", "prepare()")
def feedback_without_preparation() -> str:
    """feedback() without prepare()."""
    ctrl = made(cart())
    ctrl.feedback([0.0, 0.0])
    return ctrl.diagnose()


@fault("warning at build: integrator RK4 with steps=2 is unstable", "22 steps", never=("hessian=GaussNewton()",))
def failure_of_unstable_steps() -> str:
    """solve() with too few integration steps."""
    ctrl = made(stiff(60.0), Options(integrator=ExplicitRungeKutta()))
    ctrl.solve([1.0])
    return ctrl.diagnose()


@fault("first NOT_CONVERGED: sample 0, t = 0 s", "first NUMERICAL_FAILURE: sample 3, t = 0.3 s", "row 'unit' at node")
def summary_of_a_loop() -> str:
    """the summary of a loop with two kinds of bad samples."""

    def spoil(k: int, ctrl: Controller) -> None:
        if k == 3:
            ctrl.x[5, 0] = np.nan

    return simulate(direction(RealTimeIteration(iterations=1)), np.zeros(6), 5, before=spoil).summary()


# Calls ---------------------------------------------------------------------------------------------------------------


@fault("xhat has shape (3,)", "(2,)")
def measured_state_of_another_size() -> str:
    """step() with a state of another size."""
    return refused(lambda: made(cart()).step([0.0, 0.0, 0.0]))


@fault("parameter 'L' has shape (3,)", "(1,), or a number, or one row per node, (10,) or (11,)")
def parameter_of_another_shape() -> str:
    """set_parameter() with three values for a scalar."""
    return refused(lambda: made(cart()).set_parameter("L", [1.0, 2.0, 3.0]))


@fault("parameter 'gain' has shape (11,)", "(2,), or a number, or one row per node, (10, 2) or (11, 2)")
def vector_parameter_of_another_shape() -> str:
    """set_parameter() with a scalar per node for a vector."""
    return refused(lambda: made(cart()).set_parameter("gain", np.ones(11)))


@fault("reference has shape (10, 2)", "(3,)", "(10, 3)")
def reference_of_another_shape() -> str:
    """set_reference() with two columns for three residuals."""
    return refused(lambda: made(cart()).set_reference(np.zeros((10, 2))))


@fault("weight has shape (2, 2)", "(3, 3)", "(3,)")
def weight_of_another_shape() -> str:
    """set_weight() with a smaller matrix."""
    return refused(lambda: made(cart()).set_weight(np.eye(2)))


@fault("bounds of 'a'", "lower [2.0] above upper [1.0]")
def crossed_bounds() -> str:
    """set_bounds() with lower above upper."""
    return refused(lambda: made(cart()).set_bounds("a", 2.0, 1.0))


@fault("no row 'speed'", "those that exist: 'a'")
def unknown_row() -> str:
    """set_bounds() of a row that does not exist."""
    return refused(lambda: made(cart()).set_bounds("speed", -1.0, 1.0))


@fault("the reference cannot be set", 'Online(reference="fixed")', '"shared" or "node"')
def fixed_reference() -> str:
    """set_reference() of a package with fixed references."""
    return refused(lambda: made(cart(), Options(online=Online(reference="fixed"))).set_reference([0, 0, 0]))


@fault("node is 11", "integer in 0..10")
def node_beyond_the_end() -> str:
    """set_parameter() at a node beyond the end."""
    return refused(lambda: made(cart()).set_parameter("L", 1.0, node=11))


@fault("depends on no state and no control", "lower, expression, upper")
def row_in_another_order() -> str:
    """subject_to() with its arguments in another order."""
    ocp = cart()
    return refused(lambda: ocp.subject_to(ocp.x[0], -1, 1))


@fault("OptionError", "general cost")
def gauss_newton_of_a_general_cost() -> str:
    """GaussNewton() for a problem with a general cost."""
    return refused(lambda: made(cart("cost", lambda x, v: x**2), Options(hessian=GaussNewton())))


# Names of other tools ------------------------------------------------------------------------------------------------


@fault("'set_alg'", "algebraic(name, initial=...)", "algebraic_equation(g)")
def algebraic_variables() -> str:
    """ocp.set_alg()."""
    return refused(lambda: OCP("x1", T=1.0, N=2).set_alg("z", None))  # type: ignore[attr-defined]


@fault("'set_rterm'", "least_squares(ocp.rate(u), weight)", "ocp.previous(u)")
def penalty_of_rates() -> str:
    """ocp.set_rterm()."""
    return refused(lambda: OCP("x1", T=1.0, N=2).set_rterm(u=1))  # type: ignore[attr-defined]


@fault("'minimize'", "least_squares(expr, weight)", "stage_cost(expr)")
def objective_of_another_tool() -> str:
    """ocp.minimize()."""
    return refused(lambda: OCP("x1", T=1.0, N=2).minimize(0))  # type: ignore[attr-defined]


@fault("'make_step'", "step(xhat)")
def step_of_another_tool() -> str:
    """ctrl.make_step()."""
    return refused(lambda: made(cart()).make_step([0.0, 0.0]))  # type: ignore[attr-defined]


@fault("'subject'", "did you mean 'subject_to'?")
def misspelt_method() -> str:
    """a misspelt method."""
    return refused(lambda: OCP("x1", T=1.0, N=2).subject(0))  # type: ignore[attr-defined]


# Command line --------------------------------------------------------------------------------------------------------

PROBLEM = """
from tests.runtime.faults import cart
ocp = cart(initial=0.0)
ocp.subject_to(2, ocp.x[0], 3, name="far", at=[1])
"""


@fault("exit 1", "simulation FAILED: ", "of 3 samples", "first ", "sample 0", "row 'far'")
def simulation_on_the_command_line() -> str:
    """nmpc-export --simulate 3 of a problem that is infeasible."""
    output, errors = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "problem.py")
        file.write_text(PROBLEM, encoding="utf-8")
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            code = main([str(file), "-o", str(Path(folder, "c")), "--simulate", "3"])
    return f"exit {code}\n{errors.getvalue()}"


if __name__ == "__main__":
    for number, one in enumerate(FAULTS, 1):
        print(f"--- {number}. {one.name}\n{one.commit()}")
