"""Names that other tools give the parts of a problem are translated to those of an OCP."""

from __future__ import annotations

from collections.abc import Mapping

_COST = "least_squares(expr, weight), or stage_cost(expr) for a general cost; at the end terminal_cost(expr)"
_ROW = "subject_to(lower, expression, upper)"
_DYNAMICS = "dynamics({state: derivative})"
_RATE = "least_squares(ocp.rate(u), weight), subject_to(lower, ocp.rate(u), upper); u - ocp.previous(u) per sample"
_BLOCKS = "control(name, hold=[1, 1, 2, 4]), the lengths of blocks of intervals with one control each"
_ALGEBRAIC = "z = algebraic(name, initial=...) and algebraic_equation(g), for 0 = g(x, z, u, p)"
_IMPLICIT = "implicit_dynamics(f) with der(x), for 0 = f(x', x, z, u, p)"

#: Name in acados, ACADO, CasADi's Opti, do-mpc, rockit -> its counterpart in OCP.
OF_PROBLEM: Mapping[str, str] = {
    "algebraic_state": _ALGEBRAIC,
    "add_alg": _ALGEBRAIC,
    "set_alg": _ALGEBRAIC,
    "f_impl_expr": _IMPLICIT,
    "xdot": _IMPLICIT,
    "minimize": _COST,
    "add_objective": _COST,
    "set_objective": _COST,
    "minimizeLSQ": "least_squares(expr, weight)",
    "minimizeLSQEndTerm": "terminal_least_squares(expr, weight)",
    "minimizeLagrangeTerm": "stage_cost(expr, integrate=True)",
    "minimizeMayerTerm": "terminal_cost(expr)",
    "set_rterm": _RATE,
    "du": _RATE,
    "delta_u": _RATE,
    "deltaU": _RATE,
    "add_delta_u": _RATE,
    "u_prev": "previous(u), the control of the previous node",
    "n_control_horizon": _BLOCKS,
    "control_horizon": _BLOCKS,
    "move_blocking": _BLOCKS,
    "t": "time, the time of the node",
    "integral": "stage_cost(expr, integrate=True)",
    "cost": _COST,
    "constraints": _ROW,
    "subjectTo": _ROW,
    "bounds": "subject_to(lower, symbol, upper)",
    "bounded": _ROW,
    "set_nl_cons": f"{_ROW}, with soft=(l1, l2) for a soft row",
    "model": "OCP itself: state(), control(), parameter(), dynamics()",
    "set_der": _DYNAMICS,
    "set_rhs": _DYNAMICS,
    "set_next": "dynamics({state: next state}, discrete=True)",
    "set_variable": "state(name), control(name) or parameter(name)",
    "variable": "state(name) or control(name)",
    "input": "control(name)",
    "set_initial": "state(name, initial=...) for x_0, or ctrl.x and ctrl.u of the built controller",
    "set_value": "parameter(name, value=...), or ctrl.set_parameter(name, value) of the built controller",
    "set_tvp_fun": "parameter(name), and ctrl.set_parameter(name, values) with one row per node",
    "set_p_fun": "parameter(name), and ctrl.set_parameter(name, value)",
    "at_t0": "at_start(expr), in boundary(); or at='start' of subject_to()",
    "at_tf": "at_end(expr), in boundary(); or at='end' of subject_to()",
    "solver": "build(ocp, options)",
    "solver_options": "build(ocp, Options(...))",
    "setup": "build(ocp, options)",
    "solve": "build(ocp).solve(xhat)",
    "dims": "sizes follow from the declarations: N, x, u, p",
    "free_time": "a state for the end time that scales dynamics(), constant and named by free_initial()",
}
