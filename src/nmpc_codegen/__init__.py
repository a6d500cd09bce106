"""nmpc_codegen compiles optimal control problems in CasADi to self-contained C99 and loads the code as a controller.

Names that need CasADi are loaded on first use, so that open_package() runs a controller without importing it. The
distribution nmpc-codegen-runtime has the other names only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from nmpc_codegen.errors import (
    BuildError,
    ControllerError,
    ExportError,
    ExtraError,
    NmpcError,
    OptionError,
    ProblemError,
    ProblemWarning,
)
from nmpc_codegen.exclusive import COMPILING
from nmpc_codegen.package.signals import Soft
from nmpc_codegen.package.status import Status
from nmpc_codegen.package.version import __version__ as __version__
from nmpc_codegen.runtime.batch.many import Batch
from nmpc_codegen.runtime.batch.random import Normal, Uniform
from nmpc_codegen.runtime.controller import Controller
from nmpc_codegen.runtime.diagnosis.foreign_names import OF_PACKAGE, missing
from nmpc_codegen.runtime.estimation.observer import Observer
from nmpc_codegen.runtime.extras import DISTRIBUTION, HAS_COMPILER
from nmpc_codegen.runtime.loops.flights import Flights
from nmpc_codegen.runtime.loops.simulate import simulate
from nmpc_codegen.runtime.open_folder import open_estimator, open_package
from nmpc_codegen.runtime.records.log import Log
from nmpc_codegen.runtime.records.recorder import Recorder, open_recording
from nmpc_codegen.runtime.records.replay import Replay, replay

if TYPE_CHECKING:
    from nmpc_codegen.analysis import worst_case
    from nmpc_codegen.compiler import Package, batch, build, export, generate
    from nmpc_codegen.components.algorithms import (
        AdjointShooting,
        AugmentedLagrangian,
        KalmanFilter,
        MovingHorizon,
        RealTimeIteration,
    )
    from nmpc_codegen.components.condensing import FullCondensing, NoCondensing
    from nmpc_codegen.components.hessians import (
        EconomicGaussNewton,
        ExactHessian,
        ForwardOverAdjoint,
        GaussNewton,
        Mirror,
        Project,
        Symmetric,
    )
    from nmpc_codegen.components.integrators import (
        ESDIRK3,
        RK4,
        SDIRK2,
        SDIRK3,
        SSPRK3,
        ButcherTableau,
        Discrete,
        Euler,
        ExplicitRungeKutta,
        GaussLegendre2,
        GaussLegendre3,
        Heun,
        ImplicitEuler,
        ImplicitMidpoint,
        ImplicitRungeKutta,
        Midpoint,
        RadauIIA2,
        RadauIIA3,
    )
    from nmpc_codegen.components.qp import DenseActiveSet, Osqp, RiccatiActiveSet, RiccatiInteriorPoint
    from nmpc_codegen.frontend.estimator.declaration import Estimator
    from nmpc_codegen.frontend.functions.excess import smooth_excess
    from nmpc_codegen.frontend.functions.lookup_table import lookup_table
    from nmpc_codegen.frontend.ocp import OCP
    from nmpc_codegen.options import Online, Options

_HOMES = {
    "analysis": ("worst_case",),
    "components.algorithms": (
        *("AdjointShooting", "AugmentedLagrangian", "KalmanFilter", "MovingHorizon", "RealTimeIteration"),
    ),
    "compiler": ("Package", "batch", "build", "export", "generate"),
    "components.condensing": ("FullCondensing", "NoCondensing"),
    "components.hessians": (
        *("EconomicGaussNewton", "ExactHessian", "ForwardOverAdjoint", "GaussNewton", "Mirror"),
        *("Project", "Symmetric"),
    ),
    "components.integrators": (
        *("RK4", "SSPRK3", "ButcherTableau", "Discrete", "Euler", "ExplicitRungeKutta", "Heun", "Midpoint"),
        *("ESDIRK3", "SDIRK2", "SDIRK3", "ImplicitEuler", "ImplicitMidpoint", "ImplicitRungeKutta"),
        *("GaussLegendre2", "GaussLegendre3", "RadauIIA2", "RadauIIA3"),
    ),
    "frontend.functions.excess": ("smooth_excess",),
    "frontend.functions.lookup_table": ("lookup_table",),
    "frontend.estimator.declaration": ("Estimator",),
    "frontend.ocp": ("OCP",),
    "options": ("Online", "Options"),
    "components.qp": ("DenseActiveSet", "Osqp", "RiccatiActiveSet", "RiccatiInteriorPoint"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "ESDIRK3",
    "OCP",
    "RK4",
    "SDIRK2",
    "SDIRK3",
    "SSPRK3",
    "AdjointShooting",
    "AugmentedLagrangian",
    "Batch",
    "BuildError",
    "ButcherTableau",
    "Controller",
    "ControllerError",
    "DenseActiveSet",
    "Discrete",
    "EconomicGaussNewton",
    "Estimator",
    "Euler",
    "ExactHessian",
    "ExplicitRungeKutta",
    "ExportError",
    "ExtraError",
    "Flights",
    "ForwardOverAdjoint",
    "FullCondensing",
    "GaussLegendre2",
    "GaussLegendre3",
    "GaussNewton",
    "Heun",
    "ImplicitEuler",
    "ImplicitMidpoint",
    "ImplicitRungeKutta",
    "KalmanFilter",
    "Log",
    "Midpoint",
    "Mirror",
    "MovingHorizon",
    "NmpcError",
    "NoCondensing",
    "Normal",
    "Observer",
    "Online",
    "OptionError",
    "Options",
    "Osqp",
    "Package",
    "ProblemError",
    "ProblemWarning",
    "Project",
    "RadauIIA2",
    "RadauIIA3",
    "RealTimeIteration",
    "Recorder",
    "Replay",
    "RiccatiActiveSet",
    "RiccatiInteriorPoint",
    "Soft",
    "Status",
    "Symmetric",
    "Uniform",
    "batch",
    "build",
    "export",
    "generate",
    "lookup_table",
    "open_estimator",
    "open_package",
    "open_recording",
    "replay",
    "simulate",
    "smooth_excess",
    "worst_case",
]
if not HAS_COMPILER:
    __all__ = [name for name in __all__ if name not in _HOME]


def __dir__() -> list[str]:
    """Return the public names, including those that are not loaded yet."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


if not TYPE_CHECKING:  # a type checker must find names that do not exist

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise missing(f"module {__name__!r}", name, OF_PACKAGE, __all__)
        if not HAS_COMPILER:
            raise ImportError(
                f"{name} needs the compiler, which {DISTRIBUTION} lacks: pip uninstall {DISTRIBUTION}, then "
                "pip install nmpc-codegen; or run an exported folder with open_package()"
            )
        with COMPILING:
            return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
