"""The contracts of numbers concern derivatives, stated operations, and agreement between the two precisions."""

from __future__ import annotations

import casadi as ca
import numpy as np

from nmpc_codegen import Status
from nmpc_codegen.compiler import text_of
from nmpc_codegen.lowering.lower import lower
from nmpc_codegen.oracle.trajectory import interval_map
from verification.contracts.subject import MOST_ITERATIONS, TOLERANCE, Subject, relative
from verification.counting import mismatches

#: Largest relative errors of derivatives, by precision.
DERIVATIVES = {"double": 1e-10, "single": 1e-3}
NEWTON = 1e-4  # with the Newton steps of a sample
#: Largest differences between the precisions, of controls and of the relative cost; a cost difference that shows that
#: controls matter little.
CONTROLS, COST, FLAT = 5e-2, 1e-2, 1e-4
NEARLY = {"double": 1e-5, "single": 1e-2}


def linearisation_equals_casadi(subject: Subject) -> None:
    """Assert that [A B] of every interval equals CasADi's Jacobian after prepare() at a plan that is no solution."""
    controller, problem, random = subject.controller(), subject.model.problem, np.random.default_rng(5)
    data, z = subject.data(subject.measured()), ca.MX.sym("z", problem.nx + problem.nu)
    p, dt = ca.MX.sym("p", problem.np), ca.MX.sym("dt")
    end = interval_map(problem, subject.scheme)(z[: problem.nx], z[problem.nx :], p, dt)[0]
    phi = ca.Function("phi", [z, p, dt], [end, ca.jacobian(end, z)])
    for name in ("x", "u"):
        plan = getattr(controller, name)
        plan += (0.02 * np.maximum(np.abs(plan), 0.2) * random.uniform(-1, 1, plan.shape)).astype(plan.dtype)
    controller.prepare()
    node, x, u = controller.member("node"), np.array(controller.whole_x, float), np.array(controller.u, float)
    most = NEWTON if subject.scheme.implicit else DERIVATIVES[subject.options.precision]
    for k in range(problem.N):
        _, S = (np.asarray(v) for v in phi(np.append(x[k], u[k]), data.p[k], problem.dt[k]))
        np.testing.assert_allclose(node["S"][k][:, : S.shape[1]], S, rtol=0, atol=most * max(1.0, np.abs(S).max()))


def stated_operations_are_counted(subject: Subject) -> None:
    """Assert that the stated operations of every printed function, by class, are those of a counting scalar."""
    module = lower(subject.model)
    printed = {routine.name for routine in (*module.routines, *module.called_products)}
    assert mismatches(module, text_of(module), printed) == []


def single_is_close_to_double(subject: Subject) -> None:
    """Compare cost and controls of solve(), or of settled samples, in the two precisions."""
    found = {}
    for precision in ("double", "single"):
        controller, x0 = subject.controller(precision), subject.measured()
        if subject.options.solves:
            good = controller.solve(x0, TOLERANCE[precision], MOST_ITERATIONS).kkt.relative <= NEARLY[precision]
        else:
            for _ in range(40):
                controller.step(x0)
            good = controller.status is Status.OK
        found[precision] = controller.cost, controller.u.copy(), good
    (cost, u, solved), (other, v, single) = found["double"], found["single"]
    assert solved == single, "a solution in one of the precisions alone"
    if solved:
        assert abs(other - cost) <= COST * max(abs(cost), 1e-2), f"cost {other} in single, {cost} in double precision"
        assert relative(v, u) <= CONTROLS or abs(other - cost) <= FLAT * max(abs(cost), 1e-2)
