"""Tables 6.3 and 6.4 give the operations of every method for four problems.

They include the operations of Algorithm 6.7 where a method needs it.
"""

from __future__ import annotations

from collections.abc import Callable

from nmpc_codegen.derivatives.counts import Counts
from nmpc_codegen.derivatives.derivative_model import derivative_model
from verification.adjoint import problems
from verification.adjoint.problems import Case

#: Column of the tables -> its problem.
CASES: dict[str, Callable[[], Case]] = {
    "map, N = 10": lambda: problems.discrete_map(10),
    "map, N = 100": lambda: problems.discrete_map(100),
    "reactor, N = 50": problems.reactor,
    "rod, nx = 100, N = 10": lambda: problems.rod(100, 10),
}
#: Row of the tables -> method.
METHODS = {
    "finite differences": "finite_differences",
    "6.7 and forward": "forward",
    "6.7 and adjoint": "adjoint_matrices",
    "adjoint products": "adjoint",
    "6.8 and alternative": "alternative",
}


def operations(case: Case) -> tuple[dict[str, int], dict[str, int], int, int]:
    """Count the operations of gradient and impulse response matrix by method.

    The last two results are those of the last row of the matrix, by Algorithms 6.7 and 6.6 and by products.
    """
    counts = Counts(derivative_model(case.ocp, case.outputs, None, case.options))
    first = counts.sensitivities.total

    def totals(what: str) -> dict[str, int]:
        needs = ("forward", "adjoint_matrices")
        return {row: counts.all[f"{what}_{m}"].total + first * (m in needs) for row, m in METHODS.items()}

    row = [counts.N * counts.nout - 1]
    return (
        totals("gradient"),
        totals("impulse_response"),
        first + counts.impulse_response_adjoint_matrices(row).total,
        counts.impulse_response_adjoint(row).total,
    )


def tables() -> dict[str, dict[str, list[int]]]:
    """Return {title: {row: operations for every problem}}."""
    found = [operations(make()) for make in CASES.values()]
    return {
        "gradient": {row: [f[0][row] for f in found] for row in METHODS},
        "impulse response matrix": {
            **{row: [f[1][row] for f in found] for row in METHODS},
            "its last row, 6.7 and adjoint": [f[2] for f in found],
            "its last row, adjoint products": [f[3] for f in found],
        },
    }
