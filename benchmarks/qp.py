"""The QP solvers: time over N and against CasADi's plugins, complete iterations.

    python -m benchmarks.qp [--json FILE] [--only random,plugins,...] [--picture FILE]

All parts together take about twenty minutes on two cores.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from benchmarks.lib import command
from benchmarks.lib.qp import qp_times
from benchmarks.lib.qp.qp_times import (
    BY_NAME,
    SLOW,
    Contender,
    Recorded,
    Timed,
    contenders,
    median,
    our_times,
    plugin_times,
    record,
)
from benchmarks.lib.report import Report
from nmpc_codegen import FullCondensing, Options, generate
from nmpc_codegen.components.qp import DenseActiveSet
from verification.closed_loop import closed_loop
from verification.peers import available, pinned, silent
from verification.qp.stage_solvers import solvers

EXAMPLES = ("chain3", "quadrotor", "chain5", "chain7")  # in order of size
N_PLUGINS = 40
HORIZONS = (20, 40, 80, 160)
PATIENT = 80  # repeats of our solvers over N, because exponents are sensitive to cache disturbances
SCALED = ("chain5", "quadrotor")

#: Curves of the figure, in the order of their colours.
CURVES = (*solvers(), "hpipm", "osqp", "daqp", "qpoases (condensed)", "daqp (condensed)")

#: Complete iterations and feedback phases: (example, N or None for its own, limits in us).
LOOPS: dict[str, tuple[str, int | None, float | None, float | None]] = {
    "chain3": ("chain3", None, 80.0, None),
    "chain5": ("chain5", None, 200.0, 15.0),
    "chain7": ("chain7", None, 420.0, None),
    "chain5_N160": ("chain5", 160, 900.0, None),
    "quadrotor": ("quadrotor", None, 30.0, 4.0),
}


# Random QPs -----------------------------------------------------------------------------------------------------------


# Plugins --------------------------------------------------------------------------------------------------------------


def _variants(name: str) -> dict[str, Options]:
    """Options of the example with every pair of condensing and QP solver, and with the pair chosen by default."""
    base = BY_NAME[name].options
    pairs = {key: Options(base.integrator, condensing=o.condensing, qp=o.qp) for key, o in solvers().items()}
    return {"chosen": base, **pairs}


def condensing_time(recorded: Recorded) -> float:
    """Time (us) in which our C code condenses a QP of the recording fully."""
    base = BY_NAME[recorded.name].options
    timed = Timed(recorded.name, recorded.N, Options(base.integrator, condensing=FullCondensing(), qp=DenseActiveSet()))
    with pinned():
        return timed.time_condensing(recorded.qps[0])


def plugins(report: Report) -> None:
    """Complete QP solves against the fastest plugin on the same QPs, N = 40, cold and with an unchanged active set.

    The plugins get the QP in stage form. A dense solver after our condensing, whose time is added, is another peer with
    separate keys.
    """
    slow: set[str] = set()
    for name in EXAMPLES:
        recorded = record(name, N_PLUGINS)
        ours = _our_medians(report, recorded)
        extra = condensing_time(recorded)
        report.add("condensing_us", extra, "us", case=name)
        theirs: dict[tuple[str, bool], dict[str, float]] = {}
        for one in contenders(extra):
            if not available(one.plugin) or str(one) in slow:
                continue
            for cold in (True, False):
                value = _plugin_median(report, one, recorded, cold)
                theirs.setdefault((one.form, cold), {})[str(one)] = value
                if value > SLOW:
                    slow.add(str(one))
                    break
        _ratios(report, name, ours, theirs)


def _our_medians(report: Report, recorded: Recorded) -> dict[tuple[str, bool], float]:
    found = {}
    for key, options in _variants(recorded.name).items():
        timed = Timed(recorded.name, recorded.N, options)
        for cold in (True, False):
            with pinned():
                times = our_times(timed, recorded, cold=cold)
            value = median(times)
            found[key, cold] = value
            label = f"{recorded.name}, {key}" + ("" if key != "chosen" else f" ({_words(timed.options)})")
            report.add(f"qp_{'cold' if cold else 'warm'}_us", value, "us", case=label, n=len(times))
    return found


def _words(options: Options) -> str:
    return f"{options.condensing.name}+{options.qp.name}"


def _plugin_median(report: Report, one: Contender, recorded: Recorded, cold: bool) -> float:
    kind = "cold" if cold else "warm"
    with pinned(), silent():
        times = plugin_times(one, recorded, cold=cold)
    value = median(times)
    key = f"{one.plugin}{'_condensed' if one.dense else ''}_{kind}"
    if np.isnan(value):
        report.add(f"{key}_failed", int(np.isnan(times).sum()), case=recorded.name, n=len(times), profile="casadi")
    else:
        report.add(f"{key}_us", value, "us", case=recorded.name, n=len(times), profile="casadi")
    return value


def _ratios(
    report: Report, name: str, ours: dict[tuple[str, bool], float], theirs: dict[tuple[str, bool], dict[str, float]]
) -> None:
    for cold, kind, limit in ((True, "cold", 0.5), (False, "warm", 0.2)):
        for form, key in (("stages", f"{kind}_ratio_best_plugin"), ("condensed", f"{kind}_ratio_condensed_plugin")):
            times = {plugin: t for plugin, t in theirs.get((form, cold), {}).items() if np.isfinite(t)}
            if not times:
                report.add(key, np.nan, case=f"{name}: no plugin answered", limit=limit)
                continue
            best = min(times, key=lambda plugin: times[plugin])
            asked = limit if form == "stages" else None
            report.add(key, ours["chosen", cold] / times[best], case=f"{name}, {best}", limit=asked)


# Time against N -------------------------------------------------------------------------------------------------------


def scaling(report: Report, picture: str = "out/qp_scaling.png", horizons: tuple[int, ...] = HORIZONS) -> None:
    """Chain 5 and quadrotor over N = 20 .. 160, all solvers and the plugins that are fast enough; fitted exponents."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    axes = figure.subplots(2, len(SCALED), sharex=True, sharey="row", squeeze=False)
    for column, name in enumerate(SCALED):
        curves = _curves(name, horizons)
        for row, cold in enumerate((True, False)):
            kind = "cold" if cold else "warm"
            for (key, is_cold), values in curves.items():
                if is_cold == cold:
                    _report_curve(report, name, key, kind, horizons, values)
                    _draw_curve(axes[row, column], key, horizons, values)
            axes[row, column].set_title(f"{name}, {'no guess' if cold else 'active set unchanged'}")
            axes[row, column].grid(alpha=0.3)
            axes[row, column].set_xticks(horizons, [str(n) for n in horizons])
            axes[row, column].minorticks_off()
        axes[1, column].set(xlabel="intervals N", xlim=(horizons[0] / 1.1, horizons[-1] * 1.6))
    for axis in axes[:, 0]:
        axis.set_ylabel("whole QP [us]")
    shown = {label: line for axis in axes.flat for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=5, fontsize=8)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    print(f"picture: {picture}")


