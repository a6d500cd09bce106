"""Both estimators share entry points, tables and members of the square-root filter."""

from __future__ import annotations

from nmpc_codegen.components.base import MEASUREMENTS, Dims, spell
from nmpc_codegen.errors import OptionError
from nmpc_codegen.frontend.problem import Problem, Row
from nmpc_codegen.ir.cmodule import Table
from nmpc_codegen.package.estimation import Estimation
from nmpc_codegen.package.features import Features
from nmpc_codegen.package.kinds import EstimatorKind
from nmpc_codegen.package.signals import Argument, EntryPoint
from nmpc_codegen.package.struct_layout import Field, Struct

#: Features of a problem that estimators support.
SUPPORTS = frozenset({MEASUREMENTS, "free initial state", "soft rows", "discrete states"})

_Y, _U, _XHAT = (Argument("y", "real", ("NM",)), Argument("u", "real", ("NIN",)), Argument("xhat", "real", ("NX",)))
_Y_OUT = Argument("y", "real", ("NM",))
_P = Argument("P", "real", ("NX * NX",))
_ESTIMATE = (
    "Compute xhat, the state at the time of the measurements y, where NaN is a missing one. {of_u}xhat is finite on "
    "every return: after a failure of the window it is the estimate of the filter, after a failure of the filter an "
    "earlier one. The status is NOT_CONVERGED while measurements are unexpected, see stats.innovation. Outliers "
    "are left out."
)
_OF_U = "u are the controls since the last sample; the first sample uses them only in measurements that contain them. "
CORRECT = EntryPoint(
    "correct",
    "Replace the measurements of `age` samples ago by those in y that are not NaN, which come late, and compute the "
    "present state xhat again. The status is BAD_INDEX if the window does not reach back so far.",
    (_Y, Argument("age", "int")),
    (_XHAT,),
)
COVARIANCE = EntryPoint("covariance", "Compute the covariance P of the error of the last estimate.", (), (_P,))
_MEASURE = "Compute what sensors without noise measure at the state x, with the parameters of the present sample"
RESTART = EntryPoint(
    "restart",
    "Forget all measurements. The next sample begins at x0 with the covariance P0, which must be symmetric and "
    "positive semidefinite; the status is BAD_ARGUMENT if it is not.",
    (Argument("x0", "real", ("NX",)), Argument("P0", "real", ("NX * NX",))),
)


def estimate(features: Features) -> EntryPoint:
    """Return the C function of a sample; for a plant without controls, the function has no argument u."""
    known = features.known_controls
    inputs = (_Y, *((_U,) if known else ()))
    return EntryPoint("estimate", _ESTIMATE.format(of_u=_OF_U if known else ""), inputs, (_XHAT,))


def measure(features: Features) -> EntryPoint:
    """Return the C function of the sensors; for a plant without controls, the function has no argument u."""
    known = features.known_controls
    inputs = (Argument("x", "real", ("NX",)), *((_U,) if known else ()))
    return EntryPoint("measure", f"{_MEASURE}{' and the controls u that act' if known else ''}.", inputs, (_Y_OUT,))


def check(algorithm: object, problem: Problem, kind: EstimatorKind) -> None:
    """Raise OptionError unless the problem is that of an estimator of this kind."""
    found = problem.estimation
    if found is None:
        raise OptionError(
            f"algorithm {spell(type(algorithm))} estimates states from measurements, and {problem.name} is a "  # type: ignore[arg-type]
            "controller; expected build(ocp.estimator(...))"
        )
    if found.kind != kind:
        raise OptionError(
            f"algorithm {spell(type(algorithm))} is that of kind={kind!r}, and {problem.name} is stated with "  # type: ignore[arg-type]
            f"kind={found.kind!r}; leave algorithm out"
        )


