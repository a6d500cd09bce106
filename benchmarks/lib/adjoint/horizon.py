"""Growth with the horizon: Fig. 6.4, a gradient of the map (6.31), and Fig. 6.10, the impulse response of the reactor.

Exponents come from exact operation counts over N >= 100. Times are those of the compiled functions, which work on
matrices that have been computed before where the figure does so, too.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.lib.adjoint import drawing, measured, problems
from benchmarks.lib.adjoint.drawing import WORDS
from benchmarks.lib.adjoint.problems import Case
from benchmarks.lib.report import Report

COUNTED = (10, 25, 50, 75, 100, 150, 200, 300, 400, 600, 800)
TIMED = (25, 50, 100, 150, 200, 300)

GRADIENTS = ("finite_differences", "forward", "adjoint", "adjoint_matrices")
RESPONSES = ("forward", "adjoint_matrices", "alternative", "structure_ignored")


def reactor(N: int) -> Case:
    """The reactor with loops over the steps, so that the code of all horizons is the same."""
    return problems.reactor(N, unroll="step")


def gradient_operations(N: int) -> dict[str, int]:
    """Operations of one gradient of the map; methods with matrices compute them first."""
    counts = measured.counts(problems.discrete_map, N)
    first = counts.sensitivities.total
    return {m: counts.all[f"gradient_{m}"].total + first * (m in ("forward", "adjoint_matrices")) for m in GRADIENTS}


def measure_gradient(report: Report, folder: Path) -> None:
    """Fig. 6.4: (a) all methods, (b) the adjoint ones alone; the thesis shows N up to 200."""
    counted = [gradient_operations(N) for N in COUNTED]
    operations = {WORDS[m]: [c[m] for c in counted] for m in GRADIENTS}
    seconds: dict[str, list[float]] = {WORDS[m]: [] for m in GRADIENTS}
    for N in TIMED:
        timed = measured.compiled(problems.discrete_map(N))
        first = timed.seconds("sensitivities")
        for m in GRADIENTS:
            more = first if m in ("forward", "adjoint_matrices") else 0.0
            seconds[WORDS[m]].append(1e6 * (timed.seconds(f"gradient_{m}") + more))
    figure, axes = drawing.axes(2, 2)
    for row, (x, values, label) in enumerate(((COUNTED, operations, "operations"), (TIMED, seconds, "time [us]"))):
        drawing.curves(axes[row, 0], x, values)
        drawing.curves(axes[row, 1], x, {k: v for k, v in values.items() if k.startswith("adjoint")})
        axes[row, 0].set(xlabel="N", ylabel=label, title="gradient of J, map (6.31)")
        axes[row, 1].set(xlabel="N", ylabel=label, title="the adjoint methods alone")
    drawing.save(figure, folder, "figure_6_4")
    for m in GRADIENTS:
        slope, pace = measured.exponent(COUNTED, operations[WORDS[m]]), measured.exponent(TIMED, seconds[WORDS[m]])
        _add_exponents(report, m, f"gradient, map (6.31), {WORDS[m]}", slope, pace)
    for method in ("forward", "finite_differences"):
        ratio = operations[WORDS[method]][COUNTED.index(100)] / operations["adjoint"][COUNTED.index(100)]
        report.add(
            f"{method}_over_adjoint", ratio, "times", case="gradient, map (6.31), N = 100, operations", profile=""
        )


def measure_impulse_response(report: Report, folder: Path) -> None:
    """Fig. 6.10: the impulse response matrix of the reactor from matrices that are known."""
    functions = {m: f"impulse_response_{m}" for m in RESPONSES}
    operations: dict[str, list[float]] = {WORDS[m]: [] for m in RESPONSES}
    for N in COUNTED:
        counts = measured.counts(reactor, N)
        found = {m: counts.all[f].total for m, f in functions.items() if m != "structure_ignored"}
        found |= {"alternative": counts.insertion.total, "structure_ignored": measured.structure_ignored(counts)}
        for m in RESPONSES:
            operations[WORDS[m]].append(found[m])
    horizons = [N for N in TIMED if N <= 200]
    seconds: dict[str, list[float]] = {WORDS[m]: [] for m in RESPONSES if m != "alternative"}
    for N in horizons:
        timed = measured.compiled(reactor(N))
        for m in RESPONSES:
            if m != "alternative":
                seconds[WORDS[m]].append(1e3 * timed.seconds(functions[m]))
    figure, axes = drawing.axes(2, 3)
    panels = (("forward", "adjoint, matrices"), ("alternative",), ("structure ignored",))
    titles = ("(a) 6.5 and 6.6 from known A, B", "(b) 6.10 from known responses", "(c) structure ignored")
    for column, (names, title) in enumerate(zip(panels, titles, strict=True)):
        drawing.curves(axes[0, column], COUNTED[:7], {k: operations[k][:7] for k in names})
        axes[0, column].set(xlabel="N", ylabel="operations", title=title)
    for column, names in ((0, panels[0]), (2, panels[2])):
        drawing.curves(axes[1, column], horizons, {k: seconds[k] for k in names})
        axes[1, column].set(xlabel="N", ylabel="time [ms]")
    drawing.curves(axes[1, 1], COUNTED, operations, log=True)
    axes[1, 1].set(xlabel="N", ylabel="operations", title="all")
    drawing.save(figure, folder, "figure_6_10")
    for m in RESPONSES:
        pace = measured.exponent(horizons, seconds[WORDS[m]]) if WORDS[m] in seconds else None
        slope = measured.exponent(COUNTED, operations[WORDS[m]])
        what = f"impulse response, Van de Vusse, {WORDS[m]}"
        key = {"forward": "forward", "structure_ignored": "structure_ignored"}.get(m, f"impulse_response_{m}")
        _add_exponents(report, key, what, slope, pace)
    rows = measured.counts(reactor, 100)
    one, every = rows.impulse_response_adjoint_matrices([199]).total, rows.impulse_response_adjoint_matrices(range(200))
    report.add("row_share", one / every.total, case="one row of 6.6 over all 200, N = 100, operations", profile="")


def _add_exponents(report: Report, method: str, case: str, slope: float, pace: float | None) -> None:
    """Exponent of operations, with the limit of the method, and that of times without one."""
    upper = {"adjoint": 1.15, "adjoint_matrices": 1.15, "forward": 2.2, "structure_ignored": 3.2}
    lower = {"forward": 1.8, "structure_ignored": 2.8}
    key = "adjoint" if method == "adjoint_matrices" else method
    report.add(f"{key}_exponent", slope, case=f"{case}, operations", limit=upper.get(method), profile="")
    if method in lower:
        least = lower[method]
        report.add(f"{key}_exponent_least", slope, case=f"{case}, operations", limit=least, at_least=True, profile="")
    if pace is not None:
        report.add(f"{key}_time_exponent", pace, case=f"{case}, times")
