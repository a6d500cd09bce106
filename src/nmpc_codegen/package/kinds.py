"""A package is a controller or an estimator; words and files that differ between them are listed here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

EstimatorKind = Literal["mhe", "ekf"]


@dataclass(frozen=True)
class Kind:
    """A kind of package has its own words and templates.

    noun, words: name of the kind; law: its function of a whole sample; opened: the kind, and the function that opens
    it; main, usage: templates of main.c and of the section on usage in README.md.
    """

    noun: str
    words: str
    law: str = "estimate"
    opened: str = "an estimator; open_estimator() opens its folder"
    main: str = "package/main_of_estimator.c.jinja"
    usage: str = "package/usage_estimator.md.jinja"


CONTROLLER = Kind(
    "controller",
    "nonlinear model predictive controller",
    "step",
    "a controller; open_package() opens its folder",
    "package/main.c.jinja",
    "package/usage_controller.md.jinja",
)
ESTIMATORS: dict[EstimatorKind, Kind] = {
    "mhe": Kind("estimator", "moving horizon estimator"),
    "ekf": Kind("estimator", "extended Kalman filter"),
}