def _draw_curve(axis: Any, key: str, horizons: tuple[int, ...], values: list[float]) -> None:
    """Measured points, with the fitted exponent at the last one; our solvers solid, CasADi's plugins dotted."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 2:
        return
    colour = f"C{CURVES.index(key)}" if key in CURVES else "0.5"
    axis.loglog(horizons, values, "o-" if "+" in key else "s:", color=colour, label=key, linewidth=1.6, markersize=5)
    text = f" {fitted_exponent(horizons, values):.2f}"
    axis.text(horizons[known[-1]], values[known[-1]], text, color=colour, fontsize=8, va="center")


def _curves(name: str, horizons: tuple[int, ...]) -> dict[tuple[str, bool], list[float]]:
    """(solver, cold) -> time for every horizon; NaN if it was not run or failed."""
    curves: dict[tuple[str, bool], list[float]] = {}
    peers = [c for c in contenders(0.0) if available(c.plugin)]
    for place, N in enumerate(horizons):
        recorded = record(name, N, disturbances=3, samples=12)
        for key, options in _variants(name).items():
            timed = Timed(name, N, options) if key != "chosen" else None
            for cold in (True, False) if timed else ():
                with pinned():
                    curves.setdefault((key, cold), [np.nan] * len(horizons))[place] = median(
                        our_times(timed, recorded, cold=cold, repeats=PATIENT)
                    )
        extra = condensing_time(recorded)
        for one in peers:
            one = Contender(one.plugin, one.form, extra if one.dense else 0.0)
            for cold in (True, False):
                values = curves.setdefault((str(one), cold), [np.nan] * len(horizons))
                if place and not values[place - 1] < SLOW / 10:
                    continue
                with pinned(), silent():
                    values[place] = median(plugin_times(one, recorded, cold=cold, budget=2e5))
    return curves


def _report_curve(
    report: Report, name: str, key: str, kind: str, horizons: tuple[int, ...], values: list[float]
) -> None:
    """Times, their exponent, and the number of failures of a solver of ours."""
    ours, label = "+" in key, f"{name}, {key}, {kind}"
    known = np.isfinite(values)
    profile = "fast" if ours else "casadi"
    if ours:
        report.add("scaling_unsolved", int(np.sum(~known)), case=label, n=len(values))
    if np.sum(known) >= 2:
        riccati = key.startswith("none+riccati")
        report.add(
            "riccati_exponent_N" if riccati else "other_exponent_N",
            fitted_exponent(horizons, values),
            case=label,
            limit=1.1 if riccati else None,
            profile=profile,
            n=int(np.sum(known)),
        )
    for N, value in zip(horizons, values, strict=True):
        if np.isfinite(value):
            report.add(f"qp_N{N}_us", value, "us", case=label, profile=profile)


def fitted_exponent(horizons: tuple[int, ...], values: list[float]) -> float:
    """Slope of log time over log N by least squares."""
    known = np.isfinite(values)
    return float(np.polyfit(np.log(np.array(horizons)[known]), np.log(np.array(values)[known]), 1)[0])


# Whole iterations -----------------------------------------------------------------------------------------------------


def loops(report: Report, runs: int = 15) -> None:
    """Closed loops in C with default options: prepare + feedback, and feedback."""
    for key, (name, N, total, feedback) in LOOPS.items():
        example = BY_NAME[name]
        ocp = example.make() if N is None else qp_times.stretched(example, N)
        steps = example.steps if N is None else example.steps // 2
        sources = generate(ocp, example.options)
        t = closed_loop(sources, name, example.scenario(), runs=runs, steps=steps)
        report.add(f"{key}_total_us", t.total, "us", limit=total, n=t.samples)
        report.add(f"{key}_feedback_us", t.feedback, "us", limit=feedback, n=t.samples)
        report.add(f"{key}_total_median_us", t.total_median, "us", n=t.samples)
        report.add(f"{key}_worst_us", t.worst, "us", n=t.samples)
        report.add(f"{key}_failed_steps", t.failed, limit=0, n=t.samples)
        report.add(f"{key}_qp_iterations", t.qp_iterations, "per step", n=t.samples)


# Torture --------------------------------------------------------------------------------------------------------------


PARTS: dict[str, Callable[..., None]] = {
    "loops": loops,
    "plugins": plugins,
    "scaling": scaling,
}


def main() -> None:
    """Run all parts, or some of them."""
    parser = command.parser(__doc__, PARTS)
    parser.add_argument("--picture", metavar="FILE", default="out/qp_scaling.png", help="times against N")
    options = parser.parse_args()
    parts = {**PARTS, "scaling": partial(scaling, picture=options.picture)}
    names, report = command.chosen(parser, options, PARTS), Report("qp")
    note = f"; CasADi {ca.__version__}, NumPy {np.__version__}"
    command.measure(report, names, lambda name: parts[name](report), options.json, note)


if __name__ == "__main__":
    main()
