"""Attributes of other tools are translated to those of this package; misspelt ones are corrected."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches

#: Name in acados, ACADO, CasADi's Opti, do-mpc, rockit, or in an earlier version -> its counterpart in a controller.
OF_CONTROLLER: Mapping[str, str] = {
    "make_step": "step(xhat)",
    "solve_for_x0": "step(xhat), or solve(xhat)",
    "set": "set_reference(), set_parameter(), set_bounds(), or write ctrl.x[k] and ctrl.u[k]",
    "get": "ctrl.x, ctrl.u, ctrl.lam: arrays of all nodes",
    "cost_set": "set_weight(W), set_reference(y)",
    "constraints_set": "set_bounds(name, lower, upper, node)",
    "get_cost": "ctrl.cost",
    "get_residuals": "ctrl.kkt()",
    "get_stats": "ctrl.stats",
    "get_status": "ctrl.status",
    "set_u_last": "set_previous(u), the control that was applied last",
    "u0": "previous, the control that was applied last; set_previous(u)",
    "t0": "time of the next sample; set_time(t)",
    "print_statistics": "print(ctrl.stats), and solution.convergence_table()",
    "set_initial_guess": "write ctrl.x (N+1, nx) and ctrl.u (N, nu)",
    "options_set": "Options(...), given to build()",
    "x0": "step(xhat)",
    "simulate": "nmpc_codegen.simulate(ctrl, x0, steps)",
    "feedback_first": "feedback(xhat), after prepare()",
    "feedback_finish": "feedback(xhat), after prepare()",
    "iterate": "step(xhat), or solve(xhat)",
}

#: Name in other tools, or in an earlier version -> its counterpart in this package.
OF_PACKAGE: Mapping[str, str] = {"PartialCondensing": "NoCondensing(), or no condensing, which the compiler chooses"}


def missing(owner: str, attribute: str, foreign: Mapping[str, str], known: list[str]) -> AttributeError:
    """Return the error for an attribute that ``owner`` lacks, with the right attribute if it is known."""
    text = f"{owner} has no attribute {attribute!r}"
    close = get_close_matches(attribute, [name for name in known if not name.startswith("_")], n=1, cutoff=0.75)
    if attribute in foreign:
        text += f"; here: {foreign[attribute]}"
    elif close and not attribute.startswith("_"):
        text += f"; did you mean {close[0]!r}?"
    return AttributeError(text)
