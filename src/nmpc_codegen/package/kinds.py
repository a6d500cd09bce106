"""What a package is, a controller or an estimator, and all that differs between them by a word or a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

EstimatorKind = Literal["mhe", "ekf"]


@dataclass(frozen=True)
class Kind:
    """``noun`` and ``words``: what it is; ``law``: its function of a whole sample; ``opened``: what it is, and by which
    function; ``main`` and ``usage``: templates of main.c and of what README.md says of use."""

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