def tables(problem: Problem) -> tuple[Table, ...]:
    """Return standard deviations, thresholds of outliers, and the bounds to which states are clipped."""
    e = problem.estimation
    assert e is not None
    return (
        Table("process_std", "real", e.process_std, "standard deviations of the noise"),
        Table("initial_std", "real", e.initial_std, "standard deviations of the initial state"),
        Table("accuracy", "real", tuple(1.0 / v for v in e.noise_std), "1 / standard deviation of a measurement"),
        Table("threshold", "real", e.thresholds, "smallest outlier, in standard deviations; 0: none is one"),
        Table(
            "clipped", "int", tuple(_clip_of(e, row) for row in problem.rows), "state that is clipped to a row, or -1"
        ),
    )


def _clip_of(e: Estimation, row: Row) -> int:
    """Return the state that is clipped to a row: an unknown parameter, or in a filter every bounded state.

    -1 for none.
    """
    never = row.kind == "state" and (e.kind == "ekf" or row.name.split("[")[0] in e.unknown)
    return row.index if never else -1


def sizes(dims: Dims) -> tuple[tuple[str, int, str], ...]:
    """Return where the data of measurements are stored among the parameters of a node."""
    e = dims.estimation
    huber = e is not None and any(e.thresholds)
    u, before, y, accuracy = (0, 0, 0, 0) if e is None else e.places
    return (
        ("AT_U", u, "place of the controls among the parameters of a node"),
        ("AT_BEFORE", before, "of those of the previous interval"),
        ("HAS_BEFORE", int(e is not None and e.before), "1: the node has these"),
        ("AT_Y", y, "of the measurements"),
        ("AT_ACCURACY", accuracy, "of their accuracy, 0 for a missing one"),
        ("HUBER", int(huber), "1: outliers are expected"),
        ("EXPECTED_SAMPLES", 5, "samples as expected behind which one that is far from it is left out"),
        ("EXPECTED_OUTLIERS", 3 if huber else 0, "doubted samples in a row that outliers may cause"),
        ("DOUBTED_SAMPLES", 11, "samples after which an estimate that they contradict is given up"),
        ("TRIAL_SAMPLES", 8, "samples as expected after which the next one is OK"),
        ("FORGIVING_SAMPLES", 30, "samples as expected after which new beginnings before them do not count"),
        ("MOST_RESTARTS", 10, "times that the patience with an estimate doubles, at most"),
    )


def own_fields(dims: Dims) -> tuple[Field, ...]:
    """Return the members for a restart of the estimator, and for the watch on its innovations."""
    return (
        Field("known", (dims.nx,), "last estimate that was OK", "keep"),
        Field("samples", (), "samples since init, reset or restart", "keep", "int32"),
        Field("watch", (), "counters of the innovations", "keep", "watch"),
    )


#: Statistics on the measurements of a sample.
INNOVATION = (
    Field("innovation", (), "largest error of a measurement, in standard deviations of its prediction", "result"),
    Field("error", (), "error of that measurement, in its unit", "result"),
    Field("measurement", (), "index of that measurement, or -1", "result", "int32"),
)


def structs(dims: Dims) -> tuple[Struct, ...]:
    """Return the structs for a mean with a factor of its covariance, and for the watch on innovations."""

    def count(name: str, doc: str) -> Field:
        return Field(name, (), doc, "keep", "int32")

    return (
        Struct(
            "filter",
            "square-root Kalman filter",
            (
                Field("mean", (dims.nx,), "expected state", "keep"),
                Field("L", (dims.nx, dims.nx), "factor of the covariance L L'", "keep"),
            ),
        ),
        Struct(
            "watch",
            "innovations of the recent samples",
            (
                Field("surprise", (), "sum of the squared innovations", "keep"),
                Field("count", (), "number of innovations in the sum", "keep"),
                Field("sum", (dims.nm,), "sums of the recent innovations of a measurement", "keep"),
                Field("variance", (dims.nm,), "variances of these sums", "keep"),
                count("seen", "samples since the beginning, up to those that are not judged"),
                count("expected", "samples in a row that are as expected"),
                count("doubted", "samples in a row that are not"),
                count("left_out", "1: a measurement of the last sample was left out"),
                count("trial", "expected samples after which the estimate is OK again"),
                count("restarts", "new beginnings in a row"),
            ),
        ),
    )
